//! Iterations of smoothing, timed as a whole and by search: with lists of a method and a fit over them, or without lists.

use std::time::Instant;

use nearfield::application::{PlaneSearch, Support};
use nearfield::gpu::Gpu;
use nearfield::structure::GridBuilder;
use nearfield::{
    AabbTreeSettings, BuildOrder, FixedRadius, GpuMlsSmoothing, GpuMovingPoints, GridSettings, MlsMethod, MlsSettings,
    MlsSmoothing, NeighborSearch, RebuildPolicy, TreeSearch, UniformGrid, Vec3,
};

use super::plane_fit::{self, FromLists};
use crate::Result;
use crate::check::Expected;
use crate::device::device_points;
use crate::paper::lab::Lab;
use crate::paper::methods::uniform_grid;
use crate::paper::methods::{Found, Judged, Plug, Positions, Start};

/// Points that are smoothed, and how long.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// Where they begin.
    pub points: &'a [Vec3],
    /// Radius of the neighbours.
    pub radius: f32,
    /// Iterations.
    pub iterations: usize,
    /// No further iteration is begun after so many seconds; at least one is made.
    pub seconds: f64,
}

/// What came out.
pub struct Smoothed {
    /// Iterations that were made.
    pub iterations: usize,
    /// Milliseconds in all, from points in host memory to points there.
    pub total: f64,
    /// Mean milliseconds of a search: bringing the structure to the points, and lists. `None` without lists.
    pub search: Option<f64>,
    /// How the last lists were judged.
    pub judged: Option<Judged>,
    /// Mean neighbours in the last iteration, itself included.
    pub mean_neighbors: f64,
    /// Where the points are.
    pub points: Vec<Vec3>,
    /// Where they were after the first iteration; empty where it was not made apart.
    pub first: Vec<Vec3>,
}

/// Smoothes with lists by a method.
///
/// # Errors
/// What the method returns; a wrong answer.
pub fn with_lists(lab: &Lab, plug: &Plug, task: Task<'_>, mean_neighbors: f64) -> Result<Smoothed> {
    let Some(gpu) = lab.gpu().filter(|_| plug.on_gpu) else {
        return by_lists(None, plug, task, mean_neighbors, |at, lists| {
            let moved = match lists {
                Found::OnHost(list) => plane_fit::from_lists(&at.host, task.radius, |i| list.row(i)),
                Found::Baseline { rows, .. } => plane_fit::from_lists(&at.host, task.radius, |i| rows.row(i)),
                _ => return Err("a loop over lists needs them on the host".into()),
            };
            Ok(Positions { host: moved, device: None })
        });
    };
    let fits = FromLists::new(gpu)?;
    let run = |task: Task<'_>| {
        by_lists(Some(gpu), plug, task, mean_neighbors, |at, lists| {
            let device = at.device.as_ref().ok_or("points should be on the device")?;
            // The points need not come back: searches on the device look at those there.
            Ok(Positions { host: Vec::new(), device: Some(fits.run(device, lists, task.radius)?) })
        })
    };
    // Kernels are made in a run that is not timed.
    let first = run(Task { iterations: 1, ..task })?.points;
    Ok(Smoothed { first, ..run(task)? })
}

/// Smoothes with lists by a method and a fit over them, which says where the points move.
fn by_lists(
    gpu: Option<&Gpu>,
    plug: &Plug,
    task: Task<'_>,
    mean_neighbors: f64,
    fit: impl Fn(&Positions, &Found) -> Result<Positions>,
) -> Result<Smoothed> {
    let begin = Instant::now();
    let mut at = Positions::new(gpu, task.points.to_vec())?;
    let mut method = (plug.make)(&Start { gpu, at: &at, radius: task.radius, mean_neighbors })?;
    let (mut searching, mut iterations) = (0.0, 0);
    let (last, lists) = loop {
        let start = Instant::now();
        if iterations > 0 {
            method.update(&at)?;
        }
        let lists = method.list(task.radius)?;
        searching += start.elapsed().as_secs_f64();
        iterations += 1;
        let moved = fit(&at, &lists)?;
        let last = std::mem::replace(&mut at, moved);
        if iterations >= task.iterations || begin.elapsed().as_secs_f64() > task.seconds {
            break (last, lists);
        }
    };
    let points = read(gpu, at)?;
    let total = 1e3 * begin.elapsed().as_secs_f64();
    let (judged, mean_neighbors) = judge(gpu, &lists, &read(gpu, last)?, task.radius)?;
    let search = Some(1e3 * searching / iterations as f64);
    Ok(Smoothed { iterations, total, search, judged: Some(judged), mean_neighbors, points, first: Vec::new() })
}

/// Where the points are, from the device where they are there.
fn read(gpu: Option<&Gpu>, at: Positions) -> Result<Vec<Vec3>> {
    let (Some(gpu), Some(device)) = (gpu, &at.device) else { return Ok(at.host) };
    Ok(gpu.read(device)?.iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect())
}

fn judge(gpu: Option<&Gpu>, lists: &Found, points: &[Vec3], radius: f32) -> Result<(Judged, f64)> {
    let expected = Expected::of(points, radius)?;
    Ok((lists.check(gpu, &expected)?, expected.mean()))
}

/// A way to smooth without lists.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fused {
    /// The library's smoothing on the CPU.
    OnCpu,
    /// The library's smoothing on the GPU by this search, over a tree that is refitted and never built anew.
    Tree(TreeSearch),
    /// Our visitor on a grid of so many cells a side, built anew in every iteration.
    FixedGrid(u32),
}

impl Fused {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Tree(TreeSearch::Coherent),
        Self::Tree(TreeSearch::Primary),
        Self::Tree(TreeSearch::Packed),
        Self::FixedGrid(256),
        Self::FixedGrid(128),
        Self::OnCpu,
    ];

    /// Name in rows and legends.
    pub fn name(self) -> String {
        match self {
            Self::OnCpu => "fused: tree, CPU".to_owned(),
            Self::Tree(TreeSearch::Coherent) => "fused: tree coherent, GPU".to_owned(),
            Self::Tree(TreeSearch::Primary) => "fused: tree primary, GPU".to_owned(),
            Self::Tree(_) => "fused: tree packed, GPU".to_owned(),
            Self::FixedGrid(cells) => format!("fused: grid of {cells}³ cells, GPU"),
        }
    }

    /// Whether the GPU does the work.
    pub fn is_on_gpu(self) -> bool {
        self != Self::OnCpu
    }

    /// Whether it fits heights over the plane.
    pub fn fits_heights(self) -> bool {
        matches!(self, Self::OnCpu | Self::Tree(_))
    }

    /// Smoothes with a height of this degree.
    ///
    /// # Errors
    /// What the library returns; `Unsupported` for degrees that it does not fit.
    pub fn run(self, lab: &Lab, task: Task<'_>, degree: u8) -> Result<Smoothed> {
        let method = MlsMethod::Pss { degree, plane: PlaneSearch::Fast };
        let settings = MlsSettings::new(method);
        match (self, lab.gpu()) {
            (Self::OnCpu, _) => fused_on_cpu(task, &settings),
            (Self::Tree(search), Some(gpu)) => {
                let first = fused_on_tree(gpu, search, Task { iterations: 1, ..task }, &settings)?.points;
                Ok(Smoothed { first, ..fused_on_tree(gpu, search, task, &settings)? })
            }
            (Self::FixedGrid(cells), Some(gpu)) if degree == 0 => {
                let first = fused_on_grid(gpu, cells, Task { iterations: 1, ..task })?.points;
                Ok(Smoothed { first, ..fused_on_grid(gpu, cells, task)? })
            }
            _ => {
                let what = format!("{} with a height of degree {degree}", self.name());
                Err(nearfield::Error::Unsupported { what, advice: "trees fit it, on a GPU where one is there" }.into())
            }
        }
    }
}

fn fused_on_cpu(task: Task<'_>, settings: &MlsSettings) -> Result<Smoothed> {
    let begin = Instant::now();
    let arrays: Vec<[f32; 3]> = task.points.iter().map(Vec3::to_array).collect();
    let mut smoothing = MlsSmoothing::new(&arrays, None, &Support::Radius(task.radius), settings)?;
    let (iterations, mean_neighbors) = iterate(task, begin, || Ok(smoothing.iterate()?.mean_neighbors))?;
    let points = smoothing.positions().iter().map(|p| Vec3::from_array(*p)).collect();
    let total = 1e3 * begin.elapsed().as_secs_f64();
    Ok(Smoothed { iterations, total, search: None, judged: None, mean_neighbors, points, first: Vec::new() })
}

fn fused_on_tree(gpu: &Gpu, search: TreeSearch, task: Task<'_>, settings: &MlsSettings) -> Result<Smoothed> {
    let begin = Instant::now();
    let tree = AabbTreeSettings::default().search(search).order(BuildOrder::Hilbert);
    let moving = GpuMovingPoints::new(gpu, task.points, task.radius, &tree, RebuildPolicy::Never)?;
    let mut smoothing = GpuMlsSmoothing::over(moving, None, &Support::Radius(task.radius), settings)?;
    let (iterations, mean_neighbors) = iterate(task, begin, || Ok(smoothing.iterate()?.mean_neighbors))?;
    let points = smoothing.points()?.positions;
    let total = 1e3 * begin.elapsed().as_secs_f64();
    Ok(Smoothed { iterations, total, search: None, judged: None, mean_neighbors, points, first: Vec::new() })
}

fn fused_on_grid(gpu: &Gpu, cells: u32, task: Task<'_>) -> Result<Smoothed> {
    let begin = Instant::now();
    let mut builder: GridBuilder = uniform_grid::fixed(gpu, task.points.len(), cells)?;
    let mut at = gpu.upload("points that move", &device_points(task.points))?;
    let (iterations, _) = iterate(task, begin, || {
        let grid = builder.build(&at)?;
        at = plane_fit::without_lists(&grid, task.radius)?;
        Ok(0.0)
    })?;
    let points: Vec<Vec3> = gpu.read(&at)?.iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect();
    let total = 1e3 * begin.elapsed().as_secs_f64();
    let mean_neighbors = Expected::of(&points, task.radius)?.mean();
    Ok(Smoothed { iterations, total, search: None, judged: None, mean_neighbors, points, first: Vec::new() })
}

/// Points after one iteration on the CPU: planes from lists of a grid, higher degrees by the library.
///
/// # Errors
/// As the grid and the smoothing.
pub fn one_iteration(task: Task<'_>, degree: u8) -> Result<Vec<Vec3>> {
    if degree == 0 {
        let grid = UniformGrid::build(task.points, &GridSettings::for_radius(task.radius))?;
        let lists = grid.list(&FixedRadius::new(task.radius))?;
        return Ok(plane_fit::from_lists(task.points, task.radius, |i| lists.row(i)));
    }
    let settings = MlsSettings::new(MlsMethod::Pss { degree, plane: PlaneSearch::Fast });
    Ok(fused_on_cpu(Task { iterations: 1, ..task }, &settings)?.points)
}

/// Iterations that were made, and what the last one returned.
fn iterate(task: Task<'_>, begin: Instant, mut one: impl FnMut() -> Result<f64>) -> Result<(usize, f64)> {
    for iterations in 1.. {
        let told = one()?;
        if iterations >= task.iterations || begin.elapsed().as_secs_f64() > task.seconds {
            return Ok((iterations, told));
        }
    }
    unreachable!("there are fewer iterations than numbers")
}

/// Points may be so far from where another exact search has them, in parts of the diagonal, but for this share of them, where
/// a neighbour at the radius may count or not.
const APART: f64 = 1e-4;
const MOST_APART: f64 = 1e-3;

/// Checks that points are where another exact search has brought them.
///
/// # Errors
/// A share of points that are elsewhere.
pub fn check_points(found: &[Vec3], expected: &[Vec3], diagonal: f64) -> Result<()> {
    let is_apart = |(a, b): &(&Vec3, &Vec3)| {
        let distance = f64::from(a.distance(**b));
        // Also where one is not a number.
        distance.partial_cmp(&(APART * diagonal)) != Some(std::cmp::Ordering::Less)
    };
    let apart = found.iter().zip(expected).filter(is_apart).count();
    let most = (MOST_APART * expected.len() as f64).ceil() as usize;
    if found.len() != expected.len() || apart > most {
        let n = expected.len();
        return Err(format!("wrong answer: {apart} of {n} points are not where another search has brought them").into());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_elsewhere_are_caught() {
        let points: Vec<Vec3> = (0..2000).map(|i| Vec3::new(i as f32, 0.5, 0.25)).collect();
        check_points(&points, &points, 10.0).expect("the same points");
        let mut few = points.clone();
        few[7].x += 0.5;
        check_points(&few, &points, 10.0).expect("one in two thousand");
        few[1..8].iter_mut().for_each(|p| p.x = f32::NAN);
        assert!(check_points(&few, &points, 10.0).is_err() && check_points(&points[1..], &points, 10.0).is_err());
    }
}
