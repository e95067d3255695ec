//! The meshes that rays are cast into, each with its name.

use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::{TriMesh, Vec3};

use crate::support::Random;

/// A mesh, and what is known of it.
pub(crate) struct Case {
    pub(crate) name: String,
    pub(crate) mesh: TriMesh,
    /// Whether it encloses space, so that no ray from inside gets out: see `inside.rs`.
    pub(crate) closed: bool,
    /// The largest share of rays that may pass an outline so near that f32 does not tell the side, of sets not aimed at one.
    pub(crate) most_in_doubt: f64,
}

/// Name of the mesh of a point and a line: all that it is aimed at is one place.
pub(crate) const ONLY_DEGENERATE: &str = "only degenerate";

fn case(name: &str, mesh: TriMesh, closed: bool) -> Case {
    Case { name: name.to_owned(), mesh, closed, most_in_doubt: 0.05 }
}

/// The mesh with every vertex changed.
fn mapped(mesh: &TriMesh, map: impl Fn(Vec3) -> Vec3) -> TriMesh {
    TriMesh { vertices: mesh.vertices.iter().map(|&v| map(v)).collect(), ..mesh.clone() }
}

fn joined(meshes: &[TriMesh]) -> TriMesh {
    let mut all = TriMesh::default();
    for mesh in meshes {
        let first = all.vertices.len() as u32;
        all.vertices.extend(&mesh.vertices);
        all.triangles.extend(mesh.triangles.iter().map(|t| t.map(|v| v + first)));
    }
    all
}

/// Squares of one plane, so that boxes and split planes are flat and rays meet edges all over.
fn coplanar_grid(n: u32) -> TriMesh {
    let mut mesh = TriMesh::default();
    for y in 0..=n {
        mesh.vertices.extend((0..=n).map(|x| Vec3::new(x as f32, y as f32, 0.5)));
    }
    for y in 0..n {
        for x in 0..n {
            let at = |x: u32, y: u32| y * (n + 1) + x;
            mesh.triangles.push([at(x, y), at(x + 1, y), at(x + 1, y + 1)]);
            mesh.triangles.push([at(x, y), at(x + 1, y + 1), at(x, y + 1)]);
        }
    }
    mesh
}

/// A fan of needles a thousand times as long as wide, many of them crossing.
fn slivers(n: usize) -> TriMesh {
    let mut random = Random(11);
    let mut unit = || random.unit();
    let mut mesh = TriMesh::default();
    for i in 0..n as u32 {
        let from = Vec3::new(unit(), unit(), unit());
        let to = Vec3::new(unit(), unit(), unit());
        let side = Vec3::new(unit() - 0.5, unit() - 0.5, unit() - 0.5) * 1e-3;
        mesh.vertices.extend([from, to, from + side]);
        mesh.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    mesh
}

/// Triangles without an area among others: all corners one, two corners one, corners on a line.
fn with_degenerate() -> TriMesh {
    let mut mesh = mesh(MeshKind::Icosphere, 80, 1);
    let n = mesh.vertices.len() as u32;
    mesh.vertices.extend([Vec3::new(0.25, 0.5, 0.75) * 0.5, Vec3::new(0.25, 0.5, 0.75)]);
    for i in 0..20 {
        mesh.triangles.insert(4 * i, [i as u32, i as u32, i as u32]);
        mesh.triangles.insert(4 * i + 1, [i as u32, (i + 1) as u32, i as u32]);
        mesh.triangles.insert(4 * i + 2, [n, n + 1, n]);
    }
    mesh
}

/// Two tori through each other's holes: space with two handles in two parts.
fn linked_tori() -> TriMesh {
    let torus = mesh(MeshKind::Torus, 250, 1);
    let radius = torus.bounds().extent().max_element() * 0.375;
    let other = mapped(&torus, |v| Vec3::new(v.x + radius, v.z, -v.y));
    joined(&[torus, other])
}

/// Every mesh that is made here.
pub(crate) fn cases() -> Vec<Case> {
    let sphere = mesh(MeshKind::Icosphere, 500, 1);
    let shells: Vec<TriMesh> = (1..=8).map(|i| mapped(&mesh(MeshKind::Icosphere, 80, 1), |v| v * i as f32)).collect();
    let one = TriMesh::new(vec![Vec3::ZERO, Vec3::X, Vec3::new(0.25, 1.0, 0.5)], vec![[2, 0, 1]]).unwrap();
    let mut cases = vec![
        case("sphere", sphere.clone(), true),
        case("torus", mesh(MeshKind::Torus, 400, 1), true),
        case("cube", mesh(MeshKind::Cube, 300, 1), true),
        case("linked tori", linked_tori(), true),
        case("soup", mesh(MeshKind::Soup, 600, 5), false),
        case("coplanar grid", coplanar_grid(16), false),
        case("slivers", slivers(300), false),
        case("nested shells", joined(&shells), true),
        case("one triangle", one.clone(), false),
        case("equal triangles", joined(&vec![one; 50]), false),
        case("degenerate triangles", with_degenerate(), true),
        case(ONLY_DEGENERATE, TriMesh::new(vec![Vec3::ONE; 3], vec![[0, 1, 2], [1, 1, 1]]).unwrap(), false),
    ];
    for scale in [1e-6, 1e6] {
        cases.push(case(&format!("sphere times {scale:e}"), mapped(&sphere, |v| v * scale), true));
    }
    // Coordinates there have steps of 1/16, so the sphere is made as large as a shift leaves it round.
    let shifted = case("sphere shifted by 1e6", mapped(&sphere, |v| v * 100.0 + 1e6), true);
    // The origin of a ray that comes from afar is uncertain by a quarter of that.
    cases.push(Case { most_in_doubt: 0.1, ..shifted });
    cases.push(case("soup times 1e6", mapped(&mesh(MeshKind::Soup, 600, 5), |v| v * 1e6), false));
    cases
}

/// Real meshes, where the test data is: names, files, and whether they are closed.
pub(crate) const SCANS: &[(&str, &str, bool)] = &[
    ("stanford bunny", "stanford-bunny.obj", false),
    ("accel bunny a", "accel-bunny-a.obj", false),
    ("accel bunny b", "accel-bunny-b.obj", false),
    ("accel bunny c", "accel-bunny-c.obj", false),
    ("nefertiti", "nefertiti.obj", true),
    ("spot", "spot.obj", true),
    ("fandisk", "fandisk.obj", true),
];
