//! PLY in all three encodings, the real scan, and the errors for what nobody should write.

use glam::{DVec3, Vec3};

use super::{read_cloud, write_cloud, write_mesh};
use crate::geometry::{Attribute, Column};
use crate::io::Polygons;
use crate::io::test_data::real_file;
use crate::{Error, PointCloud, Result, TriMesh};

/// Polygons as fans.
fn read_mesh(bytes: &[u8]) -> Result<TriMesh> {
    super::read_mesh(bytes, Polygons::Fans)
}

const BODY_HEADER: &str = "element vertex 4\nproperty double x\nproperty float y\nproperty short z\n\
    property uchar red\nproperty uchar green\nproperty uchar blue\nproperty list uchar int unused\n\
    property uint id\nproperty char sign\nelement nothing 3\nelement face 2\n\
    property list uchar ushort vertex_indices\nproperty float quality\nend_header\n";

/// The same square in an encoding: `big_endian` is `None` for ascii.
fn square(big_endian: Option<bool>) -> Vec<u8> {
    let encoding = match big_endian {
        None => "ascii",
        Some(false) => "binary_little_endian",
        Some(true) => "binary_big_endian",
    };
    let mut bytes = format!("ply\nformat {encoding} 1.0\ncomment by hand\n{BODY_HEADER}").into_bytes();
    let Some(big_endian) = big_endian else {
        bytes.extend(
            b"0.1 0 0 255 0 0 0 4000000000 -1\n1 0 -7 0 255 0 2 5 6 7 1\n\n1 1 0 0 0 255 0 8 2\r\n0 1 0 9 9 9 1 4 9 3\n\
            4 0 1 2 3 0.5\n3 0 1\n2 0.25",
        );
        return bytes;
    };
    let mut put = |value: &[u8]| {
        if big_endian {
            bytes.extend(value.iter().rev());
        } else {
            bytes.extend(value);
        }
    };
    type Row = (f64, f32, i16, [u8; 3], &'static [i32], u32, i8);
    let rows: [Row; 4] = [
        (0.1, 0.0, 0, [255, 0, 0], &[], 4_000_000_000, -1),
        (1.0, 0.0, -7, [0, 255, 0], &[5, 6], 7, 1),
        (1.0, 1.0, 0, [0, 0, 255], &[], 8, 2),
        (0.0, 1.0, 0, [9, 9, 9], &[4], 9, 3),
    ];
    for (x, y, z, color, list, id, sign) in rows {
        put(&x.to_le_bytes());
        put(&y.to_le_bytes());
        put(&z.to_le_bytes());
        color.iter().for_each(|&channel| put(&[channel]));
        put(&[list.len() as u8]);
        list.iter().for_each(|item| put(&item.to_le_bytes()));
        put(&id.to_le_bytes());
        put(&sign.to_le_bytes());
    }
    let faces: [(&[u16], f32); 2] = [(&[0, 1, 2, 3], 0.5), (&[0, 1, 2], 0.25)];
    for (corners, quality) in faces {
        put(&[corners.len() as u8]);
        corners.iter().for_each(|corner| put(&corner.to_le_bytes()));
        put(&quality.to_le_bytes());
    }
    bytes
}

fn message(bytes: &[u8]) -> String {
    match read_mesh(bytes) {
        Err(error @ Error::File(_)) => error.to_string(),
        other => panic!("expected a file error, got {other:?}"),
    }
}

#[test]
fn all_three_encodings_give_the_same_cloud_and_mesh() {
    for encoding in [None, Some(false), Some(true)] {
        let bytes = square(encoding);
        let cloud = read_cloud(&bytes).unwrap();
        let expected = [Vec3::new(0.1, 0.0, 0.0), Vec3::new(1.0, 0.0, -7.0), Vec3::new(1.0, 1.0, 0.0), Vec3::Y];
        assert_eq!((cloud.origin, &cloud.points[..]), (DVec3::ZERO, &expected[..]), "{encoding:?}");
        assert_eq!(cloud.colors, Some(vec![[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [9, 9, 9, 255]]));
        let id = Attribute { name: "id".into(), values: Column::U32(vec![4_000_000_000, 7, 8, 9]) };
        let sign = Attribute { name: "sign".into(), values: Column::I8(vec![-1, 1, 2, 3]) };
        assert_eq!(cloud.attributes, [id, sign]);
        let mesh = read_mesh(&bytes).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
        assert_eq!(super::read_mesh(&bytes, Polygons::FirstThree).unwrap().triangles, [[0, 1, 2]; 2]);
        assert_eq!((mesh.vertices, mesh.colors), (cloud.points, cloud.colors));
    }
}

#[test]
fn strips_are_cut_with_alternating_winding() {
    for name in ["tristrips", "vertex_indices"] {
        let text = format!(
            "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n\
            element tristrips 1\nproperty list int int {name}\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n2 2 0\n\
            8 0 1 2 3 -1 2\n3 4\n"
        );
        assert_eq!(read_mesh(text.as_bytes()).unwrap().triangles, [[0, 1, 2], [2, 1, 3], [2, 3, 4]]);
    }
}

#[test]
fn a_sloppy_header_and_float_colours_are_read() {
    let text = b"ply\r\nformat ascii 1.0\r\nCreated by Blender 2.4 - www.blender.org\r\nobj_info scanned\r\n\
        element vertex 1\r\nproperty float32 x\r\nproperty float32 y\r\nproperty float32 z\r\nproperty float nx\r\n\
        property float ny\r\nproperty float nz\r\nproperty float r\r\nproperty float g\r\nproperty float b\r\n\
        property ushort alpha\r\nend_header\r\n1 2 3 0 0 1 1 0.5 0 65535\r\n";
    let cloud = read_cloud(text).unwrap();
    assert_eq!((cloud.len(), cloud.world(0)), (1, DVec3::new(1.0, 2.0, 3.0)));
    assert_eq!(cloud.normals, Some(vec![Vec3::Z]));
    assert_eq!(cloud.colors, Some(vec![[255, 128, 0, 255]]));
    assert!(cloud.attributes.is_empty());
}

#[test]
fn an_incomplete_normal_or_colour_stays_an_attribute() {
    let text = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
        property float nx\nproperty uchar red\nend_header\n1 2 3 0.5 7\n";
    let cloud = read_cloud(text).unwrap();
    let nx = Attribute { name: "nx".into(), values: Column::F32(vec![0.5]) };
    let red = Attribute { name: "red".into(), values: Column::U8(vec![7]) };
    assert_eq!((cloud.normals, cloud.colors, cloud.attributes), (None, None, vec![nx, red]));
}

#[test]
fn invalid_coordinates_are_kept() {
    let text = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
        end_header\nnan 0 0\n0 -inf 1e999\n";
    let cloud = read_cloud(text).unwrap();
    assert!(cloud.points[0].x.is_nan());
    assert_eq!((cloud.points[1].y, cloud.points[1].z), (f32::NEG_INFINITY, f32::INFINITY));
}

fn small(header: &str, body: &str) -> Vec<u8> {
    format!("ply\nformat ascii 1.0\n{header}end_header\n{body}").into_bytes()
}

const XYZ: &str = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
const FACE: &str = "element face 1\nproperty list uchar int vertex_indices\n";

#[test]
fn errors_name_the_line_what_was_found_and_what_was_expected() {
    let points = "0 0 0\n1 0 0\n0 1 0\n";
    let with_faces = format!("{XYZ}{FACE}");
    let cases: Vec<(Vec<u8>, &[&str])> = vec![
        (vec![], &["an empty file"]),
        (b"PLY?\n".to_vec(), &[":1:", "\"PLY?\"", "magic word"]),
        (b"ply\nformat ascii 1.0\n".to_vec(), &[":2:", "end of the file", "end_header"]),
        (b"ply\nformat text 1.0\n".to_vec(), &[":2:", "\"text\"", "binary_big_endian"]),
        (b"ply\nelement vertex 0\nend_header\n".to_vec(), &[":3:", "without a format line"]),
        (b"ply\nformat ascii 1.0\nproperty int x\n".to_vec(), &[":3:", "before any element"]),
        (b"ply\nformat ascii 1.0\nelement vertex -3\n".to_vec(), &[":3:", "element vertex -3", "COUNT"]),
        (small("element vertex 1\nproperty quad x\n", ""), &[":4:", "property quad x"]),
        (small("element face 0\n", ""), &["no element \"vertex\"", "x, y and z"]),
        (small("element vertex 1\nproperty float x\nproperty float y\n", "1 2\n"), &[":3:", "\"x y\"", "x, y and z"]),
        (small(XYZ, points), &["only points", "faces"]),
        (small(XYZ, "0 0 0\n1 0 zero\n0 1 0\n"), &[":9:", "\"zero\"", "F32 for \"z\""]),
        (small(XYZ, "0.00 0 0\n1.00 0\n0 1 0\n"), &[":9:", "the end of the line", "\"z\""]),
        (small(XYZ, "0 0 0\n1 0 0 7\n0 1 0\n"), &[":9:", "\"7\"", "the end of the line"]),
        (small(XYZ, "0.00 0.00 0.00\n1.00 0.00 0.00\n"), &["after 2 of \"vertex\"", "3 of them, as line 3 says"]),
        (
            small(
                "element vertex 18446744073709551615\nproperty float x\nproperty float y\nproperty float z\n",
                points,
            ),
            &[":3:", "18446744073709551615", "at most 3"],
        ),
        (small(&with_faces, &format!("{points}3 0 1 3\n")), &[":13:", "vertex index 3", "below 3"]),
        (small(&with_faces, &format!("{points}3 0 1 -1\n")), &[":13:", "vertex index -1", "at least 0"]),
        (small(&with_faces, &format!("{points}255 0 1 2\n")), &[":13:", "a count of 255", "at most"]),
        (small(&with_faces, &format!("{points}300 0 1 2\n")), &[":13:", "\"300\"", "U8"]),
        (
            small(&format!("{XYZ}element face 1\nproperty list uchar float vertex_indices\n"), points),
            &[":7:", "a list of F32", "integer type"],
        ),
    ];
    for (bytes, parts) in cases {
        let message = message(&bytes);
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    }
}

#[test]
fn a_binary_file_cut_short_names_the_byte() {
    let mut bytes = square(Some(false));
    let full = bytes.len();
    bytes.truncate(full - 2);
    let message = message(&bytes);
    assert!(
        message.contains(&format!("at byte {}", full - 4)) && message.contains("4 bytes of \"quality\""),
        "{message}"
    );
}

#[test]
fn an_error_stays_readable_whatever_the_names_in_the_file() {
    let long = "x".repeat(100_000);
    let header = format!("{XYZ}property list uchar int {long}\nelement {long} 7\nproperty int {long}\n");
    for body in ["0 0 0\n", "0 0 0 1\n", "0 0 0 1 2 3\n", "0 0 0 0\n0 0 0 0\n0 0 0 0\n1\n2 2\n"] {
        let padded = format!("{body}{}", "\n".repeat(100));
        let message = message(&small(&header, &padded));
        assert!(message.len() < 300, "{message}");
    }
}

#[test]
fn records_of_nothing_cost_nothing_whatever_their_count() {
    let text = small(&format!("element empty 18446744073709551615\n{XYZ}"), "0 0 0\n1 0 0\n0 1 0\n");
    assert_eq!(read_cloud(&text).unwrap().len(), 3);
    assert!(message(&small("element vertex 18446744073709551615\n", "")).contains("x, y and z"));
}

#[test]
fn a_file_cut_anywhere_is_an_error() {
    for encoding in [None, Some(false), Some(true)] {
        let seed = square(encoding);
        // The last word of a text may lose digits and stay a number.
        let certain = if encoding.is_none() { seed.len() - 3 } else { seed.len() };
        for end in 0..certain {
            let result = read_mesh(&seed[..end]);
            assert!(matches!(result, Err(Error::File(_))), "{encoding:?} cut at {end}: {result:?}");
        }
    }
}

#[test]
fn what_is_written_reads_back_equal() {
    let near: Vec<DVec3> = (0..40).map(|i| DVec3::new(f64::from(i as f32 / 7.0), -1.0, 1e-20f32.into())).collect();
    let far: Vec<DVec3> =
        (0..40).map(|i| DVec3::new(637_000.001 + f64::from(i), 5_403_059.123_4, f64::from(i) / 7.0)).collect();
    for world in [near, far] {
        let mut cloud = PointCloud::from_world(&world);
        cloud.normals = Some((0..40).map(|i| Vec3::new(1.0 / 3.0, i as f32, -0.1)).collect());
        cloud.colors = Some((0..40).map(|i| [5 * i as u8, 1, 2, i as u8]).collect());
        cloud.attributes = vec![
            Attribute { name: "i8".into(), values: Column::I8((0..40).map(|i| i - 20).collect()) },
            Attribute { name: "u8".into(), values: Column::U8((0..40).collect()) },
            Attribute { name: "i16".into(), values: Column::I16((0..40).map(|i| -800 * i).collect()) },
            Attribute { name: "u16".into(), values: Column::U16((0..40).map(|i| 1600 * i).collect()) },
            Attribute { name: "i32".into(), values: Column::I32((0..40).map(|i| i32::MIN + i).collect()) },
            Attribute { name: "u32".into(), values: Column::U32((0..40).map(|i| u32::MAX - i).collect()) },
            Attribute { name: "f32".into(), values: Column::F32((0..40).map(|i| i as f32 / 3.0).collect()) },
            Attribute { name: "f64".into(), values: Column::F64((0..40).map(|i| f64::from(i) / 3.0).collect()) },
        ];
        for ascii in [false, true] {
            let mut bytes = vec![];
            write_cloud(&cloud, ascii, &mut bytes).unwrap();
            assert_eq!(read_cloud(&bytes).unwrap(), cloud, "ascii {ascii}");

            let mesh = TriMesh {
                origin: cloud.origin,
                vertices: cloud.points.clone(),
                triangles: (0..38).map(|i| [i, i + 1, i + 2]).collect(),
                normals: cloud.normals.clone(),
                colors: cloud.colors.clone(),
            };
            let mut bytes = vec![];
            write_mesh(&mesh, ascii, &mut bytes).unwrap();
            assert_eq!(read_mesh(&bytes).unwrap(), mesh, "ascii {ascii}");
        }
    }
}

#[test]
fn what_is_written_is_read_by_ply_rs() {
    let mut cloud = PointCloud::new(vec![Vec3::new(0.5, -1.25, 3.0), Vec3::new(7.0, 8.0, 9.0)]);
    cloud.colors = Some(vec![[1, 2, 3, 255], [4, 5, 6, 255]]);
    for ascii in [false, true] {
        let mut bytes = vec![];
        write_cloud(&cloud, ascii, &mut bytes).unwrap();
        let parser = ply_rs_bw::parser::Parser::<ply_rs_bw::ply::DefaultElement>::new();
        let theirs = parser.read_ply(&mut &bytes[..]).unwrap();
        let vertices = &theirs.payload["vertex"];
        assert_eq!(vertices.len(), 2);
        for (i, vertex) in vertices.iter().enumerate() {
            let position = ["x", "y", "z"].map(|axis| vertex[axis].to_f32_lossy().unwrap());
            assert_eq!(position, cloud.points[i].to_array());
            let color = ["red", "green", "blue"].map(|channel| vertex[channel].to_u8_color_lossy().unwrap());
            assert_eq!(color, cloud.colors.as_ref().unwrap()[i][..3]);
        }
    }
}

#[test]
fn the_real_scan_has_the_vertices_and_strips_of_ply_rs() {
    let Some(bytes) = real_file("igea.ply") else { return };
    let mesh = read_mesh(&bytes).unwrap();
    assert_eq!(mesh.vertices.len(), 134_345);
    // 373,830 entries of which 35,048 are separators: each of the strips has two triangles fewer than vertices.
    let parser = ply_rs_bw::parser::Parser::<ply_rs_bw::ply::DefaultElement>::new();
    let theirs = parser.read_ply(&mut &bytes[..]).unwrap();
    let ply_rs_bw::ply::Property::ListInt(strips) = &theirs.payload["tristrips"][0]["vertex_indices"] else {
        panic!("expected a list of i32");
    };
    let expected: usize = strips.split(|&i| i == -1).map(|strip| strip.len().saturating_sub(2)).sum();
    assert_eq!(mesh.triangles.len(), expected);
    let last = &theirs.payload["vertex"][134_344];
    let position = ["x", "y", "z"].map(|axis| last[axis].to_f32_lossy().unwrap());
    assert_eq!((mesh.origin + mesh.vertices[134_344].as_dvec3()).as_vec3().to_array(), position);
    // A closed scan: with the winding right, every edge runs once each way.
    let mut edges = std::collections::HashMap::new();
    for t in mesh.triangles.iter().filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]) {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            *edges.entry((a, b)).or_insert(0) += 1;
        }
    }
    let paired = edges.iter().filter(|&(&(a, b), &n)| n == 1 && edges.get(&(b, a)) == Some(&1)).count();
    assert!(paired as f64 > 0.99 * edges.len() as f64, "{paired} of {} edges are paired", edges.len());
}
