//! Moving least squares on a device: the passes of a fit over any structure, and what is done with the fits. `fit_state.wesl`
//! and `conclude.wesl` have the twins of the structs here.
//!
//! Each pass is a visitor that sums up over the neighbours and writes one record a point; passes that look around another place
//! have the queries sent there first. Nothing is kept of neighbours. After an iteration the host reads some sums.

use std::sync::Arc;
use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::cpu::projects_the_origin;
use super::report::Sums;
use super::settings::{MlsMethod, MlsSettings, PlaneSearch};
use super::{bilateral, pss, rimls};
use crate::Result;
use crate::application::PointFlags;
use crate::gpu::{Access, Bind, Buffer, Gpu, Kernel, Pipeline, StageTime, Workgroups};
use crate::query::{DeviceQueries, Stage, VisitorModule, record_module};
use crate::structure::{DevicePoint, GpuStructure};

/// Invocations of a workgroup of the kernels here.
const WORKGROUP: u32 = 64;
/// Most invocations that sum up, each over its share of the points in a fixed order.
const MOST_SUMS: usize = 1 << 13;
/// Rounds of the loops in `finish`: the sweeps of the eigenvectors, and the factorisation of ten coefficients with its solution.
const EIGEN_ROUNDS: u64 = 8;
const SOLVE_ROUNDS: u64 = 600;

/// `MlsFitParameters` in fit_state.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[allow(missing_docs, reason = "fit_state.wesl explains them")]
pub struct FitParameters {
    pub weight_kind: u32,
    pub weight_a: f32,
    pub weight_b: f32,
    pub least: u32,
    pub has_normals: u32,
    pub own_radii: u32,
    pub degree: u32,
    pub stage: u32,
    pub from_origin: u32,
    pub value: f32,
    pub falloff: f32,
    pub padding: u32,
}

/// `MlsConcludeParameters` in conclude.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[allow(missing_docs, reason = "conclude.wesl explains them")]
pub struct ConcludeParameters {
    pub center: Vec3,
    pub n_points: u32,
    pub domain: f32,
    pub accuracy: f32,
    pub projects: u32,
    pub is_last: u32,
    pub oriented: u32,
    pub n_sums: u32,
    pub padding_0: u32,
    pub padding_1: u32,
}

/// `MlsFit` in fit_state.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[allow(missing_docs, reason = "fit_state.wesl explains them")]
pub struct FitState {
    pub goal: Vec3,
    pub said: u32,
    pub normal: Vec3,
    pub curvature: f32,
    pub mean_distance: f32,
    pub reach: f32,
    pub t: f32,
    pub state: u32,
}

/// `MlsPlace` in fit_state.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[allow(missing_docs, reason = "fit_state.wesl explains them")]
pub struct PointPlace {
    pub origin: Vec3,
    pub done: u32,
    pub at: Vec3,
    pub flags: u32,
    pub normal: Vec3,
    pub curvature: f32,
}

/// `MlsSums` in conclude.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[allow(missing_docs, reason = "conclude.wesl explains them")]
pub struct IterationSums {
    pub fitted: u32,
    pub moving: u32,
    pub neighbors: u32,
    pub moves: f32,
    pub largest: f32,
    pub along: f32,
    pub outwards: f32,
    pub distances: f32,
    pub flagged: [u32; 7],
    pub padding: u32,
}

/// Points and samples on a device, and the kernels that move the points.
pub(super) struct DeviceFits {
    gpu: Gpu,
    settings: MlsSettings,
    parameters: FitParameters,
    /// `[q]` by slot.
    fits: Buffer<FitState>,
    places: Buffer<PointPlace>,
    /// `[n]` normal and own radius of each sample.
    samples: Buffer<[f32; 4]>,
    /// `[q]` where passes look.
    pub(super) queries: Buffer<DevicePoint>,
    /// `[q]` the points for a tree that follows them.
    pub(super) moved: Buffer<DevicePoint>,
    sums: Buffer<IterationSums>,
    send_to_goals: Arc<Pipeline>,
    send_to_points: Arc<Pipeline>,
    conclude: Arc<Pipeline>,
}

/// How far the searches of an iteration go.
#[derive(Clone, Copy)]
pub(super) struct Searches<'a> {
    /// The radius of all, or the largest.
    pub(super) radius: f32,
    /// Of each point.
    pub(super) radii: Option<&'a Buffer<f32>>,
    /// Radius that the bilateral weight falls over; 0 for that of the search.
    pub(super) falloff: f32,
}

/// How an iteration ends.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ending {
    pub(super) center: Vec3,
    /// The move at which points have arrived, and whether this is the last step; `None` while smoothing.
    pub(super) arrival: Option<(f32, bool)>,
}

/// A pass of a fit: its visitor, the stage it is told, and its rounds of loops in `finish`.
struct Pass {
    module: &'static str,
    stage: u32,
    rounds: u64,
    /// Whether the queries go to the goals of the pass before.
    follows: bool,
}

impl Pass {
    fn new(module: &'static str, stage: u32, rounds: u64, follows: bool) -> Self {
        Self { module, stage, rounds, follows }
    }
}

/// The passes of a method, in order.
fn passes(method: &MlsMethod) -> Vec<Pass> {
    let plane = |stage| Pass::new("package::application::mls::plane", stage, EIGEN_ROUNDS, false);
    let height = || Pass::new("package::application::mls::height", 0, SOLVE_ROUNDS, true);
    match *method {
        MlsMethod::Apss { .. } => vec![Pass::new("package::application::mls::apss", 0, 0, false)],
        MlsMethod::Bilateral { .. } => vec![Pass::new("package::application::mls::bilateral", 0, 0, false)],
        MlsMethod::Rimls { .. } => {
            let pass = |stage| Pass::new("package::application::mls::rimls", stage, 0, false);
            (0..rimls::PASSES as u32).map(pass).collect()
        }
        MlsMethod::Jet => vec![plane(2), height()],
        MlsMethod::Pss { degree, plane: search } => {
            let mut passes = vec![plane(u32::from(search == PlaneSearch::Full))];
            if search == PlaneSearch::Full {
                let round = |_| Pass::new("package::application::mls::plane_search", 0, 0, true);
                passes.extend((0..pss::MOST_ROUNDS).map(round));
            }
            passes.extend((degree > 0).then(height));
            passes
        }
    }
}

fn fit_parameters(settings: &MlsSettings, has_normals: bool, own_radii: bool) -> FitParameters {
    let (weight_kind, [weight_a, weight_b]) = match settings.method {
        MlsMethod::Jet => super::Weight::Constant.parameters(),
        _ => settings.weight.parameters(),
    };
    let degree = match settings.method {
        MlsMethod::Pss { degree, .. } => degree.into(),
        MlsMethod::Jet => super::jet::DEGREE as u32,
        _ => 0,
    };
    let value = match settings.method {
        MlsMethod::Apss { sphericity } => sphericity,
        MlsMethod::Rimls { normal_width } => -1.0 / (normal_width * normal_width),
        MlsMethod::Bilateral { sharpness_degrees } => -1.0 / bilateral::bandwidth(sharpness_degrees),
        MlsMethod::Pss { .. } | MlsMethod::Jet => 0.0,
    };
    FitParameters {
        weight_kind,
        weight_a,
        weight_b,
        least: settings.method.least_neighbors(),
        has_normals: has_normals.into(),
        own_radii: own_radii.into(),
        degree,
        stage: 0,
        from_origin: projects_the_origin(&settings.method).into(),
        value: value as f32,
        falloff: 0.0,
        padding: 0,
    }
}

use Access::{Read, ReadWrite, Uniform};

fn pipeline(gpu: &Gpu, module: &'static str, entry: &'static str, bindings: &[Access]) -> Result<Arc<Pipeline>> {
    let constants = &[("WORKGROUP", f64::from(WORKGROUP))];
    gpu.prepare(&Kernel { constants, ..Kernel::new(module, entry, bindings, WORKGROUP) })
}

impl DeviceFits {
    /// - `places`: the points
    /// - `normals`: of the samples, at length 1 or 0
    /// - `own_radii`: of the samples
    /// - `queries`: `[q]` the points with their slots, in an order that is good to search
    #[allow(clippy::type_complexity, reason = "all parts are named above")]
    pub(super) fn new(
        gpu: &Gpu,
        settings: &MlsSettings,
        places: &[PointPlace],
        (n_samples, normals, own_radii): (usize, Option<&[[f32; 3]]>, Option<&[f32]>),
        queries: Buffer<DevicePoint>,
    ) -> Result<Self> {
        let sample = |i: usize| {
            let [x, y, z] = normals.map_or([0.0; 3], |normals| normals[i]);
            [x, y, z, own_radii.map_or(0.0, |radii| radii[i])]
        };
        let samples: Vec<[f32; 4]> = (0..n_samples).map(sample).collect();
        let fits: Vec<FitState> = places.iter().map(|p| FitState { goal: p.at, ..FitState::default() }).collect();
        let n = places.len();
        let sends = [ReadWrite, Read, Read];
        Ok(Self {
            gpu: gpu.clone(),
            settings: *settings,
            parameters: fit_parameters(settings, normals.is_some(), own_radii.is_some()),
            fits: gpu.upload("fits", &fits)?,
            places: gpu.upload("points of fits", places)?,
            samples: gpu.upload("normals and radii of samples", &samples)?,
            queries,
            moved: gpu.buffer("smoothed points", n)?,
            sums: gpu.buffer("sums of an iteration", n.clamp(1, MOST_SUMS))?,
            send_to_goals: pipeline(gpu, "package::application::mls::send", "send_to_goals", &sends)?,
            send_to_points: pipeline(gpu, "package::application::mls::send", "send_to_points", &sends)?,
            conclude: pipeline(
                gpu,
                "package::application::mls::conclude",
                "conclude",
                &[Uniform, Read, ReadWrite, ReadWrite, ReadWrite, ReadWrite],
            )?,
        })
    }

    /// Runs the passes of a fit for all points that are not done. Adds the times.
    ///
    /// Every pass is submitted before the next is recorded: some searches look at the queries while they are recorded.
    pub(super) fn fit<S: GpuStructure>(
        &self,
        structure: &S,
        searches: Searches<'_>,
        stages: &mut Vec<Stage>,
    ) -> Result<()> {
        let parameters = FitParameters { falloff: searches.falloff, ..self.parameters };
        for pass in passes(&self.settings.method) {
            let mut commands = self.gpu.commands("fit");
            if pass.follows {
                let mut sent = self.gpu.commands("send queries");
                sent.dispatch(&self.send_to_goals, &self.send_binds(), self.all_queries());
                sent.submit()?;
            }
            let told = self.gpu.uniform("fit parameters", &FitParameters { stage: pass.stage, ..parameters })?;
            let bindings: [(Access, Bind); 4] = [
                (Uniform, (&told).into()),
                (ReadWrite, (&self.fits).into()),
                (Read, (&self.places).into()),
                (Read, (&self.samples).into()),
            ];
            let mut queries = DeviceQueries::new(&self.queries, searches.radius);
            queries.radii = searches.radii;
            let rounds = [0, pass.rounds];
            let visitor =
                VisitorModule { module: pass.module, features: &[], bindings: &bindings, rounds, combines: false };
            commands.stage("fit");
            record_module(&mut commands, structure, &queries, &visitor)?;
            add_device_stages(stages, &commands.run()?);
        }
        Ok(())
    }

    /// Ends an iteration and reads its sums. While smoothing, `moved` then holds the points.
    pub(super) fn conclude(&self, ending: Ending, stages: &mut Vec<Stage>) -> Result<Sums> {
        let n_sums = self.sums.len();
        let (accuracy, is_last) = ending.arrival.unwrap_or((0.0, false));
        let parameters = ConcludeParameters {
            center: ending.center,
            n_points: self.places.len() as u32,
            domain: self.settings.domain as f32,
            accuracy,
            projects: ending.arrival.is_some().into(),
            is_last: is_last.into(),
            oriented: self.parameters.has_normals,
            n_sums: n_sums as u32,
            ..ConcludeParameters::default()
        };
        let parameters = self.gpu.uniform("conclude parameters", &parameters)?;
        let binds = [
            (&parameters).into(),
            (&self.fits).into(),
            (&self.places).into(),
            (&self.sums).into(),
            (&self.moved).into(),
            (&self.samples).into(),
        ];
        let mut commands = self.gpu.commands("conclude");
        commands.stage("conclude").dispatch(&self.conclude, &binds, Workgroups::Covering(n_sums as u64));
        add_device_stages(stages, &commands.run()?);
        let start = Instant::now();
        let mut sums = Sums::default();
        for part in self.gpu.read(&self.sums)? {
            sums.add(&Sums {
                fitted: part.fitted.into(),
                moving: part.moving.into(),
                moves: part.moves.into(),
                largest: part.largest.into(),
                along: part.along.into(),
                outwards: part.outwards.into(),
                distances: part.distances.into(),
                neighbors: part.neighbors.into(),
                flagged: part.flagged.map(u64::from),
            });
        }
        stages.push(Stage::on_host("read back", start));
        Ok(sums)
    }

    /// Sends the queries to where the points are.
    pub(super) fn send_to_points(&self) -> Result<()> {
        let mut commands = self.gpu.commands("send queries");
        commands.dispatch(&self.send_to_points, &self.send_binds(), self.all_queries());
        commands.submit()
    }

    fn send_binds(&self) -> [Bind; 3] {
        [(&self.queries).into(), (&self.fits).into(), (&self.places).into()]
    }

    fn all_queries(&self) -> Workgroups {
        Workgroups::Covering(self.queries.len() as u64)
    }

    /// The settings.
    pub(super) fn settings(&self) -> &MlsSettings {
        &self.settings
    }

    /// `[q]` the points and what was said of them, read back.
    pub(super) fn read(&self) -> Result<Vec<PointPlace>> {
        self.gpu.read(&self.places)
    }
}

/// Adds stages timed by the device's clock; a device without one has none.
pub(super) fn add_device_stages(stages: &mut Vec<Stage>, times: &[StageTime]) {
    stages.extend(times.iter().filter_map(Stage::on_device));
}

/// Points, read back: where they are, their normals, what was said of them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MlsPoints {
    /// `[q]`.
    pub positions: Vec<Vec3>,
    /// `[q]` normals of the surface there, of length 1; 0 where there was none. Without given normals their sign is arbitrary.
    pub normals: Vec<Vec3>,
    /// `[q]` 1 / radius of the spheres of [`MlsMethod::Apss`], positive where the surface bends away from its normal; `None` for other
    /// methods.
    pub mean_curvatures: Option<Vec<f32>>,
    /// `[q]`.
    pub flags: Vec<PointFlags>,
}

impl MlsPoints {
    pub(super) fn of(places: &[PointPlace], method: &MlsMethod) -> Self {
        let curvatures = matches!(method, MlsMethod::Apss { .. });
        Self {
            positions: places.iter().map(|p| p.at).collect(),
            normals: places.iter().map(|p| p.normal).collect(),
            mean_curvatures: curvatures.then(|| places.iter().map(|p| p.curvature).collect()),
            flags: places.iter().map(|p| PointFlags(p.flags)).collect(),
        }
    }
}
