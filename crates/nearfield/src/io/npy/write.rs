//! Arrays and clouds to NPZ.

use std::io::{self, Seek, Write};

use glam::{DVec3, Vec3};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use crate::geometry::{Column, PointCloud};
use crate::io::columns::{check_lengths, distinct_names};

/// An array to write: a list of numbers, or a table with one row an element.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the variants of numbers are the types")]
pub enum NpyArray<'a> {
    I8(&'a [i8]),
    U8(&'a [u8]),
    I16(&'a [i16]),
    U16(&'a [u16]),
    I32(&'a [i32]),
    U32(&'a [u32]),
    U64(&'a [u64]),
    F32(&'a [f32]),
    F64(&'a [f64]),
    /// f32, [n, 3].
    F32x3(&'a [Vec3]),
    /// f64, [n, 3].
    F64x3(&'a [DVec3]),
    /// u8, [n, 4].
    U8x4(&'a [[u8; 4]]),
    /// f32, [nz, ny, nx]: values of the nodes of a grid, with the number of nodes along x, y and z.
    F32Grid(&'a [f32], [u32; 3]),
    /// u32, as [`NpyArray::F32Grid`].
    U32Grid(&'a [u32], [u32; 3]),
}

impl<'a> From<&'a Column> for NpyArray<'a> {
    fn from(column: &'a Column) -> Self {
        match column {
            Column::I8(values) => NpyArray::I8(values),
            Column::U8(values) => NpyArray::U8(values),
            Column::I16(values) => NpyArray::I16(values),
            Column::U16(values) => NpyArray::U16(values),
            Column::I32(values) => NpyArray::I32(values),
            Column::U32(values) => NpyArray::U32(values),
            Column::F32(values) => NpyArray::F32(values),
            Column::F64(values) => NpyArray::F64(values),
        }
    }
}

impl<'a> NpyArray<'a> {
    /// NumPy's name of the element type, without the byte order.
    fn kind(&self) -> &'static str {
        match self {
            NpyArray::I8(_) => "i1",
            NpyArray::U8(_) | NpyArray::U8x4(_) => "u1",
            NpyArray::I16(_) => "i2",
            NpyArray::U16(_) => "u2",
            NpyArray::I32(_) => "i4",
            NpyArray::U32(_) | NpyArray::U32Grid(..) => "u4",
            NpyArray::U64(_) => "u8",
            NpyArray::F32(_) | NpyArray::F32x3(_) | NpyArray::F32Grid(..) => "f4",
            NpyArray::F64(_) | NpyArray::F64x3(_) => "f8",
        }
    }

    /// The elements in the byte order of this machine.
    fn bytes(&self) -> &'a [u8] {
        match *self {
            NpyArray::I8(values) => bytemuck::cast_slice(values),
            NpyArray::U8(values) => values,
            NpyArray::I16(values) => bytemuck::cast_slice(values),
            NpyArray::U16(values) => bytemuck::cast_slice(values),
            NpyArray::I32(values) => bytemuck::cast_slice(values),
            NpyArray::U32(values) => bytemuck::cast_slice(values),
            NpyArray::U64(values) => bytemuck::cast_slice(values),
            NpyArray::F32(values) => bytemuck::cast_slice(values),
            NpyArray::F64(values) => bytemuck::cast_slice(values),
            NpyArray::F32x3(values) => bytemuck::cast_slice(values),
            NpyArray::F64x3(values) => bytemuck::cast_slice(values),
            NpyArray::U8x4(values) => values.as_flattened(),
            NpyArray::F32Grid(values, _) => bytemuck::cast_slice(values),
            NpyArray::U32Grid(values, _) => bytemuck::cast_slice(values),
        }
    }

    /// The header of the array, padded so that the elements start at a multiple of 64 bytes.
    pub(super) fn header(&self) -> Vec<u8> {
        let (columns, element) = match self {
            NpyArray::I8(_) | NpyArray::U8(_) => ("", 1),
            NpyArray::I16(_) | NpyArray::U16(_) => ("", 2),
            NpyArray::I32(_) | NpyArray::U32(_) | NpyArray::F32(_) => ("", 4),
            NpyArray::U64(_) | NpyArray::F64(_) => ("", 8),
            NpyArray::F32x3(_) => (" 3", 12),
            NpyArray::F64x3(_) => (" 3", 24),
            NpyArray::U8x4(_) => (" 4", 4),
            NpyArray::F32Grid(..) | NpyArray::U32Grid(..) => ("", 4),
        };
        let order = match self.kind() {
            "i1" | "u1" => '|',
            _ if cfg!(target_endian = "big") => '>',
            _ => '<',
        };
        let (kind, rows) = (self.kind(), self.bytes().len() / element);
        let shape = match self {
            NpyArray::F32Grid(_, [nx, ny, nz]) | NpyArray::U32Grid(_, [nx, ny, nz]) => format!("{nz}, {ny}, {nx}"),
            _ => format!("{rows},{columns}"),
        };
        let mut text = format!("{{'descr': '{order}{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
        let preamble = 10;
        let padded = (preamble + text.len() + 1).next_multiple_of(64);
        text.extend(std::iter::repeat_n(' ', padded - preamble - text.len() - 1));
        text.push('\n');
        let length = u16::try_from(text.len()).expect("the header of a list or table should be short");
        [b"\x93NUMPY\x01\x00".as_slice(), &length.to_le_bytes(), text.as_bytes()].concat()
    }
}

/// Writes named arrays as an NPZ archive, as `numpy.savez` does: stored without compression, in 64-bit form where an
/// array has 4 GiB or more.
///
/// # Errors
/// `InvalidInput` for a name that appears twice, and what `out` returns.
pub fn write_npz<W: Write + Seek>(arrays: &[(&str, NpyArray<'_>)], out: W) -> io::Result<()> {
    let mut archive = ZipWriter::new(out);
    for (name, array) in arrays {
        let (header, bytes) = (array.header(), array.bytes());
        let size = (header.len() + bytes.len()) as u64;
        // A fixed date: the same arrays give the same bytes.
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(zip::DateTime::default())
            .large_file(size >= u64::from(u32::MAX));
        archive.start_file(format!("{name}.npy"), options).map_err(into_io)?;
        archive.write_all(&header)?;
        archive.write_all(bytes)?;
    }
    archive.finish().map_err(into_io)?.flush()
}

fn into_io(error: zip::result::ZipError) -> io::Error {
    match error {
        zip::result::ZipError::Io(error) => error,
        other => io::Error::new(io::ErrorKind::InvalidInput, other),
    }
}

/// Writes a cloud as NPZ: `points` [n, 3] (f64 world coordinates where the origin is not zero, else f32), `normals`
/// (f32, [n, 3]), `colors` (u8, [n, 4]) and a list of n values for each attribute.
///
/// An attribute whose name is taken or no file name gets another one.
///
/// # Errors
/// `InvalidInput` if a column has another length than the points, and what `out` returns.
pub(crate) fn write_cloud<W: Write + Seek>(cloud: &PointCloud, out: W) -> io::Result<()> {
    check_lengths(cloud)?;
    let world: Vec<DVec3>;
    let points = if cloud.origin == DVec3::ZERO {
        NpyArray::F32x3(&cloud.points)
    } else {
        world = (0..cloud.len()).map(|i| cloud.world(i)).collect();
        NpyArray::F64x3(&world)
    };
    let clean = |name: &str| name.replace(|c: char| c.is_control() || matches!(c, '/' | '\\' | ':'), "_");
    let names = distinct_names(&cloud.attributes, &["points", "normals", "colors"], clean);
    let mut arrays = vec![("points", points)];
    arrays.extend(cloud.normals.as_deref().map(|normals| ("normals", NpyArray::F32x3(normals))));
    arrays.extend(cloud.colors.as_deref().map(|colors| ("colors", NpyArray::U8x4(colors))));
    arrays.extend(names.iter().zip(&cloud.attributes).map(|(name, a)| (name.as_str(), NpyArray::from(&a.values))));
    write_npz(&arrays, out)
}
