//! `nearfield normals`: files, flags, sides, devices and what is refused.

use std::fs;

use nearfield::geometry::{Column, PointCloud};
use nearfield::io::read_cloud;

use crate::{Folder, gpu_or_skip, png_size};

fn cloud(folder: &Folder, name: &str) -> PointCloud {
    read_cloud(&folder.path(name), None).unwrap()
}

fn attribute<'a>(cloud: &'a PointCloud, name: &str) -> Option<&'a Column> {
    cloud.attributes.iter().find(|attribute| attribute.name == name).map(|attribute| &attribute.values)
}

/// Points of the unit sphere's surface, and a number for each.
fn ball(folder: &Folder) {
    let row = |i: u32| {
        let z = 1.0 - (f64::from(i) + 0.5) / 1000.0;
        let (r, angle) = ((1.0 - z * z).sqrt(), f64::from(i) * 2.399_963);
        format!("{},{},{},{}\n", 5.0 + r * angle.cos(), r * angle.sin(), z, i % 7)
    };
    let rows: String = (0..2000).map(row).collect();
    fs::write(folder.path("ball.csv"), format!("x,y,z,kind\n{rows}")).unwrap();
}

/// The part of the normals that point away from (5, 0, 0), within some degrees.
fn outward(cloud: &PointCloud) -> f64 {
    let normals = cloud.normals.as_ref().unwrap();
    let is_outward = |i: &usize| {
        let out = (cloud.world(*i) - glam::DVec3::new(5.0, 0.0, 0.0)).normalize();
        out.dot(normals[*i].as_dvec3()) > 0.99
    };
    (0..cloud.len()).filter(is_outward).count() as f64 / cloud.len() as f64
}

#[test]
fn every_orientation_and_method_gives_normals_of_a_ball() {
    let folder = Folder::new("normals-ball");
    ball(&folder);
    for method in ["pca", "jet", "jet --weighted", "pca --radius 6x", "pca --radius 10% --k 24"] {
        if method.contains("--radius") && method.contains("--k") {
            folder.fails(&format!("normals ball.csv --method {method} --device cpu"), 2, "cannot be used with");
            continue;
        }
        for (orient, expected) in
            [("spanning-tree", 1.0), ("winding-number", 1.0), ("viewpoint:5,0,0", 0.0), ("viewpoint:500,0,0", 0.5)]
        {
            let told = folder.json(&format!(
                "normals ball.csv --method {method} --orient {orient} --device cpu -o ball.ply --force --json"
            ));
            assert_eq!((told["points"].as_u64(), told["flagged"].as_u64()), (Some(2000), Some(0)), "{told}");
            let made = cloud(&folder, "ball.ply");
            let found = outward(&made);
            assert!((found - expected).abs() < 0.05, "{method} {orient}: {found}");
            assert!(attribute(&made, "kind").is_some() && attribute(&made, "flags").is_none());
            assert_eq!(attribute(&made, "curvature_max").is_some(), method.starts_with("jet"));
            assert_eq!(attribute(&made, "surface_variation").map(Column::len), Some(2000));
        }
    }
}

#[test]
fn the_summary_names_parts_flags_and_times() {
    let folder = Folder::new("normals-summary");
    ball(&folder);
    let told = folder.ok("normals ball.csv --device cpu -o out.ply --picture out.png --picture-size 640x480");
    for line in ["points      2,000\n", "pca from 24 nearest points", "flagged     0;", "1 parts", "orient "] {
        assert!(told.contains(line), "{line} in {told}");
    }
    assert_eq!(png_size(&folder.path("out.png")), (640, 480));
    folder.fails("normals ball.csv --device cpu -o out.ply", 73, "--force");
    // Three points apart from the rest have few neighbours, and those in a row no plane.
    let row: String = (0..9).map(|i| format!("{} 0 0\n", 100 + i)).collect();
    fs::write(folder.path("row.xyz"), format!("0 0 0\n0 0.5 0\n{row}")).unwrap();
    let told = folder.json("normals row.xyz --radius 3 --device cpu -o row.ply --json");
    assert_eq!((told["flagged"].as_u64(), told["without_normal"].as_u64()), (Some(11), Some(11)), "{told}");
    assert_eq!(told["flags"]["few-neighbors"].as_u64(), Some(2));
    assert_eq!(told["flags"]["degenerate"].as_u64(), Some(9));
    let flags: Vec<f64> =
        (0..11).map(|i| attribute(&cloud(&folder, "row.ply"), "flags").unwrap().get(i).unwrap()).collect();
    assert_eq!(flags, [1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0]);
}

#[test]
fn devices_agree() {
    let Some(device) = gpu_or_skip("devices_agree_on_normals") else { return };
    let folder = Folder::new("normals-devices");
    ball(&folder);
    for method in ["pca", "jet --radius 6x"] {
        let told =
            folder.json(&format!("normals ball.csv --method {method} --device {device} -o gpu.ply --force --json"));
        assert!(!told["device"].as_str().unwrap().starts_with("cpu"), "{told}");
        folder.ok(&format!("normals ball.csv --method {method} --device cpu -o cpu.ply --force"));
        let [here, there] = ["cpu.ply", "gpu.ply"].map(|name| cloud(&folder, name).normals.unwrap());
        let most = here.iter().zip(&there).map(|(a, b)| (*a - *b).length()).fold(0.0, f32::max);
        assert!(most < 1e-3, "{method}: {most}");
    }
}

#[test]
fn wrong_uses_are_refused() {
    let folder = Folder::new("normals-refused");
    fs::write(folder.path("bad.xyz"), "0 0 0\nnan 0 0\n1 1 1\n").unwrap();
    fs::write(folder.path("empty.xyz"), "").unwrap();
    folder.fails("normals bad.xyz --device cpu", 65, "NaN");
    assert!(folder.ok("normals bad.xyz --drop-invalid --device cpu").contains("few-neighbors 2"));
    folder.fails("normals bad.xyz --k 2 --device cpu", 2, "at least 3");
    folder.fails("normals bad.xyz --k 5 --method jet --device cpu", 2, "at least 3 by PCA and 6 by the jet");
    folder.fails("normals bad.xyz --radius 0 --drop-invalid --device cpu", 2, "radius");
    folder.fails("normals bad.xyz --radius wide --device cpu", 2, "is no length");
    folder.fails("normals bad.xyz --orient up --device cpu", 2, "viewpoint:X,Y,Z");
    folder.fails("normals bad.xyz --orient viewpoint:1,2 --device cpu", 2, "three finite coordinates");
    folder.fails("normals bad.xyz -o out.las --device cpu", 2, "not written");
    folder.fails("normals bad.xyz --picture out.jpg --device cpu", 2, ".png");
    folder.fails("normals bad.xyz -o - --to ply --json", 2, "standard output");
    folder.fails("normals missing.xyz", 66, "missing.xyz");
    folder.fails("normals empty.xyz --device cpu", 65, "empty file");
}
