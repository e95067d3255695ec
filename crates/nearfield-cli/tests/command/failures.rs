//! Exit codes, the one line that explains them, and files that stay whole.

use std::fs;

use serde_json::Value;

use crate::{Folder, with_four};

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
        ("neighbors four.xyz --knn 0", "--knn"),
        ("neighbors four.xyz --knn -3", "-3"),
        ("neighbors four.xyz --knn many", "many"),
        ("neighbors four.xyz --knn 3 --radius -1", "radius"),
        ("neighbors four.xyz --knn 3 --max-neighbors 2", "--max-neighbors"),
        ("neighbors four.xyz --knn 3 --structure uniform-grid", "linear-octree"),
        ("neighbors four.xyz --knn 3 --picture p.png --color cell", "--radius"),
        ("neighbors four.xyz -r 1 --picture p.png --color distance", "--knn"),
        ("neighbors four.xyz -r 1 --radii radii.txt", "--radii"),
        ("neighbors - --format xyz --radii -", "standard input"),
        ("octree four.xyz --curve peano", "hilbert"),
        ("octree four.xyz --parts 0", "1..=1048576"),
        ("octree four.xyz --max-depth 22", "0..=21"),
        ("octree four.xyz --radius 1", "--parts"),
        ("octree four.xyz --parts 2 --radius -1", "radius"),
        ("octree four.xyz --parts 2 --bytes-per-point 12", "--radius"),
        ("octree four.xyz --locate 1,2", "three finite coordinates"),
        ("octree four.xyz --locate 1,2,nan", "three finite coordinates"),
        ("octree four.xyz --output tree.csv", ".npz"),
        ("octree four.xyz --output -", ".npz"),
        ("octree four.xyz --picture p.gif", ".png"),
        ("octree four.xyz --json --picture -", "standard output"),
        ("heatmap four.xyz -o p.gif", ".png"),
        ("heatmap four.xyz -o p.png --csv p.txt", ".csv"),
        ("heatmap four.xyz -o - --json", "standard output"),
        ("heatmap four.xyz -o p.png", "PLY, OBJ or STL"),
        ("heatmap four.xyz -o p.png --leaf 0", "--leaf"),
        ("heatmap four.xyz -o p.png --structure bounding-box --leaf 20", "--structure kd-tree"),
        ("heatmap four.xyz -o p.png --metric heat", "rope-steps"),
        ("heatmap four.xyz -o p.png --size 10x10", "200 to 8000"),
        ("raycast four.xyz --rays four.xyz -o p.csv", ".npz"),
        ("raycast - --format obj --rays - -o p.npz", "standard input"),
        ("raycast four.xyz -o p.npz", "--rays"),
        ("render four.xyz -o p.jpg", ".exr"),
        ("render four.xyz -o p.png", "PLY, OBJ or STL"),
        ("render four.xyz -o p.png --spp 0", "--spp"),
        ("render four.xyz -o p.png --exposure nan", "--exposure"),
        ("render four.xyz -o p.png --every 0", "--every"),
        ("render four.xyz -o p.png --structure triangle-bvh --walk stack", "--structure kd-tree"),
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
    folder.fails("neighbors four.xyz --radii nowhere.txt", 66, "nowhere.txt");
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
fn bad_radii_exit_with_65_and_say_which() {
    let folder = with_four("radii");
    for (name, content, told) in [
        ("short.txt", &b"1\n2\n3\n"[..], "3 elements, expected 4"),
        ("long.txt", b"1\n2\n3\n4\n5\n", "5 elements, expected 4"),
        ("empty.txt", b"", "0 elements, expected 4"),
        ("negative.txt", b"1\n2\n-0.5\n4\n", "negative.txt:3"),
        ("nan.txt", b"# of each\n1\nnan\n2\n3\n", "nan.txt:3"),
        ("word.txt", b"1\n2\nwide\n4\n", "word.txt:3"),
        ("two.txt", b"1 2\n3 4\n", "two.txt:1"),
        ("cut.npy", b"\x93NUMPY\x01\x00", "cut.npy"),
    ] {
        fs::write(folder.path(name), content).unwrap();
        folder.fails(&format!("neighbors four.xyz --radii {name} --device cpu"), 65, told);
        folder.fails(&format!("neighbors four.xyz --knn 2 --radii {name} --device cpu"), 65, told);
    }
}

#[test]
fn a_device_that_is_not_there_exits_with_69() {
    let folder = with_four("device");
    folder.fails("neighbors four.xyz -r 1 --device gpu:99", 69, "gpu:99");
    folder.fails("octree four.xyz --device gpu:99", 69, "gpu:99");
    folder.fails("neighbors four.xyz -r 1 --device no-such-card", 69, "no-such-card");
    // Only `auto` falls back, and says so; `cpu` has nothing to say.
    let auto = folder.json("neighbors four.xyz -r 1 --device auto --json");
    let fell_back = auto["device"].as_str().unwrap().starts_with("cpu");
    assert_eq!(fell_back, auto["notes"].to_string().contains("the CPU did the work"), "{auto}");
    assert_eq!(folder.json("neighbors four.xyz -r 1 --device cpu --json")["notes"], serde_json::json!([]));
    let auto = folder.json("octree four.xyz --device auto --json");
    let fell_back = auto["device"].as_str().unwrap().starts_with("cpu");
    assert_eq!(fell_back, auto["notes"].to_string().contains("the CPU did the work"), "{auto}");
    assert_eq!(folder.json("octree four.xyz --device cpu --json")["notes"], serde_json::json!([]));
}

#[test]
fn files_are_replaced_only_by_force_and_stay_whole() {
    let folder = with_four("atomic");
    for (name, arguments) in [
        ("rows.csv", "neighbors four.xyz -r 1 --device cpu -o rows.csv"),
        ("rows.npz", "neighbors four.xyz -r 1 --device cpu -o rows.npz"),
        ("shot.png", "neighbors four.xyz -r 1 --device cpu --picture shot.png"),
        ("tree.npz", "octree four.xyz --device cpu -o tree.npz"),
        ("cells.png", "octree four.xyz --device cpu --picture cells.png"),
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
