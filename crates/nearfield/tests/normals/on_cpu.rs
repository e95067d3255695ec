//! Estimation on the CPU: errors on exact and noisy surfaces, curvatures, and input that has no normals.

use std::ops::ControlFlow;

use libtest_mimic::Trial;
use nearfield::application::{
    Length, Neighborhood, NormalMethod, NormalSettings, Normals, PointFlags, Watch, estimate_normals,
    estimate_normals_at,
};
use nearfield::{AabbTreeN, AabbTreeNSettings, Error, Scalar};

use crate::support::{Random, trial};
use crate::surfaces::{SEED, Surface, TORUS, angles, median_and_most, sphere, square, torus, tree};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("a_plane_has_its_normal", a_plane_has_its_normal),
        trial("exact_samples_have_small_angles", exact_samples_have_small_angles),
        trial("angles_fall_with_the_square_of_the_spacing", angles_fall_with_the_square_of_the_spacing),
        trial("the_jet_is_better_under_noise", the_jet_is_better_under_noise),
        trial("curvatures_of_a_torus_are_known", curvatures_of_a_torus_are_known),
        trial("points_without_a_surface_are_flagged", points_without_a_surface_are_flagged),
        trial("invalid_queries_are_flagged_and_invalid_points_refused", invalid_is_flagged_or_refused),
        trial("settings_that_cannot_work_are_errors", settings_that_cannot_work_are_errors),
        trial("a_caller_ends_the_estimation", a_caller_ends_the_estimation),
        trial("threads_do_not_change_the_bytes", threads_do_not_change_the_bytes),
    ]
}

fn estimate<T: Scalar>(tree: &AabbTreeN<T, 3>, settings: &NormalSettings) -> Normals<T> {
    estimate_normals(tree, settings, &mut Watch::none()).unwrap()
}

const NEIGHBORHOODS: [Neighborhood; 2] = [Neighborhood::Nearest(24), Neighborhood::Within(Length::Spacings(8.0))];
const METHODS: [NormalMethod; 2] = [NormalMethod::Pca, NormalMethod::Jet];

fn each_setting(mut check: impl FnMut(NormalSettings)) {
    for neighborhood in NEIGHBORHOODS {
        for method in METHODS {
            for weighted in [false, true] {
                check(NormalSettings { neighborhood, method, weighted });
            }
        }
    }
}

fn a_plane_has_its_normal() {
    let plane = square(3000, [0.48, 0.6, -0.64], &mut Random(SEED));
    each_setting(|settings| {
        let (exact, rough) = (estimate(&plane.tree::<f64>(), &settings), estimate(&plane.tree::<f32>(), &settings));
        let [_, most] = median_and_most(&angles(&exact, &plane));
        // Coordinates of 1e-16 over spacings of 0.02 and, at corners, a few neighbours almost in a row.
        assert!(most < 1e-10, "{settings:?}: {most}");
        let [_, most] = median_and_most(&angles(&rough, &plane));
        assert!(most < 0.02, "{settings:?} in f32: {most}");
        // Corners of the square may have five neighbours, too few for a jet.
        let flagged = exact.flags.iter().filter(|flags| !flags.is_empty()).count();
        assert!(flagged <= 4, "{settings:?}: {flagged}");
        assert!(exact.variation.iter().all(|&v| (0.0..1e-12).contains(&v)));
    });
}

/// Median and largest angle in degrees.
fn errors(surface: &Surface, settings: &NormalSettings) -> [f64; 2] {
    median_and_most(&angles(&estimate(&surface.tree::<f64>(), settings), surface))
}

fn exact_samples_have_small_angles() {
    let mut random = Random(SEED);
    for (name, surface) in [("sphere", sphere(20_000, &mut random)), ("torus", torus(20_000, &mut random))] {
        each_setting(|settings| {
            let [median, most] = errors(&surface, &settings);
            println!("{name} {settings:?}: median {median:.4}°, most {most:.3}°");
            // Of PCA the error is that of the uneven lie of 24 to 50 neighbours over a radius of some 0.1; that of the jet is
            // its square.
            let bounds = match settings.method {
                NormalMethod::Pca => [1.2, 10.0],
                NormalMethod::Jet => [0.15, 2.0],
            };
            assert!(median < bounds[0] && most < bounds[1], "{name} {settings:?}: {median}, {most}");
        });
    }
}

fn angles_fall_with_the_square_of_the_spacing() {
    // Four times the points: half the radius. The jet's error is of second order, that of PCA of the first on random points.
    let settings = NormalSettings::default().method(NormalMethod::Jet);
    let medians = [5000, 20_000, 80_000].map(|n| errors(&torus(n, &mut Random(SEED)), &settings)[0]);
    let [first, second] = [medians[0] / medians[1], medians[1] / medians[2]];
    println!("medians {medians:?}, ratios {first}, {second}");
    assert!((3.0..6.0).contains(&first) && (3.0..6.0).contains(&second), "{medians:?}");
}

fn the_jet_is_better_under_noise() {
    // 0.5 % of the diagonal, as wide as the spacing.
    let mut random = Random(SEED);
    let surface = torus(20_000, &mut random).with_noise(0.005 * 4.04, &mut random);
    let pca = |k| errors(&surface, &NormalSettings::default().nearest(k))[0];
    let jet = |k| errors(&surface, &NormalSettings::default().nearest(k).method(NormalMethod::Jet))[0];
    // The best neighbourhood of each: the jet's is larger, and its error smaller.
    let best = |of: &dyn Fn(u32) -> f64| [48, 96, 192, 384].map(of).into_iter().fold(f64::INFINITY, f64::min);
    let (pca, jet) = (best(&pca), best(&jet));
    println!("best medians under noise: PCA {pca:.2}°, jet {jet:.2}°");
    assert!(jet < pca, "jet {jet}, PCA {pca}");
}

fn curvatures_of_a_torus_are_known() {
    let surface = torus(40_000, &mut Random(SEED));
    let settings = NormalSettings::default().method(NormalMethod::Jet);
    let normals = estimate(&surface.tree::<f64>(), &settings);
    let [large, small] = TORUS;
    let mut off: Vec<f64> = Vec::new();
    for (i, point) in surface.points.iter().enumerate() {
        // Outward normals bend away from the surface: −1/r across the tube, −cos/(R + r cos) around the axis.
        let distance = point[0].hypot(point[1]);
        let [across, around] = [-1.0 / small, -(distance - large) / small / distance];
        let outward = crate::surfaces::dot(normals.vectors[i], surface.normals[i]) > 0.0;
        let expected = if outward { [around, across] } else { [-across, -around] };
        let found = normals.curvatures[i];
        assert!(found[0] >= found[1]);
        off.push((found[0] - expected[0]).abs().max((found[1] - expected[1]).abs()) * small);
    }
    off.sort_by(f64::total_cmp);
    println!("curvatures times the tube's radius are off by {:.4} (median)", off[off.len() / 2]);
    assert!(off[off.len() / 2] < 0.02, "{}", off[off.len() / 2]);
}

/// The flags that a set of points gives, in both precisions: a normal has length 1, or is 0 with a flag.
fn flags_of(points: &[[f64; 3]], settings: &NormalSettings) -> Vec<PointFlags> {
    let check = |vectors: Vec<[f64; 3]>, flags: Vec<PointFlags>| {
        assert_eq!((vectors.len(), flags.len()), (points.len(), points.len()));
        let is_unit = |v: &[f64; 3]| (crate::surfaces::dot(*v, *v) - 1.0).abs() < 1e-5;
        assert!(vectors.iter().zip(&flags).all(|(v, f)| is_unit(v) || (*v == [0.0; 3] && !f.is_empty())));
        flags
    };
    let exact = estimate(&tree(points), settings);
    let rough = estimate(&tree(&points.iter().map(|p| p.map(|x| x as f32)).collect::<Vec<_>>()), settings);
    let rough = check(rough.vectors.iter().map(|v| v.map(f64::from)).collect(), rough.flags);
    let exact = check(exact.vectors, exact.flags);
    assert_eq!(exact, rough, "{settings:?}");
    exact
}

fn points_without_a_surface_are_flagged() {
    let line: Vec<[f64; 3]> = (0..50).map(f64::from).map(|t| [1.0 + 0.25 * t, 2.0 - 0.5 * t, 0.125 * t]).collect();
    for neighborhood in [Neighborhood::Nearest(24), Neighborhood::Within(Length::Absolute(3.0))] {
        for method in METHODS {
            let settings = NormalSettings { neighborhood, method, weighted: false };
            let all = |points: &[[f64; 3]], flag| {
                let flags = flags_of(points, &settings);
                assert!(flags.iter().all(|&found| found == flag), "{settings:?}: {flags:?}");
            };
            all(&[], PointFlags::default());
            all(&line[..1], PointFlags::FEW_NEIGHBORS);
            all(&line[..2], PointFlags::FEW_NEIGHBORS);
            all(&[[3.0, 4.0, 5.0]; 100], PointFlags::DEGENERATE);
            all(&line, PointFlags::DEGENERATE);
            // More are asked for than there are: three and five are a plane, but no jet.
            let few = if method == NormalMethod::Jet { PointFlags::FEW_NEIGHBORS } else { PointFlags::default() };
            let five = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, 1.0], [0.5, 0.25, 1.0]];
            all(&five[..3], few);
            all(&five, few);
            let found = estimate(&tree(&five), &settings);
            assert!(found.vectors.iter().all(|v| v[2].abs() > 1.0 - 1e-12), "{:?}", found.vectors);
        }
    }
}

fn invalid_is_flagged_or_refused() {
    let plane = square(500, [0.0, 0.0, 1.0], &mut Random(SEED));
    let queries = [[0.1, 0.2, 0.01], [f64::NAN, 0.0, 0.0], [0.0, f64::INFINITY, 0.0], [9.0, 9.0, 9.0]];
    let settings = NormalSettings::default().within(Length::Absolute(0.5));
    let at = estimate_normals_at(&plane.tree::<f64>(), &queries, &settings, &mut Watch::none()).unwrap();
    let expected = [PointFlags::default(), PointFlags::INVALID, PointFlags::INVALID, PointFlags::FEW_NEIGHBORS];
    assert_eq!(at.flags, expected);
    assert!(at.vectors[0][2].abs() > 1.0 - 1e-12 && at.vectors[1..].iter().all(|v| *v == [0.0; 3]));
    let mut points = plane.points;
    points[7][1] = f64::NAN;
    let refused = AabbTreeN::build(&points, &AabbTreeNSettings::default()).unwrap_err();
    assert!(matches!(refused, Error::NonFinite { count: 1, first: 7, .. }), "{refused}");
}

fn settings_that_cannot_work_are_errors() {
    let plane = square(100, [0.0, 0.0, 1.0], &mut Random(SEED)).tree::<f32>();
    let same_place = tree(&[[1.0f32; 3]; 9]);
    let settings = NormalSettings::default();
    for (tree, settings) in [
        (&plane, settings.nearest(2)),
        (&plane, settings.nearest(5).method(NormalMethod::Jet)),
        (&plane, settings.within(Length::Absolute(0.0))),
        (&plane, settings.within(Length::Absolute(f64::NAN))),
        (&same_place, settings.within(Length::Spacings(3.0))),
        (&same_place, settings.within(Length::Percent(1.0))),
    ] {
        let error = estimate_normals(tree, &settings, &mut Watch::none()).unwrap_err();
        assert!(matches!(error, Error::InvalidSetting { .. }), "{settings:?}: {error}");
    }
}

fn a_caller_ends_the_estimation() {
    let tree = sphere(40_000, &mut Random(SEED)).tree::<f32>();
    let mut tell = |progress: nearfield::application::Progress| {
        if progress.done == 0 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    };
    let ended = estimate_normals(&tree, &NormalSettings::default(), &mut Watch::new(&mut tell)).unwrap_err();
    assert!(matches!(ended, Error::Interrupted { stage: "normals", total: 40_000, .. }), "{ended}");
}

fn threads_do_not_change_the_bytes() {
    let tree = torus(20_000, &mut Random(SEED)).tree::<f32>();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut normals = estimate(&tree, &NormalSettings::default().method(NormalMethod::Jet));
            nearfield::application::orient_by_spanning_tree(&tree, &mut normals, 12, &mut Watch::none()).unwrap();
            normals
        })
    };
    assert_eq!(with(1), with(5));
}
