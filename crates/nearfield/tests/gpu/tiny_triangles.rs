//! Triangles at the lower end of f32: hit by every structure on every device down to the documented edge, and never below
//! the other one.

use libtest_mimic::Trial;
use nearfield::gpu::Gpu;
use nearfield::{
    BruteForceMesh, BvhSettings, GpuBruteForceMesh, GpuKdTree, GpuTriangleBvh, HitRecord, KdTree, KdTreeSettings, Ray,
    RaySearch, TriMesh, TriangleBvh, Vec3,
};

use crate::support::{gpu_trial, trial};

/// Rays across and down.
const SIDE: usize = 16;
/// How far off the ray a hit may lie, in longest sides of the mesh, as documented; a rounding more.
const OFF: f32 = 1.01 / (1 << 19) as f32;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("tiny_triangles_are_hit_down_to_the_documented_edge", || check(&on_cpu, -90..=-40, -62)),
        gpu_trial("tiny_triangles_are_hit_down_to_the_documented_edge_on_a_device", |gpu| {
            // A device compiles its kernels for every structure that is built: few edges, those of the claims among them.
            check(&|mesh| on_gpu(gpu, mesh), [-90, -77, -65, -53], -53);
        }),
    ]
}

fn on_cpu(mesh: &TriMesh) -> Vec<Box<dyn RaySearch>> {
    vec![
        Box::new(BruteForceMesh::build(mesh).unwrap()),
        Box::new(KdTree::build(mesh, &KdTreeSettings::default()).unwrap()),
        Box::new(KdTree::build(mesh, &KdTreeSettings::spatial_median(1)).unwrap()),
        Box::new(TriangleBvh::build(mesh, &BvhSettings::default()).unwrap()),
    ]
}

fn on_gpu(gpu: &Gpu, mesh: &TriMesh) -> Vec<Box<dyn RaySearch>> {
    let tree = KdTree::build(mesh, &KdTreeSettings::default()).unwrap();
    vec![
        Box::new(GpuBruteForceMesh::build(gpu, mesh).unwrap()),
        Box::new(GpuKdTree::upload(gpu, &tree).unwrap()),
        Box::new(GpuTriangleBvh::build(gpu, mesh, &BvhSettings::default()).unwrap()),
    ]
}

/// A square of two triangles with this edge; with a floor, a large one below it, numbers 2 and 3.
fn square(edge: f32, floor: Option<f32>) -> TriMesh {
    let corners = |half: f32, z: f32| {
        [Vec3::new(-half, -half, z), Vec3::new(half, -half, z), Vec3::new(half, half, z), Vec3::new(-half, half, z)]
    };
    let mut vertices = corners(0.5 * edge, 0.0).to_vec();
    let mut triangles = vec![[0, 1, 2], [0, 2, 3]];
    if let Some(size) = floor {
        vertices.extend(corners(0.5 * size, -size));
        triangles.extend([[4, 5, 6], [4, 6, 7]]);
    }
    TriMesh::new(vertices, triangles).unwrap()
}

/// Rays straight down on the square, none on its outline or its diagonal.
fn rays(edge: f32) -> Vec<Ray> {
    let place = |i: usize, shift: f32| edge * ((i as f32 + shift) / SIDE as f32 - 0.5);
    (0..SIDE * SIDE)
        .map(|i| Ray::new(Vec3::new(place(i % SIDE, 0.5), place(i / SIDE, 0.25), edge), Vec3::NEG_Z))
        .collect()
}

/// Checks edges of these powers of two: hits as they should be from `smallest` up, none from 2⁻⁷⁷ down, and never a hit
/// off the ray.
fn check(build: &dyn Fn(&TriMesh) -> Vec<Box<dyn RaySearch>>, powers: impl IntoIterator<Item = i32>, smallest: i32) {
    for power in powers {
        let edge = 2f32.powi(power);
        for floor in [None, Some(1.0)] {
            let (mesh, rays) = (square(edge, floor), rays(edge));
            let reach = floor.unwrap_or(edge);
            for search in build(&mesh) {
                let name = format!("{} on {}, edges 2^{power}, floor {floor:?}", search.structure(), search.device());
                let hits = search.closest_hits(&rays).unwrap();
                for (i, (ray, hit)) in rays.iter().zip(hits.records()).enumerate() {
                    let behind =
                        if floor.is_some() { hit.triangle >= 2 && hit.is_hit() } else { *hit == HitRecord::miss() };
                    if power >= smallest {
                        let right = u32::from(i % SIDE * 4 + 2 < i / SIDE * 4 + 1);
                        assert_eq!(hit.triangle, right, "{name}, ray {i}");
                    } else if power <= -77 {
                        assert!(behind, "{name}, ray {i}: {hit:?}");
                    }
                    if !behind {
                        assert!(hit.triangle < 2, "{name}, ray {i}: {hit:?}");
                        let [b, c] = hit.weights;
                        let [p, q, r] = mesh.triangles[hit.triangle as usize].map(|v| mesh.vertices[v as usize]);
                        let off = ((1.0 - b - c) * p + b * q + c * r - ray.origin).truncate().abs().max_element();
                        assert!(off <= OFF * reach, "{name}, ray {i}: {off} off");
                    }
                }
            }
        }
    }
}
