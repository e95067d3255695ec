//! Structures over triangles on CPU and GPU: built once a mesh, cast into, with times, work and a checked answer.

use std::time::Instant;

use nearfield::gpu::Gpu;
use nearfield::query::{Clock, DeviceRays, RaysOnDevice, Stage};
use nearfield::structure::{BuildStage, PreparedTriangles, RayStructure};
use nearfield::{
    BruteForceMesh, BvhSettings, GpuBruteForceMesh, GpuKdTree, GpuTriangleBvh, HitRecord, KdTraversal, KdTree,
    KdTreeSettings, Ray, RaySearch, TriMesh, TriangleBvh,
};
use std::sync::Arc;

use super::check::{Answer, Expected, ask};
use super::shots::Question;
use crate::measure::{Effort, Measured, Timing, repeat};
use crate::{Error, Result};

/// A cast that takes longer than this, in seconds, is not repeated, nor warmed up.
const SLOW: f64 = 2.0;

/// A structure and where it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Every triangle, on the CPU.
    CpuBrute,
    /// The kd-tree, walked with a stack.
    CpuStack,
    /// The kd-tree, walked by ropes.
    CpuRopes,
    /// The hierarchy of boxes, eight wide.
    CpuBvh,
    /// Every triangle, on the GPU.
    GpuBrute,
    /// The kd-tree by ropes, on the GPU.
    GpuRopes,
    /// The compressed hierarchy of boxes, on the GPU.
    GpuBvh,
}

impl Method {
    /// All of them, in the order of tables.
    pub const ALL: [Self; 7] =
        [Self::CpuBrute, Self::CpuStack, Self::CpuRopes, Self::CpuBvh, Self::GpuBrute, Self::GpuRopes, Self::GpuBvh];

    /// Name in tables and legends.
    pub const fn name(self) -> &'static str {
        match self {
            Self::CpuBrute => "CPU brute force",
            Self::CpuStack => "CPU kd-tree, stack",
            Self::CpuRopes => "CPU kd-tree, ropes",
            Self::CpuBvh => "CPU BVH",
            Self::GpuBrute => "GPU brute force",
            Self::GpuRopes => "GPU kd-tree, ropes",
            Self::GpuBvh => "GPU BVH",
        }
    }

    /// Whether it needs a GPU.
    pub const fn on_gpu(self) -> bool {
        matches!(self, Self::GpuBrute | Self::GpuRopes | Self::GpuBvh)
    }

    /// Whether every ray tests every triangle.
    pub const fn is_brute(self) -> bool {
        matches!(self, Self::CpuBrute | Self::GpuBrute)
    }
}

/// A search on the device by rays from the host, and by rays that are there.
pub trait DeviceSearch: RaySearch + RaysOnDevice {}
impl<S: RaySearch + RaysOnDevice> DeviceSearch for S {}

/// A built structure.
pub enum Search {
    /// On the CPU.
    Cpu(Box<dyn RaySearch>),
    /// On the GPU.
    Gpu(Gpu, Box<dyn DeviceSearch>),
}

impl Search {
    /// The search by rays from the host.
    pub fn as_search(&self) -> &dyn RaySearch {
        match self {
            Self::Cpu(search) => search.as_ref(),
            // The trait object is asked through its supertrait.
            Self::Gpu(_, search) => search.as_ref() as &dyn RaySearch,
        }
    }
}

/// A structure with the times of its making.
pub struct Built {
    /// The structure.
    pub search: Search,
    /// Preparing the triangles and building, on the CPU, in milliseconds.
    pub build: f64,
    /// Copying it to the device, in milliseconds.
    pub upload: Option<f64>,
}

/// The triangles of a mesh, and the kd-tree that stack, ropes and GPU share.
pub struct Scene {
    /// Prepared triangles.
    pub triangles: Arc<PreparedTriangles>,
    prepare: f64,
    tree: KdTree,
    tree_build: f64,
    bvh_settings: BvhSettings,
}

impl Scene {
    /// Prepares the triangles and builds the tree.
    ///
    /// # Errors
    /// As [`KdTree::build`].
    pub fn new(mesh: &TriMesh, settings: &KdTreeSettings) -> Result<Self> {
        let (triangles, prepare) = timed(|| Ok(PreparedTriangles::new(mesh)?))?;
        let (tree, cut) = timed(|| Ok(KdTree::of(triangles.clone(), settings)?))?;
        Ok(Self { triangles, prepare, tree, tree_build: prepare + cut, bvh_settings: BvhSettings::default() })
    }

    /// The kd-tree.
    pub fn tree(&self) -> &KdTree {
        &self.tree
    }

    /// Milliseconds to prepare the triangles and to build the kd-tree.
    pub fn tree_build(&self) -> f64 {
        self.tree_build
    }

    /// Builds a structure; `None` for those of the GPU where there is none.
    ///
    /// # Errors
    /// What the build returns.
    pub fn build(&self, method: Method, gpu: Option<&Gpu>) -> Result<Option<Built>> {
        let triangles = || self.triangles.clone();
        let on_cpu = |search: Box<dyn RaySearch>, build: f64| {
            Ok(Some(Built { search: Search::Cpu(search), build, upload: None }))
        };
        let on_gpu = |gpu: &Gpu, search: Box<dyn DeviceSearch>, build: f64, upload: f64| {
            Ok(Some(Built { search: Search::Gpu(gpu.clone(), search), build, upload: Some(upload) }))
        };
        match (method, gpu) {
            (Method::CpuBrute, _) => on_cpu(Box::new(BruteForceMesh::of(triangles())), self.prepare),
            (Method::CpuStack, _) => {
                on_cpu(Box::new(self.tree.clone().with_traversal(KdTraversal::Stack)), self.tree_build)
            }
            (Method::CpuRopes, _) => {
                on_cpu(Box::new(self.tree.clone().with_traversal(KdTraversal::Ropes)), self.tree_build)
            }
            (Method::CpuBvh, _) => {
                let (bvh, split) = timed(|| Ok(TriangleBvh::of(triangles(), &self.bvh_settings)?))?;
                on_cpu(Box::new(bvh), self.prepare + split)
            }
            (Method::GpuBrute, Some(gpu)) => {
                let (brute, upload) = uploaded(gpu, || Ok(GpuBruteForceMesh::of(gpu, triangles())?))?;
                on_gpu(gpu, Box::new(brute), self.prepare, upload)
            }
            (Method::GpuRopes, Some(gpu)) => {
                let (tree, upload) = uploaded(gpu, || Ok(GpuKdTree::upload(gpu, &self.tree)?))?;
                on_gpu(gpu, Box::new(tree), self.tree_build, upload)
            }
            (Method::GpuBvh, Some(gpu)) => {
                let (bvh, whole) = uploaded(gpu, || Ok(GpuTriangleBvh::of(gpu, triangles(), &self.bvh_settings)?))?;
                let on_host = |stage: &BuildStage| stage.name != "upload";
                let stages = nearfield::structure::GpuRayStructure::build_stages(&bvh);
                let build: f64 = stages.iter().filter(|s| on_host(s)).map(|s| s.milliseconds).sum();
                on_gpu(gpu, Box::new(bvh), self.prepare + build, (whole - build).max(0.0))
            }
            (_, None) => Ok(None),
        }
    }
}

/// Runs once, or three times for the median where that takes no second.
fn timed<T>(mut make: impl FnMut() -> Result<T>) -> Result<(T, f64)> {
    let mut times = Vec::new();
    loop {
        let start = Instant::now();
        let made = make()?;
        times.push(start.elapsed().as_secs_f64() * 1e3);
        if times.len() == 3 || times.iter().sum::<f64>() > 500.0 {
            return Ok((made, crate::measure::median(&times)));
        }
    }
}

/// As [`timed`], until the copies have arrived on the device.
fn uploaded<T>(gpu: &Gpu, mut make: impl FnMut() -> Result<T>) -> Result<(T, f64)> {
    let flag = gpu.upload("flag", &[1u32])?;
    timed(|| {
        let made = make()?;
        gpu.read(&flag)?;
        Ok(made)
    })
}

/// Times of a cast.
#[derive(Debug, Clone, Copy)]
pub struct Cast {
    /// Timestamps of the device, rays and answers there; none on the CPU.
    pub device: Option<Timing>,
    /// Wall clock of the same; on the CPU the whole call.
    pub host: Timing,
    /// Wall clock from rays on the host to answers on the host; none on the CPU.
    pub round_trip: Option<f64>,
    /// Timed runs.
    pub runs: usize,
    /// Rays whose answer differs from the CPU's within rounding.
    pub differing: usize,
}

impl Cast {
    /// The times of so many times as many rays.
    pub fn scaled(self, times: f64) -> Self {
        let scaled = |t: Timing| Timing { median: times * t.median, fastest: times * t.fastest };
        Self {
            device: self.device.map(scaled),
            host: scaled(self.host),
            round_trip: self.round_trip.map(|ms| times * ms),
            ..self
        }
    }

    /// What rates are computed from: the device's clock where it has one.
    pub fn milliseconds(&self) -> f64 {
        self.device.map_or(self.host.median, |timing| timing.median)
    }
}

/// Repeats a run as `effort` says, or not at all where it takes long.
fn repeat_unless_slow<T>(effort: Effort, mut run: impl FnMut() -> Result<(T, Vec<Stage>)>) -> Result<(T, Measured)> {
    let start = Instant::now();
    let (answer, stages) = run()?;
    let seconds = start.elapsed().as_secs_f64();
    if seconds <= SLOW {
        drop(answer);
        return repeat(effort, run);
    }
    let device: Vec<f64> = stages.iter().filter(|s| s.clock == Clock::Device).map(|s| s.milliseconds).collect();
    let device = (!device.is_empty()).then(|| Timing::of(&[device.iter().sum()]));
    Ok((answer, Measured { wall: Timing::of(&[seconds * 1e3]), device, stages, runs: 1 }))
}

/// Casts the rays of `expected`, and checks every answer.
///
/// # Errors
/// What the casts return; an answer that is wrong.
pub fn cast(search: &Search, rays: &[Ray], question: Question, expected: &Expected, effort: Effort) -> Result<Cast> {
    match search {
        Search::Cpu(search) => {
            let (answer, measured) =
                repeat_unless_slow(effort, || Ok((ask(search.as_ref(), rays, question)?, Vec::new())))?;
            expected.check_exactly(&answer)?;
            Ok(Cast { device: None, host: measured.wall, round_trip: None, runs: measured.runs, differing: 0 })
        }
        Search::Gpu(gpu, search) => {
            let (answer, whole) = repeat_unless_slow(Effort { runs: effort.runs.min(5), ..effort }, || {
                timed_answer(search.as_ref(), rays, question)
            })?;
            let differing = expected.check_rounded(&answer)?;
            let round_trip = Some(whole.wall.median);
            if question == Question::All {
                // Its rows are made in passes with a scan on the host between them: there is no call on the device alone.
                let (device, host, runs) = (whole.device, whole.wall, whole.runs);
                return Ok(Cast { device, host, round_trip, runs, differing });
            }
            let (answer, measured) = on_device(gpu, search.as_ref(), rays, question, effort)?;
            expected.check_rounded(&answer)?;
            let Measured { device, wall: host, runs, .. } = measured;
            Ok(Cast { device, host, round_trip, runs, differing })
        }
    }
}

/// The answer from host to host with the stages of its report.
fn timed_answer(search: &dyn DeviceSearch, rays: &[Ray], question: Question) -> Result<(Answer, Vec<Stage>)> {
    Ok(match question {
        Question::Closest => {
            let hits = search.closest_hits(rays)?;
            (Answer::Closest(hits.records().to_vec()), hits.report.stages)
        }
        Question::Any => {
            let states = search.any_hits(rays)?;
            (Answer::Any(states.as_slice().to_vec()), states.report.stages)
        }
        Question::All => {
            let lists = search.all_hits(rays)?;
            (Answer::All(lists.offsets().to_vec(), lists.records().to_vec()), lists.report.stages)
        }
    })
}

/// Rays and answers on the device.
fn on_device(
    gpu: &Gpu,
    search: &dyn DeviceSearch,
    rays: &[Ray],
    question: Question,
    effort: Effort,
) -> Result<(Answer, Measured)> {
    let (n, buffer) = (rays.len(), gpu.upload("rays", rays)?);
    let hits = gpu.buffer::<HitRecord>("hits", if question == Question::Closest { n } else { 1 })?;
    let states = gpu.buffer::<u32>("states", if question == Question::Any { n } else { 1 })?;
    let ((), measured) = repeat_unless_slow(effort, || {
        let mut commands = gpu.commands("cast");
        commands.stage("cast");
        let rays = DeviceRays::first(&buffer, n);
        match question {
            Question::Closest => search.record_closest(&mut commands, &rays, &hits)?,
            Question::Any => search.record_any(&mut commands, &rays, &states)?,
            Question::All => return Err(Error::from("all hits are not recorded on the device")),
        }
        let times = commands.run()?;
        let stage = |time: &nearfield::gpu::StageTime| {
            Some(Stage { name: time.name, milliseconds: time.milliseconds?, clock: Clock::Device })
        };
        Ok(((), times.iter().filter_map(stage).collect()))
    })?;
    let answer = match question {
        Question::Any => Answer::Any(gpu.read(&states)?),
        _ => Answer::Closest(gpu.read(&hits)?),
    };
    Ok((answer, measured))
}

/// Mean and largest number of triangles that a ray tests for its first hit.
///
/// # Errors
/// What the cast returns.
pub fn triangle_tests(search: &Search, rays: &[Ray]) -> Result<(f64, u32)> {
    let (_, work) = search.as_search().closest_hits_with_work(rays)?;
    let sum: u64 = work.iter().map(|w| u64::from(w.triangle_tests)).sum();
    let most = work.iter().map(|w| w.triangle_tests).max().unwrap_or(0);
    Ok((sum as f64 / work.len().max(1) as f64, most))
}

/// Seconds of a cast of all rays, from one of a part of them: every `1/part`-th row of the picture.
///
/// # Errors
/// What the cast returns.
pub fn foreseen(search: &Search, rays: &[Ray], part: usize) -> Result<f64> {
    let some: Vec<Ray> = rays.chunks(64).step_by(part).flatten().copied().collect();
    let search = search.as_search();
    search.closest_hits(&some[..some.len().min(64)])?;
    let start = Instant::now();
    search.closest_hits(&some)?;
    Ok(start.elapsed().as_secs_f64() * rays.len() as f64 / some.len() as f64)
}

/// Name of how a kd-tree is built.
pub fn tree_name(settings: &KdTreeSettings) -> String {
    match settings.build {
        nearfield::KdBuild::SpatialMedian => format!("spatial median, leaves of {}", settings.leaf_limit),
        nearfield::KdBuild::BinnedSah => "binned SAH".to_owned(),
        nearfield::KdBuild::ExactSah => "exact SAH".to_owned(),
    }
}

/// The structure's own name.
pub const KD_TREE: &str = <KdTree as RayStructure>::NAME;
