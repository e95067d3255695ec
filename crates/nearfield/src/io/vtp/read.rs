//! VTP bytes to a cloud.

use super::FORMAT;
use super::arrays::Numbers;
use super::document::{Document, fault};
use super::xml::line_of;
use crate::Result;
use crate::error::Place;
use crate::geometry::{Attribute, PointCloud};
use crate::io::columns::{MAX_COLUMNS, Scalar, cloud_from_columns, vectors_from_columns};
use crate::io::empty;

/// Most bytes of the name of an array, which each of its columns gets.
const LONGEST_NAME: usize = 256;

/// Bytes of numbers for each byte of the file: two characters can be a number of eight bytes. More come from arrays that share their numbers.
const MOST_SHARED: usize = 4;

/// Characters of base64 that are gone through for each byte of the file: those of an array once for its size, and once for all of it.
const MOST_DECODED: usize = 2;

/// The cloud in a VTP file: the points of its one piece, normals, colours and all other arrays as attributes.
///
/// NaN and infinite coordinates stay as they are.
///
/// # Errors
/// `File` with the line (XML and text) or the byte (appended numbers), what was found and what was expected.
pub(crate) fn read(bytes: &[u8]) -> Result<PointCloud> {
    if bytes.is_empty() {
        return Err(empty(FORMAT, "VTK XML poly data").into());
    }
    let document = Document::parse(bytes)?;
    let Some(points) = &document.points else {
        if document.n_points == 0 {
            return Ok(PointCloud::default());
        }
        return Err(fault(
            Place::Whole,
            format!("no array in <Points> of {} points", document.n_points),
            "their coordinates",
        ));
    };
    let places = document.numbers(points)?;
    if places.components != 3 {
        let found = format!("points of {} coordinates", places.components);
        return Err(fault(line_of(bytes, points.at), found, "three"));
    }
    let n = document.n_points as usize;
    let mut cloud = cloud_from_columns([0, 1, 2].map(|axis| places.column(axis)), n);
    let (mut read, mut decoded) = (places.len(), places.decoded);
    for array in &document.point_data {
        let name = array.tag.value("Name").unwrap_or_default();
        if name.len() > LONGEST_NAME {
            let found = format!("an array whose name has {} bytes", name.len());
            return Err(fault(line_of(bytes, array.at), found, "a shorter name"));
        }
        let numbers = document.numbers(array)?;
        read += numbers.len();
        decoded += numbers.decoded;
        if read > MOST_SHARED * bytes.len() || decoded > MOST_DECODED * bytes.len() {
            return Err(fault(
                line_of(bytes, array.at),
                "arrays at one place".into(),
                "arrays with numbers of their own",
            ));
        }
        let is_normals = document.normals.as_ref().map_or(name == "normals", |normals| *normals == name);
        if is_normals && is_float(&numbers) && numbers.components == 3 && cloud.normals.is_none() {
            cloud.normals = Some(vectors_from_columns([0, 1, 2].map(|axis| numbers.column(axis)), n));
        } else if name == "colors" && is_color(&numbers) && cloud.colors.is_none() {
            let mut colors = vec![[255; 4]; n];
            (0..numbers.components).for_each(|k| numbers.column(k).for_each(|i, value| colors[i][k] = value as u8));
            cloud.colors = Some(colors);
        } else {
            if (cloud.attributes.len() + numbers.components) as u64 > MAX_COLUMNS {
                return Err(fault(line_of(bytes, array.at), format!("more than {MAX_COLUMNS} columns"), "fewer"));
            }
            for k in 0..numbers.components {
                let name = if numbers.components == 1 { name.clone() } else { format!("{name}_{k}") };
                cloud.attributes.push(Attribute { name, values: numbers.column(k).column() });
            }
        }
    }
    Ok(cloud)
}

fn is_float(numbers: &Numbers<'_>) -> bool {
    matches!(numbers.scalar, Scalar::F32 | Scalar::F64)
}

fn is_color(numbers: &Numbers<'_>) -> bool {
    numbers.scalar == Scalar::U8 && matches!(numbers.components, 3 | 4)
}
