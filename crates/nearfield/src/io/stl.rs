//! STL, ascii and binary: triangles whose equal corners (to the last bit) become one vertex.

use std::collections::HashMap;

use glam::DVec3;

use super::text::{Lines, number, shown, words};
use super::{empty, guard, mesh_from_world};
use crate::error::{FileError, Place, Result};
use crate::{PointCloud, TriMesh};

const NAME: &str = "STL";

/// Bytes before the first triangle of a binary file: a free text and the count.
const BINARY_START: usize = 84;

/// Bytes of a triangle: normal, three corners, two bytes that programs use as they like.
const BINARY_TRIANGLE: usize = 50;

/// The welded vertices.
pub(super) fn read_cloud(bytes: &[u8]) -> Result<PointCloud> {
    Ok(PointCloud::from_world(&read(bytes)?.vertices))
}

/// The triangles over welded vertices; the facet normals follow from the corners and are not kept.
pub(super) fn read_mesh(bytes: &[u8]) -> Result<TriMesh> {
    let welded = read(bytes)?;
    Ok(mesh_from_world(&welded.vertices, welded.triangles))
}

fn read(bytes: &[u8]) -> Result<Welded> {
    if bytes.is_empty() {
        return Err(empty(NAME, "\"solid\" or a binary header of 84 bytes").into());
    }
    if is_ascii(bytes) { read_ascii(bytes) } else { read_binary(bytes) }
}

/// Binary files may begin with "solid" too: what decides is a size that fits the count, then the words that follow.
fn is_ascii(bytes: &[u8]) -> bool {
    if binary_count(bytes).is_some_and(|n| (bytes.len() - BINARY_START) as u64 == n * BINARY_TRIANGLE as u64) {
        return false;
    }
    let mut lines = Lines::new(bytes).map(|(_, line)| line).filter(|line| !line.trim_ascii().is_empty());
    let starts = |line: Option<&[u8]>, word: &[u8]| line.is_none_or(|line| keyword(line).eq_ignore_ascii_case(word));
    if !starts(lines.next(), b"solid") {
        return false;
    }
    let second = lines.next();
    starts(second, b"facet") || starts(second, b"endsolid")
}

fn binary_count(bytes: &[u8]) -> Option<u64> {
    let count = bytes.get(80..BINARY_START)?.first_chunk::<4>()?;
    Some(u32::from_le_bytes(*count).into())
}

fn read_binary(bytes: &[u8]) -> Result<Welded> {
    let Some(declared) = binary_count(bytes) else {
        let found = format!("{} bytes that do not begin with \"solid\"", bytes.len());
        return Err(FileError::new(NAME, Place::Whole, found, "a binary header of 84 bytes").into());
    };
    let (count_place, body) = (Place::Byte(80), &bytes[BINARY_START..]);
    guard::records(NAME, count_place, declared, BINARY_TRIANGLE as u64, body.len() as u64)?;
    let records = body.chunks_exact(BINARY_TRIANGLE);
    if records.len() as u64 != declared || !records.remainder().is_empty() {
        let found = format!("a count of {declared} triangles before {} bytes", body.len());
        let expected = format!("{} bytes, {BINARY_TRIANGLE} a triangle", declared * BINARY_TRIANGLE as u64);
        return Err(FileError::new(NAME, count_place, found, expected).into());
    }
    let mut welded = Welded::default();
    for record in records {
        let mut floats = record[12..48].chunks_exact(4).filter_map(<[u8]>::first_chunk).map(|b| f32::from_le_bytes(*b));
        let mut next = || f64::from(floats.next().unwrap_or(f32::NAN));
        let corners = [(); 3].map(|()| DVec3::new(next(), next(), next()));
        welded.add(corners);
    }
    Ok(welded)
}

/// What may come next in an ascii file.
#[derive(Clone, Copy)]
enum Expect {
    Solid,
    FacetOrEnd,
    Loop,
    Vertex(usize),
    EndLoop,
    EndFacet,
}

impl Expect {
    fn words(self) -> &'static str {
        match self {
            Expect::Solid => "\"solid\"",
            Expect::FacetOrEnd => "\"facet\" or \"endsolid\"",
            Expect::Loop => "\"outer loop\"",
            Expect::Vertex(_) => "\"vertex x y z\", three of them",
            Expect::EndLoop => "\"endloop\"",
            Expect::EndFacet => "\"endfacet\"",
        }
    }
}

fn read_ascii(bytes: &[u8]) -> Result<Welded> {
    let mut welded = Welded::default();
    let mut expect = Expect::Solid;
    let mut corners = [DVec3::ZERO; 3];
    let mut last_line = 0;
    for (n, line) in Lines::new(bytes) {
        last_line = n;
        let word = keyword(line).to_ascii_lowercase();
        expect = match (expect, word.as_slice()) {
            (same, b"") => same,
            (Expect::Solid, b"solid") => Expect::FacetOrEnd,
            (Expect::FacetOrEnd, b"facet") => Expect::Loop,
            (Expect::FacetOrEnd, b"endsolid") => Expect::Solid,
            (Expect::Loop, b"outer") => Expect::Vertex(0),
            (Expect::Vertex(i), b"vertex") => {
                corners[i] = ascii_vertex(n, line)?;
                if i < 2 { Expect::Vertex(i + 1) } else { Expect::EndLoop }
            }
            (Expect::EndLoop, b"endloop") => Expect::EndFacet,
            (Expect::EndFacet, b"endfacet") => {
                welded.add(corners);
                Expect::FacetOrEnd
            }
            (other, _) => {
                return Err(FileError::new(NAME, Place::Line(n), shown(line.trim_ascii()), other.words()).into());
            }
        };
    }
    match expect {
        Expect::Solid if last_line > 0 => Ok(welded),
        open => Err(FileError::new(NAME, Place::Line(last_line), "the end of the file", open.words()).into()),
    }
}

fn keyword(line: &[u8]) -> &[u8] {
    words(line).next().unwrap_or_default()
}

fn ascii_vertex(n: u64, line: &[u8]) -> Result<DVec3> {
    let mut coordinates = words(line).skip(1);
    let mut vertex = DVec3::ZERO;
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        vertex[i] = number(NAME, n, coordinates.next().unwrap_or_default(), axis)?;
    }
    match coordinates.next() {
        None => Ok(vertex),
        Some(word) => Err(FileError::new(NAME, Place::Line(n), shown(word), "three coordinates").into()),
    }
}

#[derive(Default)]
struct Welded {
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    index_of: HashMap<[u64; 3], u32>,
}

impl Welded {
    fn add(&mut self, corners: [DVec3; 3]) {
        let triangle = corners.map(|corner| {
            let bits = corner.to_array().map(f64::to_bits);
            *self.index_of.entry(bits).or_insert_with(|| {
                self.vertices.push(corner);
                // A file of 2^32 vertices would be 72 GB; the count of a binary file does not reach it.
                (self.vertices.len() - 1) as u32
            })
        });
        self.triangles.push(triangle);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;

    /// Two triangles of a square.
    const SQUARE: [[[f32; 3]; 3]; 2] =
        [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.5]], [[0.0, 0.0, 0.0], [1.0, 1.0, 0.5], [0.0, 1.0, 0.0]]];

    fn ascii(start: &str, end: &str) -> String {
        let mut text = start.to_owned();
        for corners in SQUARE {
            text += "  facet normal 0 0 1\n    outer loop\n";
            for [x, y, z] in corners {
                text += &format!("      vertex {x:e} {y} {z}\n");
            }
            text += "    endloop\n  endfacet\n";
        }
        text + end
    }

    fn binary(header: &[u8]) -> Vec<u8> {
        let mut bytes = header.to_vec();
        bytes.resize(80, b' ');
        bytes.extend(2u32.to_le_bytes());
        for corners in SQUARE {
            bytes.extend([0; 12]);
            bytes.extend(corners.iter().flatten().flat_map(|c| c.to_le_bytes()));
            bytes.extend([0; 2]);
        }
        bytes
    }

    fn assert_square(bytes: &[u8]) {
        let mesh = read_mesh(bytes).unwrap();
        let vertices: Vec<_> = mesh.vertices.iter().map(|v| (v.as_dvec3() + mesh.origin).to_array()).collect();
        assert_eq!(vertices, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.5], [0.0, 1.0, 0.0]]);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(read_cloud(bytes).unwrap().len(), 4);
    }

    fn message(bytes: &[u8]) -> String {
        match read_mesh(bytes) {
            Err(error @ Error::File(_)) => error.to_string(),
            other => panic!("expected a file error, got {other:?}"),
        }
    }

    #[test]
    fn ascii_in_every_common_spelling_gives_the_welded_square() {
        assert_square(ascii("solid name with words\n", "endsolid name\n").as_bytes());
        assert_square(ascii("solid\tname\r\n", "endsolid").as_bytes());
        assert_square(ascii("\nsolid\n", "endsolid\n\n").to_uppercase().as_bytes());
    }

    #[test]
    fn binary_gives_the_same_even_if_its_header_begins_with_solid() {
        assert_square(&binary(b"made by hand"));
        assert_square(&binary(b"solid part\nfacet normal"));
    }

    #[test]
    fn our_reading_of_binary_equals_stl_io() {
        let bytes = binary(b"x");
        let theirs = stl_io::read_stl(&mut std::io::Cursor::new(&bytes)).unwrap();
        let ours = read_mesh(&bytes).unwrap();
        let vertices: Vec<[f32; 3]> = theirs.vertices.iter().map(|v| v.0).collect();
        assert_eq!(ours.vertices.iter().map(|v| v.to_array()).collect::<Vec<_>>(), vertices);
        let faces: Vec<[usize; 3]> = theirs.faces.iter().map(|f| f.vertices).collect();
        assert_eq!(ours.triangles.iter().map(|t| t.map(|i| i as usize)).collect::<Vec<_>>(), faces);
    }

    #[test]
    fn errors_name_the_line_or_byte() {
        let good = ascii("solid a\n", "endsolid a\n");
        let cases: [(Vec<u8>, &[&str]); 6] = [
            (vec![], &["an empty file"]),
            (b"hello".to_vec(), &["5 bytes", "binary header of 84 bytes"]),
            (
                good.replacen("vertex 1e0 0 0", "vertex 1e0 zero 0", 1).into_bytes(),
                &[":5:", "\"zero\"", "a number for y"],
            ),
            (good.replacen("      vertex 1e0 0 0\n", "", 1).into_bytes(), &[":6:", "\"endloop\"", "three of them"]),
            (good.replace("endsolid a\n", "").into_bytes(), &[":15:", "the end of the file", "endsolid"]),
            (
                {
                    let mut bytes = binary(b"x");
                    bytes[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
                    bytes
                },
                &["at byte 80", "4294967295", "at most 2"],
            ),
        ];
        for (bytes, parts) in cases {
            let message = message(&bytes);
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
    }

    #[test]
    fn a_file_cut_anywhere_is_an_error() {
        let text = ascii("solid a\n", "endsolid");
        for seed in [binary(b"seed"), text.into_bytes()] {
            for end in 0..seed.len() {
                let result = read_mesh(&seed[..end]);
                assert!(matches!(result, Err(Error::File(_))), "cut at {end}: {result:?}");
            }
        }
    }
}
