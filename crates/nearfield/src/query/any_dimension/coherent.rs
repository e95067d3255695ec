//! One traversal a leaf with queries, whose candidates are kept and then tested: algorithm 2 of Xing2017.
//!
//! It differs where each query has a radius of its own: the paper sweeps the leaf's box by the largest radius of the pack,
//! twice that where any query lies outside the box; here each query asks for its own radius, or twice that, and the
//! largest counts. A query without neighbours keeps an empty row, which the paper's compaction drops.

use super::query_set::Pack;
use super::rows::Hits;
use super::{FixedRadiusN, SearchWork};
use crate::geometry::Scalar;
use crate::structure::AabbTreeN;
use crate::structure::aabb_tree::any_dimension::{PointsN, is_swept_near, reach};

/// Finds the neighbours of the queries that touch one leaf.
pub(super) fn search<T: Scalar, const D: usize>(
    tree: &AabbTreeN<T, D>,
    question: &FixedRadiusN<'_, T, D>,
    queries: &PointsN<T, D>,
    pack: &Pack,
    (candidates, found): (&mut Vec<u32>, &mut Hits<T>),
) {
    let points = tree.ordered_points();
    let around = &tree.boxes()[pack.leaf];
    // Definitions 2a and 2b: the radius, or twice that from a query outside the box.
    let swept = pack.places.clone().fold(T::of(0.0), |largest, place| {
        let reach = reach(question.radius.of(queries.ids()[place] as usize));
        let is_inside = around.contains(&queries.position(place));
        largest.larger(if is_inside { reach } else { reach + reach })
    });
    candidates.clear();
    let nodes = tree.back_traverse(
        pack.leaf,
        |node| is_swept_near(around, swept, node),
        |leaf| candidates.extend(tree.places(leaf).map(|place| place as u32)),
    );
    for &candidate in candidates.iter() {
        let (position, index) = (points.position(candidate as usize), points.ids()[candidate as usize]);
        queries.for_each_dist2(pack.places.clone(), &position, |place, dist2| {
            let id = queries.ids()[place];
            let radius = question.radius.of(id as usize);
            if dist2 <= radius * radius && !(question.exclude_self && index == id) {
                found.add(place - pack.places.start, index, dist2);
            }
        });
    }
    let n_candidates = candidates.len() as u64;
    let tests = n_candidates * pack.places.len() as u64;
    found.work += SearchWork { traversals: 1, nodes, candidates: n_candidates, tests };
}
