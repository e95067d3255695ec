//! Whether the answer of a chart is right, told without the code that is measured.

use nearfield::curve::MAX_LEVEL;
use nearfield::structure::CellState;
use nearfield::{Curve, DenseOctree, LinearOctree, Octant};
use rayon::prelude::*;

use super::method::Case;
use crate::{Error, Result};

/// The only right order: all indices, ascending by key and index.
///
/// # Errors
/// The first index that is out of place.
pub(super) fn check_order(case: &Case, order: &[u32]) -> Result<()> {
    let n = case.points.len();
    check_len("indices along the curve", order.len(), n)?;
    if let Some(place) = order.par_iter().position_first(|&index| index as usize >= n) {
        return Err(wrong(format!("index {} at place {place} of {n}", order[place])));
    }
    let place_of = |index: u32| (case.domain.key_of(Curve::Morton, case.points[index as usize]), index);
    // n ascending pairs of different indices are all of them.
    match order.par_windows(2).position_first(|pair| place_of(pair[0]) >= place_of(pair[1])) {
        None => Ok(()),
        Some(place) => Err(wrong(format!("point {} should not stand before {}", order[place], order[place + 1]))),
    }
}

/// Nodes, walks and order of the points are those of the case's tree, whose invariants were checked.
///
/// # Errors
/// The first difference.
pub(super) fn check_tree(case: &Case, tree: &LinearOctree) -> Result<()> {
    same("nodes", tree.nodes(), case.tree.nodes())?;
    same("numbers in pre-order", tree.pre_order_numbers(), case.tree.pre_order_numbers())?;
    same("numbers in post-order", tree.post_order_numbers(), case.tree.post_order_numbers())?;
    same("order of the points", tree.ordered_points().ids(), case.tree.ordered_points().ids())
}

/// The only right numbers: a node comes after its children and all that is below them, one behind the other along the
/// curve; cells that are null have none.
///
/// # Errors
/// The first cell with a wrong number.
pub(super) fn check_post_order(tree: &DenseOctree, numbers: &[u32]) -> Result<()> {
    let (layout, states) = (tree.layout(), tree.states());
    check_len("numbers of cells", numbers.len(), layout.cells())?;
    let children = |place: usize| {
        let cell = layout.cell(place);
        (0..8).filter_map(move |i| layout.place(cell.child(i)?))
    };
    // Nodes of each subtree, from the finest level up.
    let mut sizes = vec![0u32; layout.cells()];
    for place in (0..layout.cells()).rev().filter(|&place| states[place] != CellState::Null) {
        sizes[place] = 1 + children(place).map(|child| sizes[child]).sum::<u32>();
    }
    // First number of each subtree, from the root down.
    let mut firsts = vec![0u32; layout.cells()];
    for place in 0..layout.cells() {
        let expected = if sizes[place] == 0 { u32::MAX } else { firsts[place] + sizes[place] - 1 };
        if numbers[place] != expected {
            let cell = layout.cell(place);
            return Err(wrong(format!("{cell:?} has number {} in post-order, expected {expected}", numbers[place])));
        }
        let mut first = firsts[place];
        for child in children(place) {
            firsts[child] = first;
            first += sizes[child];
        }
    }
    Ok(())
}

/// Counts are those of another structure and of a plain loop; see [`crate::check::Expected`].
///
/// # Errors
/// The first count that is wrong.
pub(super) fn check_counts(case: &Case, counts: &[u32]) -> Result<()> {
    let expected = case.expected.as_ref().ok_or("neighbours of so many points are not counted")?;
    expected.check_counts(counts)
}

/// Each node holds its probe, and has no child that does: no other node is right.
///
/// # Errors
/// The first probe with a wrong node.
pub(super) fn check_locations(case: &Case, found: &[u32]) -> Result<()> {
    check_len("located nodes", found.len(), case.probes.len())?;
    let nodes = case.tree.nodes();
    let is_right = |i: usize| {
        let cell = Octant::of_key(case.domain.key_of(Curve::Morton, case.probes[i]), MAX_LEVEL);
        let node = nodes.get(found[i] as usize);
        node.is_some_and(|node| {
            node.octant.contains(cell) && !node.children().any(|child| nodes[child].octant.contains(cell))
        })
    };
    match (0..found.len()).into_par_iter().find_first(|&i| !is_right(i)) {
        None => Ok(()),
        Some(i) => Err(wrong(format!("node {} is not the smallest that holds {}", found[i], case.probes[i]))),
    }
}

fn check_len(what: &str, found: usize, expected: usize) -> Result<()> {
    if found == expected { Ok(()) } else { Err(wrong(format!("{found} {what}, expected {expected}"))) }
}

fn same<T: PartialEq>(what: &str, found: &[T], expected: &[T]) -> Result<()> {
    check_len(what, found.len(), expected.len())?;
    match found.iter().zip(expected).position(|(f, e)| f != e) {
        None => Ok(()),
        Some(first) => Err(wrong(format!("{what} differ from those of the tree, first at {first}"))),
    }
}

fn wrong(what: String) -> Error {
    format!("wrong answer: {what}").into()
}

#[cfg(test)]
mod tests {
    use nearfield::geometry::generate::CloudKind;
    use nearfield::{DenseOctreeSettings, FixedRadius, NeighborSearch, OctreeSettings, curve};

    use super::*;
    use crate::sets::Set;

    fn case() -> Case {
        Case::new(Set { kind: CloudKind::Clustered, n: 3000 }).expect("a case")
    }

    /// Makes a right answer wrong.
    type Plant<'a, T> = &'a dyn Fn(&mut Vec<T>);

    /// The right answer passes; shortened, lengthened and as each of `plant` makes it, it is refused.
    fn refuses<T: Clone>(check: impl Fn(&[T]) -> Result<()>, right: &[T], plant: &[Plant<'_, T>]) {
        check(right).expect("the right answer passes");
        let refused = |answer: &[T], what: String| {
            let error = check(answer).expect_err(&what);
            assert!(error.to_string().contains("wrong answer"), "{what}: {error}");
        };
        refused(&right[1..], "one less".to_owned());
        refused(&[right, &right[..1]].concat(), "one more".to_owned());
        for (number, plant) in plant.iter().enumerate() {
            let mut answer = right.to_vec();
            plant(&mut answer);
            refused(&answer, format!("planted {number}"));
        }
    }

    #[test]
    fn planted_wrong_orders_are_refused() {
        let case = case();
        let right = curve::order_in(&case.points, Curve::Morton, &case.domain).expect("an order");
        let along_hilbert = curve::order_in(&case.points, Curve::Hilbert, &case.domain).expect("an order");
        refuses(
            |order| check_order(&case, order),
            &right,
            &[
                &|order| order.swap(100, 101),
                &|order| order[7] = order[8],
                &|order| order[2999] = 3000,
                &|order| order.reverse(),
                &|order| order.clone_from(&along_hilbert),
            ],
        );
    }

    #[test]
    fn points_of_one_cell_out_of_their_order_are_refused() {
        let mut case = case();
        case.points[5] = case.points[9];
        let mut order = curve::order_in(&case.points, Curve::Morton, &case.domain).expect("an order");
        check_order(&case, &order).expect("the right answer passes");
        let place = order.iter().position(|&index| index == 5).expect("a permutation");
        assert_eq!(order[place + 1], 9);
        order.swap(place, place + 1);
        check_order(&case, &order).expect_err("9 before 5");
    }

    #[test]
    fn planted_wrong_trees_are_refused() {
        let case = case();
        let settings = OctreeSettings::default().domain(case.domain);
        let build = |settings| LinearOctree::build(&case.points, &settings).expect("a tree");
        check_tree(&case, &build(settings)).expect("the right tree passes");
        check_tree(&case, &build(settings.leaf_capacity(31))).expect_err("other leaves");
        check_tree(&case, &build(settings.curve(Curve::Hilbert))).expect_err("another curve");
        let mut points = case.points.clone();
        points.swap(0, 1);
        let tree = LinearOctree::build(&points, &settings).expect("a tree");
        check_tree(&case, &tree).expect_err("other indices");
        let right = case.tree.nodes();
        refuses(|nodes| same("nodes", nodes, right), right, &[&|nodes| nodes.swap(1, 2), &|nodes| nodes[3] = nodes[0]]);
    }

    #[test]
    fn planted_wrong_numbers_in_post_order_are_refused() {
        let case = case();
        for settings in [case.dense_settings(), DenseOctreeSettings::with_levels(0)] {
            let tree = DenseOctree::build(&case.points, &settings).expect("a tree");
            let right = tree.post_order_numbers();
            let pre_order = tree.pre_order_numbers();
            let last = right.len() - 1;
            refuses(|numbers| check_post_order(&tree, numbers), &right, &[&|numbers| numbers[last] ^= 1]);
            if last > 0 {
                let null = right.iter().position(|&number| number == u32::MAX).expect("a null cell");
                refuses(
                    |numbers| check_post_order(&tree, numbers),
                    &right,
                    &[
                        &|numbers| numbers.swap(0, 1),
                        // Siblings out of their order, though before their parent.
                        &|numbers| numbers.swap(1, 2),
                        &|numbers| numbers[null] = 0,
                        &|numbers| numbers[0] = u32::MAX,
                        &|numbers| numbers.clone_from(&pre_order),
                    ],
                );
            }
        }
    }

    #[test]
    fn planted_wrong_counts_are_refused() {
        let case = case();
        let radius = Set { kind: CloudKind::Clustered, n: 3000 }.radius();
        let count = |radius| case.tree.count(&FixedRadius::new(radius)).expect("counts").into_vec();
        let (right, of_another_radius) = (count(radius), count(1.1 * radius));
        refuses(
            |counts| check_counts(&case, counts),
            &right,
            &[&|counts| counts[2999] = 0, &|counts| counts[17] += 1000, &|counts| {
                counts.clone_from(&of_another_radius)
            }],
        );
    }

    #[test]
    fn planted_wrong_locations_are_refused() {
        let case = case();
        let right = case.tree.locate(&case.probes);
        refuses(
            |nodes| check_locations(&case, nodes),
            &right,
            &[
                // The root holds every probe, but so does a child of it.
                &|nodes| *nodes.iter_mut().find(|node| **node != 0).expect("a deeper node") = 0,
                &|nodes| nodes[2999] = u32::MAX,
                &|nodes| nodes[4] = case.tree.nodes().len() as u32 - 1 - nodes[4],
            ],
        );
    }
}
