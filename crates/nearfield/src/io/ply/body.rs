//! The body: scalars one after the other, from words or from bytes, into typed columns.

use std::ops::Range;

use super::NAME;
use super::header::{Element, Encoding, Header, Kind, Property, Scalar};
use crate::error::{FileError, Place, Result};
use crate::geometry::Column;
use crate::io::guard;
use crate::io::text::{Lines, parsed, shown, words};

/// What one element holds: a column for each property, in the order of the header.
pub(super) struct Table {
    pub(super) columns: Vec<Values>,
}

pub(super) enum Values {
    Scalars(Column),
    /// The kept lists and the range of their items.
    Lists(Lists, Range<i64>),
    /// A list nobody asked for.
    Skipped,
}

/// The lists of one property, end to end: indices, with −1 as [`SEPARATOR`].
pub(super) struct Lists {
    pub(super) lengths: Vec<u32>,
    pub(super) items: Vec<u32>,
}

/// Stands for −1 among the items of a list.
pub(super) const SEPARATOR: u32 = u32::MAX;

/// Scalars one after the other.
pub(super) trait Source {
    /// The next scalar; exact in f64 for every type.
    fn scalar(&mut self, scalar: Scalar, name: &str) -> Result<f64>;
    /// The next item of a list; text may go on in the next line.
    fn item(&mut self, scalar: Scalar, name: &str) -> Result<f64>;
    /// Starts a record.
    fn begin_record(&mut self, element: &Element, record: u64) -> Result<()>;
    /// Ends a record.
    fn end_record(&mut self, element: &Element) -> Result<()>;
    fn place(&self) -> Place;
    fn remaining(&self) -> u64;
    fn encoding(&self) -> Encoding;
}

/// The body of a binary file.
pub(super) struct Binary<'a> {
    bytes: &'a [u8],
    at: usize,
    big_endian: bool,
}

impl<'a> Binary<'a> {
    pub(super) fn new(bytes: &'a [u8], at: usize, header: &Header) -> Self {
        Self { bytes, at, big_endian: header.encoding == Encoding::BigEndian }
    }

    fn take<const N: usize>(&mut self, name: &str) -> Result<[u8; N]> {
        match self.bytes.get(self.at..self.at + N).and_then(|slice| <[u8; N]>::try_from(slice).ok()) {
            Some(mut taken) => {
                self.at += N;
                if self.big_endian {
                    taken.reverse();
                }
                Ok(taken)
            }
            None => {
                let found = format!("the end of the file after {} bytes", self.bytes.len());
                Err(FileError::new(
                    NAME,
                    Place::Byte(self.at as u64),
                    found,
                    format!("{N} bytes of {}", shown(name.as_bytes())),
                )
                .into())
            }
        }
    }
}

impl Source for Binary<'_> {
    fn scalar(&mut self, scalar: Scalar, name: &str) -> Result<f64> {
        Ok(match scalar {
            Scalar::I8 => i8::from_le_bytes(self.take(name)?).into(),
            Scalar::U8 => u8::from_le_bytes(self.take(name)?).into(),
            Scalar::I16 => i16::from_le_bytes(self.take(name)?).into(),
            Scalar::U16 => u16::from_le_bytes(self.take(name)?).into(),
            Scalar::I32 => i32::from_le_bytes(self.take(name)?).into(),
            Scalar::U32 => u32::from_le_bytes(self.take(name)?).into(),
            Scalar::F32 => f32::from_le_bytes(self.take(name)?).into(),
            Scalar::F64 => f64::from_le_bytes(self.take(name)?),
        })
    }

    fn item(&mut self, scalar: Scalar, name: &str) -> Result<f64> {
        self.scalar(scalar, name)
    }

    fn begin_record(&mut self, _: &Element, _: u64) -> Result<()> {
        Ok(())
    }

    fn end_record(&mut self, _: &Element) -> Result<()> {
        Ok(())
    }

    fn place(&self) -> Place {
        Place::Byte(self.at as u64)
    }

    fn remaining(&self) -> u64 {
        (self.bytes.len() - self.at) as u64
    }

    fn encoding(&self) -> Encoding {
        if self.big_endian { Encoding::BigEndian } else { Encoding::LittleEndian }
    }
}

/// The body of an ascii file: a record a line.
pub(super) struct Ascii<'a> {
    lines: Lines<'a>,
    line: &'a [u8],
}

impl<'a> Ascii<'a> {
    pub(super) fn new(lines: Lines<'a>) -> Self {
        Self { lines, line: b"" }
    }

    fn word(&mut self) -> Option<&'a [u8]> {
        self.line = self.line.trim_ascii_start();
        let word = words(self.line).next()?;
        self.line = &self.line[word.len()..];
        Some(word)
    }

    fn error(&self, found: impl Into<String>, expected: impl Into<String>) -> FileError {
        FileError::new(NAME, self.place(), found, expected)
    }

    /// Moves to the next line that is not blank.
    fn advance(&mut self) -> bool {
        let lines = &mut self.lines;
        match lines.map(|(_, line)| line).find(|line| !line.trim_ascii().is_empty()) {
            Some(line) => {
                self.line = line;
                true
            }
            None => false,
        }
    }

    fn value(&self, word: &[u8], scalar: Scalar, name: &str) -> Result<f64> {
        let value = match scalar {
            Scalar::I8 => parsed::<i8>(word).map(f64::from),
            Scalar::U8 => parsed::<u8>(word).map(f64::from),
            Scalar::I16 => parsed::<i16>(word).map(f64::from),
            Scalar::U16 => parsed::<u16>(word).map(f64::from),
            Scalar::I32 => parsed::<i32>(word).map(f64::from),
            Scalar::U32 => parsed::<u32>(word).map(f64::from),
            Scalar::F32 => parsed::<f32>(word).map(f64::from),
            Scalar::F64 => parsed::<f64>(word),
        };
        value.ok_or_else(|| {
            self.error(shown(word), format!("a number of type {scalar:?} for {}", shown(name.as_bytes()))).into()
        })
    }
}

impl Source for Ascii<'_> {
    fn scalar(&mut self, scalar: Scalar, name: &str) -> Result<f64> {
        match self.word() {
            Some(word) => self.value(word, scalar, name),
            None => Err(self.error("the end of the line", format!("a value for {}", shown(name.as_bytes()))).into()),
        }
    }

    fn item(&mut self, scalar: Scalar, name: &str) -> Result<f64> {
        loop {
            if let Some(word) = self.word() {
                return self.value(word, scalar, name);
            }
            if !self.advance() {
                return Err(self
                    .error("the end of the file", format!("more values for {}", shown(name.as_bytes())))
                    .into());
            }
        }
    }

    fn begin_record(&mut self, element: &Element, record: u64) -> Result<()> {
        if self.advance() {
            return Ok(());
        }
        let found = format!("the end of the file after {record} of {}", shown(element.name.as_bytes()));
        Err(self.error(found, format!("{} of them, as line {} says", element.count, element.line)).into())
    }

    fn end_record(&mut self, element: &Element) -> Result<()> {
        match self.word() {
            None => Ok(()),
            Some(word) => {
                let expected =
                    format!("the end of the line after the properties of {}", shown(element.name.as_bytes()));
                Err(self.error(shown(word), expected).into())
            }
        }
    }

    fn place(&self) -> Place {
        Place::Line(self.lines.number())
    }

    fn remaining(&self) -> u64 {
        // The last value needs no separator behind it.
        (self.line.len() + self.lines.rest().len() + 1) as u64
    }

    fn encoding(&self) -> Encoding {
        Encoding::Ascii
    }
}

/// Reads all records of an element; `wanted` names the lists to keep with the range that their items must be in.
pub(super) fn read_element(
    source: &mut impl Source,
    element: &Element,
    wanted: impl Fn(&str) -> Option<Range<i64>>,
) -> Result<Table> {
    if element.properties.is_empty() {
        // Records of nothing: any count of them takes no byte, so there is nothing to read or to check.
        return Ok(Table { columns: vec![] });
    }
    let smallest = element.smallest_record(source.encoding());
    guard::records(NAME, Place::Line(element.line), element.count, smallest, source.remaining())?;
    let n = element.count as usize;
    let lists = |p: &Property| match wanted(&p.name) {
        Some(range) => Values::Lists(Lists { lengths: Vec::with_capacity(n), items: vec![] }, range),
        None => Values::Skipped,
    };
    let mut columns: Vec<Values> = element
        .properties
        .iter()
        .map(|p| match p.kind {
            Kind::Scalar(scalar) => Values::Scalars(column(scalar, n)),
            Kind::List { .. } => lists(p),
        })
        .collect();
    for record in 0..element.count {
        source.begin_record(element, record)?;
        for (values, property) in columns.iter_mut().zip(&element.properties) {
            match property.kind {
                Kind::Scalar(scalar) => {
                    let value = source.scalar(scalar, &property.name)?;
                    if let Values::Scalars(column) = values {
                        push(column, value);
                    }
                }
                Kind::List { count, item } => read_list(source, count, item, &property.name, values)?,
            }
        }
        source.end_record(element)?;
    }
    Ok(Table { columns })
}

fn read_list(source: &mut impl Source, count: Scalar, item: Scalar, name: &str, values: &mut Values) -> Result<()> {
    let length = list_length(source, count, item, name)?;
    if let Values::Lists(lists, _) = values {
        lists.lengths.push(length);
    }
    for _ in 0..length {
        let place = source.place();
        let value = source.item(item, name)?;
        if let Values::Lists(lists, range) = values {
            // An item is read as an integer type, so the cast is exact.
            let index = value as i64;
            if !range.contains(&index) {
                let expected = format!("at least {} and below {}", range.start, range.end);
                return Err(FileError::new(NAME, place, format!("vertex index {index}"), expected).into());
            }
            lists.items.push(u32::try_from(index).unwrap_or(SEPARATOR));
        }
    }
    Ok(())
}

fn list_length(source: &mut impl Source, count: Scalar, item: Scalar, name: &str) -> Result<u32> {
    let place = source.place();
    let length = source.scalar(count, name)?;
    if length < 0.0 {
        return Err(FileError::new(NAME, place, format!("a list of length {length}"), "a length of 0 or more").into());
    }
    let item_bytes = if source.encoding() == Encoding::Ascii { 2 } else { item.size() };
    guard::records(NAME, place, length as u64, item_bytes, source.remaining())?;
    Ok(length as u32)
}

fn column(scalar: Scalar, n: usize) -> Column {
    match scalar {
        Scalar::I8 => Column::I8(Vec::with_capacity(n)),
        Scalar::U8 => Column::U8(Vec::with_capacity(n)),
        Scalar::I16 => Column::I16(Vec::with_capacity(n)),
        Scalar::U16 => Column::U16(Vec::with_capacity(n)),
        Scalar::I32 => Column::I32(Vec::with_capacity(n)),
        Scalar::U32 => Column::U32(Vec::with_capacity(n)),
        Scalar::F32 => Column::F32(Vec::with_capacity(n)),
        Scalar::F64 => Column::F64(Vec::with_capacity(n)),
    }
}

/// Appends a value that was read as the column's own type, so that no cast changes it.
fn push(column: &mut Column, value: f64) {
    match column {
        Column::I8(values) => values.push(value as i8),
        Column::U8(values) => values.push(value as u8),
        Column::I16(values) => values.push(value as i16),
        Column::U16(values) => values.push(value as u16),
        Column::I32(values) => values.push(value as i32),
        Column::U32(values) => values.push(value as u32),
        Column::F32(values) => values.push(value as f32),
        Column::F64(values) => values.push(value),
    }
}
