//! `RayIndex`: the same answers whatever is chosen, on meshes that stay and that move, and the CPU where the GPU fails.

use libtest_mimic::Trial;
use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield::{
    BruteForceMesh, Error, HitRecord, Ray, RayIndex, RayIndexSettings, RayQuery, RaySearch, RayStructureChoice,
    RayTask, TriMesh, TriangleBvh, Vec3,
};

use crate::rays::{KINDS, rays};
use crate::support::{gpu_trial, own_context, trial};

const SEED: u64 = 20_261_129;

fn settings(structure: RayStructureChoice, device: DeviceChoice) -> RayIndexSettings {
    RayIndexSettings { structure, device }
}

fn choices() -> impl Iterator<Item = RayStructureChoice> {
    std::iter::once(RayStructureChoice::Auto).chain(RayStructureChoice::ALL)
}

/// A hundred rays of each kind.
fn all_kinds(mesh: &TriMesh) -> Vec<Ray> {
    KINDS.iter().flat_map(|kind| rays(mesh, kind, 100, SEED)).collect()
}

/// Twisted about z, so that boxes must follow.
fn twisted(mesh: &TriMesh) -> TriMesh {
    let turn = |v: &Vec3| {
        let (sin, cos) = (2.0 * v.z).sin_cos();
        Vec3::new(cos * v.x - sin * v.y, sin * v.x + cos * v.y, 1.5 * v.z)
    };
    TriMesh { vertices: mesh.vertices.iter().map(turn).collect(), ..mesh.clone() }
}

/// Every answer of two searches.
fn answers(search: &dyn RaySearch, rays: &[Ray]) -> (Vec<HitRecord>, Vec<u32>, Vec<u32>, Vec<HitRecord>) {
    let closest = search.closest_hits(rays).unwrap().records().to_vec();
    assert_eq!(search.closest_hits_with_work(rays).unwrap().0.records(), closest);
    let any = search.any_hits(rays).unwrap().as_slice().to_vec();
    let counts = search.count_hits(rays).unwrap().as_slice().to_vec();
    (closest, any, counts, search.all_hits(rays).unwrap().records().to_vec())
}

fn check(build: impl Fn(&TriMesh, &RayTask, RayStructureChoice) -> RayIndex) {
    let still = mesh(MeshKind::Torus, 400, 1);
    let moved = twisted(&still);
    let (rays, rays_moved) = (all_kinds(&still), all_kinds(&moved));
    let task = RayTask::new(rays.len() as u64).moving(1);
    let mut expected = None;
    for choice in choices() {
        let mut index = build(&still, &task, choice);
        let is_auto = choice == RayStructureChoice::Auto;
        assert_eq!((index.reason().is_some(), index.structure() == choice.name()), (is_auto, !is_auto));
        let before = answers(&index, &rays);
        let fewer = TriMesh { triangles: still.triangles[1..].to_vec(), ..still.clone() };
        assert!(matches!(index.refit(&fewer), Err(Error::LengthMismatch { .. })));
        index.refit(&moved).unwrap();
        let found = (before, answers(&index, &rays_moved));
        let report = index.closest_hits(&rays).unwrap().report;
        assert_eq!(report.reason.as_deref(), index.reason());
        assert_eq!(index.closest_hit(&rays[0]).unwrap().is_some(), index.any_hit(&rays[0]).unwrap());
        assert_eq!(index.all_hits_of(&rays[0]).unwrap().len(), index.count_hits_of(&rays[0]).unwrap() as usize);
        assert_eq!(&found, expected.get_or_insert_with(|| found.clone()), "{choice:?}");
    }
}

fn every_choice_answers_alike_on_the_cpu() {
    check(|mesh, task, choice| RayIndex::build(mesh, task, &settings(choice, DeviceChoice::Cpu)).unwrap());
    let mesh = mesh(MeshKind::Torus, 400, 1);
    let index =
        RayIndex::build(&mesh, &RayTask::new(1), &settings(RayStructureChoice::Auto, DeviceChoice::Cpu)).unwrap();
    let rays = all_kinds(&mesh);
    assert_eq!(answers(&index, &rays), answers(&BruteForceMesh::build(&mesh).unwrap(), &rays));
}

fn the_task_decides_what_auto_builds() {
    let ball = mesh(MeshKind::Icosphere, 20_480, 1);
    let build = |task: RayTask| {
        RayIndex::build(&ball, &task, &settings(RayStructureChoice::Auto, DeviceChoice::Cpu)).unwrap().structure()
    };
    assert_eq!(build(RayTask::new(3)), "brute-force");
    assert_eq!(build(RayTask::new(10_000_000)), "triangle-bvh");
    assert_eq!(build(RayTask::new(10_000_000).with_ropes()), "kd-tree");
    assert_eq!(build(RayTask::new(10_000_000).asking(RayQuery::All).moving(9)), "triangle-bvh");
}

/// With the device `Auto` the CPU answers where the GPU has no memory; with a named device that is an error.
fn the_cpu_takes_over_from_a_gpu_without_memory(gpu: &Gpu) {
    let ball = mesh(MeshKind::Icosphere, 1280, 1);
    let rays = all_kinds(&ball);
    let expected = answers(&TriangleBvh::build(&ball, &Default::default()).unwrap(), &rays);
    for choice in choices() {
        let gpu = own_context(gpu);
        let task = RayTask::new(rays.len() as u64);
        let build = |device| RayIndex::build_on(&gpu, &ball, &task, &settings(choice, device));
        let (mut index, named) = (build(DeviceChoice::Auto).unwrap(), build(DeviceChoice::Gpu).unwrap());
        gpu.set_memory_limit(gpu.memory_used());
        assert_eq!(answers(&index, &rays), expected, "{choice:?}");
        let notes = index.closest_hits(&rays).unwrap().report.notes;
        assert!(notes.iter().any(|note| note.contains("the CPU did the work")), "{notes:?}");
        assert!(matches!(named.closest_hits(&rays), Err(Error::OutOfDeviceMemory { .. })));
        index.refit(&ball).unwrap();
        assert!(index.device().starts_with("cpu"), "{choice:?}");
        assert_eq!(answers(&index, &rays), expected, "{choice:?}, after a refit");
        // What the index held on the device is free again.
        gpu.set_memory_limit(1);
        let built = build(DeviceChoice::Auto).unwrap();
        assert!(built.device().starts_with("cpu") && built.notes().iter().any(|n| n.contains("the CPU did the work")));
        assert!(matches!(build(DeviceChoice::Gpu), Err(Error::OutOfDeviceMemory { .. })));
    }
}

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("cpu::every_choice_answers_alike", every_choice_answers_alike_on_the_cpu),
        trial("cpu::the_task_decides_what_auto_builds", the_task_decides_what_auto_builds),
        gpu_trial("gpu::every_choice_answers_alike", |gpu| {
            check(|mesh, task, choice| {
                RayIndex::build_on(gpu, mesh, task, &settings(choice, DeviceChoice::Gpu)).unwrap()
            });
        }),
        gpu_trial("gpu::the_cpu_takes_over_from_a_gpu_without_memory", the_cpu_takes_over_from_a_gpu_without_memory),
    ]
}
