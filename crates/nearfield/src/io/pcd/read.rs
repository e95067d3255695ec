//! PCD bytes to a cloud.

use std::borrow::Cow;

use super::header::{Encoding, Field, Header, shortened};
use super::{FORMAT, lzf};
use crate::Result;
use crate::error::{FileError, Place};
use crate::geometry::{Attribute, PointCloud};
use crate::io::columns::{Scalar, Strided, cloud_from_columns, expected_number, push_number, vectors_from_columns};
use crate::io::guard;

/// The cloud in a PCD file: positions, normals, colours and all other fields as attributes.
///
/// NaN and infinite coordinates stay as they are.
///
/// # Errors
/// `File` with the line (header and ascii) or the byte (binary), what was found and what was expected.
pub(crate) fn read(bytes: &[u8]) -> Result<PointCloud> {
    let header = Header::read(bytes)?;
    let body = &bytes[header.body..];
    let records = match header.encoding {
        Encoding::Ascii => Records::interleaved(Cow::Owned(parse_ascii(&header, body)?), &header),
        Encoding::Binary => {
            let place = Place::Line(header.points_line);
            guard::records(FORMAT, place, header.points, header.record_size as u64, body.len() as u64)?;
            let used = header.points as usize * header.record_size;
            only_padding(bytes, header.body + used)?;
            Records::interleaved(Cow::Borrowed(&body[..used]), &header)
        }
        Encoding::BinaryCompressed => Records::by_field(Cow::Owned(decompress(&header, bytes)?), &header),
    };
    Ok(records.into_cloud(&header))
}

/// Checks that nothing but zeros (the padding of a memory page) stands from byte `start` on.
fn only_padding(bytes: &[u8], start: usize) -> Result<()> {
    match bytes[start..].iter().position(|&byte| byte != 0) {
        None => Ok(()),
        Some(at) => {
            let found = format!("{} bytes behind the last point", bytes.len() - start);
            let place = Place::Byte((start + at) as u64);
            Err(FileError::new(FORMAT, place, found, "the end of the file, or zeros up to it").into())
        }
    }
}

/// The expanded body of a `binary_compressed` file, exactly as long as the header asks.
fn decompress(header: &Header<'_>, bytes: &[u8]) -> Result<Vec<u8>> {
    let at = header.body;
    let error = |place: usize, found: String, expected: String| {
        Err(FileError::new(FORMAT, Place::Byte(place as u64), found, expected).into())
    };
    let (Some(packed), Some(expanded)) = (u32_at(bytes, at), u32_at(bytes, at + 4)) else {
        return error(bytes.len(), "the end of the file".into(), "the compressed and the expanded size".into());
    };
    let needed = header.points.checked_mul(header.record_size as u64);
    if Some(u64::from(expanded)) != needed {
        let expected = format!("{} points of {} bytes", header.points, header.record_size);
        return error(at + 4, format!("an expanded size of {expanded} bytes"), expected);
    }
    guard::records(FORMAT, Place::Byte(at as u64), u64::from(packed), 1, (bytes.len() - at - 8) as u64)?;
    let start = at + 8;
    let end = start + packed as usize;
    only_padding(bytes, end)?;
    let broken = |broken: lzf::Broken| {
        let place = Place::Byte((start + broken.at) as u64);
        FileError::new(FORMAT, place, broken.what, "LZF compressed data")
    };
    let stream = &bytes[start..end];
    let len = lzf::expanded_len(stream).map_err(broken)?;
    if len != u64::from(expanded) {
        return error(start, format!("compressed data that expands to {len} bytes"), format!("{expanded} bytes"));
    }
    Ok(lzf::expand(stream, expanded as usize).map_err(broken)?)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}

/// The points of an ascii file as binary records, so that all encodings share what follows.
fn parse_ascii(header: &Header<'_>, body: &[u8]) -> Result<Vec<u8>> {
    let error = |line: u64, found: String, expected: String| {
        Err(FileError::new(FORMAT, Place::Line(line), found, expected).into())
    };
    let values = header.values_per_point();
    // A value takes a digit and a separator; the last one may lack the separator.
    let (smallest, remaining) = (2 * values as u64, body.len() as u64 + 1);
    guard::records(FORMAT, Place::Line(header.points_line), header.points, smallest, remaining)?;
    let mut records = Vec::with_capacity(header.points as usize * header.record_size);
    let (mut points, mut line) = (0, header.body_line);
    for text in body.split(|&byte| byte == b'\n') {
        let text = match std::str::from_utf8(text) {
            Ok(text) => text,
            Err(_) => return error(line, "bytes that are not text".into(), "the numbers of a point".into()),
        };
        let mut words = text.split_ascii_whitespace().peekable();
        if words.peek().is_some() {
            if points == header.points {
                let expected = format!("the end of the file after {points} points");
                return error(line, format!("{:?}", shortened(text)), expected);
            }
            for field in &header.fields {
                for _ in 0..field.count {
                    let Some(word) = words.next() else {
                        let found = format!("{} values", text.split_ascii_whitespace().count());
                        return error(line, found, format!("{values}, as the fields say"));
                    };
                    if !push_number(&mut records, field.scalar, word) {
                        let found = format!("{:?} in field {}", shortened(word), shortened(field.name));
                        return error(line, found, expected_number(field.scalar));
                    }
                }
            }
            if words.next().is_some() {
                let found = format!("{} values", text.split_ascii_whitespace().count());
                return error(line, found, format!("{values}, as the fields say"));
            }
            points += 1;
        }
        line += 1;
    }
    if points < header.points {
        return error(
            line - 1,
            format!("the end of the file after {points} points"),
            format!("{} points", header.points),
        );
    }
    Ok(records)
}

/// The values of all points, interleaved or field by field.
struct Records<'a> {
    bytes: Cow<'a, [u8]>,
    points: usize,
    /// Bytes from one point to the next; 0 where each field stands by itself.
    record_size: usize,
}

impl<'a> Records<'a> {
    fn interleaved(bytes: Cow<'a, [u8]>, header: &Header<'_>) -> Self {
        Self { bytes, points: header.points as usize, record_size: header.record_size }
    }

    fn by_field(bytes: Cow<'a, [u8]>, header: &Header<'_>) -> Self {
        Self { bytes, points: header.points as usize, record_size: 0 }
    }

    /// Value `k` of `field`, of all points, read as `scalar`.
    fn column(&self, field: &Field<'_>, k: usize, scalar: Scalar) -> Strided<'_> {
        let size = scalar.size();
        let (start, stride) = if self.record_size == 0 {
            (self.points * field.offset + k * size, field.count * size)
        } else {
            (field.offset + k * size, self.record_size)
        };
        Strided::new(&self.bytes, start, stride, self.points, scalar)
    }

    fn into_cloud(self, header: &Header<'_>) -> PointCloud {
        let axis = |name| {
            let field = header.field(name).expect("the header should have been checked for x, y and z");
            self.column(field, 0, field.scalar)
        };
        let mut cloud = cloud_from_columns([axis("x"), axis("y"), axis("z")], self.points);
        let normals = normal_fields(header);
        cloud.normals = normals
            .map(|fields| vectors_from_columns(fields.map(|field| self.column(field, 0, field.scalar)), self.points));
        let color = color_field(header);
        if let Some(field) = color {
            let mut colors = vec![[0; 4]; self.points];
            self.column(field, 0, Scalar::U32).for_each(|i, value| {
                let [blue, green, red, alpha] = (value as u32).to_le_bytes();
                colors[i] = [red, green, blue, if field.name == "rgba" { alpha } else { 255 }];
            });
            cloud.colors = Some(colors);
        }
        for field in &header.fields {
            let used = matches!(field.name, "x" | "y" | "z" | "_")
                || normals.is_some_and(|fields| fields.iter().any(|f| f.offset == field.offset))
                || color.is_some_and(|f| f.offset == field.offset);
            if used {
                continue;
            }
            for k in 0..field.count {
                let name = if field.count == 1 { field.name.to_owned() } else { format!("{}_{k}", field.name) };
                cloud.attributes.push(Attribute { name, values: self.column(field, k, field.scalar).column() });
            }
        }
        cloud
    }
}

/// The three fields of the normal, where all are floats.
fn normal_fields<'h, 'a>(header: &'h Header<'a>) -> Option<[&'h Field<'a>; 3]> {
    let float = |name| {
        let field = header.field(name)?;
        (field.count == 1 && matches!(field.scalar, Scalar::F32 | Scalar::F64)).then_some(field)
    };
    Some([float("normal_x")?, float("normal_y")?, float("normal_z")?])
}

/// The packed colour: four bytes blue, green, red, alpha, declared as a float or as an integer.
fn color_field<'h, 'a>(header: &'h Header<'a>) -> Option<&'h Field<'a>> {
    let packed = |name| header.field(name).filter(|field| field.count == 1 && field.scalar.size() == 4);
    packed("rgba").or_else(|| packed("rgb"))
}
