//! VTK XML ImageData (`.vti`), which ParaView opens: signed distances at the nodes of a regular grid are written, and read back.
//!
//! The numbers stand behind the XML as they are in memory ("appended raw"), each array with its size in 64 bits before it:
//! `distance` in f32, NaN where undefined, and `nearest` in u32 where it is given. `Origin` is the first node in world
//! coordinates. Read is what is written here: one piece, appended raw, uncompressed.

use std::io::{self, Write};

use glam::{DVec3, Vec3};

use crate::error::{FileError, Place};
use crate::geometry::{DistanceGrid, RegularGrid};
use crate::{Error, Result};

const VTI: &str = "VTI";
/// What stands before the numbers.
const MARK: &[u8] = b"<AppendedData encoding=\"raw\">";

/// Writes a grid, and the index of what is nearest to each node.
///
/// # Errors
/// What `out` returns.
pub(super) fn write(field: &DistanceGrid, nearest: Option<&[u32]>, out: &mut dyn Write) -> io::Result<()> {
    let grid = field.grid();
    let (extent, corner) = (grid.cells().map(|n| format!("0 {n}")).join(" "), grid.world_corner());
    let width = f64::from(grid.spacing());
    let byte_order = if cfg!(target_endian = "big") { "BigEndian" } else { "LittleEndian" };
    let mut arrays = vec![("Float32", "distance", bytemuck::cast_slice::<f32, u8>(field.values()))];
    arrays.extend(nearest.map(|nearest| ("UInt32", "nearest", bytemuck::cast_slice(nearest))));
    write!(
        out,
        "<?xml version=\"1.0\"?>\n\
         <VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"{byte_order}\" header_type=\"UInt64\">\n  \
         <ImageData WholeExtent=\"{extent}\" Origin=\"{} {} {}\" Spacing=\"{width} {width} {width}\">\n    \
         <Piece Extent=\"{extent}\">\n      <PointData Scalars=\"distance\">\n",
        corner.x, corner.y, corner.z
    )?;
    let mut offset = 0;
    for (kind, name, bytes) in &arrays {
        writeln!(out, "        <DataArray type=\"{kind}\" Name=\"{name}\" format=\"appended\" offset=\"{offset}\"/>")?;
        offset += 8 + bytes.len();
    }
    out.write_all(b"      </PointData>\n    </Piece>\n  </ImageData>\n  <AppendedData encoding=\"raw\">\n_")?;
    for (_, _, bytes) in &arrays {
        out.write_all(&(bytes.len() as u64).to_ne_bytes())?;
        out.write_all(bytes)?;
    }
    out.write_all(b"\n  </AppendedData>\n</VTKFile>\n")
}

/// Reads the grid with the array `distance`.
///
/// # Errors
/// `File` with what was found; as [`RegularGrid::new`].
pub(super) fn parse(bytes: &[u8]) -> Result<DistanceGrid> {
    let wrong = |place, found: String, expected: &str| Error::from(FileError::new(VTI, place, found, expected));
    let end = bytes.windows(MARK.len()).position(|window| window == MARK);
    let end =
        end.ok_or_else(|| wrong(Place::Whole, "no appended raw data".into(), "ImageData as nearfield writes it"))?;
    let xml = String::from_utf8_lossy(&bytes[..end]);
    let file = element(&xml, "VTKFile")?;
    for (key, expected) in [("type", "ImageData"), ("header_type", "UInt64")] {
        let found = attribute(file, key)?;
        if found != expected {
            return Err(wrong(Place::Whole, format!("{key} {found}"), expected));
        }
    }
    let big_endian = attribute(file, "byte_order")? == "BigEndian";
    let image = element(&xml, "ImageData")?;
    let grid = grid(image)?;
    let array = xml.split("<DataArray").skip(1).find(|array| attribute(array, "Name").is_ok_and(|n| n == "distance"));
    let array = array.ok_or_else(|| wrong(Place::Whole, "no array `distance`".into(), "signed distances"))?;
    let kind = attribute(array, "type")?;
    if kind != "Float32" || attribute(file, "compressor").is_ok() {
        return Err(wrong(Place::Whole, format!("distances of type {kind}"), "Float32 without compression"));
    }
    let offset = numbers::<usize, 1>(array, "offset")?[0];
    let start = end + MARK.len() + bytes[end + MARK.len()..].iter().position(|&b| b == b'_').unwrap_or(0) + 1;
    let at = start.saturating_add(offset);
    let needed = 4 * grid.n_nodes() as u64;
    let size: Option<[u8; 8]> = bytes.get(at..).and_then(|rest| rest.first_chunk()).copied();
    let size = size.map(|size| if big_endian { u64::from_be_bytes(size) } else { u64::from_le_bytes(size) });
    let data = bytes.get(at.saturating_add(8)..).unwrap_or_default();
    if size != Some(needed) || (data.len() as u64) < needed {
        let found = format!("{} of {size:?} bytes of distances", data.len());
        return Err(wrong(Place::Byte(at as u64), found, &format!("{needed} bytes for {:?} nodes", grid.nodes())));
    }
    let value = |b: &[u8]| {
        let b = [b[0], b[1], b[2], b[3]];
        if big_endian { f32::from_be_bytes(b) } else { f32::from_le_bytes(b) }
    };
    DistanceGrid::new(grid, data[..needed as usize].chunks_exact(4).map(value).collect())
}

/// The grid that an element `ImageData` describes.
fn grid(image: &str) -> Result<RegularGrid> {
    let extent = numbers::<i64, 6>(image, "WholeExtent")?;
    let (origin, spacing) = (numbers::<f64, 3>(image, "Origin")?, numbers::<f64, 3>(image, "Spacing")?);
    let refused = |what: String, expected: &str| Error::from(FileError::new(VTI, Place::Whole, what, expected));
    let mut nodes = [0; 3];
    for (axis, n) in nodes.iter_mut().enumerate() {
        let count = extent[2 * axis + 1].checked_sub(extent[2 * axis]).and_then(|cells| cells.checked_add(1));
        let count = count.and_then(|count| u32::try_from(count).ok());
        *n = count.ok_or_else(|| refused(format!("extent {extent:?}"), "first and last node along each axis"))?;
    }
    if spacing.iter().any(|&w| w != spacing[0]) {
        return Err(refused(format!("spacing {spacing:?}"), "one spacing for all axes"));
    }
    let first = DVec3::from_array([0, 1, 2].map(|axis| origin[axis] + spacing[axis] * extent[2 * axis] as f64));
    // As a cloud's: f32 where that is exact, else whole units and the rest.
    let is_exact = first.as_vec3().as_dvec3() == first;
    let whole = if is_exact { DVec3::ZERO } else { first.round() };
    let corner: Vec3 = (first - whole).as_vec3();
    RegularGrid::new(whole, corner, spacing[0] as f32, nodes)
}

/// The attributes of the first element with this name.
fn element<'a>(xml: &'a str, name: &str) -> Result<&'a str> {
    let found = xml.split(&format!("<{name} ")).nth(1).and_then(|rest| rest.split('>').next());
    found.ok_or_else(|| FileError::new(VTI, Place::Whole, format!("no element {name}"), "ImageData").into())
}

fn attribute<'a>(element: &'a str, key: &str) -> Result<&'a str> {
    let element = element.split('>').next().unwrap_or_default();
    let found = element.split(&format!("{key}=\"")).nth(1).and_then(|rest| rest.split('"').next());
    found.ok_or_else(|| FileError::new(VTI, Place::Whole, format!("no attribute {key}"), "one").into())
}

/// The numbers of an attribute.
fn numbers<T: std::str::FromStr + Copy, const N: usize>(element: &str, key: &str) -> Result<[T; N]> {
    let text = attribute(element, key)?;
    let all: Option<Vec<T>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    let all = all.and_then(|all| <[T; N]>::try_from(all).ok());
    all.ok_or_else(|| FileError::new(VTI, Place::Whole, format!("{key} {text:?}"), format!("{N} numbers")).into())
}
