//! Scene files by hand: what they give, and what they are refused for.

use std::path::PathBuf;

use super::*;

const OBJ: &str = "mtllib box.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl lamp\nf 1 2 3\nusemtl glass\nf 1 2 4\n";
const MTL: &str =
    "newmtl lamp\nKd 1 1 1\nKe 5 4 3\nnewmtl glass\nd 0.1\nNi 1.3\nnewmtl metal\nKd 0 0 0\nKs 0.9 0.5 0.1\nNs 30\n";

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("nearfield-scene-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("box.obj"), OBJ).unwrap();
    std::fs::write(folder.join("box.mtl"), MTL).unwrap();
    folder
}

#[test]
fn a_scene_file_places_meshes_and_gives_them_materials() {
    let folder = folder("places");
    let text = r#"
        [camera]
        position = [0.0, 1.0, 4.0]
        target = [0.0, 0.5, 0.0]
        fov = 50.0
        [[mesh]]
        file = "box.obj"
        [[mesh]]
        file = "box.obj"
        material = "gold"
        scale = 2.0
        rotate = [0.0, 0.0, 90.0]
        translate = [10.0, 0.0, 0.0]
        [[material]]
        name = "gold"
        kind = "ggx"
        color = [1.0, 0.8, 0.3]
        metallic = 1.0
        [[light]]
        position = [0.0, 3.0, 0.0]
        intensity = [10.0, 10.0, 10.0]
    "#;
    std::fs::write(folder.join("scene.toml"), text).unwrap();
    let scene = read_scene(&folder.join("scene.toml"), 100, 100).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    let world = |v: usize| scene.mesh.origin + scene.mesh.vertices[v].as_dvec3();
    assert!((world(5) - DVec3::new(10.0, 2.0, 0.0)).length() < 1e-6, "{}", world(5));
    assert_eq!(scene.material_of, [1, 2, 0, 0]);
    assert_eq!(
        scene.materials[0].surface,
        Surface::Ggx { color: Vec3::new(1.0, 0.8, 0.3), metallic: 1.0, roughness: 0.5 }
    );
    assert_eq!((scene.materials[1].emission, scene.materials[1].two_sided), (Vec3::new(5.0, 4.0, 3.0), true));
    assert_eq!(scene.materials[2].surface, Surface::Dielectric { ior: 1.3, tint: Vec3::ONE });
    assert_eq!((scene.environment.clone(), scene.lights.len()), (Environment::NONE, 1));
    let stands = scene.mesh.origin + scene.camera.position.as_dvec3();
    assert!((stands - DVec3::new(0.0, 1.0, 4.0)).length() < 1e-6 && scene.camera.vertical_fov == 50.0);
}

#[test]
fn a_mesh_file_alone_stands_in_a_room_with_its_materials() {
    let folder = folder("room");
    let scene = read_scene(&folder.join("box.obj"), 100, 100).unwrap();
    assert_eq!((scene.mesh.triangles.len(), scene.materials.len()), (14, 6));
    assert_eq!(scene.materials[scene.material_of[0] as usize].emission, Vec3::new(5.0, 4.0, 3.0));
    std::fs::remove_file(folder.join("box.mtl")).unwrap();
    let message = read_scene(&folder.join("box.obj"), 100, 100).unwrap_err().to_string();
    assert!(message.contains("box.mtl"), "{message}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn materials_of_mtl_files_are_what_the_table_says() {
    let of = |text: &str| from_mtl::material(&crate::io::parse_mtl(text.as_bytes()).unwrap()[0]).surface;
    assert_eq!(of("newmtl a\nKd 0.5 2 0\n"), Surface::Lambert { albedo: Vec3::new(0.5, 1.0, 0.0) });
    assert_eq!(of("newmtl a\nKd 0.5\nKs 1\nillum 1\n"), Surface::Lambert { albedo: Vec3::splat(0.5) });
    assert_eq!(of("newmtl a\nKd 0\nKs 0.9\nillum 3\n"), Surface::Mirror { reflectance: Vec3::splat(0.9) });
    let Surface::Ggx { metallic: 1.0, roughness, .. } = of("newmtl a\nKd 0\nKs 0.9\nNs 30\n") else { panic!() };
    assert!((roughness - 0.5).abs() < 1e-6, "{roughness}");
    assert!(matches!(of("newmtl a\nKd 0.5\nKs 0.2\nNs 30\nillum 2\n"), Surface::Ggx { metallic: 0.0, .. }));
    assert_eq!(of("newmtl a\nTr 0.5\n"), Surface::Dielectric { ior: 1.5, tint: Vec3::ONE });
}

#[test]
fn malformed_scenes_say_where_and_what() {
    let folder = folder("bad");
    let mesh = "[[mesh]]\nfile = \"box.obj\"\n";
    for (text, words) in [
        ("[[mesh]\n".to_owned(), ["scene", ":1"]),
        (format!("{mesh}colour = 3\n"), [":3", "colour"]),
        (format!("{mesh}[[material]]\nname = \"a\"\nkind = \"plastic\"\n"), [":5", "plastic"]),
        (format!("{mesh}scale = \"big\"\n"), ["scene", ":3"]),
        (format!("{mesh}material = \"gold\"\n"), ["gold", "[[material]]"]),
        (format!("{mesh}[camera]\nposition = [0.0, 0.0, 0.0]\n"), ["position", "target"]),
        (format!("{mesh}[camera]\nfov = 190.0\n"), ["field of view", "190"]),
        (format!("{mesh}[environment]\nradiance = [-1.0, 0.0, 0.0]\n"), ["environment", "-1"]),
        (format!("{mesh}[[material]]\nname = \"a\"\nkind = \"lambert\"\nior = 2.0\n"), ["ior", "dielectric"]),
        ("[[mesh]]\nfile = \"none.ply\"\n".to_owned(), ["none.ply", "No such file"]),
        ("room = true\n".to_owned(), ["no mesh", "[[mesh]]"]),
    ] {
        let message = parse_scene(&text, &folder, 10, 10).unwrap_err().to_string();
        for word in words {
            assert!(message.contains(word), "{word:?} is not in {message:?} of {text:?}");
        }
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

/// The mean of a mesh's normals, each times its triangle's area and its place, is the volume inside: negative where the
/// outside is in.
#[test]
fn mirror_images_keep_their_outside() {
    let folder = folder("mirror");
    let ball = crate::geometry::generate::mesh(crate::geometry::generate::MeshKind::Icosphere, 80, 0);
    let corners = ball.vertices.iter().map(|v| format!("v {} {} {}\n", v.x, v.y, v.z));
    let faces = ball.triangles.iter().map(|[a, b, c]| format!("f {} {} {}\n", a + 1, b + 1, c + 1));
    std::fs::write(folder.join("ball.obj"), corners.chain(faces).collect::<String>()).unwrap();
    let volume = |scale: &str| {
        let text = format!("[[mesh]]\nfile = \"ball.obj\"\nscale = {scale}\n");
        let mesh = parse_scene(&text, &folder, 10, 10).unwrap().mesh;
        (0..mesh.triangles.len()).map(|i| mesh.triangle(i)).map(|t| t.scaled_normal().dot(t.centroid())).sum::<f32>()
            / 6.0
    };
    let [plain, mirrored, twice] = ["2.0", "[-2.0, 2.0, 2.0]", "[-2.0, -2.0, 2.0]"].map(volume);
    std::fs::remove_dir_all(&folder).unwrap();
    assert!(
        plain > 25.0 && (mirrored - plain).abs() < 0.1 && (twice - plain).abs() < 0.1,
        "{plain} {mirrored} {twice}"
    );
}
