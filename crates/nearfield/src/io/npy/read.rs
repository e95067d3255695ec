//! NPY and NPZ bytes to a cloud.

use glam::{DVec3, Vec3};

use super::archive::{self, Entry};
use super::array::{Array, Layout};
use super::{NPY, NPZ};
use crate::Result;
use crate::error::{FileError, Place};
use crate::geometry::{Attribute, Column, PointCloud};
use crate::io::columns::{cloud_from_columns, vectors_from_columns};

/// Bytes that hold every header that is parsed.
const HEADER_ROOM: usize = 10_012;

/// The cloud in an NPY array or an NPZ archive, told apart by their first bytes.
///
/// # Errors
/// `File` with the byte or the array, what was found and what was expected.
pub(crate) fn read(bytes: &[u8]) -> Result<PointCloud> {
    if bytes.starts_with(b"PK") { read_npz(bytes) } else { read_npy(bytes) }
}

/// The numbers of an NPY array with one axis, or one column.
///
/// # Errors
/// `File` where it is no such array.
pub(crate) fn read_list(bytes: &[u8]) -> Result<Vec<f64>> {
    let layout = Layout::read(bytes, 0)?;
    if !matches!(layout.shape[..], [_] | [_, 1]) {
        let found = format!("an array of shape {}", layout.shape_text());
        return Err(FileError::new(NPY, Place::Whole, found, "shape (n,)").into());
    }
    let array = layout.array(bytes, 0)?;
    let mut values = vec![0.0; array.rows()];
    array.column(0).for_each(|i, value| values[i] = value);
    Ok(values)
}

/// Columns of the table `name`: of an NPY array, or of an archive's array of that name, or else of its only one of such a
/// shape. `widths` are the numbers of columns that it may have; all columns have the same length.
///
/// # Errors
/// `File` where there is no such table.
pub(crate) fn read_table(bytes: &[u8], name: &str, widths: &[u64]) -> Result<Vec<Vec<f64>>> {
    let expected = || {
        let widths: Vec<String> = widths.iter().map(|columns| format!("(n, {columns})")).collect();
        format!("floats or integers of shape {}", widths.join(" or "))
    };
    let described = |layout: &Layout| format!("shape {} and type {}", layout.shape_text(), layout.dtype);
    if !bytes.starts_with(b"PK") {
        let layout = Layout::read(bytes, 0)?;
        if !layout.has_columns(widths) {
            let found = format!("an array of {}", described(&layout));
            return Err(FileError::new(NPY, Place::Whole, found, expected()).into());
        }
        return Ok(columns(&layout.array(bytes, 0)?));
    }
    let members = members(bytes)?;
    let fitting: Vec<&Member<'_>> = members.iter().filter(|member| member.layout.has_columns(widths)).collect();
    let member = match members.iter().find(|member| member.entry.name == name) {
        Some(named) if named.layout.has_columns(widths) => named,
        Some(named) => {
            let found = format!("array {name:?} of {}", described(&named.layout));
            return Err(FileError::new(NPZ, Place::Byte(named.entry.start), found, expected()).into());
        }
        None => match fitting[..] {
            [only] => only,
            _ => {
                let found = format!("{} arrays [{}]", members.len(), listed(&members));
                let expected = format!("an array {name:?}, or exactly one, of {}", expected());
                return Err(FileError::new(NPZ, Place::Whole, found, expected).into());
            }
        },
    };
    member.check_size()?;
    check_inflated([member], bytes.len())?;
    member.with_array(columns)
}

/// The numbers of the list `name` of an archive; `None` where it has no such array.
///
/// # Errors
/// `File` where it is no archive, or the array no list.
pub(crate) fn read_npz_list(bytes: &[u8], name: &str) -> Result<Option<Vec<f64>>> {
    let columns = named_columns(bytes, name, &[1], "(n,)")?;
    Ok(columns.map(|mut columns| columns.swap_remove(0)))
}

/// The rows of the table `name` of three columns of an archive; `None` where it has no such array.
///
/// # Errors
/// `File` where it is no archive, or the array has another shape.
pub(crate) fn read_npz_vectors(bytes: &[u8], name: &str) -> Result<Option<Vec<DVec3>>> {
    let columns = named_columns(bytes, name, &[3], "(n, 3)")?;
    let row = |columns: &[Vec<f64>], i: usize| DVec3::new(columns[0][i], columns[1][i], columns[2][i]);
    Ok(columns.map(|columns| (0..columns[0].len()).map(|i| row(&columns, i)).collect()))
}

fn named_columns(bytes: &[u8], name: &str, widths: &[u64], shape: &str) -> Result<Option<Vec<Vec<f64>>>> {
    if !bytes.starts_with(b"PK") {
        return Err(FileError::new(NPZ, Place::Byte(0), "no archive".to_owned(), "an NPZ archive").into());
    }
    let members = members(bytes)?;
    let Some(member) = members.iter().find(|member| member.entry.name == name) else { return Ok(None) };
    let is_list = widths == [1] && matches!(member.layout.shape[..], [len] if member.layout.is_list(len as usize));
    if !(is_list || member.layout.has_columns(widths)) {
        let found = format!("array {name:?} of shape {} and type {}", member.layout.shape_text(), member.layout.dtype);
        return Err(FileError::new(NPZ, Place::Byte(member.entry.start), found, format!("shape {shape}")).into());
    }
    member.check_size()?;
    check_inflated([member], bytes.len())?;
    Ok(Some(member.with_array(columns)?))
}

/// The columns of a table as f64.
fn columns(array: &Array<'_>) -> Vec<Vec<f64>> {
    let column = |k: usize| {
        let mut values = vec![0.0; array.rows()];
        array.column(k).for_each(|i, value| values[i] = value);
        values
    };
    (0..array.columns()).map(column).collect()
}

fn read_npy(bytes: &[u8]) -> Result<PointCloud> {
    let layout = Layout::read(bytes, 0)?;
    check_cloud_shape(NPY, Place::Whole, "an array", &layout)?;
    Ok(cloud(&layout.array(bytes, 0)?))
}

fn check_cloud_shape(format: &'static str, place: Place, what: &str, layout: &Layout) -> Result<()> {
    if layout.is_cloud() {
        return Ok(());
    }
    let found = format!("{what} of shape {} and type {}", layout.shape_text(), layout.dtype);
    let turned = if matches!(layout.shape[..], [3, _]) { " (transpose it)" } else { "" };
    let expected = format!("shape (n, 3) or more columns, of floats or integers{turned}");
    Err(FileError::new(format, place, found, expected).into())
}

/// The first three columns as positions, the others as attributes.
fn cloud(array: &Array<'_>) -> PointCloud {
    let mut cloud = cloud_from_columns([0, 1, 2].map(|axis| array.column(axis)), array.rows());
    let attribute = |k: usize| Attribute { name: format!("column_{k}"), values: array.column(k).column() };
    cloud.attributes = (3..array.columns()).map(attribute).collect();
    cloud
}

/// An array of an archive.
struct Member<'a> {
    entry: Entry<'a>,
    layout: Layout,
}

impl Member<'_> {
    /// Whether the content can be had for about the memory that the file takes.
    fn check_size(&self) -> Result<()> {
        if self.layout.total_size() != Some(self.entry.size) {
            let found = format!("array {:?} of {} bytes", self.entry.name, self.entry.size);
            let expected = format!("shape {} of type {}", self.layout.shape_text(), self.layout.dtype);
            return Err(FileError::new(NPZ, Place::Byte(self.entry.start), found, expected).into());
        }
        Ok(())
    }

    /// Calls `decode` with the array.
    fn with_array<T>(&self, decode: impl FnOnce(&Array<'_>) -> T) -> Result<T> {
        let content = self.entry.content()?;
        Ok(decode(&self.layout.array(&content, self.entry.start)?))
    }
}

/// The arrays of an archive.
fn members(bytes: &[u8]) -> Result<Vec<Member<'_>>> {
    let mut members = vec![];
    for entry in archive::entries(bytes)? {
        let layout = Layout::read(&entry.head(HEADER_ROOM)?, entry.start)?;
        members.push(Member { entry, layout });
    }
    Ok(members)
}

/// Where arrays are far larger than the file of `stored` bytes, they are first inflated into nothing: only an archive
/// that really holds them may ask for the memory.
fn check_inflated<'a, 'b: 'a>(members: impl IntoIterator<Item = &'a Member<'b>> + Clone, stored: usize) -> Result<()> {
    let inflated = members.clone().into_iter().fold(0_u64, |sum, member| sum.saturating_add(member.entry.size));
    if inflated > stored as u64 * 3 / 2 + (4 << 20) {
        members.into_iter().try_for_each(|member| member.entry.check())?;
    }
    Ok(())
}

fn read_npz(bytes: &[u8]) -> Result<PointCloud> {
    let members = members(bytes)?;
    let points = points_member(&members)?;
    let n = members[points].layout.shape[0] as usize;
    let used = |i: usize, member: &Member<'_>| match member.entry.name.as_str() {
        _ if i == points => true,
        "normals" => member.layout.is_table(n, &[3], false),
        "colors" => member.layout.is_table(n, &[3, 4], true),
        _ => member.layout.is_list(n),
    };
    let used: Vec<usize> = (0..members.len()).filter(|&i| used(i, &members[i])).collect();
    used.iter().try_for_each(|&i| members[i].check_size())?;
    check_inflated(used.iter().map(|&i| &members[i]), bytes.len())?;
    let mut result = members[points].with_array(cloud)?;
    for &i in used.iter().filter(|&&i| i != points) {
        let member = &members[i];
        match member.entry.name.as_str() {
            "normals" => result.normals = Some(member.with_array(vectors)?),
            "colors" => result.colors = Some(member.with_array(colors)?),
            name => {
                let values = member.with_array(|array| array.column(0).column())?;
                result.attributes.push(Attribute { name: name.to_owned(), values });
            }
        }
    }
    Ok(result)
}

/// Which array holds the positions.
fn points_member(members: &[Member<'_>]) -> Result<usize> {
    if let Some(i) = members.iter().position(|member| member.entry.name == "points") {
        let place = Place::Byte(members[i].entry.start);
        check_cloud_shape(NPZ, place, "array \"points\"", &members[i].layout)?;
        return Ok(i);
    }
    let clouds: Vec<usize> = (0..members.len()).filter(|&i| members[i].layout.is_cloud()).collect();
    if let [only] = clouds[..] {
        return Ok(only);
    }
    let found = format!("{} arrays [{}]", members.len(), listed(members));
    let expected = "an array \"points\" of shape (n, 3), or exactly one of such a shape";
    Err(FileError::new(NPZ, Place::Whole, found, expected).into())
}

/// Names and shapes of the first arrays, for errors.
fn listed(members: &[Member<'_>]) -> String {
    let describe = |member: &Member<'_>| format!("{:?} {}", member.entry.name, member.layout.shape_text());
    members.iter().take(8).map(describe).collect::<Vec<String>>().join(", ")
}

fn vectors(array: &Array<'_>) -> Vec<Vec3> {
    vectors_from_columns([0, 1, 2].map(|axis| array.column(axis)), array.rows())
}

fn colors(array: &Array<'_>) -> Vec<[u8; 4]> {
    let mut colors = vec![[255; 4]; array.rows()];
    for channel in 0..array.columns().min(4) {
        if let Column::U8(values) = array.column(channel).column() {
            colors.iter_mut().zip(values).for_each(|(color, value)| color[channel] = value);
        }
    }
    colors
}
