//! A spinning scanner on a car that drives along a street: rings on the ground, house fronts and parked cars.
//!
//! Scanner and mounting follow the KITTI data set (Geiger2012): 64 rings between +2° and -24.8°, 1.73 m above the ground.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::random::SplitMix64;

pub(super) const RINGS: u32 = 64;
pub(super) const TOP_DEGREES: f64 = 2.0;
pub(super) const BOTTOM_DEGREES: f64 = -24.8;
pub(super) const SENSOR_HEIGHT: f64 = 1.73;
pub(super) const RANGE: f64 = 120.0;
pub(super) const NOISE: f64 = 0.02;

const MOST_COLUMNS: usize = 2000;
/// Most returns a column can be expected to give: the rings above the horizon meet nothing in the gaps.
const RETURNS_PER_COLUMN: usize = 60;
/// Metres between turns: 36 km/h at ten turns a second.
const STEP: f64 = 1.0;
/// Metres after which the street repeats.
const PERIOD: f64 = 240.0;
/// Stream of the street itself, beyond any turn's.
const STREET_STREAM: u64 = u64::MAX;

/// A box standing on the ground, in metres.
struct Block {
    min: [f64; 2],
    max: [f64; 2],
    height: f64,
}

/// Elevation of a ring in radians, ring 0 highest.
pub(super) fn elevation(ring: u32) -> f64 {
    let step = (TOP_DEGREES - BOTTOM_DEGREES) / f64::from(RINGS - 1);
    (TOP_DEGREES - step * f64::from(ring)) * (std::f64::consts::PI / 180.0)
}

/// n returns in the order a scanner gives them: turn by turn, column by column, ring by ring.
pub(super) fn scan(n: usize, seed: u64) -> Vec<Vec3> {
    let street = street(seed);
    let rings: Vec<(f64, f64)> = (0..RINGS).map(|ring| libm::sincos(elevation(ring))).collect();
    let columns = n.div_ceil(RETURNS_PER_COLUMN).min(MOST_COLUMNS);
    let mut points = Vec::with_capacity(n);
    let mut turn = 0u64;
    while points.len() < n {
        let sensor_x = turn as f64 * STEP;
        let blocks = blocks_around(&street, sensor_x);
        let scan_column = |column: usize| {
            let mut random = SplitMix64::stream(seed, turn * MOST_COLUMNS as u64 + column as u64);
            let azimuth = std::f64::consts::TAU * column as f64 / columns as f64;
            cast_column(azimuth, &rings, &blocks, &mut random)
        };
        let returns: Vec<Vec<DVec3>> = (0..columns).into_par_iter().map(scan_column).collect();
        let missing = n - points.len();
        let to_world = |p: DVec3| (p + DVec3::new(sensor_x, 0.0, SENSOR_HEIGHT)).as_vec3();
        // The ground alone returns most rings, so every turn adds points.
        points.extend(returns.into_iter().flatten().take(missing).map(to_world));
        turn += 1;
    }
    points
}

/// Houses and parked cars on both sides of one period of the street; the lane |y| < 5 stays free.
fn street(seed: u64) -> Vec<Block> {
    let mut random = SplitMix64::stream(seed, STREET_STREAM);
    let mut blocks = vec![];
    let mut place = |x: (f64, f64), y: (f64, f64), side: f64, height: f64| {
        let (near, far) = (side * y.0, side * y.1);
        blocks.push(Block { min: [x.0, near.min(far)], max: [x.1, near.max(far)], height });
    };
    for side in [-1.0, 1.0] {
        let mut x = 0.0;
        while x < PERIOD - 30.0 {
            let (length, front) = (random.range(10.0, 30.0), random.range(12.0, 16.0));
            let (depth, height) = (random.range(8.0, 15.0), random.range(4.0, 15.0));
            place((x, x + length), (front, front + depth), side, height);
            x += length + random.range(2.0, 8.0);
        }
        for slot in 0..(PERIOD / 8.0) as u32 {
            let (taken, start) = (random.unit() < 0.5, f64::from(slot) * 8.0 + random.range(0.0, 3.0));
            if taken {
                place((start, start + 4.2), (6.0, 7.8), side, 1.5);
            }
        }
    }
    blocks
}

/// The blocks within range of the sensor, relative to it, from every repetition of the street.
fn blocks_around(street: &[Block], sensor_x: f64) -> Vec<Block> {
    let (first, last) =
        (((sensor_x - RANGE) / PERIOD).floor() as i64 - 1, ((sensor_x + RANGE) / PERIOD).floor() as i64);
    let mut near = vec![];
    for repetition in first..=last {
        let shift = repetition as f64 * PERIOD - sensor_x;
        for block in street {
            let (min_x, max_x) = (block.min[0] + shift, block.max[0] + shift);
            if min_x <= RANGE && max_x >= -RANGE {
                near.push(Block { min: [min_x, block.min[1]], max: [max_x, block.max[1]], height: block.height });
            }
        }
    }
    near
}

/// The returns of one column relative to the sensor; `rings` holds sine and cosine of each elevation.
fn cast_column(azimuth: f64, rings: &[(f64, f64)], blocks: &[Block], random: &mut SplitMix64) -> Vec<DVec3> {
    let (sin_azimuth, cos_azimuth) = libm::sincos(azimuth);
    // Seen from above, a column is one ray: it enters and leaves a block at two horizontal distances.
    let crossed: Vec<(f64, f64, f64)> = blocks
        .iter()
        .filter_map(|b| cross_rectangle([cos_azimuth, sin_azimuth], b).map(|(enter, leave)| (enter, leave, b.height)))
        .collect();
    let mut returns = Vec::with_capacity(rings.len());
    for &(sin, cos) in rings {
        let slope = sin / cos;
        let mut distance = if slope < 0.0 { SENSOR_HEIGHT / -slope } else { f64::INFINITY };
        for &(enter, leave, height) in &crossed {
            let z_at_enter = SENSOR_HEIGHT + enter * slope;
            if z_at_enter <= height {
                distance = distance.min(enter);
            } else if slope < 0.0 {
                let roof = (SENSOR_HEIGHT - height) / -slope;
                if roof <= leave {
                    distance = distance.min(roof);
                }
            }
        }
        // Drawn for every ray, so that one return more or less moves no other.
        let noise = NOISE * random.normal();
        let range = distance / cos;
        if range <= RANGE {
            returns.push((range + noise) * DVec3::new(cos * cos_azimuth, cos * sin_azimuth, sin));
        }
    }
    returns
}

/// Horizontal distances at which the ray from the sensor enters and leaves a block's footprint.
fn cross_rectangle(direction: [f64; 2], block: &Block) -> Option<(f64, f64)> {
    let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
    for ((along, min), max) in direction.into_iter().zip(block.min).zip(block.max) {
        if along == 0.0 {
            if min > 0.0 || max < 0.0 {
                return None;
            }
            continue;
        }
        let (a, b) = (min / along, max / along);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    (enter <= leave).then_some((enter, leave))
}
