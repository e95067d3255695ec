//! `nearfield smooth`: files, reports, pictures, devices and what is refused.

use std::fs;

use nearfield::io::read_cloud;

use crate::{Folder, gpu_or_skip, png_size};

/// Root mean square distance to the torus with radii 1 and 0.4.
fn error(folder: &Folder, name: &str) -> f64 {
    let cloud = read_cloud(&folder.path(name), None).unwrap();
    let off = |p: &nearfield::Vec3| {
        let p = p.as_dvec3() + cloud.origin;
        (p.x.hypot(p.y) - 1.0).hypot(p.z) - 0.4
    };
    let squares: f64 = cloud.points.iter().map(|p| off(p).powi(2)).sum();
    (squares / cloud.points.len() as f64).sqrt()
}

fn with_torus(name: &str) -> Folder {
    let folder = Folder::new(name);
    folder.ok("generate torus -n 6000 --noise 0.3% -o torus.ply -q");
    folder
}

#[test]
fn a_noisy_torus_becomes_smooth() {
    let folder = with_torus("smooth-torus");
    let before = error(&folder, "torus.ply");
    // A deviation of 0.3 % of the diagonal of 4.04 along the normal.
    assert!((0.0115..0.0128).contains(&before), "{before}");
    let told =
        folder.ok("smooth torus.ply --method pss --radius 8x --iterations 3 --device cpu -o out.ply --picture out.png");
    for line in ["iteration", "points      6,000", "method      pss, smooth (within ", "device      cpu"] {
        assert!(told.contains(line), "{line} in {told}");
    }
    let after = error(&folder, "out.ply");
    assert!(after < 0.4 * before, "{after}");
    assert_eq!(png_size(&folder.path("out.png")), (1600, 900));
    folder.fails("smooth torus.ply --method pss -o out.ply", 73, "--force");
}

#[test]
fn every_method_and_mode_gives_its_report() {
    let folder = with_torus("smooth-methods");
    // Normals from the shape itself.
    let cloud = read_cloud(&folder.path("torus.ply"), None).unwrap();
    let line = |p: &nearfield::Vec3| {
        let axis = p.x.hypot(p.y);
        let n = (nearfield::Vec3::new(p.x - p.x / axis, p.y - p.y / axis, p.z)).normalize();
        format!("{} {} {} {} {} {}\n", p.x, p.y, p.z, n.x, n.y, n.z)
    };
    let header = "ply\nformat ascii 1.0\nelement vertex 6000\nproperty float x\nproperty float y\nproperty float z\n\
                  property float nx\nproperty float ny\nproperty float nz\nend_header\n";
    let rows: String = cloud.points.iter().map(line).collect();
    fs::write(folder.path("oriented.ply"), format!("{header}{rows}")).unwrap();
    let before = error(&folder, "oriented.ply");
    // Blended planes lie outside of a ring by a part of its curvature, which grows with the square of the radius.
    let methods =
        [("apss", 0.25), ("rimls", 0.12), ("bilateral", 0.12), ("pss --degree 3", 0.25), ("pss --full", 0.25)];
    for (method, radius) in methods {
        for mode in ["smooth", "project"] {
            let name = method.split(' ').next().unwrap();
            let found = folder.json(&format!(
                "smooth oriented.ply --method {method} --mode {mode} --radius {radius} --iterations 2 --device cpu \
                 -o out.ply --force --json"
            ));
            let iterations = found["iterations"].as_array().unwrap();
            assert_eq!((found["method"].as_str(), found["mode"].as_str()), (Some(name), Some(mode)), "{found}");
            assert_eq!((found["points"].as_u64(), found["radius"].as_f64()), (Some(6000), Some(radius)));
            assert!(iterations.len() == 2 && iterations[0]["mean_move"].as_f64() > Some(0.001), "{found}");
            assert!(found["volume_drift"].as_f64().is_some_and(|drift| drift.abs() < 0.05), "{found}");
            let after = error(&folder, "out.ply");
            assert!(after < 0.6 * before, "{method}, {mode}: {after}");
            assert!(read_cloud(&folder.path("out.ply"), None).unwrap().normals.is_some());
        }
    }
    let found =
        folder.json("smooth torus.ply --method jet --k 40 --iterations 1 --device cpu -o out.ply --force --json");
    assert_eq!((found["k"].as_u64(), found["volume_drift"].as_f64()), (Some(40), None), "{found}");
    assert!(error(&folder, "out.ply") < 0.6 * before);
}

#[test]
fn points_that_cannot_be_moved_are_flagged_in_the_output() {
    let folder = with_torus("smooth-flags");
    let mut text: String = read_cloud(&folder.path("torus.ply"), None)
        .unwrap()
        .points
        .iter()
        .map(|p| format!("{} {} {}\n", p.x, p.y, p.z))
        .collect();
    text += "9 9 9\n";
    fs::write(folder.path("far.xyz"), text).unwrap();
    let told = folder.ok("smooth far.xyz --method pss --radius 0.2 --iterations 1 --device cpu -o out.ply");
    assert!(told.contains("1 few-neighbors"), "{told}");
    let out = read_cloud(&folder.path("out.ply"), None).unwrap();
    let flags = out.attributes.iter().find(|attribute| attribute.name == "flags").unwrap();
    assert_eq!((flags.values.get(6000), flags.values.get(0)), (Some(1.0), Some(0.0)));
    let last = out.points[6000].as_dvec3() + out.origin;
    assert_eq!(last.to_array(), [9.0; 3]);
}

#[test]
fn wrong_questions_are_told_in_one_line() {
    let folder = with_torus("smooth-wrong");
    folder.fails("smooth torus.ply -o out.ply", 2, "nearfield normals torus.ply");
    folder.fails("smooth torus.ply --method pss --degree 4 -o out.ply", 2, "degree");
    folder.fails("smooth torus.ply --method jet --degree 2 -o out.ply", 2, "--method pss");
    folder.fails("smooth torus.ply --method pss --radius=-1 -o out.ply", 2, "above 0");
    folder.fails("smooth torus.ply --method pss --radius far -o out.ply", 2, "far");
    folder.fails("smooth torus.ply --method pss --radius 1 --k 9 -o out.ply", 2, "--k");
    folder.fails("smooth torus.ply --method pss -o out.ply --picture out.jpg", 2, ".png");
    folder.fails("smooth torus.ply --method pss -o - --to ply --json", 2, "standard output");
    folder.fails("smooth none.ply --method pss -o out.ply", 66, "none.ply");
    fs::write(folder.path("one.xyz"), "1 2 3\n").unwrap();
    folder.fails("smooth one.xyz --method pss -o out.ply", 2, "more than one place");
    assert!(!folder.path("out.ply").exists());
}

#[test]
fn the_device_gives_what_the_cpu_gives() {
    let Some(device) = gpu_or_skip("the_device_gives_what_the_cpu_gives") else { return };
    let folder = with_torus("smooth-device");
    for mode in ["smooth", "project"] {
        let run = |device: &str, out: &str| {
            let mut command = folder.command(&format!(
                "smooth torus.ply --method pss --mode {mode} --radius 0.2 --iterations 2 -o {out} --force --json"
            ));
            let output = command.args(["--device", device]).output().unwrap();
            assert!(output.status.success(), "{output:?}");
            let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            assert_eq!(found["device"] == "cpu", device == "cpu", "{found}");
            read_cloud(&folder.path(out), None).unwrap()
        };
        let (here, there) = (run("cpu", "cpu.ply"), run(&device, "gpu.ply"));
        let far = here.points.iter().zip(&there.points).filter(|(a, b)| a.distance(**b) > 4e-5).count();
        assert!(far <= 6 && here.points.len() == there.points.len(), "{mode}: {far} points differ");
    }
}
