//! The elements of a file: its points, its arrays, and where their numbers are.

use super::FORMAT;
use super::xml::{Event, Scanner, Tag, line_of};
use crate::error::{FileError, Place};
use crate::io::columns::MAX_COLUMNS;
use crate::io::text::shown;
use crate::{Error, Result};

/// What is read of a file.
pub(super) struct Document<'a> {
    /// The whole file.
    pub(super) bytes: &'a [u8],
    /// Whether sizes of arrays have 64 bits, not 32.
    pub(super) wide_sizes: bool,
    /// Whether the most significant byte of a number comes first.
    pub(super) big_endian: bool,
    /// How arrays are compressed that are not text.
    pub(super) compressor: Option<String>,
    /// Points, as the piece says.
    pub(super) n_points: u64,
    /// Their coordinates.
    pub(super) points: Option<Element<'a>>,
    /// Arrays with values for each point.
    pub(super) point_data: Vec<Element<'a>>,
    /// The name of the array that holds normals.
    pub(super) normals: Option<String>,
    /// Numbers behind the XML.
    pub(super) appended: Option<Appended<'a>>,
}

/// A `DataArray`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Element<'a> {
    pub(super) tag: Tag<'a>,
    /// Its own text.
    pub(super) text: &'a [u8],
    /// The byte behind its tag.
    pub(super) at: usize,
}

/// Numbers behind the XML.
#[derive(Debug, Clone, Copy)]
pub(super) struct Appended<'a> {
    /// Bytes as they are, not base64.
    pub(super) is_raw: bool,
    /// From the first byte that offsets count from.
    pub(super) bytes: &'a [u8],
    /// Its place in the file.
    pub(super) start: usize,
}

impl<'a> Document<'a> {
    /// Reads the XML; what an array holds is looked at later.
    ///
    /// # Errors
    /// `File` with the line of what is no XML, and for files that are not of one piece of poly data.
    pub(super) fn parse(bytes: &'a [u8]) -> Result<Self> {
        let mut document = Self {
            bytes,
            wide_sizes: false,
            big_endian: false,
            compressor: None,
            n_points: 0,
            points: None,
            point_data: Vec::new(),
            normals: None,
            appended: None,
        };
        let (mut scanner, mut open) = (Scanner::new(bytes), Vec::<&[u8]>::new());
        let (mut has_root, mut has_piece) = (false, false);
        let mut array: Option<Element<'a>> = None;
        loop {
            let at = scanner.at();
            let wrong = |found: String, expected: &str| fault(line_of(bytes, at), found, expected);
            let Some(event) = scanner.next()? else { break };
            match event {
                Event::Text(text) if open.last() == Some(&&b"DataArray"[..]) => {
                    if let Some(array) = array.as_mut().filter(|array| array.text.trim_ascii().is_empty()) {
                        array.text = text;
                    }
                }
                Event::Text(_) => {}
                Event::Start { tag, is_empty } => {
                    check_place(tag.name, &open, has_root).map_err(|(found, expected)| wrong(found, expected))?;
                    match tag.name {
                        b"VTKFile" if open.is_empty() => {
                            document.note_file(tag).map_err(|(found, expected)| wrong(found, expected))?;
                            has_root = true;
                        }
                        b"Piece" if has_piece => return Err(wrong("a second piece".into(), "a file of one piece")),
                        b"Piece" => {
                            let count = tag.value("NumberOfPoints").unwrap_or_default();
                            let number = count.parse().map_err(|_| wrong(shown(count.as_bytes()), "NumberOfPoints"));
                            (document.n_points, has_piece) = (number?, true);
                        }
                        b"PointData" if matches!(open[..], [_, _, b"Piece"]) => document.normals = tag.value("Normals"),
                        b"DataArray" => array = Some(Element { tag, text: &[], at: scanner.at() }),
                        b"AppendedData" => {
                            document.appended = Some(appended(bytes, tag, scanner.at())?);
                            break;
                        }
                        _ => {}
                    }
                    if !is_empty {
                        open.push(tag.name);
                    } else if tag.name == b"DataArray" {
                        document.keep(array.take(), &open).map_err(|(f, e)| wrong(f, e))?;
                    }
                }
                Event::End(name) => {
                    let closed = open.pop();
                    if closed != Some(name) {
                        let expected = closed.map_or("no closing tag".into(), |name| format!("</{}>", text_of(name)));
                        return Err(wrong(format!("</{}>", text_of(name)), &expected));
                    }
                    if name == b"DataArray" {
                        document.keep(array.take(), &open).map_err(|(f, e)| wrong(f, e))?;
                    }
                }
            }
        }
        if !has_piece {
            return Err(fault(Place::Whole, "no <Piece> in a <VTKFile>".into(), "VTK XML poly data"));
        }
        match open.last().filter(|_| document.appended.is_none()) {
            Some(name) => {
                let found = format!("the end of the file inside <{}>", text_of(name));
                Err(fault(line_of(bytes, bytes.len()), found, "a whole file"))
            }
            None => Ok(document),
        }
    }

    /// What the outermost element says of all arrays.
    fn note_file(&mut self, tag: Tag<'_>) -> std::result::Result<(), (String, &'static str)> {
        let is = |key: &str, usual: &str| tag.value(key).unwrap_or_else(|| usual.to_owned());
        let choices = [
            ("type", "", &["PolyData"][..], "a file of type PolyData; convert other types with ParaView"),
            ("byte_order", "LittleEndian", &["LittleEndian", "BigEndian"], "LittleEndian or BigEndian"),
            ("header_type", "UInt32", &["UInt32", "UInt64"], "UInt32 or UInt64"),
        ];
        for (key, usual, known, expected) in choices {
            let found = is(key, usual);
            if !known.contains(&found.as_str()) {
                return Err((format!("{key} {}", shown(found.as_bytes())), expected));
            }
        }
        self.big_endian = is("byte_order", "") == "BigEndian";
        self.wide_sizes = is("header_type", "") == "UInt64";
        self.compressor = tag.value("compressor").filter(|name| !name.is_empty());
        Ok(())
    }

    /// Keeps an array that says something about points.
    ///
    /// - `open`: the elements around it, outermost first
    fn keep(&mut self, array: Option<Element<'a>>, open: &[&[u8]]) -> std::result::Result<(), (String, &'static str)> {
        let [_, _, b"Piece", parent] = open else { return Ok(()) };
        match (*parent, array) {
            (b"Points", Some(_)) if self.points.is_some() => {
                return Err(("a second array of points".into(), "one"));
            }
            (b"Points", array) => self.points = array,
            (b"PointData", Some(_)) if self.point_data.len() as u64 == MAX_COLUMNS => {
                return Err((format!("more than {MAX_COLUMNS} arrays"), "fewer"));
            }
            (b"PointData", array) => self.point_data.extend(array),
            _ => {}
        }
        Ok(())
    }
}

/// Whether an element that says what a file is stands where it can.
///
/// - `open`: the elements around it, outermost first
fn check_place(name: &[u8], open: &[&[u8]], has_root: bool) -> std::result::Result<(), (String, &'static str)> {
    let expected = match (name, open) {
        (b"VTKFile", []) if !has_root => return Ok(()),
        (_, []) => "one <VTKFile> around everything",
        (b"Piece", [b"VTKFile", b"PolyData"]) | (b"AppendedData", [b"VTKFile"]) => return Ok(()),
        (b"Piece", _) => "it in the <PolyData> of a <VTKFile>",
        (b"AppendedData", _) => "it in a <VTKFile>, behind <PolyData>",
        _ => return Ok(()),
    };
    let around = open.last().map_or("nothing".into(), |name| format!("<{}>", text_of(name)));
    Err((format!("<{}> in {around}", text_of(name)), expected))
}

/// The numbers behind the tag `AppendedData`, which begin behind an underscore.
fn appended<'a>(bytes: &'a [u8], tag: Tag<'_>, at: usize) -> Result<Appended<'a>> {
    let encoding = tag.value("encoding").unwrap_or_else(|| "base64".to_owned());
    if !["raw", "base64"].contains(&encoding.as_str()) {
        return Err(fault(line_of(bytes, at), format!("encoding {}", shown(encoding.as_bytes())), "raw or base64"));
    }
    let blanks = bytes[at..].iter().take_while(|byte| byte.is_ascii_whitespace()).count();
    let start = at + blanks + 1;
    if bytes.get(start - 1) != Some(&b'_') {
        return Err(fault(Place::Byte(start as u64 - 1), "no underscore".into(), "one before appended data"));
    }
    let is_raw = encoding == "raw";
    let rest = &bytes[start..];
    let end = if is_raw { None } else { rest.iter().position(|&byte| byte == b'<') };
    Ok(Appended { is_raw, bytes: &rest[..end.unwrap_or(rest.len())], start })
}

/// A name as an error shows it.
fn text_of(name: &[u8]) -> String {
    String::from_utf8_lossy(&name[..name.len().min(40)]).into_owned()
}

pub(super) fn fault(place: Place, found: String, expected: &str) -> Error {
    FileError::new(FORMAT, place, found, expected).into()
}
