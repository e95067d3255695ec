//! As much of XML as VTK files have: tags with attributes, text, comments and declarations.

use super::FORMAT;
use crate::Result;
use crate::error::{FileError, Place};
use crate::io::text::shown;

/// What stands next in a file.
pub(super) enum Event<'a> {
    /// A tag that opens an element; it is closed at once where it is empty.
    Start { tag: Tag<'a>, is_empty: bool },
    /// A tag that closes an element of this name.
    End(&'a [u8]),
    /// What stands between tags.
    Text(&'a [u8]),
}

/// A tag that opens an element.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tag<'a> {
    /// Its name.
    pub(super) name: &'a [u8],
    attributes: &'a [u8],
}

/// Goes through a file from tag to tag.
pub(super) struct Scanner<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Scanner<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// The byte that is read next.
    pub(super) fn at(&self) -> usize {
        self.at
    }

    /// What stands next; `None` at the end of the file.
    ///
    /// # Errors
    /// `File` with the line of a tag or a comment that does not end, or of what is neither.
    pub(super) fn next(&mut self) -> Result<Option<Event<'a>>> {
        loop {
            let (start, rest) = (self.at, &self.bytes[self.at..]);
            let wrong = |found: &str, expected: &str| {
                let found = format!("{found} {}", shown(&rest[..rest.len().min(100)]));
                Err(FileError::new(FORMAT, line_of(self.bytes, start), found, expected).into())
            };
            if rest.is_empty() {
                return Ok(None);
            }
            if rest[0] != b'<' {
                let length = rest.iter().position(|&byte| byte == b'<').unwrap_or(rest.len());
                self.at += length;
                return Ok(Some(Event::Text(&rest[..length])));
            }
            let skipped =
                [(&b"<?"[..], &b"?>"[..]), (b"<!--", b"-->")].into_iter().find(|(open, _)| rest.starts_with(open));
            if let Some((open, close)) = skipped {
                let inside = &rest[open.len()..];
                let Some(length) = inside.windows(close.len()).position(|window| window == close) else {
                    return wrong("a comment or declaration without an end:", "its end");
                };
                self.at += open.len() + length + close.len();
                continue;
            }
            if rest.starts_with(b"<!") {
                return wrong("a declaration", "tags, text and comments");
            }
            let mut quote = None;
            let is_end = |&byte: &u8| {
                match quote {
                    Some(open) if byte == open => quote = None,
                    None if matches!(byte, b'"' | b'\'') => quote = Some(byte),
                    _ => {}
                }
                quote.is_none() && byte == b'>'
            };
            let Some(length) = rest.iter().position(is_end) else {
                return wrong("a tag without an end:", "`>`");
            };
            self.at += length + 1;
            let inside = &rest[1..length];
            if let Some(name) = inside.strip_prefix(b"/") {
                return Ok(Some(Event::End(name.trim_ascii())));
            }
            let (inside, is_empty) = inside.strip_suffix(b"/").map_or((inside, false), |inside| (inside, true));
            let end_of_name = inside.iter().position(u8::is_ascii_whitespace).unwrap_or(inside.len());
            let (name, attributes) = inside.split_at(end_of_name);
            return Ok(Some(Event::Start { tag: Tag { name, attributes }, is_empty }));
        }
    }
}

impl Tag<'_> {
    /// The value of an attribute.
    pub(super) fn value(&self, key: &str) -> Option<String> {
        let mut rest = self.attributes;
        loop {
            let equals = rest.iter().position(|&byte| byte == b'=')?;
            let name = rest[..equals].trim_ascii();
            let quoted = rest[equals + 1..].trim_ascii_start();
            let (&quote, inside) = quoted.split_first().filter(|(quote, _)| matches!(quote, b'"' | b'\''))?;
            let end = inside.iter().position(|&byte| byte == quote)?;
            if name == key.as_bytes() {
                return Some(unescaped(&String::from_utf8_lossy(&inside[..end])));
            }
            rest = &inside[end + 1..];
        }
    }
}

fn unescaped(text: &str) -> String {
    let marks = [("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&apos;", "'"), ("&amp;", "&")];
    marks.into_iter().fold(text.to_owned(), |text, (mark, character)| text.replace(mark, character))
}

/// The line of a byte.
pub(super) fn line_of(bytes: &[u8], at: usize) -> Place {
    Place::Line(1 + bytes[..at.min(bytes.len())].iter().filter(|&&byte| byte == b'\n').count() as u64)
}
