//! Where a cell stands in the arrays of all levels, and its number in walks of the full tree. `layout.wesl` is the twin.
//!
//! The closed forms rest on Legendre's formula for base 8: ⌊p/8⌋ + ⌊p/8²⌋ + … = (p − s(p)) / 7, with s(p) the sum of the
//! octal digits of p.

use std::ops::Range;

use crate::curve::Octant;

/// The cells of all levels up to the finest, one level behind the other, each along the curve.
///
/// Places and numbers are below (8^(k + 1) − 1) / 7, at most 19,173,961.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CellLayout {
    levels: u32,
}

impl CellLayout {
    /// The layout with this finest level.
    ///
    /// # Panics
    /// If it is above [`super::MOST_LEVELS`].
    pub fn new(levels: u32) -> Self {
        assert!(levels <= super::MOST_LEVELS, "{levels} levels of a dense octree should have been refused");
        Self { levels }
    }

    /// The finest level, k.
    pub fn levels(self) -> u32 {
        self.levels
    }

    /// Cells of all levels: (8^(k + 1) − 1) / 7.
    pub fn cells(self) -> usize {
        first_of(self.levels + 1) as usize
    }

    /// Cells of the finest level: 8^k.
    pub fn finest(self) -> usize {
        1 << (3 * self.levels)
    }

    /// Places of the cells of a level; empty for a level that is too fine.
    pub fn level(self, level: u32) -> Range<usize> {
        let level = level.min(self.levels + 1);
        first_of(level) as usize..first_of((level + 1).min(self.levels + 1)) as usize
    }

    /// Place of a cell; `None` below the finest level.
    #[inline]
    pub fn place(self, cell: Octant) -> Option<usize> {
        let level = cell.level();
        (level <= self.levels).then(|| first_of(level) as usize + cell.key() as usize)
    }

    /// The cell at a place.
    ///
    /// # Panics
    /// If there is none.
    #[inline]
    pub fn cell(self, place: usize) -> Octant {
        assert!(place < self.cells(), "place {place} should be one of {} cells", self.cells());
        let (level, key) = level_and_key(place as u32);
        Octant::from_bits(1 << (3 * level) | u64::from(key)).expect("a level and a key should name an octant")
    }

    /// Number of a cell in the post-order walk of the full tree, from 0.
    ///
    /// Before cell p of level l come, by level: ⌊p / 8^(l − i)⌋ cells of the coarser levels i, p of its own, and
    /// (p + 1) · 8^(i − l) of the finer levels i: its descendants and what stands before them. The sum is
    /// (8p − s(p)) / 7 + (p + 1) · (8^(k − l + 1) − 8) / 7.
    #[inline]
    pub fn full_post_order(self, level: u32, key: u32) -> u32 {
        (8 * key - octal_digit_sum(key)) / 7 + (key + 1) * (first_of(self.levels - level + 1) - 1)
    }

    /// Number of a cell in the pre-order walk of the full tree, from 0: l ancestors, and the cells that stand before them
    /// and it with all their descendants; l + (p − s(p)) / 7 + p · (8^(k − l + 1) − 1) / 7.
    #[inline]
    pub fn full_pre_order(self, level: u32, key: u32) -> u32 {
        level + (key - octal_digit_sum(key)) / 7 + key * first_of(self.levels - level + 1)
    }

    /// How many cells of level `of` come before a cell in post-order: the first ones along the curve.
    #[inline]
    pub fn before_in_post_order(self, level: u32, key: u32, of: u32) -> u32 {
        if of <= level { key >> (3 * (level - of)) } else { (key + 1) << (3 * (of - level)) }
    }

    /// How many cells of level `of` come before a cell in pre-order: the first ones along the curve.
    #[inline]
    pub fn before_in_pre_order(self, level: u32, key: u32, of: u32) -> u32 {
        if of < level { (key >> (3 * (level - of))) + 1 } else { key << (3 * (of - level)) }
    }

    /// Null cells that come before a cell in a walk: those of a prefix of each level.
    ///
    /// - `nulls_before`: `[cells + 1]` null cells before each place
    /// - `before`: cells of each level before the cell in that walk
    #[inline]
    pub(super) fn nulls(self, nulls_before: &[u32], before: impl Fn(u32) -> u32) -> u32 {
        let of_level = |level: u32| {
            let first = first_of(level);
            nulls_before[(first + before(level)) as usize] - nulls_before[first as usize]
        };
        (0..=self.levels).map(of_level).sum()
    }
}

/// Place of the first cell of a level: (8^level − 1) / 7.
#[inline]
fn first_of(level: u32) -> u32 {
    ((1 << (3 * level)) - 1) / 7
}

/// Level and key of the cell at a place: 7 · place + 1 lies between 8^level and 8^(level + 1).
#[inline]
pub(super) fn level_and_key(place: u32) -> (u32, u32) {
    let level = (7 * place + 1).ilog2() / 3;
    (level, place - first_of(level))
}

/// Sum of the octal digits: ones, twos and fours counted by themselves.
#[inline]
fn octal_digit_sum(value: u32) -> u32 {
    const ONES: u32 = 0o11_111_111_111;
    (value & ONES).count_ones() + 2 * (value & ONES << 1).count_ones() + 4 * (value & ONES << 2).count_ones()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every cell in post-order and in pre-order, by a recursive walk.
    fn walk(cell: Octant, levels: u32, post: &mut Vec<Octant>, pre: &mut Vec<Octant>) {
        pre.push(cell);
        if cell.level() < levels {
            (0..8).for_each(|i| walk(cell.child(i).unwrap(), levels, post, pre));
        }
        post.push(cell);
    }

    #[test]
    fn closed_forms_number_the_full_tree_as_a_walk_does() {
        for levels in 0..=4 {
            let layout = CellLayout::new(levels);
            let (mut post, mut pre) = (vec![], vec![]);
            walk(Octant::ROOT, levels, &mut post, &mut pre);
            assert_eq!(post.len(), layout.cells());
            for (number, cell) in post.iter().enumerate() {
                let (level, key) = (cell.level(), cell.key() as u32);
                assert_eq!(layout.full_post_order(level, key), number as u32, "{cell:?} of {levels}");
                let before: u32 = (0..=levels).map(|of| layout.before_in_post_order(level, key, of)).sum();
                assert_eq!(before, number as u32, "{cell:?} of {levels}");
            }
            for (number, cell) in pre.iter().enumerate() {
                let (level, key) = (cell.level(), cell.key() as u32);
                assert_eq!(layout.full_pre_order(level, key), number as u32, "{cell:?} of {levels}");
                let before: u32 = (0..=levels).map(|of| layout.before_in_pre_order(level, key, of)).sum();
                assert_eq!(before, number as u32, "{cell:?} of {levels}");
            }
        }
    }

    #[test]
    fn the_deepest_tree_fits_the_closed_forms() {
        let layout = CellLayout::new(8);
        let last = (1 << 24) - 1;
        assert_eq!(layout.cells(), 19_173_961);
        assert_eq!(layout.full_post_order(0, 0), 19_173_960);
        // The last cell of the finest level comes before its eight ancestors only.
        assert_eq!(layout.full_post_order(8, last), 19_173_960 - 8);
        assert_eq!(layout.full_pre_order(8, last), 19_173_960);
    }

    #[test]
    fn places_and_cells_are_inverse() {
        for levels in [0, 1, 4, 8] {
            let layout = CellLayout::new(levels);
            for place in (0..layout.cells()).step_by(1 + layout.cells() / 5000).chain([layout.cells() - 1]) {
                let cell = layout.cell(place);
                assert_eq!(layout.place(cell), Some(place));
                assert!(layout.level(cell.level()).contains(&place));
            }
            assert_eq!(layout.place(Octant::ROOT.first_descendant(levels + 1).unwrap()), None);
            assert_eq!(layout.level(levels).len(), layout.finest());
            assert!(layout.level(levels + 1).is_empty() && layout.level(20).is_empty());
        }
    }
}
