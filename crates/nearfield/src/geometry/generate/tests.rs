//! The generators against closed forms, and their bytes against recorded ones.

use std::collections::HashMap;
use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::clouds::blobs;
use super::*;
use crate::geometry::distance::dist2;

const SEED: u64 = 7;

/// FNV-1a over the bytes of a sequence of words.
fn fnv(words: impl IntoIterator<Item = u64>) -> u64 {
    words
        .into_iter()
        .flat_map(u64::to_le_bytes)
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3))
}

fn words_of(points: &[Vec3]) -> impl Iterator<Item = u64> {
    points.iter().flat_map(|p| p.to_array()).map(|v| u64::from(v.to_bits()))
}

fn mean_neighbors(points: &[Vec3], queries: &[Vec3], radius: f32) -> f64 {
    let count = |q: &Vec3| points.iter().filter(|&&p| dist2(*q, p) <= radius * radius).count();
    queries.iter().map(count).sum::<usize>() as f64 / queries.len() as f64
}

#[test]
fn names_parse_back() {
    for &kind in CloudKind::ALL {
        assert_eq!(kind.to_string().parse::<CloudKind>().unwrap(), kind);
        assert!(kind.name().parse::<MeshKind>().is_err(), "{kind} names a cloud and a mesh");
    }
    for &kind in MeshKind::ALL {
        assert_eq!(kind.to_string().parse::<MeshKind>().unwrap(), kind);
    }
    let message = "blob".parse::<CloudKind>().unwrap_err().to_string();
    assert!(message.contains("blob") && message.contains("one of uniform shell"), "{message}");
}

#[test]
fn clouds_have_the_recorded_bytes() {
    let recorded: &[(CloudKind, u64)] = &[
        (CloudKind::Uniform, 0x3a03_9b1a_a5b2_5bb4),
        (CloudKind::Shell, 0x142e_6a47_cdf6_1914),
        (CloudKind::Clustered, 0xd144_9782_c65d_be2f),
        (CloudKind::Plummer, 0xb6b4_a774_21fc_e104),
        (CloudKind::Lidar, 0x48d6_f39c_739d_7a91),
        (CloudKind::Torus, 0x38cf_d86f_09e3_887e),
        (CloudKind::Terrain, 0xa55b_a22c_c771_aa65),
        (CloudKind::AllEqual, 0x2a56_02f2_818b_8025),
        (CloudKind::Line, 0x4343_4b81_4230_fa12),
        (CloudKind::Lattice, 0xfac6_c75b_6cfe_6fad),
    ];
    assert_eq!(recorded.iter().map(|r| r.0).collect::<Vec<_>>(), CloudKind::ALL);
    for &(kind, expected) in recorded {
        let cloud = cloud(kind, 5000, SEED);
        assert_eq!(cloud.len(), 5000, "{kind}");
        let found = fnv(words_of(&cloud.points));
        assert_eq!(found, expected, "{kind}: {found:#018x}");
    }
}

#[test]
fn meshes_have_the_recorded_bytes() {
    let recorded: &[(MeshKind, u64)] = &[
        (MeshKind::Icosphere, 0x5974_e2ef_687c_4954),
        (MeshKind::Cube, 0x1db2_4bdd_613d_4a9d),
        (MeshKind::Torus, 0x91c1_40ad_382a_083c),
        (MeshKind::Cornell, 0x5473_e035_34cc_b98b),
        (MeshKind::Soup, 0x077e_aeac_f89b_c2d8),
    ];
    assert_eq!(recorded.iter().map(|r| r.0).collect::<Vec<_>>(), MeshKind::ALL);
    for &(kind, expected) in recorded {
        let mesh = mesh(kind, 2000, SEED);
        let indices = mesh.triangles.iter().flatten().map(|&i| u64::from(i));
        let found = fnv(words_of(&mesh.vertices).chain(indices));
        assert_eq!(found, expected, "{kind}: {found:#018x}");
    }
}

#[test]
fn every_count_is_exact_and_every_cloud_searchable() {
    for &kind in CloudKind::ALL {
        for n in [0, 1, 2, 63, 64, 65, 1000, 30_011] {
            let cloud = cloud(kind, n, SEED);
            assert_eq!(cloud.len(), n, "{kind}");
            assert!(cloud.validate().is_ok(), "{kind} of {n}");
        }
    }
}

#[test]
fn a_smaller_cloud_is_the_start_of_a_larger_one() {
    use CloudKind::{AllEqual, Clustered, Line, Plummer, Shell, Torus, Uniform};
    for kind in [Uniform, Shell, Clustered, Plummer, Torus, AllEqual, Line] {
        assert_eq!(cloud(kind, 777, SEED).points, cloud(kind, 9999, SEED).points[..777], "{kind}");
    }
}

#[test]
fn seeds_give_different_clouds_but_for_the_exact_kinds() {
    for &kind in CloudKind::ALL {
        let exact = matches!(kind, CloudKind::AllEqual | CloudKind::Lattice);
        let same = |a: u64, b: u64| cloud(kind, 100, a).points == cloud(kind, 100, b).points;
        assert_eq!(same(0, 1), exact, "{kind}");
        assert_eq!(same(1, u64::MAX), exact, "{kind}");
    }
}

#[test]
fn uniform_fills_the_cube_with_49_neighbors() {
    let n = 30_000;
    let points = cloud(CloudKind::Uniform, n, SEED).points;
    assert!(points.iter().all(|p| p.min_element() >= 0.0 && p.max_element() < 1.0));
    let mean = points.iter().map(|p| p.as_dvec3()).sum::<DVec3>() / n as f64;
    assert!((mean - 0.5).abs().max_element() < 5.0 * (1.0 / 12.0 / n as f64).sqrt(), "{mean}");
    let radius = radius_for(CloudKind::Uniform, n).unwrap();
    let inner = |p: &&Vec3| p.min_element() > radius && p.max_element() < 1.0 - radius;
    let queries: Vec<Vec3> = points.iter().filter(inner).take(300).copied().collect();
    let mean = mean_neighbors(&points, &queries, radius);
    // Itself and 49 others; five standard errors of a mean of 300 Poisson numbers.
    assert!((mean - 50.0).abs() < 5.0 * (49.0f64 / 300.0).sqrt(), "{mean}");
}

#[test]
fn shell_has_its_noise_and_49_neighbors() {
    let n = 100_000;
    let points = cloud(CloudKind::Shell, n, SEED).points;
    let radii: Vec<f64> = points.iter().map(|p| p.as_dvec3().length()).collect();
    let variance = radii.iter().map(|r| (r - 1.0) * (r - 1.0)).sum::<f64>() / n as f64;
    assert!((variance.sqrt() / 0.001 - 1.0).abs() < 5.0 / (2.0 * n as f64).sqrt(), "{}", variance.sqrt());
    let mean = points.iter().map(|p| p.as_dvec3()).sum::<DVec3>() / n as f64;
    assert!(mean.abs().max_element() < 5.0 * (1.0 / 3.0 / n as f64).sqrt(), "{mean}");
    // A chord of length r cuts the share r²/4 off a unit sphere; the noise is 44 times smaller than r.
    let radius = radius_for(CloudKind::Shell, n).unwrap();
    let expected = 1.0 + n as f64 * f64::from(radius * radius) / 4.0;
    assert!((expected - 50.0).abs() < 1e-3);
    let mean = mean_neighbors(&points, &points[..300], radius);
    assert!((mean - expected).abs() < 5.0 * (49.0f64 / 300.0).sqrt(), "{mean}");
}

#[test]
fn clustered_has_the_pair_density_of_its_blobs() {
    let n = 20_000;
    let points = cloud(CloudKind::Clustered, n, SEED).points;
    let blobs = blobs(SEED);
    assert_eq!(blobs.len(), 100);
    assert!(blobs.iter().all(|b| (10f64.powf(-3.2)..0.1).contains(&b.sigma)));
    // Within one blob, a difference is normal with √2·sigma: its length is below r with the Maxwell distribution.
    // The radius is so small that pairs of different blobs and of the background are few; they only add.
    let radius = 0.002f32;
    let own: f64 = blobs
        .iter()
        .map(|b| {
            let t = f64::from(radius) / (2f64.sqrt() * b.sigma);
            let within = libm::erf(t / 2f64.sqrt()) - (2.0 / PI).sqrt() * t * libm::exp(-t * t / 2.0);
            0.009 * 0.009 * n as f64 * within
        })
        .sum();
    let mean = mean_neighbors(&points, &points[..4000], radius) - 1.0;
    assert!((0.85 * own..1.15 * own).contains(&mean), "{mean} neighbours, {own} expected");
}

#[test]
fn plummer_has_its_mass_profile() {
    let n = 50_000;
    let points = cloud(CloudKind::Plummer, n, SEED).points;
    let radii: Vec<f64> = points.iter().map(|p| p.as_dvec3().length()).collect();
    assert!(radii.iter().all(|&r| r < 10.000_001));
    let mass = |r: f64| (r * r / (1.0 + r * r)).powf(1.5);
    for r in [0.1, 0.5, 1.0, 2.0, 5.0] {
        let expected = mass(r) / mass(10.0);
        let found = radii.iter().filter(|&&x| x <= r).count() as f64 / n as f64;
        let error = (expected * (1.0 - expected) / n as f64).sqrt();
        assert!((found - expected).abs() < 5.0 * error, "radius {r}: {found}, expected {expected}");
    }
}

#[test]
fn torus_cloud_lies_on_the_surface_evenly() {
    let n = 50_000;
    let points = cloud(CloudKind::Torus, n, SEED).points;
    let from_axis = |p: &Vec3| p.as_dvec3().truncate().length();
    for p in &points {
        let tube = (from_axis(p) - 1.0).hypot(f64::from(p.z));
        assert!((tube - 0.4).abs() < 1e-6, "{p}");
    }
    // The outer half has area 2πr(πR + 2r) of 4π²Rr.
    let outer = points.iter().filter(|p| from_axis(p) > 1.0).count() as f64 / n as f64;
    let expected = 0.5 + 0.4 / PI;
    assert!((outer - expected).abs() < 5.0 * (expected * (1.0 - expected) / n as f64).sqrt(), "{outer}");
}

#[test]
fn lidar_points_lie_on_64_rings_above_the_ground() {
    let n = 60_000;
    let points = cloud(CloudKind::Lidar, n, SEED).points;
    let elevations: Vec<f64> = (0..lidar::RINGS).map(lidar::elevation).collect();
    let mut met = vec![0usize; 64];
    for p in &points {
        let q = p.as_dvec3() - DVec3::new(0.0, 0.0, lidar::SENSOR_HEIGHT);
        let angle = (q.z / q.length()).asin();
        let ring = (0..64).min_by(|&a, &b| (elevations[a] - angle).abs().total_cmp(&(elevations[b] - angle).abs()));
        let ring = ring.unwrap();
        assert!((elevations[ring] - angle).abs() < 1e-5, "{p} lies on no ring");
        met[ring] += 1;
        // Noise moves a point along its ray by six standard deviations at most here.
        assert!(q.length() < lidar::RANGE + 6.0 * lidar::NOISE && p.z > -6.0 * lidar::NOISE as f32, "{p}");
    }
    assert!(met.iter().all(|&m| m > 0), "{met:?}");
    // The lowest ring meets nothing but the ground in every column; the last column may be cut short.
    assert!(met[63] + 1 >= *met.iter().max().unwrap(), "{met:?}");
    let houses = points.iter().filter(|p| p.z > 2.0).count();
    let cars = points.iter().filter(|p| p.z > 0.2 && p.z < 1.4 && p.y.abs() < 8.0).count();
    assert!(houses > n / 50 && cars > n / 100, "{houses} on houses, {cars} on cars");
}

#[test]
fn lidar_turns_follow_each_other_along_the_street() {
    let points = cloud(CloudKind::Lidar, 400_000, SEED).points;
    // The nearest ring of a turn at x lies 1.73 / tan(24.8°) = 3.744 ahead of it.
    let ahead = |turn: f32| {
        let on_ring = |p: &&Vec3| p.y.abs() < 1e-3 && (p.x - turn - 3.744).abs() < 0.12 && p.z.abs() < 0.12;
        points.iter().filter(on_ring).count()
    };
    assert!((0..3).all(|turn| ahead(turn as f32) > 0));
    assert_eq!(ahead(20.0), 0);
}

#[test]
fn terrain_is_rough_at_every_scale_and_keeps_its_density() {
    let n = 40_000;
    let cloud = cloud(CloudKind::Terrain, n, SEED);
    assert_eq!(cloud.origin, DVec3::new(637_000.0, 5_403_000.0, 400.0));
    let bounds = cloud.bounds();
    assert!(bounds.min.x >= 0.0 && bounds.max.x <= 100.0 && bounds.min.y >= 0.0 && bounds.max.y <= 100.0);
    let bound = terrain::AMPLITUDE / (1.0 - terrain::GAIN) + 1.0;
    assert!(f64::from(bounds.max.z.max(-bounds.min.z)) < bound);
    // One point in each square of half a metre.
    let mut cells: Vec<_> = cloud.points.iter().map(|p| ((p.x * 2.0) as u32, (p.y * 2.0) as u32)).collect();
    cells.sort_unstable();
    cells.dedup();
    assert!(cells.len() >= n * 99 / 100, "{} squares of {n} have a point", cells.len());
    // Mean squared steps of fractal hills grow with the lag to the power 2·0.8; the smooth waves make it steeper.
    let step2 = |lag: f64| {
        let at = |i: u32| terrain::height(f64::from(i) * 1.37, f64::from(i) * 0.71, SEED);
        let to = |i: u32| terrain::height(f64::from(i) * 1.37 + lag, f64::from(i) * 0.71, SEED);
        (0..20_000).map(|i| (at(i) - to(i)) * (at(i) - to(i))).sum::<f64>() / 20_000.0
    };
    for lag in [2.0, 4.0, 8.0, 16.0, 32.0] {
        let growth = libm::log2(step2(2.0 * lag) / step2(lag));
        assert!((1.2..2.0).contains(&growth), "lag {lag}: power {growth}");
    }
}

#[test]
fn degenerate_kinds_are_exact() {
    assert!(cloud(CloudKind::AllEqual, 100, SEED).points.iter().all(|&p| p == Vec3::new(0.25, 0.5, 0.75)));
    let line = cloud(CloudKind::Line, 1000, SEED);
    assert_eq!((line.bounds().extent().y, line.bounds().extent().z), (0.0, 0.0));
    assert!(line.bounds().extent().x > 0.98 && line.bounds().min.x >= 0.0 && line.bounds().max.x < 1.0);
}

#[test]
fn lattice_has_exact_ties() {
    let points = cloud(CloudKind::Lattice, 11 * 11 * 11, SEED).points;
    let center = points[points.len() / 2];
    assert_eq!(center, Vec3::splat(5.0 / 16.0));
    // Points of the integer lattice within distance 1, √2, 2 and 3 of one of them.
    for (radius2, expected) in [(1.0, 7), (2.0, 19), (4.0, 33), (9.0, 123)] {
        let count = points.iter().filter(|&&p| dist2(center, p) <= radius2 * LATTICE_SPACING * LATTICE_SPACING).count();
        assert_eq!(count, expected, "squared radius {radius2}");
    }
}

/// Asserts that every edge is used once in each direction; returns the number of edges.
fn edges_of_closed(mesh: &TriMesh) -> usize {
    let mut uses: HashMap<(u32, u32), u32> = HashMap::new();
    for t in &mesh.triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            assert_ne!(a, b);
            *uses.entry((a, b)).or_default() += 1;
        }
    }
    for (&(a, b), &count) in &uses {
        assert_eq!((count, uses.get(&(b, a))), (1, Some(&1)), "edge {a} {b}");
    }
    uses.len() / 2
}

fn volume(mesh: &TriMesh) -> f64 {
    let signed = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| mesh.vertices[i as usize].as_dvec3());
        a.dot(b.cross(c)) / 6.0
    };
    mesh.triangles.iter().map(signed).sum()
}

/// Kind, Euler characteristic, area, volume, and the relative deficit allowed at n triangles: flat faces in a curved
/// surface lose a share of the order of the squared edge length, 1/n.
#[test]
fn closed_meshes_are_closed_oriented_and_of_the_right_size() {
    let torus = (4.0 * PI * PI * 0.4, 2.0 * PI * PI * 0.16);
    let cases = [
        (MeshKind::Icosphere, 2, 4.0 * PI, 4.0 / 3.0 * PI, 40.0),
        (MeshKind::Cube, 2, 6.0, 1.0, 0.001),
        (MeshKind::Torus, 0, torus.0, torus.1, 80.0),
    ];
    for (kind, euler, area, full_volume, deficit) in cases {
        for n in [0, 1, 500, 2000, 20_000] {
            let mesh = mesh(kind, n, SEED);
            let count = mesh.triangles.len();
            assert!(n < 500 || (count as f64 / n as f64 - 1.0).abs() < 0.15, "{kind}: {count} triangles for {n}");
            let edges = edges_of_closed(&mesh);
            assert_eq!(mesh.vertices.len() as i64 - edges as i64 + count as i64, euler, "{kind} {n}");
            assert!(TriMesh::new(mesh.vertices.clone(), mesh.triangles.clone()).is_ok());
            if n >= 500 {
                let allowed = deficit / count as f64 + 1e-5;
                let (a, v) = (mesh.area() / area, volume(&mesh) / full_volume);
                assert!(a > 1.0 - allowed && a < 1.0 + 1e-5, "{kind} {n}: area ratio {a}");
                assert!(v > 1.0 - allowed && v < 1.0 + 1e-5, "{kind} {n}: volume ratio {v}");
            }
        }
    }
}

#[test]
fn coarsest_meshes_are_the_solids_themselves() {
    assert_eq!(mesh(MeshKind::Icosphere, 1, SEED).vertices.len(), 12);
    assert_eq!(mesh(MeshKind::Cube, 1, SEED).vertices.len(), 8);
    let sphere = mesh(MeshKind::Icosphere, 5000, SEED);
    assert!(sphere.vertices.iter().all(|v| (v.as_dvec3().length() - 1.0).abs() < 1e-7));
}

#[test]
fn cornell_walls_face_the_room_and_blocks_face_outwards() {
    for n in [1, 32, 128, 5000] {
        let mesh = mesh(MeshKind::Cornell, n, SEED);
        let count = mesh.triangles.len();
        assert_eq!(count % 32, 0);
        assert!(n < 128 || (count as f64 / n as f64 - 1.0).abs() < 0.1, "{count} triangles for {n}");
        assert_eq!(mesh.colors.as_ref().map(Vec::len), Some(mesh.vertices.len()));
        let per_side = count / 16;
        for i in 0..count {
            let t = mesh.triangle(i);
            let normal = t.scaled_normal();
            let inwards = match i / per_side {
                0..6 => Vec3::new(278.0, 274.0, 280.0),
                6..11 => Vec3::new(186.0, 82.0, 169.0),
                _ => Vec3::new(368.0, 165.0, 351.0),
            } - t.centroid();
            assert_eq!(normal.dot(inwards) > 0.0, i / per_side < 6, "triangle {i} of side {}", i / per_side);
        }
    }
}

#[test]
fn soup_has_n_separate_triangles_of_its_width() {
    let n = 1000;
    let mesh = mesh(MeshKind::Soup, n, SEED);
    assert_eq!((mesh.triangles.len(), mesh.vertices.len()), (n, 3 * n));
    assert!(mesh.triangles.iter().flatten().copied().eq(0..3 * n as u32));
    for i in 0..n {
        let extent = mesh.triangle(i).bounds().extent().max_element();
        assert!(extent > 0.0 && extent <= 0.100_001, "{extent}");
    }
    assert!(super::mesh(MeshKind::Soup, 0, SEED).triangles.is_empty());
}

#[test]
fn noise_has_its_deviation_along_every_axis() {
    let mut points = vec![Vec3::new(1.0, -2.0, 3.0); 40_000];
    add_noise(&mut points, 0.25, SEED);
    for axis in 0..3 {
        let offsets = || points.iter().map(|p| f64::from(p[axis]) - [1.0, -2.0, 3.0][axis]);
        let mean = offsets().sum::<f64>() / 40_000.0;
        let variance = offsets().map(|x| x * x).sum::<f64>() / 40_000.0;
        // Five standard errors: 5 σ / √n, and 5 σ² √(2 / n).
        assert!(mean.abs() < 0.0063 && (variance - 0.0625).abs() < 0.0023, "axis {axis}: {mean}, {variance}");
    }
    let mut again = vec![Vec3::new(1.0, -2.0, 3.0); 100];
    add_noise(&mut again, 0.25, SEED);
    assert_eq!(again, points[..100]);
}

#[test]
fn samples_of_a_mesh_lie_on_it_by_area() {
    // The unit cube: a sixth of the points on each side, and normals that point out of it.
    let made = surface_samples(&mesh(MeshKind::Cube, 1200, 1), 60_000, SEED);
    let (points, normals) = (&made.points, made.normals.as_ref().unwrap());
    let mut sides = HashMap::new();
    for (p, n) in points.iter().zip(normals) {
        let axis = (0..3).find(|&axis| n[axis].abs() == 1.0).unwrap();
        assert_eq!(p[axis], if n[axis] > 0.0 { 1.0 } else { 0.0 });
        *sides.entry((axis, n[axis] > 0.0)).or_insert(0u32) += 1;
    }
    // Five deviations of a binomial: 5 √(n · 5 / 36) = 456.
    assert!(sides.len() == 6 && sides.values().all(|&count| count.abs_diff(10_000) < 456), "{sides:?}");
    assert!(surface_samples(&TriMesh::default(), 10, 1).points.is_empty());
}
