//! Visitors over queries that are on the device already, and the eigenvectors that kernels compute.

use libtest_mimic::Trial;
use nearfield::geometry::symmetric_eigen::Symmetric;
use nearfield::geometry::vector;
use nearfield::gpu::shader::Fill;
use nearfield::gpu::{Access, Buffer, Gpu, Kernel, Workgroups};
use nearfield::structure::GpuStructure;
use nearfield::{
    AabbTreeSettings, DeviceQueries, Error, ForEachOnDevice, GpuAabbTree, GpuBruteForce, GpuUniformGrid, GridSettings,
    TreeSearch, Vec3, Visitor,
};

use crate::support::{Random, gpu_trial};
use crate::{RADIUS, lattice_points, rows_by_loop};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("queries_on_the_device_meet_what_a_loop_meets", queries_meet_what_a_loop_meets),
        gpu_trial("wrong_queries_on_the_device_are_errors", wrong_queries_are_errors),
        gpu_trial("a_kernels_eigenvectors_are_those_of_the_cpu", eigenvectors_are_those_of_the_cpu),
    ]
}

/// Sums of squared distances, whole on the lattice in this unit, and of ones.
const SUM: &str = "
import package::structure::question::{Query, Neighbor};
@group(1) @binding(0) var<storage, read_write> sums: array<u32>;
struct State { sum: u32 }
fn begin(query: Query) -> State { return State(0u); }
fn visit(state: ptr<function, State>, query: Query, neighbor: Neighbor) -> bool {
    (*state).sum += u32(neighbor.dist2 * 16384.0) + 1u;
    return true;
}
fn combine(state: ptr<function, State>, other: State) { (*state).sum += other.sum; }
fn finish(state: ptr<function, State>, query: Query) { sums[query.slot] = (*state).sum; }
";

fn sums<S: GpuStructure>(structure: &S, queries: &DeviceQueries<'_>) -> Vec<u32> {
    let gpu = structure.gpu();
    let sums = gpu.upload("poisoned sums", &vec![0xdead_beefu32; queries.points.len()]).unwrap();
    let bindings = [(Access::ReadWrite, (&sums).into())];
    let run = |visitor: &Visitor<'_>| {
        let mut commands = gpu.commands("sum");
        structure.record_for_each(&mut commands, queries, visitor).unwrap();
        commands.run().unwrap();
        gpu.read(&sums).unwrap()
    };
    let alone = run(&Visitor::new(SUM, &bindings));
    gpu.write(&sums, 0, &vec![0xdead_beefu32; queries.points.len()]).unwrap();
    assert_eq!(run(&Visitor::combining(SUM, &bindings)), alone, "invocations that share queries");
    alone
}

fn queries_meet_what_a_loop_meets(gpu: &Gpu) {
    let points = lattice_points(3000);
    let queries: Vec<Vec3> = lattice_points(777).iter().map(|&p| p + Vec3::splat(1.0 / 128.0)).collect();
    let radii: Vec<f32> = (0..777).map(|i| (i % 16) as f32 / 128.0).collect();
    // In an order that is not that of the slots.
    let packed = |i: usize| [queries[i].x, queries[i].y, queries[i].z, f32::from_bits(i as u32)];
    let on_device = gpu.upload("queries", &(0..777).rev().map(packed).collect::<Vec<_>>()).unwrap();
    let own_radii = gpu.upload("radii", &radii).unwrap();
    // Eight invocations share each of these, also on a software device.
    let few = gpu.upload("few queries", &(0..100).map(packed).collect::<Vec<_>>()).unwrap();
    let expected = |points: &[Vec3], queries: &[Vec3], radius: &dyn Fn(usize) -> f32, itself: bool| -> Vec<u32> {
        let rows = rows_by_loop(points, queries, RADIUS);
        let sum = |(i, row): (usize, &Vec<(u32, f32)>)| {
            let near = row.iter().filter(|&&(id, d2)| d2 <= radius(i) * radius(i) && (itself || id != i as u32));
            near.map(|&(_, d2)| (d2 * 16384.0) as u32 + 1).sum()
        };
        rows.iter().enumerate().map(sum).collect()
    };
    let one = DeviceQueries::new(&on_device, RADIUS);
    let check = |name: &str, ask: &dyn Fn(&DeviceQueries<'_>) -> Vec<u32>, own: &Buffer<[f32; 4]>| {
        assert_eq!(ask(&one), expected(&points, &queries, &|_| RADIUS, true), "{name}");
        let asked = ask(&DeviceQueries::new(&few, RADIUS));
        assert_eq!(asked, expected(&points, &queries[..100], &|_| RADIUS, true), "{name}, few");
        assert_eq!(ask(&one.radii(&own_radii)), expected(&points, &queries, &|i| radii[i], true), "{name}, radii");
        let itself = DeviceQueries::new(own, RADIUS).exclude_self();
        assert_eq!(ask(&itself), expected(&points, &points, &|_| RADIUS, false), "{name}, itself");
    };
    let grid = GpuUniformGrid::build(gpu, &points, &GridSettings::for_radius(RADIUS)).unwrap();
    check("grid", &|queries| sums(&grid, queries), grid.points());
    let brute_force = GpuBruteForce::build(gpu, &points).unwrap();
    check("brute force", &|queries| sums(&brute_force, queries), brute_force.points());
    for search in [TreeSearch::Primary, TreeSearch::Packed, TreeSearch::Coherent] {
        let settings = AabbTreeSettings { search, ..AabbTreeSettings::default() };
        let tree = GpuAabbTree::build(gpu, &points, &settings).unwrap();
        check(&format!("{search:?}"), &|queries| sums(&tree, queries), GpuStructure::points(&tree));
    }
}

fn wrong_queries_are_errors(gpu: &Gpu) {
    let grid = GpuUniformGrid::build(gpu, &lattice_points(100), &GridSettings::for_radius(RADIUS)).unwrap();
    let visitor = Visitor::new(SUM, &[]);
    let mut commands = gpu.commands("nothing");
    let mut ask = |queries: &DeviceQueries<'_>| grid.record_for_each(&mut commands, queries, &visitor).unwrap_err();
    let bad_radius = ask(&DeviceQueries::new(grid.points(), f32::NAN));
    assert!(matches!(bad_radius, Error::InvalidRadius { .. }), "{bad_radius}");
    // 128 states of this size fit no workgroup's memory.
    let source = SUM.replace("{ sum: u32 }", "{ sum: u32, rest: array<u32, 100000> }");
    let source = source.replace("State(0u)", "State(0u, array<u32, 100000>())");
    let sums = gpu.upload("sums", &[0u32; 100]).unwrap();
    let bindings = [(Access::ReadWrite, (&sums).into())];
    let large = Visitor::combining(&source, &bindings);
    let refused =
        grid.record_for_each(&mut gpu.commands("nothing"), &DeviceQueries::new(grid.points(), RADIUS), &large);
    assert!(matches!(refused, Err(Error::Unsupported { .. })), "{refused:?}");
    let few = gpu.upload("radii", &[0.1f32; 99]).unwrap();
    let short = ask(&DeviceQueries::new(grid.points(), RADIUS).radii(&few));
    assert!(matches!(short, Error::LengthMismatch { found: 99, expected: 100, .. }), "{short}");
}

/// Eigenvalues, and the eigenvectors one after the other, of matrices given by diagonal and upper triangle.
const EIGEN: &str = "
import package::geometry::symmetric_eigen::symmetric_eigen;
@group(0) @binding(0) var<storage, read> matrices: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> found: array<vec4<f32>>;
@compute @workgroup_size(64)
fn decompose(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if 2u * i >= arrayLength(&matrices) { return; }
    let made = symmetric_eigen(matrices[2u * i].xyz, matrices[2u * i + 1u].xyz);
    found[4u * i] = vec4<f32>(made.values, 0.0);
    for (var k = 0u; k < 3u; k += 1u) { found[4u * i + 1u + k] = vec4<f32>(made.vectors[k], 0.0); }
}
";

fn eigenvectors_are_those_of_the_cpu(gpu: &Gpu) {
    let mut random = Random(7);
    let mut matrices: Vec<[f32; 6]> =
        (0..1000).map(|_| std::array::from_fn(|_| random.below(2001) as f32 / 1000.0 - 1.0)).collect();
    matrices.extend([
        [0.0; 6],
        [1.0, 0.0, 0.0, 1.0, 0.0, 1.0],
        [1.0, 1e-30, 0.0, 1e20, 1e-20, 3.0],
        [2.0, 1.0, 1.0, 2.0, 1.0, 2.0],
    ]);
    let packed: Vec<[f32; 4]> =
        matrices.iter().flat_map(|&[xx, xy, xz, yy, yz, zz]| [[xx, yy, zz, 0.0], [xy, xz, yz, 0.0]]).collect();
    let input = gpu.upload("matrices", &packed).unwrap();
    let output: Buffer<[f32; 4]> = gpu.buffer("eigenvectors", 4 * matrices.len()).unwrap();
    let fills = [("package::tests::eigen", Fill::Caller(EIGEN))];
    let accesses = [Access::Read, Access::ReadWrite];
    let kernel = Kernel { fills: &fills, ..Kernel::new("package::tests::eigen", "decompose", &accesses, 64) };
    let mut commands = gpu.commands("decompose");
    let covering = Workgroups::Covering(matrices.len() as u64);
    commands.dispatch(&gpu.pipeline(&kernel).unwrap(), &[(&input).into(), (&output).into()], covering);
    commands.run().unwrap();
    for (matrix, found) in matrices.iter().zip(gpu.read(&output).unwrap().chunks_exact(4)) {
        let (a, xyz) = (Symmetric(*matrix), |v: [f32; 4]| [v[0], v[1], v[2]]);
        let expected = a.eigen();
        let scale = expected.values.iter().fold(0.0f32, |most, value| most.max(value.abs()));
        for i in 0..3 {
            assert!((found[0][i] - expected.values[i]).abs() <= 2e-6 * scale, "{matrix:?}: {found:?}, {expected:?}");
            let v = xyz(found[1 + i]);
            let off = vector::norm(vector::subtract(a.times(v), vector::scale(v, found[0][i])));
            assert!(off <= 4e-6 * scale && (vector::norm(v) - 1.0).abs() < 4e-6, "{matrix:?}: {off}, {v:?}");
        }
    }
}
