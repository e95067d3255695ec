//! The coherent search of the AABB-tree: counters that show what it saves, lists in windows of packs, rows on the device,
//! and the balanced primary search.

use libtest_mimic::Trial;
use nearfield::gpu::Gpu;
use nearfield::query::Clock;
use nearfield::{
    AabbTree, AabbTreeSettings, Error, FixedRadius, GpuAabbTree, NeighborSearch, Result, RowOrder, SearchOnDevice,
    TreeSearch, Vec3,
};

use crate::support::gpu_trial;
use crate::{RADIUS, lattice_points, own_context, rows_by_loop, wrong_row};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("coherent_search_has_fewer_traversals_than_primary", counters),
        gpu_trial("a_coherent_list_in_windows_of_packs_is_the_same", windows),
        gpu_trial("coherent_rows_on_the_device_are_those_of_the_list", rows_on_device),
        gpu_trial("queries_far_from_every_leaf_are_exact", far_queries),
        gpu_trial("balanced_counts_are_those_of_an_invocation_a_query", balanced),
        gpu_trial("refused_memory_of_a_coherent_search_is_an_error_or_a_smaller_batch", refused_memory),
    ]
}

const COHERENT: AabbTreeSettings = AabbTreeSettings { search: TreeSearch::Coherent, ..AabbTreeSettings::DEFAULT };

fn trees(gpu: &Gpu, points: &[Vec3]) -> (AabbTree, GpuAabbTree) {
    let cpu = AabbTree::build(points, &COHERENT).unwrap();
    let on_gpu = GpuAabbTree::upload(gpu, &cpu).unwrap();
    (cpu, on_gpu)
}

/// Points beside the cloud's, some inside leaves, some between them, some far out.
fn others() -> Vec<Vec3> {
    let scattered = lattice_points(700).into_iter().map(|p| p + Vec3::new(1.0 / 256.0, -1.0 / 64.0, 0.25));
    scattered.chain([Vec3::splat(-3.0), Vec3::new(0.5, 0.5, 40.0), Vec3::splat(1e6)]).collect()
}

fn counters(gpu: &Gpu) {
    let points = lattice_points(3000);
    let (cpu, tree) = trees(gpu, &points);
    let (others, leaves) = (others(), cpu.shape().n_leaves() as u64);
    let own = FixedRadius::new(RADIUS);
    for question in [own, own.exclude_self(), own.queries(&others)] {
        let neighbors: u64 = cpu.count(&question).unwrap().as_slice().iter().map(|&c| u64::from(c)).sum();
        let n = question.len(points.len()) as u64;
        let (coherent, primary) =
            (tree.coherent_counters(&question).unwrap(), tree.primary_counters(&question, None).unwrap());
        assert_eq!((coherent.queries, primary.queries, primary.traversals), (n, n, n));
        assert_eq!((coherent.neighbors, primary.neighbors), (neighbors, neighbors));
        assert!(coherent.traversals < primary.traversals && coherent.traversals <= leaves);
        assert!(coherent.candidates > 0 && primary.candidates == 0);
        assert!(coherent.nodes_visited < primary.nodes_visited);
        // A pack tests what any of its queries could need.
        assert!(coherent.tests >= primary.tests && primary.tests >= neighbors);
        for phase in coherent.phases.iter().chain(&primary.phases) {
            assert!((0.0..=1.0).contains(&phase.active_share()), "{phase:?}");
        }
        assert!(["pack", "traverse", "extract"].iter().all(|name| coherent.phase(name).is_some()));
        // The host counts the same; its rounding may let it meet a box more or less at the very edge.
        let (host, host_primary) =
            (cpu.coherent_counters(&question).unwrap(), cpu.primary_counters(&question).unwrap());
        let near = |a: u64, b: u64| a.abs_diff(b) * 50 <= b;
        assert_eq!((host.neighbors, host_primary.neighbors), (neighbors, neighbors));
        assert!(near(host.traversals, coherent.traversals) && near(host.candidates, coherent.candidates));
        assert!(near(host.nodes_visited, coherent.nodes_visited) && near(host.tests, coherent.tests));
        assert!(near(host_primary.nodes_visited, primary.nodes_visited) && near(host_primary.tests, primary.tests));
    }
    // Every leaf is a pack of its own points.
    let own = tree.coherent_counters(&own).unwrap();
    assert_eq!(own.traversals, leaves);
    assert!((own.merged_share() - (1.0 - leaves as f64 / 3000.0)).abs() < 1e-12);
    let balanced = tree.primary_counters(&FixedRadius::new(RADIUS), Some(1024)).unwrap();
    assert_eq!(balanced.neighbors, own.neighbors);
    let none = trees(gpu, &[]).1.coherent_counters(&FixedRadius::new(1.0)).unwrap();
    assert_eq!((none.queries, none.traversals, none.candidates), (0, 0, 0));
}

fn windows(gpu: &Gpu) {
    let gpu = own_context(gpu);
    let points = lattice_points(2500);
    let (_, tree) = trees(&gpu, &points);
    let (others, question) = (others(), FixedRadius::new(RADIUS));
    let expected = rows_by_loop(&points, &points, RADIUS);
    let (whole, sorted) = (tree.list(&question).unwrap(), tree.list(&question.order(RowOrder::Index)).unwrap());
    assert_eq!(wrong_row(&whole, &expected), None);
    assert_eq!((whole.report.search, whole.report.batches), ("coherent", 1));
    let stages = ["pack", "traverse", "extract", "sort"];
    let timed = |name: &str| whole.report.stages.iter().any(|s| s.name == name && s.clock == Clock::Device);
    assert!(gpu.limits().timestamp_period.is_none() || stages.iter().all(|name| timed(name)), "{:?}", whole.report);
    assert_eq!(whole.indices(), tree.list(&question).unwrap().indices(), "another run, the same bytes");
    let counts = tree.count(&question.queries(&others)).unwrap();
    let own_counts: Vec<u32> = expected.iter().map(|row| row.len() as u32).collect();
    let mut done = [0; 5];
    for step in 0..40 {
        let bytes = 4e6 * 0.85f64.powi(step);
        gpu.set_memory_limit(gpu.memory_used() + bytes as u64);
        let (counted, listed) = (tree.count_on_device(&question), tree.list_on_device(&question));
        let (other, host) = (tree.count(&question.queries(&others)), tree.list(&question.order(RowOrder::Index)));
        gpu.set_memory_limit(u64::MAX);
        if let Some((found, report)) = unless_refused(counted) {
            assert_eq!(gpu.read(&found).unwrap(), own_counts);
            done[usize::from(report.batches > 1)] += 1;
        }
        if let Some(list) = unless_refused(listed) {
            let ends: Vec<u64> = gpu.read(&list.offsets).unwrap().into_iter().map(u64::from).collect();
            assert_eq!(ends, whole.offsets());
            let sum = |ids: &[u32]| ids.iter().map(|&id| u64::from(id)).sum::<u64>();
            assert_eq!(sum(&gpu.read(&list.indices).unwrap()), sum(whole.indices()));
            // Extraction needs all candidates at once; windows are counted and filled.
            let filled = list.report.kernels.iter().any(|k| k.contains("query::fill"));
            assert!(filled || list.report.batches == 1, "{:?}", list.report);
            done[2] += u32::from(list.report.batches > 1);
        }
        if let Some(other) = unless_refused(other) {
            assert_eq!(other.as_slice(), counts.as_slice());
            done[3] += 1;
        }
        if let Some(host) = unless_refused(host) {
            assert_eq!((host.offsets(), host.indices()), (sorted.offsets(), sorted.indices()));
            done[4] += 1;
        }
    }
    assert!(done.iter().all(|&n| n > 2), "{done:?} counts, lists and answers in parts");
}

/// The answer, unless the device was full.
fn unless_refused<T>(answer: Result<T>) -> Option<T> {
    match answer {
        Err(Error::OutOfDeviceMemory { .. }) => None,
        answer => Some(answer.unwrap()),
    }
}

fn rows_on_device(gpu: &Gpu) {
    let points = lattice_points(1500);
    let (_, tree) = trees(gpu, &points);
    let question = FixedRadius::new(RADIUS).exclude_self();
    let list = tree.list(&question).unwrap();
    let rows = tree.list_rows_on_device(&question).unwrap();
    let (starts, lengths) = (gpu.read(&rows.starts).unwrap(), gpu.read(&rows.lengths).unwrap());
    let indices = gpu.read(&rows.indices).unwrap();
    assert_eq!((starts.len(), rows.report.search), (points.len(), "coherent"));
    for (i, (&start, &length)) in starts.iter().zip(&lengths).enumerate() {
        assert_eq!(&indices[start as usize..(start + length) as usize], list.row(i));
    }
    let (counts, report) = tree.count_on_device(&question).unwrap();
    assert_eq!((gpu.read(&counts).unwrap(), report.search), (lengths, "coherent"));
}

fn far_queries(gpu: &Gpu) {
    let points = lattice_points(1000);
    let (cpu, tree) = trees(gpu, &points);
    let others = others();
    let radii: Vec<f32> = (0..others.len()).map(|i| [0.0, RADIUS, 0.75, 64.0][i % 4]).collect();
    for question in [FixedRadius::new(RADIUS), FixedRadius::new(64.0), FixedRadius::each(&radii)] {
        let question = question.queries(&others);
        let expected: Vec<_> = (0..others.len())
            .map(|i| {
                let radius = match question.radius {
                    nearfield::Radius::One(radius) => radius,
                    nearfield::Radius::Each(radii) => radii[i],
                };
                rows_by_loop(&points, &others[i..=i], radius).remove(0)
            })
            .collect();
        assert_eq!(wrong_row(&tree.list(&question).unwrap(), &expected), None);
        assert_eq!(wrong_row(&cpu.list(&question).unwrap(), &expected), None);
    }
}

fn balanced(gpu: &Gpu) {
    let points = lattice_points(2000);
    let (cpu, tree) = trees(gpu, &points);
    let (others, own) = (others(), FixedRadius::new(RADIUS));
    let radii: Vec<f32> = (0..points.len()).map(|i| (i % 17) as f32 / 128.0).collect();
    for question in [own, own.exclude_self(), own.queries(&others), FixedRadius::each(&radii)] {
        let expected = cpu.count(&question).unwrap();
        // The fewest take more rounds than a software renderer gives them: several runs.
        for invocations in [None, Some(1), Some(300), Some(100_000)] {
            let found = tree.count_primary(&question, invocations).unwrap();
            assert_eq!(found.as_slice(), expected.as_slice(), "{invocations:?}");
        }
    }
    assert!(trees(gpu, &[]).1.count_primary(&own, Some(10)).unwrap().as_slice().is_empty());
}

fn refused_memory(gpu: &Gpu) {
    let gpu = own_context(gpu);
    let points = lattice_points(400);
    let (_, tree) = trees(&gpu, &points);
    let expected = rows_by_loop(&points, &points, RADIUS);
    let (question, used) = (FixedRadius::new(RADIUS), gpu.memory_used());
    for n in 0..80 {
        gpu.refuse_allocation(Some(n));
        let list = tree.list(&question);
        let reached = !gpu.refuse_allocation(None);
        match list {
            Ok(list) => assert_eq!(wrong_row(&list, &expected), None, "allocation {n}"),
            Err(error) => assert!(matches!(error, Error::OutOfDeviceMemory { .. }), "allocation {n}: {error}"),
        }
        assert_eq!(gpu.memory_used(), used, "allocation {n}: bytes left");
        if !reached {
            return;
        }
    }
}
