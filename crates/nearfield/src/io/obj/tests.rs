//! OBJ as programs write it, the real files, and the errors for what nobody should write.

use glam::{DVec3, Vec3};

use super::{read_cloud, write_cloud, write_mesh};
use crate::io::Polygons;
use crate::io::test_data::real_file;
use crate::{Error, PointCloud, Result, TriMesh};

/// Polygons as fans.
fn read_mesh(bytes: &[u8]) -> Result<TriMesh> {
    super::read_mesh(bytes, Polygons::Fans)
}

fn message(bytes: &[u8]) -> String {
    match read_mesh(bytes) {
        Err(error @ Error::File(_)) => error.to_string(),
        other => panic!("expected a file error, got {other:?}"),
    }
}

#[test]
fn polygons_become_fans_over_all_vertices_whatever_the_material_file() {
    let text = b"# a quad, a triangle and a vertex no face uses\nmtllib not-there.mtl\no thing\n\
        v 0 0 0\r\nv 1 0 0\nv 1 1 0 # corner\nv 0 1 0\nv 9 9 9\nvt 0 0\nusemtl missing\ns off\n\
        f 1/1 2/1 3/1 4/1\nf -5 -4 \\\n -3\n";
    let mesh = read_mesh(text).unwrap();
    assert_eq!(mesh.vertices.len(), 5);
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
    assert_eq!(read_cloud(text).unwrap().len(), 5);
}

#[test]
fn of_polygons_the_first_three_corners_may_be_taken_and_all_are_checked() {
    let text = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 2 0\nf 1 2 3 4 5\nf 2 3 4\n";
    let mesh = super::read_mesh(text, Polygons::FirstThree).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2], [1, 2, 3]]);
    let beyond = super::read_mesh(b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3 4\n", Polygons::FirstThree);
    assert!(beyond.unwrap_err().to_string().contains("vertex index 4"));
    if let Some(bytes) = real_file("accel-bunny-b.obj") {
        assert_eq!(super::read_mesh(&bytes, Polygons::FirstThree).unwrap().triangles.len(), 29_808);
    }
}

#[test]
fn a_face_may_name_vertices_that_come_later() {
    let mesh = read_mesh(b"f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0\n").unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
}

#[test]
fn normals_are_kept_where_every_vertex_has_exactly_one() {
    let shared = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nvn 0 0 1\nf 1//1 2//2 3//-1\n";
    assert_eq!(read_mesh(shared).unwrap().normals, Some(vec![Vec3::Z; 3]));
    let split = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nvn 1 0 0\nf 1//1 2//1 3//1\nf 1//2 2//1 3//1\n";
    assert_eq!(read_mesh(split).unwrap().normals, None);
    let some = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3\n";
    assert_eq!(read_mesh(some).unwrap().normals, None);
    let cloud = b"v 0 0 0\nvn 0 0 1\nv 1 0 0\nvn 1 0 0\n";
    assert_eq!(read_cloud(cloud).unwrap().normals, Some(vec![Vec3::Z, Vec3::X]));
}

#[test]
fn colours_are_kept_where_every_vertex_has_one() {
    let all = b"v 0 0 0 1 0.5 0\nv 1 0 0 0 0 1\n";
    assert_eq!(read_cloud(all).unwrap().colors, Some(vec![[255, 128, 0, 255], [0, 0, 255, 255]]));
    let some = b"v 0 0 0\nv 1 0 0 0 0 1\n";
    assert_eq!(read_cloud(some).unwrap().colors, None);
}

#[test]
fn errors_name_the_line_what_was_found_and_what_was_expected() {
    let cases: [(&[u8], &[&str]); 10] = [
        (b"", &["an empty file"]),
        (b"o nothing\n", &["no vertices"]),
        (b"v 0 0 0\n", &["no faces"]),
        (b"v 0 0\n", &[":1:", "a vertex of 2 numbers"]),
        (b"v 0 zero 0\n", &[":1:", "\"zero\"", "a number for y"]),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", &[":4:", "a face of 2 corners"]),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 4\n", &[":5:", "vertex index 4", "at most 3"]),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n", &[":4:", "\"-4\"", "back to -3"]),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", &[":4:", "\"0\"", "from 1"]),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//7 3//1\n", &[":5:", "normal index 7", "at most 1"]),
    ];
    for (bytes, parts) in cases {
        let message = message(bytes);
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    }
}

#[test]
fn what_is_written_reads_back_equal() {
    let world: Vec<DVec3> =
        (0..50).map(|i| DVec3::new(637_000.001 + f64::from(i), 5_403_059.123_4, f64::from(i) / 7.0)).collect();
    let mut cloud = PointCloud::from_world(&world);
    cloud.normals = Some((0..50).map(|i| Vec3::new(1.0 / 3.0, i as f32, -0.1)).collect());
    cloud.colors = Some((0..50).map(|i| [5 * i as u8, 1, 2, 255]).collect());
    let mut bytes = vec![];
    write_cloud(&cloud, &mut bytes).unwrap();
    assert_eq!(read_cloud(&bytes).unwrap(), cloud);

    let triangles = (0..48).map(|i| [i, i + 1, i + 2]).collect();
    let PointCloud { origin, points: vertices, normals, colors, .. } = cloud;
    let mesh = TriMesh { origin, vertices, triangles, normals, colors };
    let mut bytes = vec![];
    write_mesh(&mesh, &mut bytes).unwrap();
    assert_eq!(read_mesh(&bytes).unwrap(), mesh);
}

#[test]
fn a_file_cut_anywhere_is_read_or_refused_without_a_panic() {
    let seed = b"v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nvn 0 0 1\nf 1//1 2//1 3//1\nf -3//-1 -2//1 -1//1\n";
    for end in 0..seed.len() {
        match read_mesh(&seed[..end]) {
            Ok(mesh) => assert!(mesh.vertices.len() == 3 && mesh.triangles.len() <= 2, "cut at {end}"),
            Err(error) => assert!(matches!(error, Error::File(_)), "cut at {end}: {error}"),
        }
    }
}

#[test]
fn the_real_meshes_have_the_counts_their_readme_says() {
    let files = [
        ("stanford-bunny.obj", 35_947, 69_451),
        ("nefertiti.obj", 49_971, 99_938),
        ("fandisk.obj", 6_475, 12_946),
        ("spot.obj", 2_930, 5_856),
        ("accel-bunny-a.obj", 2_503, 4_968),
        ("accel-bunny-b.obj", 29_888, 59_616),
        ("accel-bunny-c.obj", 1_251, 2_465),
    ];
    for (name, n_vertices, n_triangles) in files {
        let Some(bytes) = real_file(name) else { continue };
        let mesh = read_mesh(&bytes).unwrap();
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (n_vertices, n_triangles), "{name}");
        assert_eq!(read_cloud(&bytes).unwrap().len(), n_vertices, "{name}");
    }
}

#[test]
fn the_triangles_of_the_bunny_are_those_of_tobj() {
    let Some(bytes) = real_file("stanford-bunny.obj") else { return };
    let options = tobj::LoadOptions { triangulate: true, ..tobj::LoadOptions::default() };
    let no_material = |_: &std::path::Path| Ok((vec![], Default::default()));
    let (models, _) = tobj::load_obj_buf(&mut &bytes[..], &options, no_material).unwrap();
    let mut theirs = models.iter().flat_map(|model| {
        let mesh = &model.mesh;
        mesh.indices.iter().map(|&i| [0, 1, 2].map(|axis| mesh.positions[3 * i as usize + axis]))
    });
    let mesh = read_mesh(&bytes).unwrap();
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        for &vertex in triangle {
            let ours = (mesh.origin + mesh.vertices[vertex as usize].as_dvec3()).as_vec3();
            let theirs = DVec3::from_array(theirs.next().unwrap()).as_vec3();
            assert_eq!(ours, theirs, "triangle {i}");
        }
    }
    assert!(theirs.next().is_none());
}
