//! The built command as a user runs it: every subcommand, its files, its JSON and its exit codes.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;

/// A folder of its own for each test, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("nearfield-command-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Runs the command in this folder.
    fn run(&self, arguments: &str) -> Output {
        self.command(arguments).stdin(Stdio::null()).output().unwrap()
    }

    fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_nearfield"));
        command.args(arguments.split_whitespace()).current_dir(&self.0);
        command
    }

    /// Runs the command on `input` as standard input.
    fn pipe(&self, arguments: &str, input: &[u8]) -> Output {
        let mut child = self
            .command(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        child.stdin.take().unwrap().write_all(input).unwrap();
        child.wait_with_output().unwrap()
    }

    fn ok(&self, arguments: &str) -> String {
        let output = self.run(arguments);
        assert!(output.status.success(), "{arguments}: {output:?}");
        String::from_utf8(output.stdout).unwrap()
    }

    fn json(&self, arguments: &str) -> Value {
        serde_json::from_str(&self.ok(arguments)).unwrap()
    }

    /// Runs a command that must fail with `code` and exactly one line that contains `told`.
    fn fails(&self, arguments: &str, code: i32, told: &str) {
        let output = self.run(arguments);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments}: {stderr}");
        let ours: Vec<&str> = stderr.lines().filter(|line| line.starts_with("nearfield: ")).collect();
        assert!(ours.len() == 1 && ours[0].contains(told), "{arguments}: expected {told:?} in {stderr}");
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Four points: two at distance exactly 0.5, one at 1 from the first, one far away.
const FOUR: &str = "0 0 0\n0.5 0 0\n0 1 0\n100 0 0\n";

fn with_four(name: &str) -> Folder {
    let folder = Folder::new(name);
    fs::write(folder.path("four.xyz"), FOUR).unwrap();
    folder
}

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
fn npz_arrays(bytes: &[u8]) -> Vec<(String, String, Vec<u8>)> {
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
        let kind = header.split('\'').find(|part| part.starts_with('<')).unwrap().to_owned();
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

#[test]
fn invalid_points_are_refused_or_dropped_and_said() {
    let folder = Folder::new("invalid");
    fs::write(folder.path("bad.xyz"), "0 0 0\nnan 0 0\n1 0 0\n").unwrap();
    folder.fails("neighbors bad.xyz -r 1", 65, "first at index 1");
    let found = folder.json("neighbors bad.xyz -r 1 --drop-invalid --device cpu --json");
    assert_eq!((&found["points"], &found["neighbors_total"]), (&Value::from(2), &Value::from(4)));
    assert!(found["notes"][0].as_str().unwrap().contains("1 points"), "{found}");
    assert_eq!(folder.json("info bad.xyz --json")["invalid"], 1);
}

#[test]
fn wrong_commands_exit_with_2() {
    let folder = with_four("usage");
    for (arguments, told) in [
        ("", "say what to do"),
        ("neighbors four.xyz", "--radius"),
        ("neighbors four.xyz -r wide", "0.5%"),
        ("neighbors four.xyz -r -1", "radius"),
        ("neighbors four.xyz -r nan", "radius"),
        ("neighbors four.xyz -r 1 --structure tree", "uniform-grid"),
        ("neighbors four.xyz -r 1 --device gpu:x", "gpu:N"),
        ("neighbors four.xyz -r 1 --periodic 1,2", "three lengths"),
        ("neighbors four.xyz -r 1 --output rows.doc", ".npz or .csv"),
        ("neighbors four.xyz -r 1 --picture rows.gif", ".png"),
        ("neighbors four.xyz -r 1 --picture p.png --color heat", "neighbors-of"),
        ("neighbors four.xyz -r 1 --picture p.png --color neighbors-of:4", "4 queries"),
        ("neighbors four.xyz -r 1 --queries four.xyz --exclude-self", "--exclude-self"),
        ("neighbors four.xyz -r 1 --json --output -", "standard output"),
        ("neighbors - -r 1", "--format"),
        ("convert four.xyz out.las", "LAS"),
        ("convert four.xyz out.doc", "doc"),
        ("generate blob -n 5 -o out.ply", "torus-mesh"),
        ("generate uniform -n 1.5 -o out.ply", "whole number"),
        ("info four.xyz --threads 0", "--threads"),
        ("info four.xyz --max-memory lots", "8GiB"),
        ("fly", "fly"),
    ] {
        folder.fails(arguments, 2, told);
    }
    assert!(!folder.path("out.ply").exists() && !folder.path("p.png").exists());
}

#[test]
fn missing_and_unreadable_input_exits_with_66() {
    let folder = with_four("missing");
    folder.fails("neighbors nowhere.ply -r 1", 66, "nowhere.ply");
    folder.fails("info nowhere", 66, "nowhere");
    folder.fails("neighbors four.xyz -r 1 --queries nowhere.xyz", 66, "nowhere.xyz");
    fs::create_dir(folder.path("folder.ply")).unwrap();
    folder.fails("info folder.ply", 66, "folder.ply");
}

#[test]
fn bad_files_exit_with_65_and_say_where() {
    let folder = Folder::new("bad");
    for (name, content, told) in [
        ("word.xyz", &b"1 2 3\n4 five 6\n"[..], "word.xyz:2"),
        ("empty.ply", b"", "empty"),
        ("cut.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\nend_header\n1234", "cut.ply"),
        ("noise.pcd", b"\x00\x01\x02\xff\xfe", "noise.pcd"),
        ("noise.laz", b"LASFnothing of the kind", "noise.laz"),
        ("range.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "range.obj:4"),
        ("text.npy", b"no array", "text.npy"),
        ("far.xyz", b"0 0 0\n1e19 0 0\n", "1e18"),
    ] {
        fs::write(folder.path(name), content).unwrap();
        let verb = if name == "range.obj" { "convert range.obj out.ply" } else { &format!("neighbors {name} -r 1") };
        folder.fails(verb, 65, told);
    }
    assert!(!folder.path("out.ply").exists());
}

#[test]
fn a_device_that_is_not_there_exits_with_69() {
    let folder = with_four("device");
    folder.fails("neighbors four.xyz -r 1 --device gpu:99", 69, "gpu:99");
    folder.fails("neighbors four.xyz -r 1 --device no-such-card", 69, "no-such-card");
    // Only `auto` falls back, and says so; `cpu` has nothing to say.
    let auto = folder.json("neighbors four.xyz -r 1 --device auto --json");
    let fell_back = auto["device"].as_str().unwrap().starts_with("cpu");
    assert_eq!(fell_back, auto["notes"].to_string().contains("the CPU did the work"), "{auto}");
    assert_eq!(folder.json("neighbors four.xyz -r 1 --device cpu --json")["notes"], serde_json::json!([]));
}

#[test]
fn files_are_replaced_only_by_force_and_stay_whole() {
    let folder = with_four("atomic");
    for (name, arguments) in [
        ("rows.csv", "neighbors four.xyz -r 1 --device cpu -o rows.csv"),
        ("rows.npz", "neighbors four.xyz -r 1 --device cpu -o rows.npz"),
        ("shot.png", "neighbors four.xyz -r 1 --device cpu --picture shot.png"),
        ("out.ply", "convert four.xyz out.ply"),
        ("gen.ply", "generate line -n 5 -o gen.ply"),
        ("demo.png", "demo -n 100"),
    ] {
        fs::write(folder.path(name), "old").unwrap();
        folder.fails(arguments, 73, name);
        assert_eq!(fs::read(folder.path(name)).unwrap(), b"old", "{name}");
        if name != "demo.png" {
            folder.ok(&format!("{arguments} --force"));
            assert_ne!(fs::read(folder.path(name)).unwrap(), b"old", "{name}");
        }
    }
    folder.fails("convert four.xyz no/such/folder.ply", 73, "folder.ply");
    // A failure after the file was begun leaves the old one: the mesh of the input is bad.
    fs::write(folder.path("range.obj"), "v 0 0 0\nf 1 2 3\n").unwrap();
    fs::write(folder.path("keep.ply"), "old").unwrap();
    folder.fails("convert range.obj keep.ply --force", 65, "range.obj");
    assert_eq!(fs::read(folder.path("keep.ply")).unwrap(), b"old");
    let left: Vec<_> = fs::read_dir(&folder.0).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(!left.iter().any(|name| name.to_string_lossy().contains(".tmp")), "{left:?}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_exits_with_74() {
    let folder = with_four("full");
    folder.fails("generate uniform -n 100000 --format ply -o /dev/full", 74, "/dev/full");
}

#[test]
fn too_little_memory_exits_with_75() {
    let folder = Folder::new("memory");
    fs::write(folder.path("equal.xyz"), "1 2 3\n".repeat(2000)).unwrap();
    // 2,000 equal points have 4,000,000 neighbours: 32 MB with distances.
    folder.fails("neighbors equal.xyz -r 1 --device cpu -o rows.npz --max-memory 8MB", 75, "bytes");
    assert!(!folder.path("rows.npz").exists());
    folder.fails("generate uniform -n 1e6 -o big.ply --max-memory 1MB", 75, "12000000");
    folder.fails("info equal.xyz --max-memory 1kB", 75, "12000");
    folder.ok("neighbors equal.xyz -r 1 --device cpu --max-memory 8MB");
}

/// Width and height of a PNG, after its signature is checked.
fn png_size(path: &Path) -> (u32, u32) {
    let bytes = fs::read(path).unwrap();
    assert!(bytes.starts_with(b"\x89PNG\r\n\x1a\n") && bytes.ends_with(b"IEND\xaeB`\x82"));
    let side = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
    (side(16), side(20))
}

/// Pixels of a PNG as red, green and blue.
fn png_pixels(path: &Path) -> Vec<[u8; 3]> {
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
    for verb in ["demo", "neighbors", "info", "convert", "generate", "devices", "formats", "completions"] {
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
