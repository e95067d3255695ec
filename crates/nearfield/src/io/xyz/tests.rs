//! Tables as people write them, and the errors for those nobody should.

use glam::{DVec3, Vec3};

use super::{read, write_csv, write_xyz};
use crate::geometry::{Attribute, Column};
use crate::{Error, PointCloud};

fn worlds(cloud: &PointCloud) -> Vec<[f64; 3]> {
    (0..cloud.len()).map(|i| cloud.world(i).to_array()).collect()
}

fn message(bytes: &[u8]) -> String {
    match read("XYZ", bytes) {
        Err(error @ Error::File(_)) => error.to_string(),
        other => panic!("expected a file error, got {other:?}"),
    }
}

#[test]
fn every_separator_comment_and_line_end_gives_the_same_points() {
    let texts: [&[u8]; 9] = [
        b"1 2 3\n4 5 6\n",
        b"1\t2\t3\r\n4\t5\t6\r\n",
        b"1,2,3\n4, 5 ,6",
        b"1;2;3\n\n4;5;6\n",
        b"# a comment\n  1   2  3\n// another\n 4 5 6  \n",
        b"X,Y,Z\n1,2,3\n4,5,6\n",
        b"\xEF\xBB\xBF\"x\";\"y\";\"z\"\n1;2;3\n4;5;6\n",
        b"//X Y Z\n1.0 2e0 +3\n4 5. 6\n",
        b"# the x y z of two points\n1 2 3\n4 5 6\n",
    ];
    for text in texts {
        let cloud = read("XYZ", text).unwrap();
        assert_eq!(worlds(&cloud), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{:?}", String::from_utf8_lossy(text));
        assert!(cloud.attributes.is_empty());
    }
}

#[test]
fn a_header_says_what_the_columns_are_in_any_order() {
    let cloud = read("CSV", b"time,z,y,x,R,G,B,nx,ny,nz\n7.5,3,2,1,255,128,0,0,0,1\n").unwrap();
    assert_eq!(worlds(&cloud), [[1.0, 2.0, 3.0]]);
    assert_eq!(cloud.colors, Some(vec![[255, 128, 0, 255]]));
    assert_eq!(cloud.normals, Some(vec![Vec3::Z]));
    assert_eq!(cloud.attributes, [Attribute { name: "time".into(), values: Column::F64(vec![7.5]) }]);
}

#[test]
fn columns_without_a_name_are_numbered_and_incomplete_vectors_stay_columns() {
    let cloud = read("XYZ", b"1 2 3 40 50\n").unwrap();
    let names: Vec<_> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
    assert_eq!(names, ["column4", "column5"]);
    let cloud = read("XYZ", b"x y z nx red\n1 2 3 4 5\n").unwrap();
    let names: Vec<_> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
    assert_eq!((names, cloud.normals, cloud.colors), (vec!["nx", "red"], None, None));
}

#[test]
fn colours_below_one_with_fractions_use_the_whole_range() {
    let cloud = read("XYZ", b"x y z r g b\n0 0 0 1 0.5 0\n").unwrap();
    assert_eq!(cloud.colors, Some(vec![[255, 128, 0, 255]]));
    let cloud = read("XYZ", b"x y z r g b\n0 0 0 1 0 0\n").unwrap();
    assert_eq!(cloud.colors, Some(vec![[1, 0, 0, 255]]));
}

#[test]
fn not_a_number_and_infinity_are_kept() {
    let cloud = read("XYZ", b"nan 0 0\n1 inf 2\n3 3 3\n").unwrap();
    assert!(cloud.points[0].x.is_nan() && cloud.points[1].y == f32::INFINITY);
    assert!(matches!(cloud.validate(), Err(Error::NonFinite { count: 2, first: 0, .. })));
}

#[test]
fn errors_name_the_line_what_was_found_and_what_was_expected() {
    let cases: [(&[u8], &[&str]); 8] = [
        (b"", &["an empty file"]),
        (b"# nothing\n\n", &["no line with numbers", "three numbers"]),
        (b"1 2\n", &[":1:", "2 columns", "x, y and z"]),
        (b"1 2 3\n4 5\n", &[":2:", "found 2 columns", "expected 3 columns"]),
        (b"1 2 3\n\n4 5 6 7\n", &[":3:", "one more column, \"7\""]),
        (b"1 2 3\n4 five 6\n", &[":2:", "\"five\"", "a number for y"]),
        (b"x,y,i\n1,2,3\n", &[":1:", "without z"]),
        (b"1,,3\n", &[":1:", "\"\"", "a number for y"]),
    ];
    for (bytes, parts) in cases {
        let message = message(bytes);
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    }
    let wide = "1 ".repeat(5000);
    assert!(message(wide.as_bytes()).contains("at most 1024"));
}

#[test]
fn world_coordinates_round_trip_to_the_last_bit() {
    let world: Vec<DVec3> = (0..500)
        .map(|i| {
            let t = f64::from(i);
            DVec3::new(637_000.001 + t * 0.517, 5_403_059.123_4 - t * 0.311, t / 7.0)
        })
        .collect();
    let mut cloud = PointCloud::from_world(&world);
    cloud.normals = Some((0..500).map(|i| Vec3::new(1.0 / 3.0, i as f32, -0.1)).collect());
    cloud.colors = Some((0..500).map(|i| [i as u8, 1, 2, 255 - i as u8]).collect());
    cloud.attributes = vec![Attribute { name: "gps_time".into(), values: Column::F64(vec![1.0 / 3.0; 500]) }];
    for write in [write_xyz, write_csv] {
        let mut bytes = vec![];
        write(&cloud, &mut bytes).unwrap();
        assert_eq!(read("XYZ", &bytes).unwrap(), cloud);
    }
}

#[test]
fn an_empty_cloud_is_written_and_read_as_one() {
    let cloud = PointCloud::default();
    for write in [write_xyz, write_csv] {
        let mut bytes = vec![];
        write(&cloud, &mut bytes).unwrap();
        assert_eq!(read("CSV", &bytes).unwrap(), cloud);
    }
}

#[test]
fn a_file_cut_anywhere_is_read_or_refused_without_a_panic() {
    let seed = b"x,y,z,red,green,blue,time\r\n1.5,2,3,10,20,30,0.25\n4,5,6e-1,40,50,60,-1\n";
    for end in 0..seed.len() {
        match read("CSV", &seed[..end]) {
            Ok(cloud) => assert!(cloud.len() <= 2 && cloud.validate().is_ok(), "cut at {end}"),
            Err(error) => assert!(matches!(error, Error::File(_)), "cut at {end}: {error}"),
        }
    }
}
