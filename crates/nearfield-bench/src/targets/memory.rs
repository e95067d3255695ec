//! How much memory structures and answers take: at the peak on the device, and what structures of the CPU hold.
//!
//! Peaks hold everything that is on the device at once: the caller's points (16 bytes each), the structure, scratch memory and the
//! answer. Memory of buffers that were given back and are kept for the next ones is not counted.

use nearfield::gpu::Gpu;
use nearfield::parallel::reduce;
use nearfield::query::NeighborSearch;
use nearfield::structure::{AabbTreeBuilder, GpuStructure, GridBuilder, OctreeBuilder};
use nearfield::{
    AabbTree, AabbTreeSettings, BruteForce, BuildOrder, Domain, FixedRadius, GpuBruteForce, GpuNearestNeighbors,
    GridSettings, Knn, LinearOctree, OctreeSettings, SearchOnDevice, UniformGrid,
};

use super::bench::{Bench, Points};
use super::row::{Figure, Memory, Outcome};
use crate::Result;
use crate::check::Expected;
use crate::device::{NEAREST, timed};
use crate::measure::Effort;

/// Nothing is timed.
const ONCE: Effort = Effort { warm_up: 0.0, runs: 1, seconds: 0.0 };

/// A structure of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Grid,
    Octree,
    AabbTree,
    BruteForce,
}

/// Peaks on the device by the structure: build, and count, list and nearest where it has them; each checked.
pub(super) fn on_device(bench: &mut Bench, set: &str, kind: Kind) -> Result<Outcome> {
    let (points, gpu) = (bench.set(set)?, bench.gpu.clone());
    let (expected, n) = (points.expected()?, points.points.len());
    let figures = match kind {
        Kind::Grid => {
            let bounds = reduce::bounds(&points.points);
            let settings = GridSettings::for_radius(points.radius);
            of_structure(&gpu, &points, expected, |input| {
                Ok(GridBuilder::new(&gpu, n, &bounds, &settings)?.build(input)?)
            })?
        }
        Kind::Octree => {
            let domain = Domain::of_bounds(&reduce::bounds(&points.points));
            let settings = OctreeSettings::default().domain(domain);
            let build = |input: &_| Ok(OctreeBuilder::new(&gpu, n, &settings)?.build(input)?);
            let mut figures = of_structure(&gpu, &points, expected, build)?;
            let tree = build(&points.upload(&gpu)?)?;
            figures.push(nearest(&gpu, &points, &tree, || Ok(tree.knn_on_device(&Knn::new(NEAREST))?))?);
            figures
        }
        Kind::AabbTree => {
            let settings = AabbTreeSettings::default().order(BuildOrder::Hilbert);
            let build = |input: &_| Ok(AabbTreeBuilder::new(&gpu, n, &settings)?.build(input)?);
            let mut figures = of_structure(&gpu, &points, expected, build)?;
            let tree = build(&points.upload(&gpu)?)?;
            figures.push(nearest(&gpu, &points, &tree, || Ok(tree.knn_on_device(&Knn::new(NEAREST))?))?);
            figures
        }
        Kind::BruteForce => {
            of_structure(&gpu, &points, expected, |input| Ok(GpuBruteForce::build_on_device(&gpu, input)?))?
        }
    };
    Ok(Outcome::of(expected.mean(), figures))
}

fn of_structure<S: SearchOnDevice + NeighborSearch>(
    gpu: &Gpu,
    points: &Points,
    expected: &Expected,
    build: impl Fn(&nearfield::gpu::Buffer<nearfield::structure::DevicePoint>) -> Result<S>,
) -> Result<Vec<Figure>> {
    let (n, question) = (points.points.len(), FixedRadius::new(points.radius));
    let input = points.upload(gpu)?;
    gpu.take_memory_peak();
    let structure = build(&input)?;
    let peak = gpu.take_memory_peak();
    let held = GpuStructure::memory_bytes(&structure);
    let bytes = |structure, peak, answer| Memory { points: n, structure, peak, answer };
    let mut figures = vec![
        Figure::bytes_a_point("held by the structure", held, bytes(held, 0, 0)),
        Figure::bytes_a_point("peak of the build", peak, bytes(held, peak, 0)),
    ];
    let counted = timed::counts(&structure, &question, expected, ONCE)?;
    figures.push(Figure::bytes_a_point(
        "peak of a count",
        counted.peak_bytes,
        bytes(held, counted.peak_bytes, counted.answer_bytes),
    ));
    let before = gpu.memory_used();
    let listed = timed::list(gpu, expected, ONCE, || Ok((structure.list_on_device(&question)?, Vec::new())))?;
    figures.push(match listed {
        Ok(listed) => {
            let memory = bytes(held, listed.peak_bytes, listed.answer_bytes);
            let over = (listed.peak_bytes - before) as f64 / listed.answer_bytes as f64;
            let note = format!("beyond points and structure {over:.2} times the list");
            Figure::bytes_a_point("peak of a list", listed.peak_bytes, memory).note(note)
        }
        Err(note) => Figure::missing("peak of a list", note),
    });
    Ok(figures)
}

fn nearest<S: GpuStructure>(
    gpu: &Gpu,
    points: &Points,
    structure: &S,
    find: impl Fn() -> Result<GpuNearestNeighbors>,
) -> Result<Figure> {
    let held = structure.memory_bytes();
    let found = timed::nearest(gpu, &points.points, NEAREST, ONCE, || Ok((find()?, Vec::new())))?;
    Ok(match found {
        Ok(found) => {
            let (structure, peak, answer) = (held, found.peak_bytes, found.answer_bytes);
            let memory = Memory { points: points.points.len(), structure, peak, answer };
            Figure::bytes_a_point("peak of 16 nearest, without the caller's points", peak, memory)
        }
        Err(note) => Figure::missing("peak of 16 nearest", note),
    })
}

/// What structures of the CPU hold, points included.
pub(super) fn on_cpu(bench: &mut Bench, set: &str) -> Result<Outcome> {
    let points = bench.set(set)?;
    let (at, n) = (&points.points, points.points.len());
    let figure = |name: &str, bytes: u64| {
        Figure::bytes_a_point(name, bytes, Memory { points: n, structure: bytes, ..Memory::default() })
    };
    Ok(Outcome::without_neighbors(vec![
        figure("uniform-grid", UniformGrid::build(at, &GridSettings::for_radius(points.radius))?.memory_bytes()),
        figure("linear-octree", LinearOctree::build(at, &OctreeSettings::default())?.memory_bytes()),
        figure("aabb-tree", AabbTree::build(at, &AabbTreeSettings::default())?.memory_bytes()),
        figure("brute-force", BruteForce::build(at)?.memory_bytes()),
    ]))
}

/// What a list takes at its peak beyond points and structure, by its own size: by the grid in both orders of rows, and by the tree.
pub(super) fn of_list(bench: &mut Bench, set: &str) -> Result<Outcome> {
    let (points, gpu) = (bench.set(set)?, bench.gpu.clone());
    let (expected, question, n) = (points.expected()?, FixedRadius::new(points.radius), points.points.len());
    let input = points.upload(&gpu)?;
    let bounds = reduce::bounds(&points.points);
    let mut figures = Vec::new();
    {
        let grid = GridBuilder::new(&gpu, n, &bounds, &GridSettings::for_radius(points.radius))?.build(&input)?;
        let before = gpu.memory_used();
        let listed = timed::list(&gpu, expected, ONCE, || Ok((grid.list_on_device(&question)?, Vec::new())))?;
        figures.push(over("grid, rows in query order", &listed, before, n));
        let before = gpu.memory_used();
        let rows = timed::rows(&gpu, expected, ONCE, || Ok((grid.list_rows_on_device(&question)?, Vec::new())))?;
        figures.push(over("grid, rows in completion order", &rows, before, n));
    }
    let tree = AabbTreeBuilder::new(&gpu, n, &AabbTreeSettings::default().order(BuildOrder::Hilbert))?.build(&input)?;
    let before = gpu.memory_used();
    let listed = timed::list(&gpu, expected, ONCE, || Ok((tree.list_on_device(&question)?, Vec::new())))?;
    figures.push(over("tree, rows in query order", &listed, before, n));
    Ok(Outcome::of(expected.mean(), figures))
}

fn over(way: &str, attempt: &timed::Attempt, before: u64, points: usize) -> Figure {
    match attempt {
        Ok(timed) => {
            let taken = timed.peak_bytes - before;
            let memory = Memory { points, structure: before, peak: timed.peak_bytes, answer: timed.answer_bytes };
            let besides = (taken as f64 - timed.answer_bytes as f64) / points as f64;
            let note = format!("{}; {besides:.0} bytes a query beside the list", timed.search);
            Figure::bytes_by_bytes(way, taken, timed.answer_bytes, memory).note(note)
        }
        Err(note) => Figure::missing(way, note.clone()),
    }
}
