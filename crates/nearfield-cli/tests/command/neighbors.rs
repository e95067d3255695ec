//! `nearfield neighbors`: its lists, its summary and its pictures.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::{Folder, png_size, with_four};

#[test]
fn neighbors_counts_the_closed_ball_and_prints_every_key() {
    let folder = with_four("json");
    let found = folder.json("neighbors four.xyz --radius 0.5 --device cpu --json");
    assert_eq!((&found["points"], &found["queries"]), (&Value::from(4), &Value::from(4)));
    // Rows: {0, 1}, {0, 1}, {2}, {3}: the point at exactly the radius is inside.
    assert_eq!(found["neighbors_total"], 6);
    assert_eq!(found["neighbors_mean"], 1.5);
    assert_eq!((&found["neighbors_min"], &found["neighbors_max"]), (&Value::from(1), &Value::from(2)));
    assert_eq!(found["structure"], "brute-force");
    assert!(found["device"].as_str().unwrap().starts_with("cpu ("));
    assert!(!found["kernels"].as_array().unwrap().is_empty() && found["memory_bytes"].as_u64().unwrap() > 0);
    for stage in ["read", "upload", "build", "query", "read_back", "write"] {
        assert!(found["milliseconds"][stage].is_number(), "{stage}: {found}");
    }
    for key in ["search", "notes", "cut_rows", "cut_neighbors", "radius"] {
        assert!(!found[key].is_null(), "{key}: {found}");
    }
    let grid = folder.json("neighbors four.xyz -r 0.5 --device cpu --structure uniform-grid --exclude-self --json");
    assert_eq!((&grid["structure"], &grid["neighbors_total"]), (&Value::from("uniform-grid"), &Value::from(2)));
}

#[test]
fn neighbors_writes_rows_as_csv_to_files_and_standard_output() {
    let folder = with_four("csv");
    let expected = "query,neighbor,distance\n0,0,0\n0,1,0.5\n0,2,1\n1,0,0.5\n1,1,0\n2,0,1\n2,2,0\n3,3,0\n";
    assert_eq!(folder.ok("neighbors four.xyz -r 1 --device cpu --sort index --output -"), expected);
    folder.ok("neighbors four.xyz -r 1 --device cpu --sort index --output rows.csv --quiet");
    assert_eq!(fs::read_to_string(folder.path("rows.csv")).unwrap(), expected);
    let nearest_first = folder.ok("neighbors four.xyz -r 1 --device cpu --sort distance --exclude-self -o -");
    assert_eq!(nearest_first, "query,neighbor,distance\n0,1,0.5\n0,2,1\n1,0,0.5\n2,0,1\n");
}

/// The uncompressed arrays of an NPZ archive by name: (numpy type, raw values). Written from the two format
/// specifications, apart from the library's own reader.
pub(crate) fn npz_arrays(bytes: &[u8]) -> Vec<(String, String, Vec<u8>)> {
    let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]) as usize;
    let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let end = (0..bytes.len() - 21).rev().find(|&at| bytes[at..].starts_with(b"PK\x05\x06")).unwrap();
    let (entries, mut at) = (u16_at(end + 10), u32_at(end + 16));
    let mut arrays = vec![];
    for _ in 0..entries {
        assert!(bytes[at..].starts_with(b"PK\x01\x02"));
        assert_eq!(u16_at(at + 10), 0, "stored, not compressed");
        let (size, name_len, local) = (u32_at(at + 24), u16_at(at + 28), u32_at(at + 42));
        let name = String::from_utf8(bytes[at + 46..at + 46 + name_len].to_vec()).unwrap();
        let data = local + 30 + u16_at(local + 26) + u16_at(local + 28);
        let array = &bytes[data..data + size];
        assert!(array.starts_with(b"\x93NUMPY\x01"));
        let header_len = u16::from_le_bytes([array[8], array[9]]) as usize;
        let header = std::str::from_utf8(&array[10..10 + header_len]).unwrap();
        let kind = header.split('\'').find(|part| part.starts_with(['<', '|'])).unwrap().to_owned();
        arrays.push((name, kind, array[10 + header_len..].to_vec()));
        at += 46 + name_len + u16_at(at + 30) + u16_at(at + 32);
    }
    arrays
}

#[test]
fn neighbors_writes_lists_that_numpy_reads() {
    let folder = with_four("npz");
    folder.ok("neighbors four.xyz -r 0.5 --device cpu --sort index -o rows.npz");
    let bytes = fs::read(folder.path("rows.npz")).unwrap();
    let words = |values: &[u64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let halves = |values: &[u32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let expected = [
        ("offsets.npy".to_owned(), "<u8".to_owned(), words(&[0, 2, 4, 5, 6])),
        ("indices.npy".to_owned(), "<u4".to_owned(), halves(&[0, 1, 0, 1, 2, 3])),
        ("distances.npy".to_owned(), "<f4".to_owned(), floats(&[0.0, 0.5, 0.5, 0.0, 0.0, 0.0])),
    ];
    assert_eq!(npz_arrays(&bytes), expected);
}

#[test]
fn a_cap_keeps_the_nearest_and_is_reported_even_when_quiet() {
    let folder = with_four("cap");
    // Without a list the cuts are known from the counts, with one from the rows: both must say the same.
    for output in ["", "-o rows.csv --force"] {
        let found = folder.json(&format!("neighbors four.xyz -r 1 --device cpu --max-neighbors 1 --json {output}"));
        assert_eq!((&found["cut_rows"], &found["cut_neighbors"]), (&Value::from(3), &Value::from(4)), "{output}");
        assert_eq!(found["neighbors_total"], 4, "{output}");
    }
    assert_eq!(fs::read_to_string(folder.path("rows.csv")).unwrap().lines().nth(2), Some("1,1,0"));
    let quiet = folder.run("neighbors four.xyz -r 1 --device cpu --max-neighbors 1 --quiet");
    let stderr = String::from_utf8(quiet.stderr).unwrap();
    assert!(quiet.stdout.is_empty() && stderr.contains("3 rows") && stderr.contains("4 neighbours"), "{stderr}");
}

#[test]
fn a_percent_radius_is_of_the_diagonal() {
    let folder = Folder::new("percent");
    fs::write(folder.path("box.xyz"), "0 0 0\n3 4 12\n").unwrap(); // diagonal 13
    let found = folder.json("neighbors box.xyz --radius 50% --device cpu --json");
    assert_eq!(found["radius"], 6.5);
    assert_eq!(folder.json("neighbors box.xyz --radius 100% --device cpu --json")["neighbors_total"], 4);
}

#[test]
fn queries_of_another_file_meet_points_far_from_zero() {
    let folder = Folder::new("queries");
    // Map coordinates: an f32 at 5,403,000 has steps of 0.5, and the two files have different centers.
    fs::write(folder.path("points.xyz"), "637000.25 5403000.125 400\n637001.25 5403000.125 400\n").unwrap();
    fs::write(folder.path("probes.xyz"), "637000.25 5403000.0 400\n637900 5403900 400\n637001.25 5403000.125 400\n")
        .unwrap();
    let rows = folder.ok("neighbors points.xyz --queries probes.xyz -r 0.125 --device cpu --sort index -o -");
    assert_eq!(rows, "query,neighbor,distance\n0,0,0.125\n2,1,0\n");
}

#[test]
fn a_periodic_axis_wraps() {
    let folder = Folder::new("periodic");
    fs::write(folder.path("two.xyz"), "0.0625 0 0\n0.9375 0 0\n").unwrap();
    let count = |extra: &str| {
        folder.json(&format!("neighbors two.xyz -r 0.125 --device cpu --json {extra}"))["neighbors_total"].clone()
    };
    assert_eq!((count(""), count("--periodic 1,0,0")), (Value::from(2), Value::from(4)));
}

/// Pixels of a PNG as red, green and blue.
pub(crate) fn png_pixels(path: &Path) -> Vec<[u8; 3]> {
    let decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(path).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    pixels.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()
}

#[test]
fn pictures_have_the_size_and_the_colors_asked_for() {
    let folder = Folder::new("picture");
    folder.ok("generate shell -n 3000 -o shell.ply --quiet");
    let shoot = "neighbors shell.ply -r 0.2 --device cpu --quiet --picture-size 480x300";
    for color in ["count", "cell", "neighbors-of:7"] {
        let name = format!("{}.png", color.replace(':', "-"));
        folder.ok(&format!("{shoot} --picture {name} --color {color}"));
        assert_eq!(png_size(&folder.path(&name)), (480, 300), "{color}");
    }
    let count =
        |name: &str, keep: fn(&[u8; 3]) -> bool| png_pixels(&folder.path(name)).iter().filter(|p| keep(p)).count();
    // Strong green and strong blue: one point among its neighbours, and none of either in grey surroundings.
    let green = |p: &[u8; 3]| p[1] > 100 && p[1] > 2 * p[0] && p[1] > 2 * p[2];
    let blue = |p: &[u8; 3]| p[2] > 100 && p[2] > 2 * p[0];
    let (one, many) = (count("neighbors-of-7.png", green), count("neighbors-of-7.png", blue));
    assert!(one > 5 && many > one, "{one} green, {many} blue pixels");
    assert!(count("cell.png", |p| p.iter().max().unwrap() - p.iter().min().unwrap() > 60) > 5000);
    folder.ok("neighbors shell.ply -r 0.2 --queries shell.ply --device cpu --picture q.png --picture-size 200x200 -q");
    assert_eq!(png_size(&folder.path("q.png")), (200, 200));
}
