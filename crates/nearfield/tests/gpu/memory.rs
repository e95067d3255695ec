//! Device memory that runs out: refused at every single allocation, limited to parts of the need, and accounted for.

use libtest_mimic::Trial;
use nearfield::gpu::{Access, Buffer, Gpu, Kernel, Workgroups};
use nearfield::{
    Error, FixedRadius, ForEachOnDevice, GpuBruteForce, GpuUniformGrid, GridSettings, NeighborSearch, Result, RowOrder,
    SearchOnDevice, Vec3, Visitor,
};

use crate::support::{Random, gpu_trial};
use crate::{RADIUS, SEED, lattice_points, own_context, rows_by_loop, wrong_row};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("a_refused_allocation_is_an_error_or_a_smaller_batch", refused_allocations),
        gpu_trial("lists_in_batches_have_the_same_bytes", lists_in_batches_have_the_same_bytes),
        gpu_trial("counts_in_batches_are_the_same", counts_in_batches_are_the_same),
        gpu_trial("a_list_needs_a_quarter_more_than_its_own_size", a_list_needs_a_quarter_more_than_its_own_size),
        gpu_trial("rows_longer_than_the_memory_of_a_batch_are_split", rows_longer_than_the_memory_of_a_batch_are_split),
        gpu_trial("too_little_memory_is_an_error_with_sizes", too_little_memory_is_an_error_with_sizes),
        gpu_trial("reading_back_takes_the_memory_there_is", reading_back_takes_the_memory_there_is),
        gpu_trial("memory_of_recorded_work_stays_counted", memory_of_recorded_work_stays_counted),
        gpu_trial("threads_never_pass_the_limit_together", threads_never_pass_the_limit_together),
    ]
}

fn grid(gpu: &Gpu, points: &[Vec3]) -> Result<GpuUniformGrid> {
    GpuUniformGrid::build(gpu, points, &GridSettings::for_radius(RADIUS))
}

/// Runs `work` with every one of its allocations refused in turn: it gives the right answer or `OutOfDeviceMemory`, and
/// keeps no memory. `right` says what is wrong with an answer. Returns how many allocations were refused.
pub(crate) fn refuse_each<T>(
    gpu: &Gpu,
    case: &str,
    work: impl Fn() -> Result<T>,
    right: impl Fn(&T) -> Option<String>,
) -> u32 {
    let used = gpu.memory_used();
    let mut refused = 0;
    for n in 0.. {
        gpu.refuse_allocation(Some(n));
        let result = work();
        let not_reached = gpu.refuse_allocation(None);
        match &result {
            Ok(answer) => {
                if let Some(wrong) = right(answer) {
                    panic!("{case}, allocation {n} refused: {wrong}");
                }
            }
            Err(Error::OutOfDeviceMemory { what, needed, available: 0 }) => {
                assert!(*needed > 0 && !what.is_empty() && !not_reached, "{case}, allocation {n}");
            }
            Err(error) => panic!("{case}, allocation {n} refused: {error}"),
        }
        drop(result);
        assert_eq!(gpu.memory_used(), used, "{case}, allocation {n}: bytes left");
        if not_reached {
            return refused;
        }
        refused += 1;
    }
    refused
}

fn refused_allocations(gpu: &Gpu) {
    let own = own_context(gpu);
    let points = lattice_points(700);
    let radii: Vec<f32> = (0..points.len()).map(|i| (i % 17) as f32 / 128.0).collect();
    let each: Vec<_> = points.iter().zip(&radii).map(|(&p, &r)| rows_by_loop(&points, &[p], r).remove(0)).collect();
    let expected = rows_by_loop(&points, &points, RADIUS);
    let counts: Vec<u32> = expected.iter().map(|row| row.len() as u32).collect();
    let differs = |wrong: bool| wrong.then(|| "a wrong answer".to_owned());
    let row_differs = |row: Option<usize>| row.map(|i| format!("row {i} is wrong"));

    refuse_each(&own, "brute-force build", || GpuBruteForce::build(&own, &points), |s| differs(s.len() != 700));
    let built = refuse_each(&own, "grid build", || grid(&own, &points), |s| differs(s.len() != 700));
    assert!(built >= 10, "{built} allocations of a grid build");

    let (brute_force, grid) = (GpuBruteForce::build(&own, &points).unwrap(), grid(&own, &points).unwrap());
    let (all, mine) = (FixedRadius::new(RADIUS), FixedRadius::each(&radii));
    let sorted = all.order(RowOrder::Index).distances();
    let capped = all.max_neighbors(5);
    for search in [&brute_force as &dyn NeighborSearch, &grid] {
        let case = |question: &str| format!("{question} by {}", search.structure());
        let n = refuse_each(&own, &case("count"), || search.count(&all), |c| differs(c.as_slice() != counts));
        assert!(n >= 3, "{n} allocations of a count");
        refuse_each(&own, &case("list"), || search.list(&all), |l| row_differs(wrong_row(l, &expected)));
        refuse_each(&own, &case("list, own radii"), || search.list(&mine), |l| row_differs(wrong_row(l, &each)));
        refuse_each(
            &own,
            &case("sorted list"),
            || search.list(&sorted),
            |list| {
                let row = |i: usize| list.row(i).iter().copied().zip(list.row_distances(i).unwrap().iter().copied());
                let right = |i: usize| row(i).eq(expected[i].iter().map(|&(id, d2)| (id, d2.sqrt())));
                row_differs((0..points.len()).find(|&i| !right(i)))
            },
        );
        refuse_each(
            &own,
            &case("capped list"),
            || search.list(&capped),
            |list| row_differs((0..points.len()).find(|&i| list.row(i).len() != expected[i].len().min(5))),
        );
        refuse_each(
            &own,
            &case("nearest"),
            || search.nearest(&all),
            |nearest| {
                let right =
                    |i: usize| nearest.get(i).is_some_and(|n| n.dist2 == 0.0 && points[n.index as usize] == points[i]);
                row_differs((0..points.len()).find(|&i| !right(i)))
            },
        );
        let others = all.queries(&points[..300]);
        refuse_each(
            &own,
            &case("other queries"),
            || search.count(&others),
            |c| differs(c.as_slice() != &counts[..300]),
        );
    }
    refuse_each(&own, "count on the device", || grid.count_on_device(&all), |_| None);
    refuse_each(&own, "list on the device", || grid.list_on_device(&sorted), |_| None);
    let visitor = "import package::structure::question::{Query, Neighbor};
        struct State { count: u32 }
        fn begin(query: Query) -> State { return State(0u); }
        fn visit(state: ptr<function, State>, query: Query, neighbor: Neighbor) -> bool { return true; }
        fn finish(state: ptr<function, State>, query: Query) { }";
    let visitor = Visitor::new(visitor, &[]);
    refuse_each(&own, "for each", || grid.for_each_on_device(&all, &visitor), |_| None);
}

/// Bytes beyond what is held now that `work` needs at once.
fn need<T>(gpu: &Gpu, work: impl FnOnce() -> Result<T>) -> (u64, T) {
    gpu.take_memory_peak();
    let answer = work().unwrap();
    (gpu.take_memory_peak() - gpu.memory_used(), answer)
}

fn lists_in_batches_have_the_same_bytes(gpu: &Gpu) {
    let own = own_context(gpu);
    let points = lattice_points(4000);
    let queries: Vec<Vec3> = points.iter().rev().map(|&p| p + 1.0 / 256.0).collect();
    let radii: Vec<f32> = (0..points.len()).map(|i| (i % 17) as f32 / 128.0).collect();
    let brute_force = GpuBruteForce::build(&own, &points).unwrap();
    let grid = grid(&own, &points).unwrap();
    let all = FixedRadius::new(RADIUS);
    let questions = [
        ("plain", all),
        ("sorted with distances", all.order(RowOrder::Distance).distances()),
        ("without self, own radii", FixedRadius::each(&radii).exclude_self()),
        ("other queries, own radii", FixedRadius::each(&radii).queries(&queries)),
        ("capped", all.max_neighbors(12).distances()),
    ];
    for search in [&brute_force as &dyn NeighborSearch, &grid] {
        for (name, question) in &questions {
            let (need, whole) = need(&own, || search.list(question));
            assert_eq!(whole.report.batches, 1);
            for part in [2, 8, 64] {
                let case = format!("{name} by {}, 1/{part} of {need} bytes", search.structure());
                own.set_memory_limit(own.memory_used() + need / part);
                let list = search.list(question).unwrap_or_else(|error| panic!("{case}: {error}"));
                assert_eq!(list.offsets(), whole.offsets(), "{case}");
                assert_eq!(list.indices(), whole.indices(), "{case}");
                assert_eq!(list.distances(), whole.distances(), "{case}");
                assert_eq!(list.cut(), whole.cut(), "{case}");
                // Half the need may do where the rest was only for reading back.
                assert!(list.report.batches > 1 || part == 2, "{case}: {} batches", list.report.batches);
                own.set_memory_limit(u64::MAX);
            }
        }
    }
}

fn counts_in_batches_are_the_same(gpu: &Gpu) {
    let own = own_context(gpu);
    let points = lattice_points(10_000);
    let grid = grid(&own, &points).unwrap();
    let question = FixedRadius::new(RADIUS);
    let (count_need, counts) = need(&own, || grid.count(&question));
    let (nearest_need, nearest) = need(&own, || grid.nearest(&question.exclude_self()));
    for part in [3, 8] {
        own.set_memory_limit(own.memory_used() + count_need / part);
        let found = grid.count(&question).unwrap();
        assert_eq!(found.as_slice(), counts.as_slice(), "1/{part}");
        assert!(found.report.batches > 1);
        // A batch that is tried again leaves no times behind.
        let read_backs = found.report.stages.iter().filter(|s| s.name == "read back").count();
        assert_eq!(read_backs as u32, found.report.batches);
        own.set_memory_limit(own.memory_used() + nearest_need / part);
        let found = grid.nearest(&question.exclude_self()).unwrap();
        assert_eq!((found.indices(), found.dist2()), (nearest.indices(), nearest.dist2()), "1/{part}");
        assert!(found.report.batches > 1);
    }
}

fn a_list_needs_a_quarter_more_than_its_own_size(gpu: &Gpu) {
    let own = own_context(gpu);
    let points = lattice_points(4000);
    let question = FixedRadius::new(RADIUS);
    let grid = grid(&own, &points).unwrap();
    let (need, list) = need(&own, || grid.list_on_device(&question));
    let (entries, roomy) = (list.indices.bytes(), list.report.search);
    // What is needed beside the list itself.
    assert!(entries > 4 * 16 * points.len() as u64 && need > entries / 4, "{entries} bytes, and {need}");
    drop(list);
    own.set_memory_limit(own.memory_used() + entries + entries / 4);
    let list = grid.list_on_device(&question).unwrap();
    assert_eq!((roomy, list.report.search), ("row-masks", "two-pass"));
    let host = grid.list(&question).unwrap();
    let expected = rows_by_loop(&points, &points, RADIUS);
    assert_eq!(wrong_row(&host, &expected), None);
    assert_eq!(own.read(&list.indices).unwrap().len(), expected.iter().map(Vec::len).sum::<usize>());
}

fn rows_longer_than_the_memory_of_a_batch_are_split(gpu: &Gpu) {
    let own = own_context(gpu);
    let points = lattice_points(1000);
    let search = GpuBruteForce::build(&own, &points).unwrap();
    // Every row holds all points: 8,000 bytes with distances to sort by. Two rows do not fit.
    own.set_memory_limit(own.memory_used() + 14_000);
    let list = search.list(&FixedRadius::new(2.0).order(RowOrder::Index)).unwrap();
    let everything: Vec<u32> = (0..1000).collect();
    assert!((0..1000).all(|i| list.row(i) == everything));
    assert_eq!(list.report.batches, 1000);
}

fn too_little_memory_is_an_error_with_sizes(gpu: &Gpu) {
    let own = own_context(gpu);
    let points = lattice_points(1000);
    let search = grid(&own, &points).unwrap();
    let question = FixedRadius::new(RADIUS);
    own.set_memory_limit(own.memory_used() + 60);
    let errors = [
        grid(&own, &points).map(drop),
        search.count(&question).map(drop),
        search.list(&question).map(drop),
        search.list(&question.max_neighbors(3)).map(drop),
        search.nearest(&question).map(drop),
        search.list_on_device(&question).map(drop),
    ];
    for (number, error) in errors.into_iter().enumerate() {
        match error {
            Err(Error::OutOfDeviceMemory { needed, available, .. }) => {
                assert!(needed > available && available <= 60, "{number}: {needed} of {available}");
            }
            other => panic!("{number}: {other:?}"),
        }
    }
    own.set_memory_limit(u64::MAX);
    let expected = rows_by_loop(&points, &points, RADIUS);
    assert_eq!(wrong_row(&search.list(&question).unwrap(), &expected), None, "after the errors");
}

fn reading_back_takes_the_memory_there_is(gpu: &Gpu) {
    let own = own_context(gpu);
    let mut random = Random(SEED);
    let words: Vec<u32> = (0..250_003).map(|_| random.word()).collect();
    let buffer = own.upload("words", &words).unwrap();
    let used = own.memory_used();
    own.set_memory_limit(used + 70_000);
    own.take_memory_peak();
    assert!(own.read(&buffer).unwrap() == words, "in parts");
    assert!(own.take_memory_peak() <= used + 70_000);
    assert!(own.read_range(&buffer, 101..249_999).unwrap() == words[101..249_999], "a range in parts");
    own.set_memory_limit(used + 100);
    match own.read(&buffer) {
        Err(Error::OutOfDeviceMemory { needed, available, .. }) => assert_eq!((needed <= 4096, available), (true, 100)),
        other => panic!("{other:?}"),
    }
    assert_eq!(own.memory_used(), used);
}

fn memory_of_recorded_work_stays_counted(gpu: &Gpu) {
    let own = own_context(gpu);
    let restore = Kernel {
        constants: &[("WORKGROUP", 64.0)],
        ..Kernel::new(
            "package::query::restore_order",
            "restore_order",
            &[Access::Uniform, Access::Read, Access::ReadWrite],
            64,
        )
    };
    let points: Vec<[f32; 4]> = (0..100).map(|i| [i as f32, 0.0, 0.0, f32::from_bits(i)]).collect();
    let (before, result) = (own.memory_used(), own.buffer::<[f32; 4]>("result", 100).unwrap());
    let held = own.memory_used();
    let mut commands = own.commands("restore order");
    {
        let parameters = own.uniform("parameters", &[100u32, 0, 100, 0]).unwrap();
        let points = own.upload("points", &points).unwrap();
        let output: Buffer<[f32; 4]> = own.buffer("output", 100).unwrap();
        commands.dispatch(
            &own.pipeline(&restore).unwrap(),
            &[(&parameters).into(), (&points).into(), (&output).into()],
            Workgroups::Covering(100),
        );
        commands.copy(&output, &result);
    }
    assert_eq!(own.memory_used(), held + 16 + 1600 + 1600, "the buffers live on in the recording");
    commands.run().unwrap();
    assert_eq!(own.memory_used(), held);
    assert_eq!(own.read(&result).unwrap()[99][0], 99.0);
    drop(result);
    assert_eq!(own.memory_used(), before);
}

fn threads_never_pass_the_limit_together(gpu: &Gpu) {
    let own = own_context(gpu);
    let limit = own.memory_used() + 64 * 100;
    own.set_memory_limit(limit);
    own.take_memory_peak();
    let made: usize = std::thread::scope(|scope| {
        let take = || (0..200).filter_map(|_| own.buffer::<u32>("sixteen words", 16).ok()).collect::<Vec<_>>();
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(take)).collect();
        let kept: Vec<Vec<Buffer<u32>>> = threads.into_iter().map(|t| t.join().unwrap()).collect();
        kept.iter().map(Vec::len).sum()
    });
    assert_eq!(made, 100);
    assert_eq!(own.take_memory_peak(), limit);
}
