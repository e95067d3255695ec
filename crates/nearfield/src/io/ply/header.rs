//! The header: encoding, elements and their properties, with counts still to be doubted.

use super::NAME;
use crate::error::{FileError, Place};
use crate::io::text::{Lines, parsed, shown, words};

/// Enough for every real file; a header is text and could otherwise declare millions.
const MAX_PROPERTIES: usize = 1024;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    pub(super) fn size(self) -> u64 {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::F64 => 8,
        }
    }

    pub(super) fn is_integer(self) -> bool {
        !matches!(self, Scalar::F32 | Scalar::F64)
    }

    fn from_word(word: &[u8]) -> Option<Self> {
        Some(match word {
            b"char" | b"int8" => Scalar::I8,
            b"uchar" | b"uint8" => Scalar::U8,
            b"short" | b"int16" => Scalar::I16,
            b"ushort" | b"uint16" => Scalar::U16,
            b"int" | b"int32" => Scalar::I32,
            b"uint" | b"uint32" => Scalar::U32,
            b"float" | b"float32" => Scalar::F32,
            b"double" | b"float64" => Scalar::F64,
            _ => return None,
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Kind,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    /// The header line that declares it.
    pub(super) line: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// The fewest bytes one record can take.
    pub(super) fn smallest_record(&self, encoding: Encoding) -> u64 {
        let smallest = |p: &Property| match (encoding, p.kind) {
            (Encoding::Ascii, _) => 2, // a digit and what separates it
            (_, Kind::Scalar(scalar)) => scalar.size(),
            (_, Kind::List { count, .. }) => count.size(),
        };
        self.properties.iter().map(smallest).sum()
    }
}

#[derive(Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
}

/// Reads the header; `lines` then stands at the first byte of the body.
pub(super) fn read(lines: &mut Lines<'_>) -> Result<Header, FileError> {
    match lines.next() {
        Some((_, line)) if line.trim_ascii() == b"ply" => {}
        Some((n, line)) => return Err(error(n, shown(line), "the magic word \"ply\"")),
        None => return Err(crate::io::empty(NAME, "the magic word \"ply\"")),
    }
    let mut encoding = None;
    let mut elements: Vec<Element> = vec![];
    let mut n_properties = 0;
    for (n, line) in lines.by_ref() {
        let mut rest = words(line);
        match rest.next().unwrap_or_default() {
            b"comment" | b"obj_info" | b"" => {}
            b"format" => {
                encoding = Some(match rest.next().unwrap_or_default() {
                    b"ascii" => Encoding::Ascii,
                    b"binary_little_endian" => Encoding::LittleEndian,
                    b"binary_big_endian" => Encoding::BigEndian,
                    other => {
                        let expected = "ascii, binary_little_endian or binary_big_endian";
                        return Err(error(n, format!("format {}", shown(other)), expected));
                    }
                });
            }
            b"element" => {
                let (name, count) = (rest.next().unwrap_or_default(), rest.next().unwrap_or_default());
                let Some(count) = parsed::<u64>(count) else {
                    return Err(error(n, shown(line), "\"element NAME COUNT\" with a count from 0 to 2^64 - 1"));
                };
                let name = String::from_utf8_lossy(name).into_owned();
                elements.push(Element { name, count, line: n, properties: vec![] });
            }
            b"property" => {
                let Some(element) = elements.last_mut() else {
                    return Err(error(n, "a property before any element", "\"element NAME COUNT\" first"));
                };
                let property = property(rest).ok_or_else(|| {
                    error(n, shown(line), "\"property TYPE NAME\" or \"property list COUNT_TYPE TYPE NAME\"")
                })?;
                n_properties += 1;
                if n_properties > MAX_PROPERTIES {
                    return Err(error(n, "one more property", &format!("at most {MAX_PROPERTIES} properties")));
                }
                element.properties.push(property);
            }
            b"end_header" => {
                let encoding = encoding.ok_or_else(|| error(n, "a header without a format line", "\"format …\""))?;
                return Ok(Header { encoding, elements });
            }
            _ if elements.is_empty() => {}
            other => return Err(error(n, shown(other), "element, property, comment, obj_info or end_header")),
        }
    }
    Err(error(lines.number(), "the end of the file", "\"end_header\""))
}

fn property<'a>(mut words: impl Iterator<Item = &'a [u8]>) -> Option<Property> {
    let kind = match words.next()? {
        b"list" => {
            let (count, item) = (Scalar::from_word(words.next()?)?, Scalar::from_word(words.next()?)?);
            if !count.is_integer() {
                return None;
            }
            Kind::List { count, item }
        }
        word => Kind::Scalar(Scalar::from_word(word)?),
    };
    Some(Property { name: String::from_utf8_lossy(words.next()?).into_owned(), kind })
}

fn error(line: u64, found: impl Into<String>, expected: &str) -> FileError {
    FileError::new(NAME, Place::Line(line), found, expected)
}
