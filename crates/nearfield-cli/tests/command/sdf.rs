//! `nearfield sdf`: fields from points and meshes, their files, pictures and what is refused.

use std::fs;

use serde_json::Value;

use crate::{Folder, png_size};

/// A sphere of points with normals.
fn sphere(folder: &Folder, name: &str, n: u32) {
    let header = format!(
        "ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\nend_header\n"
    );
    let rows: String = (0..n)
        .map(|i| {
            let z = 1.0 - f64::from(2 * i + 1) / f64::from(n);
            let (ring, angle) = ((1.0 - z * z).sqrt(), f64::from(i) * 2.399_963_229_728_653);
            let [x, y] = [ring * angle.cos(), ring * angle.sin()];
            format!("{} {} {} {x} {y} {z}\n", 2.0 * x, 2.0 * y, 2.0 * z)
        })
        .collect();
    fs::write(folder.path(name), header + &rows).unwrap();
}

/// The values of a file of raw numbers, with the number of nodes along each axis.
fn raw(folder: &Folder, name: &str) -> (Vec<f32>, [usize; 3]) {
    let bytes = fs::read(folder.path(&format!("{name}.raw"))).unwrap();
    let told: Value = serde_json::from_slice(&fs::read(folder.path(&format!("{name}.json"))).unwrap()).unwrap();
    let nodes = [0, 1, 2].map(|axis| told["nodes"][axis].as_u64().unwrap() as usize);
    (bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect(), nodes)
}

#[test]
fn points_give_a_field_in_every_format_and_a_picture() {
    let folder = Folder::new("sdf-points");
    sphere(&folder, "sphere.ply", 4000);
    let told = folder
        .ok("sdf sphere.ply --resolution 41 --device cpu -o field.vti --picture slice.png --picture-size 400x400");
    for line in ["points      4,000\n", "grid        41 × 41 × 41 nodes (68,921)", "plane, sign by normal"] {
        assert!(told.contains(line), "{line} in {told}");
    }
    assert!(fs::read(folder.path("field.vti")).unwrap().starts_with(b"<?xml"));
    let (width, height) = png_size(&folder.path("slice.png"));
    assert!(width > 400 && height > 400);
    folder.fails("sdf sphere.ply -o field.vti --resolution 41", 73, "--force");
    let options = "sdf sphere.ply --resolution 41 --device cpu --band inf --json";
    let found = folder.json(&format!("{options} -o field.raw"));
    folder.ok(&format!("{options} -o field.npz -q"));
    assert_eq!((found["points"].as_u64(), found["defined"].as_u64()), (Some(4000), Some(68_921)), "{found}");
    let (values, [nx, ny, _]) = raw(&folder, "field");
    let spacing = found["spacing"].as_f64().unwrap();
    let corner = [0, 1, 2].map(|axis| found["origin"][axis].as_f64().unwrap());
    for (i, &value) in values.iter().enumerate() {
        let node = [i % nx, i / nx % ny, i / nx / ny];
        let place = [0, 1, 2].map(|axis| corner[axis] + spacing * node[axis] as f64);
        let truth = place.iter().map(|x| x * x).sum::<f64>().sqrt() - 2.0;
        assert!((f64::from(value) - truth).abs() < 0.05, "{value}, {truth} at {place:?}");
    }
}

#[test]
fn meshes_give_exact_distances() {
    let folder = Folder::new("sdf-mesh");
    folder.ok("generate cube -n 12 -o cube.ply -q");
    let told = folder.ok("sdf cube.ply --resolution 21 -o field.npz");
    assert!(told.contains("exact, sign by pseudonormal"), "{told}");
    let found = folder.json("sdf cube.ply --resolution 21 --sign winding-number --json");
    assert_eq!((&found["sign"], &found["mode"]), (&Value::from("winding-number"), &Value::from("exact")));
    folder.fails("sdf cube.ply --mode plane", 2, "--points");
    folder.fails("sdf cube.ply --sign normal", 2, "pseudonormal or winding-number");
}

#[test]
fn what_cannot_be_computed_says_why() {
    let folder = Folder::new("sdf-refused");
    folder.ok("generate uniform -n 100 -o cloud.ply -q");
    sphere(&folder, "sphere.ply", 300);
    folder.fails("sdf cloud.ply --device cpu", 65, "100 of 100 points have no normal");
    folder.fails("sdf sphere.ply --device cpu --max-memory 100kB", 75, "distance field");
    folder.fails("sdf sphere.ply --resolution 9", 2, "9 with a band of 4 widths");
    folder.fails("sdf sphere.ply --resolution 60000", 65, "nodes of a regular grid");
    folder.fails("sdf sphere.ply -o field.ply", 2, ".vti");
    folder.fails("sdf sphere.ply --mode best", 2, "nearest, plane, imls, apss");
    folder.fails("sdf sphere.ply --sign pseudonormal --device cpu", 2, "normal or winding-number");
    folder.fails("sdf missing.ply", 66, "missing.ply");
}
