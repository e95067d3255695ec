//! The octree against a recursive build on random and degenerate sets, for small and usual capacities.

use glam::Vec3;

use super::layout::NONE;
use super::{LinearOctree, OctreeSettings};
use crate::Error;
use crate::curve::{Curve, Domain, MAX_LEVEL, Octant};
use crate::geometry::generate::{CloudKind, cloud};

const SEED: u64 = 20_261_124;
const CAPACITIES: [u32; 11] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 32];

/// What the recursive build says of a node: octant, points' indices in any order, children.
#[derive(Debug)]
struct Plain {
    octant: Octant,
    points: Vec<u32>,
    children: Vec<Plain>,
}

/// The definition: an octant with more points than the capacity is cut into eight, empty ones are dropped.
fn recursive(octant: Octant, points: Vec<u32>, keys: &[u64], capacity: usize, depth: u32) -> Plain {
    let mut children = vec![];
    if points.len() > capacity && octant.level() < depth {
        for index in 0..8 {
            let child = octant.child(index).unwrap();
            let inside = |&&i: &&u32| child.contains(Octant::of_key(keys[i as usize], MAX_LEVEL));
            let own: Vec<u32> = points.iter().filter(inside).copied().collect();
            if !own.is_empty() {
                children.push(recursive(child, own, keys, capacity, depth));
            }
        }
    }
    Plain { octant, points, children }
}

/// Nodes of the plain tree in pre-order with their post-order numbers.
fn flattened<'a>(node: &'a Plain, post: &mut u32, out: &mut Vec<(&'a Plain, u32)>) {
    let place = out.len();
    out.push((node, 0));
    for child in &node.children {
        flattened(child, post, out);
    }
    out[place].1 = *post;
    *post += 1;
}

/// Fails unless the tree is the recursive one, node by node.
fn assert_is_recursive(points: &[Vec3], settings: &OctreeSettings, case: &str) {
    let tree = LinearOctree::build(points, settings).unwrap_or_else(|error| panic!("{case}: {error}"));
    if let Some(broken) = tree.broken_invariant() {
        panic!("{case}: {broken}");
    }
    if points.is_empty() {
        assert!(tree.nodes().is_empty() && tree.n_levels() == 0, "{case}");
        return;
    }
    let keys: Vec<u64> = points.iter().map(|&p| tree.domain().key_of(settings.curve, p)).collect();
    let all = (0..points.len() as u32).collect();
    let plain = recursive(Octant::ROOT, all, &keys, settings.leaf_capacity as usize, settings.max_level);
    let mut expected = vec![];
    flattened(&plain, &mut 0, &mut expected);
    assert_eq!(tree.nodes().len(), expected.len(), "{case}: number of nodes");
    for (pre, (node, (plain, post))) in tree.pre_order().into_iter().zip(expected).enumerate() {
        let found = &tree.nodes()[node as usize];
        assert_eq!(found.octant, plain.octant, "{case}: octant of node {node}");
        let mut ids: Vec<u32> = tree.ordered_points().ids()[found.points()].to_vec();
        ids.sort_unstable();
        assert_eq!(ids, plain.points, "{case}: points of node {node}");
        assert_eq!(found.children().len(), plain.children.len(), "{case}: children of node {node}");
        assert_eq!(tree.pre_order_numbers()[node as usize], pre as u32, "{case}: pre-order of node {node}");
        assert_eq!(tree.post_order_numbers()[node as usize], post, "{case}: post-order of node {node}");
        assert_eq!(tree.node_of(found.octant), Some(node), "{case}: finding node {node}");
    }
}

/// Named sets of points that trees get wrong.
fn sets() -> Vec<(String, Vec<Vec3>)> {
    let mut sets = vec![
        ("no points".to_owned(), vec![]),
        ("one point".to_owned(), vec![Vec3::new(3.0, -1.0, 7.0)]),
        ("all equal".to_owned(), vec![Vec3::new(3.0, -1.0, 7.0); 70]),
        ("two values".to_owned(), (0..90).map(|i| Vec3::splat((i % 2) as f32)).collect()),
        (
            "two values a ulp apart".to_owned(),
            (0..60).map(|i| Vec3::splat(if i < 40 { 1.0 } else { 1.0f32.next_up() })).collect(),
        ),
        ("line".to_owned(), (0..200).map(|i| Vec3::new(i as f32, 0.0, 0.0)).collect()),
        ("exponential spacing".to_owned(), (0..150).map(|i| Vec3::splat(0.5f32.powi(i / 5))).collect()),
        (
            "far outlier".to_owned(),
            (0..100).map(|i| if i == 7 { Vec3::splat(1e9) } else { Vec3::splat(i as f32) }).collect(),
        ),
        // Coordinates 0 to 8 in a domain of edge 8: on the borders of cells, the far faces included.
        (
            "lattice on the borders of cells".to_owned(),
            (0..729).map(|i| Vec3::new((i % 9) as f32, (i / 9 % 9) as f32, (i / 81) as f32)).collect(),
        ),
        (
            "far faces".to_owned(),
            (0..192)
                .map(|i| {
                    let (a, b) = ((i % 8) as f32 / 7.0, (i / 8 % 8) as f32 / 7.0);
                    [Vec3::new(1.0, a, b), Vec3::new(a, 1.0, b), Vec3::new(a, b, 1.0)][i / 64]
                })
                .collect(),
        ),
    ];
    for kind in [CloudKind::Uniform, CloudKind::Clustered, CloudKind::Shell, CloudKind::Plummer] {
        for (round, n) in [2, 9, 33, 100, 400, 1500].into_iter().enumerate() {
            sets.push((format!("{kind:?} {n}"), cloud(kind, n, SEED + round as u64).points));
        }
    }
    sets
}

#[test]
fn every_tree_is_the_recursive_one() {
    let mut built = 0;
    for (name, points) in sets() {
        for capacity in CAPACITIES {
            for (curve, depth) in [(Curve::Morton, MAX_LEVEL), (Curve::Hilbert, MAX_LEVEL), (Curve::Morton, 3)] {
                // Trees that are cut to the last cell are long: a few of them are enough.
                let depth = if capacity == 0 { depth.min(12) } else { depth };
                let settings = OctreeSettings::default().leaf_capacity(capacity).curve(curve).max_level(depth);
                assert_is_recursive(
                    &points,
                    &settings,
                    &format!("{name}, capacity {capacity}, {curve}, depth {depth}"),
                );
                built += 1;
            }
        }
    }
    assert!(built > 1000, "only {built} trees");
}

#[test]
fn every_depth_limit_is_kept() {
    let points = cloud(CloudKind::Clustered, 600, SEED).points;
    for depth in 0..=MAX_LEVEL {
        assert_is_recursive(
            &points,
            &OctreeSettings::default().leaf_capacity(2).max_level(depth),
            &format!("depth {depth}"),
        );
    }
}

#[test]
fn points_that_ten_levels_do_not_part_are_sorted_deeper() {
    let close = |i: u32| Vec3::splat(i as f32 * 1e-5);
    let points: Vec<Vec3> = (0..100).map(close).chain([Vec3::ONE]).collect();
    let tree = LinearOctree::build(&points, &OctreeSettings::default().leaf_capacity(4)).unwrap();
    assert_eq!((tree.sorted_levels(), tree.broken_invariant()), (MAX_LEVEL, None));
    let shallow = LinearOctree::build(&points, &OctreeSettings::default().max_level(10)).unwrap();
    assert_eq!((shallow.sorted_levels(), shallow.broken_invariant()), (10, None));
    let spread =
        LinearOctree::build(&cloud(CloudKind::Uniform, 1000, SEED).points, &OctreeSettings::default()).unwrap();
    assert_eq!(spread.sorted_levels(), 10);
}

#[test]
fn points_are_located_in_their_leaves_and_others_in_the_smallest_node() {
    let points = cloud(CloudKind::Shell, 2000, SEED).points;
    for curve in Curve::ALL {
        let tree = LinearOctree::build(&points, &OctreeSettings::default().leaf_capacity(5).curve(curve)).unwrap();
        for (i, node) in tree.locate(&points).into_iter().enumerate() {
            let node = &tree.nodes()[node as usize];
            assert!(node.is_leaf(), "point {i}");
            assert!(tree.ordered_points().ids()[node.points()].contains(&(i as u32)), "point {i}");
        }
        for probe in cloud(CloudKind::Uniform, 2000, SEED + 1).points {
            // From the corner of the unit cube to that of the shell's domain.
            let probe = probe * tree.domain().edge() + tree.domain().origin();
            let octant = Octant::of_key(tree.domain().key_of(curve, probe), MAX_LEVEL);
            let around = (0..tree.nodes().len() as u32).filter(|&i| tree.nodes()[i as usize].octant.contains(octant));
            let deepest = around.max_by_key(|&i| tree.nodes()[i as usize].level);
            assert_eq!(tree.locate_at(probe), deepest, "{probe}");
        }
        assert_eq!(tree.locate(&[Vec3::splat(9.0), Vec3::NAN]), [NONE, NONE]);
    }
}

#[test]
fn points_outside_a_given_domain_are_an_error_with_the_first_index() {
    let domain = Domain::new(Vec3::ZERO, 1.0).unwrap();
    let settings = OctreeSettings::default().domain(domain);
    let mut points = vec![Vec3::splat(0.5), Vec3::ONE, Vec3::ZERO];
    assert!(LinearOctree::build(&points, &settings).is_ok(), "corners are inside");
    points.extend([Vec3::new(0.5, 1.1, 0.5), Vec3::splat(0.1), Vec3::new(0.5, -0.1, 0.5)]);
    let error = LinearOctree::build(&points, &settings).unwrap_err();
    assert!(matches!(error, Error::OutsideDomain { what: "points", count: 2, first: 3 }), "{error}");
    points[4].z = f32::NAN;
    let error = LinearOctree::build(&points, &settings).unwrap_err();
    assert!(matches!(error, Error::NonFinite { count: 1, first: 4, .. }), "{error}");
}

#[test]
fn a_depth_limit_beyond_the_keys_is_refused() {
    let error = LinearOctree::build(&[Vec3::ZERO], &OctreeSettings::default().max_level(22)).unwrap_err();
    assert!(matches!(error, Error::InvalidSetting { setting: "max_level", .. }), "{error}");
}

#[test]
fn planted_breaks_are_found() {
    let points = cloud(CloudKind::Uniform, 500, SEED).points;
    let sound = LinearOctree::build(&points, &OctreeSettings::default().leaf_capacity(8)).unwrap();
    let broken = |number: char, plant: &dyn Fn(&mut LinearOctree)| {
        let mut tree = sound.clone();
        plant(&mut tree);
        let found = tree.broken_invariant();
        assert!(found.as_ref().is_some_and(|b| b.starts_with(number)), "{number}: {found:?}");
    };
    let last = sound.nodes().len() - 1;
    broken('1', &|tree| tree.settings.curve = Curve::Hilbert);
    broken('2', &|tree| tree.nodes.nodes[last].end_point -= 1);
    broken('3', &|tree| tree.settings.leaf_capacity = 2);
    broken('4', &|tree| tree.nodes.level_starts[1] += 1);
    broken('5', &|tree| tree.nodes.nodes[last].parent -= 1);
    broken('5', &|tree| tree.nodes.nodes[1].rope += 1);
    broken('6', &|tree| tree.nodes.post_order.swap(0, 1));
    broken('p', &|tree| tree.packs.truncate(1));
}
