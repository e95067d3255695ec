//! What points that have moved are checked for before a tree follows them.

use glam::Vec3;

use crate::geometry::validate;
use crate::{Error, Result};

/// Checks new positions of `expected` points.
///
/// # Errors
/// `LengthMismatch`, `NonFinite`, `CoordinateTooLarge`.
pub(in crate::structure) fn check_moved(points: &[Vec3], expected: usize) -> Result<()> {
    if points.len() != expected {
        let (found, expected) = (points.len() as u64, expected as u64);
        return Err(Error::LengthMismatch { what: "new positions of the points", found, expected });
    }
    validate::points(points)
}
