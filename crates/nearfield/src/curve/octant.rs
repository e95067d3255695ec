//! Octants: cells of any level, as keys that know their level. `octant.wesl` is the twin of this file.

use super::{Curve, Domain, MAX_LEVEL};
use crate::geometry::Aabb;

/// A cell of an octree at some level, named by a 1 bit and behind it the 3·level bits of its key: the root is 1, its
/// children are 8 to 15.
///
/// All relations but those that name a place in space (`neighbor`, `cell`, `bounds`) hold for either curve, as a key's
/// prefix is the ancestor's key. Every operation takes constant time.
///
/// Zeroed memory is no octant; asked anyway, it answers as the root.
///
/// The order is that of a pre-order walk: along the curve, an octant before its descendants.
#[repr(transparent)]
#[derive(Clone, Copy, PartialEq, Eq, Hash, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Octant(u64);

impl Octant {
    /// The whole domain, at level 0.
    pub const ROOT: Self = Self(1);

    /// The octant at `level` that holds the cell with this 63-bit key.
    ///
    /// # Panics
    /// If the level is above [`MAX_LEVEL`] or the key has more than 63 bits.
    #[inline(always)]
    pub fn of_key(key: u64, level: u32) -> Self {
        assert!(level <= MAX_LEVEL && key < 1 << 63, "key {key:#x} at level {level} should be a cell");
        Self((1 << 63 | key) >> (3 * (MAX_LEVEL - level)))
    }

    /// The octant with these bits, if they name one.
    pub fn from_bits(bits: u64) -> Option<Self> {
        (bits != 0 && bits.ilog2().is_multiple_of(3)).then_some(Self(bits))
    }

    /// The bits: a 1, and behind it the key.
    #[inline(always)]
    pub fn bits(self) -> u64 {
        self.0
    }

    /// Level: 0 for the root.
    #[inline(always)]
    pub fn level(self) -> u32 {
        (63 - (self.0 | 1).leading_zeros()) / 3
    }

    /// The key among the cells of its own level.
    #[inline(always)]
    pub fn key(self) -> u64 {
        self.0 & !(1 << (3 * self.level()))
    }

    /// The smallest 63-bit key of a cell inside.
    #[inline(always)]
    pub fn first_key(self) -> u64 {
        (self.0 | u64::from(self.0 == 0)) << (self.0 | 1).leading_zeros() & !(1 << 63)
    }

    /// The largest 63-bit key of a cell inside.
    #[inline(always)]
    pub fn last_key(self) -> u64 {
        self.first_key() | ((1 << (self.0 | 1).leading_zeros()) - 1)
    }

    /// Whether `other` is this octant or inside it.
    #[inline(always)]
    pub fn contains(self, other: Self) -> bool {
        let (own, others) = (self.0.leading_zeros(), other.0.leading_zeros());
        own >= others && other.0 >> (own - others) == self.0
    }

    /// Whether the two share no cell.
    #[inline(always)]
    pub fn is_disjoint(self, other: Self) -> bool {
        !self.contains(other) && !other.contains(self)
    }

    /// The octant around this one; `None` for the root.
    #[inline(always)]
    pub fn parent(self) -> Option<Self> {
        (self.0 != 1).then_some(Self(self.0 >> 3))
    }

    /// The octant at `level` that contains this one; `None` if this one's level is smaller.
    #[inline(always)]
    pub fn ancestor(self, level: u32) -> Option<Self> {
        let own = self.level();
        (level <= own).then(|| Self(self.0 >> (3 * (own - level))))
    }

    /// Child `index` (0 to 7) along the curve; `None` at [`MAX_LEVEL`] or for another index.
    #[inline(always)]
    pub fn child(self, index: u32) -> Option<Self> {
        (self.0 >> 63 == 0 && index < 8).then(|| Self(self.0 << 3 | u64::from(index)))
    }

    /// The child that contains `descendant`; `None` unless that is inside this octant and smaller.
    #[inline(always)]
    pub fn child_towards(self, descendant: Self) -> Option<Self> {
        if self == descendant || !self.contains(descendant) {
            return None;
        }
        descendant.ancestor(self.level() + 1)
    }

    /// The smallest octant that contains both.
    #[inline(always)]
    pub fn common_ancestor(self, other: Self) -> Self {
        let level = self.level().min(other.level());
        let (a, b) = (self.0 >> (3 * (self.level() - level)), other.0 >> (3 * (other.level() - level)));
        // The bits from the first difference down, in whole levels.
        let levels = (64 - (a ^ b).leading_zeros()).div_ceil(3);
        Self(a >> (3 * levels))
    }

    /// Which child of its parent this is, 0 to 7 along the curve; 0 for the root.
    #[inline(always)]
    pub fn child_index(self) -> u32 {
        if self.0 == 1 { 0 } else { (self.0 & 7) as u32 }
    }

    /// Child `index` of the parent; `None` for the root or an index above 7.
    #[inline(always)]
    pub fn sibling(self, index: u32) -> Option<Self> {
        self.parent()?.child(index)
    }

    /// The first descendant at `level`; `None` outside this level … [`MAX_LEVEL`].
    pub fn first_descendant(self, level: u32) -> Option<Self> {
        let own = self.level();
        (own..=MAX_LEVEL).contains(&level).then(|| Self(self.0 << (3 * (level - own))))
    }

    /// The last descendant at `level`; `None` outside this level … [`MAX_LEVEL`].
    pub fn last_descendant(self, level: u32) -> Option<Self> {
        let first = self.first_descendant(level)?;
        Some(Self(first.0 | ((1 << (3 * (level - self.level()))) - 1)))
    }

    /// The next octant of the same level along the curve; `None` behind the last.
    #[inline(always)]
    pub fn next(self) -> Option<Self> {
        let next = self.0.wrapping_add(1);
        (next != 0 && next.leading_zeros() == self.0.leading_zeros()).then_some(Self(next))
    }

    /// The octant of the same level before this one along the curve; `None` for the first.
    #[inline(always)]
    pub fn previous(self) -> Option<Self> {
        let previous = self.0 - 1;
        (previous.leading_zeros() == self.0.leading_zeros()).then_some(Self(previous))
    }

    /// Coordinates among the 2^level cells an axis of its level.
    #[inline]
    pub fn cell(self, curve: Curve) -> [u32; 3] {
        curve.decode(self.first_key()).map(|c| c >> (MAX_LEVEL - self.level()))
    }

    /// The octant at `level` with these coordinates; `None` outside the domain or above [`MAX_LEVEL`].
    pub fn of_cell(curve: Curve, cell: [u32; 3], level: u32) -> Option<Self> {
        let inside = level <= MAX_LEVEL && cell.iter().all(|&c| u64::from(c) < 1 << level);
        inside.then(|| Self::of_key(curve.encode(cell.map(|c| c << (MAX_LEVEL - level))), level))
    }

    /// The octant of the same level one step along `direction` (−1, 0 or 1 by axis); `None` outside the domain.
    pub fn neighbor(self, curve: Curve, direction: [i32; 3]) -> Option<Self> {
        let cell = self.cell(curve);
        let mut moved = [0; 3];
        for axis in 0..3 {
            moved[axis] = cell[axis].checked_add_signed(direction[axis])?;
        }
        Self::of_cell(curve, moved, self.level())
    }

    /// Smallest and largest cell at [`MAX_LEVEL`] inside.
    #[inline]
    pub fn cell_range(self, curve: Curve) -> [[u32; 3]; 2] {
        let shift = MAX_LEVEL - self.level();
        let low = self.cell(curve).map(|c| c << shift);
        [low, low.map(|c| c + ((1 << shift) - 1))]
    }

    /// A box that holds every point of the domain whose cell is inside; see [`Domain::bounds_of`].
    pub fn bounds(self, curve: Curve, domain: &Domain) -> Aabb {
        let [low, high] = self.cell_range(curve);
        domain.bounds_of(low, high)
    }
}

impl Ord for Octant {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.first_key().cmp(&other.first_key()).then(self.level().cmp(&other.level()))
    }
}

impl PartialOrd for Octant {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl std::fmt::Debug for Octant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Octant(level {}, key {:#o})", self.level(), self.key())
    }
}
