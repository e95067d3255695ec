//! The dense octree on the GPU: equal to the CPU's to the bit, equal to a recursive construction, and errors where memory
//! or the domain end.

use libtest_mimic::Trial;
use nearfield::gpu::Gpu;
use nearfield::structure::dense_octree::MOST_LEVELS;
use nearfield::{CellState, Curve, DenseOctree, DenseOctreeSettings, Domain, Error, GpuDenseOctree, Octant, Vec3};

use crate::support::{Random, gpu_trial, own_context, refuse_each, trial};

const SEED: u64 = 20_261_124;

fn cases() -> Vec<(&'static str, Vec<Vec3>)> {
    let mut random = Random(SEED);
    let mut point = || Vec3::new(random.unit(), random.unit(), random.unit());
    let lattice = |n: u32| {
        let part = move |i: u32| i as f32 / n as f32;
        (0..=n).flat_map(move |x| (0..=n).flat_map(move |y| (0..=n).map(move |z| Vec3::new(part(x), part(y), part(z)))))
    };
    vec![
        ("none", vec![]),
        ("one", vec![Vec3::new(3.0, -2.0, 7.0)]),
        ("random", (0..3000).map(|_| 10.0 * point() - 5.0).collect()),
        ("clustered", (0..3000).map(|i| Vec3::splat((i % 3) as f32) + 0.01 * point()).collect()),
        ("line", (0..1000).map(|i| Vec3::new(i as f32, 0.5, 0.5)).collect()),
        ("all equal", vec![Vec3::new(0.1, 0.2, 0.3); 500]),
        ("two values", (0..500).map(|i| Vec3::splat((i % 2) as f32)).collect()),
        ("borders of cells", lattice(8).collect()),
        ("far faces", lattice(8).filter(|p| p.max_element() == 1.0).chain([Vec3::ZERO]).collect()),
        ("one octant", (0..1000).map(|_| 0.2 * point()).chain([Vec3::ONE]).collect()),
    ]
}

fn settings(levels: u32, curve: Curve) -> DenseOctreeSettings {
    DenseOctreeSettings::with_levels(levels).curve(curve)
}

/// Places in and around the domain of a tree.
fn queries(domain: &Domain) -> Vec<Vec3> {
    let mut random = Random(SEED);
    let mut part = || (random.below(65) as f32 - 8.0) / 48.0;
    (0..1000).map(|_| domain.origin() + domain.edge() * Vec3::new(part(), part(), part())).collect()
}

/// The first difference between two trees.
fn difference(found: &DenseOctree, expected: &DenseOctree) -> Option<String> {
    if (found.layout(), found.curve(), found.domain()) != (expected.layout(), expected.curve(), expected.domain()) {
        return Some("layout, curve or domain".into());
    }
    let bits = |tree: &DenseOctree| {
        let position = |i: usize| tree.points().position(i).to_array().map(f32::to_bits);
        (0..tree.points().len()).map(position).collect::<Vec<_>>()
    };
    let place = |differs: Option<usize>, what: &str| differs.map(|i| format!("{what} at place {i}"));
    let words = |a: &[u32], b: &[u32], what: &str| match a.len() == b.len() {
        true => place(a.iter().zip(b).position(|(a, b)| a != b), what),
        false => Some(format!("length of {what}")),
    };
    words(found.points().ids(), expected.points().ids(), "order")
        .or_else(|| (bits(found) != bits(expected)).then(|| "positions".into()))
        .or_else(|| words(found.starts(), expected.starts(), "starts"))
        .or_else(|| place(found.states().iter().zip(expected.states()).position(|(a, b)| a != b), "states"))
        .or_else(|| words(found.nulls_before(), expected.nulls_before(), "nulls before"))
}

/// The nodes of the tree below a cell in post-order, by recursion: `cells` are those of the points at the finest level.
fn post_order(cell: Octant, levels: u32, cells: &[Octant], nodes: &mut Vec<(Octant, CellState)>) {
    let inside: Vec<Octant> = cells.iter().copied().filter(|&c| cell.contains(c)).collect();
    let state = match (inside.is_empty(), cell.level() == levels) {
        (true, _) => CellState::EmptyLeaf,
        (false, true) => CellState::OccupiedLeaf,
        (false, false) => CellState::Inner,
    };
    if state == CellState::Inner {
        (0..8).for_each(|i| post_order(cell.child(i).unwrap(), levels, &inside, nodes));
    }
    nodes.push((cell, state));
}

fn gpu_equals_the_cpu_to_the_bit(gpu: &Gpu) {
    for (name, points) in cases() {
        for curve in Curve::ALL {
            for levels in 0..=4 {
                let case = format!("{name}, {curve}, {levels} levels");
                check(gpu, &points, &settings(levels, curve), &case);
            }
        }
    }
}

fn check(gpu: &Gpu, points: &[Vec3], settings: &DenseOctreeSettings, case: &str) {
    let cpu = DenseOctree::build(points, settings).unwrap();
    let tree = GpuDenseOctree::build(gpu, points, settings).unwrap();
    let read = tree.read().unwrap();
    assert_eq!(difference(&read, &cpu), None, "{case}");
    assert_eq!(tree.n_nodes(), cpu.n_nodes(), "{case}");
    assert!(tree.post_order_numbers().unwrap() == cpu.post_order_numbers(), "{case}: post-order numbers");
    assert!(tree.pre_order_numbers().unwrap() == cpu.pre_order_numbers(), "{case}: pre-order numbers");
    assert!(tree.post_order().unwrap() == cpu.post_order(), "{case}: post-order");
    assert!(tree.pre_order().unwrap() == cpu.pre_order(), "{case}: pre-order");
    for queries in [points, &queries(cpu.domain()), &[]] {
        let (found, expected) = (tree.locate(queries).unwrap(), cpu.locate(queries).unwrap());
        let wrong = (0..queries.len()).find(|&i| found[i] != expected[i]);
        assert_eq!(wrong.map(|i| (queries[i], found[i], expected[i])), None, "{case}");
    }
}

fn gpu_equals_the_recursive_construction(gpu: &Gpu) {
    for (name, points) in cases() {
        for curve in Curve::ALL {
            for levels in 0..=4 {
                let tree = GpuDenseOctree::build(gpu, &points, &settings(levels, curve)).unwrap();
                let finest = |&p: &Vec3| Octant::of_key(tree.domain().key_of(curve, p), levels);
                let cells: Vec<Octant> = points.iter().map(finest).collect();
                let mut nodes = vec![];
                post_order(Octant::ROOT, levels, &cells, &mut nodes);
                assert!(tree.post_order().unwrap() == nodes, "{name}, {curve}, {levels} levels");
            }
        }
    }
}

/// At eight levels the cells are more than the workgroups of one dimension can take.
fn deep_trees_equal_the_cpu(gpu: &Gpu) {
    let points = cases().swap_remove(3).1;
    check(gpu, &points, &settings(6, Curve::Hilbert), "6 levels");
    check(gpu, &points, &settings(MOST_LEVELS, Curve::Morton), "8 levels");
}

fn the_posters_cell_has_number_46(gpu: &Gpu) {
    let settings = settings(2, Curve::Morton).domain(Domain::new(Vec3::ZERO, 4.0).unwrap());
    let tree = GpuDenseOctree::build(gpu, &[Vec3::new(3.5, 1.0, 2.25)], &settings).unwrap();
    let leaf = tree.locate(&[Vec3::new(3.0, 1.5, 2.9)]).unwrap()[0].unwrap();
    assert_eq!((leaf.level(), leaf.key()), (2, 46));
    assert_eq!(tree.n_nodes(), 1 + 8 + 8);
    let nodes = tree.post_order().unwrap();
    assert_eq!(nodes[5 + 6], (leaf, CellState::OccupiedLeaf));
}

/// The first numbers outside the closed cube that no device flushes to zero, and the last inside.
fn the_faces_of_the_domain_are_inside(gpu: &Gpu) {
    let settings = settings(4, Curve::Morton).domain(Domain::new(Vec3::ZERO, 1.0).unwrap());
    let points = cases().swap_remove(7).1;
    let (cpu, tree) = (DenseOctree::build(&points, &settings).unwrap(), GpuDenseOctree::build(gpu, &points, &settings));
    let coordinates =
        [-f32::MIN_POSITIVE, -0.0, 0.0, f32::MIN_POSITIVE, 0.5, 1.0 - f32::EPSILON, 1.0, 1.0 + f32::EPSILON];
    let queries: Vec<Vec3> =
        coordinates.iter().flat_map(|&c| [Vec3::new(c, 0.5, 1.0), Vec3::new(0.0, 0.25, c)]).collect();
    let (found, expected) = (tree.unwrap().locate(&queries).unwrap(), cpu.locate(&queries).unwrap());
    assert_eq!(found, expected);
    let outside = |c: f32| !(0.0..=1.0).contains(&c);
    let inside: Vec<bool> = coordinates.iter().flat_map(|&c| [!outside(c); 2]).collect();
    assert_eq!(expected.iter().map(Option::is_some).collect::<Vec<_>>(), inside);
}

fn points_on_the_device_keep_their_place_as_index(gpu: &Gpu) {
    let domain = Domain::new(Vec3::ZERO, 1.0).unwrap();
    let points = [Vec3::splat(0.9), Vec3::splat(0.1), Vec3::splat(0.95), Vec3::splat(0.2)];
    let given: Vec<[f32; 4]> = points.iter().map(|p| [p.x, p.y, p.z, 77.0]).collect();
    let input = gpu.upload("points", &given).unwrap();
    let settings = settings(1, Curve::Morton).domain(domain);
    let tree = GpuDenseOctree::build_on_device(gpu, &input, &domain, &settings).unwrap();
    assert_eq!(gpu.read(tree.order()).unwrap(), [1, 3, 0, 2]);
    assert!(gpu.read(tree.points()).unwrap().iter().all(|p| p[3] == 77.0));
    let cpu = DenseOctree::build(&points, &settings).unwrap();
    assert_eq!(difference(&tree.read().unwrap(), &cpu), None);
    // Outside points count to the border.
    let outside = gpu.upload("points", &[[-5.0f32, 9.0, 0.1, 0.0]]).unwrap();
    let tree = GpuDenseOctree::build_on_device(gpu, &outside, &domain, &settings).unwrap();
    assert_eq!(tree.read().unwrap().state_of(Octant::of_key(0b010 << 60, 1)), CellState::OccupiedLeaf);
}

fn wrong_input_is_an_error(gpu: &Gpu) {
    let in_unit_cube = settings(3, Curve::Morton).domain(Domain::new(Vec3::ZERO, 1.0).unwrap());
    let mut points = vec![Vec3::ONE; 10];
    let build = |points: &[Vec3], settings: &DenseOctreeSettings| GpuDenseOctree::build(gpu, points, settings);
    assert!(matches!(build(&points, &settings(9, Curve::Morton)), Err(Error::InvalidSetting { .. })));
    let tree = build(&points, &in_unit_cube).unwrap();
    points[4].y = 1.5;
    points[7].z = -0.25;
    let error = build(&points, &in_unit_cube).unwrap_err();
    assert!(matches!(error, Error::OutsideDomain { what: "points", count: 2, first: 4 }), "{error}");
    points[6].x = f32::NAN;
    let error = build(&points, &in_unit_cube).unwrap_err();
    assert!(matches!(error, Error::NonFinite { what: "points", count: 1, first: 6 }), "{error}");
    let error = tree.locate(&points).unwrap_err();
    assert!(matches!(error, Error::NonFinite { what: "queries", count: 1, first: 6 }), "{error}");
}

// ---- memory ----

fn memory_is_checked_before_it_is_asked_for(gpu: &Gpu) {
    let own = own_context(gpu);
    let points = cases().swap_remove(2).1;
    let build = |levels, max_memory| {
        GpuDenseOctree::build(&own, &points, &settings(levels, Curve::Morton).max_memory(max_memory))
    };
    let used = own.memory_used();
    own.take_memory_peak();
    // By the limit of the settings, then by the context's.
    match build(8, 1 << 20) {
        // Twelve bytes for each of 19,173,961 cells, eight for each of 8^8, and 52 a point.
        Err(Error::OutOfDeviceMemory { needed, available, .. }) => {
            assert_eq!((needed, available), (12 * 19_173_961 + (8 << 24) + 52 * 3000, 1 << 20));
        }
        other => panic!("{other:?}"),
    }
    own.set_memory_limit(used + 5000);
    match build(8, u64::MAX) {
        Err(Error::OutOfDeviceMemory { needed, available, .. }) => assert!(needed > available && available == 5000),
        other => panic!("{other:?}"),
    }
    assert_eq!(own.take_memory_peak(), used, "nothing was allocated");
    own.set_memory_limit(u64::MAX);
    // What is checked is what is taken, but for the tables of scan and sort.
    own.take_memory_peak();
    drop(build(6, u64::MAX).unwrap());
    let (taken, told) = (own.take_memory_peak() - used, 12 * 299_593 + (8 << 18) + 52 * 3000);
    assert!((told..told + told / 20).contains(&taken), "{taken} bytes taken, {told} told");
    let tree = build(3, u64::MAX).unwrap();
    let cpu = DenseOctree::build(&points, &settings(3, Curve::Morton)).unwrap();
    assert_eq!(difference(&tree.read().unwrap(), &cpu), None, "after the errors");
}

fn a_refused_allocation_is_an_error(gpu: &Gpu) {
    let own = own_context(gpu);
    let points = cases().swap_remove(2).1;
    let settings = settings(3, Curve::Hilbert);
    let cpu = DenseOctree::build(&points, &settings).unwrap();
    let build = || GpuDenseOctree::build(&own, &points, &settings);
    let refused = refuse_each(&own, "build", build, |tree| tree.n_nodes() == cpu.n_nodes());
    assert!(refused >= 15, "{refused} allocations of a build");
    let tree = build().unwrap();
    refuse_each(&own, "read", || tree.read(), |read| difference(read, &cpu).is_none());
    refuse_each(&own, "locate", || tree.locate(&points), |found| *found == cpu.locate(&points).unwrap());
    refuse_each(&own, "numbers", || tree.post_order_numbers(), |found| *found == cpu.post_order_numbers());
    refuse_each(&own, "post-order", || tree.post_order(), |found| *found == cpu.post_order());
}

// ---- the checks themselves ----

fn planted_differences_are_found() {
    let points = cases().swap_remove(2).1;
    let build = |points: &[Vec3], settings: &DenseOctreeSettings| DenseOctree::build(points, settings).unwrap();
    let sound = build(&points, &settings(3, Curve::Morton));
    assert_eq!(difference(&sound, &sound), None);
    let contains = |found: Option<String>, what: &str| {
        assert!(found.as_ref().is_some_and(|f| f.contains(what)), "{what}: {found:?}")
    };
    contains(difference(&build(&points, &settings(2, Curve::Morton)), &sound), "layout");
    contains(difference(&build(&points, &settings(3, Curve::Hilbert)), &sound), "curve");
    let domain = settings(3, Curve::Morton).domain(*sound.domain());
    let mut moved = points.clone();
    moved[5] = domain.domain.unwrap().origin();
    contains(difference(&build(&moved, &domain), &sound), "order");
    contains(difference(&build(&points[1..], &domain), &sound), "order");
    // By one step of a coordinate, within the cell.
    let mut nudged = points;
    nudged[5].x = f32::from_bits(nudged[5].x.to_bits() ^ 1);
    contains(difference(&build(&nudged, &domain), &sound), "positions");
}

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("planted_differences_are_found", planted_differences_are_found),
        gpu_trial("gpu_equals_the_cpu_to_the_bit", gpu_equals_the_cpu_to_the_bit),
        gpu_trial("gpu_equals_the_recursive_construction", gpu_equals_the_recursive_construction),
        gpu_trial("deep_trees_equal_the_cpu", deep_trees_equal_the_cpu),
        gpu_trial("the_posters_cell_has_number_46", the_posters_cell_has_number_46),
        gpu_trial("the_faces_of_the_domain_are_inside", the_faces_of_the_domain_are_inside),
        gpu_trial("points_on_the_device_keep_their_place_as_index", points_on_the_device_keep_their_place_as_index),
        gpu_trial("wrong_input_is_an_error", wrong_input_is_an_error),
        gpu_trial("memory_is_checked_before_it_is_asked_for", memory_is_checked_before_it_is_asked_for),
        gpu_trial("a_refused_allocation_is_an_error", a_refused_allocation_is_an_error),
    ]
}
