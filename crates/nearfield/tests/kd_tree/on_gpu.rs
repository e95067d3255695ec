//! The tree on the device: the answers of brute force there, and kernels of one's own that follow its ropes.

use libtest_mimic::Trial;
use nearfield::gpu::shader::Fill;
use nearfield::gpu::{Access, Bind, Buffer, Gpu, Kernel, Workgroups};
use nearfield::structure::{GpuBruteForceMesh, GpuRayStructure};
use nearfield::{GpuKdTree, KdTree, KdTreeSettings, PreparedTriangles, Ray, RaySearch};

use super::BUILDS;
use super::meshes::{meshes, rays};
use super::support::gpu_trial;

/// Rays of each case.
const RAYS: usize = 2000;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("ropes_on_the_device_give_what_brute_force_gives_there", answers),
        gpu_trial("the_device_does_the_work_that_the_cpu_does", work),
        gpu_trial("kernels_of_ones_own_follow_the_ropes", own_kernel),
    ]
}

fn answers(gpu: &Gpu) {
    for (name, mesh) in meshes() {
        let triangles = PreparedTriangles::new(&mesh).unwrap();
        let reference = GpuBruteForceMesh::of(gpu, triangles.clone()).unwrap();
        for settings in [BUILDS[0], KdTreeSettings::DEFAULT] {
            let on_cpu = KdTree::of(triangles.clone(), &settings).unwrap();
            let tree = GpuKdTree::upload(gpu, &on_cpu).unwrap();
            let rays = rays(&mesh, &on_cpu, RAYS);
            let case = |i: usize| format!("{name}, {:?}: ray {i} {:?}", settings.build, rays[i]);
            let (found, expected) = (tree.closest_hits(&rays).unwrap(), reference.closest_hits(&rays).unwrap());
            let (any, expected_any) = (tree.any_hits(&rays).unwrap(), reference.any_hits(&rays).unwrap());
            let (all, expected_all) = (tree.all_hits(&rays).unwrap(), reference.all_hits(&rays).unwrap());
            for i in 0..rays.len() {
                assert_eq!(found.records()[i], expected.records()[i], "{}", case(i));
                assert_eq!(any.is_hit(i), expected_any.is_hit(i), "{}", case(i));
                assert_eq!(all.row(i), expected_all.row(i), "{}", case(i));
            }
        }
    }
}

fn work(gpu: &Gpu) {
    let (_, mesh) = meshes().swap_remove(4);
    let on_cpu = KdTree::build(&mesh, &KdTreeSettings::DEFAULT).unwrap();
    let tree = GpuKdTree::upload(gpu, &on_cpu).unwrap();
    let rays = rays(&mesh, &on_cpu, RAYS);
    let (_, on_host) = on_cpu.closest_hits_with_work(&rays).unwrap();
    let (_, on_device) = tree.closest_hits_with_work(&rays).unwrap();
    let same = on_host.iter().zip(&on_device).filter(|(a, b)| a == b).count();
    // Where a plane is met within rounding, the two may pass it a leaf sooner or later.
    assert!(same >= rays.len() * 95 / 100, "{same} of {} rays took the same work", rays.len());
}

/// A kernel of one's own: how far, in all, a ray runs through odd and even crossings. It imports the walk.
const THICKNESS: &str = "
import package::geometry::prepared_ray::{Ray, RaySpace, prepare};
import package::structure::hit_visitor::HitState;
import package::structure::kd_tree::ropes::trace;
import package::structure::ray_work::RayWork;

@group(0) @binding(0) var<storage, read_write> answers: array<vec2<f32>>;
@group(0) @binding(1) var<storage, read> rays: array<Ray>;
@group(0) @binding(2) var<uniform> space: RaySpace;

@compute @workgroup_size(64)
fn measure(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&rays) {
        return;
    }
    let ray = prepare(rays[id.x], space);
    var state = HitState(ray.t_min, ray.t_max, ray.shift, ray.scale, 0.0, 0.0);
    var work = RayWork(0u, 0u, 0u, 0u);
    if ray.t_min <= ray.t_max {
        trace(ray, &state, &work);
    }
    answers[id.x] = vec2<f32>(state.crossings, state.sum);
}
";

/// What it does with the hits.
const SUM_OF_HITS: &str = "
import package::geometry::prepared_triangle::LocalHit;

struct HitState {
    t_min: f32,
    t_max: f32,
    shift: f32,
    scale: f32,
    crossings: f32,
    sum: f32,
}

fn limit(state: ptr<function, HitState>) -> f32 {
    return (*state).t_max;
}

fn offer(state: ptr<function, HitState>, hit: LocalHit, leave: f32) -> bool {
    if hit.t >= (*state).t_min && hit.t <= (*state).t_max && hit.t < leave {
        (*state).crossings += 1.0;
        (*state).sum += (hit.t + (*state).shift) * (*state).scale;
    }
    return true;
}
";

fn own_kernel(gpu: &Gpu) {
    let (_, mesh) = meshes().swap_remove(4);
    let on_cpu = KdTree::build(&mesh, &KdTreeSettings::DEFAULT).unwrap();
    let tree = GpuKdTree::upload(gpu, &on_cpu).unwrap();
    // Towards the centre of the shells, from everywhere.
    let rays: Vec<Ray> = rays(&mesh, &on_cpu, 10 * RAYS)
        .iter()
        .step_by(10)
        .map(|ray| Ray::new(ray.origin, 0.1 * ray.direction - ray.origin))
        .collect();

    let answers: Buffer<[f32; 2]> = gpu.buffer("answers", rays.len()).unwrap();
    let ray_buffer = gpu.upload("rays", &rays).unwrap();
    let space = gpu.uniform("space", tree.triangles().space()).unwrap();
    let mut accesses = vec![Access::ReadWrite, Access::Read, Access::Uniform];
    let mut binds: Vec<Bind> = vec![(&answers).into(), (&ray_buffer).into(), (&space).into()];
    for (access, bind) in tree.bindings() {
        accesses.push(access);
        binds.push(bind);
    }
    // Both forms of the walk, whichever the device needs; `tree.features()` names that one.
    for short_loops in [false, true] {
        let features = [("short_loops", short_loops), ("count_work", false)];
        let kernel = Kernel {
            fills: &[
                ("package::user::thickness", Fill::Caller(THICKNESS)),
                ("package::structure::hit_visitor", Fill::Caller(SUM_OF_HITS)),
            ],
            features: &features,
            ..Kernel::new("package::user::thickness", "measure", &accesses, 64)
        };
        let pipeline = gpu.pipeline(&kernel).unwrap();
        let mut commands = gpu.commands("thickness");
        commands.stage("measure");
        commands.dispatch(&pipeline, &binds, Workgroups::Covering(rays.len() as u64));
        commands.run().unwrap();

        let found = gpu.read(&answers).unwrap();
        let expected = on_cpu.all_hits(&rays).unwrap();
        let mut crossed = 0;
        for (i, &[crossings, sum]) in found.iter().enumerate() {
            let row = expected.row(i);
            let total: f32 = row.iter().map(|hit| hit.t).sum();
            let size: f32 = row.iter().map(|hit| hit.t.abs()).sum();
            assert_eq!(crossings, row.len() as f32, "ray {i} {:?}", rays[i]);
            assert!((sum - total).abs() <= 1e-4 * (1.0 + size), "ray {i}: {sum} and {total}");
            crossed += usize::from(!row.is_empty());
        }
        assert!(crossed > rays.len() / 4, "{crossed} rays cross a shell");
    }
}
