//! `nearfield neighbors --knn` and `--radii`: rows as a plain loop finds them, the summary, pictures, and why a structure
//! was chosen.

use std::fmt::Write;
use std::fs;

use serde_json::Value;

use crate::neighbors::{npz_arrays, png_pixels};
use crate::{Folder, gpu_or_skip, with_four};

/// Coordinates of so many points, multiples of 1/32 below 8: differences and squares are exact, and there are ties.
fn cloud(n: usize, seed: u64) -> Vec<[f32; 3]> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as f32 / 32.0
    };
    (0..n).map(|_| [next(), next(), next()]).collect()
}

fn text(points: &[[f32; 3]]) -> String {
    points.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect()
}

/// The rows of a plain loop as CSV: the k nearest of each query within its radius, ties by lower index.
fn by_loop(points: &[[f32; 3]], queries: &[[f32; 3]], k: usize, radius: impl Fn(usize) -> f32, own: bool) -> String {
    let mut csv = "query,neighbor,distance\n".to_owned();
    for (i, query) in queries.iter().enumerate() {
        let dist2 = |p: &[f32; 3]| (0..3).map(|axis| (p[axis] - query[axis]).powi(2)).sum::<f32>();
        let mut row: Vec<(f32, usize)> = points.iter().map(dist2).zip(0..).collect();
        row.retain(|&(dist2, j)| dist2 <= radius(i) * radius(i) && (own || j != i));
        row.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (dist2, j) in row.iter().take(k) {
            writeln!(csv, "{i},{j},{}", dist2.sqrt()).unwrap();
        }
    }
    csv
}

#[test]
fn the_nearest_are_those_of_a_plain_loop() {
    let folder = Folder::new("knn");
    let (points, queries) = (cloud(400, 1), cloud(60, 2));
    fs::write(folder.path("points.xyz"), text(&points)).unwrap();
    fs::write(folder.path("probes.xyz"), text(&queries)).unwrap();
    for structure in ["auto", "brute-force", "linear-octree"] {
        let ask = |rest: &str| {
            folder.ok(&format!("neighbors points.xyz --device cpu --structure {structure} --output - {rest} --quiet"))
        };
        let far = |_| f32::INFINITY;
        assert_eq!(ask("--knn 8"), by_loop(&points, &points, 8, far, true), "{structure}");
        assert_eq!(ask("--knn 5 --exclude-self"), by_loop(&points, &points, 5, far, false), "{structure}");
        assert_eq!(ask("--knn 130 --queries probes.xyz"), by_loop(&points, &queries, 130, far, true), "{structure}");
        assert_eq!(ask("--knn 6 --radius 0.75"), by_loop(&points, &points, 6, |_| 0.75, true), "{structure}");
        assert_eq!(ask("--knn 3 --radius 0"), by_loop(&points, &points, 3, |_| 0.0, true), "{structure}");
    }
    // Structures without a search for the nearest have lists that are cut.
    for structure in ["uniform-grid", "aabb-tree"] {
        let ask = format!("neighbors points.xyz --device cpu --structure {structure} --knn 6 --radius 0.75 -o - -q");
        assert_eq!(folder.ok(&ask), by_loop(&points, &points, 6, |_| 0.75, true), "{structure}");
    }
}

#[test]
fn the_nearest_are_the_same_on_the_gpu() {
    let Some(device) = gpu_or_skip("command::nearest::the_nearest_are_the_same_on_the_gpu") else { return };
    let folder = Folder::new("knn-gpu");
    let points = cloud(1200, 3);
    fs::write(folder.path("points.xyz"), text(&points)).unwrap();
    let radii: Vec<f32> = (0..points.len()).map(|i| (i % 7) as f32 / 8.0).collect();
    let lines: String = radii.iter().map(|radius| format!("{radius}\n")).collect();
    fs::write(folder.path("radii.txt"), lines).unwrap();
    let ask = |rest: &str| {
        let mut command = folder.command(&format!("neighbors points.xyz --output - --quiet {rest}"));
        let output = command.args(["--device", &device]).output().unwrap();
        assert!(output.status.success(), "{rest}: {output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    for structure in ["auto", "brute-force", "linear-octree"] {
        let nearest = ask(&format!("--knn 4 --structure {structure}"));
        assert_eq!(nearest, by_loop(&points, &points, 4, |_| f32::INFINITY, true), "{structure}");
        let within = ask(&format!("--knn 4 --radii radii.txt --structure {structure}"));
        assert_eq!(within, by_loop(&points, &points, 4, |i| radii[i], true), "{structure}");
    }
}

#[test]
fn the_summary_of_the_nearest_has_their_distances() {
    let folder = with_four("knn-json");
    // Second nearest, the point itself the first: 0.5, 0.5, 1 and √(100 − 0.5)².
    let found = folder.json("neighbors four.xyz --knn 2 --device cpu --json");
    assert_eq!((&found["k"], &found["full_rows"], &found["radius"]), (&Value::from(2), &Value::from(4), &Value::Null));
    assert_eq!((&found["kth_distance_min"], &found["kth_distance_max"]), (&Value::from(0.5), &Value::from(99.5)));
    assert_eq!(found["kth_distance_mean"], (0.5 + 0.5 + 1.0 + 99.5) / 4.0);
    assert_eq!((&found["neighbors_total"], &found["cut_rows"]), (&Value::from(8), &Value::from(0)));
    let within = folder.json("neighbors four.xyz --knn 2 --radius 0.5 --device cpu --json");
    assert_eq!((&within["full_rows"], &within["neighbors_total"]), (&Value::from(2), &Value::from(6)));
    assert_eq!((&within["radius"], &within["kth_distance_max"]), (&Value::from(0.5), &Value::from(0.5)));
    let lines = folder.ok("neighbors four.xyz --knn 2 --radius 0.5 --device cpu");
    assert!(lines.contains("distance of neighbour 2: mean 0.5") && lines.contains("of the 2 queries"), "{lines}");
    let plain = folder.json("neighbors four.xyz --radius 0.5 --device cpu --json");
    assert!(plain["k"].is_null() && plain["kth_distance_mean"].is_null(), "{plain}");
}

#[test]
fn more_neighbours_than_points_are_all_of_them_and_said() {
    let folder = with_four("knn-many");
    let found = folder.json("neighbors four.xyz --knn 4000000000 --exclude-self --device cpu --json --max-memory 1MB");
    assert_eq!((&found["neighbors_total"], &found["full_rows"]), (&Value::from(12), &Value::from(0)));
    assert!(found["notes"][0].as_str().unwrap().contains("there are 3 points"), "{found}");
    assert!(found["kth_distance_max"].is_null());
    fs::write(folder.path("one.xyz"), "1 2 3\n").unwrap();
    let alone = folder.json("neighbors one.xyz --knn 1 --exclude-self --device cpu --json");
    assert_eq!((&alone["neighbors_total"], &alone["queries"]), (&Value::from(0), &Value::from(1)));
    folder.fails("neighbors four.xyz --knn 4 --device cpu --max-memory 100", 75, "bytes");
}

#[test]
fn rows_of_the_nearest_can_be_ordered_by_index() {
    let folder = with_four("knn-index");
    let rows = folder.ok("neighbors four.xyz --knn 3 --device cpu --sort index -o -");
    let expected = "query,neighbor,distance\n0,0,0\n0,1,0.5\n0,2,1\n1,0,0.5\n1,1,0\n1,2,1.118034\n\
                    2,0,1\n2,1,1.118034\n2,2,0\n3,0,100\n3,1,99.5\n3,3,0\n";
    assert_eq!(rows, expected);
    folder.ok("neighbors four.xyz --knn 3 --radius 0.5 --device cpu -o rows.npz");
    let arrays = npz_arrays(&fs::read(folder.path("rows.npz")).unwrap());
    let offsets: Vec<u64> = arrays[0].2.chunks(8).map(|b| u64::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!((offsets, arrays[1].2.len(), arrays[2].2.len()), (vec![0, 2, 4, 5, 6], 24, 24));
}

/// An NPY array of one axis, written from the format's specification.
fn npy(kind: &str, n: usize, elements: Vec<u8>) -> Vec<u8> {
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({n},), }}");
    header += &" ".repeat((64 - (11 + header.len()) % 64) % 64);
    header.push('\n');
    let length = u16::try_from(header.len()).unwrap().to_le_bytes();
    [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), &elements].concat()
}

#[test]
fn each_query_has_the_radius_of_its_line() {
    let folder = with_four("radii-rows");
    fs::write(folder.path("radii.txt"), "0.5\n0\n1.25\n100\n").unwrap();
    let halves: Vec<u8> = [0.5f32, 0.0, 1.25, 100.0].iter().flat_map(|r| r.to_le_bytes()).collect();
    let words: Vec<u8> = [0.5f64, 0.0, 1.25, 100.0].iter().flat_map(|r| r.to_be_bytes()).collect();
    fs::write(folder.path("radii32.npy"), npy("<f4", 4, halves)).unwrap();
    fs::write(folder.path("radii64.npy"), npy(">f8", 4, words)).unwrap();
    let expected =
        "query,neighbor,distance\n0,0,0\n0,1,0.5\n1,1,0\n2,0,1\n2,1,1.118034\n2,2,0\n3,0,100\n3,1,99.5\n3,3,0\n";
    for file in ["radii.txt", "radii32.npy", "radii64.npy"] {
        for structure in ["brute-force", "uniform-grid", "linear-octree", "aabb-tree"] {
            let ask =
                format!("neighbors four.xyz --radii {file} --device cpu --structure {structure} --sort index -o -");
            assert_eq!(folder.ok(&ask), expected, "{file}, {structure}");
        }
    }
    let found = folder.json("neighbors four.xyz --radii radii.txt --device cpu --json");
    assert_eq!(
        (&found["radius"], &found["radius_min"], &found["radius_max"]),
        (&Value::Null, &0.0.into(), &100.0.into())
    );
    assert!(folder.ok("neighbors four.xyz --radii radii.txt --device cpu").contains("0 to 100"));
    let nearest = folder.ok("neighbors four.xyz --radii radii.txt --knn 2 --device cpu -o -");
    assert_eq!(nearest, "query,neighbor,distance\n0,0,0\n0,1,0.5\n1,1,0\n2,2,0\n2,0,1\n3,3,0\n3,1,99.5\n");
    let piped = folder.pipe("neighbors four.xyz --radii - --device cpu --json", b"0.5\n0.5\n0.5\n0.5\n");
    let piped: Value = serde_json::from_slice(&piped.stdout).unwrap();
    assert_eq!((&piped["radius"], &piped["neighbors_total"]), (&0.5.into(), &6.into()));
}

#[test]
fn auto_says_why_and_a_named_structure_has_no_reason() {
    let folder = Folder::new("reason");
    folder.ok("generate uniform -n 3000 --seed 7 -o uniform.ply --quiet");
    let ask = |rest: &str| folder.json(&format!("neighbors uniform.ply --device cpu --json {rest}"));
    let grid = ask("-r 0.1");
    assert_eq!(grid["structure"], "uniform-grid");
    let reason = grid["reason"].as_str().unwrap();
    assert!(reason.starts_with("auto chose uniform-grid: ") && reason.contains("% of the cells used"), "{reason}");
    let tree = ask("--knn 8");
    assert!(tree["structure"] != "uniform-grid" && tree["reason"].as_str().unwrap().contains("8 nearest"), "{tree}");
    let radii: String = (0..3000).map(|i| if i == 7 { "0.3\n" } else { "0.05\n" }).collect();
    fs::write(folder.path("radii.txt"), radii).unwrap();
    let varied = ask("--radii radii.txt");
    assert!(varied["structure"] != "uniform-grid", "{varied}");
    assert!(varied["reason"].as_str().unwrap().contains("the largest is 0.3 and the median 0.05"), "{varied}");
    assert!(ask("-r 0.1 --structure uniform-grid")["reason"].is_null());
    let lines = folder.ok("neighbors uniform.ply -r 0.1 --device cpu");
    assert!(lines.lines().any(|line| line.starts_with("reason ") && line.contains("auto chose")), "{lines}");
}

#[test]
fn pictures_of_the_nearest_show_distances_and_one_row() {
    let folder = Folder::new("knn-picture");
    folder.ok("generate shell -n 3000 -o shell.ply --quiet");
    let shoot = "neighbors shell.ply --knn 9 --device cpu --quiet --picture-size 480x300";
    folder.ok(&format!("{shoot} --picture distance.png"));
    folder.ok(&format!("{shoot} --picture one.png --color neighbors-of:7"));
    folder.ok(&format!("{shoot} --radius 0.08 --picture within.png"));
    folder.ok(&format!("{shoot} --radius 0.1 --picture count.png --color count"));
    let count =
        |name: &str, keep: fn(&[u8; 3]) -> bool| png_pixels(&folder.path(name)).iter().filter(|p| keep(p)).count();
    let coloured = |p: &[u8; 3]| p.iter().max().unwrap() - p.iter().min().unwrap() > 60;
    assert!(count("distance.png", coloured) > 5000);
    // Within 0.08 most have fewer than nine: they are grey.
    assert!(count("within.png", coloured) < count("distance.png", coloured) / 2);
    assert!(count("count.png", coloured) > 5000);
    let green = |p: &[u8; 3]| p[1] > 100 && p[1] > 2 * p[0] && p[1] > 2 * p[2];
    let blue = |p: &[u8; 3]| p[2] > 100 && p[2] > 2 * p[0];
    let (one, many) = (count("one.png", green), count("one.png", blue));
    assert!(one > 5 && many > one, "{one} green, {many} blue pixels");
}
