//! What is written is read back, and so is what VTK writes; damage is told.

use std::time::{Duration, Instant};

use glam::{DVec3, Vec3};

use super::{read, write_cloud};
use crate::geometry::{Attribute, Column, PointCloud};
use crate::{Error, Result};

fn cloud(origin: DVec3) -> PointCloud {
    let mut cloud = PointCloud::new(vec![Vec3::new(1.0, 2.0, 3.0), Vec3::new(-0.5, 7.25, 0.25), Vec3::ZERO]);
    cloud.origin = origin;
    cloud.normals = Some(vec![Vec3::X, Vec3::Z, Vec3::Y]);
    cloud.colors = Some(vec![[1, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12]]);
    let column = |name: &str, values| Attribute { name: name.into(), values };
    cloud.attributes = vec![
        column("a<\"b\">&c", Column::I16(vec![-1, 300, 5])),
        column("density", Column::F32(vec![0.1, f32::NAN, -0.0])),
        column("class", Column::U8(vec![0, 1, 255])),
    ];
    cloud
}

fn written(cloud: &PointCloud) -> Vec<u8> {
    let mut bytes = vec![];
    write_cloud(cloud, &mut bytes).unwrap();
    bytes
}

fn world(cloud: &PointCloud) -> Vec<DVec3> {
    cloud.points.iter().map(|p| cloud.origin + p.as_dvec3()).collect()
}

#[test]
fn clouds_come_back_as_they_were() {
    for origin in [DVec3::ZERO, DVec3::new(600_000.0, 5_000_000.0, 0.0)] {
        let cloud = cloud(origin);
        let found = read(&written(&cloud)).unwrap();
        assert_eq!(world(&found), world(&cloud));
        assert_eq!((&found.normals, &found.colors), (&cloud.normals, &cloud.colors));
        assert_eq!(found.attributes.len(), 3);
        for (found, expected) in found.attributes.iter().zip(&cloud.attributes) {
            assert_eq!(found.name, expected.name);
            assert_eq!(format!("{:?}", found.values), format!("{:?}", expected.values), "NaN too");
        }
    }
    assert_eq!(read(&written(&PointCloud::default())).unwrap().len(), 0);
}

/// A file of two points with an array of each kind, as ParaView lays it out.
///
/// - `attributes`: of the outermost element
/// - `arrays`: attributes and text of coordinates, a vector, a number a point
/// - `tail`: what stands behind the poly data
fn file(attributes: &str, arrays: [[&str; 2]; 3], tail: &str) -> Vec<u8> {
    let [[points, places], [vector, vectors], [single, singles]] = arrays;
    format!(
        "<?xml version=\"1.0\"?>\n<!-- a > b -->\n<VTKFile type=\"PolyData\" version=\"0.1\"{attributes}>\n  <PolyData>\n    \
         <FieldData>\n      <DataArray type=\"Float64\" Name=\"TimeValue\" NumberOfTuples=\"1\" format=\"ascii\">\n        0.5\n      \
         </DataArray>\n    </FieldData>\n    <Piece NumberOfPoints=\"2\" NumberOfVerts=\"0\">\n      <PointData Scalars='count'>\n        \
         <DataArray type=\"Float64\" Name=\"velocity\" NumberOfComponents=\"3\" {vector}>\n{vectors}\n          \
         <InformationKey name=\"L2_NORM_RANGE\" location=\"vtkDataArray\" length=\"2\">\n            <Value index=\"0\">\n              \
         99\n            </Value>\n          </InformationKey>\n        </DataArray>\n        \
         <DataArray type=\"Int64\" Name=\"count\" {single}>{singles}</DataArray>\n      </PointData>\n      \
         <CellData>\n      </CellData>\n      <Points>\n        <DataArray type=\"Float32\" Name=\"Points\" NumberOfComponents=\"3\" \
         {points}>{places}</DataArray>\n      </Points>\n      <Verts>\n        \
         <DataArray type=\"Int64\" Name=\"connectivity\" format=\"ascii\"></DataArray>\n      </Verts>\n    </Piece>\n  </PolyData>\n\
         {tail}"
    )
    .into_bytes()
}

fn base64(bytes: &[u8]) -> String {
    const CHARACTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for group in bytes.chunks(3) {
        let word = group.iter().fold(0u32, |word, &byte| word << 8 | u32::from(byte)) << (8 * (3 - group.len()));
        for i in 0..4 {
            let bits = (word >> (18 - 6 * i)) as usize & 63;
            text.push(if i <= group.len() { CHARACTERS[bits] as char } else { '=' });
        }
    }
    text
}

const ASCII: [&str; 2] = ["format=\"ascii\"", ""];
const PLACES: [f32; 6] = [0.5, -1.0, 2e3, 1.0, 0.0, 0.25];
const VECTORS: [f64; 6] = [0.1, 1e-300, -3.0, 4.0, 5.0, 6.0];
const COUNTS: [i64; 2] = [-7, 1 << 40];

fn is_sound(bytes: &[u8]) {
    let cloud = read(bytes).unwrap();
    let expected: Vec<DVec3> = PLACES.chunks(3).map(|p| Vec3::from_slice(p).as_dvec3()).collect();
    assert_eq!(world(&cloud), expected);
    let every = |k: usize| Column::F64(vec![VECTORS[k], VECTORS[3 + k]]);
    let names: Vec<&str> = cloud.attributes.iter().map(|attribute| attribute.name.as_str()).collect();
    assert_eq!(names, ["velocity_0", "velocity_1", "velocity_2", "count"]);
    for (k, attribute) in cloud.attributes[..3].iter().enumerate() {
        assert_eq!(attribute.values, every(k));
    }
    assert_eq!(cloud.attributes[3].values, Column::F64(COUNTS.map(|count| count as f64).into()));
}

fn ascii() -> Vec<u8> {
    let text = |places| [ASCII[0], places];
    let arrays = [text("0.5 -1 2e3\n 1 0\t.25"), text("0.1 1e-300 -3\n4 5 6"), text(" -7 1099511627776 ")];
    file("", arrays, "</VTKFile>\n")
}

/// The arrays in bytes of either order, each behind its size.
fn arrays(big_endian: bool, wide: bool) -> [Vec<u8>; 3] {
    macro_rules! bytes {
        ($numbers:expr) => {
            $numbers
                .iter()
                .flat_map(|n| if big_endian { n.to_be_bytes() } else { n.to_le_bytes() })
                .collect::<Vec<u8>>()
        };
    }
    [bytes!(PLACES), bytes!(VECTORS), bytes!(COUNTS)].map(|numbers| {
        let size = if wide { bytes!([numbers.len() as u64]) } else { bytes!([numbers.len() as u32]) };
        [size, numbers].concat()
    })
}

fn attributes(big_endian: bool, wide: bool) -> String {
    let order = if big_endian { "BigEndian" } else { "LittleEndian" };
    format!(" byte_order=\"{order}\" header_type=\"{}\"", if wide { "UInt64" } else { "UInt32" })
}

fn binary(big_endian: bool, wide: bool, size_apart: bool) -> Vec<u8> {
    let width = if wide { 8 } else { 4 };
    let text = arrays(big_endian, wide).map(|bytes| match size_apart {
        true => format!("\n  {}{}\n", base64(&bytes[..width]), base64(&bytes[width..])),
        false => format!("\n  {}\n", base64(&bytes)),
    });
    let format = "format=\"binary\" RangeMin=\"0\"";
    file(&attributes(big_endian, wide), [0, 1, 2].map(|i| [format, &text[i]]), "</VTKFile>\n")
}

fn appended(big_endian: bool, wide: bool, is_raw: bool) -> Vec<u8> {
    let mut data: Vec<u8> = vec![];
    let formats = arrays(big_endian, wide).map(|bytes| {
        let offset = data.len();
        data.extend(if is_raw { bytes } else { base64(&bytes).into_bytes() });
        format!("format=\"appended\" offset=\"{offset}\"")
    });
    let encoding = if is_raw { "raw" } else { "base64" };
    let tail = format!("  <AppendedData encoding=\"{encoding}\">\n   _");
    let head = file(&attributes(big_endian, wide), [0, 1, 2].map(|i| [formats[i].as_str(), ""]), &tail);
    [&head, data.as_slice(), b"\n  </AppendedData>\n</VTKFile>\n"].concat()
}

#[test]
fn every_encoding_gives_the_same_points() {
    is_sound(&ascii());
    for (big_endian, wide) in [(false, false), (false, true), (true, false), (true, true)] {
        for other in [false, true] {
            is_sound(&binary(big_endian, wide, other));
            is_sound(&appended(big_endian, wide, other));
        }
    }
}

#[test]
fn normals_are_named_by_the_point_data() {
    let text = String::from_utf8(ascii()).unwrap();
    let cloud = read(text.replace("Scalars='count'", "Normals='velocity'").as_bytes()).unwrap();
    assert_eq!(cloud.normals.unwrap()[1], Vec3::new(4.0, 5.0, 6.0));
    assert_eq!(cloud.attributes.len(), 1);
}

fn told(result: Result<PointCloud>) -> String {
    match result {
        Err(error @ Error::File(_)) => error.to_string(),
        other => panic!("expected a fault of the file, not {other:?}"),
    }
}

#[test]
fn damaged_files_say_what_is_wrong_and_where() {
    let text = String::from_utf8(ascii()).unwrap();
    let line = |of: &str| 1 + text[..text.find(of).unwrap()].matches('\n').count();
    for (from, to, place, expected) in [
        ("\"PolyData\" version", "\"ImageData\" version", 3, "PolyData"),
        ("NumberOfPoints=\"2\"", "NumberOfPoints=\"3\"", line("2e3"), "9 of them"),
        ("NumberOfPoints=\"2\"", "NumberOfPoints=\"99999999999999\"", line("2e3"), "bytes of text"),
        ("NumberOfPoints=\"2\"", "NumberOfPoints=\"-2\"", line("<Piece"), "NumberOfPoints"),
        ("2e3", "2e3x", line("2e3"), "number of 32 bits"),
        (".25<", ".25 9<", line("2e3"), "6 of them"),
        (" 0\t", "\t", line("2e3"), "5 numbers"),
        ("1099511627776", "1e9", line("1099511627776"), "a whole number of 64 bits"),
        ("\"Float32\"", "\"String\"", line("2e3"), "Float32, Float64"),
        ("NumberOfComponents=\"3\" format=\"ascii\">0.5", "format=\"ascii\">0.5", line("2e3"), "2 of them"),
        (
            "Name=\"count\" format=\"ascii\"",
            "Name=\"count\" format=\"zip\"",
            line("\"count\""),
            "ascii, binary or appended",
        ),
        ("Name=\"count\" format=\"ascii\"", "Name=\"count\" format=\"appended\"", line("\"count\""), "AppendedData"),
        ("Name=\"count\" format=\"ascii\"", "Name=\"count\" format=\"binary\"", line("\"count\""), "base64"),
        ("      </Points>", "", line("</Piece>"), "</Points>"),
        ("<CellData>", "<!DOCTYPE a>", line("<CellData>"), "comments"),
        ("-->", "--", 2, "its end"),
        ("</VTKFile>", "", line("</VTKFile>") + 1, "inside <VTKFile>"),
        ("  </PolyData>", "<Piece NumberOfPoints=\"0\"/></PolyData>", line("</PolyData>"), "second piece"),
        ("<Points>", "<Places>", line("</Points>"), "</Places>"),
    ] {
        assert!(text.contains(from), "{from}");
        let changed = text.replacen(from, to, 1);
        let message = told(read(changed.as_bytes()));
        assert!(message.contains(expected) && message.contains(&format!(":{place}")), "{to}: {place}: {message}");
    }
    for bytes in [&b""[..], b"x", b"<a/>", b"\x00\xff<", b"<VTKFile type=\"PolyData\"/>"] {
        told(read(bytes));
    }
}

#[test]
fn compressed_and_shared_numbers_are_refused() {
    let compressed = |bytes: Vec<u8>| {
        let at = bytes.windows(8).position(|window| window == b"<VTKFile").unwrap() + 8;
        [&bytes[..at], b" compressor=\"vtkZLibDataCompressor\"", &bytes[at..]].concat()
    };
    assert!(told(read(&compressed(appended(false, true, true)))).contains("vtkZLibDataCompressor"));
    is_sound(&compressed(ascii()));
    // Twenty arrays of 100,000 points at one place.
    let many = "<DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/>".repeat(20);
    let head = format!(
        "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"100000\"><PointData>{many}</PointData><Points>\
         <DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/></Points></Piece></PolyData>\
         <AppendedData encoding=\"raw\">_"
    );
    let shared = [head.into_bytes(), 1_200_000u32.to_le_bytes().to_vec(), vec![0; 1_200_000]].concat();
    assert!(told(read(&shared)).contains("numbers of their own"));
}

#[test]
fn elements_stand_where_they_can() {
    let sound = String::from_utf8(ascii()).unwrap();
    let behind = String::from_utf8(appended(false, false, false)).unwrap();
    for (text, from, to, expected) in [
        (&sound, "VTKFile", "File", "<File> in nothing, expected one <VTKFile>"),
        (&sound, "</VTKFile>", "</VTKFile><VTKFile type=\"PolyData\"/>", "<VTKFile> in nothing"),
        (&sound, "<VTKFile type=\"PolyData\"", "<VTKFile", "type"),
        (&sound, "PolyData>", "Grid>", "<Piece> in <Grid>"),
        (&sound, "<PolyData>", "", "<Piece> in <VTKFile>"),
        (&sound, "Points>", "CellData>", "no array in <Points>"),
        (&behind, "  </PolyData>", "", "<AppendedData> in <PolyData>"),
    ] {
        assert!(text.contains(from), "{from}");
        let message = told(read(text.replace(from, to).as_bytes()));
        assert!(message.contains(expected), "{to}: {expected}: {message}");
    }
}

/// Many arrays of no numbers, all with the size 0 that stands behind the XML.
fn empty_arrays(blanks_in_xml: usize, blanks_in_data: usize) -> Vec<u8> {
    let many = "<DataArray type=\"UInt8\" format=\"appended\" offset=\"0\"/>".repeat(60_000);
    let points = "<DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/>";
    let (first, second) = ("\n".repeat(blanks_in_xml), "\n".repeat(blanks_in_data));
    format!(
        "<VTKFile type=\"PolyData\"><PolyData>{first}<Piece NumberOfPoints=\"0\"><PointData>{many}</PointData><Points>{points}\
         </Points></Piece></PolyData><AppendedData encoding=\"base64\">_{second}AAAAAA==</AppendedData></VTKFile>"
    )
    .into_bytes()
}

#[test]
fn time_does_not_grow_with_arrays_times_bytes() {
    // Both would be some 10^11 steps.
    let start = Instant::now();
    assert_eq!(read(&empty_arrays(1 << 20, 0)).unwrap().attributes.len(), 60_000);
    assert!(told(read(&empty_arrays(0, 1 << 20))).contains("numbers of their own"));
    assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
}

#[test]
fn a_file_cut_anywhere_before_its_last_number_is_refused() {
    for bytes in [ascii(), binary(false, true, false), appended(false, false, false), appended(false, true, true)] {
        let end = bytes.windows(10).position(|w| w == b"</VTKFile>").unwrap();
        let end = bytes.windows(15).position(|w| w == b"</AppendedData>").map_or(end, |at| at - 3);
        for cut in 0..end {
            assert!(matches!(read(&bytes[..cut]), Err(Error::File(_))), "cut after {cut} of {end}");
        }
    }
}

#[test]
fn damaged_appended_numbers_name_their_byte() {
    let bytes = appended(false, true, true);
    let start = bytes.windows(2).position(|window| window == b" _").unwrap() + 2;
    let mut larger = bytes.clone();
    larger[start] += 1;
    let message = told(read(&larger));
    assert!(message.contains(&format!("at byte {start}")) && message.contains("an array of 25 bytes"), "{message}");
    let text = |from: &str, to: &str| {
        let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
        told(read(&[&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat()))
    };
    assert!(text("offset=\"0\"", "offset=\"18446744073709551615\"").contains("offset"));
    assert!(text("encoding=\"raw\"", "encoding=\"zip\"").contains("raw or base64"));
    assert!(text(" _", " ").contains("underscore"));
    assert!(text("header_type=\"UInt64\"", "header_type=\"UInt8\"").contains("UInt32 or UInt64"));
    assert!(text("LittleEndian", "MiddleEndian").contains("BigEndian"));
}
