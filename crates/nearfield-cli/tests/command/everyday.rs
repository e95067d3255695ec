//! `nearfield filter`, `downsample` and `cluster`: files, attributes, reports, pictures, devices and what is refused.

use std::fs;

use nearfield::PointCloud;
use nearfield::io::read_cloud;

use crate::{Folder, gpu_or_skip, png_size};

/// Two rows of points, one far away, and one that stands twice; with an attribute, a colour and a normal each.
const SCENE: &str = "0 0 0\n0.5 0 0\n1 0 0\n0 0 0\n9 0 0\n9.5 0 0\n10 0 0\n50 0 0\n";

fn with_scene(name: &str) -> Folder {
    let folder = Folder::new(name);
    let row = |(i, line): (usize, &str)| format!("{line} 0 {} 1 {} 200 {} {}\n", i % 2, 10 * i, 255 - i, 100 + i);
    let rows: String = SCENE.lines().enumerate().map(row).collect();
    let properties = "property float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\n\
                      property float nz\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
                      property ushort intensity\n";
    let header = format!("ply\nformat ascii 1.0\nelement vertex 8\n{properties}end_header\n");
    fs::write(folder.path("scene.ply"), format!("{header}{rows}")).unwrap();
    folder
}

fn read(folder: &Folder, name: &str) -> PointCloud {
    read_cloud(&folder.path(name), None).unwrap()
}

fn column(cloud: &PointCloud, name: &str) -> Vec<f64> {
    let found = cloud.attributes.iter().find(|attribute| attribute.name == name);
    let values = &found.unwrap_or_else(|| panic!("{name} should be an attribute")).values;
    (0..values.len()).map(|i| values.get(i).unwrap()).collect()
}

#[test]
fn filters_keep_the_attributes_of_the_points_that_stay() {
    let folder = with_scene("filter");
    let told = folder.ok("filter radius scene.ply --radius 0.5 --min-neighbors 1 --device cpu -o radius.ply");
    for line in
        ["points      8", "kept        7", "taken out   1 (12.50 %)", "1 or more others within 0.5", "device      cpu"]
    {
        assert!(told.contains(line), "{line} in {told}");
    }
    let kept = read(&folder, "radius.ply");
    assert_eq!(column(&kept, "intensity"), [100.0, 101.0, 102.0, 103.0, 104.0, 105.0, 106.0]);
    assert_eq!(kept.colors.as_ref().unwrap()[5][..3], [50, 200, 250]);
    assert_eq!(kept.normals.as_ref().unwrap()[5].to_array(), [0.0, 1.0, 1.0]);

    let found = folder.json("filter duplicates scene.ply --device cpu -o once.ply --json");
    assert_eq!((&found["points"], &found["kept"], &found["filter"]), (&8.into(), &7.into(), &"duplicates".into()));
    assert_eq!(column(&read(&folder, "once.ply"), "intensity"), [100.0, 101.0, 102.0, 104.0, 105.0, 106.0, 107.0]);
    folder.ok("filter duplicates scene.ply --tolerance 0.5 --device cpu -o apart.ply");
    assert_eq!(column(&read(&folder, "apart.ply"), "intensity"), [100.0, 102.0, 104.0, 106.0, 107.0]);

    let found = folder.json("filter statistical scene.ply --k 2 --ratio 1.5 --device cpu -o near.ply --json");
    assert_eq!((&found["kept"], &found["rule"]), (&7.into(), &"pcl".into()));
    assert!(found["limit"].as_f64() > found["mean"].as_f64());
    assert_eq!(column(&read(&folder, "near.ply"), "intensity").last(), Some(&106.0));
    folder.fails("filter radius scene.ply --radius 1 -o near.ply", 73, "--force");
}

#[test]
fn marked_points_all_stay() {
    let folder = with_scene("filter-mark");
    folder.ok("filter radius scene.ply --radius 0.5 --min-neighbors 2 --device cpu --mark -o marked.ply");
    let marked = read(&folder, "marked.ply");
    assert_eq!(column(&marked, "neighbors"), [2.0, 3.0, 1.0, 2.0, 1.0, 2.0, 1.0, 0.0]);
    assert_eq!(column(&marked, "kept"), [1.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
    folder.ok("filter duplicates scene.ply --tolerance 0.5 --device cpu --mark -o marked.ply --force");
    assert_eq!(column(&read(&folder, "marked.ply"), "original"), [0.0, 0.0, 2.0, 0.0, 4.0, 4.0, 6.0, 7.0]);
    folder.ok("filter statistical scene.ply --k 1 --rule open3d --device cpu --mark -o marked.ply --force");
    let marked = read(&folder, "marked.ply");
    // Of one nearest the point itself is all there is.
    assert_eq!((column(&marked, "mean_distance"), column(&marked, "kept")), (vec![0.0; 8], vec![0.0; 8]));
}

#[test]
fn cells_have_means_of_points_normals_and_colors() {
    let folder = with_scene("voxel");
    let found = folder.json("downsample voxel scene.ply --size 2 --device cpu -o few.ply --json");
    assert_eq!((&found["points"], &found["left"], &found["largest_cell"]), (&8.into(), &4.into(), &4.into()));
    let few = read(&folder, "few.ply");
    // 9 and 9.5 lie between 8 and 10, and 10 is where the next cell begins.
    assert_eq!([0, 1, 2, 3].map(|i| few.world(i).x), [0.375, 9.25, 10.0, 50.0]);
    assert_eq!(few.colors.as_ref().unwrap()[0][..3], [15, 200, 254]);
    let normal = few.normals.as_ref().unwrap()[0];
    assert!((normal.length() - 1.0).abs() < 1e-6 && normal.y > 0.1 && normal.y < 0.9, "{normal}");
    // The point nearest to the mean has the attributes.
    assert_eq!(column(&few, "intensity")[0], 101.0);
    folder.ok("downsample voxel scene.ply --size 2 --point first --device cpu -o few.ply --force");
    assert_eq!(column(&read(&folder, "few.ply"), "intensity")[0], 100.0);
    folder.ok(
        "downsample voxel scene.ply --size 2 --origin below-corner --point nearest --device cpu -o few.ply --force",
    );
    // Cells from -1 on: 0 and 0.5; 1; 9, 9.5 and 10; 50.
    assert_eq!(column(&read(&folder, "few.ply"), "intensity"), [100.0, 102.0, 105.0, 107.0]);
    // Cells begin at multiples of their size in the coordinates of the file, wherever that is.
    fs::write(folder.path("map.xyz"), "637001.5 5403001 1\n637002.5 5403001 1\n637003.5 5403001 1\n").unwrap();
    folder.ok("downsample voxel map.xyz --size 3 --origin zero --device cpu -o few.ply --force");
    let few = read(&folder, "few.ply");
    assert_eq!([0, 1].map(|i| few.world(i).x), [637_001.5, 637_003.0]);
}

#[test]
fn samples_are_as_many_as_asked_for() {
    let folder = Folder::new("samples");
    folder.ok("generate torus -n 3000 -o torus.ply -q");
    for (method, name) in [("poisson", "poisson"), ("farthest --seed 5", "farthest")] {
        let mut words = method.split(' ');
        let verb = words.next().unwrap();
        let rest: Vec<&str> = words.collect();
        let found = folder
            .json(&format!("downsample {verb} torus.ply --count 300 {} -o few.ply --force --json", rest.join(" ")));
        assert_eq!((&found["left"], &found["method"]), (&300.into(), &name.into()), "{found}");
        assert_eq!(read(&folder, "few.ply").len(), 300);
    }
    let told = folder.ok("downsample farthest torus.ply --count 1e2 -o few.ply --force");
    assert!(told.contains("left        100 (3.33 %)") && told.contains("from the last one"), "{told}");
    assert_eq!(read(&folder, "few.ply").world(0), read(&folder, "torus.ply").world(0));
    let given = folder.json("downsample poisson torus.ply --count 300 --area 15.79 -o few.ply --force --json");
    // 4 π² · 1 · 0.4 over 2 √3 · 300, the densest packing.
    assert!((given["radius"].as_f64().unwrap() - 0.123_264).abs() < 1e-4, "{given}");
}

#[test]
fn clusters_are_a_column_and_a_picture() {
    let folder = with_scene("cluster");
    let told = folder
        .ok("cluster dbscan scene.ply --eps 0.5 --min-points 3 --device cpu -o labels.ply --picture clusters.png \
         --picture-size 400x300");
    for line in ["clusters    2, the largest of 4, 3 points", "core points 4", "border      3", "noise       1"] {
        assert!(told.contains(line), "{line} in {told}");
    }
    let labelled = read(&folder, "labels.ply");
    assert_eq!(column(&labelled, "label"), [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, -1.0]);
    assert_eq!(column(&labelled, "core"), [1.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
    assert_eq!(column(&labelled, "intensity")[7], 107.0);
    assert_eq!(png_size(&folder.path("clusters.png")), (400, 300));
    let found =
        folder.json("cluster euclidean scene.ply --radius 0.5 --min-size 2 --max-size 3 --device cpu -o l.ply --json");
    assert_eq!((&found["clusters"], &found["unlabelled"]), (&1.into(), &5.into()), "{found}");
    assert_eq!((&found["too_small"]["points"], &found["too_large"]["points"]), (&1.into(), &4.into()), "{found}");
    assert_eq!(column(&read(&folder, "l.ply"), "label"), [-1.0, -1.0, -1.0, -1.0, 0.0, 0.0, 0.0, -1.0]);
    // A report alone needs no output.
    assert_eq!(folder.json("cluster dbscan scene.ply --eps 100 --device cpu --min-points 1 --json")["clusters"], 1);
}

#[test]
fn clouds_without_points_are_no_special_case() {
    let folder = Folder::new("everyday-empty");
    folder.ok("generate uniform -n 0 -o none.ply -q");
    folder.ok("generate uniform -n 1 -o one.ply -q");
    for (file, n) in [("none.ply", 0), ("one.ply", 1)] {
        for verb in ["filter statistical", "filter radius --radius 1 --min-neighbors 0", "filter duplicates"] {
            let mut words = verb.splitn(3, ' ');
            let (verb, by, rest) = (words.next().unwrap(), words.next().unwrap(), words.next().unwrap_or(""));
            let found = folder.json(&format!("{verb} {by} {file} {rest} --device cpu -o out.ply --force --json"));
            assert_eq!(found["kept"], n, "{verb} {by} {file}");
        }
        assert_eq!(folder.json(&format!("downsample voxel {file} --size 1 -o out.ply --force --json"))["left"], n);
        let found = folder.json(&format!("downsample poisson {file} --count {n} -o out.ply --force --json"));
        assert_eq!(found["left"], n);
        let found = folder.json(&format!("cluster euclidean {file} --radius 1 --device cpu --json"));
        assert_eq!(found["clusters"], n);
    }
}

#[test]
fn what_makes_no_sense_is_told_in_one_line() {
    let folder = with_scene("everyday-wrong");
    folder.fails("filter scene.ply", 2, "scene.ply");
    folder.fails("filter statistical scene.ply --k 0", 2, "--k");
    folder.fails("filter radius scene.ply --radius 0", 2, "above 0");
    folder.fails("filter duplicates scene.ply --tolerance=-1", 2, "tolerance");
    folder.fails("downsample voxel scene.ply --size 1e-9 -o out.ply", 2, "cells along x");
    folder.fails("downsample voxel scene.ply --size nan -o out.ply", 2, "nan");
    folder.fails("downsample poisson scene.ply --count 9 -o out.ply", 2, "9 of 8 points");
    folder.fails("downsample farthest scene.ply --count 2 --start 8 -o out.ply", 2, "first sample");
    folder.fails("cluster dbscan scene.ply --eps 0", 2, "above 0");
    folder.fails("cluster dbscan scene.ply --eps 1 --min-points 0", 2, "--min-points");
    folder.fails("cluster euclidean scene.ply --radius 1 --min-size 5 --max-size 4", 2, "max_size");
    folder.fails("cluster dbscan scene.ply --eps 1 --picture out.jpg", 2, ".png");
    folder.fails("cluster dbscan scene.ply --eps 1 -o - --to ply --json", 2, "standard output");
    folder.fails("cluster dbscan none.ply --eps 1", 66, "none.ply");
    fs::write(folder.path("nan.xyz"), "0 0 0\nnan 0 0\n").unwrap();
    folder.fails("filter duplicates nan.xyz --device cpu", 65, "--drop-invalid");
    let told = folder.ok("filter duplicates nan.xyz --drop-invalid --device cpu");
    assert!(told.contains("1 points with NaN"), "{told}");
    assert!(!folder.path("out.ply").exists());
}

#[test]
fn everyday_tasks_on_the_device_are_those_of_the_cpu() {
    let Some(device) = gpu_or_skip("everyday_tasks_on_the_device_are_those_of_the_cpu") else { return };
    let folder = Folder::new("everyday-device");
    folder.ok("generate clustered -n 4000 -o cloud.ply -q");
    for (task, name) in [
        ("cluster dbscan cloud.ply --eps 2% --min-points 5", "label"),
        ("cluster euclidean cloud.ply --radius 2% --min-size 10", "label"),
        ("filter radius cloud.ply --radius 2% --min-neighbors 4 --mark", "kept"),
        ("filter statistical cloud.ply --mark", "kept"),
        ("filter duplicates cloud.ply --tolerance 1% --mark", "original"),
        ("filter duplicates cloud.ply --mark", "original"),
    ] {
        let run = |device: &str, out: &str| {
            let mut command = folder.command(&format!("{task} -o {out} --force --json"));
            let output = command.args(["--device", device]).output().unwrap();
            assert!(output.status.success(), "{task}: {output:?}");
            let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            assert_eq!(found["device"] == "cpu", device == "cpu", "{found}");
            column(&read(&folder, out), name)
        };
        assert_eq!(run("cpu", "cpu.ply"), run(&device, "gpu.ply"), "{task}");
    }
    let points = |by: &str, device: &str| {
        let mut command = folder.command(&format!("downsample {by} -o few.ply --force"));
        assert!(command.args(["--device", device]).output().unwrap().status.success());
        read(&folder, "few.ply").points
    };
    let farthest = |device: &str| points("farthest cloud.ply --count 200 --seed 3", device);
    assert_eq!(farthest("cpu"), farthest(&device));
    let voxels = |device: &str| points("voxel cloud.ply --size 2%", device);
    let (here, there) = (voxels("cpu"), voxels(&device));
    assert_eq!(here.len(), there.len());
    assert!(here.iter().zip(&there).all(|(a, b)| a.distance(*b) < 1e-6));
}
