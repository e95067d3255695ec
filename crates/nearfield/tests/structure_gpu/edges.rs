//! The GPU at its edges: nothing to search, and more work for a query than a software renderer's loops can do.
//!
//! Expected values follow from the clouds: equal points are all neighbours of each other.

use libtest_mimic::Trial;
use nearfield::gpu::{Access, Gpu};
use nearfield::query::{ForEachOnDevice, NeighborSearch, SearchOnDevice, Visitor};
use nearfield::structure::{GpuAabbTree, GpuBruteForce, GpuUniformGrid};
use nearfield::{AabbTreeSettings, BuildOrder, Error, FixedRadius, GridSettings, RowOrder, Vec3};

use crate::support::gpu_trial;

/// More points than rounds that llvmpipe grants the loops of an invocation.
const MANY: usize = 70_000;
const PLACE: Vec3 = Vec3::new(0.5, -3.0, 8.0);

/// A visitor that counts.
const COUNTING: &str = "
import package::structure::question::{Query, Neighbor};
@group(1) @binding(0) var<storage, read_write> counts: array<u32>;
struct State { count: u32 }
fn begin(query: Query) -> State { return State(0u); }
fn visit(state: ptr<function, State>, query: Query, neighbor: Neighbor) -> bool { (*state).count += 1u; return true; }
fn finish(state: ptr<function, State>, query: Query) { counts[query.slot] = (*state).count; }
";

trait Structure: NeighborSearch + SearchOnDevice + ForEachOnDevice {}
impl<S: NeighborSearch + SearchOnDevice + ForEachOnDevice> Structure for S {}

macro_rules! on_each {
    ($check:ident) => {
        [
            gpu_trial(concat!("brute-force/", stringify!($check)), |gpu| {
                $check(gpu, |points, _| GpuBruteForce::build(gpu, points).unwrap());
            }),
            gpu_trial(concat!("uniform-grid/", stringify!($check)), |gpu| {
                let build = |points: &[Vec3], cell| {
                    GpuUniformGrid::build(gpu, points, &GridSettings::for_radius(cell)).unwrap()
                };
                $check(gpu, build);
            }),
            gpu_trial(concat!("aabb-tree/", stringify!($check)), |gpu| {
                let settings = AabbTreeSettings::default().order(BuildOrder::Hilbert);
                $check(gpu, |points, _| GpuAabbTree::build(gpu, points, &settings).unwrap());
            }),
        ]
    };
}

pub(crate) fn trials() -> Vec<Trial> {
    [
        on_each!(nothing_to_search_and_nobody_who_asks),
        on_each!(seventy_thousand_neighbors_are_all_found),
        on_each!(rows_of_seventy_thousand_are_sorted),
        on_each!(the_nearest_of_seventy_thousand_are_kept),
        on_each!(every_query_beside_others_is_whole),
        on_each!(as_many_candidates_as_are_allowed_are_all_tested),
        on_each!(too_many_candidates_are_refused_or_found),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn nothing_to_search_and_nobody_who_asks<S: Structure>(gpu: &Gpu, build: impl Fn(&[Vec3], f32) -> S) {
    for (n, q) in [(0, 0), (0, 3), (3, 0)] {
        let (points, queries) = (vec![PLACE; n], vec![PLACE; q]);
        let structure = build(&points, 0.5);
        for question in [FixedRadius::new(0.5).queries(&queries), FixedRadius::new(0.5)] {
            let asked = question.len(n);
            // Either nobody asks, or there is nothing to find, or all points find each other.
            let expected = vec![n as u32; asked];
            let entries = n * asked;
            let case = format!("{n} points, {asked} queries");
            assert_eq!(structure.count(&question).unwrap().as_slice(), expected, "{case}");
            assert_eq!(structure.nearest(&question).unwrap().indices().len(), asked, "{case}");
            for order in [RowOrder::Unspecified, RowOrder::Index, RowOrder::Distance] {
                let ordered = question.order(order);
                let list = structure.list(&ordered).unwrap();
                assert_eq!((list.len(), list.indices().len()), (asked, entries), "{case}, {order:?}");
                let capped = structure.list(&ordered.max_neighbors(2)).unwrap();
                assert_eq!((capped.len(), capped.indices().len()), (asked, n.min(2) * asked), "{case}, {order:?}");
                let on_device = structure.list_on_device(&ordered).unwrap();
                assert_eq!(gpu.read(&on_device.offsets).unwrap().last(), Some(&(entries as u32)), "{case}, {order:?}");
            }
            let (counts, _) = structure.count_on_device(&question).unwrap();
            assert_eq!(gpu.read(&counts).unwrap(), expected, "{case}");
            let visited = gpu.upload("visited", &vec![0xdead_beefu32; asked]).unwrap();
            let bindings = [(Access::ReadWrite, (&visited).into())];
            let visitor = Visitor::new(COUNTING, &bindings);
            structure.for_each_on_device(&question, &visitor).unwrap();
            assert_eq!(gpu.read(&visited).unwrap(), expected, "{case}");
        }
    }
}

fn seventy_thousand_neighbors_are_all_found<S: Structure>(gpu: &Gpu, build: impl Fn(&[Vec3], f32) -> S) {
    let structure = build(&vec![PLACE; MANY], 0.25);
    let question = FixedRadius::new(0.25).queries(&[PLACE]);
    assert_eq!(structure.count(&question).unwrap().as_slice(), [MANY as u32]);
    assert_eq!(structure.nearest(&question).unwrap().indices(), [0]);
    let list = structure.list(&question).unwrap();
    let mut found = list.row(0).to_vec();
    found.sort_unstable();
    assert!(found.into_iter().eq(0..MANY as u32), "an index is missing or twice there");
    let visited = gpu.upload("visited", &[0xdead_beefu32]).unwrap();
    let bindings = [(Access::ReadWrite, (&visited).into())];
    let visitor = Visitor::new(COUNTING, &bindings);
    structure.for_each_on_device(&question, &visitor).unwrap();
    assert_eq!(gpu.read(&visited).unwrap(), [MANY as u32]);
}

/// Points on a line, the nearest last, and a query at their end.
fn line() -> Vec<Vec3> {
    (0..MANY).rev().map(|i| Vec3::new(i as f32, 0.0, 0.0)).collect()
}

fn rows_of_seventy_thousand_are_sorted<S: Structure>(gpu: &Gpu, build: impl Fn(&[Vec3], f32) -> S) {
    let structure = build(&line(), MANY as f32);
    let question = FixedRadius::new(MANY as f32).queries(&[Vec3::ZERO]);
    for distances in [false, true] {
        let question = FixedRadius { distances, ..question };
        let by_index = structure.list(&question.order(RowOrder::Index)).unwrap();
        assert!(by_index.row(0).iter().copied().eq(0..MANY as u32), "not by index");
        let by_distance = structure.list(&question.order(RowOrder::Distance)).unwrap();
        assert!(by_distance.row(0).iter().copied().eq((0..MANY as u32).rev()), "not by distance");
        for (list, first) in [(by_index, (MANY - 1) as f32), (by_distance, 0.0)] {
            let at = |values: &[f32]| (values.len(), values[0], values[100], values[MANY - 1]);
            let middle = (first - 100.0).abs();
            let expected = distances.then_some((MANY, first, middle, (MANY - 1) as f32 - first));
            assert_eq!(list.distances().map(at), expected);
        }
    }
    let on_device = structure.list_on_device(&question.order(RowOrder::Index));
    match (gpu.limits().loop_rounds, on_device) {
        (None, Ok(list)) => assert!(gpu.read(&list.indices).unwrap().into_iter().eq(0..MANY as u32)),
        (Some(_), Err(error @ Error::Unsupported { .. })) => {
            let message = error.to_string();
            assert!(message.contains("70000") && message.contains(gpu.name()), "{message}");
        }
        (_, other) => panic!("{:?}", other.map(|list| list.report)),
    }
}

fn the_nearest_of_seventy_thousand_are_kept<S: Structure>(_: &Gpu, build: impl Fn(&[Vec3], f32) -> S) {
    let structure = build(&line(), MANY as f32);
    let question = FixedRadius::new(MANY as f32).queries(&[Vec3::ZERO]).distances();
    for cap in [0, 3, 5000, MANY - 1] {
        let list = structure.list(&question.max_neighbors(cap as u32).order(RowOrder::Distance)).unwrap();
        assert!(list.row(0).iter().copied().eq((0..MANY as u32).rev().take(cap)), "cap {cap}");
        let distances = list.distances().unwrap_or_default();
        assert!(distances.iter().copied().eq((0..cap).map(|i| i as f32)), "cap {cap}");
        let cut: Vec<_> = list.cut().iter().map(|cut| (cut.query, cut.missing)).collect();
        assert_eq!(cut, [(0, (MANY - cap) as u32)]);
        let by_index = structure.list(&question.max_neighbors(cap as u32).order(RowOrder::Index)).unwrap();
        assert!(by_index.row(0).iter().copied().eq((MANY - cap) as u32..MANY as u32), "cap {cap} by index");
    }
}

/// Queries that run in step share the rounds of their loops: near and far ones, with small and large balls.
fn every_query_beside_others_is_whole<S: Structure>(_: &Gpu, build: impl Fn(&[Vec3], f32) -> S) {
    let heap = 20_000;
    let points: Vec<Vec3> = (0..5 * heap).map(|i| Vec3::new((i % 5) as f32, 0.0, 0.0)).collect();
    let structure = build(&points, 0.5);
    let queries: Vec<Vec3> = (0..24).map(|i| Vec3::new((i % 5) as f32, 0.0, (i % 3) as f32 * 0.25)).collect();
    let radii: Vec<f32> = (0..24).map(|i| [0.5, 1.25, 0.0][i % 3]).collect();
    let expected: Vec<u32> = queries
        .iter()
        .zip(&radii)
        .map(|(query, &radius)| {
            let near = (0..5).filter(|&x| Vec3::new(x as f32, 0.0, 0.0).distance_squared(*query) <= radius * radius);
            (near.count() * heap) as u32
        })
        .collect();
    let question = FixedRadius::each(&radii).queries(&queries);
    assert_eq!(structure.count(&question).unwrap().as_slice(), expected);
    let list = structure.list(&question).unwrap();
    for (i, &count) in expected.iter().enumerate() {
        let mut row = list.row(i).to_vec();
        row.sort_unstable();
        row.dedup();
        assert_eq!(row.len(), count as usize, "row {i}");
    }
}

/// So many that a loop of eight a round ends just in time on devices that end long loops.
fn as_many_candidates_as_are_allowed_are_all_tested<S: Structure>(gpu: &Gpu, build: impl Fn(&[Vec3], f32) -> S) {
    let n = 470_000;
    let structure = build(&vec![PLACE; n], 0.25);
    let question = FixedRadius::new(0.25).queries(&[PLACE; 8]);
    assert_eq!(structure.count(&question).unwrap().as_slice(), [n as u32; 8], "{}", gpu.name());
    let list = structure.list(&FixedRadius::new(0.25).queries(&[PLACE])).unwrap();
    let mut found = list.row(0).to_vec();
    found.sort_unstable();
    assert!(found.into_iter().eq(0..n as u32));
}

fn too_many_candidates_are_refused_or_found<S: Structure>(gpu: &Gpu, build: impl Fn(&[Vec3], f32) -> S) {
    let n = 500_000;
    let structure = build(&vec![PLACE; n], 0.25);
    let question = FixedRadius::new(0.25).queries(&[PLACE]);
    if gpu.limits().loop_rounds.is_none() {
        assert_eq!(structure.count(&question).unwrap().as_slice(), [n as u32]);
        return;
    }
    let visitor = Visitor::new(COUNTING, &[]);
    let errors = [
        structure.count(&question).err(),
        structure.nearest(&question).err(),
        structure.list(&question).err(),
        structure.list(&question.max_neighbors(4)).err(),
        structure.list_on_device(&question).err(),
        structure.count_on_device(&question).err(),
        structure.for_each_on_device(&question, &visitor).err(),
    ];
    for error in errors {
        let Some(error @ Error::Unsupported { .. }) = error else { panic!("{error:?}") };
        let message = error.to_string();
        assert!(message.contains("500000") && message.contains(gpu.name()), "{message}");
    }
}
