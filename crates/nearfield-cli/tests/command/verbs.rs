//! The other subcommands, standard input and output.

use std::fs;
use std::process::Stdio;

use serde_json::Value;

use crate::{FOUR, Folder, png_size};

#[test]
fn empty_clouds_and_single_points_are_no_special_case() {
    let folder = Folder::new("empty");
    folder.ok("generate uniform -n 0 -o none.ply -q");
    folder.ok("generate uniform -n 1 -o one.ply -q");
    for (file, total) in [("none.ply", 0), ("one.ply", 1)] {
        let found =
            folder.json(&format!("neighbors {file} -r 1 --device cpu --json -o {file}.csv --picture {file}.png"));
        assert_eq!(found["neighbors_total"], total, "{file}");
        assert!(folder.json(&format!("info {file} --json"))["spacing"].is_null(), "{file}");
    }
    assert_eq!(fs::read_to_string(folder.path("none.ply.csv")).unwrap(), "query,neighbor,distance\n");
}

#[test]
fn info_measures_what_is_there() {
    let folder = Folder::new("info");
    // Spacing: 1 and 1 on the first pair, 9 for the third; the fourth repeats the first.
    fs::write(folder.path("a.xyz"), "0 0 0\n1 0 0\n10 0 0\n0 0 0\n").unwrap();
    let info = folder.json("info a.xyz --json");
    assert_eq!((&info["points"], &info["duplicates"]), (&Value::from(4), &Value::from(1)));
    assert!((info["spacing"].as_f64().unwrap() - 11.0 / 3.0).abs() < 1e-6, "{info}");
    assert_eq!(info["max"], serde_json::json!([10.0, 0.0, 0.0]));
    assert_eq!((&info["diagonal"], &info["format"]), (&Value::from(10.0), &Value::from("XYZ")));
    folder.ok("generate cube -n 12 -o cube.obj -q");
    let mesh = folder.json("info cube.obj --json");
    assert_eq!(
        (&mesh["triangles"], &mesh["area"], &mesh["points"]),
        (&Value::from(12), &Value::from(6.0), &Value::from(8))
    );
    assert!(folder.ok("info cube.obj").contains("triangles   12"));
}

#[test]
fn convert_keeps_points_faces_and_map_coordinates() {
    let folder = Folder::new("convert");
    fs::write(folder.path("map.xyz"), "637000.125 5403000.25 400.5\n637001 5403001 401\n").unwrap();
    folder.ok("convert map.xyz map.ply");
    folder.ok("convert map.ply map.obj");
    folder.ok("convert map.obj map.csv");
    folder.ok("convert map.csv back.xyz");
    let back = fs::read_to_string(folder.path("back.xyz")).unwrap();
    assert!(back.contains("637000.125 5403000.25 400.5"), "{back}");
    folder.ok("generate icosphere -n 80 -o ball.ply -q");
    folder.ok("convert ball.ply ball.obj -q");
    assert_eq!(folder.json("info ball.obj --json")["triangles"], 80);
    let lossy = folder.run("convert ball.ply ball.xyz");
    assert!(lossy.status.success() && String::from_utf8_lossy(&lossy.stderr).contains("80 triangles are left out"));
    folder.ok("convert ball.ply text.ply --ascii -q");
    assert!(fs::read(folder.path("text.ply")).unwrap().starts_with(b"ply\nformat ascii 1.0"));
}

#[test]
fn a_dash_reads_standard_input_and_writes_standard_output() {
    let folder = Folder::new("dash");
    let output = folder.pipe("convert - - --format xyz --to csv --quiet", b"1 2 3\n");
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    assert!(String::from_utf8(output.stdout).unwrap().trim_end().ends_with("1,2,3"));
    let output = folder.pipe("neighbors - --format xyz -r 1 --device cpu --output -", FOUR.as_bytes());
    assert!(output.stdout.starts_with(b"query,neighbor,distance\n0,"), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("neighbours"), "the summary stands aside");
    let output = folder.pipe("info - --format xyz", b"1 2\n");
    assert_eq!(output.status.code(), Some(65));
    assert!(String::from_utf8_lossy(&output.stderr).contains("standard input:1"), "{output:?}");
}

#[test]
fn a_reader_that_has_enough_is_no_error() {
    let folder = Folder::new("pipe");
    folder.ok("generate uniform -n 20000 -o many.xyz -q");
    let mut child = folder
        .command("neighbors many.xyz -r 0.1 --device cpu -q -o -")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
}

#[test]
fn generate_gives_the_same_bytes_for_the_same_seed() {
    let folder = Folder::new("generate");
    for (name, seed) in [("a.ply", 5), ("b.ply", 5), ("c.ply", 6)] {
        folder.ok(&format!("generate clustered -n 1000 --seed {seed} -o {name} -q"));
    }
    let [a, b, c] = ["a.ply", "b.ply", "c.ply"].map(|name| fs::read(folder.path(name)).unwrap());
    assert!(a == b && a != c);
    for kind in ["uniform", "shell", "plummer", "lidar", "torus", "terrain", "all-equal", "line", "lattice"] {
        folder.ok(&format!("generate {kind} -n 1e2 -o {kind}.pcd -q"));
        assert_eq!(folder.json(&format!("info {kind}.pcd --json"))["points"], 100, "{kind}");
    }
    for kind in ["icosphere", "cube", "torus-mesh", "cornell", "soup"] {
        folder.ok(&format!("generate {kind} -n 100 -o {kind}.obj -q"));
        assert!(folder.json(&format!("info {kind}.obj --json"))["triangles"].as_u64().unwrap() > 0, "{kind}");
    }
}

#[test]
fn samples_lie_on_the_mesh_but_for_the_noise() {
    let folder = Folder::new("sample");
    folder.ok("generate cube -n 12 -o cube.obj -q");
    folder.ok("sample cube.obj -n 2000 --normals -o exact.xyz -q");
    folder.ok("sample cube.obj -n 2000 --noise 1% --seed 5 -o scan.ply -q");
    folder.ok("sample cube.obj -n 2000 --noise 1% --seed 5 -o again.ply -q");
    folder.ok("sample cube.obj -n 2000 --noise 1% --seed 6 -o other.ply -q");
    folder.ok("convert scan.ply scan.xyz -q");
    let [scan, again, other] = ["scan.ply", "again.ply", "other.ply"].map(|name| fs::read(folder.path(name)).unwrap());
    assert!(scan == again && scan != other);
    assert!(!String::from_utf8_lossy(&scan[..300]).contains("nx"), "no normals were asked for");
    let rows = |name: &str| -> Vec<Vec<f64>> {
        let text = fs::read_to_string(folder.path(name)).unwrap();
        let numbers = |line: &str| line.split_whitespace().map(|t| t.parse().unwrap()).collect();
        text.lines().filter(|line| !line.starts_with('#')).map(numbers).collect()
    };
    // The cube is 1 wide. A point is as far from its surface as the nearest of the planes of its faces.
    let info = folder.json("info cube.obj --json");
    let corner =
        |key: &str| -> Vec<f64> { info[key].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect() };
    let (low, high) = (corner("min"), corner("max"));
    let off =
        |p: &[f64]| (0..3).map(|a| (p[a] - low[a]).abs().min((p[a] - high[a]).abs())).fold(f64::INFINITY, f64::min);
    let exact = rows("exact.xyz");
    assert_eq!((exact.len(), exact[0].len()), (2000, 6), "places and normals");
    for row in &exact {
        assert!(off(row) < 1e-6, "{row:?}");
        let axis = (3..6).find(|&a| row[a].abs() > 0.999).unwrap_or_else(|| panic!("{row:?}")) - 3;
        let face = if row[axis + 3] > 0.0 { high[axis] } else { low[axis] };
        assert!((row[axis] - face).abs() < 1e-6, "normals point outwards: {row:?}");
    }
    // 1 % of the diagonal; near edges the nearest plane may be another, which makes the deviation smaller.
    let scan = rows("scan.xyz");
    let rms = (scan.iter().map(|p| off(p).powi(2)).sum::<f64>() / scan.len() as f64).sqrt();
    assert!((0.014..0.019).contains(&rms), "{rms}");
}

#[test]
fn what_cannot_be_sampled_says_why() {
    let folder = Folder::new("sample-fails");
    folder.ok("generate uniform -n 10 -o points.ply -q");
    folder.fails("sample points.ply -n 10 -o scan.ply", 65, "no triangles");
    fs::write(folder.path("flat.obj"), "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n").unwrap();
    folder.fails("sample flat.obj -n 10 -o scan.ply", 2, "without area");
    folder.ok("generate cube -n 12 -o cube.obj -q");
    folder.fails("sample cube.obj -n 10 --noise=-1 -o scan.ply", 2, "0 or more");
    folder.fails("sample cube.obj -n 10 -o scan.stl", 2, "not written");
    folder.fails("sample cube.obj -n 1e9 --max-memory 1MB -o scan.ply", 75, "samples");
    folder.fails("sample missing.obj -n 10 -o scan.ply", 66, "missing.obj");
    assert!(!folder.path("scan.ply").exists());
}

#[test]
fn devices_and_formats_are_listed() {
    let folder = Folder::new("lists");
    let devices = folder.json("devices --json");
    for (i, device) in devices.as_array().unwrap().iter().enumerate() {
        assert_eq!(device["device"], format!("gpu:{i}"));
        assert!(device["name"].is_string() && device["kind"].is_string() && device["driver"].is_string());
    }
    assert!(!folder.ok("devices").is_empty());
    let formats = folder.json("formats --json");
    let ply = formats.as_array().unwrap().iter().find(|f| f["name"] == "PLY").unwrap();
    assert!(ply["reads_mesh"] == true && ply["writes_cloud"] == true);
    assert!(folder.ok("formats").contains("LAZ"));
}

#[test]
fn help_has_an_example_for_each_subcommand() {
    let folder = Folder::new("help");
    for verb in [
        "demo",
        "neighbors",
        "octree",
        "heatmap",
        "raycast",
        "render",
        "info",
        "convert",
        "generate",
        "sample",
        "sort",
        "filter",
        "downsample",
        "cluster",
        "devices",
        "formats",
        "completions",
    ] {
        let help = folder.ok(&format!("{verb} --help"));
        assert!(help.contains("Example") && help.contains(&format!("\n  nearfield {verb}")), "{verb}: {help}");
    }
    assert!(folder.ok("--version").starts_with("nearfield "));
}

#[test]
fn completions_know_the_subcommands() {
    let folder = Folder::new("completions");
    for shell in ["bash", "zsh", "fish"] {
        let script = folder.ok(&format!("completions {shell}"));
        assert!(script.contains("neighbors") && script.contains("exclude-self"), "{shell}");
    }
}

#[test]
fn the_demo_agrees_and_may_be_repeated() {
    let folder = Folder::new("demo");
    for _ in 0..2 {
        let table = folder.ok("demo -n 3000");
        assert!(
            table.contains("all agree") && table.contains("uniform-grid") && table.contains("brute-force"),
            "{table}"
        );
        assert_eq!(png_size(&folder.path("demo.png")), (1600, 1000));
    }
    assert!(folder.ok("demo -n 1 --quiet").is_empty());
}
