//! The linear octree on the GPU: nodes, numbers, order, locations, neighbours and balance equal to the CPU's to the bit,
//! the leaves of the dense octree where every octant is cut, and errors where memory or the domain end.

use std::collections::BTreeSet;

use libtest_mimic::Trial;
use nearfield::curve::MAX_LEVEL;
use nearfield::geometry::Period;
use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::Gpu;
use nearfield::structure::linear_octree::NONE;
use nearfield::structure::{DevicePoint, GpuStructure, OctreeBuilder};
use nearfield::{
    CellState, Curve, DenseOctree, DenseOctreeSettings, Domain, Error, GpuLinearOctree, LinearOctree, NeighborSearch,
    Octant, OctreeSettings, Vec3,
};

use crate::support::{Random, gpu_trial, own_context, refuse_each, trial};

const SEED: u64 = 20_261_125;

fn cases() -> Vec<(String, Vec<Vec3>)> {
    let lattice = |i: i32| Vec3::new((i % 9) as f32, (i / 9 % 9) as f32, (i / 81) as f32);
    let mut cases = vec![
        ("none".to_owned(), vec![]),
        ("one".to_owned(), vec![Vec3::new(3.0, -1.0, 7.0)]),
        ("all equal".to_owned(), vec![Vec3::new(3.0, -1.0, 7.0); 300]),
        ("two values".to_owned(), (0..300).map(|i| Vec3::splat((i % 2) as f32)).collect()),
        ("line".to_owned(), (0..900).map(|i| Vec3::new(i as f32, 0.0, 0.0)).collect()),
        ("exponential spacing".to_owned(), (0..400).map(|i| Vec3::splat(0.5f32.powi(i / 12))).collect()),
        ("borders of cells".to_owned(), (0..729).map(lattice).collect()),
        ("far faces".to_owned(), (0..729).map(lattice).filter(|p| p.max_element() == 8.0).collect()),
    ];
    for kind in [CloudKind::Uniform, CloudKind::Clustered, CloudKind::Shell] {
        cases.push((format!("{kind} 5000"), cloud(kind, 5000, SEED).points));
    }
    cases
}

fn settings() -> Vec<OctreeSettings> {
    let plain = OctreeSettings::default();
    vec![
        plain,
        plain.leaf_capacity(1),
        plain.leaf_capacity(7).curve(Curve::Hilbert),
        plain.leaf_capacity(3).max_level(4),
        plain.leaf_capacity(100_000),
        OctreeSettings::uniform(6).curve(Curve::Hilbert),
        OctreeSettings::uniform(0),
    ]
}

/// The first difference between two trees.
fn difference(found: &LinearOctree, expected: &LinearOctree) -> Option<String> {
    let first = |differs: Option<usize>, what: &str| differs.map(|i| format!("{what} {i}"));
    let words = |a: &[u32], b: &[u32], what: &str| match a.len() == b.len() {
        true => first((0..a.len()).find(|&i| a[i] != b[i]), what),
        false => Some(format!("number of {what}: {} and {}", a.len(), b.len())),
    };
    if (found.domain(), found.curve(), found.sorted_levels(), found.n_levels())
        != (expected.domain(), expected.curve(), expected.sorted_levels(), expected.n_levels())
    {
        return Some("domain, curve or levels".to_owned());
    }
    let (a, b) = (found.nodes(), expected.nodes());
    words(found.ordered_points().ids(), expected.ordered_points().ids(), "place of point")
        .or_else(|| (a.len() != b.len()).then(|| format!("number of nodes: {} and {}", a.len(), b.len())))
        .or_else(|| (0..a.len()).find(|&i| a[i] != b[i]).map(|i| format!("node {i}: {:?} and {:?}", a[i], b[i])))
        .or_else(|| words(found.pre_order_numbers(), expected.pre_order_numbers(), "pre-order of node"))
        .or_else(|| words(found.post_order_numbers(), expected.post_order_numbers(), "post-order of node"))
        .or_else(|| {
            (0..found.n_levels() as u32).find(|&l| found.level(l) != expected.level(l)).map(|l| format!("level {l}"))
        })
}

fn both(gpu: &Gpu, points: &[Vec3], settings: &OctreeSettings) -> (GpuLinearOctree, LinearOctree) {
    (GpuLinearOctree::build(gpu, points, settings).unwrap(), LinearOctree::build(points, settings).unwrap())
}

fn gpu_equals_the_cpu_to_the_bit(gpu: &Gpu) {
    for (name, points) in cases() {
        for settings in settings() {
            let (tree, cpu) = both(gpu, &points, &settings);
            let read = tree.read().unwrap();
            assert_eq!(difference(&read, &cpu), None, "{name}, {settings:?}");
            assert_eq!(read.broken_invariant(), None, "{name}, {settings:?}");
            assert_eq!(gpu.read(tree.pre_order()).unwrap(), cpu.pre_order(), "{name}, {settings:?}");
            assert_eq!(gpu.read(tree.post_order()).unwrap(), cpu.post_order(), "{name}, {settings:?}");
            assert!((0..23).all(|level| tree.level(level) == cpu.level(level)), "{name}, {settings:?}");
        }
    }
}

fn points_are_located_as_on_the_cpu(gpu: &Gpu) {
    let mut random = Random(SEED);
    for (name, points) in cases() {
        for settings in settings() {
            let (tree, cpu) = both(gpu, &points, &settings);
            let mut part = || (random.below(65) as f32 - 8.0) / 48.0;
            let around: Vec<Vec3> = (0..1000)
                .map(|_| cpu.domain().origin() + cpu.domain().edge() * Vec3::new(part(), part(), part()))
                .chain([Vec3::splat(f32::NAN), Vec3::splat(f32::INFINITY), Vec3::splat(-1e30)])
                .collect();
            for probes in [&points[..], &around, &[]] {
                assert_eq!(tree.locate(probes).unwrap(), cpu.locate(probes), "{name}, {settings:?}");
            }
        }
    }
}

fn leaves_know_the_leaves_around_them(gpu: &Gpu) {
    for (name, points) in cases() {
        for settings in [OctreeSettings::default(), OctreeSettings::default().leaf_capacity(2).curve(Curve::Hilbert)] {
            let (tree, cpu) = both(gpu, &points, &settings);
            let (found, expected) = (tree.leaf_neighbors().unwrap(), cpu.leaf_neighbors());
            assert!(found == expected, "{name}, {settings:?}");
        }
    }
}

/// A cloud whose tree is far from balanced: a dense cluster at the border of a large empty octant.
fn unbalanced() -> Vec<Vec3> {
    let far = cloud(CloudKind::Uniform, 200, SEED).points;
    let near = cloud(CloudKind::Uniform, 2000, SEED + 1).points;
    far.into_iter()
        .chain(near.into_iter().map(|p| Vec3::splat(0.5) + p * 0.004))
        .chain([Vec3::ZERO, Vec3::ONE])
        .collect()
}

fn balance_is_that_of_the_cpu(gpu: &Gpu) {
    for (name, points) in cases().into_iter().chain([("unbalanced".to_owned(), unbalanced())]) {
        for curve in Curve::ALL {
            let settings = OctreeSettings::default().leaf_capacity(4).curve(curve);
            let (tree, cpu) = both(gpu, &points, &settings);
            let balanced = cpu.balanced().unwrap();
            assert_eq!(balanced.broken_invariant(), None, "{name}, {curve}");
            let found = tree.balanced().unwrap();
            assert_eq!(difference(&found.read().unwrap(), &balanced), None, "{name}, {curve}");
            assert_eq!(found.read().unwrap().broken_invariant(), None, "{name}, {curve}");
            assert_eq!(found.locate(&points).unwrap(), balanced.locate(&points), "{name}, {curve}");
        }
    }
}

fn trees_cut_to_a_level_have_the_leaves_of_the_dense_octree(gpu: &Gpu) {
    for (name, points) in cases() {
        for curve in Curve::ALL {
            for level in 0..=4 {
                let dense = DenseOctree::build(&points, &DenseOctreeSettings::with_levels(level).curve(curve)).unwrap();
                let (tree, cpu) = both(gpu, &points, &OctreeSettings::uniform(level).curve(curve));
                let occupied: Vec<Octant> = dense
                    .leaves()
                    .filter(|(_, state)| *state == CellState::OccupiedLeaf)
                    .map(|(cell, _)| cell)
                    .collect();
                for tree in [&cpu, &tree.read().unwrap()] {
                    let leaves: Vec<Octant> = tree.leaves().map(|leaf| tree.nodes()[leaf as usize].octant).collect();
                    assert_eq!(leaves, occupied, "{name}, {curve}, level {level}");
                    for leaf in tree.leaves() {
                        let node = &tree.nodes()[leaf as usize];
                        assert_eq!(node.points(), dense.points_in(node.octant), "{name}, {curve}, level {level}");
                    }
                }
            }
        }
    }
}

fn builders_build_again_as_points_move(gpu: &Gpu) {
    let domain = Domain::new(Vec3::splat(-1.5), 4.0).unwrap();
    let settings = OctreeSettings::default().domain(domain).leaf_capacity(8);
    let mut builder = OctreeBuilder::new(gpu, 3000, &settings).unwrap();
    for (round, kind) in [CloudKind::Uniform, CloudKind::Clustered, CloudKind::Shell].into_iter().enumerate() {
        let points = cloud(kind, 3000, SEED + round as u64).points;
        let input: Vec<DevicePoint> =
            points.iter().enumerate().map(|(i, p)| [p.x, p.y, p.z, f32::from_bits(i as u32)]).collect();
        let tree = builder.build(&gpu.upload("points", &input).unwrap()).unwrap();
        let cpu = LinearOctree::build(&points, &settings).unwrap();
        assert_eq!(difference(&tree.read().unwrap(), &cpu), None, "{kind}");
    }
    let other = gpu.upload("points", &[[0.0f32; 4]; 5]).unwrap();
    assert!(matches!(builder.build(&other), Err(Error::LengthMismatch { found: 5, expected: 3000, .. })));
    let without = OctreeBuilder::new(gpu, 10, &OctreeSettings::default());
    assert!(matches!(without, Err(Error::InvalidSetting { setting: "domain", .. })));
}

fn wrong_input_is_an_error(gpu: &Gpu) {
    let domain = Domain::new(Vec3::ZERO, 1.0).unwrap();
    let settings = OctreeSettings::default().domain(domain);
    let mut points = vec![Vec3::ONE; 40];
    let build = |points: &[Vec3], settings: &OctreeSettings| GpuLinearOctree::build(gpu, points, settings);
    assert!(matches!(build(&points, &settings.max_level(22)), Err(Error::InvalidSetting { .. })));
    assert!(build(&points, &settings).is_ok());
    points[4].y = 1.5;
    points[7].z = -0.25;
    let error = build(&points, &settings).unwrap_err();
    assert!(matches!(error, Error::OutsideDomain { what: "points", count: 2, first: 4 }), "{error}");
    points[6].x = f32::NAN;
    let error = build(&points, &settings).unwrap_err();
    assert!(matches!(error, Error::NonFinite { what: "points", count: 1, first: 6 }), "{error}");
    // Points that are on the device already are looked at there.
    let input: Vec<DevicePoint> = points.iter().map(|p| [p.x, p.y, p.z, 0.0]).collect();
    let built = OctreeBuilder::new(gpu, 40, &settings).unwrap().build(&gpu.upload("points", &input).unwrap());
    assert!(matches!(built, Err(Error::OutsideDomain { what: "points", count: 3, first: 4 })), "{built:?}");
}

fn a_refused_allocation_is_an_error(gpu: &Gpu) {
    let own = own_context(gpu);
    let points = cloud(CloudKind::Clustered, 400, SEED).points;
    let settings = OctreeSettings::default().leaf_capacity(1);
    let cpu = LinearOctree::build(&points, &settings).unwrap();
    assert_eq!(cpu.sorted_levels(), MAX_LEVEL, "both widths of keys should be tried");
    let build = || GpuLinearOctree::build(&own, &points, &settings);
    let refused = refuse_each(&own, "build", build, |tree| tree.nodes().len() == cpu.nodes().len());
    assert!(refused >= 30, "{refused} allocations of a build");
    // A shallow tree: every level of a balance allocates.
    let points = cloud(CloudKind::Uniform, 200, SEED).points;
    let (tree, cpu) = both(&own, &points, &OctreeSettings::default().leaf_capacity(8));
    refuse_each(&own, "read", || tree.read(), |read| difference(read, &cpu).is_none());
    refuse_each(&own, "locate", || tree.locate(&points), |found| *found == cpu.locate(&points));
    refuse_each(&own, "neighbours", || tree.leaf_neighbors(), |found| *found == cpu.leaf_neighbors());
    let balanced = cpu.balanced().unwrap();
    refuse_each(&own, "balance", || tree.balanced(), |found| found.nodes().len() == balanced.nodes().len());
}

fn memory_is_told(gpu: &Gpu) {
    let points = cloud(CloudKind::Uniform, 5000, SEED).points;
    let (tree, cpu) = both(gpu, &points, &OctreeSettings::default());
    // 16 bytes a point and its index; 48 a node and four numbers.
    let least = 20 * points.len() as u64 + 64 * cpu.nodes().len() as u64;
    let told = NeighborSearch::memory_bytes(&tree);
    assert!((least..least + 1024).contains(&told), "{told} bytes told, {least} at least");
    assert!(NeighborSearch::memory_bytes(&cpu) >= 16 * points.len() as u64 + 56 * cpu.nodes().len() as u64);
}

fn periodic_trees_are_the_same(gpu: &Gpu) {
    let points = cloud(CloudKind::Uniform, 2000, SEED).points;
    let settings = OctreeSettings::default().periodic(Period::new(Vec3::new(1.0, 0.0, 2.0)).unwrap());
    let (tree, cpu) = both(gpu, &points, &settings);
    assert_eq!(difference(&tree.read().unwrap(), &cpu), None);
    assert_eq!(GpuStructure::features(&tree), [("periodic", true)]);
}

// ---- the checks themselves, and what needs no GPU ----

fn planted_differences_are_found() {
    let points = cloud(CloudKind::Uniform, 500, SEED).points;
    let build = |points: &[Vec3], settings: OctreeSettings| LinearOctree::build(points, &settings).unwrap();
    let plain = OctreeSettings::default();
    let sound = build(&points, plain);
    assert_eq!(difference(&sound, &sound), None);
    let contains = |found: Option<String>, what: &str| {
        assert!(found.as_ref().is_some_and(|f| f.contains(what)), "{what}: {found:?}")
    };
    let domain = plain.domain(*sound.domain());
    contains(difference(&build(&points, plain.curve(Curve::Hilbert)), &sound), "curve");
    contains(difference(&build(&points[1..], domain), &sound), "number of place");
    let mut swapped = points.clone();
    swapped.swap(0, 1);
    contains(difference(&build(&swapped, domain), &sound), "place of point");
    contains(difference(&build(&points, domain.leaf_capacity(5)), &sound), "levels");
}

/// Against the definition, pair by pair.
fn neighbours_are_all_pairs_that_touch() {
    for (name, points) in cases() {
        let points = &points[..points.len().min(800)];
        for curve in Curve::ALL {
            let tree = LinearOctree::build(points, &OctreeSettings::default().leaf_capacity(3).curve(curve)).unwrap();
            let found = tree.leaf_neighbors();
            assert!(found.leaves.iter().copied().eq(tree.leaves()), "{name}, {curve}");
            for (i, &leaf) in found.leaves.iter().enumerate() {
                let own = tree.nodes()[leaf as usize];
                let touches = |&&other: &&u32| {
                    let other = tree.nodes()[other as usize];
                    own != other
                        && (0..3).all(|a| own.low[a] <= other.high()[a] + 1 && other.low[a] <= own.high()[a] + 1)
                };
                let expected: Vec<u32> = found.leaves.iter().filter(touches).copied().collect();
                assert_eq!(found.row(i), expected, "{name}, {curve}: leaf {leaf}");
                for &other in &expected {
                    assert_eq!(tree.contact(leaf, other), tree.contact(other, leaf));
                    assert!(tree.contact(leaf, other).is_some());
                }
            }
        }
    }
}

/// A tree with eight leaves of one size: 7 neighbours each, 3 by a face, 3 by an edge, 1 by a corner.
fn octants_of_a_cube_touch_by_faces_edges_and_a_corner() {
    use nearfield::structure::linear_octree::Contact;
    let corners: Vec<Vec3> = (0..8).map(|i| Vec3::new((i >> 2) as f32, (i >> 1 & 1) as f32, (i & 1) as f32)).collect();
    let tree = LinearOctree::build(&corners, &OctreeSettings::uniform(1)).unwrap();
    let found = tree.leaf_neighbors();
    assert_eq!(found.offsets, (0..=8).map(|i| 7 * i).collect::<Vec<u64>>());
    for leaf in tree.leaves() {
        let contacts: Vec<Option<Contact>> = tree.leaves().map(|other| tree.contact(leaf, other)).collect();
        let count = |contact| contacts.iter().filter(|c| **c == contact).count();
        let counts = [Some(Contact::Face), Some(Contact::Edge), Some(Contact::Corner), None].map(count);
        assert_eq!(counts, [3, 3, 1, 1]);
    }
}

/// The leaves with points of the balanced complete octree, by the definition: octants without points are leaves too, and
/// leaves are cut until those that touch differ by at most one level.
fn balanced_by_definition(tree: &LinearOctree, points: &[Vec3]) -> BTreeSet<Octant> {
    let curve = tree.curve();
    let inner = tree.nodes().iter().filter(|node| !node.is_leaf());
    let mut leaves: BTreeSet<Octant> = inner.flat_map(|n| (0..8).map(|i| n.octant.child(i).unwrap())).collect();
    leaves.insert(Octant::ROOT);
    leaves.retain(|&leaf| tree.node_of(leaf).is_none_or(|node| tree.nodes()[node as usize].is_leaf()));
    let range = |leaf: &Octant| {
        let low = leaf.cell(curve).map(|c| c << (MAX_LEVEL - leaf.level()));
        [low, low.map(|c| c + (1 << (MAX_LEVEL - leaf.level())) - 1)]
    };
    let touch = |a: &Octant, b: &Octant| {
        let (a, b) = (range(a), range(b));
        (0..3).all(|axis| a[0][axis] <= b[1][axis] + 1 && b[0][axis] <= a[1][axis] + 1)
    };
    loop {
        let deepest = leaves.iter().map(|leaf| leaf.level()).max().unwrap_or(0);
        let too_large = |leaf: &&Octant| {
            leaf.level() + 1 < deepest && leaves.iter().any(|o| o.level() > leaf.level() + 1 && touch(leaf, o))
        };
        let Some(&leaf) = leaves.iter().find(too_large) else { break };
        leaves.remove(&leaf);
        leaves.extend((0..8).map(|i| leaf.child(i).unwrap()));
    }
    let keys: Vec<Octant> = points.iter().map(|&p| Octant::of_key(tree.domain().key_of(curve, p), MAX_LEVEL)).collect();
    leaves.retain(|leaf| keys.iter().any(|&key| leaf.contains(key)));
    leaves
}

fn balance_is_that_of_the_complete_octree() {
    for (name, points) in cases().into_iter().chain([("unbalanced".to_owned(), unbalanced())]) {
        // Few points and levels: the definition takes time.
        let step = points.len().div_ceil(60).max(1);
        let points: Vec<Vec3> = points.into_iter().step_by(step).collect();
        for curve in Curve::ALL {
            let settings = OctreeSettings::default().leaf_capacity(1).max_level(5).curve(curve);
            let tree = LinearOctree::build(&points, &settings).unwrap();
            let balanced = tree.balanced().unwrap();
            let octants: BTreeSet<Octant> =
                balanced.leaves().map(|leaf| balanced.nodes()[leaf as usize].octant).collect();
            let expected = if points.is_empty() { BTreeSet::new() } else { balanced_by_definition(&tree, &points) };
            assert!(octants == expected, "{name}, {curve}: {} leaves, expected {}", octants.len(), expected.len());
        }
    }
}

fn leaves_of_balanced_trees_differ_by_one_level_at_most() {
    for (name, points) in cases().into_iter().chain([("unbalanced".to_owned(), unbalanced())]) {
        let tree = LinearOctree::build(&points, &OctreeSettings::default().leaf_capacity(4)).unwrap();
        let balanced = tree.balanced().unwrap();
        assert_eq!(balanced.unbalanced_pair(), None, "{name}");
    }
    let tree = LinearOctree::build(&unbalanced(), &OctreeSettings::default().leaf_capacity(4)).unwrap();
    assert!(tree.unbalanced_pair().is_some(), "the case should be out of balance");
    assert!(tree.balanced().unwrap().nodes().len() > tree.nodes().len());
}

fn walks_go_in_their_orders() {
    let points = cloud(CloudKind::Shell, 3000, SEED).points;
    let tree = LinearOctree::build(&points, &OctreeSettings::default().curve(Curve::Hilbert)).unwrap();
    let octants = |nodes: Vec<u32>| nodes.into_iter().map(|n| tree.nodes()[n as usize].octant).collect::<Vec<_>>();
    assert!(octants(tree.pre_order()).is_sorted_by(|a, b| a < b), "an octant's order is that of pre-order");
    let last = |o: &Octant| (o.last_key(), std::cmp::Reverse(o.level()));
    assert!(octants(tree.post_order()).is_sorted_by(|a, b| last(a) < last(b)));
    let by_level: Vec<u32> = (0..tree.n_levels() as u32).flat_map(|l| tree.level(l)).map(|n| n as u32).collect();
    assert!(by_level.into_iter().eq(0..tree.nodes().len() as u32));
    assert!(tree.level(MAX_LEVEL + 1).is_empty() && tree.level(NONE).is_empty());
}

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("planted_differences_are_found", planted_differences_are_found),
        trial("neighbours_are_all_pairs_that_touch", neighbours_are_all_pairs_that_touch),
        trial(
            "octants_of_a_cube_touch_by_faces_edges_and_a_corner",
            octants_of_a_cube_touch_by_faces_edges_and_a_corner,
        ),
        trial("balance_is_that_of_the_complete_octree", balance_is_that_of_the_complete_octree),
        trial(
            "leaves_of_balanced_trees_differ_by_one_level_at_most",
            leaves_of_balanced_trees_differ_by_one_level_at_most,
        ),
        trial("walks_go_in_their_orders", walks_go_in_their_orders),
        gpu_trial("gpu_equals_the_cpu_to_the_bit", gpu_equals_the_cpu_to_the_bit),
        gpu_trial("points_are_located_as_on_the_cpu", points_are_located_as_on_the_cpu),
        gpu_trial("leaves_know_the_leaves_around_them", leaves_know_the_leaves_around_them),
        gpu_trial("balance_is_that_of_the_cpu", balance_is_that_of_the_cpu),
        gpu_trial(
            "trees_cut_to_a_level_have_the_leaves_of_the_dense_octree",
            trees_cut_to_a_level_have_the_leaves_of_the_dense_octree,
        ),
        gpu_trial("builders_build_again_as_points_move", builders_build_again_as_points_move),
        gpu_trial("wrong_input_is_an_error", wrong_input_is_an_error),
        gpu_trial("a_refused_allocation_is_an_error", a_refused_allocation_is_an_error),
        gpu_trial("memory_is_told", memory_is_told),
        gpu_trial("periodic_trees_are_the_same", periodic_trees_are_the_same),
    ]
}
