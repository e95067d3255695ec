//! The tree from sorted keys, on the CPU: leaves in closed form, then one walk along them.

use rayon::prelude::*;

use super::layout::{NONE, OctreeNode};
use crate::curve::{Curve, MAX_LEVEL, Octant};
use crate::parallel::chunk_len;
use crate::{Error, Result};

/// Chunks of points below this length cost more to hand out than to look at.
const SMALLEST_CHUNK: usize = 16_384;

/// A key that points are sorted by: the first bits of a 63-bit key.
pub(super) trait CurveKey: Copy + Send + Sync {
    /// Levels that two keys share, up to those that the key has.
    fn common_levels(self, other: Self) -> u32;
    /// The 63-bit key, zero behind the bits that are known.
    fn widened(self) -> u64;
}

/// 10 levels in 30 bits.
impl CurveKey for u32 {
    #[inline(always)]
    fn common_levels(self, other: Self) -> u32 {
        ((self ^ other).leading_zeros() - 2) / 3
    }

    #[inline(always)]
    fn widened(self) -> u64 {
        u64::from(self) << 33
    }
}

/// 21 levels in 63 bits.
impl CurveKey for u64 {
    #[inline(always)]
    fn common_levels(self, other: Self) -> u32 {
        ((self ^ other).leading_zeros() - 1) / 3
    }

    #[inline(always)]
    fn widened(self) -> u64 {
        self
    }
}

/// The first point of a leaf.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct LeafHead {
    /// Its place.
    pub(super) point: u32,
    /// Level of the largest octant that starts here: one more than this point shares with the point before.
    pub(super) top: u32,
    /// Level of the leaf. All octants from `top` to here start at this point; all but the leaf are inner nodes.
    pub(super) level: u32,
}

/// Whether more than `capacity` points share a cell at level `level` of the keys.
pub(super) fn is_overfull<K: CurveKey>(keys: &[K], capacity: usize, level: u32) -> bool {
    keys.len() > capacity
        && (0..keys.len() - capacity)
            .into_par_iter()
            .with_min_len(SMALLEST_CHUNK)
            .any(|i| keys[i].common_levels(keys[i + capacity]) >= level)
}

/// The leaves of the tree over sorted keys, cut where an octant has more than `capacity` points, down to `depth`.
pub(super) fn leaf_heads<K: CurveKey>(keys: &[K], capacity: usize, depth: u32) -> Vec<LeafHead> {
    let chunk = chunk_len(keys.len(), SMALLEST_CHUNK);
    (0..keys.len().div_ceil(chunk))
        .into_par_iter()
        .flat_map_iter(|c| {
            let places = c * chunk..keys.len().min((c + 1) * chunk);
            places.filter_map(|i| leaf_head(keys, capacity, depth, i))
        })
        .collect()
}

/// The leaf that starts at point `i`, if one does. Twin of `leaf_head` in leaves.wesl.
///
/// An inner node at level l is an octant with more than `capacity` points: it holds some point i and point i + capacity.
#[inline]
fn leaf_head<K: CurveKey>(keys: &[K], capacity: usize, depth: u32, i: usize) -> Option<LeafHead> {
    let n = keys.len();
    let top = if i == 0 { 0 } else { keys[i - 1].common_levels(keys[i]) + 1 };
    if top > depth {
        // The depth limit holds this point and the one before in one octant.
        return None;
    }
    // Inner nodes that start here are those from `top` on that point i + capacity is in, too.
    let inner_end = if i + capacity < n { (keys[i].common_levels(keys[i + capacity]) + 1).min(depth) } else { 0 };
    let point = i as u32;
    if inner_end > top {
        return Some(LeafHead { point, top, level: inner_end });
    }
    if top == 0 {
        return Some(LeafHead { point, top, level: inner_end });
    }
    // A leaf starts here if the octant that this point shares with the one before is an inner node.
    let shared = top - 1;
    let window = &keys[i.saturating_sub(capacity)..=i];
    let first = i + 1 - window.len() + window.partition_point(|key| key.common_levels(keys[i]) < shared);
    let is_inner = first + capacity < n && keys[first].common_levels(keys[first + capacity]) >= shared;
    is_inner.then_some(LeafHead { point, top, level: top })
}

/// Nodes in breadth-first order, and their numbers in the other orders.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Nodes {
    pub(super) nodes: Vec<OctreeNode>,
    /// First node of each level, and the number of nodes behind the last.
    pub(super) level_starts: Vec<u32>,
    pub(super) pre_order: Vec<u32>,
    pub(super) post_order: Vec<u32>,
}

/// Links the octants that start at the leaves' heads.
///
/// # Errors
/// `TooMany` where the nodes' numbers do not fit 32 bits.
pub(super) fn link<K: CurveKey>(keys: &[K], heads: &[LeafHead], curve: Curve) -> Result<Nodes> {
    let found: u64 = heads.iter().map(|head| u64::from(head.level - head.top) + 1).sum();
    if found >= u64::from(NONE) {
        let (limit, advice) = (u64::from(NONE) - 1, "use a larger leaf capacity or fewer levels");
        return Err(Error::TooMany { what: "nodes of the octree", found, limit, advice });
    }
    let mut counts = [0u32; MAX_LEVEL as usize + 1];
    for head in heads {
        counts[head.top as usize..=head.level as usize].iter_mut().for_each(|count| *count += 1);
    }
    let n_levels = counts.iter().take_while(|&&count| count > 0).count();
    let mut level_starts = vec![0];
    for &count in &counts[..n_levels] {
        level_starts.push(level_starts[level_starts.len() - 1] + count);
    }
    let n_nodes = level_starts[n_levels] as usize;
    let empty: OctreeNode = bytemuck::Zeroable::zeroed();
    let mut made =
        Nodes { nodes: vec![empty; n_nodes], pre_order: vec![0; n_nodes], post_order: vec![0; n_nodes], level_starts };
    // Next free node of each level, and the open node of each level.
    let mut next = made.level_starts.clone();
    let mut open = [NONE; MAX_LEVEL as usize + 1];
    let (mut pre, mut post) = (0, 0);
    let mut last_level = None;
    for head in heads {
        // Octants that do not hold this point end before it; the largest one that starts here follows them.
        if let Some(last) = last_level {
            close(&mut made, &open, head.top..=last, head.point, next[head.top as usize], &mut post);
        }
        let key = keys[head.point as usize].widened();
        for level in head.top..=head.level {
            let node = next[level as usize];
            next[level as usize] += 1;
            let octant = Octant::of_key(key, level);
            let parent = if level == 0 { NONE } else { open[level as usize - 1] };
            made.nodes[node as usize] = OctreeNode {
                low: octant.cell_range(curve)[0],
                level,
                first_point: head.point,
                first_child: NONE,
                octant,
                parent,
                ..empty
            };
            made.pre_order[node as usize] = pre;
            pre += 1;
            if let Some(parent) = made.nodes.get_mut(parent as usize) {
                parent.first_child = parent.first_child.min(node);
                parent.child_mask |= 1 << octant.child_index();
            }
            open[level as usize] = node;
        }
        last_level = Some(head.level);
    }
    if let Some(last) = last_level {
        close(&mut made, &open, 0..=last, keys.len() as u32, NONE, &mut post);
    }
    Ok(made)
}

/// Ends the open nodes of these levels, the deepest first.
fn close(made: &mut Nodes, open: &[u32], levels: std::ops::RangeInclusive<u32>, end: u32, rope: u32, post: &mut u32) {
    for level in levels.rev() {
        let node = open[level as usize] as usize;
        made.nodes[node].end_point = end;
        made.nodes[node].rope = rope;
        made.post_order[node] = *post;
        *post += 1;
    }
}
