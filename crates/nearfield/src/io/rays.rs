//! Rays from a file: a text table with one a line, an NPY array, or an array of an NPZ archive, told apart by the first bytes.

use glam::{DVec3, Vec3};

use super::npy;
use super::text::{Lines, number, shown};
use crate::Ray;
use crate::error::{FileError, Place, Result};

/// Name of the text in errors.
const TEXT: &str = "rays";
/// Columns of a table: origin and direction, and the range of t where it is not 0 to infinity.
const WIDTHS: [u64; 2] = [6, 8];
/// What the columns are.
const NAMES: [&str; 8] =
    ["x", "y", "z", "the direction's x", "the direction's y", "the direction's z", "t_min", "t_max"];

/// Rays in the order of the file, relative to `origin`, that of the mesh they are cast into.
///
/// A ray has six numbers, its origin in world coordinates and its direction, or eight, then the smallest and the largest
/// t; without them t goes from 0 to infinity. Numbers may be NaN or infinite: what cannot be cast is for
/// [`Ray::fault`] to say.
///
/// Text has one ray a line, separated by spaces, tabs, commas or semicolons; empty lines and those that start with `#` or
/// `//` are skipped, and so is a first line that starts with a letter and names the columns (`x` …). All lines have as many
/// numbers as the first. An NPY array has shape (n, 6) or (n, 8); of an NPZ archive the array `rays` is read, or the only
/// one of such a shape. A file without rays gives none.
///
/// # Errors
/// `File` with the line or the array, for what is no number, a line of another length, and an array of another shape.
pub fn parse_rays(bytes: &[u8], origin: DVec3) -> Result<Vec<Ray>> {
    if bytes.starts_with(npy::MAGIC) || bytes.starts_with(b"PK") {
        let columns = npy::read_table(bytes, "rays", &WIDTHS)?;
        let n = columns.first().map_or(0, Vec::len);
        return Ok((0..n).map(|i| ray(|k| columns.get(k).map(|column| column[i]), origin)).collect());
    }
    let mut rays = vec![];
    let mut expected = None;
    for (line_number, line) in Lines::new(bytes) {
        let line = line.trim_ascii();
        if line.is_empty() || line.starts_with(b"#") || line.starts_with(b"//") {
            continue;
        }
        let mut words = line
            .split(|&b| b.is_ascii_whitespace() || b == b',' || b == b';')
            .filter(|word| !word.is_empty())
            .peekable();
        let names_columns = |word: &&[u8]| matches!(word.to_ascii_lowercase().as_slice(), b"x" | b"ox" | b"origin_x");
        if expected.is_none() && words.peek().is_some_and(names_columns) {
            continue;
        }
        let (mut numbers, mut n) = ([0.0; 8], 0);
        for word in words {
            let Some(&name) = NAMES.get(n) else {
                return Err(wrong_length(line_number, line, expected));
            };
            numbers[n] = number(TEXT, line_number, word, name)?;
            n += 1;
        }
        if !(WIDTHS.contains(&(n as u64)) && expected.is_none_or(|expected| expected == n)) {
            return Err(wrong_length(line_number, line, expected));
        }
        expected = Some(n);
        rays.push(ray(|k| (k < n).then_some(numbers[k]), origin));
    }
    Ok(rays)
}

fn wrong_length(line_number: u64, line: &[u8], expected: Option<usize>) -> crate::Error {
    let expected = match expected {
        Some(n) => format!("{n} numbers, as in the lines before"),
        None => "6 numbers (origin, direction) or 8 (and t_min, t_max)".to_owned(),
    };
    FileError::new(TEXT, Place::Line(line_number), shown(line), expected).into()
}

/// The ray whose number of column `k` is `at(k)`.
fn ray(at: impl Fn(usize) -> Option<f64>, origin: DVec3) -> Ray {
    let value = |k: usize| at(k).unwrap_or(0.0);
    let start = DVec3::new(value(0), value(1), value(2)) - origin;
    Ray {
        origin: start.as_vec3(),
        t_min: value(6) as f32,
        direction: Vec3::new(value(3) as f32, value(4) as f32, value(5) as f32),
        t_max: at(7).map_or(f32::INFINITY, |t| t as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::{NpyArray, write_npz};

    fn told(bytes: &[u8]) -> String {
        parse_rays(bytes, DVec3::ZERO).unwrap_err().to_string()
    }

    /// An archive with tables of f32, given by name and number of columns.
    fn archive(tables: &[(&str, usize, &[f32])]) -> Vec<u8> {
        let mut archive = std::io::Cursor::new(vec![]);
        let mut writer = zip::ZipWriter::new(&mut archive);
        for (name, columns, values) in tables {
            writer.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
            std::io::Write::write_all(&mut writer, &npy_bytes(*columns, values)).unwrap();
        }
        writer.finish().unwrap();
        archive.into_inner()
    }

    fn npy_bytes(columns: usize, values: &[f32]) -> Vec<u8> {
        let rows = values.len() / columns;
        let text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, {columns}), }}\n");
        let length = (text.len() as u16).to_le_bytes();
        let elements: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        [b"\x93NUMPY\x01\x00".as_slice(), &length, text.as_bytes(), &elements].concat()
    }

    const TWO: [Ray; 2] = [
        Ray {
            origin: Vec3::new(1.0, 2.0, 3.0),
            t_min: 0.0,
            direction: Vec3::new(0.0, 0.0, -1.0),
            t_max: f32::INFINITY,
        },
        Ray { origin: Vec3::ZERO, t_min: 0.0, direction: Vec3::new(0.5, 0.0, 0.25), t_max: f32::INFINITY },
    ];
    const TWO_AS_NUMBERS: [f32; 12] = [1.0, 2.0, 3.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.25];

    #[test]
    fn text_arrays_and_archives_give_the_same_rays() {
        for text in [
            "1 2 3 0 0 -1\n0 0 0 0.5 0 0.25\n",
            "\u{feff}# rays\r\nx y z dx dy dz\r\n1, 2, 3, 0, 0, -1\r\n\r\n0;0;0;0.5;0;.25",
        ] {
            assert_eq!(parse_rays(text.as_bytes(), DVec3::ZERO).unwrap(), TWO, "{text}");
        }
        assert_eq!(parse_rays(&npy_bytes(6, &TWO_AS_NUMBERS), DVec3::ZERO).unwrap(), TWO);
        let named = archive(&[("others", 6, &[7.0; 6]), ("rays", 6, &TWO_AS_NUMBERS)]);
        assert_eq!(parse_rays(&named, DVec3::ZERO).unwrap(), TWO);
        let only = archive(&[("weights", 3, &[7.0; 6]), ("mine", 6, &TWO_AS_NUMBERS)]);
        assert_eq!(parse_rays(&only, DVec3::ZERO).unwrap(), TWO);
    }

    #[test]
    fn a_range_of_t_is_two_more_numbers_and_origins_are_relative_to_the_mesh() {
        let expected = Ray { origin: Vec3::new(0.25, 0.0, -1.0), t_min: 0.5, direction: Vec3::X, t_max: 2.0 };
        let origin = DVec3::new(6.0e6, 0.0, 1.0);
        let read = parse_rays(b"6000000.25 0 0 1 0 0 0.5 2", origin).unwrap();
        assert_eq!(read, [expected]);
        let array = npy_bytes(8, &[0.25, 0.0, -1.0, 1.0, 0.0, 0.0, 0.5, 2.0]);
        assert_eq!(parse_rays(&array, DVec3::ZERO).unwrap(), [expected]);
    }

    #[test]
    fn rays_that_cannot_be_cast_are_kept_and_no_rays_are_none() {
        let read = parse_rays(b"nan 0 0 1 0 0 0 inf\n0 0 0 0 0 0 0 inf\n", DVec3::ZERO).unwrap();
        assert!(read.iter().all(|ray| ray.fault().is_some()), "{read:?}");
        assert!(parse_rays(b"", DVec3::ZERO).unwrap().is_empty());
        assert!(parse_rays(&npy_bytes(6, &[]), DVec3::ZERO).unwrap().is_empty());
    }

    #[test]
    fn what_is_no_ray_is_placed() {
        for (text, place, why) in [
            ("1 2 3 0 0\n", ":1:", "6 numbers"),
            ("1 2 3 0 0 1 0\n", ":1:", "6 numbers"),
            ("1 2 3 0 0 1\n1 2 3 0 0 1 0 9\n", ":2:", "6 numbers, as in"),
            ("1 2 3 0 0 1 0 9 9\n", ":1:", "6 numbers"),
            ("1 2 3 0 wide 1\n", ":1:", "the direction's y"),
            ("\nwide\n", ":2:", "a number for x"),
        ] {
            let told = told(text.as_bytes());
            assert!(told.contains(place) && told.contains(why), "{text:?}: {told}");
        }
        assert!(told(&npy_bytes(7, &[0.0; 7])).contains("(1, 7)"));
        let two = archive(&[("a", 6, &[7.0; 6]), ("b", 8, &[7.0; 8])]);
        assert!(told(&two).contains("\"rays\""), "{}", told(&two));
        let mut list = std::io::Cursor::new(vec![]);
        write_npz(&[("rays", NpyArray::F32(&[1.0; 6]))], &mut list).unwrap();
        assert!(told(&list.into_inner()).contains("(6,)"));
    }

    #[test]
    fn arrays_that_are_cut_off_anywhere_are_errors() {
        let whole = npy_bytes(6, &TWO_AS_NUMBERS);
        assert!((npy::MAGIC.len()..whole.len()).all(|end| parse_rays(&whole[..end], DVec3::ZERO).is_err()));
        let whole = archive(&[("rays", 6, &TWO_AS_NUMBERS)]);
        assert!((2..whole.len()).all(|end| parse_rays(&whole[..end], DVec3::ZERO).is_err()));
    }
}
