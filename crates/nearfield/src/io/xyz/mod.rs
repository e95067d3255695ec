//! Text tables: XYZ (separated by spaces) and CSV, with or without a header.
//!
//! The separator is found in the file: semicolon, comma, else spaces and tabs, so either name reads any of them. A
//! header names the columns (`x y z nx ny nz r g b` or `red …`; any other name becomes an attribute); it may stand in a
//! comment (`# x y z`, `//X Y Z`). Without one the first three columns are x, y, z and the others `column4`, `column5` …
//! Lines that are blank or start with `#` or `//` are passed over.

mod read;
#[cfg(test)]
mod tests;
mod write;

pub(super) use read::read;
pub(super) use write::{write_csv, write_xyz};
