//! Distance fields of the device against those of the CPU: the same indices and undefined nodes, the same distances up to
//! rounding.

use libtest_mimic::Trial;
use nearfield::application::{
    DistanceField, DistanceMode, DistanceSettings, GpuMeshDistance, GpuOrientedSamples, MeshDistance, OrientedSamples,
    SignRule, Watch, grid_around,
};
use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::geometry::{RegularGrid, TriMesh};
use nearfield::gpu::Gpu;
use nearfield::{Aabb, DVec3, Error, Vec3};

use crate::support::{Random, gpu_trial};

/// Samples of a torus and their normals.
fn torus(n: usize) -> (Vec<Vec3>, Vec<Vec3>) {
    let mut random = Random(17);
    let (mut points, mut normals) = (vec![], vec![]);
    while points.len() < n {
        let [u, v] = [(); 2].map(|()| 2.0 * std::f32::consts::PI * random.unit());
        let ring = 1.0 + 0.4 * v.cos();
        if 1.4 * random.unit() <= ring {
            points.push(Vec3::new(ring * u.cos(), ring * u.sin(), 0.4 * v.sin()));
            normals.push(Vec3::new(v.cos() * u.cos(), v.cos() * u.sin(), v.sin()));
        }
    }
    (points, normals)
}

fn grid(points: &[Vec3], resolution: u32) -> RegularGrid {
    grid_around(DVec3::ZERO, &Aabb::of_points(points), resolution, 4.0).unwrap()
}

fn arrays(vectors: &[Vec3]) -> Vec<[f32; 3]> {
    vectors.iter().map(|v| v.to_array()).collect()
}

fn both(gpu: &Gpu, n: usize, resolution: u32, settings: &DistanceSettings) -> [DistanceField; 2] {
    let (points, normals) = torus(n);
    let grid = grid(&points, resolution);
    let samples = OrientedSamples::new(&arrays(&points), &arrays(&normals)).unwrap();
    let here = samples.distance_field(&grid, settings, &mut Watch::none()).unwrap();
    let there = GpuOrientedSamples::build(gpu, &points, &normals).unwrap();
    assert!((there.spacing() / samples.spacing() - 1.0).abs() < 0.05, "{} {}", there.spacing(), samples.spacing());
    [here, there.distance_field(&grid, settings).unwrap().read().unwrap()]
}

/// The largest difference in units of the last place; both sides must be undefined at the same nodes.
fn difference_in_ulp(a: &DistanceField, b: &DistanceField) -> i64 {
    let ordered = |x: f32| if x < 0.0 { -i64::from((-x).to_bits()) } else { i64::from(x.to_bits()) };
    let pairs = a.distances.values().iter().zip(b.distances.values());
    let differ = pairs.map(|(&a, &b)| match (a.is_nan(), b.is_nan()) {
        (true, true) => 0,
        (false, false) => (ordered(a) - ordered(b)).abs(),
        _ => i64::MAX,
    });
    differ.max().unwrap()
}

/// A mesh with some of its triangles left out, so that it has holes.
fn with_holes(whole: &TriMesh) -> TriMesh {
    let kept = whole.triangles.iter().copied().enumerate().filter(|(i, _)| i % 11 != 0).map(|(_, t)| t);
    TriMesh::new(whole.vertices.clone(), kept.collect()).unwrap()
}

/// A closed cylinder along z whose triangles are needles.
fn needles(radius: f32, scale: f32) -> TriMesh {
    let n = 24u32;
    let ring = |i: u32, z: f32| {
        let (sin, cos) = (i as f32 / n as f32 * std::f32::consts::TAU).sin_cos();
        scale * Vec3::new(radius * cos, radius * sin, z)
    };
    let mut vertices: Vec<Vec3> = (0..n).flat_map(|i| [ring(i, -0.5), ring(i, 0.5)]).collect();
    vertices.extend([scale * Vec3::new(0.0, 0.0, -0.5), scale * Vec3::new(0.0, 0.0, 0.5)]);
    let triangles = (0..n).flat_map(|i| {
        let [here, next] = [2 * i, 2 * ((i + 1) % n)];
        [[here, next, next + 1], [here, next + 1, here + 1], [2 * n, next, here], [2 * n + 1, here + 1, next + 1]]
    });
    TriMesh::new(vertices, triangles.collect()).unwrap()
}

/// A plate whose triangles have a corner near the middle of their longest edge.
fn caps(height: f32) -> TriMesh {
    let vertices = vec![
        Vec3::ZERO,
        Vec3::X,
        Vec3::new(0.5, height, 0.0),
        Vec3::new(0.5, -height, 0.0),
        Vec3::new(0.5, 0.4, 0.2),
        Vec3::new(0.5, -0.4, 0.2),
    ];
    let triangles = vec![[0, 1, 2], [1, 0, 3], [0, 2, 4], [2, 1, 4], [3, 0, 5], [1, 3, 5]];
    TriMesh::new(vertices, triangles).unwrap()
}

/// Compares the field of a mesh on the device with that of the CPU.
fn compare_mesh(gpu: &Gpu, name: &str, mesh: &TriMesh, settings: &DistanceSettings) {
    let grid = grid_around(DVec3::ZERO, &mesh.bounds(), 41, 4.0).unwrap();
    let surface = MeshDistance::new(mesh).unwrap();
    let here = surface.distance_field(&grid, settings, &mut Watch::none()).unwrap();
    let uploaded = GpuMeshDistance::upload(gpu, &surface).unwrap();
    let there = uploaded.distance_field(&grid, settings).unwrap().read().unwrap();
    let same = uploaded.distances(&grid, settings).unwrap();
    let pairs = there.distances.values().iter().zip(same.values());
    assert!(pairs.into_iter().all(|(a, b)| a.to_bits() == b.to_bits()), "{name}: distances alone are others");
    let (width, mut other_triangles) = (f64::from(grid.spacing()), 0);
    let radius = settings.radius(&grid);
    for (i, (&a, &b)) in here.distances.values().iter().zip(there.distances.values()).enumerate() {
        let [a, b] = [a, b].map(f64::from);
        if a.is_nan() || b.is_nan() {
            let known = if a.is_nan() { b } else { a };
            assert!(
                a.is_nan() == b.is_nan() || (known.abs() - radius).abs() < 1e-5 * width,
                "{name}: node {i}: {a}, {b}"
            );
            continue;
        }
        assert!((a.abs() - b.abs()).abs() < 1e-5 * width, "{name}: node {i}: {a}, {b}");
        assert!((a < 0.0) == (b < 0.0) || a.abs() < 1e-4 * width, "{name}: node {i}: {a}, {b}");
        other_triangles += usize::from(here.nearest[i] != there.nearest[i]);
        // The triangle that is named is that of the distance.
        let named = there.nearest[i] as usize;
        let node = grid.node(i).unwrap();
        let place = DVec3::from([0, 1, 2].map(|axis| grid.coordinate(axis, node[axis])));
        let corners = mesh.triangles[named].map(|v| mesh.vertices[v as usize].as_dvec3() - place);
        let (offset, _) = nearfield::geometry::closest_point::closest_point(corners);
        assert!((offset.length() - a.abs()).abs() < 1e-5 * width, "{name}: node {i} is not that far from {named}");
    }
    println!("{name}: {} nodes, {other_triangles} with another triangle as near", here.n_defined());
    assert!(here.n_defined() > 1000);
}

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials: Vec<Trial> = vec![gpu_trial("a_planted_difference_is_seen", |gpu| {
        let [mut here, there] = both(gpu, 500, 25, &DistanceSettings::default().mode(DistanceMode::Nearest));
        let at = here.distances.values().iter().position(|v| !v.is_nan()).unwrap();
        let changed = f32::from_bits(here.distances.values()[at].to_bits() + 9);
        here.distances.values_mut()[at] = changed;
        assert!(difference_in_ulp(&here, &there) >= 5);
        here.distances.values_mut()[at] = f32::NAN;
        assert_eq!(difference_in_ulp(&here, &there), i64::MAX);
    })];
    for (name, band) in [("narrow", 4.0), ("wide", 20.0), ("endless", f64::INFINITY)] {
        trials.push(gpu_trial(format!("{name}_bands_are_those_of_the_cpu_in_index_and_mask"), move |gpu| {
            let settings = DistanceSettings::default().mode(DistanceMode::Nearest).band(band);
            let [here, there] = both(gpu, 10_000, 57, &settings);
            let differ = here.nearest.iter().zip(&there.nearest).filter(|(a, b)| a != b).count();
            assert_eq!(differ, 0, "indices differ");
            let ulp = difference_in_ulp(&here, &there);
            println!("{name}: {} nodes, {ulp} ulp", here.n_defined());
            assert!(ulp <= 4, "{ulp} ulp");
        }));
    }
    for mode in [DistanceMode::Plane, DistanceMode::Imls, DistanceMode::Apss] {
        trials.push(gpu_trial(format!("{mode}_on_the_device_is_that_of_the_cpu"), move |gpu| {
            let [here, there] = both(gpu, 8000, 41, &DistanceSettings::default().mode(mode));
            assert_eq!(here.nearest, there.nearest);
            let width = here.distances.grid().spacing();
            let pairs = here.distances.values().iter().zip(there.distances.values());
            let far = pairs.filter(|(a, b)| a.is_nan() != b.is_nan() || (*a - *b).abs() > 1e-4 * width).count();
            // Weights of a sample at the border of its neighbourhood may be there and not here.
            assert!(far <= here.n_defined() / 1000, "{far} of {} differ", here.n_defined());
        }));
    }
    // A grid most of which is empty, whose far bricks hang over, and one that is full.
    for (name, corner, nodes, band) in
        [("mostly_empty", [-4.0, -1.5, -3.0], [85, 41, 70], 2.0), ("full", [-1.5, -1.5, -0.5], [31, 33, 17], 1e3)]
    {
        trials.push(gpu_trial(format!("distances_of_a_{name}_grid_come_to_the_host_as_they_are"), move |gpu| {
            let (points, normals) = torus(4000);
            let grid = RegularGrid::new(DVec3::ZERO, Vec3::from(corner), 0.09, nodes).unwrap();
            let samples = GpuOrientedSamples::build(gpu, &points, &normals).unwrap();
            let settings = DistanceSettings::default().band(band);
            let field = samples.distance_field(&grid, &settings).unwrap();
            let expected = gpu.read(field.values()).unwrap();
            let defined = expected.iter().filter(|&&bits| !f32::from_bits(bits).is_nan()).count();
            let is_full = defined == grid.n_nodes();
            assert!(defined > 3000 && is_full == (name == "full"), "{defined} of {}", grid.n_nodes());
            let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<u32>>();
            assert!(bits(field.read_distances().unwrap().values()) == expected, "read");
            assert!(bits(samples.distances(&grid, &settings).unwrap().values()) == expected, "computed and read");
            assert!(bits(field.read().unwrap().distances.values()) == expected, "with what is nearest");
        }));
    }
    trials.push(gpu_trial("the_spacing_is_that_of_the_cpu", |gpu| {
        // The first radii meet more than enough, or far too few.
        for n in [3, 40, 1000, 100_000] {
            let (points, normals) = torus(n);
            let there = GpuOrientedSamples::build(gpu, &points, &normals).unwrap().spacing();
            let here = OrientedSamples::new(&arrays(&points), &arrays(&normals)).unwrap().spacing();
            assert!((there / here - 1.0).abs() < 0.01, "{n}: {there} {here}");
        }
    }));
    trials.push(gpu_trial("signs_by_winding_number_are_those_of_the_cpu", |gpu| {
        let settings = DistanceSettings::default().sign(SignRule::WindingNumber);
        let [here, there] = both(gpu, 6000, 33, &settings);
        let width = here.distances.grid().spacing();
        let pairs = here.distances.values().iter().zip(there.distances.values());
        let wrong = pairs.filter(|(a, b)| a.is_sign_negative() != b.is_sign_negative() && a.abs() > 0.1 * width);
        assert_eq!(wrong.count(), 0);
    }));
    for (name, kind, n) in
        [("torus", MeshKind::Torus, 3000), ("cube", MeshKind::Cube, 12), ("sphere", MeshKind::Icosphere, 1280)]
    {
        trials.push(gpu_trial(format!("{name}_meshes_have_the_field_of_the_cpu"), move |gpu| {
            let made = mesh(kind, n, 0);
            for (rule, band) in
                [(SignRule::Pseudonormal, 4.0), (SignRule::Pseudonormal, f64::INFINITY), (SignRule::WindingNumber, 3.0)]
            {
                let settings = DistanceSettings::default().sign(rule).band(band);
                compare_mesh(gpu, &format!("{name} by {rule} to {band}"), &made, &settings);
            }
            compare_mesh(gpu, &format!("{name} with holes"), &with_holes(&made), &DistanceSettings::default());
        }));
    }
    trials.push(gpu_trial("thin_and_far_too_small_or_large_triangles_have_the_field_of_the_cpu", |gpu| {
        let settings = DistanceSettings::default();
        for radius in [0.02, 1e-3, 1e-4] {
            compare_mesh(gpu, &format!("needles {radius}"), &needles(radius, 1.0), &settings);
        }
        for height in [1e-2, 1e-4] {
            compare_mesh(gpu, &format!("caps {height}"), &caps(height), &settings);
        }
        for scale in [1e-12, 1e12] {
            compare_mesh(gpu, &format!("needles times {scale}"), &needles(0.02, scale), &settings);
        }
    }));
    trials.push(gpu_trial("meshes_that_cannot_be_computed_on_the_device_say_why", |gpu| {
        let made = mesh(MeshKind::Cube, 12, 0);
        let (surface, settings) = (MeshDistance::new(&made).unwrap(), DistanceSettings::default());
        let there = GpuMeshDistance::upload(gpu, &surface).unwrap();
        let away = RegularGrid::new(DVec3::ZERO, Vec3::splat(50.0), 0.1, [9; 3]).unwrap();
        let error = there.distance_field(&away, &settings).unwrap_err().to_string();
        assert!(error.contains("none of 12 triangles"), "{error}");
        assert!(there.distance_field(&away, &settings.sign(SignRule::Normal)).is_err());
        let flat = TriMesh::new(vec![Vec3::ZERO, Vec3::X], vec![[0, 1, 1]]).unwrap();
        let flat = MeshDistance::new(&flat).unwrap();
        let there = GpuMeshDistance::upload(gpu, &flat).unwrap();
        let error = there.distance_field(&away, &settings).unwrap_err().to_string();
        assert!(error.contains("none of 1 triangles"), "{error}");
    }));
    trials.push(gpu_trial("what_cannot_be_computed_on_the_device_says_why", |gpu| {
        let (points, normals) = torus(200);
        let samples = GpuOrientedSamples::build(gpu, &points, &normals).unwrap();
        let settings = DistanceSettings::default();
        let away = RegularGrid::new(DVec3::ZERO, Vec3::splat(50.0), 0.1, [9; 3]).unwrap();
        let error = samples.distance_field(&away, &settings).unwrap_err().to_string();
        assert!(error.contains("none of 200 samples"), "{error}");
        let error = samples.distance_field(&grid(&points, 33), &settings.max_bytes(9)).unwrap_err();
        assert!(matches!(error, Error::OutOfMemory { .. }), "{error}");
        let error = samples.distances(&grid(&points, 33), &settings.max_bytes(9)).unwrap_err();
        assert!(matches!(error, Error::OutOfMemory { .. }), "{error}");
        assert!(samples.distances(&away, &settings).unwrap_err().to_string().contains("none of 200 samples"));
        assert!(samples.distance_field(&grid(&points, 33), &settings.sign(SignRule::Pseudonormal)).is_err());
        assert!(matches!(GpuOrientedSamples::build(gpu, &points, &[]), Err(Error::NoNormals { .. })));
        let none = GpuOrientedSamples::build(gpu, &[], &[]).unwrap();
        assert!(none.is_empty() && none.distance_field(&grid(&points, 33), &settings).is_err());
    }));
    trials
}
