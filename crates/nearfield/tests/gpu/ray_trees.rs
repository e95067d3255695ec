//! The hierarchy over triangles on the device against brute force there, on meshes that are hard in different ways.

use libtest_mimic::Trial;
use nearfield::geometry::generate::{self, MeshKind};
use nearfield::gpu::Gpu;
use nearfield::{
    BvhSettings, GpuBruteForceMesh, GpuTriangleBvh, HitRecord, Ray, RaySearch, TriMesh, TriangleBvh, Vec3,
};

use crate::SEED;
use crate::support::{Random, gpu_trial};

const N_RAYS: usize = 10_000;

/// By how much t may differ between two kernels, in parts of itself: a walk and a loop may be contracted differently.
const RELATIVE: f32 = 1e-5;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("triangle_bvh_names_the_triangles_of_brute_force", names_the_same_triangles),
        gpu_trial("triangle_bvh_takes_triangles_that_cannot_be_hit", takes_degenerate_triangles),
        gpu_trial("triangle_bvh_of_the_cpu_goes_to_the_device", goes_to_the_device),
    ]
}

fn unit(random: &mut Random) -> f32 {
    random.below(1 << 20) as f32 / (1 << 20) as f32
}

fn vector(random: &mut Random) -> Vec3 {
    Vec3::new(unit(random), unit(random), unit(random))
}

fn rays(mesh: &TriMesh) -> Vec<Ray> {
    let mut random = Random(SEED);
    let bounds = mesh.bounds();
    let mut around = |reach: f32| bounds.center() + reach * bounds.diagonal() * (vector(&mut random) - 0.5);
    let pairs: Vec<(Vec3, Vec3)> = (0..N_RAYS).map(|_| (around(4.0), around(0.8))).collect();
    let ray = |(i, &(outside, inside)): (usize, &(Vec3, Vec3))| {
        let triangle = mesh.triangle(i % mesh.triangles.len());
        match i % 6 {
            0 => Ray::new(outside, inside - outside),
            1 => Ray::new(inside, outside - inside),
            2 => Ray::new(outside, triangle.a - outside),
            3 => Ray::new(outside, 0.5 * (triangle.a + triangle.b) - outside),
            4 => Ray::new(triangle.centroid() - 2.0 * bounds.diagonal() * Vec3::AXES[i / 6 % 3], Vec3::AXES[i / 6 % 3]),
            _ if i % 100 == 5 => Ray::new(outside, Vec3::ZERO),
            _ => Ray { t_min: 0.9, t_max: 1.1, ..Ray::new(outside, triangle.centroid() - outside) },
        }
    };
    pairs.iter().enumerate().map(ray).collect()
}

fn moved(mesh: &TriMesh, to: impl Fn(Vec3) -> Vec3) -> TriMesh {
    TriMesh { vertices: mesh.vertices.iter().map(|&v| to(v)).collect(), ..mesh.clone() }
}

/// The first ray whose records differ by more than rounding.
fn difference(found: &[HitRecord], expected: &[HitRecord]) -> Option<usize> {
    let same = |a: &HitRecord, b: &HitRecord| {
        a.triangle == b.triangle && (a.t == b.t || (a.t - b.t).abs() <= RELATIVE * b.t.abs().max(1e-3))
    };
    (0..expected.len()).find(|&i| !same(&found[i], &expected[i]))
}

fn assert_same(name: &str, found: &impl RaySearch, expected: &impl RaySearch, rays: &[Ray]) -> usize {
    let hits = expected.closest_hits(rays).unwrap();
    let records = found.closest_hits(rays).unwrap();
    if let Some(i) = difference(records.records(), hits.records()) {
        let (found, expected) = (records.records()[i], hits.records()[i]);
        panic!("{name}: ray {i} {:?}: {found:?} instead of {expected:?}", rays[i]);
    }
    let any = expected.any_hits(rays).unwrap();
    assert_eq!(found.any_hits(rays).unwrap().as_slice(), any.as_slice(), "{name}: any");
    let counts = expected.count_hits(rays).unwrap();
    assert_eq!(found.count_hits(rays).unwrap().as_slice(), counts.as_slice(), "{name}: count");
    let (found, expected) = (found.all_hits(rays).unwrap(), expected.all_hits(rays).unwrap());
    assert_eq!(found.offsets(), expected.offsets(), "{name}: all");
    hits.n_hits()
}

fn names_the_same_triangles(gpu: &Gpu) {
    let soup = generate::mesh(MeshKind::Soup, 600, SEED);
    let equal = TriMesh { triangles: vec![soup.triangles[0]; 300], ..soup.clone() };
    let cases = [
        ("icosphere", generate::mesh(MeshKind::Icosphere, 1280, 0)),
        ("one triangle", TriMesh { triangles: vec![soup.triangles[0]], ..soup.clone() }),
        ("equal triangles", equal),
        ("scaled down", moved(&soup, |v| v * 1e-6)),
        ("scaled up", moved(&soup, |v| v * 1e6)),
        ("shifted", moved(&soup, |v| v + 1e6)),
        ("soup", soup),
    ];
    for (name, mesh) in cases {
        let bvh = GpuTriangleBvh::build(gpu, &mesh, &BvhSettings::default()).unwrap();
        assert_eq!(bvh.broken_invariant().unwrap(), None, "{name}");
        let brute = GpuBruteForceMesh::build(gpu, &mesh).unwrap();
        let n_hits = assert_same(name, &bvh, &brute, &rays(&mesh));
        assert!(n_hits > N_RAYS / 20, "{name}: only {n_hits} rays hit");
    }
}

fn takes_degenerate_triangles(gpu: &Gpu) {
    let soup = generate::mesh(MeshKind::Soup, 40, SEED);
    let [a, b, _] = soup.triangles[0];
    let flat = TriMesh { triangles: vec![[a, b, b]; 20], ..soup };
    let bvh = GpuTriangleBvh::build(gpu, &flat, &BvhSettings::default()).unwrap();
    assert_eq!(bvh.broken_invariant().unwrap(), None);
    assert_eq!(bvh.closest_hits(&rays(&flat)).unwrap().n_hits(), 0);
}

fn goes_to_the_device(gpu: &Gpu) {
    let mesh = generate::mesh(MeshKind::Torus, 800, 0);
    let on_cpu = TriangleBvh::build(&mesh, &BvhSettings::fast_build()).unwrap();
    let bvh = GpuTriangleBvh::upload(gpu, &on_cpu).unwrap();
    let rays = rays(&mesh);
    assert_same("torus", &bvh, &GpuBruteForceMesh::build(gpu, &mesh).unwrap(), &rays);
    let (hits, work) = bvh.closest_hits_with_work(&rays).unwrap();
    let tests: u64 = work.iter().map(|work| u64::from(work.triangle_tests)).sum();
    let boxes: u64 = work.iter().map(|work| u64::from(work.node_visits)).sum();
    assert!(tests >= hits.n_hits() as u64 && boxes > 0);
    assert!(tests < 20 * N_RAYS as u64, "{tests} triangles were tested for {N_RAYS} rays");
}
