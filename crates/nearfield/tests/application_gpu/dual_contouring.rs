//! Dual contouring on the device against the CPU: the same polygons, positions up to rounding.

use libtest_mimic::Trial;
use nearfield::application::{Contour, ContourSettings, GpuContour, NodeValues, Watch, contour, contour_on_gpu};
use nearfield::geometry::RegularGrid;
use nearfield::geometry::mesh_intersections::self_intersections;
use nearfield::geometry::mesh_topology::MeshTopology;
use nearfield::gpu::Gpu;
use nearfield::{DVec3, Error, Vec3};

use crate::solids::{Random, RotatedCube, double_torus, grid_over};
use crate::support::gpu_trial;

/// How two surfaces of one field differ: in what they consist of, or the share of vertices farther apart than 1e-5 of the
/// diagonal and of quads cut along different diagonals.
fn difference(here: &Contour<f32>, there: &Contour<f32>) -> Result<[f64; 2], String> {
    if !here.quads().eq(there.quads()) {
        return Err(format!("{} and {} polygons", here.n_quads(), there.n_quads()));
    }
    if !here.cells().eq(there.cells()) {
        return Err("vertices belong to other cells".to_owned());
    }
    let allowed = 1e-5 * here.grid().bounds().diagonal();
    let far = |(a, b): (&[f32; 3], &[f32; 3])| Vec3::from(*a).distance(Vec3::from(*b)) > allowed;
    let n_far = here.vertices().iter().zip(there.vertices()).filter(|pair| far(*pair)).count();
    let n_cut = here.triangles().iter().zip(&there.triangles()).step_by(2).filter(|(a, b)| a != b).count();
    Ok([n_far as f64 / here.vertices().len().max(1) as f64, n_cut as f64 / here.n_quads().max(1) as f64])
}

fn agree(gpu: &Gpu, name: &str, values: &NodeValues<'_, f32>) {
    for settings in [ContourSettings::features(), ContourSettings::default()] {
        let here = contour(values, &settings, &mut Watch::none()).unwrap();
        let there = contour_on_gpu(gpu, values, &settings, &mut Watch::none()).unwrap();
        let [far, cut] = difference(&here, &there).unwrap_or_else(|error| panic!("{name}: {error}"));
        println!("{name}, {:?}: {far:.5} of the vertices, {cut:.5} of the diagonals differ", settings.mode);
        assert!(far <= 1e-3 && cut <= 1e-2, "{name}: {far} {cut}");
    }
}

fn values_of(grid: &RegularGrid, of: impl Fn([f64; 3]) -> f64) -> Vec<f32> {
    let position = |node: [u32; 3]| [0, 1, 2].map(|axis| grid.coordinate(axis, node[axis]));
    (0..grid.n_nodes()).map(|i| of(position(grid.node(i).unwrap())) as f32).collect()
}

/// Smooth random values with holes: every kind of cell, without normals that rounding decides.
fn random_values(grid: &RegularGrid, undefined: f64, seed: u64) -> Vec<f32> {
    let mut random = Random::new(seed);
    let mut value = || if random.unit() < undefined { f32::NAN } else { 2.0 * random.unit() as f32 - 1.0 };
    (0..grid.n_nodes()).map(|_| value()).collect()
}

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials: Vec<Trial> = vec![];
    trials.push(gpu_trial("planted_differences_are_seen", |_| {
        let grid = grid_over(1.3, 25);
        let field = |radius: f64| values_of(&grid, move |p| DVec3::from(p).length() - radius);
        let of = |values: &[f32]| {
            let values = NodeValues::new(&grid, values).unwrap();
            contour(&values, &ContourSettings::features(), &mut Watch::none()).unwrap()
        };
        let (one, other, larger) = (of(&field(1.0)), of(&field(1.001)), of(&field(1.2)));
        assert_eq!(difference(&one, &one), Ok([0.0, 0.0]));
        assert!(difference(&one, &other).unwrap()[0] > 0.9);
        assert!(difference(&one, &larger).is_err());
    }));
    type Field = fn([f64; 3]) -> f64;
    let cube: Field = |p| RotatedCube::new(0.7).distance(p);
    let hole: Field = |p| if p[2] > 0.4 { f64::NAN } else { DVec3::from(p).length() - 1.0 };
    let solids: [(&str, Field); 3] =
        [("double_torus", double_torus), ("rotated_cube", cube), ("ball_with_a_hole", hole)];
    for (name, of) in solids {
        trials.push(gpu_trial(format!("{name}_is_that_of_the_cpu"), move |gpu| {
            let grid = grid_over(1.6, 40);
            let values = values_of(&grid, of);
            agree(gpu, name, &NodeValues::new(&grid, &values).unwrap());
        }));
    }
    trials.push(gpu_trial("random_signs_have_the_polygons_of_the_cpu", |gpu| {
        for (seed, undefined) in [(1, 0.0), (2, 0.05), (3, 0.3)] {
            let grid = RegularGrid::new(DVec3::ZERO, Vec3::ZERO, 1.0, [24, 17, 20]).unwrap();
            let values = random_values(&grid, undefined, seed);
            let values = NodeValues::new(&grid, &values).unwrap();
            let here = contour(&values, &ContourSettings::features(), &mut Watch::none()).unwrap();
            let there = contour_on_gpu(gpu, &values, &ContourSettings::features(), &mut Watch::none()).unwrap();
            // Random gradients make planes that meet far away, where rounding is large and the better of two diagonals is chance:
            // only what it consists of counts.
            let [far, cut] = difference(&here, &there).unwrap();
            println!("seed {seed}: {far:.4} of the vertices, {cut:.4} of the diagonals differ");
            assert!(here.n_quads() > 1000 && far < 0.05 && cut < 0.15, "{far} {cut}");
        }
    }));
    trials.push(gpu_trial("offset_levels_are_those_of_the_cpu", |gpu| {
        let grid = grid_over(1.9, 40);
        let values = values_of(&grid, double_torus);
        let values = NodeValues::new(&grid, &values).unwrap();
        for values in [values.at_level(0.2), values.at_level(-0.1), values.two_sided(0.15)] {
            agree(gpu, "offset", &values);
        }
    }));
    trials.push(gpu_trial("default_mode_does_not_intersect_itself", |gpu| {
        let grid = grid_over(1.6, 40);
        let values = values_of(&grid, |p| RotatedCube::new(0.7).distance(p));
        let values = NodeValues::new(&grid, &values).unwrap();
        let mesh = contour_on_gpu(gpu, &values, &ContourSettings::default(), &mut Watch::none()).unwrap().mesh();
        let topology = MeshTopology::of(&mesh);
        assert!(topology.is_closed() && topology.is_manifold() && topology.is_oriented());
        assert!(self_intersections(&mesh).is_empty());
    }));
    trials.push(gpu_trial("grids_without_a_surface_give_an_empty_mesh", |gpu| {
        for value in [-1.0f32, 1.0, 0.0, f32::NAN] {
            let grid = RegularGrid::new(DVec3::ZERO, Vec3::ZERO, 1.0, [2, 5, 3]).unwrap();
            let values = vec![value; grid.n_nodes()];
            let values = NodeValues::new(&grid, &values).unwrap();
            let surface = contour_on_gpu(gpu, &values, &ContourSettings::default(), &mut Watch::none()).unwrap();
            assert_eq!((surface.vertices().len(), surface.n_quads()), (0, 0), "{value}");
        }
    }));
    trials.push(gpu_trial("what_does_not_fit_is_refused", |gpu| {
        let grid = grid_over(1.0, 9);
        let short = gpu.upload("values", &[0.0f32; 5]).unwrap();
        let settings = ContourSettings::default();
        let refused = GpuContour::of(gpu, &grid, &short, 0.0, false, &settings);
        assert!(matches!(refused, Err(Error::LengthMismatch { expected: 729, .. })));
        let field = gpu.upload("values", &vec![1.0f32; 729]).unwrap();
        let bad = ContourSettings { threshold: 2.0, ..settings };
        assert!(matches!(GpuContour::of(gpu, &grid, &field, 0.0, false, &bad), Err(Error::InvalidSetting { .. })));
    }));
    trials
}
