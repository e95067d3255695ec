//! LAS and LAZ files written by the crate `las`, damaged ones, and the real scans.

use std::io::Cursor;

use glam::DVec3;
use las::point::{Classification, Format, Point};

use super::read;
use crate::geometry::{Column, PointCloud};
use crate::io::test_data::real_file;

const POINTS: usize = 40;

/// Point `i` of the samples; coordinates are whole millimetres far from zero.
fn sample_point(i: usize, format: Format) -> Point {
    let step = i as f64;
    Point {
        x: 637_000.001 + step * 0.517,
        y: 5_403_059.123 - step * 0.311,
        z: 412.007 + (step * 0.7).sin(),
        intensity: (i * 1000) as u16,
        return_number: 1 + (i % 3) as u8,
        number_of_returns: 3,
        classification: Classification::new((i % 7) as u8).unwrap(),
        gps_time: format.has_gps_time.then_some(245_379.398_436_825_14 + step),
        color: format.has_color.then(|| las::Color::new(256 * i as u16, 0xffff, 255)),
        nir: format.has_nir.then_some(7),
        waveform: format.has_waveform.then(las::raw::point::Waveform::default),
        ..Point::default()
    }
}

fn sample(number: u8, compressed: bool) -> Vec<u8> {
    let mut builder = las::Builder::from((1, 4));
    builder.point_format = Format::new(number).unwrap();
    builder.point_format.is_compressed = compressed;
    let transform = |offset| las::Transform { scale: 0.001, offset };
    builder.transforms = las::Vector { x: transform(600_000.0), y: transform(5_400_000.0), z: transform(0.0) };
    let format = builder.point_format;
    let mut writer = las::Writer::new(Cursor::new(vec![]), builder.into_header().unwrap()).unwrap();
    for i in 0..POINTS {
        writer.write_point(sample_point(i, format)).unwrap();
    }
    writer.into_inner().unwrap().into_inner()
}

fn refusal(bytes: &[u8]) -> String {
    read(bytes).expect_err("the file should be refused").to_string()
}

/// The message for `bytes` with `value` written over byte `at`.
fn planted(bytes: &[u8], at: usize, value: &[u8]) -> String {
    let mut bytes = bytes.to_vec();
    bytes[at..at + value.len()].copy_from_slice(value);
    refusal(&bytes)
}

/// The message for `bytes` with another number of points in the header.
fn with_count(bytes: &[u8], count: u64) -> String {
    let mut bytes = bytes.to_vec();
    bytes[107..111].fill(0);
    planted(&bytes, 247, &count.to_le_bytes())
}

fn attribute<'a>(cloud: &'a PointCloud, name: &str) -> &'a Column {
    &cloud.attributes.iter().find(|a| a.name == name).expect("the attribute should be there").values
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}

fn points_start(bytes: &[u8]) -> usize {
    u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize
}

/// Byte of the LASzip record's content in a compressed sample: the first record behind the header of version 1.4.
const LASZIP: usize = 375 + 54;

#[test]
fn every_point_format_gives_its_columns() {
    for number in [0, 1, 2, 3, 6, 7, 8] {
        for compressed in [false, true] {
            let case = format!("format {number}, compressed {compressed}");
            let cloud = read(&sample(number, compressed)).unwrap_or_else(|error| panic!("{case}: {error}"));
            let format = Format::new(number).unwrap();
            assert_eq!(cloud.len(), POINTS, "{case}");
            assert_eq!(cloud.attributes.len(), if format.has_gps_time { 5 } else { 4 }, "{case}");
            assert_eq!(cloud.colors.is_some(), format.has_color, "{case}");
            for i in 0..POINTS {
                let expected = sample_point(i, format);
                let distance = (cloud.world(i) - DVec3::new(expected.x, expected.y, expected.z)).abs().max_element();
                // Half a step of the file's scale, and half an f32 step of an offset below 16 m.
                assert!(distance <= 0.5e-3 + 0.5e-6, "{case}: point {i} is {distance} away");
                let value = |name| attribute(&cloud, name).get(i).unwrap();
                assert_eq!(value("intensity"), f64::from(expected.intensity), "{case}");
                assert_eq!(value("return_number"), f64::from(expected.return_number), "{case}");
                assert_eq!(value("number_of_returns"), 3.0, "{case}");
                assert_eq!(value("classification"), (i % 7) as f64, "{case}");
                if let Some(time) = expected.gps_time {
                    assert_eq!(value("gps_time"), time, "{case}");
                }
                if let Some(colors) = &cloud.colors {
                    assert_eq!(colors[i], [i as u8, 255, 0, 255], "{case}");
                }
            }
        }
    }
}

#[test]
fn eight_bit_colors_in_sixteen_bit_fields_are_kept() {
    let mut bytes = sample(2, false);
    let start = points_start(&bytes);
    for i in 0..POINTS {
        bytes[start + 26 * i + 20..start + 26 * i + 26].copy_from_slice(&[200, 0, 100, 0, i as u8, 0]);
    }
    let cloud = read(&bytes).unwrap();
    assert_eq!(cloud.colors.unwrap()[7], [200, 100, 7, 255]);
}

#[test]
fn a_cut_file_is_an_error() {
    for (number, compressed) in [(3, false), (3, true), (7, false), (7, true)] {
        let bytes = sample(number, compressed);
        for end in 0..bytes.len() {
            assert!(read(&bytes[..end]).is_err(), "format {number}, compressed {compressed}, cut at byte {end}");
        }
    }
}

#[test]
fn counts_beyond_the_bytes_are_refused() {
    let las = sample(1, false);
    assert!(with_count(&las, u64::MAX).contains("can hold"));
    assert!(with_count(&las, POINTS as u64 + 1).contains("at most 40"));
    assert!(planted(&las, 107, &3_u32.to_le_bytes()).contains("the count at byte 107"));
    assert!(planted(&las, 100, &u32::MAX.to_le_bytes()).contains("can hold"));
    assert!(planted(&las, 96, &u32::MAX.to_le_bytes()).contains("point data at byte 4294967295"));
    assert!(planted(&las, 235, &[0xff; 12]).contains("extended records at byte"));
    let at_end = [(las.len() as u64).to_le_bytes().as_slice(), &u32::MAX.to_le_bytes()].concat();
    assert!(planted(&las, 235, &at_end).contains("can hold"));
}

#[test]
fn bad_headers_name_the_byte() {
    let las = sample(1, false);
    assert_eq!(planted(&las, 0, b"X"), "input at byte 0: LAS: found \"XASF\", expected \"LASF\"");
    assert!(planted(&las, 25, &[9]).contains("version 1.9, expected version 1.0 to 1.4"));
    assert!(planted(&las, 94, &[10, 0]).contains("a header size of 10"));
    assert!(planted(&las, 104, &[11]).contains("point format 11"));
    assert!(planted(&las, 105, &[19, 0]).contains("a record length of 19, expected at least 28"));
    assert!(planted(&las, 131, &f64::NAN.to_le_bytes()).contains("a scale of NaN"));
    assert!(planted(&las, 139, &[0; 8]).contains(" at byte 139: LAS: found a scale of 0"));
    assert!(planted(&las, 171, &f64::INFINITY.to_le_bytes()).contains("an offset of inf"));
    assert!(refusal(b"").contains("an empty file"));
    assert!(refusal(b"LASF").contains("the end of the file in the header"));
}

#[test]
fn bad_compression_is_refused_before_it_is_decoded() {
    let laz = sample(3, true);
    let table = u64_at(&laz, points_start(&laz)) as usize;
    assert!(planted(&laz, table + 4, &u32::MAX.to_le_bytes()).contains("can hold"));
    assert!(planted(&laz, table + 4, &0_u32.to_le_bytes()).contains("a count of 40 points, expected at most the 0"));
    assert!(planted(&laz, points_start(&laz), &u64::MAX.to_le_bytes()).contains("a chunk table at byte"));
    assert!(planted(&laz, points_start(&laz), &(laz.len() as u64).to_le_bytes()).contains("in the chunk table"));
    assert!(planted(&laz, LASZIP, &[9, 0]).contains("LASzip compressor 9"));
    assert!(planted(&laz, LASZIP + 34, &[7, 0]).contains("compressed fields"));
    assert!(planted(&laz, LASZIP - 54 + 2, b"L").contains("no LASzip record"));
    // The header asks for more points than the one chunk holds; the chunk size allows 50,000.
    assert!(with_count(&laz, 50_001).contains("a count of 50001 points, expected at most the 50000"));
    assert!(with_count(&laz, 50_000).contains("a compressed chunk that breaks after"));
}

#[test]
fn layer_sizes_beyond_the_chunk_are_refused() {
    let laz = sample(7, true);
    let layers = points_start(&laz) + 8 + 36 + 4;
    for layer in 0..10 {
        let message = planted(&laz, layers + 4 * layer, &u32::MAX.to_le_bytes());
        assert!(message.contains("for its layers"), "layer {layer}: {message}");
    }
}

#[test]
fn a_huge_count_in_one_huge_chunk_costs_no_memory() {
    let mut laz = sample(1, true);
    laz[LASZIP + 12..LASZIP + 16].copy_from_slice(&0xffff_fffe_u32.to_le_bytes());
    assert!(with_count(&laz, 0xffff_fff0).contains("a compressed chunk that breaks after"));
}

#[test]
fn equal_points_that_compress_to_almost_nothing_are_read() {
    // 41 MB of columns from a file of some kilobytes: more than is allowed without decoding it once before.
    let mut builder = las::Builder::from((1, 2));
    builder.point_format = Format::new(0).unwrap();
    builder.point_format.is_compressed = true;
    let mut writer = las::Writer::new(Cursor::new(vec![]), builder.into_header().unwrap()).unwrap();
    let points = 1_000_000;
    for _ in 0..points {
        writer.write_point(Point { x: 5.25, ..Point::default() }).unwrap();
    }
    let bytes = writer.into_inner().unwrap().into_inner();
    assert!(bytes.len() < 100_000, "{} bytes", bytes.len());
    let cloud = read(&bytes).unwrap();
    assert_eq!(cloud.len(), points);
    assert!((0..points).all(|i| cloud.world(i) == DVec3::new(5.25, 0.0, 0.0)));
}

#[test]
fn a_chunk_table_offset_at_the_end_is_found() {
    let mut laz = sample(6, true);
    let start = points_start(&laz);
    let table = laz[start..start + 8].to_vec();
    laz[start..start + 8].copy_from_slice(&(-1_i64).to_le_bytes());
    laz.extend(table);
    assert_eq!(read(&laz).unwrap().len(), POINTS);
}

#[test]
fn no_points_give_an_empty_cloud() {
    for compressed in [false, true] {
        let mut builder = las::Builder::from((1, 2));
        builder.point_format.is_compressed = compressed;
        let mut writer = las::Writer::new(Cursor::new(vec![]), builder.into_header().unwrap()).unwrap();
        writer.close().unwrap();
        let bytes = writer.into_inner().unwrap().into_inner();
        assert!(read(&bytes).unwrap().is_empty(), "compressed {compressed}");
    }
}

#[test]
fn real_las_coordinates_are_scale_times_integer() {
    let Some(bytes) = real_file("autzen-thin.las") else { return };
    let cloud = read(&bytes).unwrap();
    assert_eq!(cloud.len(), 10_653);
    let start = points_start(&bytes);
    for (i, record) in bytes[start..].chunks_exact(34).take(cloud.len()).enumerate() {
        let integer = |at: usize| f64::from(i32::from_le_bytes(record[at..at + 4].try_into().unwrap()));
        let expected = DVec3::new(integer(0), integer(4), integer(8)) * 0.01;
        // Half an f32 step of an offset below 4096 m.
        assert!((cloud.world(i) - expected).abs().max_element() <= 0.000_123, "point {i}");
    }
    // As laspy reads them.
    assert_eq!(cloud.colors.as_ref().unwrap()[5432], [229, 226, 213, 255]);
    assert_eq!(attribute(&cloud, "gps_time").get(10_652), Some(249_773.492_351_052_32));
    assert_eq!(attribute(&cloud, "return_number").get(10_652), Some(2.0));
}

#[test]
fn real_laz_equals_the_values_of_laspy() {
    let Some(bytes) = real_file("autzen-trim.laz") else { return };
    let cloud = read(&bytes).unwrap();
    assert_eq!(cloud.len(), 110_000);
    let hundredths =
        |axis: usize| -> i64 { (0..cloud.len()).map(|i| (cloud.world(i)[axis] * 100.0).round() as i64).sum() };
    assert_eq!([hundredths(0), hundredths(1), hundredths(2)], [7_002_010_454_461, 9_340_603_643_128, 4_733_712_773]);
    let intensity = attribute(&cloud, "intensity");
    assert_eq!((0..cloud.len()).filter_map(|i| intensity.get(i)).sum::<f64>(), 11_220_547.0);
    assert_eq!(attribute(&cloud, "gps_time").get(54_321), Some(245_383.599_056_612_44));
    assert_eq!(attribute(&cloud, "classification").get(54_321), Some(1.0));
    let colors = cloud.colors.as_ref().unwrap();
    assert_eq!([colors[0], colors[109_999]], [[84, 102, 93, 255], [64, 74, 70, 255]]);
}
