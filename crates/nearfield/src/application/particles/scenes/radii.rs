//! Grains of three radii, after figure 20 of Xing2017.
//!
//! A third of the grains has radius r and lies on the floor, 1.8 r apart; a third has 3 r and a third 2 r, above it to the left and to the
//! right, three of their own radii apart. The paper does not say where its grains start, and with r above 0.27 % of the domain's diagonal
//! 30,000 of them do not fit so far apart; then they start as far apart as they fit, and the numbers of the law are smaller by the factor
//! by which a grain has more neighbours, so that it receives as much from all of them together.

use glam::DVec3;

use super::super::{BuiltinOptions, DemSettings, PairRule, ParticleScene, Particles};
use super::grains::{Jitter, in_box};
use crate::{Error, Result};

/// Radii of the classes in parts of the smallest.
const CLASSES: [f64; 3] = [3.0, 2.0, 1.0];
/// Distance of neighbours on the floor and above it, in parts of their own radius.
const LOWER: f64 = 1.8;
const UPPER: f64 = 3.0;
/// By how much distances shrink at a time until all have room.
const SHRINK: f64 = 0.995;

pub(super) fn paper_fig20(options: &BuiltinOptions) -> Result<ParticleScene> {
    let part = options.radius.unwrap_or(0.0025);
    if !(part > 0.0 && part <= 0.02) {
        let expected = "a part of the domain's diagonal above 0 and up to 0.02";
        return Err(Error::InvalidSetting { setting: "radius", found: part.to_string(), expected });
    }
    let particles = options.particles.unwrap_or(30_000);
    let counts = [particles / 3, particles / 3, particles - particles / 3 * 2];
    let smallest = part * (DVec3::ONE - DVec3::NEG_ONE).length();
    let radii = CLASSES.map(|factor| factor * smallest);

    // The floor takes the layers that it needs, and the rest is shared in proportion to the volumes of the two others.
    let across = places(2.0, radii[2], LOWER * radii[2]);
    let layers = f64::from(counts[2]).max(1.0) / (across * across);
    let floor = (LOWER * radii[2] * layers.ceil() + radii[2]).min(1.0);
    let share = CLASSES[0].powi(3) / (CLASSES[0].powi(3) + CLASSES[1].powi(3));
    let middle = 2.0 * share - 1.0;
    let blocks = [
        [DVec3::new(-1.0, floor - 1.0, -1.0), DVec3::new(middle, 1.0, 1.0)],
        [DVec3::new(middle, floor - 1.0, -1.0), DVec3::ONE],
        [DVec3::NEG_ONE, DVec3::new(1.0, floor - 1.0, 1.0)],
    ];
    let mut all = Particles::default();
    let mut closest: f64 = 1.0;
    for (class, ([low, high], radius)) in blocks.into_iter().zip(radii).enumerate() {
        let usual = radius * if class == 2 { LOWER } else { UPPER };
        let mut spacing = usual;
        while room(high - low, radius, spacing) < f64::from(counts[class]) {
            spacing *= SHRINK;
        }
        closest = closest.min(spacing / usual);
        let mut block = Particles::at_rest(filled([low, high], radius, spacing, counts[class]));
        block.classes.fill(class as u8);
        all.extend(block);
    }
    let settings = DemSettings { radii: radii.to_vec(), ..DemSettings::green(smallest) };
    let less = closest.powi(3);
    let settings = DemSettings {
        pair_rule: options.pair_rule.unwrap_or(PairRule::Contact),
        spring: settings.spring * less,
        damping: settings.damping * less,
        shear: settings.shear * less,
        ..settings
    };
    Ok(in_box("paper-fig20", all, settings))
}

/// Places along a side of a block, a radius off its ends.
fn places(side: f64, radius: f64, spacing: f64) -> f64 {
    (((side - 2.0 * radius).max(0.0)) / spacing).floor() + 1.0
}

/// Places in a block.
fn room(size: DVec3, radius: f64, spacing: f64) -> f64 {
    size.to_array().into_iter().map(|side| places(side, radius, spacing)).product()
}

/// The first `count` places of a block, from its lower side up.
fn filled([low, high]: [DVec3; 2], radius: f64, spacing: f64, count: u32) -> Vec<DVec3> {
    let [nx, _, nz] = (high - low).to_array().map(|side| places(side, radius, spacing) as u32);
    let mut jitter = Jitter::new(radius);
    let inside = |place: DVec3| place.clamp(DVec3::NEG_ONE, DVec3::ONE);
    let place = |i: u32| {
        let cell = DVec3::new(f64::from(i % nx), f64::from(i / nx / nz), f64::from(i / nx % nz));
        inside(low + radius + spacing * cell + jitter.next())
    };
    (0..count).map(place).collect()
}
