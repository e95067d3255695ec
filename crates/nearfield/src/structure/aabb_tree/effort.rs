//! How much a traversal of the tree on a device can have to do: bounds for devices that end long loops.

use rayon::prelude::*;

use super::{AabbTree, TreeShape};
use crate::geometry::Aabb;
use crate::structure::Effort;

/// Invocations that may run in step on a device that does not say how many do.
pub(super) const MOST_IN_STEP: u32 = 64;

/// Upper bounds for balls of this radius around the points, or around any place within `queries`; `in_step` of them are
/// answered together, each on its own way through the tree.
pub(super) fn most(tree: &AabbTree, radius: f32, queries: Option<&Aabb>, in_step: u32) -> Effort {
    // Apart, invocations need not be in leaves at the same time.
    let one = match queries {
        Some(_) => everything(&tree.shape, tree.points.len()),
        None => around_leaves(tree, radius),
    };
    times(one, u64::from(in_step))
}

/// The same for packs that go through the tree together, whatever they ask; where they `split`, until some leave the pack.
pub(super) fn most_packed(shape: &TreeShape, n_points: usize, split: bool) -> Effort {
    // Those that leave a pack still take each step in the same round as the others, and no way has more steps than nodes,
    // of which half are leaves.
    times(everything(shape, n_points), if split { 2 } else { 1 })
}

/// All nodes and all points once.
fn everything(shape: &TreeShape, n_points: usize) -> Effort {
    // A loop over a leaf takes up to two rounds more than full ones.
    Effort { candidates: n_points as u64, rounds: shape.n_nodes() as u64 + 2 * shape.n_leaves() as u64 }
}

fn times(effort: Effort, factor: u64) -> Effort {
    Effort { candidates: effort.candidates * factor, rounds: effort.rounds * factor }
}

/// The same for invocations that go through the candidates of their pack, all in one loop, without a look at nodes.
pub(super) fn most_candidates(tree: &AabbTree, radius: f32, queries: Option<&Aabb>) -> Effort {
    let candidates = match queries {
        Some(_) => tree.points.len() as u64,
        None => around_leaves(tree, radius).candidates,
    };
    Effort { candidates, rounds: 0 }
}

/// The most that one invocation has to do in the region around a leaf, which meets no less than a ball around one of its
/// points does.
fn around_leaves(tree: &AabbTree, radius: f32) -> Effort {
    let (n_nodes, n_leaves) = (tree.boxes.len() as u64, tree.shape.n_leaves() as u64);
    let of_leaf = |leaf: usize| {
        let mut spans = Vec::new();
        let region = tree.region_near(&tree.boxes[leaf].to_aabb(), radius);
        let visited = tree.spans_in(&region, &mut spans) as u64;
        let candidates = spans.iter().map(|span| span.len() as u64).sum::<u64>();
        // Nodes inside the region were not entered; the kernel enters them.
        let smallest = (tree.points.len() as u64 / n_leaves).max(1);
        let leaves = (candidates / smallest + spans.len() as u64).min(n_leaves);
        Effort { candidates, rounds: (visited + 2 * leaves).min(n_nodes) + 2 * leaves }
    };
    let larger =
        |a: Effort, b: Effort| Effort { candidates: a.candidates.max(b.candidates), rounds: a.rounds.max(b.rounds) };
    let none = Effort { candidates: 0, rounds: 0 };
    tree.shape.leaves().into_par_iter().map(of_leaf).reduce(|| none, larger)
}
