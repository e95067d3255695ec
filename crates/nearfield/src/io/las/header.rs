//! The header of a LAS file, checked against the bytes that are there.

use las::point::Format;
use las::{Transform, Vector};

use super::FORMAT;
use crate::Result;
use crate::error::{FileError, Place};
use crate::io::guard;

/// Bytes of the smallest header, that of version 1.0.
const SMALLEST_HEADER: usize = 227;
/// Bytes of an extended record without its content.
const EXTENDED_RECORD: u64 = 60;

/// What of the header is needed to read the points.
pub(super) struct Header {
    /// Layout of a point; with the extra bytes behind it.
    pub(super) format: Format,
    /// Number of the format, 0 to 10.
    pub(super) format_number: u8,
    /// Scale and offset of each axis.
    pub(super) transforms: Vector<Transform>,
    /// Number of points.
    pub(super) points: u64,
    /// Bytes of a point.
    pub(super) record_size: usize,
    /// Byte at which the variable length records start.
    pub(super) records_start: usize,
    /// Number of variable length records.
    pub(super) records: u32,
    /// Byte at which the points start.
    pub(super) points_start: usize,
}

/// Error at a byte.
pub(super) fn error(byte: usize, found: impl Into<String>, expected: impl Into<String>) -> crate::Error {
    FileError::new(FORMAT, Place::Byte(byte as u64), found, expected).into()
}

impl Header {
    /// Reads and checks the header.
    ///
    /// # Errors
    /// `File` with the byte at fault.
    pub(super) fn read(bytes: &[u8]) -> Result<Self> {
        if !bytes.starts_with(b"LASF") {
            let start = &bytes[..bytes.len().min(4)];
            let found = if bytes.is_empty() { "an empty file".into() } else { format!("\"{}\"", start.escape_ascii()) };
            return Err(error(0, found, "\"LASF\""));
        }
        if bytes.len() < SMALLEST_HEADER {
            return Err(error(bytes.len(), "the end of the file in the header", format!("{SMALLEST_HEADER} bytes")));
        }
        if bytes[24] != 1 || bytes[25] > 4 {
            return Err(error(24, format!("version {}.{}", bytes[24], bytes[25]), "version 1.0 to 1.4"));
        }
        let raw = las::raw::Header::read_from(bytes)
            .map_err(|cause| error(bytes.len(), format!("a header that cannot be read ({cause})"), "a whole header"))?;
        let (header_size, points_start) = (usize::from(raw.header_size), raw.offset_to_point_data as usize);
        if raw.header_size < raw.version.header_size() {
            let expected = format!("at least {} in version {}", raw.version.header_size(), raw.version);
            return Err(error(94, format!("a header size of {header_size}"), expected));
        }
        if points_start < header_size || points_start > bytes.len() {
            let expected = format!("between the header size {header_size} and the file size {}", bytes.len());
            return Err(error(96, format!("point data at byte {points_start}"), expected));
        }
        let records = raw.number_of_variable_length_records;
        guard::records(FORMAT, Place::Byte(100), records.into(), 54, (points_start - header_size) as u64)?;
        let (format, format_number) = point_format(&raw)?;
        let points = point_count(&raw)?;
        let transforms = transforms(&raw)?;
        if let Some(extended) = raw.evlr {
            check_extended_records(bytes, extended.start_of_first_evlr, extended.number_of_evlrs)?;
        }
        Ok(Self {
            format,
            format_number,
            transforms,
            points,
            record_size: usize::from(raw.point_data_record_length),
            records_start: header_size,
            records,
            points_start,
        })
    }
}

fn point_format(raw: &las::raw::Header) -> Result<(Format, u8)> {
    let number = raw.point_data_record_format;
    // LASzip marks compression in the two upper bits.
    let plain = number & 0x3f;
    let unknown = || error(104, format!("point format {number}"), "point format 0 to 10");
    if plain > 10 {
        return Err(unknown());
    }
    let mut format = Format::new(plain).map_err(|_| unknown())?;
    format.is_compressed = number != plain;
    let (found, smallest) = (raw.point_data_record_length, format.len());
    let Some(extra_bytes) = found.checked_sub(smallest) else {
        return Err(error(
            105,
            format!("a record length of {found}"),
            format!("at least {smallest} in format {plain}"),
        ));
    };
    format.extra_bytes = extra_bytes;
    Ok((format, plain))
}

fn point_count(raw: &las::raw::Header) -> Result<u64> {
    let legacy = u64::from(raw.number_of_point_records);
    match raw.large_file.map(|large| large.number_of_point_records) {
        Some(count) if legacy != 0 && legacy != count => {
            Err(error(247, format!("a count of {count} points"), format!("{legacy}, the count at byte 107")))
        }
        Some(count) => Ok(count),
        None => Ok(legacy),
    }
}

fn transforms(raw: &las::raw::Header) -> Result<Vector<Transform>> {
    let scales = [raw.x_scale_factor, raw.y_scale_factor, raw.z_scale_factor];
    let offsets = [raw.x_offset, raw.y_offset, raw.z_offset];
    for (axis, (&scale, &offset)) in scales.iter().zip(&offsets).enumerate() {
        if !scale.is_finite() || scale == 0.0 {
            return Err(error(131 + 8 * axis, format!("a scale of {scale:e}"), "a finite number that is not zero"));
        }
        if !offset.is_finite() {
            return Err(error(155 + 8 * axis, format!("an offset of {offset:e}"), "a finite number"));
        }
    }
    let [x, y, z] = std::array::from_fn(|axis| Transform { scale: scales[axis], offset: offsets[axis] });
    Ok(Vector { x, y, z })
}

/// Walks the records behind the points, which are not read, so that a file cut inside them is noticed.
fn check_extended_records(bytes: &[u8], start: u64, count: u32) -> Result<()> {
    let size = bytes.len() as u64;
    if start > size {
        let expected = format!("at most the file size {size}");
        return Err(error(235, format!("extended records at byte {start}"), expected));
    }
    guard::records(FORMAT, Place::Byte(243), count.into(), EXTENDED_RECORD, size - start)?;
    let mut at = start;
    for _ in 0..count {
        let length = bytes.get(at as usize + 20..at as usize + 28);
        let length = length.map(|b| u64::from_le_bytes(b.try_into().expect("the slice should have 8 bytes")));
        let end = length.and_then(|length| length.checked_add(at + EXTENDED_RECORD)).filter(|&end| end <= size);
        match end {
            Some(end) => at = end,
            None => return Err(error(at as usize, "an extended record that goes beyond the file", "a whole record")),
        }
    }
    Ok(())
}
