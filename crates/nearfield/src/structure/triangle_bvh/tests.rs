//! The hierarchy against brute force, to the bit, and its invariants, on meshes that are hard in different ways.

use glam::Vec3;

use super::settings::BLOCK;
use super::{BvhSettings, MOST_LEVELS, TriangleBvh};
use crate::geometry::generate::{self, MeshKind};
use crate::geometry::row_simd::Simd;
use crate::geometry::{Ray, TriMesh};
use crate::query::{HitRecord, RaySearch};
use crate::structure::{BruteForceMesh, RayStructure};

const SEED: u64 = 0x00b5_eed5;
const N_RAYS: usize = 10_000;

/// Numbers in [0, 1) that differ from seed to seed.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    fn vector(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit())
    }

    fn below(&mut self, n: usize) -> usize {
        ((self.unit() * n as f32) as usize).min(n - 1)
    }
}

fn soup_of(corners: impl Iterator<Item = [Vec3; 3]>) -> TriMesh {
    let vertices: Vec<Vec3> = corners.flatten().collect();
    let triangles = (0..vertices.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    TriMesh::new(vertices, triangles).unwrap()
}

fn slivers() -> TriMesh {
    let mut random = Random(SEED);
    soup_of((0..400).map(|_| {
        let (from, along) = (random.vector(), random.vector() - 0.5);
        [from, from + along, from + 0.5 * along + 1e-6 * (random.vector() - 0.5)]
    }))
}

fn coplanar_grid() -> TriMesh {
    let n = 16;
    let vertices = (0..=n).flat_map(|y| (0..=n).map(move |x| Vec3::new(x as f32, y as f32, 1.0))).collect();
    let corner = |x: u32, y: u32| y * (n + 1) + x;
    let square = |x: u32, y: u32| {
        [[corner(x, y), corner(x + 1, y), corner(x, y + 1)], [corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)]]
    };
    TriMesh::new(vertices, (0..n).flat_map(|y| (0..n).flat_map(move |x| square(x, y))).collect()).unwrap()
}

fn nested_shells() -> TriMesh {
    let shell = generate::mesh(MeshKind::Icosphere, 180, 0);
    let mut mesh = TriMesh::default();
    for i in 0..6 {
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend(shell.vertices.iter().map(|&v| v * 0.7f32.powi(i)));
        mesh.triangles.extend(shell.triangles.iter().map(|t| t.map(|v| v + first)));
    }
    mesh
}

fn moved(mesh: &TriMesh, to: impl Fn(Vec3) -> Vec3) -> TriMesh {
    TriMesh { vertices: mesh.vertices.iter().map(|&v| to(v)).collect(), ..mesh.clone() }
}

/// Ever smaller triangles towards a corner: bins peel off one at a time.
fn shrinking() -> TriMesh {
    soup_of((0..300).map(|i| {
        let size = 0.8f32.powi(i);
        [Vec3::splat(size), Vec3::new(1.1, 1.0, 1.0) * size, Vec3::new(1.0, 1.1, 1.05) * size]
    }))
}

fn cases() -> Vec<(&'static str, TriMesh)> {
    let one = [Vec3::ZERO, Vec3::new(3.0, 0.0, 1.0), Vec3::new(0.0, 2.0, 0.5)];
    let soup = generate::mesh(MeshKind::Soup, 600, SEED);
    let line = [Vec3::ZERO, Vec3::new(0.5, 0.25, 0.125), Vec3::new(1.0, 0.5, 0.25)];
    vec![
        ("icosphere", generate::mesh(MeshKind::Icosphere, 1280, 0)),
        ("slivers", slivers()),
        ("coplanar grid", coplanar_grid()),
        ("nested shells", nested_shells()),
        ("one triangle", soup_of([one].into_iter())),
        ("all degenerate", soup_of([line; 20].into_iter())),
        ("some degenerate", soup_of((0..60).map(|i| if i % 3 == 0 { line } else { one.map(|v| v * i as f32) }))),
        ("equal triangles", soup_of([one; 1000].into_iter())),
        ("shrinking", shrinking()),
        ("scaled down", moved(&soup, |v| v * 1e-6)),
        ("scaled up", moved(&soup, |v| v * 1e6)),
        ("shifted", moved(&soup, |v| v + 1e6)),
        ("soup", soup),
    ]
}

/// Rays from around and from inside, along axes, at vertices and along edges, from surfaces, with ranges of t.
fn rays(mesh: &TriMesh) -> Vec<Ray> {
    let mut random = Random(SEED ^ mesh.triangles.len() as u64);
    let bounds = mesh.bounds();
    let extent = bounds.extent().max(Vec3::splat(1e-3 * bounds.diagonal()));
    (0..N_RAYS)
        .map(|i| {
            let mut around = |reach: f32| bounds.center() + extent * reach * (random.vector() - 0.5);
            let (outside, inside) = (around(4.0), around(1.0));
            let triangle = mesh.triangle(random.below(mesh.triangles.len()));
            let (u, v) = (random.unit(), random.unit());
            let edge = triangle.a + u * (triangle.b - triangle.a);
            let face = triangle.a + u * (triangle.b - triangle.a) + (1.0 - u) * v * (triangle.c - triangle.a);
            let axis = Vec3::AXES[i / 8 % 3] * if i & 64 == 0 { 1.0 } else { -1.0 };
            let mut ray = match i % 8 {
                0 => Ray::new(outside, inside - outside),
                1 => Ray::new(inside, random.vector() - 0.5),
                2 => Ray::new(face - extent.max_element() * axis, axis),
                3 => Ray::new(outside, triangle.c - outside),
                4 => Ray::new(outside, edge - outside),
                5 => Ray::new(face, random.vector() - 0.5),
                6 => Ray::new(triangle.a, axis),
                _ => Ray { t_min: 0.25 * u, t_max: 0.5 + v, ..Ray::new(outside, face - outside) },
            };
            if i % 101 == 0 {
                ray.direction = Vec3::ZERO;
            }
            ray
        })
        .collect()
}

fn bits(records: &[HitRecord]) -> Vec<[u32; 4]> {
    records.iter().map(|r| [r.triangle, r.t.to_bits(), r.weights[0].to_bits(), r.weights[1].to_bits()]).collect()
}

/// Every answer is that of brute force; the number of rays that hit.
fn assert_same(name: &str, bvh: &TriangleBvh, brute: &BruteForceMesh, rays: &[Ray]) -> usize {
    let hits = brute.closest_hits(rays).unwrap();
    let (expected, found) = (bits(hits.records()), bits(bvh.closest_hits(rays).unwrap().records()));
    if let Some(i) = (0..rays.len()).find(|&i| expected[i] != found[i]) {
        let (expected, found) = (hits.records()[i], bvh.closest_hits(&rays[i..=i]).unwrap().records()[0]);
        panic!("{name}: ray {i} {:?}: {found:?} instead of {expected:?}", rays[i]);
    }
    assert_eq!(bvh.any_hits(rays).unwrap().as_slice(), brute.any_hits(rays).unwrap().as_slice(), "{name}: any");
    assert_eq!(bvh.count_hits(rays).unwrap().as_slice(), brute.count_hits(rays).unwrap().as_slice(), "{name}: count");
    let (all, expected) = (bvh.all_hits(rays).unwrap(), brute.all_hits(rays).unwrap());
    assert_eq!(all.offsets(), expected.offsets(), "{name}: all");
    assert_eq!(bits(all.records()), bits(expected.records()), "{name}: all");
    hits.n_hits()
}

#[test]
fn every_answer_is_that_of_brute_force_to_the_bit() {
    for (name, mesh) in cases() {
        let (rays, brute) = (rays(&mesh), BruteForceMesh::build(&mesh).unwrap());
        let bvh = TriangleBvh::build(&mesh, &BvhSettings::default()).unwrap();
        assert_eq!(bvh.broken_invariant(), None, "{name}");
        let n_hits = assert_same(name, &bvh, &brute, &rays);
        assert!(name == "all degenerate" || n_hits > N_RAYS / 20, "{name}: only {n_hits} rays hit");
    }
}

#[test]
fn portable_arithmetic_gives_the_same_bits_and_the_same_work() {
    for (name, mesh) in cases() {
        let rays = rays(&mesh);
        let best = TriangleBvh::build(&mesh, &BvhSettings::default()).unwrap();
        let portable = TriangleBvh { simd: Simd::Portable, ..best.clone() };
        let (expected, expected_work) = best.closest_hits_with_work(&rays).unwrap();
        let (found, work) = portable.closest_hits_with_work(&rays).unwrap();
        assert_eq!(bits(found.records()), bits(expected.records()), "{name}");
        assert_eq!(work, expected_work, "{name}");
    }
}

#[test]
fn settings_change_the_tree_and_no_answer() {
    let mesh = nested_shells();
    let (rays, brute) = (rays(&mesh), BruteForceMesh::build(&mesh).unwrap());
    let one = BvhSettings { leaf_triangles: 1, ..BvhSettings::DEFAULT };
    let deep = BvhSettings { bins: 2, sweep_below: 0, leaf_cost: 1e-3, ..BvhSettings::DEFAULT };
    for settings in [BvhSettings::fast_build(), BvhSettings::best_query(), one, deep] {
        let bvh = TriangleBvh::build(&mesh, &settings).unwrap();
        assert_eq!(bvh.broken_invariant(), None, "{settings:?}");
        assert_same("nested shells", &bvh, &brute, &rays[..2000]);
        let most = bvh.blocks.iter().map(|block| block.len()).max();
        assert!(most.is_some_and(|most| most <= settings.leaf_triangles as usize), "{settings:?}: {most:?}");
    }
    for wrong in [
        BvhSettings { bins: 1, ..BvhSettings::DEFAULT },
        BvhSettings { bins: 65, ..BvhSettings::DEFAULT },
        BvhSettings { leaf_triangles: 0, ..BvhSettings::DEFAULT },
        BvhSettings { leaf_triangles: BLOCK as u32 + 1, ..BvhSettings::DEFAULT },
        BvhSettings { leaf_cost: f32::NAN, ..BvhSettings::DEFAULT },
    ] {
        assert!(TriangleBvh::build(&mesh, &wrong).is_err(), "{wrong:?}");
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    // More triangles than one thread splits alone, some of them without an area.
    let mut mesh = generate::mesh(MeshKind::Soup, 150_000, SEED);
    for i in 0..100 {
        mesh.vertices[300 * i] = mesh.vertices[300 * i + 1];
    }
    let built = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| TriangleBvh::build(&mesh, &BvhSettings::fast_build()).unwrap())
    };
    let one = built(1);
    assert_eq!(one.broken_invariant(), None);
    for threads in [2, 5] {
        let other = built(threads);
        assert_eq!(
            (one.nodes.len(), one.blocks.len(), one.depth),
            (other.nodes.len(), other.blocks.len(), other.depth)
        );
        for (a, b) in one.nodes.iter().zip(&other.nodes) {
            assert_eq!((a.children, a.planes), (b.children, b.planes), "{threads} threads");
        }
        for (a, b) in one.blocks.iter().zip(&other.blocks) {
            assert_eq!((a.indices, a.lanes), (b.indices, b.lanes), "{threads} threads");
        }
    }
}

#[test]
fn refitted_trees_answer_as_brute_force_on_the_moved_mesh() {
    for (name, mesh) in cases() {
        let mut bvh = TriangleBvh::build(&mesh, &BvhSettings::default()).unwrap();
        let n_nodes = bvh.n_nodes();
        let size = mesh.bounds().diagonal();
        // Twisted about z: triangles that were far apart come together.
        let twisted = moved(&mesh, |v| {
            let (sin, cos) = (3.0 * v.z / size).sin_cos();
            Vec3::new(cos * v.x - sin * v.y, sin * v.x + cos * v.y, 1.5 * v.z)
        });
        bvh.refit(&twisted).unwrap();
        assert_eq!(bvh.broken_invariant(), None, "{name}");
        if RayStructure::build_stages(&bvh).iter().any(|stage| stage.name == "fit") {
            assert_eq!(bvh.n_nodes(), n_nodes, "{name}");
        }
        assert_same(name, &bvh, &BruteForceMesh::build(&twisted).unwrap(), &rays(&twisted)[..4000]);
    }
}

#[test]
fn triangles_may_lose_and_gain_their_area() {
    let mesh = generate::mesh(MeshKind::Soup, 200, SEED);
    let mut flat = mesh.clone();
    for i in 0..100 {
        flat.vertices[3 * i] = flat.vertices[3 * i + 1];
    }
    let mut bvh = TriangleBvh::build(&mesh, &BvhSettings::default()).unwrap();
    for now in [&flat, &mesh] {
        bvh.refit(now).unwrap();
        assert_eq!(bvh.broken_invariant(), None);
        assert_same("flattened", &bvh, &BruteForceMesh::build(now).unwrap(), &rays(&mesh)[..2000]);
    }
    let mut bvh = TriangleBvh::build(&flat, &BvhSettings::default()).unwrap();
    bvh.refit(&mesh).unwrap();
    assert_eq!(bvh.broken_invariant(), None);
    assert_same("risen", &bvh, &BruteForceMesh::build(&mesh).unwrap(), &rays(&mesh)[..2000]);
}

#[test]
fn a_refused_refit_leaves_the_tree_as_it_was() {
    let mesh = generate::mesh(MeshKind::Soup, 100, SEED);
    let mut bvh = TriangleBvh::build(&mesh, &BvhSettings::default()).unwrap();
    let fewer = TriMesh { triangles: mesh.triangles[1..].to_vec(), ..mesh.clone() };
    assert!(bvh.refit(&fewer).unwrap_err().to_string().contains("99"));
    assert!(bvh.refit(&moved(&mesh, |v| v * f32::NAN)).is_err());
    assert_eq!(bvh.broken_invariant(), None);
    assert_same("unmoved", &bvh, &BruteForceMesh::build(&mesh).unwrap(), &rays(&mesh)[..2000]);
}

#[test]
fn no_mesh_makes_a_tree_deeper_than_the_limit() {
    for (name, mesh) in cases() {
        let settings = BvhSettings { bins: 2, sweep_below: 2, leaf_triangles: 1, ..BvhSettings::DEFAULT };
        let bvh = TriangleBvh::build(&mesh, &settings).unwrap();
        assert!(bvh.depth() <= MOST_LEVELS, "{name}: {}", bvh.depth());
        assert_eq!(bvh.broken_invariant(), None, "{name}");
        assert_same(name, &bvh, &BruteForceMesh::build(&mesh).unwrap(), &rays(&mesh)[..1000]);
    }
}

#[test]
fn a_broken_tree_is_found_out() {
    let mesh = generate::mesh(MeshKind::Icosphere, 320, 0);
    let sound = TriangleBvh::build(&mesh, &BvhSettings::default()).unwrap();
    let broken = |change: &dyn Fn(&mut TriangleBvh)| {
        let mut bvh = sound.clone();
        change(&mut bvh);
        bvh.broken_invariant().map(|words| words.chars().next().unwrap_or(' '))
    };
    assert_eq!(broken(&|bvh| bvh.blocks[1].indices[0] = bvh.blocks[0].indices[0]), Some('1'));
    assert_eq!(broken(&|bvh| bvh.nodes[0].planes[0][0] += 0.1), Some('2'));
    assert!(broken(&|bvh| bvh.nodes[0].children[1] = bvh.nodes[0].children[0]).is_some());
    assert_eq!(broken(&|bvh| bvh.depth = 1), Some('4'));
}

#[cfg(feature = "gpu")]
#[test]
fn compressed_boxes_hold_what_is_below_them() {
    use super::collapse::LeafCost;
    use super::{compress, cpu};
    for (name, mesh) in cases() {
        let triangles = crate::structure::PreparedTriangles::new(&mesh).unwrap();
        let cost = LeafCost { most: compress::LEAF, entry: 0.0, triangle: 0.3 };
        let wide = cpu::wide_tree(&triangles, &BvhSettings::DEFAULT, &cost, &mut vec![]).unwrap();
        let mut compressed = compress::compress(wide, &triangles);
        assert_eq!(compressed.broken_invariant(&triangles), None, "{name}");
        if compressed.triangles.len() > 100 {
            compressed.nodes[0].origin[1] += 0.2 * mesh.bounds().diagonal();
            assert!(compressed.broken_invariant(&triangles).is_some_and(|words| words.starts_with('5')), "{name}");
        }
    }
}
