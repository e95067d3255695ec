//! Wavefront OBJ: positions with optional colours, normals, polygons; everything else is passed over.
//!
//! Every `v` line becomes a vertex, in the file's order and whether a face uses it or not; material files are opened
//! by `read_obj_materials` alone. Normals are kept where every face names them and no vertex has two different ones: a mesh that shades its
//! edges hard would need its vertices doubled, and their number is what clouds and searches are about.

mod materials;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub use materials::{MeshMaterials, MtlMaterial, parse_mtl, read_obj_materials};
pub(super) use read::{read_cloud, read_mesh};
pub(super) use write::{write_cloud, write_mesh};

const NAME: &str = "OBJ";
