//! Refit and both searches of the device against brute force, up to the rounding of a distance that a device may fuse.

use nearfield::gpu::Gpu;
use nearfield::query::Clock;
use nearfield::{
    AabbTreeN, AabbTreeNSettings, Error, FixedRadiusN, GpuAabbTreeN, NeighborsN, QueriesN, RadiusN, RowOrder,
    TreeSearch,
};

use crate::cases::{Case, SEED, cases, radius_for};
use crate::support::{Random, own_context, refuse_each};

const SEARCHES: [TreeSearch; 2] = [TreeSearch::Primary, TreeSearch::Coherent];

/// Rounding of an f32, relative.
const UNIT: f64 = 1.0 / (1u64 << 24) as f64;
/// What squares of 16 axes may be off by where a device flushes small ones to zero.
const FLUSHED: f64 = 16.0 * 1.18e-38;

fn settings(search: TreeSearch) -> AabbTreeNSettings {
    AabbTreeNSettings::default().bucket_size(7).search(search)
}

fn exact_dist2<const D: usize>(a: &[f32; D], b: &[f32; D]) -> f64 {
    (0..D).map(|axis| (f64::from(a[axis]) - f64::from(b[axis])).powi(2)).sum()
}

/// The first difference between a list and the truth that rounding cannot explain. A squared distance has D + 2 roundings,
/// its limit one.
fn difference<const D: usize>(
    points: &[[f32; D]],
    question: &FixedRadiusN<'_, f32, D>,
    list: &NeighborsN<f32>,
) -> Option<String> {
    let queries = match question.queries {
        QueriesN::Points => points,
        QueriesN::Other(queries) => queries,
    };
    if list.len() != queries.len() || *list.offsets().last().unwrap() != list.indices().len() as u64 {
        return Some(format!("{} rows for {} queries", list.len(), queries.len()));
    }
    for (i, query) in queries.iter().enumerate() {
        let radius = match question.radius {
            RadiusN::One(radius) => f64::from(radius),
            RadiusN::Each(radii) => f64::from(radii[i]),
        };
        let mut found = vec![None; points.len()];
        for (&index, &dist2) in list.row(i).iter().zip(list.row_dist2(i)) {
            if found[index as usize].replace(f64::from(dist2)).is_some() {
                return Some(format!("query {i}: {index} stands twice"));
            }
        }
        for (index, point) in points.iter().enumerate() {
            let dist2 = exact_dist2(query, point);
            let is_own = question.exclude_self && index == i;
            let is_near = dist2 <= radius * radius && !is_own;
            let unsure = (dist2 - radius * radius).abs() <= (D + 3) as f64 * UNIT * radius * radius * 1.01 + FLUSHED;
            if found[index].is_some() != is_near && (is_own || !unsure) {
                return Some(format!("query {i}: point {index} at {dist2:e} of {:e}: {is_near}", radius * radius));
            }
            let off = found[index].map_or(0.0, |found| (found - dist2).abs());
            if off > (D + 2) as f64 * UNIT * dist2 * 1.01 + FLUSHED {
                return Some(format!("query {i}: point {index} at {dist2:e}, off by {off:e}"));
            }
        }
    }
    None
}

/// Checks count and list of both searches for one question.
fn check<const D: usize>(
    name: &str,
    tree: &mut GpuAabbTreeN,
    points: &[[f32; D]],
    question: &FixedRadiusN<'_, f32, D>,
) {
    for search in SEARCHES {
        tree.set_search(search).unwrap();
        let list = tree.list(question).unwrap();
        assert_eq!(difference(points, question, &list), None, "{name}, {search:?}");
        let lengths: Vec<u32> = list.offsets().windows(2).map(|ends| (ends[1] - ends[0]) as u32).collect();
        let counts = tree.count(question).unwrap();
        assert_eq!(counts.as_slice(), lengths, "{name}, {search:?}");
        assert_eq!(counts.work, list.work, "{name}, {search:?}");
        let again = tree.list(question).unwrap();
        assert!((again.indices(), again.dist2()) == (list.indices(), list.dist2()), "{name}, {search:?}");
        let keeps = search == TreeSearch::Coherent && list.work.traversals > 0;
        assert_eq!(list.work.candidates > 0, keeps, "{name}, {search:?}: {:?}", list.work);
    }
}

pub(crate) fn answers_are_those_of_brute_force<const D: usize>(gpu: &Gpu) {
    for Case { name, points, queries, radius } in cases::<f32, D>(240) {
        // With buckets of one point some leaves are empty.
        for bucket in [1, 7] {
            let settings = settings(TreeSearch::Primary).bucket_size(bucket);
            let mut tree = GpuAabbTreeN::build(gpu, &points, &settings).unwrap();
            let plain = FixedRadiusN::new(radius);
            check(name, &mut tree, &points, &plain);
            check(name, &mut tree, &points, &plain.exclude_self().order(RowOrder::Distance));
            check(name, &mut tree, &points, &plain.queries(&queries));
            let radii = |n: usize| (0..n).map(|i| radius * 10f32.powi((i % 4) as i32 - 3)).collect::<Vec<f32>>();
            check(name, &mut tree, &points, &FixedRadiusN::each(&radii(points.len())).exclude_self());
            check(name, &mut tree, &points, &FixedRadiusN::each(&radii(queries.len())).queries(&queries));
        }
    }
}

/// More queries at one leaf than a pack has, and some thousand points.
pub(crate) fn heavy_packs_are_split(gpu: &Gpu) {
    let mut random = Random(SEED);
    let points: Vec<[f32; 4]> = (0..3000).map(|_| std::array::from_fn(|_| random.unit())).collect();
    let queries: Vec<[f32; 4]> = (0..700).map(|_| points[5].map(|x| x + 0.001 * random.unit())).collect();
    let mut tree = GpuAabbTreeN::build(gpu, &points, &settings(TreeSearch::Coherent)).unwrap();
    let question = FixedRadiusN::new(radius_for(&points, 20));
    check("own", &mut tree, &points, &question);
    check("heavy", &mut tree, &points, &question.queries(&queries));
    let work = tree.count(&question.queries(&queries)).unwrap().work;
    assert!((3..30).contains(&work.traversals), "{work:?}");
}

pub(crate) fn refit_gives_the_boxes_of_the_cpu<const D: usize>(gpu: &Gpu) {
    let mut random = Random(SEED);
    for (n, bucket) in [(0, 7), (1, 7), (6, 7), (7, 7), (8, 7), (1500, 7), (11, 1), (600, 2)] {
        let mut points: Vec<[f32; D]> = (0..n).map(|_| std::array::from_fn(|_| random.unit())).collect();
        let mut on_cpu = AabbTreeN::build(&points, &settings(TreeSearch::Coherent).bucket_size(bucket)).unwrap();
        let mut on_gpu = GpuAabbTreeN::upload(gpu, &on_cpu).unwrap();
        for step in 0..4 {
            let read = on_gpu.read::<D>().unwrap();
            assert_eq!(read.broken_invariant(), None, "{n} points, step {step}");
            assert!(read.boxes() == on_cpu.boxes() && read.shape() == on_cpu.shape(), "{n} points, step {step}");
            for point in &mut points {
                *point = point.map(|x| x + 10f32.powi(step - 2) * (random.unit() - 0.5));
            }
            on_cpu.refit(&points).unwrap();
            let stages = on_gpu.refit(&points).unwrap();
            let timed = gpu.limits().timestamp_period.is_some();
            assert_eq!(stages.iter().filter(|stage| stage.on_device).count(), if timed { 2 } else { 0 });
            if n > 0 {
                check("moved", &mut on_gpu, &points, &FixedRadiusN::new(radius_for(&points, 9)));
            }
        }
        let before = on_gpu.read::<D>().unwrap();
        if n > 0 {
            points[n / 2][D - 1] = f32::NAN;
            assert!(matches!(on_gpu.refit(&points), Err(Error::NonFinite { count: 1, .. })));
            assert!(matches!(on_gpu.refit(&points[1..]), Err(Error::LengthMismatch { .. })));
        }
        assert!(before.boxes() == on_gpu.read::<D>().unwrap().boxes());
    }
}

pub(crate) fn searches_do_different_work(gpu: &Gpu) {
    let points = cases::<f32, 5>(2000).swap_remove(5).points;
    let question = FixedRadiusN::new(radius_for(&points, 20));
    let mut on_cpu = AabbTreeN::build(&points, &settings(TreeSearch::Coherent)).unwrap();
    let mut tree = GpuAabbTreeN::upload(gpu, &on_cpu).unwrap();
    let coherent = tree.list(&question).unwrap();
    tree.set_search(TreeSearch::Primary).unwrap();
    let primary = tree.list(&question).unwrap();
    assert_eq!((primary.work.traversals, coherent.work.traversals), (2000, 512));
    assert!(coherent.work.candidates > 0 && coherent.work.nodes < primary.work.nodes);
    // Boxes are met by the same slack on both sides; few lie within its rounding.
    let near = |a: u64, b: u64| a.abs_diff(b) <= a / 1000;
    for (search, found) in [(TreeSearch::Coherent, coherent.work), (TreeSearch::Primary, primary.work)] {
        on_cpu.set_search(search);
        let expected = on_cpu.list(&question).unwrap().work;
        assert!(near(found.candidates, expected.candidates) && near(found.tests, expected.tests), "{expected:?}");
    }
    if gpu.limits().timestamp_period.is_some() {
        let expected = ["traverse", "scan candidates", "write candidates", "count", "scan", "fill"];
        let stages = coherent.report.stages.iter().filter(|stage| stage.clock == Clock::Device);
        assert!(stages.map(|stage| stage.name).eq(expected), "{:?}", coherent.report.stages);
    }
}

pub(crate) fn short_memory_gives_the_same_in_parts(gpu: &Gpu) {
    let points = cases::<f32, 6>(600).swap_remove(5).points;
    let question = FixedRadiusN::<f32, 6>::new(radius_for(&points, 60));
    let own = own_context(gpu);
    for search in SEARCHES {
        let tree = GpuAabbTreeN::build(&own, &points, &settings(search)).unwrap();
        own.set_memory_limit(u64::MAX);
        let expected = tree.list(&question.order(RowOrder::Index)).unwrap();
        own.set_memory_limit(own.memory_used() + 4 * expected.indices().len() as u64);
        let found = tree.list(&question.order(RowOrder::Index)).unwrap();
        assert!(found.report.batches > 1, "{search:?}");
        assert!((found.offsets(), found.indices()) == (expected.offsets(), expected.indices()), "{search:?}");
        assert_eq!(found.work, expected.work, "{search:?}");
        own.set_memory_limit(u64::MAX);
        let right = |list: &NeighborsN<f32>| list.indices() == expected.indices();
        let few = FixedRadiusN::<f32, 6>::new(1e-3);
        let lists = |list: &NeighborsN<f32>| list.indices().len() == points.len();
        assert!(refuse_each(&own, "list", || tree.list(&few), lists) > 4);
        assert!(right(&tree.list(&question.order(RowOrder::Index)).unwrap()));
        drop(tree);
    }
}

pub(crate) fn bad_input_is_an_error_with_numbers(gpu: &Gpu) {
    let points = cases::<f32, 3>(60).swap_remove(5).points;
    let packed = GpuAabbTreeN::build(gpu, &points, &AabbTreeNSettings::default());
    assert!(matches!(packed, Err(Error::Unsupported { .. })));
    let mut tree = GpuAabbTreeN::build(gpu, &points, &settings(TreeSearch::Coherent)).unwrap();
    assert!(matches!(tree.set_search(TreeSearch::Packed), Err(Error::Unsupported { .. })));
    let other = FixedRadiusN::<f32, 4>::new(1.0);
    assert!(matches!(tree.count(&other), Err(Error::InvalidSetting { setting: "dimension", .. })));
    assert!(matches!(tree.refit(&[[0.0; 2]; 60]), Err(Error::InvalidSetting { setting: "dimension", .. })));
    assert!(tree.read::<5>().is_err() && tree.list(&FixedRadiusN::<f32, 3>::new(-1.0)).is_err());
    let large = FixedRadiusN::<f32, 3>::new(100.0).max_bytes(9000);
    let error = tree.list(&large).unwrap_err();
    assert!(matches!(error, Error::OutOfMemory { needed: 29_288, available: 9000, .. }), "{error}");
    if let Some(limit) = gpu.limits().loop_rounds {
        let many: Vec<[f32; 2]> = (0..limit).map(|i| [i as f32, 0.0]).collect();
        let refused = GpuAabbTreeN::build(gpu, &many, &settings(TreeSearch::Primary));
        assert!(matches!(refused, Err(Error::Unsupported { .. })));
    }
}

/// The comparison finds what it should.
pub(crate) fn planted_differences_are_found(gpu: &Gpu) {
    let points = cases::<f32, 5>(240).swap_remove(5).points;
    let question = FixedRadiusN::new(radius_for(&points, 9) * 1.01);
    let tree = GpuAabbTreeN::build(gpu, &points, &settings(TreeSearch::Primary)).unwrap();
    let list = tree.list(&question).unwrap();
    assert_eq!(difference(&points, &question, &list), None);
    assert!(difference(&points, &question.exclude_self(), &list).is_some());
    let larger = FixedRadiusN { radius: RadiusN::One(radius_for(&points, 12)), ..question };
    assert!(difference(&points, &larger, &list).is_some());
    let mut moved = points.clone();
    moved[17][4] += 1e-4;
    assert!(difference(&moved, &question, &list).is_some());
}
