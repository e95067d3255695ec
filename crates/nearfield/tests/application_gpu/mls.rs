//! Moving least squares on the device against the CPU: the same places up to rounding and the same flags, for every method, weight,
//! support and structure.

use libtest_mimic::Trial;
use nearfield::application::{Length, MlsPoints, MlsReport, PlaneSearch, PointFlags, Support, Watch, Weight};
use nearfield::gpu::Gpu;
use nearfield::structure::{GpuMovingPoints, GpuStructure, RebuildPolicy};
use nearfield::{
    AabbTreeN, AabbTreeNSettings, AabbTreeSettings, Error, GpuAabbTree, GpuBruteForce, GpuLinearOctree,
    GpuMlsProjection, GpuMlsSmoothing, GpuUniformGrid, GridSettings, MlsMethod, MlsProjection, MlsSettings,
    MlsSmoothing, OctreeSettings, TreeSearch, Vec3,
};

use crate::support::{Random, gpu_trial};
use crate::surfaces::torus;

const RADIUS: f32 = 0.3;
const ITERATIONS: usize = 3;

fn methods() -> Vec<(&'static str, MlsMethod)> {
    let pss = |degree, plane| MlsMethod::Pss { degree, plane };
    vec![
        ("apss", MlsMethod::APSS),
        ("half_spheres", MlsMethod::Apss { sphericity: 0.5 }),
        ("planes", pss(0, PlaneSearch::Fast)),
        ("pss_1", pss(1, PlaneSearch::Fast)),
        ("pss_2", MlsMethod::PSS),
        ("oriented_pss_2", MlsMethod::PSS),
        ("pss_3", pss(3, PlaneSearch::Fast)),
        ("full_planes", pss(0, PlaneSearch::Full)),
        ("full_pss_2", pss(2, PlaneSearch::Full)),
        ("rimls", MlsMethod::RIMLS),
        ("bilateral", MlsMethod::BILATERAL),
        ("jet", MlsMethod::Jet),
    ]
}

const WEIGHTS: [Weight; 8] = [
    Weight::Constant,
    Weight::Quadratic,
    Weight::Quartic,
    Weight::Power { inner: 3, outer: 5 },
    Weight::Wendland,
    Weight::Singular,
    Weight::CompactExponential,
    Weight::GAUSSIAN,
];

/// A noisy torus with a few points that cannot be moved: two far away, and some on a line.
struct Cloud {
    points: Vec<Vec3>,
    normals: Vec<Vec3>,
    diagonal: f32,
}

fn cloud() -> Cloud {
    let surface = torus(4000, 0.004);
    let normals = surface.plane_normals(f64::from(RADIUS));
    let vectors = |from: &[[f64; 3]]| from.iter().map(|v| Vec3::from_array(v.map(|x| x as f32))).collect();
    let (mut points, mut normals): (Vec<Vec3>, Vec<Vec3>) = (vectors(&surface.points), vectors(&normals));
    for (i, at) in [(10, Vec3::splat(4.0)), (11, Vec3::splat(4.1))] {
        points.insert(i, at);
        normals.insert(i, Vec3::Z);
    }
    for i in 0..20 {
        points.push(Vec3::new(-4.0 + 0.03 * i as f32, 0.0, 0.0));
        normals.push(Vec3::Y);
    }
    // Without a normal of its own.
    normals[500] = Vec3::ZERO;
    normals[501] = Vec3::new(f32::NAN, 0.0, 1.0);
    Cloud { points, normals, diagonal: surface.diagonal as f32 }
}

/// The normals, where a method needs them or the case is one of oriented points.
fn given<'a>(case: &str, settings: &MlsSettings, cloud: &'a Cloud) -> Option<&'a [Vec3]> {
    (settings.method.needs_normals() || case.starts_with("oriented")).then_some(&cloud.normals)
}

fn arrays(vectors: &[Vec3]) -> Vec<[f32; 3]> {
    vectors.iter().map(Vec3::to_array).collect()
}

fn vectors(arrays: &[[f32; 3]]) -> Vec<Vec3> {
    arrays.iter().map(|&a| Vec3::from_array(a)).collect()
}

/// How many points differ: in place by more than 1e-5 of the diagonal, in direction by more than a hundredth, or in their flags.
fn differ(here: &MlsPoints, there: &MlsPoints, diagonal: f32) -> (usize, usize, usize) {
    let far = |a: &[Vec3], b: &[Vec3], most: f32| {
        assert_eq!(a.len(), b.len());
        a.iter().zip(b).filter(|(a, b)| !(a.distance(**b) <= most)).count()
    };
    let flags = here.flags.iter().zip(&there.flags).filter(|(a, b)| a != b).count();
    let turned = |normals: &[Vec3]| -> Vec<Vec3> {
        // Without given normals signs are arbitrary.
        let sign = |(n, m): (&Vec3, &Vec3)| if n.dot(*m) < 0.0 { -*n } else { *n };
        normals.iter().zip(&here.normals).map(sign).collect()
    };
    let places = far(&here.positions, &there.positions, 1e-5 * diagonal);
    (places, far(&here.normals, &turned(&there.normals), 0.01), flags)
}

/// At most 0.1 % of the points differ.
fn check(case: &str, here: &MlsPoints, there: &MlsPoints, diagonal: f32) {
    let found = differ(here, there, diagonal);
    let most = here.positions.len() / 1000;
    println!("{case}: places, normals and flags that differ: {found:?} of {}", here.positions.len());
    assert!(found.0 <= most && found.1 <= most && found.2 <= most, "{case}: {found:?} differ");
}

/// Sums of both sides are alike.
fn check_reports(case: &str, here: &MlsReport, there: &MlsReport) {
    let close = |a: f64, b: f64| (a - b).abs() <= 1e-3 * a.abs().max(1e-6);
    assert_eq!((here.iteration, here.fitted, here.moving), (there.iteration, there.fitted, there.moving), "{case}");
    assert!(close(here.mean_neighbors, there.mean_neighbors), "{case}: {here:?}, {there:?}");
    assert!(close(here.mean_move, there.mean_move), "{case}: {here:?}, {there:?}");
    assert_eq!(here.volume_change.is_some(), there.volume_change.is_some(), "{case}: {here:?}, {there:?}");
    if let (Some(a), Some(b)) = (here.volume_change, there.volume_change) {
        assert!((a - b).abs() < 1e-5, "{case}: {a}, {b}");
    }
}

fn smoothed_here(
    case: &str,
    cloud: &Cloud,
    support: &Support<'_, f32>,
    settings: &MlsSettings,
) -> (MlsPoints, Vec<MlsReport>) {
    let (points, normals) = (arrays(&cloud.points), given(case, settings, cloud).map(arrays));
    let mut smoothing = MlsSmoothing::new(&points, normals.as_deref(), support, settings).unwrap();
    let reports = (0..ITERATIONS).map(|_| smoothing.iterate().unwrap()).collect();
    let points = MlsPoints {
        positions: vectors(smoothing.positions()),
        normals: vectors(smoothing.normals()),
        mean_curvatures: smoothing.mean_curvatures().map(<[f32]>::to_vec),
        flags: smoothing.flags().to_vec(),
    };
    (points, reports)
}

fn smoothing_agrees(gpu: &Gpu, case: &str, support: &Support<'_, f32>, settings: &MlsSettings) {
    let cloud = cloud();
    let (here, reports) = smoothed_here(case, &cloud, support, settings);
    let normals = given(case, settings, &cloud);
    let mut smoothing = GpuMlsSmoothing::new(gpu, &cloud.points, normals, support, settings).unwrap();
    for expected in &reports {
        check_reports(case, expected, &smoothing.iterate().unwrap());
    }
    let there = smoothing.points().unwrap();
    check(case, &here, &there, cloud.diagonal);
    assert!(PointFlags::totals(&here.flags)[0] >= 2, "{case}: the far points should have few neighbours");
    assert_eq!(here.mean_curvatures.is_some(), there.mean_curvatures.is_some());
    // The tree holds the points that are read.
    assert_eq!(smoothing.particles().positions().unwrap(), there.positions);
}

fn projected_here(cloud: &Cloud, queries: &[Vec3], support: &Support<'_, f32>, settings: &MlsSettings) -> MlsPoints {
    let (points, queries) = (arrays(&cloud.points), arrays(queries));
    let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default()).unwrap();
    let normals = given("", settings, cloud).map(arrays);
    let mut projection = MlsProjection::new(&tree, normals.as_deref(), &queries, support, settings).unwrap();
    projection.run(&mut Watch::none()).unwrap();
    MlsPoints {
        positions: vectors(projection.positions()),
        normals: vectors(projection.normals()),
        mean_curvatures: projection.mean_curvatures().map(<[f32]>::to_vec),
        flags: projection.flags().to_vec(),
    }
}

fn projected_there<S: GpuStructure>(
    structure: &S,
    cloud: &Cloud,
    queries: &[Vec3],
    support: &Support<'_, f32>,
    settings: &MlsSettings,
) -> MlsPoints {
    let normals = given("", settings, cloud);
    let mut projection = GpuMlsProjection::new(structure, normals, queries, support, settings).unwrap();
    projection.run(&mut Watch::none()).unwrap();
    projection.points().unwrap()
}

/// Queries near the surface, one far away, and one that is none.
fn queries(cloud: &Cloud) -> Vec<Vec3> {
    let mut random = Random(5);
    let mut shift = || 0.1 * random.unit() - 0.05;
    let mut queries: Vec<Vec3> =
        cloud.points.iter().step_by(2).map(|p| *p + Vec3::new(shift(), shift(), shift())).collect();
    queries[7] = Vec3::splat(50.0);
    queries[8] = Vec3::new(0.0, f32::NAN, 0.0);
    queries
}

fn projection_agrees_on_every_structure(gpu: &Gpu) {
    let (cloud, support) = (cloud(), Support::Radius(RADIUS));
    let (settings, queries) = (MlsSettings::new(MlsMethod::APSS), queries(&cloud));
    let here = projected_here(&cloud, &queries, &support, &settings);
    assert_eq!(here.flags[7], PointFlags::FEW_NEIGHBORS);
    assert_eq!((here.flags[8], here.positions[7]), (PointFlags::INVALID, queries[7]));
    let there = |made: MlsPoints, name: &str| {
        assert!(made.positions[8].y.is_nan() && made.flags[8] == PointFlags::INVALID);
        let known = |mut points: MlsPoints| {
            points.positions[8] = Vec3::ZERO;
            points
        };
        check(name, &known(here.clone()), &known(made), cloud.diagonal);
    };
    macro_rules! on {
        ($structure:expr, $name:expr) => {
            there(projected_there(&$structure.unwrap(), &cloud, &queries, &support, &settings), $name)
        };
    }
    on!(GpuUniformGrid::build(gpu, &cloud.points, &GridSettings::for_radius(RADIUS)), "grid");
    on!(GpuBruteForce::build(gpu, &cloud.points), "brute force");
    on!(GpuLinearOctree::build(gpu, &cloud.points, &OctreeSettings::default()), "octree");
    for search in TreeSearch::ALL {
        let tree = AabbTreeSettings { search, ..AabbTreeSettings::default() };
        on!(GpuAabbTree::build(gpu, &cloud.points, &tree), search.name());
    }
}

fn every_weight_is_that_of_the_cpu(gpu: &Gpu) {
    for weight in WEIGHTS {
        // Both the weight and its slope matter to the full search.
        let method = MlsMethod::Pss { degree: 2, plane: PlaneSearch::Full };
        let settings = MlsSettings::new(method).weight(weight);
        if weight == Weight::Singular {
            // Its slope has no bound: samples near the foot throw the search about.
            let settings = MlsSettings::new(MlsMethod::PSS).weight(weight);
            smoothing_agrees(gpu, "singular", &Support::Radius(RADIUS), &settings);
            continue;
        }
        smoothing_agrees(gpu, &format!("{weight:?}"), &Support::Radius(RADIUS), &settings);
    }
}

fn every_support_is_that_of_the_cpu(gpu: &Gpu) {
    let n = cloud().points.len();
    let own: Vec<f32> = (0..n).map(|i| 0.18 + 0.1 * (i % 7) as f32 / 6.0).collect();
    for (name, method) in [("apss", MlsMethod::APSS), ("rimls", MlsMethod::RIMLS), ("pss", MlsMethod::PSS)] {
        let settings = MlsSettings::new(method);
        smoothing_agrees(gpu, &format!("{name} of points"), &Support::OfPoints(&own), &settings);
        smoothing_agrees(gpu, &format!("{name} of queries"), &Support::OfQueries(&own), &settings);
    }
    let cloud = cloud();
    for method in [MlsMethod::Jet, MlsMethod::BILATERAL] {
        let (settings, support) = (MlsSettings::new(method), Support::Nearest(24));
        let (here, _) = smoothed_here("", &cloud, &support, &settings);
        let normals = given("", &settings, &cloud);
        let mut smoothing = GpuMlsSmoothing::new(gpu, &cloud.points, normals, &support, &settings).unwrap();
        (0..ITERATIONS).for_each(|_| drop(smoothing.iterate().unwrap()));
        check(&format!("{} of the nearest", method.name()), &here, &smoothing.points().unwrap(), cloud.diagonal);
    }
    let queries: Vec<Vec3> = cloud.points.iter().step_by(3).copied().collect();
    let support = Support::Nearest(30);
    let grid = GpuUniformGrid::build(gpu, &cloud.points, &GridSettings::for_radius(RADIUS)).unwrap();
    // The nearest are found again where a step has led.
    for (method, steps) in [(MlsMethod::BILATERAL, 1), (MlsMethod::Jet, 1), (MlsMethod::Jet, 4)] {
        let settings = MlsSettings { most_steps: steps, ..MlsSettings::new(method) };
        let here = projected_here(&cloud, &queries, &support, &settings);
        let there = projected_there(&grid, &cloud, &queries, &support, &settings);
        check(&format!("projection by the nearest, {steps} steps"), &here, &there, cloud.diagonal);
    }
}

fn points_without_surfaces_are_flagged(gpu: &Gpu) {
    let settings = MlsSettings::new(MlsMethod::PSS);
    let support = Support::Radius(1.0);
    let line: Vec<Vec3> = (0..50).map(|i| Vec3::new(0.01 * i as f32, 0.0, 0.0)).collect();
    for (name, points, flag) in [
        ("line", line, PointFlags::DEGENERATE),
        ("one place", vec![Vec3::ONE; 30], PointFlags::DEGENERATE),
        ("few", vec![Vec3::ZERO, Vec3::X, Vec3::Y], PointFlags::FEW_NEIGHBORS),
    ] {
        let mut smoothing = GpuMlsSmoothing::new(gpu, &points, None, &support, &settings).unwrap();
        let report = smoothing.iterate().unwrap();
        assert_eq!((report.fitted, report.largest_move), (points.len() as u64, 0.0), "{name}");
        let found = smoothing.points().unwrap();
        assert_eq!(found.positions, points, "{name}");
        assert!(found.flags.iter().all(|flags| *flags == flag), "{name}: {:?}", found.flags[0]);
    }
    let mut nothing = GpuMlsSmoothing::new(gpu, &[], None, &support, &settings).unwrap();
    assert_eq!(nothing.iterate().unwrap().fitted, 0);
    assert!(nothing.points().unwrap().positions.is_empty());
}

fn wrong_input_is_an_error(gpu: &Gpu) {
    let (points, normals) = ([Vec3::ZERO, Vec3::X, Vec3::Y], [Vec3::Z; 2]);
    let make = |normals: Option<&[Vec3]>, support: Support<'_, f32>, settings: MlsSettings| {
        GpuMlsSmoothing::new(gpu, &points, normals, &support, &settings).map(drop).unwrap_err()
    };
    let apss = MlsSettings::default();
    let error = make(None, Support::Radius(1.0), apss);
    assert!(matches!(error, Error::InvalidSetting { .. }) && error.to_string().contains("normals"), "{error}");
    assert!(matches!(make(Some(&normals), Support::Radius(1.0), apss), Error::LengthMismatch { .. }));
    assert!(matches!(make(None, Support::Radius(-1.0), apss), Error::InvalidSetting { .. }));
    let grid = GpuUniformGrid::build(gpu, &points, &GridSettings::for_radius(1.0)).unwrap();
    let support = Support::OfQueries(&[1.0]);
    let settings = MlsSettings { accuracy: Length::Absolute(1e-6), ..MlsSettings::new(MlsMethod::PSS) };
    let error = GpuMlsProjection::new(&grid, None, &points, &support, &settings).map(drop).unwrap_err();
    assert!(matches!(error, Error::LengthMismatch { .. }), "{error}");
}

fn trees_of_the_caller_follow(gpu: &Gpu) {
    let (cloud, settings) = (cloud(), MlsSettings::new(MlsMethod::APSS));
    let support = Support::Radius(RADIUS);
    let (here, _) = smoothed_here("", &cloud, &support, &settings);
    for search in TreeSearch::ALL {
        let tree = AabbTreeSettings { search, ..AabbTreeSettings::default() };
        let particles = GpuMovingPoints::new(gpu, &cloud.points, RADIUS, &tree, RebuildPolicy::Always).unwrap();
        let mut smoothing = GpuMlsSmoothing::over(particles, Some(&cloud.normals), &support, &settings).unwrap();
        (0..ITERATIONS).for_each(|_| drop(smoothing.iterate().unwrap()));
        check(&format!("tree, {search:?}"), &here, &smoothing.points().unwrap(), cloud.diagonal);
    }
}

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials: Vec<Trial> = vec![
        gpu_trial("planted_differences_are_seen", |_| {
            let cloud = cloud();
            let (here, _) = smoothed_here("", &cloud, &Support::Radius(RADIUS), &MlsSettings::default());
            assert_eq!(differ(&here, &here, cloud.diagonal), (0, 0, 0));
            let mut other = here.clone();
            other.positions[3].x += 2e-5 * cloud.diagonal;
            other.normals[4] = Vec3::new(other.normals[4].y, -other.normals[4].x, other.normals[4].z);
            other.flags[5] = PointFlags::LIMITED;
            assert_eq!(differ(&here, &other, cloud.diagonal), (1, 1, 1));
        }),
        gpu_trial("projections_on_every_structure_are_those_of_the_cpu", projection_agrees_on_every_structure),
        gpu_trial("every_weight_is_that_of_the_cpu", every_weight_is_that_of_the_cpu),
        gpu_trial("every_support_is_that_of_the_cpu", every_support_is_that_of_the_cpu),
        gpu_trial("points_without_surfaces_are_flagged_on_the_device", points_without_surfaces_are_flagged),
        gpu_trial("wrong_input_is_an_error_on_the_device", wrong_input_is_an_error),
        gpu_trial("trees_of_the_caller_follow_the_points", trees_of_the_caller_follow),
    ];
    for (name, method) in methods() {
        trials.push(gpu_trial(format!("{name}_smooths_on_the_device_as_on_the_cpu"), move |gpu| {
            smoothing_agrees(gpu, name, &Support::Radius(RADIUS), &MlsSettings::new(method));
        }));
        trials.push(gpu_trial(format!("{name}_projects_on_the_device_as_on_the_cpu"), move |gpu| {
            let (cloud, support, settings) = (cloud(), Support::Radius(RADIUS), MlsSettings::new(method));
            let queries: Vec<Vec3> =
                queries(&cloud).into_iter().enumerate().filter(|(i, _)| *i != 8).map(|(_, q)| q).collect();
            let here = projected_here(&cloud, &queries, &support, &settings);
            let grid = GpuUniformGrid::build(gpu, &cloud.points, &GridSettings::for_radius(RADIUS)).unwrap();
            let there = projected_there(&grid, &cloud, &queries, &support, &settings);
            check(name, &here, &there, cloud.diagonal);
        }));
    }
    trials
}
