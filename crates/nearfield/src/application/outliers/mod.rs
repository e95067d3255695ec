//! Points that do not belong: far from their neighbours ([`statistical_outliers`]), with few of them ([`radius_outliers`]), or there
//! already ([`duplicates`]).
//!
//! Nothing is removed here: each function says of every point, in the caller's order, whether to keep it, and what was measured.
//! Invalid points (with a NaN or infinite coordinate) are not kept, count for nothing, and are told. The statistical rule is that of
//! PCL or that of Open3D, which differ; see [`OutlierRule`].
//!
//! On the device the nearest are found through the tree of boxes, counts and duplicates through the uniform grid.

mod duplicates;
#[cfg(feature = "gpu")]
mod gpu;
mod radius;
mod statistical;

pub use duplicates::{Duplicates, duplicates};
#[cfg(feature = "gpu")]
pub use gpu::{duplicates_on_gpu, radius_outliers_on_gpu, statistical_outliers_on_gpu};
pub use radius::{RadiusOutlierSettings, RadiusOutliers, radius_outliers};
pub use statistical::{OutlierRule, StatisticalOutlierSettings, StatisticalOutliers, statistical_outliers};

/// Points between two reports of how far it is.
const BLOCK: usize = 1 << 12;
/// Points of a task.
const TASK: usize = 128;

/// Indices of what is kept, ascending.
fn indices(kept: &[bool]) -> Vec<u32> {
    kept.iter().zip(0..).filter(|(kept, _)| **kept).map(|(_, i)| i).collect()
}
