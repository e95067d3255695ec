//! Disjoint sets that many threads join at once, without locks (Jayanti2016). Every set is a tree whose root is its smallest member.

use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering::Relaxed;

use rayon::prelude::*;

/// Members that one thread looks at.
const TASK: usize = 1 << 12;

/// A forest over the members 0 to n − 1, of which some may be in no set.
///
/// Relaxed order is enough: a parent is all that is shared, it is only ever replaced by a smaller ancestor, and what the threads did
/// is read after they have been joined.
pub(super) struct UnionFind {
    parents: Vec<AtomicU32>,
}

impl UnionFind {
    /// Parent of what is in no set.
    pub(super) const NONE: u32 = super::labels::NONE;

    /// Each member alone, where it is in a set.
    pub(super) fn of(in_set: &[bool]) -> Self {
        let parent = |(i, &is): (usize, &bool)| AtomicU32::new(if is { i as u32 } else { Self::NONE });
        Self { parents: in_set.par_iter().enumerate().with_min_len(TASK).map(parent).collect() }
    }

    /// The smallest member of the set of `member`, which must be in one.
    pub(super) fn find(&self, member: u32) -> u32 {
        let mut at = member;
        loop {
            let parent = self.parents[at as usize].load(Relaxed);
            if parent == at {
                return at;
            }
            let grandparent = self.parents[parent as usize].load(Relaxed);
            if grandparent == parent {
                return parent;
            }
            // Halves the way for the next one; another thread may have found a smaller ancestor.
            self.parents[at as usize].fetch_min(grandparent, Relaxed);
            at = grandparent;
        }
    }

    /// Joins the sets of two members, which must be in one each.
    pub(super) fn join(&self, a: u32, b: u32) {
        let (mut a, mut b) = (a, b);
        loop {
            (a, b) = (self.find(a), self.find(b));
            if a == b {
                return;
            }
            let (low, high) = (a.min(b), a.max(b));
            // It fails where another thread has hooked this root: then somebody has got on, and the search goes on from there.
            if self.parents[high as usize].compare_exchange(high, low, Relaxed, Relaxed).is_ok() {
                return;
            }
        }
    }

    /// `[n]` the smallest member of each one's set, [`UnionFind::NONE`] without one.
    pub(super) fn roots(&self) -> Vec<u32> {
        let root = |i: usize| match self.parents[i].load(Relaxed) {
            Self::NONE => Self::NONE,
            parent => self.find(parent),
        };
        (0..self.parents.len()).into_par_iter().with_min_len(TASK).map(root).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joined_members_have_the_smallest_as_root() {
        let sets = UnionFind::of(&[true, true, false, true, true, true]);
        sets.join(5, 3);
        sets.join(4, 5);
        assert_eq!(sets.roots(), [0, 1, UnionFind::NONE, 3, 3, 3]);
        sets.join(1, 4);
        assert_eq!(sets.roots(), [0, 1, UnionFind::NONE, 1, 1, 1]);
    }

    #[test]
    fn chains_joined_by_many_threads_are_one_set() {
        let n = 20_000u32;
        let sets = UnionFind::of(&vec![true; n as usize]);
        // Neighbours and far ones, so that threads meet at the same roots; multiples of seven stay apart from the others.
        let joins = (1..n).into_par_iter().filter(|i| i % 7 != 0);
        joins.for_each(|i| {
            let before = if i % 7 == 1 { i.saturating_sub(2) } else { i - 1 };
            sets.join(i, if before % 7 == 0 { 1 } else { before });
        });
        let roots = sets.roots();
        assert!((0..n).all(|i| roots[i as usize] == if i % 7 == 0 { i } else { 1 }));
    }
}
