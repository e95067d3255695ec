//! A radius for each query from a file: text with one a line, or an NPY array of n numbers, told apart by the first bytes.

use super::npy;
use super::text::{Lines, number, shown};
use crate::error::{Error, FileError, Place, Result};
use crate::geometry::validate;

/// Name of the text in errors.
const TEXT: &str = "radii";

/// Radii that can be searched, in the order of the file, as f32.
///
/// Text has one number a line; empty lines and those that start with `#` are skipped. An NPY array has shape (n,) or
/// (n, 1) and floats or integers. A file without radii gives none.
///
/// # Errors
/// `File` with the line or the element, for what is no number and for numbers that are no radius: negative, NaN, infinite,
/// or with a square that is not a normal f32.
pub fn parse_radii(bytes: &[u8]) -> Result<Vec<f32>> {
    if bytes.starts_with(npy::MAGIC) {
        let values = npy::read_list(bytes)?;
        return values.into_iter().enumerate().map(|(i, value)| radius(value, Place::Whole, Some(i))).collect();
    }
    let mut radii = vec![];
    for (line_number, line) in Lines::new(bytes) {
        let line = line.trim_ascii();
        if line.is_empty() || line.starts_with(b"#") {
            continue;
        }
        if line.contains(&b' ') || line.contains(&b'\t') || line.contains(&b',') {
            return Err(FileError::new(TEXT, Place::Line(line_number), shown(line), "one number a line").into());
        }
        radii.push(radius(number(TEXT, line_number, line, "the radius")?, Place::Line(line_number), None)?);
    }
    Ok(radii)
}

/// The number as a radius, or where it stands and why it is none.
fn radius(value: f64, place: Place, element: Option<usize>) -> Result<f32> {
    let radius = value as f32;
    match validate::radius(radius, None) {
        Err(Error::InvalidRadius { reason, .. }) => {
            let at = element.map(|i| format!(" at index {i}")).unwrap_or_default();
            let format = if element.is_some() { npy::NPY } else { TEXT };
            Err(FileError::new(format, place, format!("{value}{at}, which {reason}"), "a radius").into())
        }
        other => other.map(|()| radius),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::{NpyArray, write_npz};

    fn told(bytes: &[u8]) -> String {
        parse_radii(bytes).unwrap_err().to_string()
    }

    /// The array of an archive as a file of its own.
    fn npy(array: NpyArray<'_>) -> Vec<u8> {
        let mut archive = std::io::Cursor::new(vec![]);
        write_npz(&[("radii", array)], &mut archive).unwrap();
        let archive = archive.into_inner();
        let start = archive.windows(6).position(|w| w == npy::MAGIC).unwrap();
        let end = archive.windows(4).position(|w| w == b"PK\x01\x02").unwrap();
        archive[start..end].to_vec()
    }

    #[test]
    fn text_has_one_radius_a_line() {
        let text = b"\xEF\xBB\xBF# of each probe\r\n0.5\r\n\r\n  1e-3 \n0\n7";
        assert_eq!(parse_radii(text).unwrap(), [0.5, 1e-3, 0.0, 7.0]);
        assert_eq!(parse_radii(b"").unwrap(), [0.0; 0]);
    }

    #[test]
    fn arrays_are_floats_or_integers_of_one_axis() {
        assert_eq!(parse_radii(&npy(NpyArray::F32(&[0.5, 0.0, 3.0]))).unwrap(), [0.5, 0.0, 3.0]);
        assert_eq!(parse_radii(&npy(NpyArray::U64(&[1, 2]))).unwrap(), [1.0, 2.0]);
        let text = std::str::from_utf8(&npy(NpyArray::F32(&[]))[10..]).unwrap().replace("(0,)", "(0,3)");
        let mut table = npy(NpyArray::F32(&[]))[..10].to_vec();
        table.extend(text.as_bytes());
        table[8] += 1;
        assert!(told(&table).contains("(0, 3)"), "{}", told(&table));
    }

    #[test]
    fn what_is_no_radius_is_placed() {
        for (text, place, why) in [
            ("1\n-2\n", ":2:", "negative"),
            ("1\n\nnan", ":3:", "not a number"),
            ("inf", ":1:", "infinite"),
            ("1e300", ":1:", "infinite"),
            ("1e-30", ":1:", "normal"),
            ("0.5\nwide\n", ":2:", "\"wide\""),
            ("1 2\n", ":1:", "one number a line"),
            ("1,2\n", ":1:", "one number a line"),
        ] {
            let told = told(text.as_bytes());
            assert!(told.contains(place) && told.contains(why), "{text:?}: {told}");
        }
        let told = told(&npy(NpyArray::F32(&[1.0, 2.0, f32::NAN])));
        assert!(told.contains("at index 2") && told.contains("not a number"), "{told}");
    }

    #[test]
    fn arrays_that_are_cut_off_anywhere_are_errors() {
        let whole = npy(NpyArray::F32(&[0.5, 0.25]));
        for end in npy::MAGIC.len()..whole.len() {
            assert!(parse_radii(&whole[..end]).is_err(), "{end}");
        }
        let mut longer = whole;
        longer.push(0);
        assert!(parse_radii(&longer).is_err());
    }
}
