//! One array: its header, checked against the bytes behind it, and its columns.

use npyz::{DType, NpyHeader, Order, TypeChar};

use super::{MAGIC, NPY};
use crate::Result;
use crate::error::{FileError, Place};
use crate::io::columns::{MAX_COLUMNS, Scalar, Strided};
use crate::io::guard;

/// Longest header that is parsed, as in NumPy (`max_header_size`).
const MAX_HEADER: usize = 10_000;
/// Deepest nesting of a header that is parsed; a plain array has two levels.
const MAX_DEPTH: usize = 8;

/// What the header of an array says.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    /// Type of the numbers; `None` for what is not a plain number.
    scalar: Option<Scalar>,
    big_endian: bool,
    rows_first: bool,
    /// Length of each axis.
    pub(super) shape: Vec<u64>,
    /// Type as the file has it, for errors.
    pub(super) dtype: String,
    /// Bytes of an element.
    element: u64,
    /// Byte of the array at which the elements start.
    start: usize,
}

/// An array of plain numbers whose elements have been found to be all there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Array<'a> {
    scalar: Scalar,
    big_endian: bool,
    rows_first: bool,
    rows: usize,
    columns: usize,
    elements: &'a [u8],
}

impl Layout {
    /// Reads the header at the start of `bytes`, which may end anywhere behind it. `at` is the byte of the file at
    /// which `bytes` starts.
    ///
    /// # Errors
    /// `File` if it is cut off or none.
    pub(super) fn read(bytes: &[u8], at: u64) -> Result<Self> {
        let error = |offset: usize, found: String, expected: &str| -> Result<Self> {
            Err(FileError::new(NPY, Place::Byte(at + offset as u64), found, expected).into())
        };
        if !bytes.starts_with(MAGIC) {
            let start = bytes[..bytes.len().min(6)].escape_ascii();
            let found = if bytes.is_empty() { "an empty file".into() } else { format!("\"{start}\"") };
            return error(0, found, "\"\\x93NUMPY\"");
        }
        let length = match bytes.get(6..8) {
            Some([1, 0]) => bytes.get(8..10).map(|b| (10, usize::from(u16::from_le_bytes([b[0], b[1]])))),
            Some([2 | 3, 0]) => bytes.get(8..12).map(|b| (12, u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize)),
            Some([major, minor]) => return error(6, format!("version {major}.{minor}"), "version 1.0, 2.0 or 3.0"),
            _ => None,
        };
        let Some((text_start, length)) = length else {
            return error(bytes.len(), "the end of the file in the header".into(), "the length of the header");
        };
        if length > MAX_HEADER {
            return error(8, format!("a header of {length} bytes"), "at most 10000");
        }
        let Some(text) = bytes.get(text_start..text_start + length) else {
            return error(bytes.len(), "the end of the file in the header".into(), "the whole header");
        };
        if depth(text) > MAX_DEPTH {
            return error(
                text_start,
                "a header nested too deep".into(),
                "a dictionary of descr, fortran_order and shape",
            );
        }
        let header = guard::caught(NPY, || {
            NpyHeader::from_reader(&bytes[..text_start + length]).map_err(|cause| {
                let found = format!("a header that cannot be read ({})", first_line(&cause.to_string()));
                let expected = "a dictionary of descr, fortran_order and shape";
                FileError::new(NPY, Place::Byte(at + text_start as u64), found, expected).into()
            })
        })?;
        let dtype = header.dtype();
        let scalar = match &dtype {
            DType::Plain(kind) => scalar(kind.type_char(), kind.size_field()),
            _ => None,
        };
        let big_endian = matches!(&dtype, DType::Plain(kind) if kind.endianness() == npyz::Endianness::Big);
        Ok(Self {
            scalar,
            big_endian,
            rows_first: header.order() == Order::C,
            shape: header.shape().to_vec(),
            element: dtype.num_bytes().unwrap_or(0) as u64,
            dtype: dtype.descr().chars().take(100).collect(),
            start: text_start + length,
        })
    }

    /// Whether this is a table of plain numbers with at least three columns.
    pub(super) fn is_cloud(&self) -> bool {
        self.scalar.is_some() && matches!(self.shape[..], [_, columns] if columns >= 3)
    }

    /// Whether this is a table of plain numbers with one of these numbers of columns.
    pub(super) fn has_columns(&self, widths: &[u64]) -> bool {
        self.scalar.is_some() && matches!(self.shape[..], [_, columns] if widths.contains(&columns))
    }

    /// Whether this is a list of plain numbers.
    pub(super) fn is_list(&self, len: usize) -> bool {
        self.scalar.is_some() && self.shape == [len as u64]
    }

    /// Whether this is a table of plain numbers with so many columns, of bytes if `only_u8`.
    pub(super) fn is_table(&self, len: usize, columns: &[u64], only_u8: bool) -> bool {
        let scalar_fits = if only_u8 { self.scalar == Some(Scalar::U8) } else { self.scalar.is_some() };
        scalar_fits && matches!(self.shape[..], [rows, n] if rows == len as u64 && columns.contains(&n))
    }

    /// Bytes of the array, header included; `None` where that is no number of 64 bits.
    pub(super) fn total_size(&self) -> Option<u64> {
        let elements = self.shape.iter().try_fold(1_u64, |product, &n| product.checked_mul(n))?;
        elements.checked_mul(self.element)?.checked_add(self.start as u64)
    }

    /// Shape as Python writes it.
    pub(super) fn shape_text(&self) -> String {
        let axes: Vec<String> = self.shape.iter().take(8).map(u64::to_string).collect();
        format!("({}{})", axes.join(", "), if axes.len() == 1 { "," } else { "" })
    }

    /// The elements, where `bytes` is the whole array and `at` the byte of the file at which it starts.
    ///
    /// # Errors
    /// `File` if the type is not a plain number, the shape is not a list or a table, or the size differs.
    pub(super) fn array<'a>(&self, bytes: &'a [u8], at: u64) -> Result<Array<'a>> {
        let error = |found: String, expected: String| -> Result<Array<'a>> {
            Err(FileError::new(NPY, Place::Byte(at), found, expected).into())
        };
        let Some(scalar) = self.scalar else {
            let expected = "floats of 4 or 8 bytes or integers of 1 to 8".into();
            return error(format!("elements of type {}", self.dtype), expected);
        };
        let (rows, columns) = match self.shape[..] {
            [rows] => (rows, 1),
            [rows, columns] if columns <= MAX_COLUMNS => (rows, columns),
            _ => return error(format!("shape {}", self.shape_text()), "one or two axes".into()),
        };
        if self.total_size() != Some(bytes.len() as u64) {
            let found = format!("{} bytes of elements", bytes.len() - self.start);
            return error(found, format!("shape {} of type {}", self.shape_text(), self.dtype));
        }
        Ok(Array {
            scalar,
            big_endian: self.big_endian,
            rows_first: self.rows_first,
            // No column holds more elements than there are bytes, unless there are no columns.
            rows: if columns == 0 { 0 } else { rows as usize },
            columns: columns as usize,
            elements: &bytes[self.start..],
        })
    }
}

impl<'a> Array<'a> {
    /// Number of rows.
    pub(super) fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns; 1 for a list.
    pub(super) fn columns(&self) -> usize {
        self.columns
    }

    /// The values of column `k`.
    pub(super) fn column(&self, k: usize) -> Strided<'a> {
        let size = self.scalar.size();
        let (start, stride) =
            if self.rows_first { (k * size, self.columns * size) } else { (k * self.rows * size, size) };
        Strided::new(self.elements, start, stride, self.rows, self.scalar).big_endian(self.big_endian)
    }
}

fn scalar(kind: TypeChar, size: u64) -> Option<Scalar> {
    Some(match (kind, size) {
        (TypeChar::Int, 1) => Scalar::I8,
        (TypeChar::Int, 2) => Scalar::I16,
        (TypeChar::Int, 4) => Scalar::I32,
        (TypeChar::Int, 8) => Scalar::I64,
        (TypeChar::Uint, 1) => Scalar::U8,
        (TypeChar::Uint, 2) => Scalar::U16,
        (TypeChar::Uint, 4) => Scalar::U32,
        (TypeChar::Uint, 8) => Scalar::U64,
        (TypeChar::Float, 4) => Scalar::F32,
        (TypeChar::Float, 8) => Scalar::F64,
        _ => return None,
    })
}

/// Deepest nesting of brackets: the header parser recurses, and backtracks more with each level.
fn depth(text: &[u8]) -> usize {
    let (mut depth, mut deepest) = (0_usize, 0);
    for byte in text {
        match byte {
            b'(' | b'[' | b'{' => depth += 1,
            b')' | b']' | b'}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        deepest = deepest.max(depth);
    }
    deepest
}

fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or_default().chars().take(120).collect()
}
