//! An octree as full arrays: one array of 8^i cells for each level i up to k, pruned from the bottom.
//!
//! The arrays are the space-filling curves of all levels at once: the cell at place c of level i is the parent of the
//! cells 8·c … 8·c + 7 of level i + 1, so a parent or a child is a shift away and no pointer is stored. The build goes
//! from level k up: a thread a parent checks eight children; if all eight are empty they become null and the parent a
//! leaf, otherwise the parent is an inner node and all eight stay. Leaves are therefore occupied cells of level k, and
//! empty cells of any level.
//!
//! Source: Ajmera2008, the poster's own method, as a reproduction and as a second reference for tests. Its parts:
//! - *parallel SFC construction*: the cell of every point by [`Domain`](crate::Domain), its key, and a stable sort of
//!   the points by key;
//! - *parallel octree construction*: the loop over the levels, one kernel a level;
//! - *location of the cell containing the queried point*: `locate`, up from the cell at level k to the first that is
//!   not null;
//! - *parallel post-order traversal*: `post_order_numbers`, the number in the notional full tree (a closed form) minus
//!   the null cells before it (k + 1 look-ups in a scan), and its inverse `post_order`; pre-order by the same means;
//! - *containment*, *child containing a descendant*, *least common ancestor*: [`Octant`](crate::Octant), on keys alone;
//! - *range of the points of a cell*: `points_in`. *Nearest neighbours and range queries* are not answered here: the
//!   queries of the library run on other structures.
//!
//! Differs: points are sorted too, so that each cell has its range of them; Hilbert's curve as well as Morton's, as the
//! method only needs keys whose prefixes are the ancestors' keys; all levels lie in one array; any domain.
//!
//! Cost: memory by the cells, not by the points. On the CPU 5 bytes a cell and 4 more a cell of level k (163 MB at
//! level 8), on the GPU 8 and 4 (220 MB, and 144 MB more while it is built), and 16 or 20 bytes a point; the build
//! sorts n keys and reads every cell. Use it to compare with; for all else a tree of the occupied cells alone is smaller
//! and has more levels.
//!
//! Invariants, checked by `validate.rs`:
//! 1. the order is a permutation, sorted by the key at level k, ties by the caller's index;
//! 2. `starts` is monotone from 0 to n, and cell c of level k holds the points `starts[c]..starts[c + 1]`;
//! 3. a cell of level k with points is an occupied leaf, a cell of another level with points is inner;
//! 4. a cell without points is null if its parent has no points, else an empty leaf, as is the root;
//! 5. `nulls_before` holds the number of null cells before each place of the array, and of all at its end.

mod cpu;
#[cfg(feature = "gpu")]
mod gpu;
mod layout;
mod settings;
#[cfg(test)]
mod tests;
mod validate;

pub use cpu::DenseOctree;
#[cfg(feature = "gpu")]
pub use gpu::GpuDenseOctree;
pub use layout::CellLayout;
pub use settings::DenseOctreeSettings;

/// Most levels below the root: 8⁸ cells, 19 million with all levels together.
pub const MOST_LEVELS: u32 = 8;

/// What a cell is in the pruned tree. The kernels write the same numbers.
#[repr(u8)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum CellState {
    /// Not in the tree: pruned with its seven siblings, or below such a cell.
    Null = 0,
    /// A leaf without points.
    EmptyLeaf = 1,
    /// A leaf with points, at the finest level.
    OccupiedLeaf = 2,
    /// A node with eight children.
    Inner = 3,
}

impl CellState {
    /// Whether the cell is a leaf of the tree.
    pub fn is_leaf(self) -> bool {
        matches!(self, Self::EmptyLeaf | Self::OccupiedLeaf)
    }

    /// The state of this number.
    #[cfg(feature = "gpu")]
    fn of_word(word: u32) -> Option<Self> {
        [Self::Null, Self::EmptyLeaf, Self::OccupiedLeaf, Self::Inner].get(word as usize).copied()
    }
}
