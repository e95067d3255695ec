//! NPY and NPZ, the array files of NumPy: clouds are read from both, clouds and arrays written as NPZ.
//!
//! The crate `npyz` reads the header of an array (a Python expression) and `zip` writes archives. The directory of an
//! archive is read here: `zip` reserves memory by its entry count before it looks at the entries, and a stored array
//! can be used where it stands in the file, without a copy.
//!
//! An array of n rows and at least three columns is a cloud; numbers are floats of 4 or 8 bytes or integers of 1 to 8,
//! in either byte order, rows or columns first. Further columns become attributes `column_3`, `column_4` …
//!
//! In an archive the cloud is the array `points`, or else the only one with such a shape; `normals` [n, 3] and
//! `colors` (u8, [n, 3] or [n, 4]) belong to it, and every array of n numbers is an attribute.

mod archive;
mod array;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub(crate) use read::{read, read_list, read_npz_list, read_npz_vectors, read_table};
pub(crate) use write::write_cloud;
pub use write::{NpyArray, write_npz};

/// Name of the array format in errors.
pub(crate) const NPY: &str = "NPY";
/// What an array starts with.
pub(crate) const MAGIC: &[u8] = b"\x93NUMPY";
/// Name of the archive format in errors.
const NPZ: &str = "NPZ";
