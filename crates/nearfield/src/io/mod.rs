//! Point cloud and mesh files: one file a format, each reading from bytes and writing to any `Write`.
//!
//! A reader believes no count beyond the bytes that are there, and says of a malformed file the line or byte, what it
//! found and what it expected. Readers keep NaN and infinite coordinates; [`PointCloud::validate`] reports them.
//! A mesh file read as a cloud gives all of its vertices.
//!
//! PLY, OBJ, STL and the text tables are read by our own code: the errors above need positions that `ply-rs-bw`, `tobj`
//! and `stl_io` do not give, and `tobj` drops vertices no face uses. The tests compare with those three.

mod colors;
mod columns;
mod distance_grid;
mod exr;
mod format;
mod guard;
mod las;
mod npy;
mod obj;
mod open;
mod pcd;
mod ply;
mod radii;
mod rays;
mod save;
mod stl;
#[cfg(test)]
mod test_data;
mod text;
mod vti;
mod vtp;
mod xyz;

pub use distance_grid::{GridFormat, parse_distance_grid, read_distance_grid, write_distance_grid};
pub use exr::write_exr;
pub use format::{FORMATS, Format, FormatInfo};
pub use npy::{NpyArray, write_npz};
pub(crate) use npy::{read_npz_list, read_npz_vectors};
pub use obj::{MeshMaterials, MtlMaterial, parse_mtl, read_obj_materials};
pub(crate) use open::with_path;
pub use open::{Polygons, parse_cloud, parse_mesh, parse_mesh_with, read_cloud, read_mesh};
pub use radii::parse_radii;
pub use rays::parse_rays;
pub use save::{WriteOptions, WriteSeek, write_atomically, write_cloud, write_mesh};

use glam::DVec3;

use crate::error::{FileError, Place};
use crate::{PointCloud, TriMesh};

/// A mesh from world coordinates and triangles already known to be in range.
pub(crate) fn mesh_from_world(coordinates: &[DVec3], triangles: Vec<[u32; 3]>) -> TriMesh {
    let cloud = PointCloud::from_world(coordinates);
    TriMesh { origin: cloud.origin, vertices: cloud.points, triangles, normals: None, colors: None }
}

/// The error for a file without a byte in it.
fn empty(format: &'static str, expected: &'static str) -> FileError {
    FileError::new(format, Place::Whole, "an empty file", expected)
}
