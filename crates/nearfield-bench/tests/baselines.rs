//! The approximate searches on the GPU give the rows of their plain references, with the recall that was published for
//! them; libann's program is answered where it can be built.
//!
//! Where rows are compared for equality, coordinates have so few bits that distances and projections are exact in f32,
//! whatever the order of operations.

use std::path::{Path, PathBuf};
use std::process::Command;

use libtest_mimic::Arguments;
use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::Gpu;
use nearfield::{Error, Vec3};
use nearfield_bench::baselines::lsh::reference::Tables;
use nearfield_bench::baselines::lsh::{GpuLsh, HashFamily, LshSettings, PieceWidth};
use nearfield_bench::baselines::shifted_sort::{Asking, GpuShiftedSort, ShiftedSortSettings, reference};
use nearfield_bench::baselines::{KnnRows, Points, Queries, ann, exact, recall};

#[path = "../../nearfield/tests/support/mod.rs"]
mod support;
use support::{Random, count_as_skipped, gpu_trial, own_context, refuse_each, trial};

fn main() {
    let tests = vec![
        gpu_trial("shifted sort gives the rows of its reference", shifted_sort_is_its_reference),
        gpu_trial("shifted sort of any points keeps its distances", shifted_sort_of_any_points),
        gpu_trial("shifted sort has the published recall", shifted_sort_recall),
        trial("the plain shifted sort has the published recall", reference_recall),
        gpu_trial("shifted sort refuses what it cannot do", shifted_sort_errors),
        gpu_trial("hashing gives the answers of its reference", hashing_is_its_reference),
        gpu_trial("hashing looks at the first points of a long bucket", long_buckets),
        gpu_trial("hashing of any points keeps its distances", hashing_of_any_points),
        gpu_trial("recall of hashing rises with the tables", |gpu| hashing_recall(Some(gpu))),
        trial("recall of the plain hashing rises with the tables", || hashing_recall(None)),
        gpu_trial("hashing refuses what it cannot do", hashing_errors),
        gpu_trial("memory that runs out is an error of either search", memory_runs_out),
        trial("libann's program is exact where it can be built", ann_is_exact),
        trial("a program that fails or lies is an error", bad_programs),
    ];
    libtest_mimic::run(&Arguments::from_args(), tests).exit();
}

const SEED: u64 = 11;

/// Points whose coordinates are multiples of 2^-bits in the unit cube; every eighth is a duplicate of the one before.
fn of_few_bits(n: usize, dimension: usize, bits: u32, seed: u64) -> Points {
    let mut random = Random(seed);
    let mut coordinates: Vec<f32> = Vec::with_capacity(n * dimension);
    for i in 0..n {
        for _ in 0..dimension {
            let value = random.below(1 << bits) as f32 / (1u32 << bits) as f32;
            let duplicate = (i % 8 == 7).then(|| coordinates[coordinates.len() - dimension]);
            coordinates.push(duplicate.unwrap_or(value));
        }
    }
    Points::new(dimension, coordinates).expect("points")
}

fn in_space(points: &Points) -> Vec<Vec3> {
    points.coordinates().chunks_exact(3).map(Vec3::from_slice).collect()
}

fn assert_rows(case: &str, found: &KnnRows, expected: &KnnRows) {
    assert_eq!((found.k(), found.len()), (expected.k(), expected.len()), "{case}");
    for i in 0..expected.len() {
        assert_eq!(found.row(i), expected.row(i), "{case}: row {i}");
        assert_eq!(found.row_dist2(i), expected.row_dist2(i), "{case}: row {i}");
    }
}

fn shifted_sort_is_its_reference(gpu: &Gpu) {
    let others = in_space(&of_few_bits(700, 3, 10, SEED + 1));
    let numbers = [(3000, 7, 5, 7), (500, 128, 5, 128), (40, 128, 1, 60), (1, 1, 5, 1), (0, 4, 5, 4)];
    for (n, k, shifts, window) in numbers {
        let points = in_space(&of_few_bits(n, 3, 10, SEED));
        let settings = ShiftedSortSettings::new(k).shifts(shifts).window(window);
        let wide = GpuShiftedSort::<u64>::new(gpu, n, settings).expect("a plan");
        let narrow = GpuShiftedSort::<u32>::new(gpu, n + 10, settings).expect("a plan");
        for asking in
            [Asking::Points { without_self: false }, Asking::Points { without_self: true }, Asking::Other(&others)]
        {
            let what = if let Asking::Other(_) = asking { "others".to_owned() } else { format!("{asking:?}") };
            for (bits, found) in [(63, wide.knn(&points, asking)), (30, narrow.knn(&points, asking))] {
                let case = format!("{n} points, {settings:?}, {what}, {bits} bits");
                let expected = reference::knn(&points, asking, &settings, bits).expect(&case);
                let found = found.expect(&case);
                assert_rows(&case, &found.answer, &expected);
                let times = if gpu.limits().timestamp_period.is_some() { 4 * shifts } else { 0 };
                let extra = if times > 0 && matches!(asking, Asking::Other(_)) { 2 } else { 0 };
                assert_eq!(found.stages.len(), times + extra, "{case}");
            }
        }
    }
}

/// Every row is honest, and each distance is that of the reference's row or a few units in the last place off.
fn assert_alike(case: &str, points: &Points, queries: Queries<'_>, found: &KnnRows, expected: &KnnRows) {
    for i in 0..expected.len() {
        recall::check_row(points, queries, i, found).expect(case);
        assert_eq!(found.row(i).len(), expected.row(i).len(), "{case}: row {i}");
        for (a, b) in found.row_dist2(i).iter().zip(expected.row_dist2(i)) {
            assert!((a - b).abs() <= 1e-5 * b, "{case}: row {i} has {a}, expected {b}");
        }
    }
}

fn shifted_sort_of_any_points(gpu: &Gpu) {
    for kind in [CloudKind::Clustered, CloudKind::Shell, CloudKind::AllEqual, CloudKind::Line] {
        let cloud = cloud(kind, 5000, SEED).points;
        let settings = ShiftedSortSettings::new(10);
        let plan = GpuShiftedSort::<u64>::new(gpu, cloud.len(), settings).expect("a plan");
        let asking = Asking::Points { without_self: true };
        let found = plan.knn(&cloud, asking).expect("rows").answer;
        let expected = reference::knn(&cloud, asking, &settings, 63).expect("rows");
        let points = Points::in_space(&cloud).expect("points");
        assert_alike(&kind.to_string(), &points, Queries::PointsWithoutSelf, &found, &expected);
    }
}

/// Recall at k = 10 of points uniform in the cube, with five shifts and with four; see the module of the search.
fn assert_recall(knn: impl Fn(&[Vec3], &ShiftedSortSettings) -> KnnRows) {
    let cloud = cloud(CloudKind::Uniform, 20_000, SEED).points;
    let points = Points::in_space(&cloud).expect("points");
    let sample = exact::sample(points.len(), 500);
    let nearest = exact::knn(&points, Queries::PointsWithoutSelf, &sample, 10);
    let judge = |shifts| {
        let rows = knn(&cloud, &ShiftedSortSettings::new(10).shifts(shifts));
        recall::of_knn(&points, Queries::PointsWithoutSelf, &sample, &rows, &nearest).expect("honest rows")
    };
    let (five, four, one) = (judge(5), judge(4), judge(1));
    assert!(five.recall > 0.97 && five.exact_rows > 0.8 && five.distance_ratio < 1.01, "{five:?}");
    assert!((0.4..0.65).contains(&four.recall) && four.recall - one.recall < 0.02, "{four:?} {one:?}");
}

fn shifted_sort_recall(gpu: &Gpu) {
    assert_recall(|points, settings| {
        let plan = GpuShiftedSort::<u64>::new(gpu, points.len(), *settings).expect("a plan");
        plan.knn(points, Asking::Points { without_self: true }).expect("rows").answer
    });
}

fn reference_recall() {
    assert_recall(|points, settings| {
        reference::knn(points, Asking::Points { without_self: true }, settings, 63).expect("rows")
    });
}

fn shifted_sort_errors(gpu: &Gpu) {
    let right = ShiftedSortSettings::new(5);
    for settings in [
        ShiftedSortSettings::new(0),
        ShiftedSortSettings::new(129),
        right.shifts(0),
        right.shifts(65),
        right.window(0),
        right.window(129),
    ] {
        let error = GpuShiftedSort::<u64>::new(gpu, 10, settings).expect_err("out of range");
        assert!(matches!(error, Error::InvalidSetting { .. }), "{settings:?}: {error}");
    }
    let plan = GpuShiftedSort::<u64>::new(gpu, 10, right).expect("a plan");
    let ask = |points: &[Vec3]| plan.knn(points, Asking::Points { without_self: false });
    assert!(matches!(ask(&[Vec3::ONE; 11]), Err(Error::TooMany { found: 11, limit: 10, .. })));
    assert!(matches!(ask(&[Vec3::ONE, Vec3::NAN]), Err(Error::NonFinite { first: 1, .. })));
    let bad = [Vec3::splat(f32::INFINITY)];
    assert!(matches!(plan.knn(&[Vec3::ONE], Asking::Other(&bad)), Err(Error::NonFinite { .. })));
}

fn hashing_is_its_reference(gpu: &Gpu) {
    let cases = [
        // n, dimension, k, tables, projections, width, bucket limit
        (3000, 3, 10, 8, 8, 0.4, 4096),
        (2000, 5, 20, 6, 4, 0.8, 15),
        (1000, 16, 128, 10, 6, 3.0, 4096),
        (600, 64, 7, 16, 4, 6.0, 4096),
        (1, 3, 4, 2, 2, 1.0, 10),
        (0, 3, 4, 2, 2, 1.0, 10),
    ];
    for (n, dimension, k, tables, projections, width, limit) in cases {
        let points = of_few_bits(n, dimension, 8, SEED);
        let others = of_few_bits(300, dimension, 8, SEED + 1);
        let settings = LshSettings::for_k(k).tables(tables).projections(projections).bucket_limit(limit);
        let settings = settings.width(PieceWidth::Fixed(width)).seed(n as u64);
        let family = HashFamily::draw(&points, &settings).expect("a family");
        let lsh = GpuLsh::build(gpu, &points, &family).expect("tables");
        let plain = Tables::build(&points, &family).expect("tables");
        // Some candidates are within it, some are not.
        let radius = 0.33 * (dimension as f32).sqrt();
        for queries in [Queries::Points, Queries::PointsWithoutSelf, Queries::Other(&others)] {
            let who = if let Queries::Other(_) = queries { "others".to_owned() } else { format!("{queries:?}") };
            let case = format!("{n} points of dimension {dimension}, {settings:?}, {who}");
            for radius in [None, Some(radius), Some(0.0)] {
                let found = lsh.knn(queries, k, radius).expect(&case).answer;
                assert_rows(&format!("{case}, {radius:?}"), &found, &plain.knn(queries, k, radius).expect(&case));
            }
            let expected = plain.list_within(queries, radius).expect(&case);
            let found = lsh.list_within(queries, radius).expect(&case).answer;
            assert_eq!(lsh.count_within(queries, radius).expect(&case).answer, expected.counts(), "{case}");
            assert_eq!(found.sorted(), expected.clone().sorted(), "{case}");
            let sample = exact::sample(queries.of(&points).len(), 200);
            recall::of_range(&points, queries, &sample, radius, &expected).expect(&case);
            let met: u64 = expected.counts().iter().map(|&c| u64::from(c)).sum();
            assert!(met > 0 || n < 2, "{case}: nothing was met");
        }
    }
}

/// All points in one bucket: more than one dispatch looks at it where loops end early.
fn long_buckets(gpu: &Gpu) {
    let points = Points::new(3, [0.25, 0.5, 0.75].repeat(6000)).expect("points");
    for limit in [2000, 4096] {
        let settings = LshSettings::for_k(64).tables(3).bucket_limit(limit).width(PieceWidth::Fixed(1.0));
        let family = HashFamily::draw(&points, &settings).expect("a family");
        let lsh = GpuLsh::build(gpu, &points, &family).expect("tables");
        let others = Points::new(3, [0.25, 0.5, 0.75].repeat(100)).expect("points");
        let counts = lsh.count_within(Queries::Other(&others), 0.0).expect("counts").answer;
        assert!(counts.iter().all(|&c| c == limit as u32), "{limit}: {:?}", &counts[..3]);
        let rows = lsh.knn(Queries::Other(&others), 64, None).expect("rows").answer;
        assert!((0..100).all(|i| rows.row(i).iter().copied().eq(0..64)), "{limit}: {:?}", rows.row(0));
        let lists = lsh.list_within(Queries::Other(&others), 0.0).expect("lists").answer.sorted();
        assert!((0..100).all(|i| lists.row(i).iter().copied().eq(0..limit as u32)), "{limit}");
    }
}

fn hashing_of_any_points(gpu: &Gpu) {
    for dimension in [3, 33] {
        let points = Points::uniform(4000, dimension, SEED).expect("points");
        let family = HashFamily::draw(&points, &LshSettings::for_k(10)).expect("a family");
        let lsh = GpuLsh::build(gpu, &points, &family).expect("tables");
        let found = lsh.knn(Queries::Points, 10, None).expect("rows").answer;
        let expected = Tables::build(&points, &family).and_then(|t| t.knn(Queries::Points, 10, None)).expect("rows");
        let mut same = 0;
        for i in 0..points.len() {
            recall::check_row(&points, Queries::Points, i, &found).expect("an honest row");
            same += usize::from(found.row(i) == expected.row(i));
        }
        // A projection on the border of a piece may be rounded to either side.
        assert!(same >= points.len() - 20, "{dimension}: {same} of {} rows are those of the reference", points.len());
    }
}

fn hashing_recall(gpu: Option<&Gpu>) {
    for dimension in [3, 12] {
        let points = Points::uniform(4000, dimension, SEED).expect("points");
        let sample = exact::sample(points.len(), 300);
        let nearest = exact::knn(&points, Queries::PointsWithoutSelf, &sample, 10);
        let radius = nearest.row_dist2(0)[9].sqrt();
        let recall_of = |tables| {
            let family = HashFamily::draw(&points, &LshSettings::for_k(10).tables(tables)).expect("a family");
            let queries = Queries::PointsWithoutSelf;
            let (rows, lists) = match gpu {
                Some(gpu) => {
                    let lsh = GpuLsh::build(gpu, &points, &family).expect("tables");
                    let lists = lsh.list_within(queries, radius).expect("lists").answer;
                    (lsh.knn(queries, 10, None).expect("rows").answer, lists)
                }
                None => {
                    let plain = Tables::build(&points, &family).expect("tables");
                    (plain.knn(queries, 10, None).expect("rows"), plain.list_within(queries, radius).expect("lists"))
                }
            };
            let of_rows = recall::of_knn(&points, queries, &sample, &rows, &nearest).expect("honest rows");
            let of_lists = recall::of_range(&points, queries, &sample, radius, &lists).expect("honest lists");
            [of_rows.recall, of_lists.recall]
        };
        let (one, four, sixteen) = (recall_of(1), recall_of(4), recall_of(16));
        // The first tables are the same ones: what they find stays found.
        for i in 0..2 {
            assert!(one[i] < four[i] && four[i] < sixteen[i] && sixteen[i] > 0.8, "{one:?} {four:?} {sixteen:?}");
        }
    }
}

fn hashing_errors(gpu: &Gpu) {
    let points = Points::uniform(50, 4, SEED).expect("points");
    let others = Points::uniform(50, 5, SEED).expect("points");
    let family = HashFamily::draw(&points, &LshSettings::for_k(3)).expect("a family");
    let lsh = GpuLsh::build(gpu, &points, &family).expect("tables");
    let mismatch = |error| matches!(error, Error::LengthMismatch { found: 5, expected: 4, .. });
    assert!(mismatch(GpuLsh::build(gpu, &others, &family).expect_err("another dimension")));
    assert!(mismatch(lsh.knn(Queries::Other(&others), 3, None).expect_err("another dimension")));
    for k in [0, 129] {
        assert!(matches!(lsh.knn(Queries::Points, k, None), Err(Error::InvalidSetting { .. })));
    }
    for radius in [-1.0, f32::NAN, f32::INFINITY, 1e30] {
        assert!(matches!(lsh.count_within(Queries::Points, radius), Err(Error::InvalidRadius { .. })), "{radius}");
    }
}

fn memory_runs_out(gpu: &Gpu) {
    let gpu = own_context(gpu);
    let points = of_few_bits(300, 3, 8, SEED);
    let family = HashFamily::draw(&points, &LshSettings::for_k(3).tables(2)).expect("a family");
    let expected = Tables::build(&points, &family).and_then(|t| t.list_within(Queries::Points, 0.1)).expect("lists");
    let listed = || GpuLsh::build(&gpu, &points, &family)?.list_within(Queries::Points, 0.1);
    refuse_each(&gpu, "hashing", listed, |found| found.answer.clone().sorted() == expected.clone().sorted());
    let cloud = in_space(&points);
    let (asking, settings) = (Asking::Other(&cloud), ShiftedSortSettings::new(3).shifts(2));
    let expected = reference::knn(&cloud, asking, &settings, 63).expect("rows");
    let sorted = || GpuShiftedSort::<u64>::new(&gpu, 300, settings)?.knn(&cloud, asking);
    refuse_each(&gpu, "shifted sort", sorted, |found| found.answer == expected);
}

fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts").join(name)
}

fn ann_is_exact() {
    let program = std::env::temp_dir().join(format!("nearfield-ann-peer-{}", std::process::id()));
    let built = Command::new("sh").arg(script("build_ann_peer.sh")).arg(&program).output();
    let said = match &built {
        Ok(output) => String::from_utf8_lossy(&output.stdout).into_owned(),
        Err(error) => format!("skipped: {error}"),
    };
    if said.starts_with("skipped: ") {
        count_as_skipped("libann's program is exact where it can be built");
        return;
    }
    assert!(said.starts_with("built: "), "{built:?}");
    for dimension in [3, 8] {
        let points = Points::uniform(1000, dimension, SEED).expect("points");
        let sample = exact::sample(1000, 1000);
        let nearest = exact::knn(&points, Queries::Points, &sample, 7);
        let radius = nearest.row_dist2(0)[6].sqrt();
        let ran = ann::run(&program, &points, 7, radius).expect("an answer");
        let quality = recall::of_knn(&points, Queries::Points, &sample, &ran.rows, &nearest).expect("honest rows");
        assert_eq!((quality.recall, quality.exact_rows), (1.0, 1.0));
        let inside = |i: usize| {
            let near = |j: &usize| {
                let axes = points.get(i).iter().zip(points.get(*j));
                let dist2: f64 = axes.map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
                dist2 <= f64::from(radius).powi(2) * (1.0 + 1e-6)
            };
            (0..1000).filter(near).count() as u32
        };
        let wrong = (0..1000).filter(|&i| ran.counts[i].abs_diff(inside(i)) > 1).count();
        assert_eq!(wrong, 0, "counts within the radius");
        assert!(ran.build_ms > 0.0 && ran.knn_ms > 0.0 && ran.count_ms > 0.0);
    }
    let _ = std::fs::remove_file(program);
}

fn bad_programs() {
    let points = Points::uniform(10, 3, SEED).expect("points");
    let error = ann::run(Path::new("/no/such/program"), &points, 3, 0.1).expect_err("no program");
    assert!(error.to_string().contains("/no/such/program"), "{error}");
    for program in ["/bin/false", "/bin/echo"].map(Path::new).iter().filter(|program| program.exists()) {
        ann::run(program, &points, 3, 0.1).expect_err("no answer");
    }
}
