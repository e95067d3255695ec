//! One traversal for queries that stand side by side, candidates tested as they come.
//!
//! Nodes are met by the distance between two boxes, that of the pack and that of the node, not by whether the swept box
//! overlaps them: a box has corners that no ball reaches, and they are most of it in many dimensions. Within a leaf that
//! the pack meets, queries that do not reach its box are left out.

use super::query_set::Pack;
use super::rows::Hits;
use super::{FixedRadiusN, SearchWork};
use crate::geometry::Scalar;
use crate::structure::AabbTreeN;
use crate::structure::aabb_tree::BoxN;
use crate::structure::aabb_tree::any_dimension::{PointsN, dist2_of_boxes, dist2_to_box, reach};

/// A query of the pack with what its search needs.
#[derive(Debug, Clone, Copy)]
pub(super) struct Asked<T, const D: usize> {
    position: [T; D],
    id: u32,
    radius2: T,
    reach2: T,
}

/// Finds the neighbours of the queries of a pack.
pub(super) fn search<T: Scalar, const D: usize>(
    tree: &AabbTreeN<T, D>,
    question: &FixedRadiusN<'_, T, D>,
    queries: &PointsN<T, D>,
    pack: &Pack,
    (asked, found): (&mut Vec<Asked<T, D>>, &mut Hits<T>),
) {
    let points = tree.ordered_points();
    asked.clear();
    asked.extend(pack.places.clone().map(|place| {
        let (position, id) = (queries.position(place), queries.ids()[place]);
        let radius = question.radius.of(id as usize);
        let reach = reach(radius);
        Asked { position, id, radius2: radius * radius, reach2: reach * reach }
    }));
    let around = asked.iter().fold(BoxN::EMPTY, |bounds, query| bounds.grown_to(&query.position));
    let reach2 = asked.iter().fold(T::of(0.0), |largest, query| largest.larger(query.reach2));
    let mut tests = 0;
    let nodes = tree.descend(
        0,
        |node| dist2_of_boxes(&around, node) <= reach2,
        |leaf| {
            let (places, bounds) = (tree.places(leaf), &tree.boxes()[leaf]);
            for (slot, query) in asked.iter().enumerate() {
                if dist2_to_box(&query.position, bounds) > query.reach2 {
                    continue;
                }
                tests += places.len() as u64;
                points.for_each_dist2(places.clone(), &query.position, |place, dist2| {
                    let index = points.ids()[place];
                    if dist2 <= query.radius2 && !(question.exclude_self && index == query.id) {
                        found.add(slot, index, dist2);
                    }
                });
            }
        },
    );
    found.work += SearchWork { traversals: 1, nodes, candidates: 0, tests };
}
