//! The hierarchy over triangles on the device against brute force there, on meshes that are hard in different ways.

use libtest_mimic::Trial;
use nearfield::geometry::generate::{self, MeshKind};
use nearfield::gpu::{AdapterKind, Gpu};
use nearfield::{
    BvhSettings, Error, GpuBruteForceMesh, GpuTriangleBvh, HitRecord, Ray, RaySearch, TriMesh, TriangleBvh, Vec3,
};

use crate::SEED;
use crate::support::{Random, gpu_trial, own_context};

const N_RAYS: usize = 10_000;

/// By how much t may differ between two kernels, in parts of itself: a walk and a loop may be contracted differently.
const RELATIVE: f32 = 1e-5;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("triangle_bvh_names_the_triangles_of_brute_force", names_the_same_triangles),
        gpu_trial("triangle_bvh_takes_triangles_that_cannot_be_hit", takes_degenerate_triangles),
        gpu_trial("triangle_bvh_follows_triangles_that_move", follows_triangles_that_move),
        gpu_trial("triangle_bvh_takes_triangles_that_lose_and_gain_an_area", loses_and_gains_area),
        gpu_trial("triangle_bvh_refuses_a_refit_and_stays", refuses_a_refit_and_stays),
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

/// Twisted about z, so that triangles which were far apart come together.
fn twisted(mesh: &TriMesh) -> TriMesh {
    let (size, center) = (mesh.bounds().diagonal(), mesh.bounds().center());
    moved(mesh, |v| {
        let (sin, cos) = (3.0 * (v.z - center.z) / size).sin_cos();
        let local = v - center;
        center + Vec3::new(cos * local.x - sin * local.y, sin * local.x + cos * local.y, 1.5 * local.z)
    })
}

fn follows_triangles_that_move(gpu: &Gpu) {
    let soup = generate::mesh(MeshKind::Soup, 3000, SEED);
    // Brute force over all of them takes a software device minutes.
    let n_rays = if gpu.kind() == AdapterKind::Software { 300 } else { 3000 };
    let cases = [
        ("icosphere", generate::mesh(MeshKind::Icosphere, 1280, 0)),
        ("flat", moved(&soup, |v| v * Vec3::new(1.0, 1.0, 0.0))),
        ("one triangle", TriMesh { triangles: vec![soup.triangles[0]], ..soup.clone() }),
        ("equal triangles", TriMesh { triangles: vec![soup.triangles[0]; 300], ..soup.clone() }),
        ("scaled down", moved(&soup, |v| v * 1e-6)),
        ("scaled up", moved(&soup, |v| v * 1e6)),
        // Not so far that rounding takes or gives triangles their area: such a mesh is built anew.
        ("shifted", moved(&soup, |v| v + 1e3)),
        ("soup", soup),
    ];
    for (name, mesh) in cases {
        let mut bvh = GpuTriangleBvh::build(gpu, &mesh, &BvhSettings::default()).unwrap();
        let n_nodes = bvh.nodes().len();
        for now in [twisted(&mesh), moved(&mesh, |v| v * 16.0), twisted(&twisted(&mesh)), mesh.clone()] {
            bvh.refit(&now).unwrap();
            assert_eq!(bvh.broken_invariant().unwrap(), None, "{name}");
            assert_eq!(bvh.nodes().len(), n_nodes, "{name}");
            let stages = RaySearch::build_stages(&bvh);
            assert!(stages.iter().any(|stage| stage.name == "copy and fit"), "{name}: {stages:?}");
            let brute = GpuBruteForceMesh::build(gpu, &now).unwrap();
            assert_same(name, &bvh, &brute, &rays(&now)[..n_rays]);
        }
        // Back where they were, boxes are as tight as new ones, but for a step of rounding each.
        let fresh = GpuTriangleBvh::build(gpu, &mesh, &BvhSettings::default()).unwrap();
        let boxes = |bvh: &GpuTriangleBvh| -> u64 {
            let (_, work) = bvh.closest_hits_with_work(&rays(&mesh)[..3000]).unwrap();
            work.iter().map(|work| u64::from(work.node_visits + work.triangle_tests)).sum()
        };
        let (refitted, fresh) = (boxes(&bvh), boxes(&fresh));
        assert!(10 * refitted <= 11 * fresh, "{name}: {refitted} boxes and triangles instead of {fresh}");
    }
}

fn loses_and_gains_area(gpu: &Gpu) {
    let mesh = generate::mesh(MeshKind::Soup, 200, SEED);
    let mut flat = mesh.clone();
    (0..100).for_each(|i| flat.vertices[3 * i] = flat.vertices[3 * i + 1]);
    for (first, then) in [(&mesh, &flat), (&flat, &mesh)] {
        let mut bvh = GpuTriangleBvh::build(gpu, first, &BvhSettings::default()).unwrap();
        for now in [then, first] {
            bvh.refit(now).unwrap();
            assert_eq!(bvh.broken_invariant().unwrap(), None);
            assert_same("area", &bvh, &GpuBruteForceMesh::build(gpu, now).unwrap(), &rays(&mesh)[..2000]);
        }
    }
    let nothing = TriMesh { vertices: vec![Vec3::ONE; mesh.vertices.len()], ..mesh.clone() };
    let mut bvh = GpuTriangleBvh::build(gpu, &nothing, &BvhSettings::default()).unwrap();
    bvh.refit(&nothing).unwrap();
    assert_eq!(bvh.closest_hits(&rays(&mesh)).unwrap().n_hits(), 0);
}

fn refuses_a_refit_and_stays(gpu: &Gpu) {
    let gpu = own_context(gpu);
    let mesh = generate::mesh(MeshKind::Soup, 100, SEED);
    let rays = rays(&mesh);
    let mut bvh = GpuTriangleBvh::build(&gpu, &mesh, &BvhSettings::default()).unwrap();
    let before = bvh.closest_hits(&rays).unwrap().records().to_vec();
    let fewer = TriMesh { triangles: mesh.triangles[1..].to_vec(), ..mesh.clone() };
    assert!(bvh.refit(&fewer).unwrap_err().to_string().contains("99"));
    let mut broken = twisted(&mesh);
    broken.vertices[7].y = f32::NAN;
    assert!(matches!(bvh.refit(&broken), Err(Error::NonFinite { .. })));
    for n in 0.. {
        gpu.refuse_allocation(Some(n));
        let refitted = bvh.refit(&twisted(&mesh));
        let not_reached = gpu.refuse_allocation(None);
        if refitted.is_ok() {
            assert!(not_reached && n > 3, "only {n} allocations");
            break;
        }
        assert!(matches!(refitted, Err(Error::OutOfDeviceMemory { .. })), "{refitted:?}");
        assert_eq!(bvh.broken_invariant().unwrap(), None, "allocation {n}");
        assert_eq!(bvh.closest_hits(&rays).unwrap().records(), before, "allocation {n}");
    }
    assert_eq!(bvh.broken_invariant().unwrap(), None);
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
