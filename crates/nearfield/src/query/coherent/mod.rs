//! Coherent spherical range search on the AABB-tree: queries that share a leaf share one traversal.
//!
//! Phase I packs the queries by the leaf that each is nearest to on the way down: leaves are found, queries sorted by
//! them, and the sorted list compacted to the packs; the points themselves stand in packs already. Phase II goes from each
//! pack's leaf back to the root with the volume that a ball sweeps over the leaf, and keeps the points of all leaves that it
//! meets: the pack's candidates. Phase III tests the candidates against the queries of the pack. On the device a plain list
//! is extracted by one invocation a candidate and sorted by query; all other answers take one invocation a query, which goes
//! through the list of its pack.
//!
//! Source: Xing2017, section 4.2 (algorithm 2) and section 4.1 for `primary`. Departures:
//! - candidates and matches are counted, scanned and written, in place of atomic appends: results are the same from run to
//!   run, and memory is taken for what there is;
//! - a query that lies farther than the radius from its leaf gets a sweep of its own (`sweep`): answers are exact for queries
//!   anywhere;
//! - a query without neighbours keeps an empty row, which the paper's compaction drops;
//! - candidates are places in the tree's order, not copies of points; where they do not fit one binding or the memory that
//!   is left, packs are taken in windows;
//! - packs of more than 4,096 queries are cut on the device.
//!
//! Cost: 8 bytes a candidate on the device, of which a pack of 20 points has hundreds; on the CPU spans of the order. When
//! to use: to reproduce the paper. `Packed` makes no list and is faster.

#[cfg(feature = "gpu")]
mod back_traverse;
mod counters;
mod cpu;
#[cfg(feature = "gpu")]
mod extract;
#[cfg(feature = "gpu")]
mod gpu_counters;
#[cfg(feature = "gpu")]
mod pack;
#[cfg(feature = "gpu")]
mod primary;
mod sweep;

#[cfg(feature = "gpu")]
pub(super) use back_traverse::{Asking, Candidates, MODULE as BACK_TRAVERSE};
pub use counters::{PhaseLanes, SearchCounters};
pub(super) use cpu::{find_candidates, pack_by_leaf};
#[cfg(feature = "gpu")]
pub(super) use extract::{Extracted, MODULE as EXTRACT};
#[cfg(feature = "gpu")]
pub(super) use pack::MODULE as PACK;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use sweep::Sweep;

/// Module that visits the candidates of a query.
#[cfg(feature = "gpu")]
pub(super) const CANDIDATES: &str = "package::query::coherent::candidates";
