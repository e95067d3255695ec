//! The graph of neighbours that orientation is passed along, with the safest edges first: Hoppe's Riemannian graph.

use rayon::prelude::*;

use super::Normals;
use crate::Result;
use crate::application::Watch;
use crate::geometry::Scalar;
use crate::geometry::vector;
use crate::query::NearestFew;
use crate::structure::AabbTreeN;

/// Points between two reports of how far it is.
const BLOCK: usize = 1 << 14;
/// Points of a task.
const TASK: usize = 256;

/// An edge between two points, ordered by what it costs, then by its ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Edge {
    /// Bits of an f32 that is not negative: their order is that of the numbers.
    pub(super) cost: u32,
    pub(super) low: u32,
    pub(super) high: u32,
}

/// Edges from every point to its `k` nearest, sorted; those that both ends found stand twice. Points without a normal have
/// none. An edge costs 1 − |n·n′|.
pub(super) fn sorted_edges<T: Scalar>(
    tree: &AabbTreeN<T, 3>,
    normals: &Normals<T>,
    k: u32,
    watch: &mut Watch<'_>,
) -> Result<Vec<Edge>> {
    let cost = |a: u32, b: u32| {
        let [n, m] = [a, b].map(|i| normals.vectors[i as usize]);
        1.0 - vector::dot(n, m).to_f64().abs()
    };
    sorted_edges_by(tree, normals, k, watch, &cost)
}

/// The same with costs of one's own; negative ones count as 0.
pub(super) fn sorted_edges_by<T: Scalar>(
    tree: &AabbTreeN<T, 3>,
    normals: &Normals<T>,
    k: u32,
    watch: &mut Watch<'_>,
    cost: &(impl Fn(u32, u32) -> f64 + Sync),
) -> Result<Vec<Edge>> {
    let edge = |a: u32, b: u32| {
        let joined = a != b && normals.has(b as usize);
        let bits = |cost: f64| (cost.max(0.0) as f32).to_bits();
        joined.then(|| Edge { cost: bits(cost(a.min(b), a.max(b))), low: a.min(b), high: a.max(b) })
    };
    let points = tree.ordered_points();
    let n = points.len();
    // The nearest point is the point itself, or one at the same place.
    let places_of_row = (k as usize + 1).min(n);
    let mut edges = Vec::new();
    for first in (0..n).step_by(BLOCK) {
        watch.report("neighbour graph", first as u64, n as u64)?;
        let places: Vec<usize> = (first..n.min(first + BLOCK)).collect();
        let rows: Vec<Vec<Edge>> = places
            .par_chunks(TASK)
            .map_init(
                || NearestFew::new(places_of_row),
                |few, places| {
                    let mut row = Vec::with_capacity(places.len() * places_of_row);
                    for &place in places {
                        let id = points.ids()[place];
                        if normals.has(id as usize) {
                            tree.nearest_few(&points.position(place), T::of(f64::INFINITY), few);
                            row.extend(few.found().iter().filter_map(|&(_, other)| edge(id, other)));
                        }
                    }
                    row
                },
            )
            .collect();
        rows.iter().for_each(|row| edges.extend_from_slice(row));
    }
    edges.par_sort_unstable();
    Ok(edges)
}

/// Sets of points that are connected.
pub(super) struct Sets {
    parents: Vec<u32>,
}

impl Sets {
    /// Each point alone.
    pub(super) fn new(n: usize) -> Self {
        Self { parents: (0..n as u32).collect() }
    }

    /// The point that stands for the set of this one.
    pub(super) fn find(&mut self, mut point: u32) -> u32 {
        while self.parents[point as usize] != point {
            let above = self.parents[self.parents[point as usize] as usize];
            self.parents[point as usize] = above;
            point = above;
        }
        point
    }

    /// Makes one set of two; whether they were two. The lower point stands for both.
    pub(super) fn unite(&mut self, a: u32, b: u32) -> bool {
        let (a, b) = (self.find(a), self.find(b));
        self.parents[a.max(b) as usize] = a.min(b);
        a != b
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::AabbTreeNSettings;

    #[test]
    fn edges_are_sorted_by_cost_and_skip_points_without_normals() {
        let points: Vec<[f64; 3]> = (0..4).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default()).unwrap();
        let up = [0.0, 0.0, 1.0];
        let normals = Normals::of_vectors(&[up, [0.0, 0.6, -0.8], [0.0; 3], up]);
        let edges = sorted_edges(&tree, &normals, 9, &mut Watch::none()).unwrap();
        let found: Vec<(u32, u32, f32)> = edges.iter().map(|e| (e.low, e.high, f32::from_bits(e.cost))).collect();
        assert_eq!(found[0], (0, 3, 0.0));
        assert_eq!(found.len(), 6);
        assert!(found[2..].iter().all(|e| (e.2 - 0.2).abs() < 1e-6 && e.0 != 2 && e.1 != 2), "{found:?}");
    }

    #[test]
    fn sets_stand_for_their_lowest_point() {
        let mut sets = Sets::new(6);
        assert!(sets.unite(5, 3) && sets.unite(3, 4) && !sets.unite(4, 5));
        assert_eq!([0, 3, 4, 5].map(|point| sets.find(point)), [0, 3, 3, 3]);
    }
}
