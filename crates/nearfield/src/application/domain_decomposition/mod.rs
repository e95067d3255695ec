//! Domain decomposition: points split into parts of equal work that are contiguous along a space-filling curve.
//!
//! A curve through the domain puts all cells in a line; cutting the line into p ranges gives p parts. The parts balance
//! because a cut can be anywhere on the line, their surfaces are small because cells that are near on the line are near
//! in space, and p − 1 keys say where every point lives, also points that are not there yet: nothing has to be looked up
//! at another part.
//!
//! Source: Ajmera2008, "spatial domain decomposition" and "data ownership"; the poster gives the idea, not the cuts.
//! Differs: leaves of the octree with any weights can be split beside single points, the curve can be Hilbert's, and the
//! surface and what parts must exchange are measured. Cost: 8 bytes a part; a partition of points O(n log n) for the
//! sort of their keys, of leaves O(leaves); the owner of a point O(log p). The report walks the tree once for each leaf,
//! and once more for each point near another part. When to use: to spread points over processes or devices, or to do
//! large sets in pieces. The parts of a curve have more surface than those of a graph partitioner, and need no graph.
//!
//! Invariants:
//! 1. splitters ascend; the keys of parts tile all 2⁶³ keys in the order of the parts;
//! 2. points of one cell at level 21 have one owner; a part that got no point when the partition was made owns no key
//!    (without any points the last part owns all);
//! 3. work of a part = total work / p ± the largest work that cannot be cut (a leaf, or the points of one cell at level
//!    21).

mod exchange;
mod partition;
mod report;
mod surface;
#[cfg(test)]
mod tests;

pub use exchange::Exchange;
pub use partition::{MAX_PARTS, Partition};
pub use report::{PartReport, PartitionReport, compare_curves};
