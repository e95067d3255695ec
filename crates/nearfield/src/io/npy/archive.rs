//! The directory of a zip archive, and the bytes of its entries.

use std::borrow::Cow;
use std::io::Read;

use super::NPZ;
use crate::Result;
use crate::error::{FileError, Place};
use crate::io::guard;

/// Bytes of the record that ends a zip file, without its comment.
const END: usize = 22;
/// Bytes of a directory entry without its name.
const ENTRY: usize = 46;
/// Most entries an archive may have; more is taken for a damaged directory.
const MAX_ENTRIES: u64 = 65_536;
/// A 32-bit field that says "see the 64-bit one".
const SEE_64: u64 = u32::MAX as u64;

/// A file in the archive.
#[derive(Debug)]
pub(super) struct Entry<'a> {
    /// Name without the ending ".npy".
    pub(super) name: String,
    /// Bytes as stored.
    stored: &'a [u8],
    /// Byte of the archive at which they start.
    pub(super) start: u64,
    /// Whether they are deflated.
    deflated: bool,
    /// Bytes once inflated.
    pub(super) size: u64,
    crc: u32,
}

fn error(at: usize, found: impl Into<String>, expected: impl Into<String>) -> crate::Error {
    FileError::new(NPZ, Place::Byte(at as u64), found, expected).into()
}

/// `N` little-endian bytes at `at` as a number.
fn number<const N: usize>(bytes: &[u8], at: u64) -> Result<u64> {
    let at = usize::try_from(at).unwrap_or(usize::MAX);
    let Some(field) = at.checked_add(N).and_then(|end| bytes.get(at..end)) else {
        return Err(error(bytes.len(), "the end of the file in the archive's directory", "a whole directory"));
    };
    Ok(field.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte)))
}

/// The entries called "….npy".
///
/// # Errors
/// `File` with the byte at fault: no or a broken directory, an entry beyond the file, an unknown compression.
pub(super) fn entries(bytes: &[u8]) -> Result<Vec<Entry<'_>>> {
    let (mut at, count, end) = directory(bytes)?;
    guard::records(NPZ, Place::Byte(at), count, ENTRY as u64, end.saturating_sub(at))?;
    if count > MAX_ENTRIES {
        return Err(error(at as usize, format!("{count} entries"), format!("at most {MAX_ENTRIES}")));
    }
    let mut entries: Vec<Entry<'_>> = vec![];
    let mut stored = 0;
    for _ in 0..count {
        if number::<4>(bytes, at)? != 0x0201_4b50 {
            return Err(error(at as usize, "something else", "an entry of the archive's directory"));
        }
        let [name, extra, comment] =
            [number::<2>(bytes, at + 28)?, number::<2>(bytes, at + 30)?, number::<2>(bytes, at + 32)?];
        let next = at + ENTRY as u64 + name + extra + comment;
        if next > end {
            return Err(error(at as usize, "a directory entry that goes beyond the directory", "a whole entry"));
        }
        let name_start = at as usize + ENTRY;
        let extra_start = name_start + name as usize;
        let name = String::from_utf8_lossy(&bytes[name_start..extra_start]);
        if let Some(name) = name.strip_suffix(".npy") {
            let entry = entry(bytes, at, name, &bytes[extra_start..extra_start + extra as usize])?;
            stored += entry.stored.len();
            // Entries that share their bytes turn a small file into any amount of content.
            if stored > bytes.len() {
                return Err(error(at as usize, "entries that overlap", "each entry in its own bytes"));
            }
            entries.push(entry);
        }
        at = next;
    }
    Ok(entries)
}

/// Where the directory starts, how many entries it has, and where it ends at the latest.
fn directory(bytes: &[u8]) -> Result<(u64, u64, u64)> {
    let last = bytes.len().saturating_sub(END);
    let first = last.saturating_sub(usize::from(u16::MAX));
    let ends_file = |at: &usize| {
        let comment = bytes.get(at + 20..at + END).map(|b| usize::from(u16::from_le_bytes([b[0], b[1]])));
        bytes[*at..].starts_with(b"PK\x05\x06") && comment.is_some_and(|n| at + END + n == bytes.len())
    };
    let Some(end) = (first..=last).rev().find(ends_file) else {
        return Err(error(bytes.len(), "the end of the file", "an archive's directory before it"));
    };
    let at = end as u64;
    let (count, start) = (number::<2>(bytes, at + 10)?, number::<4>(bytes, at + 16)?);
    if (count == u64::from(u16::MAX) || start == SEE_64) && end >= 20 && bytes[end - 20..].starts_with(b"PK\x06\x07") {
        let wide = number::<8>(bytes, at - 12)?;
        if wide.checked_add(56).is_none_or(|wide_end| wide_end > at - 20) || number::<4>(bytes, wide)? != 0x0606_4b50 {
            return Err(error(end - 12, format!("a 64-bit directory at byte {wide}"), "its end record there"));
        }
        return Ok((number::<8>(bytes, wide + 48)?, number::<8>(bytes, wide + 32)?, wide));
    }
    Ok((start, count, at))
}

/// The entry described at byte `at` of the archive.
fn entry<'a>(bytes: &'a [u8], at: u64, name: &str, extra: &[u8]) -> Result<Entry<'a>> {
    let [mut packed, mut size] = [number::<4>(bytes, at + 20)?, number::<4>(bytes, at + 24)?];
    let mut local = number::<4>(bytes, at + 42)?;
    let mut wide = wide_fields(extra);
    for field in [&mut size, &mut packed, &mut local] {
        if *field == SEE_64 {
            let missing = || error(at as usize, "an entry without its 64-bit size", "a 64-bit field");
            *field = wide.next().ok_or_else(missing)?;
        }
    }
    if number::<2>(bytes, at + 8)? & 1 != 0 {
        return Err(error(at as usize, format!("array {name:?}, encrypted"), "an archive without encryption"));
    }
    let deflated = match number::<2>(bytes, at + 10)? {
        0 => false,
        8 => true,
        method => {
            let found = format!("array {name:?} compressed by method {method}");
            return Err(error(at as usize + 10, found, "stored (0) or deflated (8)"));
        }
    };
    if local.checked_add(30).is_none_or(|end| end > at) || number::<4>(bytes, local)? != 0x0403_4b50 {
        let found = format!("array {name:?} at byte {local}");
        return Err(error(at as usize + 42, found, "the start of a file of the archive there"));
    }
    let start = local + 30 + number::<2>(bytes, local + 26)? + number::<2>(bytes, local + 28)?;
    let Some(end) = start.checked_add(packed).filter(|&end| end <= at) else {
        let found = format!("array {name:?} of {packed} bytes at byte {start}");
        return Err(error(at as usize + 20, found, format!("an end at byte {at} or before")));
    };
    if !deflated && packed != size {
        let found = format!("array {name:?} stored in {packed} bytes");
        return Err(error(at as usize + 20, found, format!("{size}, its size")));
    }
    let crc = number::<4>(bytes, at + 16)? as u32;
    Ok(Entry { name: name.to_owned(), stored: &bytes[start as usize..end as usize], start, deflated, size, crc })
}

/// The numbers of the zip64 field of an entry.
fn wide_fields(mut extra: &[u8]) -> impl Iterator<Item = u64> {
    let mut found: &[u8] = &[];
    while let [a, b, c, d, rest @ ..] = extra {
        let length = usize::from(u16::from_le_bytes([*c, *d])).min(rest.len());
        if [*a, *b] == [1, 0] {
            found = &rest[..length];
        }
        extra = &rest[length..];
    }
    found.chunks_exact(8).map(|b| u64::from_le_bytes(b.try_into().expect("the chunk should have 8 bytes")))
}

impl<'a> Entry<'a> {
    /// At most the first `limit` bytes.
    ///
    /// # Errors
    /// `File` where they cannot be inflated.
    pub(super) fn head(&self, limit: usize) -> Result<Cow<'a, [u8]>> {
        if !self.deflated {
            return Ok(Cow::Borrowed(&self.stored[..self.stored.len().min(limit)]));
        }
        let mut head = vec![];
        self.inflater().take(limit as u64).read_to_end(&mut head).map_err(|cause| self.broken(&cause))?;
        Ok(Cow::Owned(head))
    }

    /// Inflates into nothing, to see that the content is whole before memory is asked for.
    ///
    /// # Errors
    /// As [`Entry::content`].
    pub(super) fn check(&self) -> Result<()> {
        let mut crc = flate2::Crc::new();
        if !self.deflated {
            crc.update(self.stored);
            return self.check_crc(&crc, true);
        }
        let mut inflater = self.inflater().take(self.size.saturating_add(1));
        let (mut block, mut size) = (vec![0; 1 << 16], 0);
        loop {
            let n = inflater.read(&mut block).map_err(|cause| self.broken(&cause))?;
            if n == 0 {
                return self.check_crc(&crc, size == self.size);
            }
            crc.update(&block[..n]);
            size += n as u64;
        }
    }

    /// All bytes. To be called after [`Entry::check`] where [`Entry::size`] is far above the stored size.
    ///
    /// # Errors
    /// `File` where they cannot be inflated, are fewer or more than the directory says, or fail their checksum.
    pub(super) fn content(&self) -> Result<Cow<'a, [u8]>> {
        if !self.deflated {
            self.check()?;
            return Ok(Cow::Borrowed(self.stored));
        }
        let mut content = Vec::with_capacity(self.size as usize);
        let mut inflater = self.inflater().take(self.size.saturating_add(1));
        inflater.read_to_end(&mut content).map_err(|cause| self.broken(&cause))?;
        let mut crc = flate2::Crc::new();
        crc.update(&content);
        self.check_crc(&crc, content.len() as u64 == self.size)?;
        Ok(Cow::Owned(content))
    }

    fn inflater(&self) -> flate2::read::DeflateDecoder<&'a [u8]> {
        flate2::read::DeflateDecoder::new(self.stored)
    }

    fn broken(&self, cause: &std::io::Error) -> crate::Error {
        let found = format!("array {:?}, which cannot be inflated ({cause})", self.name);
        FileError::new(NPZ, Place::Byte(self.start), found, "deflated data").into()
    }

    fn check_crc(&self, crc: &flate2::Crc, size_fits: bool) -> Result<()> {
        let expected = if !size_fits {
            format!("{} bytes, as the directory says", self.size)
        } else if crc.sum() != self.crc {
            format!("checksum {:08x}", self.crc)
        } else {
            return Ok(());
        };
        let found = format!("array {:?} with checksum {:08x} and another content", self.name, crc.sum());
        Err(FileError::new(NPZ, Place::Byte(self.start), found, expected).into())
    }
}
