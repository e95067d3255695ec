//! `nearfield resample`: files, reports, pictures, devices and what is refused.

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
    folder.ok("generate torus -n 8000 --noise 0.2% -o torus.ply -q");
    folder
}

#[test]
fn a_noisy_torus_is_resampled() {
    let folder = with_torus("resample-torus");
    let told = folder
        .ok("resample torus.ply --count 1000 --radius 0.5 --iterations 12 --device cpu -o out.ply --picture out.png");
    for line in [
        "iteration",
        "mean move",
        "points      8,000",
        "samples     1,000",
        "variant     best (within ",
        "noise       some 0.00",
        "device      cpu",
    ] {
        assert!(told.contains(line), "{line} in {told}");
    }
    assert_eq!(told.lines().filter(|line| line.trim_start().starts_with(char::is_numeric)).count(), 12, "{told}");
    assert_eq!(read_cloud(&folder.path("out.ply"), None).unwrap().points.len(), 1000);
    assert!(error(&folder, "out.ply") < 0.6 * error(&folder, "torus.ply"));
    assert_eq!(png_size(&folder.path("out.png")), (1600, 900));
    folder.fails("resample torus.ply --count 500 -o out.ply", 73, "--force");
}

#[test]
fn every_variant_gives_its_report() {
    let folder = with_torus("resample-variants");
    for (variant, mu) in [("best", 0.45), ("paper", 0.45), ("authors", 0.5), ("cgal", 0.45)] {
        let found = folder.json(&format!(
            "resample torus.ply --count 400 --variant {variant} --iterations 3 --device cpu -o out.ply --force --json"
        ));
        let iterations = found["iterations"].as_array().unwrap();
        assert_eq!((found["variant"].as_str(), found["mu"].as_f64()), (Some(variant), Some(mu)), "{found}");
        assert_eq!((found["points"].as_u64(), found["samples"].as_u64()), (Some(8000), Some(400)));
        assert!(iterations.len() == 3 && iterations[0]["mean_move"].as_f64() > Some(0.001), "{found}");
        assert!(iterations[0]["mean_inputs"].as_f64() > Some(20.0), "{found}");
        // 0.2 % of the diagonal of 4.04 along the normal.
        assert!(found["noise"].as_f64().is_some_and(|noise| (0.006..0.010).contains(&noise)), "{found}");
    }
    let seeded = |seed: u32| {
        folder.ok(&format!(
            "resample torus.ply --count 50 --iterations 1 --seed {seed} --device cpu -o s.ply --force -q"
        ));
        fs::read(folder.path("s.ply")).unwrap()
    };
    assert!(seeded(1) == seeded(1) && seeded(1) != seeded(2));
}

#[test]
fn samples_on_outliers_are_told_and_dropped_and_small_radii_noted() {
    let folder = with_torus("resample-flags");
    let cloud = read_cloud(&folder.path("torus.ply"), None).unwrap();
    let mut text: String = cloud.points.iter().take(300).map(|p| format!("{} {} {}\n", p.x, p.y, p.z)).collect();
    text += "9 9 9\n";
    fs::write(folder.path("far.xyz"), text).unwrap();
    // Every point is a sample.
    let question = "resample far.xyz --count 301 --radius 0.8 --iterations 2 --device cpu";
    let told = folder.ok(&format!("{question} -o out.ply"));
    assert!(told.contains("1 no-attraction"), "{told}");
    let out = read_cloud(&folder.path("out.ply"), None).unwrap();
    let flags = out.attributes.iter().find(|attribute| attribute.name == "flags").unwrap();
    assert_eq!((flags.values.get(300), flags.values.get(0)), (Some(65.0), Some(0.0)));
    let told = folder.ok(&format!("{question} --drop-unattracted -o kept.xyz"));
    assert!(told.contains("samples     300, 1 without attraction are left out"), "{told}");
    assert_eq!(fs::read_to_string(folder.path("kept.xyz")).unwrap().lines().count(), 300);
    let told = folder.ok("resample torus.ply --count 500 --radius 0.08 --iterations 1 --device cpu -o n.ply");
    assert!(told.contains("is small for noise of some 0.00"), "{told}");
}

#[test]
fn samples_can_be_snapped() {
    let folder = with_torus("resample-snap");
    let question = "resample torus.ply --count 200 --iterations 3 --device cpu";
    let told = folder.ok(&format!("{question} --snap nearest -o near.ply"));
    assert!(told.contains("snapped     to the nearest points, by "), "{told}");
    let points = read_cloud(&folder.path("torus.ply"), None).unwrap().points;
    let near = read_cloud(&folder.path("near.ply"), None).unwrap().points;
    assert!(near.iter().all(|p| points.contains(p)));
    folder.ok("normals torus.ply --k 30 --device cpu -o oriented.ply -q");
    let found = folder.json(&format!("{} --snap apss -o on.ply --json", question.replace("torus", "oriented")));
    assert!(found["snap_mean_move"].as_f64() > Some(1e-5), "{found}");
    folder.fails(&format!("{question} --snap apss -o none.ply"), 2, "nearfield normals torus.ply");
}

#[test]
fn wrong_questions_are_told_in_one_line() {
    let folder = with_torus("resample-wrong");
    folder.fails("resample torus.ply --count 9000 -o out.ply", 2, "9000 of 8000 points");
    folder.fails("resample torus.ply --count 0 -o out.ply", 2, "--count");
    folder.fails("resample torus.ply --count 100 --radius=-1 -o out.ply", 2, "above 0");
    folder.fails("resample torus.ply --count 100 --radius far -o out.ply", 2, "far");
    folder.fails("resample torus.ply --count 100 --mu 0.9 -o out.ply", 2, "mu");
    folder.fails("resample torus.ply --count 100 --variant worst -o out.ply", 2, "worst");
    folder.fails("resample torus.ply --count 100 -o out.ply --picture out.jpg", 2, ".png");
    folder.fails("resample torus.ply --count 100 -o - --to ply --json", 2, "standard output");
    folder.fails("resample none.ply -o out.ply", 66, "none.ply");
    fs::write(folder.path("one.xyz"), "1 2 3\n").unwrap();
    folder.fails("resample one.xyz --count 1 -o out.ply", 2, "more than one place");
    assert!(!folder.path("out.ply").exists());
}

#[test]
fn the_device_gives_what_the_cpu_gives() {
    let Some(device) = gpu_or_skip("the_device_gives_what_the_cpu_gives") else { return };
    let folder = with_torus("resample-device");
    let run = |device: &str, out: &str| {
        let question = format!("resample torus.ply --count 300 --iterations 4 -o {out} --force --json");
        let output = folder.command(&question).args(["--device", device]).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(found["device"] == "cpu", device == "cpu", "{found}");
        read_cloud(&folder.path(out), None).unwrap()
    };
    let (here, there) = (run("cpu", "cpu.ply"), run(&device, "gpu.ply"));
    let far = here.points.iter().zip(&there.points).filter(|(a, b)| a.distance(**b) > 4e-5).count();
    assert!(far == 0 && here.points.len() == there.points.len(), "{far} samples differ");
}
