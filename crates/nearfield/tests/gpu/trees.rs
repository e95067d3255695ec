//! The nearest points and points in boxes on the octree of the device: batches, refused memory, rows that stay there. Packs
//! of the AABB-tree that are split while they are searched.

use libtest_mimic::Trial;
use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::Gpu;
use nearfield::structure::GpuStructure;
use nearfield::{
    Aabb, AabbTreeSettings, BoxSearch, Boxes, Error, FixedRadius, GpuAabbTree, GpuLinearOctree, Knn, KnnSearch,
    LinearOctree, NeighborSearch, OctreeSettings, Result, RowOrder, TreeSearch, Vec3,
};

use crate::support::gpu_trial;
use crate::{lattice_points, own_context};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("large_trees_are_walked_where_loops_are_ended", large_trees),
        gpu_trial("split_packs_find_what_single_queries_find", split_packs),
        gpu_trial("nearest_points_in_batches_are_the_same", nearest_in_batches),
        gpu_trial("points_in_boxes_in_batches_are_the_same", boxes_in_batches),
        gpu_trial("nearest_points_stay_on_the_device", nearest_on_device),
        gpu_trial("refused_memory_of_a_tree_is_an_error_or_a_smaller_batch", refused_memory),
    ]
}

const SETTINGS: OctreeSettings = OctreeSettings::DEFAULT;

fn trees(gpu: &Gpu, n: usize) -> (LinearOctree, GpuLinearOctree) {
    let points = lattice_points(n);
    (LinearOctree::build(&points, &SETTINGS).unwrap(), GpuLinearOctree::build(gpu, &points, &SETTINGS).unwrap())
}

fn boxes() -> Vec<Aabb> {
    lattice_points(300).into_iter().map(|p| Aabb::new(p, p + Vec3::new(0.125, 0.25, 0.5))).collect()
}

/// Runs `work` with ever less memory until it fails; it gives the same answer in more and more batches.
fn with_less_memory<T>(gpu: &Gpu, work: impl Fn() -> Result<T>, batches_if_right: impl Fn(&T) -> u32) {
    let mut most_batches = 0;
    for shift in 10..24 {
        gpu.set_memory_limit(gpu.memory_used() + (1 << (33 - shift)));
        match work() {
            Ok(answer) => most_batches = most_batches.max(batches_if_right(&answer)),
            Err(Error::OutOfDeviceMemory { .. }) => break,
            Err(error) => panic!("{error}"),
        }
    }
    gpu.set_memory_limit(u64::MAX);
    assert!(most_batches > 2, "{most_batches} batches");
}

fn nearest_in_batches(gpu: &Gpu) {
    let gpu = own_context(gpu);
    let (cpu, tree) = trees(&gpu, 2000);
    let others = lattice_points(1500);
    for question in [Knn::new(9), Knn::new(5).exclude_self(), Knn::new(3).queries(&others)] {
        let expected = cpu.knn(&question).unwrap();
        with_less_memory(
            &gpu,
            || tree.knn(&question),
            |found| {
                assert_eq!(found.indices(), expected.indices());
                assert_eq!(found.distances(), expected.distances());
                found.report.batches
            },
        );
    }
}

fn boxes_in_batches(gpu: &Gpu) {
    let gpu = own_context(gpu);
    let (cpu, tree) = trees(&gpu, 2000);
    let boxes = boxes();
    let question = Boxes::new(&boxes);
    let expected = cpu.list_in_boxes(&question).unwrap();
    assert!(expected.summary().mean > 10.0, "boxes should hold points");
    with_less_memory(
        &gpu,
        || tree.list_in_boxes(&question),
        |found| {
            assert_eq!((found.offsets(), found.indices()), (expected.offsets(), expected.indices()));
            found.report.batches
        },
    );
}

fn nearest_on_device(gpu: &Gpu) {
    let (cpu, tree) = trees(gpu, 500);
    for (k, places) in [(0, 0), (7, 7)] {
        let expected = cpu.knn(&Knn::new(k)).unwrap();
        let found = tree.knn_on_device(&Knn::new(k)).unwrap();
        assert_eq!(found.places, places);
        assert_eq!(gpu.read(&found.indices).unwrap(), expected.indices());
        let distances: Vec<f32> = gpu.read(&found.dist2).unwrap().into_iter().map(f32::sqrt).collect();
        assert_eq!(distances, expected.distances());
    }
    let (_, tree) = trees(gpu, 10);
    assert_eq!(tree.knn_on_device(&Knn::new(40).exclude_self()).unwrap().places, 9);
}

fn refused_memory(gpu: &Gpu) {
    let gpu = own_context(gpu);
    let (cpu, tree) = trees(&gpu, 300);
    let boxes = boxes();
    let (knn, question) = (Knn::new(4), Boxes::new(&boxes));
    let (nearest, inside) = (cpu.knn(&knn).unwrap(), cpu.list_in_boxes(&question).unwrap());
    for n in 0..40 {
        gpu.refuse_allocation(Some(n));
        let found = tree.knn(&knn);
        gpu.refuse_allocation(Some(n));
        let listed = tree.list_in_boxes(&question);
        gpu.refuse_allocation(None);
        match found {
            Ok(found) => assert_eq!(found.indices(), nearest.indices(), "allocation {n}"),
            Err(error) => assert!(matches!(error, Error::OutOfDeviceMemory { .. }), "allocation {n}: {error}"),
        }
        match listed {
            Ok(listed) => assert_eq!(listed.indices(), inside.indices(), "allocation {n}"),
            Err(error) => assert!(matches!(error, Error::OutOfDeviceMemory { .. }), "allocation {n}: {error}"),
        }
    }
}

/// Radii of ratio 1000 side by side, and queries so few that those of a subgroup are far apart.
/// A tree of many points is walked, with or without splitting its packs, also where loops are ended: testing every point
/// for every query would take minutes.
fn large_trees(gpu: &Gpu) {
    let points = cloud(CloudKind::Uniform, 120_000, 7).points;
    let tree = GpuAabbTree::build(gpu, &points, &AabbTreeSettings::DEFAULT).unwrap();
    let effort = tree.most_effort(0.01, None).unwrap();
    // Eight points are a round there.
    let rounds = effort.rounds + effort.candidates.div_ceil(8);
    let limit = gpu.limits().loop_rounds;
    assert!(limit.is_none_or(|limit| rounds + 2 <= u64::from(limit)), "{rounds} rounds of {limit:?}");
}

fn split_packs(gpu: &Gpu) {
    let points = cloud(CloudKind::Clustered, 12_000, 7).points;
    // With some 4,000 leaves, the large balls meet many more than an invocation passes in a pack.
    let mut tree = GpuAabbTree::build(gpu, &points, &AabbTreeSettings::DEFAULT.bucket_size(4)).unwrap();
    let radii: Vec<f32> = (0..points.len()).map(|i| if i % 37 == 0 { 0.2 } else { 0.0002 }).collect();
    let far: Vec<Vec3> = points.iter().copied().step_by(150).collect();
    for (name, question) in [("radii", FixedRadius::each(&radii)), ("far apart", FixedRadius::new(0.01).queries(&far))]
    {
        let mut counts = Vec::new();
        for search in [TreeSearch::Packed, TreeSearch::Primary] {
            tree.set_search(search);
            counts.push(tree.count(&question).unwrap().as_slice().to_vec());
        }
        assert_eq!(counts[0], counts[1], "{name}");
        assert!(counts[0].iter().any(|&count| count > 1), "{name}: there should be neighbours");
        let rows = question.order(RowOrder::Index).max_bytes(256 << 20);
        tree.set_search(TreeSearch::Packed);
        let packed = tree.list(&rows).unwrap();
        tree.set_search(TreeSearch::Primary);
        let alone = tree.list(&rows).unwrap();
        assert_eq!((packed.offsets(), packed.indices()), (alone.offsets(), alone.indices()), "{name}");
    }
}
