//! `nearfield sort`: orders, files, attributes, pictures and what is refused.

use std::fs;

use serde_json::Value;

use crate::{Folder, png_size};

/// Cells of a 4 × 4 square in Morton order, x first.
const Z: [[u32; 2]; 10] = [[0, 0], [0, 1], [1, 0], [1, 1], [0, 2], [1, 3], [2, 0], [3, 1], [2, 3], [3, 3]];

fn ten(folder: &Folder) {
    let backwards: String = Z.iter().rev().map(|[x, y]| format!("{x} {y} 0\n")).collect();
    fs::write(folder.path("ten.xyz"), backwards).unwrap();
}

/// The first three columns of a text file of points.
fn coordinates(folder: &Folder, name: &str) -> Vec<[f64; 3]> {
    let text = fs::read_to_string(folder.path(name)).unwrap();
    let row = |line: &str| {
        let values: Vec<f64> = line.split([' ', ',']).filter_map(|t| t.parse().ok()).collect();
        values.get(..3).map(|v| [v[0], v[1], v[2]])
    };
    text.lines().filter_map(row).collect()
}

#[test]
fn points_are_written_along_the_curve() {
    let folder = Folder::new("sort-ten");
    ten(&folder);
    let told = folder.ok("sort ten.xyz -o sorted.xyz");
    assert_eq!(coordinates(&folder, "sorted.xyz"), Z.map(|[x, y]| [x.into(), y.into(), 0.0]));
    for line in
        ["points      10\n", "curve       morton in 2 dimensions\n", "domain      cube of 3 at 0 0 0\n", "mean jump   "]
    {
        assert!(told.contains(line), "{line} in {told}");
    }
    folder.fails("sort ten.xyz -o sorted.xyz", 73, "--force");
    folder.ok("sort ten.xyz -o sorted.xyz --force -q");
}

#[test]
fn points_in_a_plane_follow_the_curve_in_two_dimensions() {
    let folder = Folder::new("sort-plane");
    let square: String = (0..64).map(|i| format!("{} 7 {}\n", i % 8, i / 8)).collect();
    fs::write(folder.path("square.xyz"), square).unwrap();
    let found = folder.json("sort square.xyz --curve hilbert --json");
    // From each cell to one that shares a side.
    assert_eq!((&found["dimensions"], found["mean_jump_after"].as_f64()), (&Value::from(2), Some(1.0)), "{found}");
}

#[test]
fn the_mean_jumps_are_those_of_both_files() {
    let folder = Folder::new("sort-jumps");
    folder.ok("generate clustered -n 3000 --seed 5 -o cloud.csv -q");
    let jump = |name: &str| {
        let points = coordinates(&folder, name);
        let step = |w: &[[f64; 3]]| (0..3).map(|a| (w[1][a] - w[0][a]).powi(2)).sum::<f64>().sqrt();
        points.windows(2).map(step).sum::<f64>() / (points.len() - 1) as f64
    };
    let mut after = vec![];
    for curve in ["morton", "hilbert"] {
        let found = folder.json(&format!("sort cloud.csv --curve {curve} -o {curve}.csv --json"));
        assert_eq!((&found["points"], &found["curve"]), (&Value::from(3000), &Value::from(curve)));
        for (key, name) in [("mean_jump_before", "cloud.csv"), ("mean_jump_after", &format!("{curve}.csv"))] {
            let (told, expected) = (found[key].as_f64().unwrap(), jump(name));
            assert!((told / expected - 1.0).abs() < 1e-4, "{curve} {key}: {told}, the file has {expected}");
        }
        let mut sorted = coordinates(&folder, &format!("{curve}.csv"));
        let mut original = coordinates(&folder, "cloud.csv");
        sorted.sort_by(|a, b| a.partial_cmp(b).unwrap());
        original.sort_by(|a, b| a.partial_cmp(b).unwrap());
        assert_eq!(sorted, original, "{curve}");
        after.push(found["mean_jump_after"].as_f64().unwrap());
    }
    assert!(after[1] < after[0], "hilbert jumps less than morton: {after:?}");
}

#[test]
fn attributes_move_with_their_points() {
    let folder = Folder::new("sort-attributes");
    let rows: String = Z.iter().rev().map(|[x, y]| format!("{x},{y},0,{}\n", 10 * x + y)).collect();
    fs::write(folder.path("in.csv"), format!("x,y,z,intensity\n{rows}")).unwrap();
    folder.ok("sort in.csv -o out.csv -q");
    let text = fs::read_to_string(folder.path("out.csv")).unwrap();
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|line| line.split(',').map(|t| t.parse().unwrap()).collect()).collect();
    assert_eq!(rows.len(), 10);
    assert!(
        rows.iter().zip(Z).all(|(row, [x, y])| row[..] == [x.into(), y.into(), 0.0, (10 * x + y).into()]),
        "{text}"
    );
}

#[test]
fn pictures_of_any_number_of_points_are_drawn() {
    let folder = Folder::new("sort-picture");
    ten(&folder);
    folder.ok("sort ten.xyz --picture ten.png --picture-size 640x480 -q");
    assert_eq!(png_size(&folder.path("ten.png")), (640, 480));
    for n in [0, 1, 501, 20_001] {
        folder.ok(&format!("generate uniform -n {n} -o {n}.ply -q"));
        folder.ok(&format!("sort {n}.ply --curve hilbert --picture {n}.png --picture-size 640x480 -q"));
        assert_eq!(png_size(&folder.path(&format!("{n}.png"))), (640, 480));
    }
}

#[test]
fn what_cannot_be_sorted_is_refused() {
    let folder = Folder::new("sort-refused");
    fs::write(folder.path("bad.xyz"), "0 0 0\nnan 0 0\n1 1 1\n").unwrap();
    folder.fails("sort bad.xyz -o out.xyz", 65, "NaN");
    assert!(folder.ok("sort bad.xyz -o out.xyz --drop-invalid").contains("1 points with NaN"));
    assert_eq!(coordinates(&folder, "out.xyz").len(), 2);
    folder.fails("sort bad.xyz --curve peano", 2, "morton or hilbert");
    folder.fails("sort bad.xyz -o out.las", 2, "not written");
    folder.fails("sort bad.xyz --picture out.jpg", 2, ".png");
    folder.fails("sort bad.xyz -o - --to xyz --json", 2, "standard output");
    folder.fails("sort missing.xyz", 66, "missing.xyz");
}

#[test]
fn a_dash_reads_standard_input_and_writes_standard_output() {
    let folder = Folder::new("sort-dash");
    let output = folder.pipe("sort - --format xyz -o - --to xyz", b"1 1 1\n0 0 0\n");
    assert!(output.status.success(), "{output:?}");
    assert!(String::from_utf8(output.stdout).unwrap().trim_end().ends_with("0 0 0\n1 1 1"));
    assert!(String::from_utf8_lossy(&output.stderr).contains("mean jump"), "the summary stands aside");
    folder.ok("generate icosphere -n 80 -o ball.obj -q");
    assert!(folder.ok("sort ball.obj -o ball.xyz").contains("80 triangles are left out"));
}
