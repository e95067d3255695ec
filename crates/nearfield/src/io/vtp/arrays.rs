//! The numbers of an array, whichever way they are written down.

use std::borrow::Cow;

use super::document::{Document, Element, fault};
use super::xml::line_of;
use crate::error::Place;
use crate::io::columns::{MAX_COLUMNS, Scalar, Strided, expected_number, push_number};
use crate::io::text::{shown, words};
use crate::{Error, Result};

/// The numbers of an array, those of a point one after the other.
pub(super) struct Numbers<'a> {
    bytes: Cow<'a, [u8]>,
    /// Their type.
    pub(super) scalar: Scalar,
    /// How many a point has.
    pub(super) components: usize,
    n_points: usize,
    big_endian: bool,
    /// Characters of base64 that were gone through for them, some twice.
    pub(super) decoded: usize,
}

impl Numbers<'_> {
    /// Bytes of all.
    pub(super) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Number `k` of every point.
    pub(super) fn column(&self, k: usize) -> Strided<'_> {
        let (size, n) = (self.scalar.size(), self.n_points);
        Strided::new(&self.bytes, k * size, self.components * size, n, self.scalar).big_endian(self.big_endian)
    }
}

/// What an array should hold.
struct Shape {
    scalar: Scalar,
    components: u64,
    n_points: u64,
}

impl Shape {
    /// Numbers in all.
    fn count(&self) -> u64 {
        self.n_points.saturating_mul(self.components)
    }

    fn bytes(&self) -> u64 {
        self.count().saturating_mul(self.scalar.size() as u64)
    }

    fn name(&self) -> String {
        format!(
            "{} for {} points of {} numbers of {} bits",
            self.bytes(),
            self.n_points,
            self.components,
            8 * self.scalar.size()
        )
    }
}

impl<'a> Document<'a> {
    /// The numbers of an array.
    ///
    /// # Errors
    /// `File` with the line or byte for another number of them than the points need, for what is no number, and for types and encodings that
    /// are not read.
    pub(super) fn numbers(&self, array: &Element<'a>) -> Result<Numbers<'a>> {
        let shape = self.shape(array)?;
        let format = array.tag.value("format").unwrap_or_else(|| "ascii".to_owned());
        if format != "ascii"
            && let Some(compressor) = &self.compressor
        {
            let found = format!("arrays compressed by {}", shown(compressor.as_bytes()));
            return Err(fault(
                Place::Whole,
                found,
                "arrays that are not compressed: choose the compressor `None` in ParaView",
            ));
        }
        let mut decoded = 0;
        let (bytes, big_endian) = match format.as_str() {
            "ascii" => (Cow::Owned(self.bytes_of_text(array, &shape)?), false),
            "binary" => {
                let at = self.place_in(array.text);
                (Cow::Owned(self.bytes_of_base64(array.text, at, &shape, &mut decoded)?), self.big_endian)
            }
            "appended" => (self.bytes_of_appended(array, &shape, &mut decoded)?, self.big_endian),
            _ => {
                return Err(self.wrong(
                    array,
                    format!("format {}", shown(format.as_bytes())),
                    "ascii, binary or appended",
                ));
            }
        };
        let (components, n_points) = (shape.components as usize, shape.n_points as usize);
        Ok(Numbers { bytes, scalar: shape.scalar, components, n_points, big_endian, decoded })
    }

    fn shape(&self, array: &Element<'a>) -> Result<Shape> {
        let kind = array.tag.value("type").unwrap_or_default();
        let scalar = scalar(&kind).ok_or_else(|| {
            self.wrong(
                array,
                format!("type {}", shown(kind.as_bytes())),
                "Float32, Float64, or Int or UInt of 8 to 64 bits",
            )
        })?;
        let count = array.tag.value("NumberOfComponents").unwrap_or_else(|| "1".to_owned());
        let components = count.parse().ok().filter(|n| (1..=MAX_COLUMNS).contains(n)).ok_or_else(|| {
            let found = format!("NumberOfComponents {}", shown(count.as_bytes()));
            self.wrong(array, found, "a number from 1 to 65,536")
        })?;
        Ok(Shape { scalar, components, n_points: self.n_points })
    }

    /// An error at the tag of an array.
    fn wrong(&self, array: &Element<'a>, found: String, expected: &str) -> Error {
        let name = array.tag.value("Name").unwrap_or_default();
        fault(line_of(self.bytes, array.at), format!("{found} of array {}", shown(name.as_bytes())), expected)
    }

    /// Where a part of the file begins.
    fn place_in(&self, part: &[u8]) -> usize {
        if part.is_empty() { 0 } else { part.as_ptr() as usize - self.bytes.as_ptr() as usize }
    }

    /// Numbers as text, least significant byte first.
    fn bytes_of_text(&self, array: &Element<'a>, shape: &Shape) -> Result<Vec<u8>> {
        // A number takes a digit and a blank; the last one may lack the blank.
        let possible = (array.text.len() as u64).div_ceil(2);
        if shape.count() > possible {
            let found = format!("{} bytes of text", array.text.len());
            return Err(self.wrong(array, found, &format!("{} numbers", shape.count())));
        }
        let mut bytes = Vec::with_capacity(shape.bytes() as usize);
        let mut found = 0;
        for word in words(array.text) {
            let is_number = std::str::from_utf8(word).is_ok_and(|word| push_number(&mut bytes, shape.scalar, word));
            if !is_number {
                let place = line_of(self.bytes, self.place_in(word));
                return Err(fault(place, shown(word), &expected_number(shape.scalar)));
            }
            found += 1;
            if found > shape.count() {
                return Err(self.wrong(array, "more numbers".into(), &format!("{} of them", shape.count())));
            }
        }
        if found < shape.count() {
            return Err(self.wrong(array, format!("{found} numbers"), &format!("{} of them", shape.count())));
        }
        Ok(bytes)
    }

    /// Numbers behind the XML.
    fn bytes_of_appended(&self, array: &Element<'a>, shape: &Shape, decoded: &mut usize) -> Result<Cow<'a, [u8]>> {
        let Some(appended) = self.appended else {
            return Err(self.wrong(array, "no appended data".into(), "the element AppendedData"));
        };
        let offset = array.tag.value("offset").unwrap_or_default();
        let number = offset.parse().ok().filter(|&offset: &usize| offset <= appended.bytes.len());
        let Some(offset) = number else {
            let expected = format!("one of the {} bytes of appended data", appended.bytes.len());
            return Err(self.wrong(array, format!("offset {}", shown(offset.as_bytes())), &expected));
        };
        let (rest, at) = (&appended.bytes[offset..], appended.start + offset);
        if !appended.is_raw {
            return Ok(Cow::Owned(self.bytes_of_base64(rest, at, shape, decoded)?));
        }
        let place = Place::Byte(at as u64);
        let head = rest
            .get(..self.size_width())
            .ok_or_else(|| fault(place, "the end of the file".into(), "the size of an array"))?;
        self.check_size(head, || place, shape)?;
        let numbers = &rest[self.size_width()..];
        match usize::try_from(shape.bytes()).ok().and_then(|size| numbers.get(..size)) {
            Some(numbers) => Ok(Cow::Borrowed(numbers)),
            None => Err(fault(place, format!("{} bytes up to the end of the file", numbers.len()), &shape.name())),
        }
    }

    /// Numbers in base64, with their size in front.
    ///
    /// - `at`: where the text stands in the file
    /// - `decoded`: how many characters were gone through, to which these are added
    fn bytes_of_base64(&self, text: &[u8], at: usize, shape: &Shape, decoded: &mut usize) -> Result<Vec<u8>> {
        // Lines are counted from the start of the file: for what is wrong alone.
        let place = |i: usize| line_of(self.bytes, at + i);
        let mut first = |most: usize| -> Result<Vec<u8>> {
            let (bytes, end) = decode(text, most).map_err(|i| {
                let found = text
                    .get(i..)
                    .filter(|rest| !rest.is_empty())
                    .map_or("the end of the data".into(), |rest| shown(&rest[..1]));
                fault(place(i), found, "base64")
            })?;
            *decoded += end;
            Ok(bytes)
        };
        let width = self.size_width();
        let head = first(width)?;
        if head.len() < width {
            return Err(fault(place(0), format!("{} bytes in base64", head.len()), "the size of an array"));
        }
        self.check_size(&head, || place(0), shape)?;
        // Four characters are three bytes: nothing is decoded that cannot be there.
        let size = usize::try_from(shape.bytes()).ok().filter(|&size| size <= text.len());
        let mut bytes = size.map(|size| first(width + size)).transpose()?.unwrap_or_default();
        if Some(bytes.len()) != size.map(|size| width + size) {
            let found = format!("{} bytes in base64", bytes.len().saturating_sub(width));
            return Err(fault(place(0), found, &shape.name()));
        }
        bytes.drain(..width);
        Ok(bytes)
    }

    /// Bytes of the size in front of an array.
    fn size_width(&self) -> usize {
        if self.wide_sizes { 8 } else { 4 }
    }

    fn check_size(&self, head: &[u8], place: impl FnOnce() -> Place, shape: &Shape) -> Result<()> {
        let fold = |size: u64, &byte: &u8| size << 8 | u64::from(byte);
        let size = if self.big_endian { head.iter().fold(0, fold) } else { head.iter().rev().fold(0, fold) };
        if size == shape.bytes() {
            return Ok(());
        }
        Err(fault(place(), format!("an array of {size} bytes"), &shape.name()))
    }
}

fn scalar(kind: &str) -> Option<Scalar> {
    Some(match kind {
        "Int8" => Scalar::I8,
        "UInt8" => Scalar::U8,
        "Int16" => Scalar::I16,
        "UInt16" => Scalar::U16,
        "Int32" => Scalar::I32,
        "UInt32" => Scalar::U32,
        "Int64" | "vtkIdType" => Scalar::I64,
        "UInt64" => Scalar::U64,
        "Float32" => Scalar::F32,
        "Float64" => Scalar::F64,
        _ => return None,
    })
}

/// The first `most` bytes, or all that are there, of groups of four characters. Any group may end with padding: writers encode sizes alone
/// or together with the numbers. Returns also where the text behind them begins.
///
/// # Errors
/// The place of what is no base64, or of the end inside a group.
fn decode(text: &[u8], most: usize) -> std::result::Result<(Vec<u8>, usize), usize> {
    let mut bytes = Vec::with_capacity(most.min(text.len() / 4 * 3) + 3);
    let (mut group, mut filled, mut padding) = (0u32, 0, 0);
    for (i, &character) in text.iter().enumerate().filter(|(_, character)| !character.is_ascii_whitespace()) {
        let bits = match character {
            b'A'..=b'Z' => character - b'A',
            b'a'..=b'z' => character - b'a' + 26,
            b'0'..=b'9' => character - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            b'=' if filled >= 2 => 0,
            _ => return Err(i),
        };
        padding += usize::from(character == b'=');
        if padding > 0 && character != b'=' {
            return Err(i);
        }
        group = group << 6 | u32::from(bits);
        filled += 1;
        if filled == 4 {
            bytes.extend_from_slice(&group.to_be_bytes()[1..4 - padding]);
            (group, filled, padding) = (0, 0, 0);
            if bytes.len() >= most {
                bytes.truncate(most);
                return Ok((bytes, i + 1));
            }
        }
    }
    if filled == 0 { Ok((bytes, text.len())) } else { Err(text.len()) }
}
