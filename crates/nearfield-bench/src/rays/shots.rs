//! The rays: from a camera that has the mesh in its picture, off what they hit, and towards a lamp.

use nearfield::geometry::{Aabb, PreparedTriangle};
use nearfield::query::RayHit;
use nearfield::{HitRecord, Ray, TriMesh, Vec3};
use rayon::prelude::*;

/// Seed of bounces and lamp points.
pub const SEED: u64 = 7;
/// Half of the picture's height at distance 1: an angle of view of 45°.
const HALF_VIEW: f32 = 0.414_213_57;
/// The share of the picture's side that the mesh's box fills.
const FILLED: f32 = 0.95;
/// Smallest t of rays that start on a surface, in longest sides of the mesh.
const OFF_SURFACE: f32 = 1e-4;

/// What is asked of rays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Question {
    /// The first hit.
    Closest,
    /// Whether there is one.
    Any,
    /// All of them in order.
    All,
}

/// Rays with what is asked of them.
pub struct Shots {
    /// "primary", "diffuse bounces" …
    pub name: &'static str,
    /// What is asked.
    pub question: Question,
    /// The rays.
    pub rays: Vec<Ray>,
}

/// Bounds of the vertices that triangles use.
fn used_bounds(mesh: &TriMesh) -> Aabb {
    let boxes = (0..mesh.triangles.len()).map(|i| mesh.triangle(i).bounds());
    boxes.fold(Aabb::EMPTY, Aabb::union)
}

/// A ray through the middle of every pixel of a square picture, row by row from the top, by a camera that looks along
/// −z and has the mesh's box fill 95 % of the picture's narrower measure.
pub fn primary(mesh: &TriMesh, side: usize) -> Vec<Ray> {
    let bounds = used_bounds(mesh);
    let (center, half) = (bounds.center(), 0.5 * bounds.extent());
    // The front of the box is what fills the picture.
    let away = half.z + half.x.max(half.y).max(1e-6 * half.z) / (HALF_VIEW * FILLED);
    let eye = center + Vec3::new(0.0, 0.0, away);
    let step = 2.0 * HALF_VIEW / side as f32;
    (0..side * side)
        .map(|pixel| {
            let (x, y) = ((pixel % side) as f32 + 0.5, (pixel / side) as f32 + 0.5);
            Ray::new(eye, Vec3::new(x * step - HALF_VIEW, HALF_VIEW - y * step, -1.0).normalize())
        })
        .collect()
}

/// The rays of so many rows of a square picture, spread evenly over its height; all of them where there are no more.
pub fn sampled_rows(rays: &[Ray], side: usize, rows: usize) -> Vec<Ray> {
    let rows = rows.clamp(1, side.max(1));
    // The middle row of each part.
    let row = |i: usize| (2 * i + 1) * side / (2 * rows);
    (0..rows).flat_map(|i| rays[row(i) * side..(row(i) + 1) * side].iter().copied()).collect()
}

/// A hash of a pixel and a number as two values in [0, 1).
fn uniform(pixel: usize, number: u64) -> [f32; 2] {
    let mut z = SEED.wrapping_add((8 * pixel as u64 + number + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^= z >> 31;
    [(z >> 40) as f32, (z >> 16 & 0xff_ffff) as f32].map(|bits| bits / (1u32 << 24) as f32)
}

/// Rays from random places in the mesh's box in random directions.
pub fn random(mesh: &TriMesh, n: usize) -> Vec<Ray> {
    let bounds = used_bounds(mesh);
    let ray = |i: usize| {
        let ([x, y], [z, turn], [height, _]) = (uniform(i, 2), uniform(i, 3), uniform(i, 4));
        let (z_direction, (sine, cosine)) = (2.0 * height - 1.0, (std::f32::consts::TAU * turn).sin_cos());
        let around = (1.0 - z_direction * z_direction).max(0.0).sqrt();
        let origin = bounds.min + Vec3::new(x, y, z) * bounds.extent();
        Ray::new(origin, Vec3::new(around * cosine, around * sine, z_direction))
    };
    (0..n).into_par_iter().map(ray).collect()
}

/// What the hit rays hit, with the normal on their side, pixel by pixel.
fn surfaces<'a>(
    rays: &'a [Ray],
    hits: &'a [HitRecord],
    triangles: &'a [PreparedTriangle],
) -> impl ParallelIterator<Item = (usize, Vec3, Vec3)> + 'a {
    rays.par_iter().zip(hits).enumerate().filter(|(_, (_, hit))| hit.is_hit()).map(move |(pixel, (ray, record))| {
        let hit = RayHit::new(record, &triangles[record.triangle as usize]);
        let normal = if hit.normal.dot(ray.direction) > 0.0 { -hit.normal } else { hit.normal };
        (pixel, hit.position, normal)
    })
}

/// A ray off every hit, in the order of the pixels, with the cosine's distribution about the normal.
pub fn bounces(rays: &[Ray], hits: &[HitRecord], triangles: &[PreparedTriangle], reach: f32) -> Vec<Ray> {
    let bounce = |(pixel, position, normal): (usize, Vec3, Vec3)| {
        let [turn, height] = uniform(pixel, 0);
        let (sine, cosine) = (std::f32::consts::TAU * turn).sin_cos();
        let (x, y) = normal.any_orthonormal_pair();
        let direction = height.sqrt() * (cosine * x + sine * y) + (1.0 - height).sqrt() * normal;
        Ray { t_min: OFF_SURFACE * reach, ..Ray::new(position, direction.normalize()) }
    };
    surfaces(rays, hits, triangles).map(bounce).collect()
}

/// A ray from every hit to a point of a square lamp over and before the mesh, in the order of the pixels.
pub fn shadows(rays: &[Ray], hits: &[HitRecord], triangles: &[PreparedTriangle], bounds: &Aabb) -> Vec<Ray> {
    let reach = bounds.extent().max_element();
    let lamp = bounds.center() + reach * Vec3::new(0.6, 1.5, 1.0);
    let shadow = |(pixel, position, _): (usize, Vec3, Vec3)| {
        let [x, z] = uniform(pixel, 1);
        let direction = lamp + 0.5 * reach * Vec3::new(x - 0.5, 0.0, z - 0.5) - position;
        Ray { t_min: OFF_SURFACE, t_max: 1.0, ..Ray::new(position, direction) }
    };
    surfaces(rays, hits, triangles).map(shadow).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nearfield::geometry::generate::{MeshKind, mesh};
    use nearfield::structure::PreparedTriangles;
    use nearfield::{BruteForceMesh, RaySearch};

    #[test]
    fn the_mesh_is_in_the_picture_and_bounces_leave_it() {
        let mesh = mesh(MeshKind::Icosphere, 320, 0);
        let triangles = PreparedTriangles::new(&mesh).expect("a mesh");
        let brute = BruteForceMesh::of(triangles.clone());
        let side = 64;
        let rays = primary(&mesh, side);
        let hits = brute.closest_hits(&rays).expect("hits");
        let hit = |x: usize, y: usize| hits.records()[y * side + x].is_hit();
        assert!(hit(32, 32) && !hit(0, 0) && !hit(63, 63));
        assert!((0..side).all(|i| !hit(i, 0) && !hit(0, i)), "room at the border");
        // The ball's outline stands a little behind the front of its box.
        let share = hits.n_hits() as f64 / rays.len() as f64;
        assert!((0.3..0.75).contains(&share), "{share}");
        // Off a convex mesh no bounce comes back, and their mean leans along the normals by 2/3.
        let off = bounces(&rays, hits.records(), triangles.as_slice(), 2.0);
        assert_eq!(off.len(), hits.n_hits());
        assert_eq!(brute.any_hits(&off).expect("states").as_slice().iter().sum::<u32>(), 0);
        let lean: f32 = off.iter().map(|ray| ray.direction.dot(ray.origin.normalize())).sum::<f32>() / off.len() as f32;
        assert!((lean - 2.0 / 3.0).abs() < 0.03, "{lean}");
        let shadows = shadows(&rays, hits.records(), triangles.as_slice(), &mesh.bounds());
        let lit = brute.any_hits(&shadows).expect("states").as_slice().iter().filter(|&&s| s == 0).count();
        assert!(lit > shadows.len() / 10 && lit < shadows.len(), "{lit} of {} lit", shadows.len());
    }

    #[test]
    fn sampled_rows_are_whole_distinct_and_spread_over_the_picture() {
        let side = 10;
        let rays: Vec<Ray> = (0..side * side).map(|i| Ray::new(Vec3::splat(i as f32), Vec3::X)).collect();
        let rows = |n: usize| -> Vec<usize> {
            let some = sampled_rows(&rays, side, n);
            assert!(some.chunks(side).all(|row| row.windows(2).all(|w| w[1].origin.x == w[0].origin.x + 1.0)));
            some.chunks(side).map(|row| row[0].origin.x as usize / side).collect()
        };
        assert_eq!(rows(1), [5]);
        assert_eq!(rows(2), [2, 7]);
        assert_eq!(rows(3), [1, 5, 8]);
        assert_eq!(rows(10), (0..10).collect::<Vec<_>>());
        assert_eq!(rows(99), rows(10));
    }
}
