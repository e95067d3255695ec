//! `nearfield render`: its pictures, its notes and its inputs, on the CPU and on the GPU.

use std::fs;

use serde_json::json;

use crate::neighbors::png_pixels;
use crate::rays::{PLATES, with_plates};
use crate::{Folder, gpu_or_skip, png_size};

#[test]
fn a_mesh_is_rendered_in_a_room_the_same_for_every_structure() {
    let folder = Folder::new("render");
    folder.ok("generate icosphere -n 320 -o ball.obj -q");
    let render = "render ball.obj --size 240x200 --spp 2 --depth 4 --seed 7 --device cpu";
    let told = folder.ok(&format!("{render} -o room.png"));
    for words in ["332 triangles", "240 x 200, 2 samples a pixel, depth 4", "Msamples/s", "Mrays/s"] {
        assert!(told.contains(words), "{words}: {told}");
    }
    assert_eq!(png_size(&folder.path("room.png")), (240, 200));
    let pixels = png_pixels(&folder.path("room.png"));
    let at = |x: usize, y: usize| pixels[y * 240 + x];
    let mean = |x: usize, color: usize| (60..140).map(|y| u32::from(at(x, y)[color])).sum::<u32>();
    // The left wall is red, the right one green, and walls reach the edges of the picture.
    assert!(mean(4, 0) > 2 * mean(4, 1), "{} {}", mean(4, 0), mean(4, 1));
    assert!(2 * mean(235, 1) > 3 * mean(235, 0), "{} {}", mean(235, 0), mean(235, 1));
    for structure in ["brute-force", "kd-tree"] {
        folder.ok(&format!("{render} --structure {structure} -o {structure}.png -q"));
        let same =
            fs::read(folder.path(&format!("{structure}.png"))).unwrap() == fs::read(folder.path("room.png")).unwrap();
        assert!(same, "{structure}");
    }
    let found = folder.json(&format!("{render} --force --json -o room.png"));
    assert_eq!((&found["samples"], &found["paths"]), (&json!(2), &json!(2 * 240 * 200)));
    assert!(found["rays"].as_u64().unwrap() > 2 * 240 * 200 && found["samples_dropped"] == 0, "{found}");
}

#[test]
fn a_mesh_without_its_materials_is_grey_and_says_so() {
    let folder = with_plates("render-grey");
    let lost = format!("mtllib lost.mtl\nusemtl paint\n{PLATES}");
    fs::write(folder.path("lost.obj"), lost).unwrap();
    let render = "--size 200x200 --spp 1 --depth 1 --device cpu";
    let found = folder.json(&format!("render lost.obj {render} --json -o lost.png"));
    assert!(found["notes"].to_string().contains("lost.mtl"), "{found}");
    folder.ok(&format!("render plates.obj {render} -q -o plates.png"));
    assert_eq!(fs::read(folder.path("lost.png")).unwrap(), fs::read(folder.path("plates.png")).unwrap());
    // More light, a brighter picture.
    folder.ok(&format!("render plates.obj {render} --exposure 4 -q -o bright.png"));
    let sum = |name: &str| png_pixels(&folder.path(name)).iter().map(|p| u64::from(p[1])).sum::<u64>();
    assert!(sum("bright.png") > sum("plates.png") * 5 / 4);
}

/// A tall block of a corner at the origin: the ends of its long edges stand at 3 along the axis.
fn spike(axis: usize, sign: f32) -> String {
    // One mesh for y, its corners moved to the other axes by turns, so that each picture is that of y.
    let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [0.25, 0.0, 1.0], [0.5, 3.0, 0.5f32]];
    let turned = |[x, y, z]: [f32; 3]| match (axis, sign > 0.0) {
        (0, true) => [y, -x, z],
        (0, false) => [-y, x, z],
        (1, true) => [x, y, z],
        (1, false) => [-x, -y, z],
        (_, true) => [x, -z, y],
        (_, false) => [x, z, -y],
    };
    let lines = corners.map(turned).map(|[x, y, z]| format!("v {x} {y} {z}\n"));
    lines.concat() + "f 1 2 3\nf 1 4 2\nf 2 4 3\nf 3 4 1\n"
}

#[test]
fn any_direction_of_a_mesh_stands_up_in_the_room() {
    let folder = Folder::new("render-up");
    let render = "--size 200x200 --spp 1 --depth 1 --device cpu -q --force";
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        for (sign, up) in [(1.0, name.to_owned()), (-1.0, format!("-{name}"))] {
            fs::write(folder.path(&format!("up{up}.obj")), spike(axis, sign)).unwrap();
            folder.ok(&format!("render up{up}.obj {render} --up {up} -o up{up}.png"));
        }
    }
    let picture = |name: &str| fs::read(folder.path(name)).unwrap();
    folder.ok(&format!("render upy.obj {render} -o usual.png"));
    for name in ["x", "y", "z", "-x", "-y", "-z"] {
        assert!(picture(&format!("up{name}.png")) == picture("usual.png"), "--up {name}");
    }
    folder.ok(&format!("render upz.obj {render} -o lying.png"));
    assert!(picture("lying.png") != picture("usual.png"));
    fs::write(folder.path("scene.toml"), "[[mesh]]\nfile = \"upy.obj\"\n").unwrap();
    folder.fails("render scene.toml --up z -o out.png --device cpu", 2, "`rotate` of its [[mesh]]");
    folder.fails("render cornell-box --up y -o out.png --device cpu", 2, "--up turns a mesh");
    assert!(!folder.path("out.png").exists());
}

#[test]
fn what_is_rendered_is_held_against_the_memory_limit() {
    let folder = Folder::new("render-memory");
    folder.ok("generate icosphere -n 1280 -o ball.obj -q");
    let bytes = fs::metadata(folder.path("ball.obj")).unwrap().len();
    let scene = "[[mesh]]\nfile = \"ball.obj\"\n[[mesh]]\nfile = \"ball.obj\"\n";
    fs::write(folder.path("scene.toml"), scene).unwrap();
    let render = "--size 200x200 --spp 1 --depth 0 --device cpu -o out.png --force --max-memory";
    // The picture takes 12 bytes a pixel.
    let enough = bytes.max(12 * 200 * 200);
    folder.ok(&format!("render ball.obj {render} {enough} -q"));
    folder.fails(&format!("render ball.obj {render} {}", bytes - 1), 75, &format!("the input needs {bytes} bytes"));
    let both = 2 * bytes + scene.len() as u64;
    folder.fails(&format!("render scene.toml {render} {}", both - 1), 75, &format!("the input needs {both} bytes"));
    folder.ok(&format!("render scene.toml {render} {} -q", both.max(enough)));
}

#[test]
fn a_spectral_color_is_a_note_and_the_rest_of_its_file_is_taken() {
    let folder = with_plates("render-spectral");
    fs::write(folder.path("two.obj"), format!("mtllib first.mtl second.mtl\nusemtl paint\n{PLATES}")).unwrap();
    fs::write(folder.path("first.mtl"), "newmtl other\nKd 1 0 0\n").unwrap();
    fs::write(folder.path("second.mtl"), "newmtl paint\nKd 0.1 0.9 0.1\nKs spectral gold.rfl\n").unwrap();
    let render = "render two.obj --size 200x200 --spp 1 --depth 1 --device cpu --force -o two.png";
    let found = folder.json(&format!("{render} --json"));
    let notes = found["notes"].to_string();
    assert!(
        notes.contains("second.mtl:3: Ks spectral gold.rfl") && notes.contains("write red, green and blue"),
        "{notes}"
    );
    assert!(folder.ok(render).contains("note        second.mtl:3"));
    // The paint is the second file's green.
    let green = png_pixels(&folder.path("two.png"))
        .iter()
        .filter(|p| p[1] > 3 * p[0] / 2 + 20 && p[1] > 3 * p[2] / 2 + 20)
        .count();
    assert!(green > 2000, "{green}");
}

#[test]
fn the_scene_in_the_help_is_a_scene() {
    let folder = Folder::new("render-help");
    folder.ok("generate icosphere -n 320 -o bunny.obj -q");
    let help = folder.ok("render --help");
    let from = help.find("  [camera]").expect("the help shows a scene");
    let length = help[from..].find("\n`room").expect("the help says what follows the scene");
    let scene = &help[from..from + length];
    assert!(scene.contains("[environment]") && scene.contains("[[light]]"), "{scene}");
    fs::write(folder.path("scene.toml"), scene).unwrap();
    fs::write(folder.path("room.toml"), format!("room = true\n{scene}")).unwrap();
    for name in ["scene", "room"] {
        folder.ok(&format!("render {name}.toml --size 200x200 --spp 1 --device cpu -o {name}.png -q"));
    }
    assert!(png_pixels(&folder.path("scene.png")) != png_pixels(&folder.path("room.png")));
}

#[test]
fn light_is_written_as_floats_and_scenes_are_read() {
    let folder = Folder::new("render-exr");
    folder.ok("render cornell-box --size 200x200 --spp 1 --depth 0 --device cpu -o lamp.exr -q");
    let bytes = fs::read(folder.path("lamp.exr")).unwrap();
    assert!(bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]));
    // Without scattering there is the lamp, of radiance 17, 12, 4, and darkness.
    let floats = |value: f32| bytes.windows(4).filter(|w| *w == value.to_le_bytes()).count();
    assert!(floats(17.0) > 20 && floats(17.0) == floats(12.0), "{}", floats(17.0));
    folder.ok("generate icosphere -n 80 -o ball.obj -q");
    let scene =
        "[[mesh]]\nfile = \"ball.obj\"\nmaterial = \"mirror\"\n[[material]]\nname = \"mirror\"\nkind = \"mirror\"\n";
    fs::write(folder.path("scene.toml"), scene).unwrap();
    folder.ok("render scene.toml --size 200x200 --spp 1 --device cpu -o scene.png -q");
    // A mirror in white light from everywhere is as bright as the light.
    assert!(png_pixels(&folder.path("scene.png")).iter().filter(|p| p[0] > 240).count() > 20_000);
    fs::write(folder.path("broken.toml"), "[[mesh]]\nfile = 7\n").unwrap();
    folder.fails("render broken.toml -o out.png --device cpu", 65, "broken.toml:2");
    fs::write(folder.path("lost.toml"), "[[mesh]]\nfile = \"nowhere.obj\"\n").unwrap();
    folder.fails("render lost.toml -o out.png --device cpu", 66, "nowhere.obj");
    folder.fails("render nowhere.obj -o out.png --device cpu", 66, "nowhere.obj");
    assert!(!folder.path("out.png").exists());
}

#[test]
fn devices_render_the_picture_of_the_cpu() {
    let Some(device) = gpu_or_skip("devices_render_the_picture_of_the_cpu") else { return };
    let folder = Folder::new("render-gpu");
    folder.ok("generate icosphere -n 80 -o ball.obj -q");
    let render = "render ball.obj --size 200x200 --spp 2 --depth 2";
    folder.ok(&format!("{render} --device cpu -o cpu.png -q"));
    folder.ok(&format!("{render} --device {device} -o gpu.png -q"));
    let (cpu, gpu) = (png_pixels(&folder.path("cpu.png")), png_pixels(&folder.path("gpu.png")));
    let differ = cpu.iter().zip(&gpu).filter(|(a, b)| (0..3).any(|c| a[c].abs_diff(b[c]) > 3)).count();
    // Paths part where rounding tips a choice.
    assert!(differ * 50 < cpu.len(), "{differ} of {} pixels differ", cpu.len());
}

#[cfg(unix)]
#[test]
fn an_interrupted_picture_is_written_and_says_so() {
    let folder = Folder::new("render-interrupt");
    folder.ok("generate icosphere -n 320 -o ball.obj -q");
    let mut command =
        folder.command("render ball.obj --size 200x200 --spp 1000000 --every 0.01 --device cpu -o room.png");
    let child = command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped()).spawn().unwrap();
    // The picture is written while samples come in.
    let start = std::time::Instant::now();
    while !folder.path("room.png").exists() {
        assert!(start.elapsed().as_secs() < 120, "no picture on the way");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let id = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(130), "{stderr}");
    assert!(stderr.contains("nearfield: interrupted after ") && stderr.contains("of 1000000 samples"), "{stderr}");
    assert!(String::from_utf8_lossy(&output.stdout).contains("samples a pixel"));
    assert_eq!(png_size(&folder.path("room.png")), (200, 200));
}
