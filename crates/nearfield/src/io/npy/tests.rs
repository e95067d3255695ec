//! Arrays by hand and by NumPy, archives, round trips and damaged files.

use std::io::{Cursor, Write};

use glam::{DVec3, Vec3};
use zip::write::SimpleFileOptions;

use super::{NpyArray, read, write_cloud, write_npz};
use crate::geometry::{Attribute, Column, PointCloud};

/// An NPY file of version 1.0 with this dictionary and these elements.
fn npy(dictionary: &str, elements: &[u8]) -> Vec<u8> {
    let length = dictionary.len() as u16;
    [b"\x93NUMPY\x01\x00".as_slice(), &length.to_le_bytes(), dictionary.as_bytes(), elements].concat()
}

fn dictionary(kind: &str, fortran: bool, shape: &str) -> String {
    let fortran = if fortran { "True" } else { "False" };
    format!("{{'descr': '{kind}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n")
}

fn refusal(bytes: &[u8]) -> String {
    read(bytes).expect_err("the file should be refused").to_string()
}

fn world(cloud: &PointCloud) -> Vec<DVec3> {
    (0..cloud.len()).map(|i| cloud.world(i)).collect()
}

fn archive(arrays: &[(&str, NpyArray<'_>)]) -> Vec<u8> {
    let mut out = Cursor::new(vec![]);
    write_npz(arrays, &mut out).unwrap();
    out.into_inner()
}

fn deflated(name: &str, content: &[u8]) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(Cursor::new(vec![]));
    let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
    writer.start_file(name, options).unwrap();
    writer.write_all(content).unwrap();
    writer.finish().unwrap().into_inner()
}

const EXPECTED: [DVec3; 2] = [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)];

#[test]
fn every_number_type_byte_order_and_axis_order_is_read() {
    fn case<const N: usize>(kind: &str, encode: impl Fn(f64) -> ([u8; N], [u8; N])) {
        for fortran in [false, true] {
            let values = if fortran { [1.0, 4.0, 2.0, 5.0, 3.0, 6.0] } else { [1.0, 2.0, 3.0, 4.0, 5.0, 6.0] };
            let little: Vec<u8> = values.iter().flat_map(|&v| encode(v).0).collect();
            let big: Vec<u8> = values.iter().flat_map(|&v| encode(v).1).collect();
            let orders = if N == 1 { [('|', little), ('|', big)] } else { [('<', little), ('>', big)] };
            for (order, elements) in orders {
                let kind = format!("{order}{kind}");
                let cloud = read(&npy(&dictionary(&kind, fortran, "(2, 3)"), &elements)).unwrap();
                assert_eq!(world(&cloud), EXPECTED, "{kind}, fortran order {fortran}");
            }
        }
    }
    case("f4", |v| ((v as f32).to_le_bytes(), (v as f32).to_be_bytes()));
    case("f8", |v| (v.to_le_bytes(), v.to_be_bytes()));
    case("i1", |v| ((v as i8).to_le_bytes(), (v as i8).to_be_bytes()));
    case("i2", |v| ((v as i16).to_le_bytes(), (v as i16).to_be_bytes()));
    case("i4", |v| ((v as i32).to_le_bytes(), (v as i32).to_be_bytes()));
    case("i8", |v| ((v as i64).to_le_bytes(), (v as i64).to_be_bytes()));
    case("u1", |v| ((v as u8).to_le_bytes(), (v as u8).to_be_bytes()));
    case("u2", |v| ((v as u16).to_le_bytes(), (v as u16).to_be_bytes()));
    case("u4", |v| ((v as u32).to_le_bytes(), (v as u32).to_be_bytes()));
    case("u8", |v| ((v as u64).to_le_bytes(), (v as u64).to_be_bytes()));
}

#[test]
fn further_columns_become_attributes() {
    let cloud = read(&npy(&dictionary("|u1", false, "(2, 5)"), &[1, 2, 3, 7, 8, 4, 5, 6, 9, 10])).unwrap();
    assert_eq!(world(&cloud), EXPECTED);
    let expected = [
        Attribute { name: "column_3".into(), values: Column::U8(vec![7, 9]) },
        Attribute { name: "column_4".into(), values: Column::U8(vec![8, 10]) },
    ];
    assert_eq!(cloud.attributes, expected);
}

#[test]
fn other_shapes_and_types_are_named() {
    let case = |kind: &str, shape: &str, size: usize| refusal(&npy(&dictionary(kind, false, shape), &vec![0; size]));
    assert!(case("<f4", "(6,)", 24).contains("shape (6,) and type '<f4', expected shape (n, 3)"));
    assert!(case("<f4", "(3, 2)", 24).contains("(transpose it)"));
    assert!(case("<f4", "()", 4).contains("shape ()"));
    assert!(case("<f4", "(1, 3, 1)", 12).contains("shape (1, 3, 1)"));
    assert!(case("<f2", "(1, 3)", 6).contains("type '<f2'"));
    assert!(case("|b1", "(1, 3)", 3).contains("type '|b1'"));
    assert!(case("<c8", "(1, 3)", 24).contains("type '<c8'"));
    let record = "{'descr': [('x', '<f4'), ('y', '<f4')], 'fortran_order': False, 'shape': (2,), }\n";
    assert!(refusal(&npy(record, &[0; 16])).contains("type [('x', '<f4'), ('y', '<f4'), ]"));
}

#[test]
fn shapes_that_the_bytes_cannot_hold_are_refused() {
    for shape in
        ["(3, 3)", "(1, 3)", "(6148914691236517205, 3)", "(18446744073709551615, 3)", "(4294967295, 4294967295)"]
    {
        let message = refusal(&npy(&dictionary("<f4", false, shape), &[0; 24]));
        assert!(message.contains("expected shape (") || message.contains("one or two axes"), "{shape}: {message}");
    }
    assert!(refusal(&npy(&dictionary("<f4", false, "(0, 4294967295)"), &[])).contains("one or two axes"));
    assert!(refusal(&npy(&dictionary("<f4", false, "(-1, 3)"), &[])).contains("a header that cannot be read"));
    assert!(read(&npy(&dictionary("<f4", false, "(0, 3)"), &[])).unwrap().is_empty());
}

#[test]
fn hostile_headers_end_quickly() {
    assert!(refusal(&npy(&"(".repeat(9000), &[])).contains("nested too deep"));
    assert!(refusal(&npy(&"(".repeat(8), &[])).contains("cannot be read"));
    assert!(refusal(&npy(&" ".repeat(20_000), &[])).contains("a header of 20000 bytes"));
    assert!(refusal(b"\x93NUMPY\x02\x00\xff\xff\xff\xff").contains("a header of 4294967295 bytes"));
    assert!(refusal(b"\x93NUMPY\x09\x00\x01\x00 ").contains("version 9.0"));
    assert!(refusal(b"").contains("an empty file"));
    assert!(refusal(b"1 2 3\n").contains("found \"1 2 3\\n\", expected \"\\x93NUMPY\""));
}

#[test]
fn a_cut_file_is_an_error() {
    let array = npy(&dictionary("<f4", false, "(2, 3)"), &[0; 24]);
    let stored = archive(&[("points", NpyArray::F32x3(&[Vec3::ONE; 3])), ("id", NpyArray::U32(&[1, 2, 3]))]);
    let packed = deflated("points.npy", &array);
    for (name, bytes) in [("array", array), ("stored", stored), ("deflated", packed)] {
        assert!(read(&bytes).is_ok(), "{name}");
        for end in 0..bytes.len() {
            assert!(read(&bytes[..end]).is_err(), "{name} cut at byte {end}");
        }
    }
}

#[test]
fn a_written_cloud_reads_back_the_same() {
    let mut cloud = PointCloud::new(vec![Vec3::new(0.1, -7.0, 1e-20), Vec3::new(2.0, 3.5, 0.3)]);
    cloud.normals = Some(vec![Vec3::X, Vec3::new(0.0, 0.6, -0.8)]);
    cloud.colors = Some(vec![[1, 2, 3, 4], [255, 128, 0, 255]]);
    cloud.attributes = vec![
        Attribute { name: "intensity".into(), values: Column::U16(vec![1, 65535]) },
        Attribute { name: "gps time".into(), values: Column::F64(vec![0.1, 1e300]) },
        Attribute { name: "i8".into(), values: Column::I8(vec![-1, 1]) },
    ];
    let mut out = Cursor::new(vec![]);
    write_cloud(&cloud, &mut out).unwrap();
    assert_eq!(read(out.get_ref()).unwrap(), cloud);

    let utm: Vec<DVec3> = (0..50).map(|i| DVec3::new(637_000.001, 5_403_059.123, f64::from(i) * 0.517)).collect();
    let far = PointCloud::from_world(&utm);
    let mut out = Cursor::new(vec![]);
    write_cloud(&far, &mut out).unwrap();
    assert_eq!(read(out.get_ref()).unwrap(), far);
}

#[test]
fn an_archive_gives_the_only_table_without_a_name() {
    let points = [Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.0)];
    let id = [7_u64, 8];
    let cloud = read(&archive(&[("id", NpyArray::U64(&id)), ("xyz", NpyArray::F32x3(&points))])).unwrap();
    assert_eq!(world(&cloud), EXPECTED);
    assert_eq!(cloud.attributes[0].values, Column::F64(vec![7.0, 8.0]));
    let two = archive(&[("a", NpyArray::F32x3(&points)), ("b", NpyArray::F32x3(&points))]);
    assert!(refusal(&two).contains("2 arrays [\"a\" (2, 3), \"b\" (2, 3)], expected an array \"points\""));
    assert!(refusal(&archive(&[("points", NpyArray::U64(&id))])).contains("array \"points\" of shape (2,)"));
    assert!(refusal(&archive(&[])).contains("0 arrays"));
}

#[test]
fn a_damaged_array_of_an_archive_is_noticed() {
    let stored = archive(&[("points", NpyArray::F32x3(&[Vec3::ONE; 3]))]);
    let array = stored.windows(6).position(|w| w == b"\x93NUMPY").unwrap();
    let mut flipped = stored.clone();
    // A coordinate, behind 128 bytes of header.
    flipped[array + 128 + 20] ^= 1;
    assert!(refusal(&flipped).contains("array \"points\" with checksum"));
    let mut packed = deflated("points.npy", &npy(&dictionary("|u1", false, "(200, 3)"), &[9; 600]));
    let middle = packed.len() / 3;
    packed[middle] ^= 0x10;
    assert!(read(&packed).is_err());
}

#[test]
fn an_archive_that_promises_more_than_it_holds_is_refused() {
    // 4 GiB of claimed content behind 24 bytes.
    let header = npy(&dictionary("<f4", false, "(357000000, 3)"), &[]);
    let mut packed = deflated("points.npy", &[header.as_slice(), &[0; 24]].concat());
    let size = (header.len() as u64 + 357_000_000 * 12) as u32;
    let directory = packed.windows(4).rposition(|w| w == b"PK\x01\x02").unwrap();
    packed[directory + 24..directory + 28].copy_from_slice(&size.to_le_bytes());
    assert!(refusal(&packed).contains("as the directory says"));
    // The size of the directory entry and the shape must agree.
    packed[directory + 24..directory + 28].copy_from_slice(&(size - 1).to_le_bytes());
    assert!(refusal(&packed).contains("expected shape (357000000, 3)"));
}

#[test]
fn a_64_bit_directory_is_read() {
    let points = [Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.0)];
    let small = archive(&[("points", NpyArray::F32x3(&points))]);
    let directory = small.windows(4).rposition(|w| w == b"PK\x01\x02").unwrap();
    let end = small.len() - 22;
    // The same entry with its numbers moved into a field of 64-bit ones, and the end record likewise.
    let mut entry = small[directory..end].to_vec();
    let size = u64::from(u32::from_le_bytes(entry[20..24].try_into().unwrap()));
    entry[20..28].fill(0xff);
    entry[42..46].fill(0xff);
    entry[30..32].copy_from_slice(&28_u16.to_le_bytes());
    entry.truncate(46 + "points.npy".len());
    entry.extend([1, 0, 24, 0]);
    entry.extend([size, size, 0].iter().flat_map(|n| n.to_le_bytes()));
    let mut bytes = [&small[..directory], &entry].concat();
    let wide_end = bytes.len() as u64;
    bytes.extend(b"PK\x06\x06");
    bytes.extend([44, 0x2d_002d, 0, 1, 1, entry.len() as u64, directory as u64].iter().enumerate().flat_map(
        |(i, n)| {
            // The two versions, and the two disk numbers, take one 32-bit field and one 64-bit field.
            n.to_le_bytes().into_iter().take(if i == 1 { 4 } else { 8 })
        },
    ));
    bytes.extend(b"PK\x06\x07\0\0\0\0");
    bytes.extend(wide_end.to_le_bytes());
    bytes.extend([1, 0, 0, 0]);
    let mut last = small[end..].to_vec();
    last[8..20].fill(0xff);
    bytes.extend(last);
    assert_eq!(world(&read(&bytes).unwrap()), EXPECTED);
    for cut in 0..bytes.len() {
        assert!(read(&bytes[..cut]).is_err(), "cut at byte {cut}");
    }
}

#[test]
fn entries_that_share_their_bytes_are_refused() {
    let one = archive(&[("points", NpyArray::F32x3(&[Vec3::ONE; 300]))]);
    let directory = one.windows(4).rposition(|w| w == b"PK\x01\x02").unwrap();
    let end = one.windows(4).rposition(|w| w == b"PK\x05\x06").unwrap();
    let entry = one[directory..end].to_vec();
    let mut shared = [&one[..directory], &entry, &entry, &entry, &one[end..]].concat();
    let end = shared.len() - 22;
    shared[end + 8..end + 12].copy_from_slice(&[3, 0, 3, 0]);
    assert!(refusal(&shared).contains("entries that overlap"));
}

#[test]
fn a_name_twice_is_refused_when_writing() {
    let error = write_npz(&[("a", NpyArray::U8(&[1])), ("a", NpyArray::U8(&[2]))], Cursor::new(vec![])).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::InvalidInput);
}

#[test]
fn elements_start_at_a_multiple_of_64_bytes() {
    let mut values = [0_u32; 1000];
    values[0] = 0xdead_beef;
    for len in [0, 1, 9, 10, 99, 100, 999, 1000] {
        let header = NpyArray::U32(&values[..len]).header();
        assert_eq!(header.len() % 64, 0, "{len} values");
        assert!(header.ends_with(b"\n"));
        let parsed = npyz::NpyHeader::from_reader(header.as_slice()).unwrap();
        assert_eq!(parsed.shape(), [len as u64]);
    }
}
