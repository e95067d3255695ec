//! One small valid file for each variant of each format, by hand or by a writer that is not the reader under test.

use nearfield::geometry::{Attribute, Column};
use nearfield::io::{Format, WriteOptions, write_cloud, write_mesh};
use nearfield::{DVec3, PointCloud, TriMesh, Vec3};

/// Points in each seed.
const N: usize = 24;

/// A valid file.
#[derive(Clone)]
pub(crate) struct Seed {
    /// Format and variant, as a test name.
    pub(crate) name: &'static str,
    pub(crate) format: Format,
    pub(crate) bytes: Vec<u8>,
}

/// The seed of every variant that is read.
pub(crate) fn all() -> Vec<Seed> {
    let seed = |name, format, bytes| Seed { name, format, bytes };
    vec![
        seed("ply_ascii", Format::Ply, written_mesh("ply", true)),
        seed("ply_ascii_cloud", Format::Ply, written_cloud("ply", true)),
        seed("ply_little_endian", Format::Ply, written_mesh("ply", false)),
        seed("ply_big_endian", Format::Ply, ply_big_endian()),
        seed("obj", Format::Obj, written_mesh("obj", false)),
        seed("stl_ascii", Format::Stl, stl_ascii()),
        seed("stl_binary", Format::Stl, stl_binary()),
        seed("xyz", Format::Xyz, written_cloud("xyz", false)),
        seed("csv", Format::Csv, written_cloud("csv", false)),
        seed("pcd_ascii", Format::Pcd, pcd("ascii")),
        seed("pcd_binary", Format::Pcd, pcd("binary")),
        seed("pcd_compressed", Format::Pcd, pcd("binary_compressed")),
        seed("las", Format::Las, las(false)),
        seed("laz", Format::Laz, las(true)),
        seed("npy", Format::Npy, npy()),
        seed("npz", Format::Npz, written_cloud("npz", false)),
        seed("vtp_raw", Format::Vtp, written_cloud("vtp", false)),
        seed("vtp_ascii", Format::Vtp, vtp("ascii", "1 0 0.5\n0 1 -2e3\n")),
        seed("vtp_base64", Format::Vtp, vtp("binary", "GAAAAAAAgD8AAAAAAAAAPwAAAAAAAIA/AAD6xA==")),
    ]
}

/// Bytes of each dense file: enough for 32 times as many to outweigh 64 MB.
const DENSE_BYTES: usize = 8 << 20;

/// Files of as many records in a byte as their format can hold, for the memory that each takes.
pub(crate) fn dense() -> Vec<Seed> {
    let repeated = |start: String, record: &[u8]| -> Vec<u8> {
        let body = record.iter().copied().cycle().take(DENSE_BYTES / record.len() * record.len());
        start.into_bytes().into_iter().chain(body).collect()
    };
    let seed = |name, format, bytes| Seed { name, format, bytes };
    let ply = |encoding: &str, n: usize, kind: &str, face: &str| {
        format!(
            "ply\nformat {encoding} 1.0\nelement vertex {n}\nproperty {kind} x\nproperty {kind} y\nproperty {kind} z\n\
            {face}end_header\n"
        )
    };
    let (n_points, n_lines) = (DENSE_BYTES / 3, DENSE_BYTES / 6);
    let face = |n: usize, count: &str| format!("element face {n}\nproperty list {count} uchar vertex_indices\n");
    let no_lists = format!("{}\0\0\0", ply("binary_little_endian", 1, "uchar", &face(DENSE_BYTES, "uchar")));
    let one_list = ply("binary_little_endian", 1, "uchar", &face(1, "uint"));
    let mut one_list = [one_list.into_bytes(), vec![0; 3], (DENSE_BYTES as u32).to_le_bytes().into()].concat();
    one_list.resize(one_list.len() + DENSE_BYTES, 0);
    let mut stl = vec![0; 80];
    stl.extend(((DENSE_BYTES / 50) as u32).to_le_bytes());
    stl.extend((0..DENSE_BYTES / 50 * 50).map(|i| if i % 50 < 48 { (i * 2_654_435_761) as u8 } else { 0 }));
    vec![
        seed("dense_ply_ascii", Format::Ply, repeated(ply("ascii", n_lines, "double", ""), b"1 2 3\n")),
        seed("dense_ply_binary", Format::Ply, repeated(ply("binary_little_endian", n_points, "uchar", ""), b"123")),
        seed("dense_vtp_bytes", Format::Vtp, dense_vtp()),
        seed("dense_ply_empty_lists", Format::Ply, repeated(no_lists, b"\0")),
        seed("dense_ply_one_list", Format::Ply, one_list),
        seed("dense_obj_vertices", Format::Obj, repeated(String::new(), b"v 1 2 3\n")),
        seed("dense_obj_face", Format::Obj, repeated("v 1 2 3\nf".into(), b" 1")),
        seed("dense_obj_normals", Format::Obj, repeated("v 1 2 3\nvn 0 0 1\nf".into(), b" 1//1")),
        seed("dense_stl_binary", Format::Stl, stl),
        seed("dense_xyz", Format::Xyz, repeated(String::new(), b"1 2 3\n")),
        seed("dense_csv_wide", Format::Csv, repeated(String::new(), &[b"1,".repeat(999), b"1\n".to_vec()].concat())),
        seed("dense_csv_colors", Format::Csv, repeated("x,y,z,r,g,b\n".into(), b"1,2,3,4,5,6\n")),
    ]
}

fn positions() -> Vec<DVec3> {
    let coordinate = |i: usize| 637_000.25 + i as f64 * 0.125;
    (0..N).map(|i| DVec3::new(coordinate(i), 5_403_059.5 - i as f64, (i % 5) as f64)).collect()
}

fn cloud() -> PointCloud {
    let mut cloud = PointCloud::from_world(&positions());
    cloud.normals = Some(vec![Vec3::new(0.0, 0.6, 0.8); N]);
    cloud.colors = Some((0..N).map(|i| [i as u8, 100, 200, 255]).collect());
    cloud.attributes = vec![Attribute { name: "intensity".into(), values: Column::U16((0..N as u16).collect()) }];
    cloud
}

fn written(extension: &str, write: impl FnOnce(&std::path::Path, &WriteOptions) -> nearfield::Result<()>) -> Vec<u8> {
    let path = format!("{}/seed-{}.{extension}", env!("CARGO_TARGET_TMPDIR"), std::process::id());
    let path = std::path::Path::new(&path);
    write(path, &WriteOptions { force: true, ..WriteOptions::default() }).expect("a valid cloud should be written");
    let bytes = std::fs::read(path).expect("what was written should be there");
    std::fs::remove_file(path).expect("what was written should be removable");
    bytes
}

fn written_cloud(extension: &str, ascii: bool) -> Vec<u8> {
    written(extension, |path, options| write_cloud(path, &cloud(), &WriteOptions { ascii, ..*options }))
}

fn written_mesh(extension: &str, ascii: bool) -> Vec<u8> {
    let PointCloud { origin, points: vertices, normals, colors, .. } = cloud();
    let triangles = (0..N as u32 - 2).map(|i| [i, i + 1, i + 2]).collect();
    let mesh = TriMesh { origin, vertices, triangles, normals, colors };
    written(extension, |path, options| write_mesh(path, &mesh, &WriteOptions { ascii, ..*options }))
}

/// Points of three bytes each, behind the XML.
fn dense_vtp() -> Vec<u8> {
    let n = DENSE_BYTES / 3;
    let head = format!(
        "<VTKFile type=\"PolyData\" byte_order=\"LittleEndian\"><PolyData><Piece NumberOfPoints=\"{n}\"><Points>\
         <DataArray type=\"UInt8\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/></Points></Piece></PolyData>\
         <AppendedData encoding=\"raw\">_"
    );
    [head.into_bytes(), (3 * n as u32).to_le_bytes().to_vec(), vec![7; 3 * n]].concat()
}

/// Two points in the XML.
fn vtp(format: &str, numbers: &str) -> Vec<u8> {
    format!(
        "<VTKFile type=\"PolyData\" byte_order=\"LittleEndian\">\n<PolyData>\n<Piece NumberOfPoints=\"2\">\n<PointData>\n\
         <DataArray type=\"Int16\" Name=\"count\" format=\"ascii\">5 -6</DataArray>\n</PointData>\n<Points>\n\
         <DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"{format}\">{numbers}</DataArray>\n</Points>\n\
         </Piece>\n</PolyData>\n</VTKFile>\n"
    )
    .into_bytes()
}

fn ply_big_endian() -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat binary_big_endian 1.0\nelement vertex {N}\nproperty double x\nproperty double y\n\
        property double z\nproperty short quality\nelement tristrips 1\nproperty list int int vertex_indices\n\
        end_header\n"
    )
    .into_bytes();
    for (i, position) in positions().iter().enumerate() {
        bytes.extend(position.to_array().iter().flat_map(|c| c.to_be_bytes()));
        bytes.extend((i as i16).to_be_bytes());
    }
    let strips = [0, 1, 2, 3, 4, -1, 5, 6, 7, 8];
    bytes.extend((strips.len() as i32).to_be_bytes());
    bytes.extend(strips.iter().flat_map(|i: &i32| i.to_be_bytes()));
    bytes
}

fn corners() -> impl Iterator<Item = [Vec3; 3]> {
    let at = |i: usize| Vec3::new(i as f32 * 0.5, (i % 3) as f32, (i % 2) as f32);
    (0..N / 2).map(move |i| [at(i), at(i + 1), at(i + 2)])
}

fn stl_ascii() -> Vec<u8> {
    let mut text = "solid seed\n".to_owned();
    for triangle in corners() {
        text += "facet normal 0 0 1\nouter loop\n";
        for corner in triangle {
            text += &format!("vertex {} {} {}\n", corner.x, corner.y, corner.z);
        }
        text += "endloop\nendfacet\n";
    }
    (text + "endsolid seed\n").into_bytes()
}

fn stl_binary() -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes.extend((corners().count() as u32).to_le_bytes());
    for triangle in corners() {
        bytes.extend([0; 12]);
        bytes.extend(triangle.iter().flat_map(|c| c.to_array()).flat_map(f32::to_le_bytes));
        bytes.extend([0; 2]);
    }
    bytes
}

fn pcd(data: &str) -> Vec<u8> {
    let mut bytes = format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb label\nSIZE 4 4 4 4 2\n\
        TYPE F F F U U\nCOUNT 1 1 1 1 1\nWIDTH {N}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {N}\nDATA {data}\n"
    )
    .into_bytes();
    let position = |i: usize| [i as f32 * 0.5, 1.0 - i as f32, 0.25];
    let color = |i: usize| 0x00ff_0000_u32 + i as u32;
    match data {
        "ascii" => {
            for i in 0..N {
                let [x, y, z] = position(i);
                bytes.extend(format!("{x} {y} {z} {} {i}\n", color(i)).bytes());
            }
        }
        "binary" => {
            for i in 0..N {
                bytes.extend(position(i).iter().flat_map(|c| c.to_le_bytes()));
                bytes.extend(color(i).to_le_bytes());
                bytes.extend((i as u16).to_le_bytes());
            }
        }
        _ => {
            // Field after field, compressed as LZF: runs of up to 32 bytes as they are, behind their length less one.
            let mut fields: Vec<u8> = vec![];
            for axis in 0..3 {
                fields.extend((0..N).flat_map(|i| position(i)[axis].to_le_bytes()));
            }
            fields.extend((0..N).flat_map(|i| color(i).to_le_bytes()));
            fields.extend((0..N).flat_map(|i| (i as u16).to_le_bytes()));
            let packed: Vec<u8> = fields
                .chunks(32)
                .flat_map(|run| std::iter::once(run.len() as u8 - 1).chain(run.iter().copied()))
                .collect();
            bytes.extend((packed.len() as u32).to_le_bytes());
            bytes.extend((fields.len() as u32).to_le_bytes());
            bytes.extend(packed);
        }
    }
    bytes
}

fn las(compressed: bool) -> Vec<u8> {
    let mut builder = las::Builder::from((1, 2));
    builder.point_format = las::point::Format::new(3).expect("point format 3 should exist");
    builder.point_format.is_compressed = compressed;
    let transform = |offset| las::Transform { scale: 0.001, offset };
    builder.transforms = las::Vector { x: transform(637_000.0), y: transform(5_403_000.0), z: transform(0.0) };
    let header = builder.into_header().expect("the header should be valid");
    let mut writer = las::Writer::new(std::io::Cursor::new(vec![]), header).expect("a writer into memory should open");
    for (i, position) in positions().iter().enumerate() {
        let point = las::Point {
            x: position.x,
            y: position.y,
            z: position.z,
            intensity: i as u16,
            gps_time: Some(i as f64),
            color: Some(las::Color { red: 65_535, green: i as u16, blue: 0 }),
            ..las::Point::default()
        };
        writer.write_point(point).expect("a point should be written");
    }
    writer.into_inner().expect("the file should be complete").into_inner()
}

/// A LAZ file of under a kilobyte whose chunk table says that it has 2³² − 1 chunks.
pub(crate) fn laz_with_endless_chunk_table() -> Vec<u8> {
    let mut bytes = las(true);
    let u32_at = |bytes: &[u8], at: usize| u32::from_le_bytes(*bytes[at..].first_chunk().expect("it should be there"));
    // The offset to the points stands in the header; the points begin with the offset of the chunk table.
    let points = u32_at(&bytes, 96) as usize;
    let table = u32_at(&bytes, points) as usize;
    assert_eq!(u32_at(&bytes, table + 4), 1, "the count of chunks should stand behind the version");
    bytes[table + 4..table + 8].copy_from_slice(&u32::MAX.to_le_bytes());
    bytes
}

fn npy() -> Vec<u8> {
    let mut header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({N}, 3), }}");
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(positions().iter().flat_map(|p| p.to_array()).flat_map(f64::to_le_bytes));
    bytes
}
