//! `nearfield simulate` and `nearfield surface`: frames, films, measures, checkpoints and what is refused.

use std::fs;

use crate::{Folder, png_size};

/// Few grains, small pictures.
const GRAINS: &str = "simulate dem-box --particles 200 --device cpu --size 240x200";

#[test]
fn frames_measures_and_a_checkpoint_are_written() {
    let folder = Folder::new("simulate");
    let told = folder.json(&format!("{GRAINS} --steps 25 --vtp --ply --video --json -o out"));
    assert_eq!((&told["scene"], &told["model"], &told["particles"]), (&"dem-box".into(), &"dem".into(), &200.into()));
    // One frame every ten steps, at the start and at the end.
    assert_eq!((&told["steps"], &told["step"], &told["frames"]), (&25.into(), &25.into(), &4.into()));
    assert!(
        told["steps_per_second"].as_f64().unwrap() > 0.0 && told["mean_neighbors"].as_f64().unwrap() > 1.0,
        "{told}"
    );
    assert_eq!(told["end"]["outside"], 0);
    for frame in ["00000", "00001", "00002", "00003"] {
        let path = |extension: &str| folder.path(&format!("out/frame-{frame}.{extension}"));
        assert_eq!(png_size(&path("png")), (240, 200));
        assert!(path("vtp").exists() && path("ply").exists(), "{frame}");
    }
    assert!(!folder.path("out/frame-00004.png").exists());
    let measures = fs::read_to_string(folder.path("out/measures.csv")).unwrap();
    let steps: Vec<&str> = measures.lines().map(|line| line.split(',').next().unwrap()).collect();
    assert_eq!(steps, ["step", "0", "10", "20", "25"]);
    let columns = measures.lines().next().unwrap().split(',').count();
    assert!(measures.lines().all(|line| line.split(',').count() == columns), "{measures}");
    // An animated PNG, half as large, with all pictures.
    let film = fs::read(folder.path("out/film.png")).unwrap();
    assert_eq!(png_size(&folder.path("out/film.png")), (120, 100));
    let at = film.windows(4).position(|bytes| bytes == b"acTL").unwrap();
    assert_eq!(film[at + 4..at + 8], 4u32.to_be_bytes());
    // The particles of a frame as another reader of the library sees them.
    assert_eq!(folder.json("info out/frame-00003.ply --json")["points"], 200);

    let told = folder.ok(&format!("{GRAINS} --steps 2 -o told"));
    for words in ["dem-box, dem, 200 particles", "neighbours by uniform-grid", "energy", "momentum", "measures.csv"] {
        assert!(told.contains(words), "{words}: {told}");
    }
}

#[test]
fn a_simulation_goes_on_from_its_checkpoint() {
    let folder = Folder::new("simulate-resume");
    let grains = format!("{GRAINS} --reorder-every 7 -q");
    folder.ok(&format!("{grains} --steps 40 -o whole"));
    folder.ok(&format!("{grains} --steps 24 -o parts"));
    folder.ok(&format!("{grains} --steps 40 --resume parts/checkpoint.npz -o parts"));
    let read = |name: &str| fs::read(folder.path(name)).unwrap();
    assert!(read("whole/checkpoint.npz") == read("parts/checkpoint.npz"));
    for frame in ["00002", "00003", "00004"] {
        assert!(read(&format!("whole/frame-{frame}.png")) == read(&format!("parts/frame-{frame}.png")), "{frame}");
    }
    let steps = |name: &str| -> Vec<String> {
        let text = fs::read_to_string(folder.path(name)).unwrap();
        text.lines().skip(1).map(|line| line.split(',').next().unwrap().to_owned()).collect()
    };
    assert_eq!(steps("whole/measures.csv"), ["0", "10", "20", "30", "40"]);
    // The end of the first part has a row of its own.
    assert_eq!(steps("parts/measures.csv"), ["0", "10", "20", "24", "30", "40"]);
    let other = "simulate dem-box --particles 100 --device cpu --size 240x200 --steps 50";
    folder.fails(&format!("{other} --resume whole/checkpoint.npz -o other"), 65, "particles to go on from");
}

#[test]
fn a_simulation_that_blows_up_keeps_the_last_good_state() {
    let folder = Folder::new("simulate-blow-up");
    // After step 1 all fall at 0.00015.
    folder.fails(&format!("{GRAINS} --steps 30 --max-speed 0.001 -o out"), 65, "checkpoint.npz");
    assert!(folder.path("out/checkpoint.npz").exists());
    // A row of the start, and one of the last sound step, which is no frame.
    let measures = fs::read_to_string(folder.path("out/measures.csv")).unwrap();
    let rows: Vec<Vec<&str>> = measures.lines().map(|line| line.split(',').collect()).collect();
    let step: u64 = rows[2][0].parse().unwrap();
    assert!(rows.len() == 3 && rows[1][0] == "0" && (1..10).contains(&step), "{measures}");
    assert!(rows[2].len() == rows[0].len() && rows[2][2] == "5e-1", "{measures}");
    assert!(!folder.path("out/frame-00001.png").exists());
    folder.ok(&format!("{GRAINS} --steps 12 --resume out/checkpoint.npz -o out -q"));
}

#[test]
fn scene_files_are_simulated_and_wrong_ones_name_their_line() {
    let folder = Folder::new("simulate-scene");
    let text = "domain = { low = [0, 0, 0], high = [1, 1, 1] }\ntime_step = 0.002\n[model]\nkind = 'pbf'\nspacing = 0.1\n\
                [[box]]\nlow = [0, 0, 0]\nhigh = [0.5, 0.5, 1.0]\n[[wall]]\nlow = [0, 0, 0]\nhigh = [1, 1, 1]\n";
    fs::write(folder.path("tank.toml"), text).unwrap();
    let small = "--device cpu --size 240x200";
    let told =
        folder.json(&format!("simulate tank.toml --seconds 0.01 {small} --color density --ply --vtp --json -o out"));
    assert_eq!((&told["scene"], &told["particles"], &told["boundary"]), (&"tank".into(), &250.into(), &728.into()));
    assert_eq!(told["step"], 5);
    folder.ok("surface out/frame-00001.ply --spacing 0.1 -o water.ply -q");
    folder.ok("surface out/frame-00001.vtp --spacing 0.1 -o same.ply -q");
    assert!(fs::read(folder.path("same.ply")).unwrap() == fs::read(folder.path("water.ply")).unwrap());
    fs::write(folder.path("cut.vtp"), &fs::read(folder.path("out/frame-00001.vtp")).unwrap()[..2000]).unwrap();
    folder.fails("surface cut.vtp --spacing 0.1 -o cut.ply", 65, "cut.vtp");
    let surface = folder.json("surface out/checkpoint.npz --spacing 0.1 --json -o water.obj");
    assert_eq!((&surface["closed"], &surface["euler_number"]), (&true.into(), &2.into()));
    assert_eq!(surface["particles"], 250);

    fs::write(folder.path("wrong.toml"), text.replace("spacing", "spcing")).unwrap();
    folder.fails(&format!("simulate wrong.toml {small} -o wrong"), 65, "wrong.toml:5:");
    folder.fails(&format!("simulate none.toml {small} -o wrong"), 66, "none.toml");
    folder.fails(&format!("simulate tank.toml {small} --particles 10 -o wrong"), 2, "--particles");
    folder.fails(&format!("simulate ocean {small} -o wrong"), 2, "dam-break");
    assert!(!folder.path("wrong").exists());
}

#[test]
fn options_that_make_no_sense_are_refused() {
    let folder = Folder::new("simulate-options");
    folder.ok(&format!("{GRAINS} --steps 1 -q -o out"));
    folder.fails(&format!("{GRAINS} --steps 1 -o out"), 73, "--force");
    folder.ok(&format!("{GRAINS} --steps 1 -q --force -o out"));
    for (options, told) in [
        ("--steps 3 --seconds 1", "--seconds"),
        ("--seconds 0", "--seconds 0"),
        ("--seconds nan", "--seconds"),
        ("--frames-per-second -1", "--frames-per-second"),
        ("--model pbf", "model"),
        ("--search octree", "search"),
        ("--search uniform-grid:0", "1/64"),
        ("--pair-rule touch", "contact, symmetric or gather"),
        ("--color density", "densities"),
        ("--max-speed 0", "largest speed"),
    ] {
        folder.fails(&format!("{GRAINS} {options} -o other"), 2, told);
    }
    folder.fails("surface none.ply -o mesh.ply", 66, "none.ply");
}
