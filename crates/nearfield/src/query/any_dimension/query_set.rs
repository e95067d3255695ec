//! Queries in the order in which they are searched, cut into packs.

use std::borrow::Cow;
use std::ops::Range;

use rayon::prelude::*;

use super::QueriesN;
use super::answers::SearchWork;
use super::question::RadiusN;
use crate::geometry::Scalar;
use crate::structure::aabb_tree::any_dimension::PointsN;
use crate::structure::{AabbTreeN, TreeSearch, TreeShape};

/// Most queries of a packed search that are answered together.
const PACK: usize = 64;
/// Queries whose leaf one thread looks for at a time.
const LOCATED_BY_ONE: usize = 1 << 9;

/// Queries that stand side by side.
#[derive(Debug, Clone)]
pub(super) struct Pack {
    /// Where they stand in the set.
    pub(super) places: Range<usize>,
    /// The leaf that they touch; for a packed search the root.
    pub(super) leaf: usize,
}

/// Queries in searching order and their packs. Queries that touch no leaf stand in no pack: they have no neighbours.
pub(super) struct QuerySet<'a, T: Scalar, const D: usize> {
    pub(super) points: Cow<'a, PointsN<T, D>>,
    pub(super) packs: Vec<Pack>,
    /// Nodes looked at to find leaves.
    pub(super) nodes: u64,
}

impl<'a, T: Scalar, const D: usize> QuerySet<'a, T, D> {
    /// The queries packed as the tree's search needs them.
    pub(super) fn new(tree: &'a AabbTreeN<T, D>, queries: QueriesN<'_, T, D>, radius: RadiusN<'_, T>) -> Self {
        let search = tree.settings().search;
        match queries {
            QueriesN::Points => {
                let packs = own_packs(&tree.shape(), search);
                Self { points: Cow::Borrowed(tree.ordered_points()), packs, nodes: 0 }
            }
            QueriesN::Other(_) if tree.is_empty() => {
                Self { points: Cow::Owned(PointsN::gather(&[], vec![])), packs: vec![], nodes: 0 }
            }
            QueriesN::Other(queries) => match search {
                TreeSearch::Packed => Self::by_nearest_leaf(tree, queries),
                TreeSearch::Primary | TreeSearch::Coherent => Self::by_touching_leaf(tree, queries, radius),
            },
        }
    }

    /// Queries in the order of the leaves that are near them, however far.
    pub(super) fn by_nearest_leaf(tree: &AabbTreeN<T, D>, queries: &[[T; D]]) -> Self {
        let key = |(i, query): (usize, &[T; D])| (tree.nearest_leaf(query) as u32, i as u32);
        let mut keys: Vec<(u32, u32)> = queries.par_iter().with_min_len(LOCATED_BY_ONE).enumerate().map(key).collect();
        keys.par_sort_unstable();
        // Leaves below one node are searched together, as many as a pack of the points has.
        let shape = tree.shape();
        let levels = shape.depth() - pack_level(&shape);
        let mut packs: Vec<Pack> = Vec::new();
        for (place, &(leaf, _)) in keys.iter().enumerate() {
            let node = (leaf + 1) >> levels;
            match packs.last_mut() {
                Some(last) if last.leaf == node as usize && last.places.len() < PACK => last.places.end += 1,
                _ => packs.push(Pack { places: place..place + 1, leaf: node as usize }),
            }
        }
        packs.iter_mut().for_each(|pack| pack.leaf = 0);
        Self::gather(queries, &keys, packs, u64::from(shape.depth()) * 2 * queries.len() as u64)
    }

    fn by_touching_leaf(tree: &AabbTreeN<T, D>, queries: &[[T; D]], radius: RadiusN<'_, T>) -> Self {
        let key = |(i, query): (usize, &[T; D])| {
            let (radius, mut nodes) = (radius.of(i), 0);
            let leaf = tree.touching_leaf(query, radius * radius, &mut nodes);
            (leaf.map(|leaf| (leaf as u32, i as u32)), nodes)
        };
        let located: Vec<_> = queries.par_iter().with_min_len(LOCATED_BY_ONE).enumerate().map(key).collect();
        let nodes = located.iter().map(|(_, nodes)| nodes).sum();
        let mut keys: Vec<(u32, u32)> = located.into_iter().filter_map(|(key, _)| key).collect();
        keys.par_sort_unstable();
        let is_primary = tree.settings().search == TreeSearch::Primary;
        let mut packs: Vec<Pack> = Vec::new();
        for (place, &(leaf, _)) in keys.iter().enumerate() {
            match packs.last_mut() {
                Some(last) if !is_primary && last.leaf == leaf as usize => last.places.end += 1,
                _ => packs.push(Pack { places: place..place + 1, leaf: leaf as usize }),
            }
        }
        Self::gather(queries, &keys, packs, nodes)
    }

    fn gather(queries: &[[T; D]], keys: &[(u32, u32)], packs: Vec<Pack>, nodes: u64) -> Self {
        let order = keys.iter().map(|&(_, i)| i).collect();
        Self { points: Cow::Owned(PointsN::gather(queries, order)), packs, nodes }
    }

    /// Cuts packs into tasks of about `n_queries` queries; ranges of pack numbers.
    pub(super) fn tasks(&self, n_queries: usize) -> Vec<Range<usize>> {
        let (mut tasks, mut first, mut waiting) = (Vec::new(), 0, 0);
        for (number, pack) in self.packs.iter().enumerate() {
            waiting += pack.places.len();
            if waiting >= n_queries {
                tasks.push(first..number + 1);
                (first, waiting) = (number + 1, 0);
            }
        }
        if first < self.packs.len() {
            tasks.push(first..self.packs.len());
        }
        tasks
    }

    /// What finding the packs took.
    pub(super) fn work(&self) -> SearchWork {
        SearchWork { nodes: self.nodes, ..SearchWork::default() }
    }
}

/// The level of the nodes whose points make a pack: at most [`PACK`] points, and no deeper than the leaves.
fn pack_level(shape: &TreeShape) -> u32 {
    let is_small = |&level: &u32| shape.level(level).all(|node| shape.points(node).len() <= PACK);
    (0..shape.depth()).find(is_small).unwrap_or(shape.depth())
}

/// The packs of the tree's own points.
fn own_packs(shape: &TreeShape, search: TreeSearch) -> Vec<Pack> {
    match search {
        TreeSearch::Primary => {
            let pack = |place| Pack { places: place..place + 1, leaf: shape.leaf_of(place) };
            (0..shape.n_points()).map(pack).collect()
        }
        TreeSearch::Coherent => {
            let packs = shape.leaves().map(|leaf| Pack { places: shape.points(leaf), leaf });
            packs.filter(|pack| !pack.places.is_empty()).collect()
        }
        TreeSearch::Packed => {
            let packs = shape.level(pack_level(shape)).map(|node| Pack { places: shape.points(node), leaf: 0 });
            packs.filter(|pack| !pack.places.is_empty()).collect()
        }
    }
}
