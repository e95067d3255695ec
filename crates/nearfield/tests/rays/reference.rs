//! What is right, in f64, for each ray by the obvious loop; and the comparison with it.
//!
//! A triangle is surely hit where the ray passes its inside by more than a bound, surely missed where it passes outside
//! by more than that, and in doubt between. With R the longest side of the mesh, M = 2⁻¹⁷ R the margin of
//! `geometry::RaySpace`, and W the largest coordinate of ray and mesh, the bound is M + 2⁻²² W: the margin covers what
//! rounding does near the mesh, the second part the origin of a ray that starts far away, and is left out for others.

use libtest_mimic::Trial;
use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::{BruteForceMesh, DVec3, HitRecord, Ray, RaySearch, TriMesh, Vec3};
use rayon::prelude::*;

use crate::rays::rays;
use crate::support::trial;

/// The share of t by which it may be off.
const T_SHARE: f64 = 1e-5;
/// Where a ray meets a plane under at least this cosine, at least this many longest sides from where it starts, nothing
/// but the share of t is allowed. Elsewhere the bound over the cosine is added: a ray that grazes a plane meets it
/// farther off by as much, and near its origin a share of t is less than coordinates can tell.
const STEEP: f64 = 0.125;
const FAR_ENOUGH: f64 = 0.0625;
/// A triangle lower than this share of its longest edge has weights that are quotients of small areas, by which t, which
/// lies between the depths of its corners, moves along it: there, too, the bound over the cosine is added.
const LOW: f64 = 1.0 / 32.0;

/// What is known of one ray and one triangle that it does not surely miss.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Found {
    triangle: u32,
    /// t lies between these, if it is a hit.
    low: f64,
    high: f64,
    /// Whether it is hit for sure.
    sure: bool,
    /// Whether t may be off by more than its share.
    wide: bool,
}

/// What is known of one ray and a mesh.
#[derive(Debug, Default)]
pub(crate) struct Truth {
    found: Vec<Found>,
    t_min: f64,
    t_max: f64,
}

/// How many rays were compared, and of how many there is what kind of doubt.
#[derive(Debug, Default, Clone, Copy)]
pub(crate) struct Tally {
    pub(crate) rays: usize,
    /// A triangle is in doubt before their first sure hit, or a t at a limit of theirs.
    pub(crate) in_doubt: usize,
    /// Hits whose t was compared with the wide tolerance, and all hits.
    pub(crate) wide: usize,
    pub(crate) hits: usize,
}

impl Tally {
    pub(crate) fn add(&mut self, other: &Self) {
        self.rays += other.rays;
        self.in_doubt += other.in_doubt;
        self.wide += other.wide;
        self.hits += other.hits;
    }
}

struct Bound {
    distance: f64,
    /// Longest side of the mesh.
    reach: f64,
}

impl Bound {
    fn of(mesh: &TriMesh, ray: &Ray) -> Self {
        let bounds = mesh.bounds();
        let reach = f64::from(bounds.extent().max_element());
        let outside = (bounds.min - ray.origin).max(ray.origin - bounds.max).max_element();
        let margin = reach / f64::from(1 << 17);
        let far = if f64::from(outside) > reach {
            let largest = ray.origin.abs().max(bounds.min.abs()).max(bounds.max.abs()).max_element();
            f64::from(largest) / f64::from(1 << 22)
        } else {
            0.0
        };
        Self { distance: margin + far, reach }
    }
}

/// Distance from the origin to the segment in the plane.
fn distance_to_segment(a: (f64, f64), b: (f64, f64)) -> f64 {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let length2 = dx * dx + dy * dy;
    let share = if length2 > 0.0 { (-(a.0 * dx + a.1 * dy) / length2).clamp(0.0, 1.0) } else { 0.0 };
    (a.0 + share * dx).hypot(a.1 + share * dy)
}

/// A ray with its direction as z.
struct Frame {
    origin: DVec3,
    axes: [DVec3; 3],
    length: f64,
}

impl Frame {
    fn of(ray: &Ray) -> Self {
        let direction = ray.direction.as_dvec3();
        let length = direction.length();
        let z = direction / length;
        let x = z.any_orthonormal_vector();
        Self { origin: ray.origin.as_dvec3(), axes: [x, z.cross(x), z], length }
    }
}

fn verdict(triangle: u32, corners: [DVec3; 3], frame: &Frame, bound: &Bound) -> Option<Found> {
    let [x, y, z] = frame.axes;
    let local = corners.map(|c| c - frame.origin);
    let flat = local.map(|c| (c.dot(x), c.dot(y)));
    let beyond = |of: fn(&(f64, f64)) -> f64| {
        flat.iter().all(|p| of(p) > bound.distance) || flat.iter().all(|p| of(p) < -bound.distance)
    };
    if beyond(|p| p.0) || beyond(|p| p.1) {
        return None;
    }
    let depth = local.map(|c| c.dot(z));
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    let edges = [0, 1, 2].map(|i| (corners[(i + 1) % 3] - corners[i]).length());
    if normal.length() <= 8.0 * f64::EPSILON * edges[0] * edges[2] {
        return None;
    }
    let side = |a: (f64, f64), b: (f64, f64)| a.0 * b.1 - a.1 * b.0;
    let sides = [side(flat[0], flat[1]), side(flat[1], flat[2]), side(flat[2], flat[0])];
    let inside = sides.iter().all(|&s| s >= 0.0) || sides.iter().all(|&s| s <= 0.0);
    let area = sides.iter().sum::<f64>();
    let inside = inside && area != 0.0;
    let nearest = (0..3).map(|i| distance_to_segment(flat[i], flat[(i + 1) % 3])).fold(f64::INFINITY, f64::min);
    if !inside && nearest > bound.distance {
        return None;
    }
    let found = |low: f64, high: f64, sure, wide| {
        Some(Found { triangle, low: low / frame.length, high: high / frame.length, sure, wide })
    };
    if inside && nearest > bound.distance {
        let cosine = (normal.dot(z) / normal.length()).abs();
        let t = normal.dot(local[0]) / normal.dot(z);
        let longest = edges.iter().copied().fold(0.0, f64::max);
        let is_low = normal.length() < LOW * longest * longest;
        let wide = is_low || cosine < STEEP || t.abs() < FAR_ENOUGH * bound.reach;
        let off = T_SHARE * t.abs() + if wide { bound.distance / cosine } else { 0.0 };
        return found(t - off, t + off, true, wide);
    }
    let (low, high) =
        (depth.iter().copied().fold(f64::INFINITY, f64::min), depth.iter().copied().fold(f64::NEG_INFINITY, f64::max));
    let (low, high) = (low - bound.distance, high + bound.distance);
    let off = T_SHARE * low.abs().max(high.abs());
    found(low - off, high + off, false, true)
}

impl Truth {
    /// By a loop over all triangles.
    pub(crate) fn of(mesh: &TriMesh, ray: &Ray) -> Self {
        let (bound, frame) = (Bound::of(mesh, ray), Frame::of(ray));
        let found = |i: usize| {
            let t = mesh.triangle(i);
            verdict(i as u32, [t.a, t.b, t.c].map(Vec3::as_dvec3), &frame, &bound)
        };
        let found = (0..mesh.triangles.len()).filter_map(found).collect();
        Self { found, t_min: f64::from(ray.t_min), t_max: f64::from(ray.t_max) }
    }

    /// Farthest that the first hit can be: infinite where none is sure.
    fn latest(&self) -> f64 {
        let sure = self.found.iter().filter(|f| f.sure && f.low >= self.t_min && f.high <= self.t_max);
        sure.map(|f| f.high).fold(f64::INFINITY, f64::min)
    }

    /// Whether a triangle in doubt, or a t at the border of the ray's range, could come first.
    fn is_in_doubt(&self) -> bool {
        let latest = self.latest();
        self.found.iter().any(|&Found { low, high, sure, .. }| {
            let at_border = low < self.t_min && high >= self.t_min || low <= self.t_max && high > self.t_max;
            low <= latest && high >= self.t_min && low <= self.t_max && (!sure || at_border)
        })
    }

    /// What is known of the triangle of a hit.
    fn found_of(&self, hit: &HitRecord) -> Option<&Found> {
        self.found.iter().find(|found| found.triangle == hit.triangle)
    }

    /// Why this is not the first hit.
    fn closest_fault(&self, found: &HitRecord) -> Option<String> {
        let latest = self.latest();
        if !found.is_hit() {
            return latest.is_finite().then(|| format!("a miss, but there is a hit at {latest} or before"));
        }
        let t = f64::from(found.t);
        let Some(&Found { low, high, .. }) = self.found_of(found) else {
            return Some(format!("triangle {} is missed by more than the bound", found.triangle));
        };
        if !(low..=high).contains(&t) || t < self.t_min || t > self.t_max {
            return Some(format!("t is {t}, expected from {low} to {high}"));
        }
        (t > latest).then(|| format!("t is {t}, but there is a hit at {latest} or before"))
    }

    /// Fewest and most hits there can be.
    fn counts(&self) -> (usize, usize) {
        let within = |f: &&Found| f.sure && f.low >= self.t_min && f.high <= self.t_max;
        let possible = |f: &&Found| f.high >= self.t_min && f.low <= self.t_max;
        (self.found.iter().filter(within).count(), self.found.iter().filter(possible).count())
    }
}

/// Truths of many rays, on all threads.
pub(crate) fn truths(mesh: &TriMesh, rays: &[Ray]) -> Vec<Truth> {
    rays.par_iter().map(|ray| Truth::of(mesh, ray)).collect()
}

/// Compares closest hits and counts with the truth; the first fault is an error.
pub(crate) fn compare(rays: &[Ray], truths: &[Truth], closest: &[HitRecord], counts: &[u32]) -> Result<Tally, String> {
    let mut tally = Tally { rays: rays.len(), ..Tally::default() };
    if closest.len() != rays.len() || counts.len() != rays.len() {
        return Err(format!("{} hits and {} counts of {} rays", closest.len(), counts.len(), rays.len()));
    }
    for (i, ray) in rays.iter().enumerate() {
        let truth = &truths[i];
        tally.in_doubt += usize::from(truth.is_in_doubt());
        tally.hits += usize::from(closest[i].is_hit());
        tally.wide += usize::from(truth.found_of(&closest[i]).is_some_and(|found| found.wide));
        if let Some(fault) = truth.closest_fault(&closest[i]) {
            return Err(format!("ray {i}, {ray:?}, got {:?}: {fault}", closest[i]));
        }
        let (fewest, most) = truth.counts();
        if !(fewest..=most).contains(&(counts[i] as usize)) {
            return Err(format!("ray {i}, {ray:?}: {} hits, expected {fewest} to {most}", counts[i]));
        }
    }
    Ok(tally)
}

fn planted_differences_are_found() {
    let mesh = mesh(MeshKind::Icosphere, 80, 1);
    let rays = rays(&mesh, "random", 400, 3);
    let brute = BruteForceMesh::build(&mesh).unwrap();
    let (hits, counts) = (brute.closest_hits(&rays).unwrap(), brute.count_hits(&rays).unwrap());
    let (hits, counts, truths) = (hits.records().to_vec(), counts.as_slice().to_vec(), truths(&mesh, &rays));
    compare(&rays, &truths, &hits, &counts).unwrap();
    let hit = hits.iter().position(HitRecord::is_hit).unwrap();
    let miss = hits.iter().position(|h| !h.is_hit()).unwrap();
    let is_steep = |i: &usize| truths[*i].found_of(&hits[*i]).is_some_and(|found| !found.wide);
    let steep = (0..hits.len()).find(is_steep).unwrap();
    let planted: [(usize, HitRecord); 6] = [
        (hit, HitRecord::miss()),
        (miss, hits[hit]),
        (steep, HitRecord { t: hits[steep].t * (1.0 + 1.2e-5), ..hits[steep] }),
        (hit, HitRecord { t: hits[hit].t * 1.001, ..hits[hit] }),
        (hit, HitRecord { triangle: (hits[hit].triangle + 40) % 80, ..hits[hit] }),
        (hit, HitRecord { t: f32::NAN, ..hits[hit] }),
    ];
    for (i, record) in planted {
        let mut wrong = hits.clone();
        wrong[i] = record;
        assert!(compare(&rays, &truths, &wrong, &counts).is_err(), "{record:?}");
    }
    let mut wrong = counts.clone();
    wrong[hit] += 3;
    assert!(compare(&rays, &truths, &hits, &wrong).is_err());
    assert!(compare(&rays, &truths, &hits[1..], &counts).is_err());
}

pub(crate) fn trials() -> Vec<Trial> {
    vec![trial("planted_differences_are_found", planted_differences_are_found)]
}
