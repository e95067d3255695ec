//! What every structure on every device answers.

use crate::Result;

use super::{Counts, FixedRadius, Nearest, Neighbors, Stage};

/// Fixed-radius search over a set of points, whatever the structure and the device.
///
/// All implementations give the same answer; they differ in time, memory and the order within unsorted rows.
pub trait NeighborSearch: Sync {
    /// Name of the structure: "brute-force", "uniform-grid".
    fn structure(&self) -> &'static str;

    /// The device: "cpu (…)" or the adapter's name.
    fn device(&self) -> String;

    /// Number of points.
    fn len(&self) -> usize;

    /// Whether there is no point.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes the structure holds, points included.
    fn memory_bytes(&self) -> u64;

    /// Times of the stages of the build.
    fn build_stages(&self) -> Vec<Stage>;

    /// Number of neighbours of every query; order, cap and distances of the question do not matter.
    ///
    /// # Errors
    /// See [`FixedRadius::validate`]; `OutOfMemory`, `OutOfDeviceMemory`, `DeviceLost`.
    fn count(&self, question: &FixedRadius<'_>) -> Result<Counts>;

    /// Neighbours of every query as compressed sparse rows in query order.
    ///
    /// # Errors
    /// As [`NeighborSearch::count`]; `OutOfMemory` with the size where the list would pass
    /// [`FixedRadius::max_bytes`] or the memory of the host: nothing is ever cut silently.
    fn list(&self, question: &FixedRadius<'_>) -> Result<Neighbors>;

    /// The nearest point within the radius of every query, ties by lower index.
    ///
    /// # Errors
    /// As [`NeighborSearch::count`].
    fn nearest(&self, question: &FixedRadius<'_>) -> Result<Nearest>;
}
