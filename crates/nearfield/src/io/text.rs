//! What the text formats share: numbered lines, numbers with an error that says where, and numbers as written.

use std::fmt;

use crate::error::{FileError, Place};

/// The longest piece of a file that an error message shows, in characters.
const SHOWN: usize = 40;

/// A piece of a file as an error message shows it: quoted, control characters escaped, cut when long.
pub(crate) fn shown(bytes: &[u8]) -> String {
    let head = &bytes[..bytes.len().min(4 * SHOWN)];
    let text = String::from_utf8_lossy(head);
    let cut: String = text.chars().take(SHOWN).collect();
    let dots = if cut.len() < text.len() || head.len() < bytes.len() { "…" } else { "" };
    format!("{cut:?}{dots}")
}

/// The lines of a text file with their 1-based numbers, without line ends (LF or CRLF) and byte order mark.
pub(crate) struct Lines<'a> {
    rest: &'a [u8],
    number: u64,
}

impl<'a> Lines<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes), number: 0 }
    }

    /// What has not been read yet.
    pub(crate) fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// Number of the line read last.
    pub(crate) fn number(&self) -> u64 {
        self.number
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = (u64, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let end = self.rest.iter().position(|&b| b == b'\n');
        let line = &self.rest[..end.unwrap_or(self.rest.len())];
        self.rest = &self.rest[end.map_or(self.rest.len(), |e| e + 1)..];
        self.number += 1;
        Some((self.number, line.strip_suffix(b"\r").unwrap_or(line)))
    }
}

/// The words of a line.
pub(crate) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// Parses a word as any type that reads itself from text.
pub(crate) fn parsed<T: std::str::FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// Parses a number (`nan` and `inf` included) or says on which line it is not one.
pub(crate) fn number(format: &'static str, line: u64, word: &[u8], what: &str) -> Result<f64, FileError> {
    parsed(word).ok_or_else(|| {
        let what: String = what.chars().take(SHOWN).collect();
        FileError::new(format, Place::Line(line), shown(word), format!("a number for {what}"))
    })
}

/// A number in the shortest form that reads back as the same f64.
pub(crate) struct Exact(pub(crate) f64);

impl fmt::Display for Exact {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = self.0.abs();
        if size == 0.0 || (1e-5..1e15).contains(&size) || !size.is_finite() {
            write!(f, "{}", self.0)
        } else {
            write!(f, "{:e}", self.0)
        }
    }
}

/// As [`Exact`] for f32.
pub(crate) struct ExactF32(pub(crate) f32);

impl fmt::Display for ExactF32 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = self.0.abs();
        if size == 0.0 || (1e-5..1e9).contains(&size) || !size.is_finite() {
            write!(f, "{}", self.0)
        } else {
            write!(f, "{:e}", self.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_numbered_and_lose_their_ends() {
        let lines: Vec<_> = Lines::new(b"\xEF\xBB\xBFa\r\n\nb").collect();
        assert_eq!(lines, [(1, &b"a"[..]), (2, b""), (3, b"b")]);
    }

    #[test]
    fn written_numbers_read_back_as_the_same_bits() {
        for value in [0.0, -0.0, 0.1, 5_403_059.123_4, 1e300, 5e-324, -1.0 / 3.0, f64::MAX, f64::INFINITY] {
            let text = Exact(value).to_string();
            assert_eq!(text.parse::<f64>().unwrap().to_bits(), value.to_bits(), "{text}");
        }
        for value in [0.0, -0.0, 0.1, 1e-45, f32::MAX, 123_456.79] {
            let text = ExactF32(value).to_string();
            assert_eq!(text.parse::<f32>().unwrap().to_bits(), value.to_bits(), "{text}");
        }
    }

    #[test]
    fn long_pieces_are_cut_and_control_characters_escaped() {
        assert_eq!(shown(b"a\x00b"), "\"a\\0b\"");
        assert!(shown(&[b'x'; 5000]).chars().count() < 50);
        let error = number("XYZ", 1, &[b'-'; 5000], &"column".repeat(1000)).unwrap_err();
        assert!(error.to_string().len() < 200, "{error}");
    }
}
