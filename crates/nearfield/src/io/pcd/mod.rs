//! PCD, the point clouds of the Point Cloud Library: ascii, binary and binary_compressed are read, binary is written.
//!
//! The parsing is our own. The crate `pcd-rs` keeps each point as a list of boxed values (above 100 bytes for a point
//! of three bytes), allocates what a compressed block claims to hold, and does not say at which line or byte a file is
//! broken; it serves as the reference of the tests instead.
//!
//! - `x y z` of any number type become world coordinates.
//! - `normal_x normal_y normal_z` (floats) become normals.
//! - `rgb` and `rgba` (four packed bytes) become colours; only `rgba` carries alpha.
//! - Any other field becomes an attribute, `name_0`, `name_1` … where its count is above one; `_` is padding.
//! - The viewpoint is not applied: it says where the scanner stood, coordinates are in the world already.

mod header;
mod lzf;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub(crate) use read::read;
pub(crate) use write::write;

/// Name of the format in errors.
const FORMAT: &str = "PCD";
