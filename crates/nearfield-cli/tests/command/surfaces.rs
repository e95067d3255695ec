//! `mesh` and `offset`: surfaces of meshes, points and fields, their files and what is said of them.

use crate::{Folder, gpu_or_skip, png_size};

fn with_ball(name: &str) -> Folder {
    let folder = Folder::new(name);
    folder.ok("generate icosphere -n 5000 -o ball.ply");
    folder
}

#[test]
fn a_mesh_is_made_anew_and_is_closed() {
    let folder = with_ball("mesh-anew");
    let told = folder.json("mesh ball.ply --resolution 33 --device cpu -o new.ply --json");
    assert_eq!((&told["closed"], &told["manifold"], &told["oriented"]), (&true.into(), &true.into(), &true.into()));
    assert_eq!(
        (&told["euler_number"], &told["components"], &told["intersections_left"]),
        (&2.into(), &1.into(), &0.into())
    );
    let again = folder.json("info new.ply --json");
    assert!(again.to_string().contains(&told["vertices"].to_string()), "{again}");
    let text = folder.ok("mesh ball.ply --resolution 33 --device cpu -o new.ply --force");
    assert!(text.contains("closed, 1 components, Euler number 2"), "{text}");
}

#[test]
fn a_field_gives_the_surface_of_its_points() {
    let folder = with_ball("mesh-field");
    folder.ok("sdf ball.ply --resolution 33 --device cpu -o field.vti");
    let direct = folder.json("mesh ball.ply --resolution 33 --device cpu -o direct.ply --json");
    let told = folder.json("mesh field.vti --device cpu -o from.ply --json");
    assert_eq!(direct["vertices"], told["vertices"]);
    assert_eq!(std::fs::read(folder.path("direct.ply")).unwrap(), std::fs::read(folder.path("from.ply")).unwrap());
}

#[test]
fn offsets_grow_and_shrink_and_end_with_a_message() {
    let folder = with_ball("offset");
    let told = folder.json("offset ball.ply --distance 20% --resolution 33 --device cpu -o grown.ply --json");
    assert!(told["closed"] == true && told["euler_number"] == 2, "{told}");
    let told = folder.json("offset ball.ply --distance=-20% --resolution 33 --device cpu -o shrunk.ply --json");
    assert!(told["closed"] == true && told["offset"].as_f64().unwrap() < 0.0, "{told}");
    folder.fails(
        "offset ball.ply --distance=-40% --resolution 33 --device cpu -o none.ply",
        2,
        "leaves nothing of a body",
    );
    folder.fails("offset ball.ply --distance 0 --resolution 33 --device cpu -o none.ply", 2, "not 0");
    folder.fails("offset ball.ply --distance far -o none.ply", 2, "expected a length");
    assert!(!folder.path("none.ply").exists());
}

#[test]
fn pictures_are_rendered() {
    let folder = with_ball("mesh-picture");
    folder.ok("mesh ball.ply --resolution 20 --device cpu -o new.ply --picture new.png --picture-size 220x200");
    assert_eq!(png_size(&folder.path("new.png")), (220, 200));
}

#[test]
fn what_cannot_be_meshed_says_why() {
    let folder = with_ball("mesh-fails");
    std::fs::write(folder.path("bare.xyz"), "0 0 0\n1 0 0\n0 1 0\n").unwrap();
    folder.fails("mesh bare.xyz --device cpu -o new.ply", 65, "normals");
    folder.fails("mesh ball.ply --resolution 5 -o new.ply", 2, "resolution");
    folder.fails("mesh ball.ply -o new.las", 2, "not written for meshes");
    folder.fails("mesh ball.ply -o new.ply --picture new.jpg", 2, ".png");
    folder.fails("mesh ball.ply --threshold 2 --resolution 20 --device cpu -o new.ply", 2, "eigenvalue threshold");
    folder.fails("mesh missing.vti -o new.ply", 66, "missing.vti");
}

#[test]
fn the_device_gives_the_mesh_of_the_cpu() {
    let Some(device) = gpu_or_skip("the_device_gives_the_mesh_of_the_cpu") else { return };
    let folder = with_ball("mesh-device");
    folder.ok("normals ball.ply --device cpu -o points.ply");
    let here = folder.json("mesh points.ply --resolution 33 --device cpu -o here.ply --json");
    let there = folder.json(&format!("mesh points.ply --resolution 33 --device {device} -o there.ply --json"));
    for key in ["vertices", "mesh_triangles", "closed", "euler_number"] {
        assert_eq!(here[key], there[key], "{key}");
    }
}
