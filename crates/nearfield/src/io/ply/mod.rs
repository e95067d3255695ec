//! PLY: ascii and both binary byte orders, with normals, colours, attributes, polygons and triangle strips.
//!
//! Every element is read into typed columns, so that a point costs the bytes of its type and any scalar type is taken
//! for any property. Lists of a face element become fans; a `tristrips` list is cut at −1 and its winding alternates.
//! A header line that is no keyword is passed over before the first element, as some programs write their name there.

mod body;
mod header;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub(super) use read::{read_cloud, read_mesh};
pub(super) use write::{write_cloud, write_mesh};

const NAME: &str = "PLY";
