//! Point cloud and mesh files: one file a format.

mod columns;
mod guard;
mod las;
mod npy;
mod pcd;
#[cfg(test)]
mod test_data;
mod vtp;

pub use npy::{NpyArray, write_npz};
