//! VTK XML PolyData (`.vtp`), which ParaView opens: clouds and meshes are written, clouds are read.
//!
//! Written are the numbers behind the XML as they are in memory ("appended raw"). Positions are f64 world coordinates where the origin is not
//! zero, else f32. Every point of a cloud is a vertex cell of its own, so that ParaView shows, picks and filters single points. Normals
//! are the array `normals`, colours `colors` (red, green, blue, alpha), attributes keep their names.
//!
//! Read is one piece in ASCII, base64 or raw, in the XML or appended, in either byte order, uncompressed; whatever its points are joined to is
//! left out. Our own code: `vtkio` brings an XML reader and decoders for what we refuse, and says neither line nor byte.
//!
//! - `Points` of any number type become world coordinates.
//! - The array that `PointData` names as `Normals`, or else `normals`, becomes the normals where it has three numbers a point.
//! - `colors` of three or four bytes a point become colours.
//! - Any other array becomes an attribute, `name_0`, `name_1` … where it has several numbers a point.

mod arrays;
mod document;
mod read;
#[cfg(test)]
mod tests;
mod write;
mod xml;

pub(crate) use read::read;
pub(crate) use write::{write_cloud, write_mesh};

/// Name of the format in errors.
const FORMAT: &str = "VTP";
