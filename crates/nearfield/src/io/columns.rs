//! Columns of numbers between files and clouds: typed values at a stride inside a block of bytes, and the names and
//! lengths that a writer needs.

use glam::{DVec3, Vec3};

use crate::geometry::{Attribute, Column, PointCloud};

/// Most columns a file may have; more is taken for a damaged header.
///
/// The widest point feature in use (ESF) has 640 values.
pub(crate) const MAX_COLUMNS: u64 = 65_536;

/// Type of a number in a binary file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    /// Bytes of one value.
    pub(crate) fn size(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::I64 | Scalar::U64 | Scalar::F64 => 8,
        }
    }
}

/// `len` values of one type, `stride` bytes apart.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Strided<'a> {
    bytes: &'a [u8],
    stride: usize,
    len: usize,
    scalar: Scalar,
    big_endian: bool,
}

/// Iterator over the values of a [`Strided`] as `$number`.
macro_rules! values {
    ($strided:expr, $number:ty) => {{
        let Strided { bytes, stride, len, big_endian, .. } = *$strided;
        (0..len).map(move |i| {
            let value = &bytes[i * stride..][..size_of::<$number>()];
            let value = value.try_into().expect("the slice should have the size of the number");
            if big_endian { <$number>::from_be_bytes(value) } else { <$number>::from_le_bytes(value) }
        })
    }};
}

impl<'a> Strided<'a> {
    /// `len` little-endian values, the first at byte `start`. The caller has checked that the last one ends inside
    /// `bytes`.
    pub(crate) fn new(bytes: &'a [u8], start: usize, stride: usize, len: usize, scalar: Scalar) -> Self {
        Self { bytes: &bytes[start.min(bytes.len())..], stride, len, scalar, big_endian: false }
    }

    /// The same values, most significant byte first.
    pub(crate) fn big_endian(self, big_endian: bool) -> Self {
        Self { big_endian, ..self }
    }

    /// The values in the type the file has; 64-bit integers become f64 (exact up to 2⁵³).
    pub(crate) fn column(&self) -> Column {
        match self.scalar {
            Scalar::I8 => Column::I8(values!(self, i8).collect()),
            Scalar::U8 => Column::U8(values!(self, u8).collect()),
            Scalar::I16 => Column::I16(values!(self, i16).collect()),
            Scalar::U16 => Column::U16(values!(self, u16).collect()),
            Scalar::I32 => Column::I32(values!(self, i32).collect()),
            Scalar::U32 => Column::U32(values!(self, u32).collect()),
            Scalar::F32 => Column::F32(values!(self, f32).collect()),
            Scalar::F64 => Column::F64(values!(self, f64).collect()),
            Scalar::I64 => Column::F64(values!(self, i64).map(|v| v as f64).collect()),
            Scalar::U64 => Column::F64(values!(self, u64).map(|v| v as f64).collect()),
        }
    }

    /// Calls `visit` with each index and value.
    pub(crate) fn for_each(&self, mut visit: impl FnMut(usize, f64)) {
        macro_rules! each {
            ($number:ty) => {
                values!(self, $number).enumerate().for_each(|(i, value)| visit(i, value as f64))
            };
        }
        match self.scalar {
            Scalar::I8 => each!(i8),
            Scalar::U8 => each!(u8),
            Scalar::I16 => each!(i16),
            Scalar::U16 => each!(u16),
            Scalar::I32 => each!(i32),
            Scalar::U32 => each!(u32),
            Scalar::I64 => each!(i64),
            Scalar::U64 => each!(u64),
            Scalar::F32 => each!(f32),
            Scalar::F64 => each!(f64),
        }
    }
}

/// Appends the number that `word` stands for, least significant byte first; false if it is none.
pub(crate) fn push_number(records: &mut Vec<u8>, scalar: Scalar, word: &str) -> bool {
    macro_rules! push {
        ($number:ty) => {
            word.parse::<$number>().map(|number| records.extend_from_slice(&number.to_le_bytes())).is_ok()
        };
    }
    match scalar {
        Scalar::I8 => push!(i8),
        Scalar::U8 => push!(u8),
        Scalar::I16 => push!(i16),
        Scalar::U16 => push!(u16),
        Scalar::I32 => push!(i32),
        Scalar::U32 => push!(u32),
        Scalar::I64 => push!(i64),
        Scalar::U64 => push!(u64),
        Scalar::F32 => push!(f32),
        Scalar::F64 => push!(f64),
    }
}

/// What a word of a text file should be.
pub(crate) fn expected_number(scalar: Scalar) -> String {
    let kind = match scalar {
        Scalar::F32 | Scalar::F64 => "a number",
        Scalar::U8 | Scalar::U16 | Scalar::U32 | Scalar::U64 => "a whole number from 0",
        Scalar::I8 | Scalar::I16 | Scalar::I32 | Scalar::I64 => "a whole number",
    };
    format!("{kind} of {} bits", 8 * scalar.size())
}

/// A cloud from its three coordinate columns, all of length `n`.
pub(crate) fn cloud_from_columns(axes: [Strided<'_>; 3], n: usize) -> PointCloud {
    let mut world = vec![DVec3::ZERO; n];
    for (axis, column) in axes.iter().enumerate() {
        column.for_each(|i, value| world[i][axis] = value);
    }
    PointCloud::from_world(&world)
}

/// Vectors from their three component columns, all of length `n`.
pub(crate) fn vectors_from_columns(components: [Strided<'_>; 3], n: usize) -> Vec<Vec3> {
    let mut vectors = vec![Vec3::ZERO; n];
    for (axis, column) in components.iter().enumerate() {
        column.for_each(|i, value| vectors[i][axis] = value as f32);
    }
    vectors
}

/// Names for the attributes of a cloud that a file can hold: `clean` makes one name legal, and a name that is empty,
/// reserved or already taken gets a number behind it.
pub(crate) fn distinct_names(
    attributes: &[Attribute],
    reserved: &[&str],
    clean: impl Fn(&str) -> String,
) -> Vec<String> {
    let mut taken: std::collections::HashSet<String> = reserved.iter().map(|&name| name.to_owned()).collect();
    let distinct = |attribute: &Attribute| {
        let cleaned = clean(&attribute.name);
        let base = if cleaned.is_empty() { "attribute".to_owned() } else { cleaned };
        let mut name = base.clone();
        let mut number = 2;
        while !taken.insert(name.clone()) {
            name = format!("{base}_{number}");
            number += 1;
        }
        name
    };
    attributes.iter().map(distinct).collect()
}

/// Checks that every column of a cloud about to be written has one value a point.
///
/// # Errors
/// `InvalidInput` naming the column, its length and the number of points.
pub(crate) fn check_lengths(cloud: &PointCloud) -> std::io::Result<()> {
    let columns = (cloud.normals.iter().map(|n| ("normals", n.len())))
        .chain(cloud.colors.iter().map(|c| ("colors", c.len())))
        .chain(cloud.attributes.iter().map(|a| (a.name.as_str(), a.values.len())));
    check_equal(columns, cloud.len())
}

/// Checks that every named length is `expected`.
///
/// # Errors
/// `InvalidInput` naming the first that differs.
pub(crate) fn check_equal<'a>(
    mut columns: impl Iterator<Item = (&'a str, usize)>,
    expected: usize,
) -> std::io::Result<()> {
    match columns.find(|&(_, len)| len != expected) {
        None => Ok(()),
        Some((name, len)) => {
            let message = format!("column {name} has {len} values, expected {expected}, one a point");
            Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, message))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_at_their_stride_in_both_byte_orders() {
        // Records of an i16 and a padding byte: 258 and -2, little-endian.
        let little = [2, 1, 99, 0xfe, 0xff, 99];
        assert_eq!(Strided::new(&little, 0, 3, 2, Scalar::I16).column(), Column::I16(vec![258, -2]));
        let big = [99, 1, 2, 99, 0xff, 0xfe];
        let column = Strided::new(&big, 1, 3, 2, Scalar::I16).big_endian(true);
        assert_eq!(column.column(), Column::I16(vec![258, -2]));
        let mut seen = vec![];
        column.for_each(|i, v| seen.push((i, v)));
        assert_eq!(seen, [(0, 258.0), (1, -2.0)]);
    }

    #[test]
    fn wide_integers_become_doubles() {
        let bytes = 9_007_199_254_740_992_u64.to_le_bytes();
        let column = Strided::new(&bytes, 0, 8, 1, Scalar::U64).column();
        assert_eq!(column, Column::F64(vec![9_007_199_254_740_992.0]));
    }

    #[test]
    fn names_that_clash_get_a_number() {
        let attribute = |name: &str| Attribute { name: name.into(), values: Column::U8(vec![]) };
        let attributes = [attribute("x"), attribute("a b"), attribute("a_b"), attribute(""), attribute("x")];
        let names = distinct_names(&attributes, &["x"], |name| name.replace(' ', "_"));
        assert_eq!(names, ["x_2", "a_b", "a_b_2", "attribute", "x_3"]);
    }

    #[test]
    fn a_short_column_is_refused_before_writing() {
        let mut cloud = PointCloud::new(vec![Vec3::ZERO; 3]);
        assert!(check_lengths(&cloud).is_ok());
        cloud.colors = Some(vec![[0; 4]; 2]);
        let error = check_lengths(&cloud).unwrap_err().to_string();
        assert_eq!(error, "column colors has 2 values, expected 3, one a point");
    }
}
