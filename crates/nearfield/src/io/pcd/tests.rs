//! PCD files by hand, round trips, damaged files, and the real terrain against `pcd-rs`.

use glam::{DVec3, Vec3};

use super::{read, write};
use crate::geometry::{Attribute, Column, PointCloud};
use crate::io::test_data::real_file;

const ASCII: &str = "# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z rgb intensity curv
SIZE 4 4 8 4 2 4
TYPE F F F U U F
COUNT 1 1 1 1 1 2
WIDTH 2
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 2
DATA ascii
1.5 -2 3 66051 7 0.5 0.25
nan 5e0 6 255 65535 1 2
";

/// The message of the error that `bytes` must give.
fn refusal(bytes: &[u8]) -> String {
    read(bytes).expect_err("the file should be refused").to_string()
}

fn replaced(from: &str, to: &str) -> String {
    assert!(ASCII.contains(from), "{from:?} is not in the sample");
    refusal(ASCII.replacen(from, to, 1).as_bytes())
}

fn binary(cloud: &PointCloud) -> Vec<u8> {
    let mut bytes = vec![];
    write(cloud, &mut bytes).unwrap();
    bytes
}

fn rich_cloud() -> PointCloud {
    let mut cloud = PointCloud::new(vec![Vec3::new(0.1, -0.2, 3.0e7), Vec3::new(f32::NAN, 1.0, f32::INFINITY)]);
    cloud.normals = Some(vec![Vec3::X, Vec3::new(0.0, 0.6, -0.8)]);
    cloud.colors = Some(vec![[1, 2, 3, 4], [255, 128, 0, 255]]);
    let column = |name: &str, values| Attribute { name: name.into(), values };
    cloud.attributes = vec![
        column("i8", Column::I8(vec![-128, 127])),
        column("u8", Column::U8(vec![0, 255])),
        column("i16", Column::I16(vec![i16::MIN, i16::MAX])),
        column("u16", Column::U16(vec![0, u16::MAX])),
        column("i32", Column::I32(vec![i32::MIN, i32::MAX])),
        column("u32", Column::U32(vec![0, u32::MAX])),
        column("f32", Column::F32(vec![0.1, -0.0])),
        column("f64", Column::F64(vec![0.1, 1e300])),
    ];
    cloud
}

/// World coordinates, in bits so that NaN equals NaN.
fn world(cloud: &PointCloud) -> Vec<[u64; 3]> {
    (0..cloud.len()).map(|i| cloud.world(i).to_array().map(f64::to_bits)).collect()
}

fn assert_same(a: &PointCloud, b: &PointCloud) {
    assert_eq!(world(a), world(b));
    assert_eq!((&a.normals, &a.colors, &a.attributes), (&b.normals, &b.colors, &b.attributes));
}

#[test]
fn ascii_gives_positions_colors_and_attributes() {
    let cloud = read(ASCII.as_bytes()).unwrap();
    assert_eq!(cloud.world(0), DVec3::new(1.5, -2.0, 3.0));
    assert!(cloud.world(1).x.is_nan());
    assert_eq!(cloud.world(1).y, 5.0);
    // 66051 is 0x010203.
    assert_eq!(cloud.colors, Some(vec![[1, 2, 3, 255], [0, 0, 255, 255]]));
    let expected = [
        Attribute { name: "intensity".into(), values: Column::U16(vec![7, 65535]) },
        Attribute { name: "curv_0".into(), values: Column::F32(vec![0.5, 1.0]) },
        Attribute { name: "curv_1".into(), values: Column::F32(vec![0.25, 2.0]) },
    ];
    assert_eq!(cloud.attributes, expected);
}

#[test]
fn color_packed_in_a_float_is_unpacked() {
    let bytes = ASCII.replace("TYPE F F F U U F", "TYPE F F F F U F").replace(" 66051 ", " 2.3694278e-38 ");
    let packed = 2.369_427_8e-38_f32.to_bits().to_le_bytes();
    let cloud = read(bytes.as_bytes()).unwrap();
    assert_eq!(cloud.colors.unwrap()[0], [packed[2], packed[1], packed[0], 255]);
}

#[test]
fn padding_fields_are_left_out() {
    let text = "FIELDS x _ y z\nSIZE 1 1 1 1\nTYPE U U U U\nCOUNT 1 2 1 1\nWIDTH 1\nHEIGHT 1\nDATA ascii\n1 0 0 2 3\n";
    let cloud = read(text.as_bytes()).unwrap();
    assert_eq!(cloud.world(0), DVec3::new(1.0, 2.0, 3.0));
    assert!(cloud.attributes.is_empty());
}

#[test]
fn compressed_fields_stand_one_after_the_other() {
    let header = "FIELDS x y z n\nSIZE 1 1 1 2\nTYPE U U I U\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\n";
    let mut bytes = format!("{header}DATA binary_compressed\n").into_bytes();
    let fields = [1, 2, 3, 4, 5, 251, 0, 1, 1, 1];
    bytes.extend([fields.len() as u32 + 1, fields.len() as u32].iter().flat_map(|n| n.to_le_bytes()));
    bytes.push(fields.len() as u8 - 1);
    bytes.extend(fields);
    let cloud = read(&bytes).unwrap();
    assert_eq!([cloud.world(0), cloud.world(1)], [DVec3::new(1.0, 3.0, 5.0), DVec3::new(2.0, 4.0, -5.0)]);
    assert_eq!(cloud.attributes[0].values, Column::U16(vec![256, 257]));
    for end in 0..bytes.len() {
        assert!(read(&bytes[..end]).is_err(), "cut at byte {end}");
    }
    // A page of padding, as the Point Cloud Library leaves it, is fine; anything else is not.
    bytes.extend([0; 100]);
    assert!(read(&bytes).is_ok());
    bytes.push(1);
    assert!(refusal(&bytes).contains("101 bytes behind the last point"));
}

#[test]
fn a_written_cloud_reads_back_the_same() {
    let cloud = rich_cloud();
    assert_same(&read(&binary(&cloud)).unwrap(), &cloud);
    let utm: Vec<DVec3> = (0..50).map(|i| DVec3::new(637_000.001, 5_403_059.123, f64::from(i) * 0.517)).collect();
    let cloud = PointCloud::from_world(&utm);
    assert_ne!(cloud.origin, DVec3::ZERO);
    assert_same(&read(&binary(&cloud)).unwrap(), &cloud);
    assert!(read(&binary(&PointCloud::default())).unwrap().is_empty());
}

#[test]
fn names_that_pcd_cannot_hold_are_changed() {
    let mut cloud = PointCloud::new(vec![Vec3::ONE]);
    cloud.attributes =
        ["x", "scan angle", "_"].map(|name| Attribute { name: name.into(), values: Column::U8(vec![9]) }).to_vec();
    let names: Vec<String> = read(&binary(&cloud)).unwrap().attributes.into_iter().map(|a| a.name).collect();
    assert_eq!(names, ["x_2", "scan_angle", "__2"]);
}

#[test]
fn the_reference_reader_reads_what_is_written() {
    let cloud = rich_cloud();
    let bytes = binary(&cloud);
    let reader = pcd_rs::DynReader::from_reader(bytes.as_slice()).unwrap();
    let records: Vec<pcd_rs::DynRecord> = reader.collect::<pcd_rs::Result<_>>().unwrap();
    assert_eq!(records.len(), 2);
    assert_eq!(records[0].to_xyz::<f32>(), Some(cloud.points[0].to_array()));
    assert_eq!(records[1].0[4], pcd_rs::Field::F32(vec![0.6]));
    assert_eq!(records[1].0[14], pcd_rs::Field::F64(vec![1e300]));
}

#[test]
fn a_cut_file_is_an_error() {
    let bytes = binary(&rich_cloud());
    for end in 0..bytes.len() {
        assert!(read(&bytes[..end]).is_err(), "binary cut at byte {end}");
    }
    // Without its last token the ascii file misses a value; a cut inside that token gives another number.
    for end in 0..ASCII.len() - 2 {
        assert!(read(&ASCII.as_bytes()[..end]).is_err(), "ascii cut at byte {end}");
    }
}

#[test]
fn errors_name_the_line_and_what_stands_there() {
    assert_eq!(replaced("-2", "-2x"), "input:12: PCD: found \"-2x\" in field y, expected a number of 32 bits");
    assert!(replaced(" 7 ", " 70000 ").contains(":12: PCD: found \"70000\" in field intensity"));
    assert!(replaced(" 0.25", "").contains(":12: PCD: found 6 values, expected 7"));
    assert!(replaced(" 0.25", " 0.25 9").contains(":12: PCD: found 8 values, expected 7"));
    assert!(replaced("FIELDS x", "FIELDS u").contains("without x, expected fields x, y and z"));
    assert!(replaced("POINTS 2", "POINTS 3").contains(":10: PCD: found POINTS 3, expected 2"));
    assert!(replaced("SIZE 4 4 8 4", "SIZE 4 4 8").contains("SIZE with 5 values, expected 6"));
    assert!(replaced("SIZE 4", "SIZE 3").contains(":4: PCD: found SIZE \"3\" for TYPE F"));
    assert!(replaced("TYPE F", "TYPE Q").contains(":5: PCD: found TYPE \"Q\""));
    assert!(replaced("DATA ascii", "DATA ascij").contains(":11: PCD: found DATA ascij"));
    assert!(replaced("COUNT 1", "COUNT 0").contains("COUNT 0"));
    assert!(replaced("VERSION 0.7", "BERSION 0.7").contains("keyword"));
    let short = ASCII.replace("nan 5e0 6 255 65535 1 2\n", "").replace("0.25", "0.250000000000000000000");
    assert!(refusal(short.as_bytes()).contains(":13: PCD: found the end of the file after 1 points, expected 2"));
    assert!(refusal(format!("{ASCII}1 2 3 4 5 6 7\n").as_bytes()).contains(":14: "));
    assert!(refusal(b"").contains("an empty file"));
}

#[test]
fn counts_beyond_the_bytes_are_refused() {
    for (width, points) in [("4294967295", "4294967295"), ("18446744073709551615", "18446744073709551615")] {
        let header = ASCII.replace("WIDTH 2", &format!("WIDTH {width}"));
        let header = header.replace("POINTS 2", &format!("POINTS {points}"));
        assert!(refusal(header.as_bytes()).contains("can hold"));
        assert!(refusal(header.replace("ascii", "binary").as_bytes()).contains("can hold"));
        assert!(refusal(header.replace("ascii", "binary_compressed").as_bytes()).contains("expanded size"));
    }
    assert!(replaced("HEIGHT 1", "HEIGHT 18446744073709551615").contains("a product below 2^64"));
    assert!(replaced("COUNT 1", "COUNT 4294967295").contains("at most 65536 values a point"));
}

#[test]
fn a_count_below_the_data_is_refused() {
    let bytes = binary(&rich_cloud());
    let text = String::from_utf8_lossy(&bytes[..bytes.iter().rposition(|&b| b == b'y').unwrap() + 2]).into_owned();
    let mut fewer = text.replace("WIDTH 2", "WIDTH 1").replace("POINTS 2", "POINTS 1").into_bytes();
    fewer.extend(&bytes[text.len()..]);
    assert!(refusal(&fewer).contains("behind the last point"));
}

#[test]
fn the_terrain_equals_the_reference_reader() {
    let Some(bytes) = real_file("terrain-csite1.pcd") else { return };
    let cloud = read(&bytes).unwrap();
    assert_eq!(cloud.len(), 522_674);
    let reader = pcd_rs::DynReader::from_reader(bytes.as_slice()).unwrap();
    for (i, record) in reader.enumerate() {
        let expected = record.unwrap().to_xyz::<f32>().unwrap().map(f64::from);
        assert_eq!(cloud.world(i).to_array(), expected, "point {i}");
    }
}
