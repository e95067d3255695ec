//! Dual contouring on the CPU against closed forms: topology of any signs, exact corners, Euler numbers, borders.

use std::collections::BTreeSet;

use nearfield::application::{
    Contour, ContourSettings, FunctionHermite, NodeValues, PointsHermite, Watch, contour, contour_with,
};
use nearfield::geometry::mesh_intersections::self_intersections;
use nearfield::geometry::mesh_topology::MeshTopology;
use nearfield::geometry::{DistanceGrid, RegularGrid, Scalar};
use nearfield::structure::{AabbTreeN, AabbTreeNSettings};
use nearfield::{DVec3, Error, Vec3};

use crate::solids::{Random, RotatedCube, double_torus, grid_over, torus};

const GRIDS: u64 = 1000;
const SIDE: u32 = 10;

/// Values at the nodes of a grid with spacing 1 and its corner at 0.
fn unit_grid(nodes: [u32; 3]) -> RegularGrid {
    RegularGrid::new(DVec3::ZERO, Vec3::ZERO, 1.0, nodes).unwrap()
}

fn values_of<T: Scalar>(grid: &RegularGrid, of: impl Fn([f64; 3]) -> f64) -> Vec<T> {
    let position = |node: [u32; 3]| [0, 1, 2].map(|axis| grid.coordinate(axis, node[axis]));
    (0..grid.n_nodes()).map(|i| T::of(of(position(grid.node(i).unwrap())))).collect()
}

fn run<T: Scalar>(grid: &RegularGrid, values: &[T], settings: &ContourSettings) -> Contour<T> {
    contour(&NodeValues::new(grid, values).unwrap(), settings, &mut Watch::none()).unwrap()
}

fn is_border(grid: &RegularGrid, node: [u32; 3]) -> bool {
    (0..3).any(|axis| node[axis] == 0 || node[axis] + 1 == grid.nodes()[axis])
}

/// Random values, some of them 0; those of the border are positive where the surface shall be closed.
fn random_values(grid: &RegularGrid, closed: bool, seed: u64) -> Vec<f32> {
    let mut random = Random::new(seed);
    let value = |i: usize| {
        let value = if random.unit() < 0.02 { 0.0 } else { 2.0 * random.unit() as f32 - 1.0 };
        if closed && is_border(grid, grid.node(i).unwrap()) { value.abs() + 0.01 } else { value }
    };
    (0..grid.n_nodes()).map(value).collect()
}

/// Corners inside of the cell at a node and of the next one along an axis, if both are in the grid.
fn inside(grid: &RegularGrid, values: &[f32], node: [u32; 3]) -> Option<u8> {
    let mut set = 0;
    for corner in 0..8u32 {
        let at = [node[0] + (corner & 1), node[1] + (corner >> 1 & 1), node[2] + (corner >> 2)];
        set |= u8::from(values[grid.number(at)?] < 0.0) << corner;
    }
    Some(set)
}

#[test]
fn a_thousand_random_sign_grids_are_closed_manifold_and_oriented() {
    let grid = unit_grid([SIDE; 3]);
    let (mut cases, mut pairs) = (BTreeSet::new(), BTreeSet::new());
    for seed in 0..GRIDS {
        let values = random_values(&grid, true, seed);
        for i in 0..grid.n_nodes() {
            let node = grid.node(i).unwrap();
            let Some(own) = inside(&grid, &values, node) else { continue };
            cases.insert(own);
            for axis in 0..3 {
                let mut beyond = node;
                beyond[axis] += 1;
                pairs.extend(inside(&grid, &values, beyond).map(|next| (axis, own, next)));
            }
        }
        let mesh = run(&grid, &values, &ContourSettings::features()).mesh();
        let topology = MeshTopology::of(&mesh);
        let sound = topology.is_closed() && topology.is_manifold() && topology.is_oriented();
        assert!(sound, "seed {seed}: {topology:?}");
        assert_eq!(topology.vertices, mesh.vertices.len() as u64, "seed {seed}: a vertex without a triangle");
        assert!(topology.euler_number() <= 2 * topology.components as i64, "seed {seed}");
    }
    // Two cells side by side have twelve corners, along each of three axes.
    assert_eq!((cases.len(), pairs.len()), (256, 3 << 12));
}

#[test]
fn random_sign_grids_do_not_intersect_themselves_in_the_default_mode() {
    let grid = unit_grid([SIDE; 3]);
    for seed in 0..GRIDS {
        let values = random_values(&grid, true, seed);
        let surface = run(&grid, &values, &ContourSettings::default());
        let pairs = self_intersections(&surface.mesh());
        let report = surface.report();
        assert_eq!((pairs.len(), report.intersections, report.flipped), (0, 0, 0), "seed {seed}: {report:?}");
    }
}

#[test]
fn open_and_undefined_grids_are_manifold_with_a_border() {
    let grid = unit_grid([SIDE; 3]);
    for seed in 0..GRIDS {
        let mut values = random_values(&grid, false, seed);
        let mut random = Random::new(seed + 77);
        values.iter_mut().filter(|_| random.unit() < 0.1).for_each(|value| *value = f32::NAN);
        let surface = run(&grid, &values, &ContourSettings::features());
        let topology = MeshTopology::of(&surface.mesh());
        assert!(topology.is_manifold() && topology.is_oriented(), "seed {seed}: {topology:?}");
        assert!(topology.boundary_loops > 0 && topology.boundary_length > 0.0);
        assert_eq!(surface.n_quads(), interior_crossings(&grid, &values), "seed {seed}");
    }
}

/// Edges of the grid off its border with a negative value at one end and another at the other.
fn interior_crossings(grid: &RegularGrid, values: &[f32]) -> usize {
    let mut n = 0;
    for i in 0..grid.n_nodes() {
        let node = grid.node(i).unwrap();
        for axis in 0..3 {
            let mut last = node;
            last[axis] += 1;
            let Some(end) = grid.number(last) else { continue };
            let (a, b) = (values[i], values[end]);
            let across = (0..3).filter(|&other| other != axis);
            let inner = across.into_iter().all(|other| node[other] > 0 && node[other] + 1 < grid.nodes()[other]);
            n += usize::from(inner && !a.is_nan() && !b.is_nan() && (a < 0.0) != (b < 0.0));
        }
    }
    n
}

#[test]
fn corners_of_a_rotated_cube_are_exact_in_feature_mode() {
    let cube = RotatedCube::new(0.7);
    let grid = grid_over(1.3, 65);
    let values: Vec<f64> = values_of(&grid, |p| cube.distance(p));
    let hermite = FunctionHermite { value: |p| cube.distance(p), gradient: |p| cube.gradient(p) };
    let input = NodeValues::new(&grid, &values).unwrap();
    let surface = contour_with(&input, &hermite, &ContourSettings::features(), &mut Watch::none()).unwrap();
    let width = f64::from(grid.spacing());
    for corner in cube.corners() {
        let off = surface.vertices().iter().map(|v| (DVec3::from(*v) - corner).length()).fold(f64::INFINITY, f64::min);
        assert!(off < 1e-6 * width, "{corner}: {} widths", off / width);
    }
    // Every vertex is on the surface, and so is every point of a crease.
    let worst = surface.vertices().iter().map(|v| cube.distance(*v).abs()).fold(0.0, f64::max);
    assert!(worst < 1e-6 * width, "{} widths", worst / width);
    let topology = MeshTopology::of(&surface.mesh());
    assert!(topology.is_closed() && topology.is_manifold() && topology.euler_number() == 2);
    let volume = volume(&surface);
    assert!((volume / (1.4f64.powi(3)) - 1.0).abs() < 2e-3, "{volume}");
}

#[test]
fn f32_has_the_corners_too() {
    let cube = RotatedCube::new(0.7);
    let grid = grid_over(1.3, 65);
    let values: Vec<f32> = values_of(&grid, |p| cube.distance(p));
    let hermite = FunctionHermite {
        value: |p: [f32; 3]| cube.distance(p.map(f64::from)) as f32,
        gradient: |p: [f32; 3]| cube.gradient(p.map(f64::from)).map(|x| x as f32),
    };
    let input = NodeValues::new(&grid, &values).unwrap();
    let surface = contour_with(&input, &hermite, &ContourSettings::features(), &mut Watch::none()).unwrap();
    for corner in cube.corners() {
        let off = |v: &[f32; 3]| (DVec3::from(v.map(f64::from)) - corner).length();
        let off = surface.vertices().iter().map(off).fold(f64::INFINITY, f64::min);
        // Coordinates up to 1.3 carry 6e-8 each, some thirty widths of 0.04 from the origin.
        assert!(off < 2e-5 * f64::from(grid.spacing()), "{corner}: {off}");
    }
}

fn volume<T: Scalar>(surface: &Contour<T>) -> f64 {
    let at = |v: u32| DVec3::from(surface.vertices()[v as usize].map(|x| x.to_f64()));
    surface.triangles().iter().map(|&[a, b, c]| at(a).dot(at(b).cross(at(c))) / 6.0).sum()
}

#[test]
fn sphere_torus_and_double_torus_have_their_euler_numbers() {
    let grid = grid_over(1.6, 97);
    let sphere = |p: [f64; 3]| DVec3::from(p).length() - 1.0;
    #[allow(clippy::type_complexity, reason = "a name, a field and its Euler number")]
    let cases: [(&str, &dyn Fn([f64; 3]) -> f64, i64); 3] =
        [("sphere", &sphere, 2), ("torus", &torus, 0), ("double torus", &double_torus, -2)];
    for (name, of, euler) in cases {
        let values: Vec<f32> = values_of(&grid, of);
        for settings in [ContourSettings::default(), ContourSettings::features()] {
            let surface = run(&grid, &values, &settings);
            let mesh = surface.mesh();
            let topology = MeshTopology::of(&mesh);
            assert!(topology.is_closed() && topology.is_manifold() && topology.is_oriented(), "{name}: {topology:?}");
            assert_eq!((topology.euler_number(), topology.components), (euler, 1), "{name}");
            assert!(volume(&surface) > 0.0, "{name} is inside out");
            let is_default = settings == ContourSettings::default();
            assert!(!is_default || self_intersections(&mesh).is_empty(), "{name}");
        }
    }
}

#[test]
fn a_sphere_is_met_to_a_hundredth_of_a_width() {
    // Measured for exact fields of 65³: 0.0103 widths, limited by curvature.
    let grid = grid_over(1.25, 65);
    let values: Vec<f64> = values_of(&grid, |p| DVec3::from(p).length() - 1.0);
    let surface = run(&grid, &values, &ContourSettings::default());
    let width = f64::from(grid.spacing());
    let off = |v: &[f64; 3]| (DVec3::from(*v).length() - 1.0) / width;
    let rms = (surface.vertices().iter().map(|v| off(v).powi(2)).sum::<f64>() / surface.vertices().len() as f64).sqrt();
    println!("sphere: {rms:.4} widths");
    assert!(rms < 0.012, "{rms}");
}

#[test]
fn normals_of_points_keep_the_creases_that_the_field_has_lost() {
    // Points on the faces of a cube with their normals; the field is that of the nearest plane.
    let cube = RotatedCube::new(0.7);
    let (points, normals) = cube.samples(60);
    let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default()).unwrap();
    let grid = grid_over(1.3, 49);
    let values: Vec<f64> = values_of(&grid, |p| cube.distance(p));
    let input = NodeValues::new(&grid, &values).unwrap();
    let hermite = PointsHermite::new(&tree, &normals).unwrap();
    let surface = contour_with(&input, &hermite, &ContourSettings::features(), &mut Watch::none()).unwrap();
    let width = f64::from(grid.spacing());
    for corner in cube.corners() {
        let off = surface.vertices().iter().map(|v| (DVec3::from(*v) - corner).length()).fold(f64::INFINITY, f64::min);
        // Linear interpolation over the kinks beside a corner costs up to 0.3 widths.
        assert!(off < 0.3 * width, "{corner}: {} widths", off / width);
    }
    assert!(PointsHermite::new(&tree, &normals[1..]).is_err());
}

#[test]
fn creases_of_a_sampled_distance_field_stay() {
    let cube = RotatedCube::new(0.7);
    let grid = grid_over(1.3, 65);
    let values: Vec<f32> = values_of(&grid, |p| cube.distance(p));
    let surface = run(&grid, &values, &ContourSettings::default());
    let width = f64::from(grid.spacing());
    let mut errors: Vec<f64> =
        surface.vertices().iter().map(|v| cube.distance(v.map(f64::from)).abs() / width).collect();
    errors.sort_by(f64::total_cmp);
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    let corner = |c: DVec3| {
        let off = |v: &[f32; 3]| (DVec3::from(v.map(f64::from)) - c).length() / width;
        surface.vertices().iter().map(off).fold(f64::INFINITY, f64::min)
    };
    let worst_corner = cube.corners().into_iter().map(corner).fold(0.0, f64::max);
    println!("cube, linear interpolation: RMS {rms:.4}, corner {worst_corner:.3} widths, {:?}", surface.report());
    // Surface nets have 0.040 and 0.86; dual contouring with linear interpolation and exact normals 0.0063 and 0.30.
    assert!(rms < 0.02 && worst_corner < 0.6, "{rms} {worst_corner}");
    assert!(self_intersections(&surface.mesh()).is_empty());
}

#[test]
fn holes_in_the_data_are_a_reported_border() {
    let grid = grid_over(1.25, 33);
    let sphere = |p: [f64; 3]| DVec3::from(p).length() - 1.0;
    // Two holes: caps without values.
    let values: Vec<f32> = values_of(&grid, |p| if p[2].abs() > 0.8 { f64::NAN } else { sphere(p) });
    let topology = MeshTopology::of(&run(&grid, &values, &ContourSettings::default()).mesh());
    assert!(topology.is_manifold() && topology.is_oriented() && !topology.is_closed());
    assert_eq!((topology.boundary_loops, topology.euler_number()), (2, 0));
    // Rims between the circles of the caps and of the last layer with values, in steps along the axes at most 4/π as long.
    let circle = |z: f64| std::f64::consts::TAU * (1.0 - z * z).sqrt();
    let (least, most) = (2.0 * circle(0.8), 2.0 * circle(0.7) * 4.0 / std::f64::consts::PI);
    assert!((least..most).contains(&topology.boundary_length), "{} of {least} to {most}", topology.boundary_length);
}

#[test]
fn grids_without_a_surface_give_an_empty_mesh() {
    for (name, value) in [("inside", -1.0), ("outside", 1.0), ("undefined", f64::NAN), ("zero", 0.0)] {
        for nodes in [[2, 2, 2], [2, 9, 3], [5, 5, 5]] {
            let grid = unit_grid(nodes);
            let values: Vec<f32> = values_of(&grid, |_| value);
            let surface = run(&grid, &values, &ContourSettings::default());
            assert_eq!((surface.vertices().len(), surface.n_quads()), (0, 0), "{name} {nodes:?}");
            assert_eq!(surface.mesh().triangles.len(), 0);
        }
    }
}

#[test]
fn one_layer_of_cells_has_no_polygon_but_where_four_cells_meet() {
    // Cells side by side along x and y only: edges along z have four.
    let grid = unit_grid([4, 4, 2]);
    let values: Vec<f32> = values_of(&grid, |p| if p[2] > 0.5 { 1.0 } else { -1.0 });
    let surface = run(&grid, &values, &ContourSettings::default());
    assert_eq!((surface.n_quads(), surface.vertices().len()), (4, 9));
    let topology = MeshTopology::of(&surface.mesh());
    assert!(topology.is_manifold() && topology.boundary_loops == 1 && topology.boundary_length == 8.0);
    assert!(surface.vertices().iter().all(|v| v[2] == 0.5));
    let upright: Vec<f32> = values_of(&grid, |p| p[0] - 1.5);
    assert_eq!(run(&grid, &upright, &ContourSettings::default()).n_quads(), 0);
    assert!(RegularGrid::new(DVec3::ZERO, Vec3::ZERO, 1.0, [5, 5, 1]).is_err(), "a grid has two nodes an axis");
}

#[test]
fn a_surface_that_leaves_the_grid_is_open_there() {
    let grid = grid_over(0.9, 33);
    let values: Vec<f32> = values_of(&grid, |p| DVec3::from(p).length() - 1.0);
    let topology = MeshTopology::of(&run(&grid, &values, &ContourSettings::default()).mesh());
    // The ball reaches through all six faces of the grid.
    assert!(topology.is_manifold() && topology.is_oriented());
    assert_eq!((topology.boundary_loops, topology.components, topology.euler_number()), (6, 1, 2 - 6));
    // Touching the border from inside: the last layer of nodes is outside.
    let grid = grid_over(1.0, 33);
    let values: Vec<f32> = values_of(&grid, |p| DVec3::from(p).length() - 1.0);
    assert!(MeshTopology::of(&run(&grid, &values, &ContourSettings::default()).mesh()).is_closed());
}

#[test]
fn values_of_exactly_zero_count_as_outside() {
    // A plane through nodes, and a ball whose only node inside touches six zeros.
    let grid = unit_grid([6, 6, 6]);
    let plane: Vec<f32> = values_of(&grid, |p| p[2] - 2.0);
    let surface = run(&grid, &plane, &ContourSettings::default());
    assert!(surface.n_quads() == 16 && surface.vertices().iter().all(|v| v[2] == 2.0));
    let point: Vec<f32> = values_of(&grid, |p| {
        let off = [2.0, 3.0, 2.0];
        let steps: f64 = (0..3).map(|a| f64::abs(p[a] - off[a])).sum();
        if steps == 0.0 { -1.0 } else { (steps - 1.0) * 0.5 }
    });
    let surface = run(&grid, &point, &ContourSettings::default());
    let topology = MeshTopology::of(&surface.mesh());
    assert!(topology.is_closed() && topology.is_manifold() && topology.euler_number() == 2);
    // A negative number and zeros around it: all crossings of each edge at its far end, and all triangles with an area.
    let tiny: Vec<f32> = values_of(&grid, |p| if p == [2.0, 3.0, 2.0] { -0.0 } else { 0.0 });
    assert_eq!(run(&grid, &tiny, &ContourSettings::default()).n_quads(), 0, "-0 is no negative number");
    let hole: Vec<f32> = values_of(&grid, |p| if p == [2.0, 3.0, 2.0] { 0.0 } else { -1.0 });
    let surface = run(&grid, &hole, &ContourSettings::default());
    let report = surface.report();
    assert!(report.flipped == 0 && report.intersections == 0 && report.rounded > 0, "{report:?}");
    assert_eq!(MeshTopology::of(&surface.mesh()).euler_number(), 2);
}

#[test]
fn the_same_bytes_come_out_of_one_thread_and_of_many() {
    let grid = grid_over(1.6, 49);
    let values: Vec<f32> = values_of(&grid, double_torus);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&grid, &values, &ContourSettings::default()))
    };
    let (one, many) = (with(1), with(7));
    assert!(one == many && !one.vertices().is_empty());
}

#[test]
fn what_cannot_be_contoured_says_why() {
    let grid = unit_grid([3; 3]);
    let values = vec![1.0f32; 27];
    assert!(matches!(NodeValues::new(&grid, &values[1..]), Err(Error::LengthMismatch { expected: 27, .. })));
    let input = NodeValues::new(&grid, &values).unwrap();
    for threshold in [-0.1, 1.0, f64::NAN] {
        let settings = ContourSettings { threshold, ..ContourSettings::default() };
        let error = contour(&input, &settings, &mut Watch::none()).unwrap_err();
        assert!(error.to_string().contains("eigenvalue threshold"), "{error}");
    }
    let mut stop = |_| std::ops::ControlFlow::Break(());
    let stopped = contour(&input, &ContourSettings::default(), &mut Watch::new(&mut stop));
    assert!(matches!(stopped, Err(Error::Interrupted { .. })));
    let field = DistanceGrid::undefined(grid).unwrap();
    assert!(contour(&(&field).into(), &ContourSettings::default(), &mut Watch::none()).unwrap().vertices().is_empty());
}
