//! The header of a PCD file: lines of text up to `DATA`.

use super::FORMAT;
use crate::Result;
use crate::error::{FileError, Place};
use crate::io::columns::{MAX_COLUMNS, Scalar};

/// How the points are stored behind the header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    /// One point a line.
    Ascii,
    /// One record a point.
    Binary,
    /// All values of a field together, compressed by LZF.
    BinaryCompressed,
}

/// One field of a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Field<'a> {
    /// Name, such as "x".
    pub(super) name: &'a str,
    /// Type of its values.
    pub(super) scalar: Scalar,
    /// Values a point.
    pub(super) count: usize,
    /// Byte at which it starts in a record.
    pub(super) offset: usize,
}

/// What the header says.
#[derive(Debug)]
pub(super) struct Header<'a> {
    /// Fields in file order.
    pub(super) fields: Vec<Field<'a>>,
    /// Bytes of a point.
    pub(super) record_size: usize,
    /// Number of points.
    pub(super) points: u64,
    /// 1-based line of `POINTS`, or of what stands for it.
    pub(super) points_line: u64,
    /// How the points are stored.
    pub(super) encoding: Encoding,
    /// Byte at which the points start.
    pub(super) body: usize,
    /// 1-based line at which the points start.
    pub(super) body_line: u64,
}

/// A header line: its number and the words behind the keyword.
#[derive(Debug, Clone)]
struct Entry<'a> {
    line: u64,
    words: Vec<&'a str>,
}

/// Error at a line of the header.
fn error(line: u64, found: impl Into<String>, expected: impl Into<String>) -> crate::Error {
    FileError::new(FORMAT, Place::Line(line), found, expected).into()
}

/// The header lines by keyword.
#[derive(Default)]
struct Entries<'a> {
    fields: Option<Entry<'a>>,
    size: Option<Entry<'a>>,
    kind: Option<Entry<'a>>,
    count: Option<Entry<'a>>,
    width: Option<Entry<'a>>,
    height: Option<Entry<'a>>,
    points: Option<Entry<'a>>,
}

impl<'a> Header<'a> {
    /// Reads the header that `bytes` starts with.
    ///
    /// # Errors
    /// `File` with the line at fault.
    pub(super) fn read(bytes: &'a [u8]) -> Result<Self> {
        let mut entries = Entries::default();
        let (mut at, mut line) = (0, 0);
        let encoding = loop {
            line += 1;
            if at >= bytes.len() {
                let found = if bytes.is_empty() { "an empty file" } else { "the end of the file in the header" };
                return Err(error(line, found, "header lines up to DATA"));
            }
            let length = bytes[at..].iter().position(|&b| b == b'\n');
            let text = &bytes[at..at + length.unwrap_or(bytes.len() - at)];
            at += text.len() + usize::from(length.is_some());
            let Ok(text) = std::str::from_utf8(text) else {
                return Err(error(line, "bytes that are not text", "a header line"));
            };
            let mut words = text.split_ascii_whitespace();
            let Some(keyword) = words.next().filter(|word| !word.starts_with('#')) else { continue };
            let slot = match keyword {
                "VERSION" | "VIEWPOINT" => continue,
                "FIELDS" | "COLUMNS" => &mut entries.fields,
                "SIZE" => &mut entries.size,
                "TYPE" => &mut entries.kind,
                "COUNT" => &mut entries.count,
                "WIDTH" => &mut entries.width,
                "HEIGHT" => &mut entries.height,
                "POINTS" => &mut entries.points,
                "DATA" => {
                    // A file cut inside this word must not pass for one without points.
                    if length.is_none() {
                        return Err(error(line, "the end of the file in the header", "points behind DATA"));
                    }
                    break encoding(line, words.next())?;
                }
                other => return Err(error(line, format!("{:?}", shortened(other)), "a PCD header keyword")),
            };
            if slot.is_some() {
                return Err(error(line, format!("a second {keyword}"), "each keyword once"));
            }
            *slot = Some(Entry { line, words: words.collect() });
        };
        let (fields, record_size) = fields(&entries, line)?;
        let (points, points_line) = points(&entries, line)?;
        Ok(Header { fields, record_size, points, points_line, encoding, body: at, body_line: line + 1 })
    }

    /// The field called `name`.
    pub(super) fn field(&self, name: &str) -> Option<&Field<'a>> {
        self.fields.iter().find(|field| field.name == name)
    }

    /// Values on a line of an ascii file.
    pub(super) fn values_per_point(&self) -> usize {
        self.fields.iter().map(|field| field.count).sum()
    }
}

/// The first characters of a word from the file, for an error.
pub(super) fn shortened(word: &str) -> String {
    let mut text: String = word.chars().take(40).collect();
    if text.len() < word.len() {
        text.push('…');
    }
    text
}

fn encoding(line: u64, word: Option<&str>) -> Result<Encoding> {
    match word {
        Some("ascii") => Ok(Encoding::Ascii),
        Some("binary") => Ok(Encoding::Binary),
        Some("binary_compressed") => Ok(Encoding::BinaryCompressed),
        other => {
            let found = format!("DATA {}", shortened(other.unwrap_or("without a value")));
            Err(error(line, found, "DATA ascii, binary or binary_compressed"))
        }
    }
}

/// A whole number in the header.
fn number(line: u64, what: &str, word: &str) -> Result<u64> {
    word.parse().map_err(|_| error(line, format!("{what} {:?}", shortened(word)), "a whole number"))
}

fn fields<'a>(entries: &Entries<'a>, data_line: u64) -> Result<(Vec<Field<'a>>, usize)> {
    let required = |entry: &'_ Option<Entry<'a>>, keyword: &str| {
        entry
            .clone()
            .ok_or_else(|| error(data_line, format!("a header without {keyword}"), format!("a {keyword} line")))
    };
    let names = required(&entries.fields, "FIELDS")?;
    let sizes = required(&entries.size, "SIZE")?;
    let kinds = required(&entries.kind, "TYPE")?;
    let n = names.words.len();
    for (keyword, entry) in [("SIZE", Some(&sizes)), ("TYPE", Some(&kinds)), ("COUNT", entries.count.as_ref())] {
        if let Some(entry) = entry.filter(|entry| entry.words.len() != n) {
            let found = format!("{keyword} with {} values", entry.words.len());
            return Err(error(entry.line, found, format!("{n}, one a field")));
        }
    }
    let mut fields = Vec::with_capacity(n);
    let (mut offset, mut columns) = (0_usize, 0_u64);
    for (i, &name) in names.words.iter().enumerate() {
        let scalar = scalar(&kinds, &sizes, i)?;
        let count = match &entries.count {
            Some(entry) => number(entry.line, "COUNT", entry.words[i])?,
            None => 1,
        };
        columns = columns.saturating_add(count);
        if count == 0 || columns > MAX_COLUMNS {
            let line = entries.count.as_ref().map_or(names.line, |entry| entry.line);
            let found = format!("COUNT {count} of field {:?}", shortened(name));
            return Err(error(line, found, format!("at least 1, and at most {MAX_COLUMNS} values a point")));
        }
        let count = count as usize;
        fields.push(Field { name, scalar, count, offset });
        offset += count * scalar.size();
    }
    for axis in ["x", "y", "z"] {
        let mut found = fields.iter().filter(|field| field.name == axis);
        match (found.next(), found.next()) {
            (Some(field), None) if field.count == 1 => {}
            (Some(_), None) => return Err(error(names.line, format!("field {axis} with a count above 1"), "count 1")),
            (Some(_), Some(_)) => return Err(error(names.line, format!("two fields {axis}"), "x, y and z once")),
            (None, _) => {
                let found = format!("fields {} without {axis}", shortened(&names.words.join(" ")));
                return Err(error(names.line, found, "fields x, y and z"));
            }
        }
    }
    Ok((fields, offset))
}

fn scalar(kinds: &Entry<'_>, sizes: &Entry<'_>, i: usize) -> Result<Scalar> {
    let (kind, size) = (kinds.words[i], sizes.words[i]);
    Ok(match (kind, size) {
        ("I", "1") => Scalar::I8,
        ("I", "2") => Scalar::I16,
        ("I", "4") => Scalar::I32,
        ("I", "8") => Scalar::I64,
        ("U", "1") => Scalar::U8,
        ("U", "2") => Scalar::U16,
        ("U", "4") => Scalar::U32,
        ("U", "8") => Scalar::U64,
        ("F", "4") => Scalar::F32,
        ("F", "8") => Scalar::F64,
        ("I" | "U" | "F", _) => {
            let found = format!("SIZE {:?} for TYPE {kind}", shortened(size));
            return Err(error(sizes.line, found, "1, 2, 4 or 8 for I and U, 4 or 8 for F"));
        }
        _ => return Err(error(kinds.line, format!("TYPE {:?}", shortened(kind)), "I, U or F")),
    })
}

/// Number of points, from POINTS or WIDTH × HEIGHT, which must agree; and the line that says so.
fn points(entries: &Entries<'_>, data_line: u64) -> Result<(u64, u64)> {
    let value = |entry: &Option<Entry<'_>>, keyword: &str| match entry {
        None => Ok(None),
        Some(Entry { line, words }) => match words[..] {
            [word] => Ok(Some((number(*line, keyword, word)?, *line))),
            _ => Err(error(*line, format!("{keyword} with {} values", words.len()), "one whole number")),
        },
    };
    let width = value(&entries.width, "WIDTH")?;
    let height = value(&entries.height, "HEIGHT")?.map_or(1, |(height, _)| height);
    let points = value(&entries.points, "POINTS")?;
    let Some((width, width_line)) = width else {
        return points.ok_or_else(|| error(data_line, "a header without POINTS and WIDTH", "a POINTS line"));
    };
    let Some(area) = width.checked_mul(height) else {
        return Err(error(width_line, format!("WIDTH {width} and HEIGHT {height}"), "a product below 2^64"));
    };
    match points {
        None => Ok((area, width_line)),
        Some((points, line)) if points == area => Ok((points, line)),
        Some((points, line)) => {
            Err(error(line, format!("POINTS {points}"), format!("{area}, which is WIDTH {width} × HEIGHT {height}")))
        }
    }
}
