//! The dense octree against an explicit tree that is built and walked by recursion.

use glam::Vec3;

use crate::curve::{Curve, Domain, MAX_LEVEL, Octant};
use crate::structure::{CellState, DenseOctree, DenseOctreeSettings};
use crate::{Error, Result};

const SEED: u64 = 20_261_124;

/// A node of the explicit tree: its eight children, or none.
struct Node {
    octant: Octant,
    points: Vec<u32>,
    children: Vec<Node>,
}

/// Splits a node with points until the finest level, by the coordinates of cells at that level.
fn explicit(curve: Curve, levels: u32, corner: [u32; 3], level: u32, cells: &[[u32; 3]], points: Vec<u32>) -> Node {
    let octant = Octant::of_cell(curve, corner, level).unwrap();
    if level == levels || points.is_empty() {
        return Node { octant, points, children: vec![] };
    }
    let shift = levels - level - 1;
    let child = |i: u32| {
        let corner = [2 * corner[0] + (i >> 2), 2 * corner[1] + (i >> 1 & 1), 2 * corner[2] + (i & 1)];
        let inside = |&p: &u32| cells[p as usize].map(|c| c >> shift) == corner;
        explicit(curve, levels, corner, level + 1, cells, points.iter().copied().filter(inside).collect())
    };
    let mut children: Vec<Node> = (0..8).map(child).collect();
    children.sort_by_key(|node| node.octant);
    Node { octant, points, children }
}

impl Node {
    fn state(&self) -> CellState {
        match (self.children.is_empty(), self.points.is_empty()) {
            (false, _) => CellState::Inner,
            (true, true) => CellState::EmptyLeaf,
            (true, false) => CellState::OccupiedLeaf,
        }
    }

    fn post_order<'a>(&'a self, nodes: &mut Vec<&'a Node>) {
        self.children.iter().for_each(|child| child.post_order(nodes));
        nodes.push(self);
    }

    fn pre_order<'a>(&'a self, nodes: &mut Vec<&'a Node>) {
        nodes.push(self);
        self.children.iter().for_each(|child| child.pre_order(nodes));
    }
}

fn explicit_tree(tree: &DenseOctree, points: &[Vec3]) -> Node {
    let levels = tree.layout().levels();
    let cells: Vec<[u32; 3]> =
        points.iter().map(|&p| tree.domain().cell_of(p).map(|c| c >> (MAX_LEVEL - levels))).collect();
    explicit(tree.curve(), levels, [0; 3], 0, &cells, (0..points.len() as u32).collect())
}

/// The first difference from the explicit tree in nodes, states, points, numbers, walks, leaves or locations.
fn difference(tree: &DenseOctree, points: &[Vec3]) -> Option<String> {
    let root = explicit_tree(tree, points);
    let (mut post, mut pre) = (vec![], vec![]);
    root.post_order(&mut post);
    root.pre_order(&mut pre);
    if tree.n_nodes() != post.len() {
        return Some(format!("{} nodes, expected {}", tree.n_nodes(), post.len()));
    }
    let nodes = |walk: &[&Node]| walk.iter().map(|node| (node.octant, node.state())).collect::<Vec<_>>();
    if tree.post_order() != nodes(&post) || tree.pre_order() != nodes(&pre) {
        return Some("a walk differs".into());
    }
    let (post_numbers, pre_numbers) = (tree.post_order_numbers(), tree.pre_order_numbers());
    let mut numbered = 0;
    for (walk, numbers, single) in [
        (&post, &post_numbers, DenseOctree::post_order_number as fn(&DenseOctree, Octant) -> Option<u32>),
        (&pre, &pre_numbers, DenseOctree::pre_order_number),
    ] {
        for (number, node) in walk.iter().enumerate() {
            let place = tree.layout().place(node.octant).unwrap();
            if numbers[place] != number as u32 || single(tree, node.octant) != Some(number as u32) {
                return Some(format!("number of {:?} is {}, expected {number}", node.octant, numbers[place]));
            }
        }
        numbered += numbers.iter().filter(|&&number| number != u32::MAX).count();
    }
    if numbered != 2 * post.len() {
        return Some("a null cell has a number".into());
    }
    for node in &post {
        if tree.state_of(node.octant) != node.state() {
            return Some(format!("{:?} is {:?}", node.octant, tree.state_of(node.octant)));
        }
        // Points of a cell come by finer cells, and in the caller's order in a finest cell.
        let mut found = tree.points().ids()[tree.points_in(node.octant)].to_vec();
        if !node.state().is_leaf() {
            found.sort_unstable();
        }
        if found != node.points {
            return Some(format!("points of {:?} are {found:?}, expected {:?}", node.octant, node.points));
        }
    }
    let leaves = || post.iter().filter(|node| node.children.is_empty());
    if !tree.leaves().eq(leaves().map(|node| (node.octant, node.state()))) {
        return Some("the leaves differ".into());
    }
    let located = tree.locate(points).unwrap();
    let of_point = |p: u32| leaves().find(|node| node.points.contains(&p)).map(|node| node.octant);
    let wrong = (0..points.len() as u32).find(|&p| located[p as usize] != of_point(p));
    wrong.map(|p| format!("point {p} is located in {:?}", located[p as usize]))
}

/// Reproducible numbers from 0 to below 1 (SplitMix64).
fn random() -> impl FnMut() -> f32 {
    let mut state = SEED;
    move || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u32 << 24) as f32
    }
}

fn cases() -> Vec<(&'static str, Vec<Vec3>)> {
    let mut unit = random();
    let mut point = || Vec3::new(unit(), unit(), unit());
    let lattice = |n: u32| {
        let part = move |i: u32| i as f32 / n as f32;
        (0..=n).flat_map(move |x| (0..=n).flat_map(move |y| (0..=n).map(move |z| Vec3::new(part(x), part(y), part(z)))))
    };
    vec![
        ("none", vec![]),
        ("one", vec![Vec3::new(3.0, -2.0, 7.0)]),
        ("random", (0..300).map(|_| 10.0 * point() - 5.0).collect()),
        ("clustered", (0..300).map(|i| Vec3::splat((i % 3) as f32) + 0.01 * point()).collect()),
        ("line", (0..100).map(|i| Vec3::new(i as f32, 0.5, 0.5)).collect()),
        ("all equal", vec![Vec3::new(0.1, 0.2, 0.3); 50]),
        ("two values", (0..50).map(|i| Vec3::splat((i % 2) as f32)).collect()),
        ("borders of cells", lattice(8).collect()),
        ("far faces", lattice(4).filter(|p| p.max_element() == 1.0).chain([Vec3::ZERO]).collect()),
        ("one octant", (0..100).map(|_| 0.2 * point()).chain([Vec3::ONE]).collect()),
    ]
}

#[test]
fn it_equals_the_explicit_tree() {
    for (name, points) in cases() {
        for curve in Curve::ALL {
            for levels in 0..=4 {
                let case = format!("{name}, {curve}, {levels} levels");
                let tree = DenseOctree::build(&points, &DenseOctreeSettings::with_levels(levels).curve(curve)).unwrap();
                assert_eq!(tree.broken_invariant(), None, "{case}");
                assert_eq!(difference(&tree, &points), None, "{case}");
            }
        }
    }
}

#[test]
fn planted_differences_are_found() {
    let points: Vec<Vec3> = cases().swap_remove(2).1;
    let sound = DenseOctree::build(&points, &DenseOctreeSettings::with_levels(3)).unwrap();
    assert_eq!(difference(&sound, &points), None);
    let found = |plant: &dyn Fn(&mut DenseOctree)| {
        let mut tree = sound.clone();
        plant(&mut tree);
        difference(&tree, &points).is_some()
    };
    let place = |state: CellState| sound.states().iter().rposition(|&s| s == state).unwrap();
    assert!(found(&|t| t.states[place(CellState::EmptyLeaf)] = CellState::OccupiedLeaf));
    assert!(found(&|t| t.states[place(CellState::Null)] = CellState::EmptyLeaf));
    assert!(found(&|t| t.nulls_before[t.layout.cells()] -= 1));
    assert!(found(&|t| {
        let middle = t.starts.iter().position(|&s| s > 100).unwrap();
        t.starts[middle] -= 1;
    }));
    let mut moved = points.clone();
    moved[17] = sound.domain().origin();
    assert!(difference(&sound, &moved).is_some());
}

#[test]
fn the_posters_cell_has_number_46() {
    // Cell (3, 1, 2) of four along each axis.
    let domain = Domain::new(Vec3::ZERO, 4.0).unwrap();
    let settings = DenseOctreeSettings::with_levels(2).domain(domain);
    let tree = DenseOctree::build(&[Vec3::new(3.5, 1.0, 2.25)], &settings).unwrap();
    let leaf = tree.locate(&[Vec3::new(3.0, 1.5, 2.9)]).unwrap()[0].unwrap();
    assert_eq!((leaf.level(), leaf.key()), (2, 46));
    assert_eq!(tree.state_of(leaf), CellState::OccupiedLeaf);
    // Root, its eight children, and those of child 5 = 46 / 8. Before the leaf stand children 0 to 4 and its six siblings.
    assert_eq!(tree.n_nodes(), 1 + 8 + 8);
    assert_eq!(tree.post_order_number(leaf), Some(5 + 6));
    assert_eq!(tree.pre_order_number(leaf), Some(1 + 5 + 1 + 6));
    assert_eq!(tree.post_order_number(Octant::ROOT), Some(16));
    assert_eq!(tree.post_order_number(Octant::ROOT.first_descendant(2).unwrap()), None);
    assert_eq!(tree.states_of(2).iter().filter(|&&s| s == CellState::Null).count(), 56);
}

#[test]
fn no_points_make_one_empty_leaf() {
    for levels in [0, 3] {
        let tree = DenseOctree::build(&[], &DenseOctreeSettings::with_levels(levels)).unwrap();
        assert_eq!(tree.post_order(), [(Octant::ROOT, CellState::EmptyLeaf)]);
        assert_eq!(tree.locate(&[Vec3::splat(0.5), Vec3::splat(2.0)]).unwrap(), [Some(Octant::ROOT), None]);
    }
}

#[test]
fn eight_levels_fit_and_hold() {
    let points: Vec<Vec3> = cases().swap_remove(2).1;
    let tree = DenseOctree::build(&points, &DenseOctreeSettings::with_levels(8)).unwrap();
    // The invariants of the 19 million cells, without the explicit tree's walks.
    assert_eq!(tree.broken_invariant(), None);
    let nodes = tree.post_order();
    assert_eq!(nodes.last(), Some(&(Octant::ROOT, CellState::Inner)));
    assert!(nodes.iter().enumerate().all(|(i, &(cell, _))| tree.post_order_number(cell) == Some(i as u32)));
    let inner = nodes.iter().filter(|(_, state)| *state == CellState::Inner).count();
    assert_eq!(nodes.len(), 1 + 8 * inner);
}

#[test]
fn points_outside_a_given_domain_are_an_error_with_the_first() {
    let settings = DenseOctreeSettings::with_levels(3).domain(Domain::new(Vec3::ZERO, 1.0).unwrap());
    let mut points = vec![Vec3::ONE; 10];
    assert!(DenseOctree::build(&points, &settings).is_ok());
    points[4].y = 1.5;
    points[7].z = -0.25;
    let error = DenseOctree::build(&points, &settings).unwrap_err();
    assert!(matches!(error, Error::OutsideDomain { what: "points", count: 2, first: 4 }), "{error}");
}

#[test]
fn points_that_are_not_finite_are_an_error() {
    let points = [Vec3::ZERO, Vec3::new(f32::NAN, 0.0, 0.0), Vec3::ONE];
    for settings in
        [DenseOctreeSettings::default(), DenseOctreeSettings::default().domain(Domain::new(Vec3::ZERO, 1.0).unwrap())]
    {
        let error = DenseOctree::build(&points, &settings).unwrap_err();
        assert!(matches!(error, Error::NonFinite { what: "points", count: 1, first: 1 }), "{error}");
    }
    let tree = DenseOctree::build(&points[2..], &DenseOctreeSettings::default()).unwrap();
    assert!(matches!(tree.locate(&points), Err(Error::NonFinite { what: "queries", first: 1, .. })));
}

#[test]
fn nine_levels_are_refused() {
    let error = DenseOctree::build(&[], &DenseOctreeSettings::with_levels(9)).unwrap_err();
    assert!(matches!(error, Error::InvalidSetting { .. }), "{error}");
}

#[test]
fn memory_is_checked_before_it_is_asked_for() {
    let build = |max_memory| -> Result<DenseOctree> {
        DenseOctree::build(&[Vec3::ONE; 10], &DenseOctreeSettings::with_levels(8).max_memory(max_memory))
    };
    let error = build(1 << 20).unwrap_err();
    let Error::OutOfMemory { needed, available, .. } = error else { panic!("{error}") };
    // Five bytes for each of 19,173,961 cells, four for each of 8^8, and some for ten points.
    assert!((162_978_669..162_980_000).contains(&needed) && available == 1 << 20, "{error}");
    assert!(matches!(build(needed - 1), Err(Error::OutOfMemory { .. })));
    let tree = build(needed).unwrap();
    assert!(tree.memory_bytes() <= needed + 1024);
}
