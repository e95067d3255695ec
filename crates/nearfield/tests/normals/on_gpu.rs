//! The device against the CPU: the same flags, and the same normals up to rounding and side.

use libtest_mimic::Trial;
use nearfield::application::{
    Length, Neighborhood, NormalMethod, NormalSettings, Normals, PointFlags, Watch, estimate_normals,
    estimate_normals_at, estimate_normals_on_gpu, normals::GpuNormals,
};
use nearfield::gpu::Gpu;
use nearfield::{AabbTreeSettings, DeviceQueries, Error, GpuAabbTree, GpuBruteForce, Queries, Vec3};

use crate::support::{Random, gpu_trial, trial};
use crate::surfaces::{SEED, scan, square, torus, tree};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("planted_differences_of_normals_are_seen", planted_differences_are_seen),
        gpu_trial("normals_of_the_device_are_those_of_the_cpu", device_is_cpu),
        gpu_trial("normals_at_other_places_are_those_of_the_cpu", other_places_are_those_of_the_cpu),
        gpu_trial("points_without_a_surface_are_flagged_on_the_device", flags_of_the_device),
        gpu_trial("normals_in_batches_are_the_same", batches_are_the_same),
        gpu_trial("wrong_input_is_refused_on_the_device", wrong_input_is_refused),
    ]
}

fn vectors(points: &[[f64; 3]]) -> Vec<Vec3> {
    points.iter().map(|p| Vec3::from_array(p.map(|x| x as f32))).collect()
}

/// Largest angle in radians that all but one in a thousand stay below, and how many flags differ.
fn difference(a: &Normals<f32>, b: &Normals<f32>) -> (f32, usize) {
    assert_eq!(a.len(), b.len());
    let chord = |(a, b): (&[f32; 3], &[f32; 3])| {
        let (a, b) = (Vec3::from_array(*a), Vec3::from_array(*b));
        (a - b).length().min((a + b).length())
    };
    let mut chords: Vec<f32> = a.vectors.iter().zip(&b.vectors).map(chord).collect();
    chords.sort_by(f32::total_cmp);
    let flags = a.flags.iter().zip(&b.flags).filter(|(a, b)| a != b).count();
    (chords.get(a.len().saturating_sub(1 + a.len() / 1000)).copied().unwrap_or(0.0), flags)
}

fn planted_differences_are_seen() {
    let mut a = Normals::of_vectors(&vec![[0.0f32, 0.0, 1.0]; 1000]);
    let b = a.clone();
    assert_eq!(difference(&a, &b), (0.0, 0));
    a.vectors[3] = [0.0, 0.0, -1.0];
    a.vectors[5] = [0.0, 1.0, 0.0];
    assert_eq!(difference(&a, &b).0, 0.0);
    a.vectors[7] = [0.0, 0.6, 0.8];
    a.flags[9] = PointFlags::DEGENERATE;
    assert!(difference(&a, &b).0 > 0.6 && difference(&a, &b).1 == 1);
}

fn device_is_cpu(gpu: &Gpu) {
    let mut random = Random(SEED);
    let mut clouds = vec![
        ("torus", torus(6000, &mut random).with_noise(0.004, &mut random)),
        ("far plane", square(3000, [0.48, 0.6, -0.64], &mut random).moved([100.0, -200.0, 50.0])),
    ];
    clouds.extend(scan("stanford-bunny.obj", 6000, &mut random).map(|surface| ("bunny", surface)));
    for (name, surface) in &clouds {
        let points = vectors(&surface.points);
        let on_cpu = tree(&points.iter().map(|p| p.to_array()).collect::<Vec<_>>());
        for neighborhood in
            [Neighborhood::Nearest(24), Neighborhood::Nearest(41), Neighborhood::Within(Length::Spacings(6.0))]
        {
            for (method, weighted) in [
                (NormalMethod::Pca, false),
                (NormalMethod::Pca, true),
                (NormalMethod::Jet, false),
                (NormalMethod::Jet, true),
            ] {
                let settings = NormalSettings { neighborhood, method, weighted };
                let here = estimate_normals(&on_cpu, &settings, &mut Watch::none()).unwrap();
                let there = estimate_normals_on_gpu(gpu, &points, &settings).unwrap();
                let (angle, flags) = difference(&here, &there);
                let variation = here.variation.iter().zip(&there.variation).map(|(a, b)| (a - b).abs());
                let variation = variation.fold(0.0, f32::max);
                println!("{name} {settings:?}: angle {angle:.2e}, flags {flags}, variation {variation:.2e}");
                // A direction is as uncertain as a few ulp over the gap of variances; 1e-3 is 0.06°.
                assert!(angle < 1e-3 && flags == 0 && variation < 1e-4, "{name} {settings:?}: {angle}, {flags}");
                curvatures_agree(&here, &there);
            }
        }
    }
}

/// Up to the side of the normal, within a hundredth of the larger for all but one in a hundred.
fn curvatures_agree(here: &Normals<f32>, there: &Normals<f32>) {
    assert_eq!(here.curvatures.len(), there.curvatures.len());
    let most = |c: [f32; 2]| c[0].abs().max(c[1].abs());
    let mut sizes: Vec<f32> = here.curvatures.iter().map(|&c| most(c)).collect();
    sizes.sort_by(f32::total_cmp);
    let typical = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
    let far = |(a, b): (&[f32; 2], &[f32; 2])| {
        let off = |b: [f32; 2]| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
        off(*b).min(off([-b[1], -b[0]])) > 0.01 * (most(*a) + typical)
    };
    let different = here.curvatures.iter().zip(&there.curvatures).filter(|pair| far(*pair)).count();
    assert!(different * 100 <= here.curvatures.len() || typical < 0.1, "{different} curvatures differ");
}

fn other_places_are_those_of_the_cpu(gpu: &Gpu) {
    let mut random = Random(SEED);
    let points = vectors(&torus(4000, &mut random).points);
    let queries = vectors(&torus(999, &mut random).with_noise(0.01, &mut random).points);
    let on_cpu = tree(&points.iter().map(|p| p.to_array()).collect::<Vec<_>>());
    let places: Vec<[f32; 3]> = queries.iter().map(|q| q.to_array()).collect();
    let settings = NormalSettings::default().method(NormalMethod::Jet);
    let boxes = GpuAabbTree::build(gpu, &points, &AabbTreeSettings::DEFAULT).unwrap();
    let here = estimate_normals_at(&on_cpu, &places, &settings.nearest(20), &mut Watch::none()).unwrap();
    let (there, report) = GpuNormals::nearest(&boxes, Queries::Other(&queries), 20, &settings).unwrap();
    let there = there.read(gpu).unwrap();
    assert!(difference(&here, &there).0 < 1e-3 && difference(&here, &there).1 == 0);
    assert!(report.kernels.iter().any(|kernel| kernel.contains("visit_nearest")), "{report:?}");
    let here =
        estimate_normals_at(&on_cpu, &places, &settings.within(Length::Absolute(0.2)), &mut Watch::none()).unwrap();
    let packed: Vec<[f32; 4]> = (0u32..).zip(&queries).map(|(i, q)| [q.x, q.y, q.z, f32::from_bits(i)]).collect();
    let on_device = gpu.upload("queries", &packed).unwrap();
    let asked = DeviceQueries::new(&on_device, 0.2);
    let there = GpuNormals::within(&boxes, &asked, &settings).unwrap().read(gpu).unwrap();
    assert!(difference(&here, &there).0 < 1e-3 && difference(&here, &there).1 == 0);
    let brute_force = GpuBruteForce::build(gpu, &points).unwrap();
    let there = GpuNormals::within(&brute_force, &asked, &settings).unwrap().read(gpu).unwrap();
    assert!(difference(&here, &there).0 < 1e-3 && difference(&here, &there).1 == 0);
}

fn flags_of_the_device(gpu: &Gpu) {
    let line: Vec<Vec3> =
        (0..50u8).map(f32::from).map(|t| Vec3::new(1.0 + 0.25 * t, 2.0 - 0.5 * t, 0.125 * t)).collect();
    for neighborhood in [Neighborhood::Nearest(24), Neighborhood::Within(Length::Absolute(3.0))] {
        for method in [NormalMethod::Pca, NormalMethod::Jet] {
            for weighted in [false, true] {
                let settings = NormalSettings { neighborhood, method, weighted };
                let five =
                    [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.25]].map(|[x, y]| Vec3::new(x, y, 1.0));
                for points in [&[][..], &line[..1], &line[..2], &[Vec3::ONE; 100], &line, &five[..3], &five] {
                    let cpu = tree(&points.iter().map(|p| p.to_array()).collect::<Vec<_>>());
                    let here = estimate_normals(&cpu, &settings, &mut Watch::none()).unwrap();
                    let there = estimate_normals_on_gpu(gpu, points, &settings).unwrap();
                    assert_eq!(here.flags, there.flags, "{settings:?}, {} points", points.len());
                    assert!(difference(&here, &there).0 < 1e-3, "{settings:?}, {} points", points.len());
                }
            }
        }
    }
}

fn batches_are_the_same(gpu: &Gpu) {
    let own = crate::support::own_context(gpu);
    let points = vectors(&torus(5000, &mut Random(SEED)).points);
    let settings = NormalSettings::default();
    let all = estimate_normals_on_gpu(&own, &points, &settings).unwrap();
    let tree = GpuAabbTree::build(&own, &points, &AabbTreeSettings::DEFAULT).unwrap();
    // Room for the answer, the points once more and a part of the rows.
    own.set_memory_limit(own.memory_used() + 600_000);
    let (parts, report) = GpuNormals::nearest(&tree, Queries::Points, 24, &settings).unwrap();
    assert!(report.batches > 1, "{} batches", report.batches);
    own.set_memory_limit(u64::MAX);
    assert_eq!(parts.read(&own).unwrap(), all);
}

fn wrong_input_is_refused(gpu: &Gpu) {
    let settings = NormalSettings::default();
    let invalid = estimate_normals_on_gpu(gpu, &[Vec3::ZERO, Vec3::NAN], &settings).unwrap_err();
    assert!(matches!(invalid, Error::NonFinite { count: 1, first: 1, .. }), "{invalid}");
    let few = estimate_normals_on_gpu(gpu, &[Vec3::ZERO; 9], &settings.nearest(2)).unwrap_err();
    assert!(matches!(few, Error::InvalidSetting { .. }), "{few}");
    let no_size = settings.within(Length::Percent(1.0));
    let no_size = estimate_normals_on_gpu(gpu, &[Vec3::ONE; 9], &no_size).unwrap_err();
    assert!(matches!(no_size, Error::InvalidSetting { .. }), "{no_size}");
}
