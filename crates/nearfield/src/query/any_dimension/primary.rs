//! One traversal a query: algorithm 1 of Xing2017.

use super::query_set::Pack;
use super::rows::Hits;
use super::{FixedRadiusN, SearchWork};
use crate::geometry::Scalar;
use crate::structure::AabbTreeN;
use crate::structure::aabb_tree::any_dimension::{PointsN, dist2_to_box, reach};

/// Finds the neighbours of the one query of the pack: those in the leaf that it touches, then upwards those below the
/// other child of each node that the ball meets.
pub(super) fn search<T: Scalar, const D: usize>(
    tree: &AabbTreeN<T, D>,
    question: &FixedRadiusN<'_, T, D>,
    queries: &PointsN<T, D>,
    pack: &Pack,
    found: &mut Hits<T>,
) {
    let (points, place) = (tree.ordered_points(), pack.places.start);
    let (query, id) = (queries.position(place), queries.ids()[place]);
    let radius = question.radius.of(id as usize);
    let (radius2, reach) = (radius * radius, reach(radius));
    let reach2 = reach * reach;
    let mut tests = 0;
    let nodes = tree.back_traverse(
        pack.leaf,
        |node| dist2_to_box(&query, node) <= reach2,
        |leaf| {
            let places = tree.places(leaf);
            tests += places.len() as u64;
            points.for_each_dist2(places, &query, |place, dist2| {
                let index = points.ids()[place];
                if dist2 <= radius2 && !(question.exclude_self && index == id) {
                    found.add(0, index, dist2);
                }
            });
        },
    );
    found.work += SearchWork { traversals: 1, nodes, candidates: 0, tests };
}
