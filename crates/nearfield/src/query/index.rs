//! A structure and a device chosen by words, for programs that let their users choose.

use std::sync::OnceLock;

use glam::Vec3;

use super::choose::{self, Purpose, StructureChoice};
use super::{Counts, FixedRadius, Knn, KnnSearch, Nearest, NearestNeighbors, NeighborSearch, Neighbors, Report, Stage};
use crate::geometry::{Period, validate};
use crate::gpu::{AdapterKind, DeviceChoice, Gpu};
use crate::structure::{
    AabbTree, AabbTreeSettings, BruteForce, BuildOrder, GpuAabbTree, GpuBruteForce, GpuLinearOctree, GpuUniformGrid,
    GridSettings, LinearOctree, OctreeSettings, UniformGrid,
};
use crate::{Error, Result};

/// What to build and where.
#[derive(Debug, Clone, Default)]
pub struct IndexSettings {
    /// The structure.
    pub structure: StructureChoice,
    /// The device.
    pub device: DeviceChoice,
    /// Period of the domain.
    pub period: Period,
}

/// What an index holds: a structure with the searches it has.
trait Structure: NeighborSearch + Send {
    /// Its own search for the nearest points; `None` where it has none.
    fn as_knn(&self) -> Option<&dyn KnnSearch>;
}

/// One line a structure: whether it has a search for the nearest points.
macro_rules! structures {
    ($($structure:ty: $as_knn:expr;)*) => {$(
        impl Structure for $structure {
            fn as_knn(&self) -> Option<&dyn KnnSearch> {
                let as_knn: fn(&$structure) -> Option<&dyn KnnSearch> = $as_knn;
                as_knn(self)
            }
        }
    )*};
}

structures! {
    BruteForce: |structure| Some(structure);
    GpuBruteForce: |structure| Some(structure);
    UniformGrid: |_| None;
    GpuUniformGrid: |_| None;
    LinearOctree: |structure| Some(structure);
    GpuLinearOctree: |structure| Some(structure);
    AabbTree: |structure| Some(structure);
    GpuAabbTree: |structure| Some(structure);
}

/// A structure on a device, ready for questions.
///
/// All structures answer questions with a radius. The nearest points without one are found by those for which
/// [`StructureChoice::finds_nearest`] holds; others answer [`Knn`] with a radius by lists that are cut.
pub struct Index {
    search: Box<dyn Structure>,
    /// Why this structure, where it was chosen.
    reason: Option<String>,
    notes: Vec<String>,
    substitute: Option<Substitute>,
}

/// What to build, chosen.
#[derive(Debug, Clone, Copy)]
struct Plan {
    structure: StructureChoice,
    /// The radius that cells are made for; 0 for cells by density.
    radius: f32,
    period: Period,
}

/// What the CPU needs to take over from a GPU that fails at a question.
struct Substitute {
    points: Vec<Vec3>,
    plan: Plan,
    built: OnceLock<Box<dyn Structure>>,
}

impl Index {
    /// Builds what `settings` say over `points`, for questions like `purpose`: a `&FixedRadius` or a `&Knn`.
    ///
    /// [`StructureChoice::Auto`] goes by the number of pairs, the radii, and how the points fill cells of the largest
    /// radius, for which it passes over the points once; [`Index::reason`] gives the figures.
    ///
    /// Only `DeviceChoice::Auto` falls back to the CPU: where no hardware GPU is found, or the GPU fails at the build
    /// or at a question (for which the index keeps a copy of the points); the notes say so, those of the reports too.
    ///
    /// # Errors
    /// As the builds: `NonFinite`, `CoordinateTooLarge`, `TooMany`, `InvalidSetting`; `NoDevice`; `Unsupported` where
    /// the nearest without a radius are asked of a structure that does not find them;
    /// `OutOfDeviceMemory` and other device errors unless the device is `Auto`.
    pub fn build<'q>(points: &[Vec3], purpose: impl Into<Purpose<'q>>, settings: &IndexSettings) -> Result<Self> {
        let mut notes = Vec::new();
        let gpu = open(&settings.device, &mut notes)?;
        Self::assemble(gpu.as_ref(), points, &purpose.into(), settings, notes)
    }

    /// As [`Index::build`], on a GPU that is open already: of the device in `settings` only counts whether it is
    /// `Auto`, which lets the CPU take over.
    ///
    /// # Errors
    /// As [`Index::build`].
    pub fn build_on<'q>(
        gpu: &Gpu,
        points: &[Vec3],
        purpose: impl Into<Purpose<'q>>,
        settings: &IndexSettings,
    ) -> Result<Self> {
        Self::assemble(Some(gpu), points, &purpose.into(), settings, Vec::new())
    }

    fn assemble(
        gpu: Option<&Gpu>,
        points: &[Vec3],
        purpose: &Purpose<'_>,
        settings: &IndexSettings,
        mut notes: Vec<String>,
    ) -> Result<Self> {
        let (auto, period) = (settings.device == DeviceChoice::Auto, settings.period);
        let radius = purpose.largest_radius();
        let (structure, reason) = match settings.structure {
            StructureChoice::Auto => {
                validate::points(points)?;
                let ends_loops = gpu.is_some_and(|gpu| gpu.limits().loop_rounds.is_some());
                let device = choose::Device { is_gpu: gpu.is_some(), ends_loops };
                let (structure, reason) = choose::choose(points, purpose, &period, device);
                (structure, Some(reason))
            }
            chosen => (chosen, None),
        };
        if radius.is_none() && !structure.finds_nearest() {
            return Err(choose::no_radius(structure.name()));
        }
        let plan = Plan { structure, radius: radius.unwrap_or(0.0), period };
        if let Some(gpu) = gpu {
            if gpu.kind() == AdapterKind::Software {
                notes.push(format!("{} is a software renderer: the CPU in disguise, and slower", gpu.name()));
            }
            match Self::on_gpu(gpu, points, &plan) {
                Ok(search) => {
                    let copy = || Substitute { points: points.to_vec(), plan, built: OnceLock::new() };
                    return Ok(Self { search, reason, notes, substitute: auto.then(copy) });
                }
                Err(error) if auto && error.is_device_fault() => notes.push(taken_over(gpu.name(), &error)),
                Err(error) => return Err(error),
            }
        }
        Ok(Self { search: Self::on_cpu(points, &plan)?, reason, notes, substitute: None })
    }

    /// Asks the structure, or the CPU where the GPU fails and the CPU may take over; the answer's report, which
    /// `report_of` finds, gets the notes and the reason.
    fn ask<T>(
        &self,
        ask: impl Fn(&dyn Structure) -> Result<T>,
        report_of: impl Fn(&mut T) -> &mut Report,
    ) -> Result<T> {
        let mut notes = self.notes.clone();
        let mut answer = match (ask(self.search.as_ref()), &self.substitute) {
            (Err(error), Some(substitute)) if error.is_device_fault() => {
                notes.push(taken_over(&self.search.device(), &error));
                ask(substitute.search()?)?
            }
            (answer, _) => answer?,
        };
        let report = report_of(&mut answer);
        report.notes.extend(notes);
        report.reason = self.reason.clone();
        Ok(answer)
    }

    fn on_cpu(points: &[Vec3], &Plan { structure, radius, period }: &Plan) -> Result<Box<dyn Structure>> {
        Ok(match structure {
            StructureChoice::BruteForce => Box::new(BruteForce::build_periodic(points, period)?),
            StructureChoice::UniformGrid | StructureChoice::Auto => {
                Box::new(UniformGrid::build(points, &GridSettings::for_radius(radius).periodic(period))?)
            }
            StructureChoice::LinearOctree => {
                Box::new(LinearOctree::build(points, &OctreeSettings::default().periodic(period))?)
            }
            StructureChoice::AabbTree => {
                Box::new(AabbTree::build(points, &AabbTreeSettings::default().periodic(period))?)
            }
        })
    }

    fn on_gpu(gpu: &Gpu, points: &[Vec3], &Plan { structure, radius, period }: &Plan) -> Result<Box<dyn Structure>> {
        Ok(match structure {
            StructureChoice::BruteForce => Box::new(GpuBruteForce::build_periodic(gpu, points, period)?),
            StructureChoice::UniformGrid | StructureChoice::Auto => {
                Box::new(GpuUniformGrid::build(gpu, points, &GridSettings::for_radius(radius).periodic(period))?)
            }
            StructureChoice::LinearOctree => {
                Box::new(GpuLinearOctree::build(gpu, points, &OctreeSettings::default().periodic(period))?)
            }
            StructureChoice::AabbTree => {
                // Asked a few times at most: a build where the points are gains more than tighter boxes.
                let settings = AabbTreeSettings::default().order(BuildOrder::Hilbert).periodic(period);
                Box::new(GpuAabbTree::build(gpu, points, &settings)?)
            }
        })
    }

    /// What a user should know about the device: a fallback, a software adapter.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Why this structure was chosen, in one sentence with the figures that decided; `None` where it was named. Reports
    /// of answers have it too.
    pub fn reason(&self) -> Option<&str> {
        self.reason.as_deref()
    }
}

impl Substitute {
    /// The structure on the CPU, built at the first use.
    fn search(&self) -> Result<&dyn Structure> {
        if self.built.get().is_none() {
            let built = Index::on_cpu(&self.points, &self.plan)?;
            // Where two threads come here at once, the structure of the first one stays.
            let _ = self.built.set(built);
        }
        Ok(self.built.get().expect("the structure should have been set above").as_ref())
    }
}

/// The GPU of a choice, `None` for the CPU, which also takes over with a note where the choice is `Auto`.
///
/// # Errors
/// As [`Gpu::open`], unless the choice is `Auto`.
pub(super) fn open(device: &DeviceChoice, notes: &mut Vec<String>) -> Result<Option<Gpu>> {
    match Gpu::open(device) {
        Err(error) if *device == DeviceChoice::Auto => {
            notes.push(taken_over("the GPU", &error));
            Ok(None)
        }
        opened => opened,
    }
}

/// The note on a GPU that the CPU replaced.
pub(super) fn taken_over(device: &str, error: &Error) -> String {
    format!("{device} could not be used ({error}); the CPU did the work")
}

impl NeighborSearch for Index {
    fn structure(&self) -> &'static str {
        self.search.structure()
    }

    fn device(&self) -> String {
        self.search.device()
    }

    fn len(&self) -> usize {
        self.search.len()
    }

    fn memory_bytes(&self) -> u64 {
        self.search.memory_bytes()
    }

    fn build_stages(&self) -> Vec<Stage> {
        self.search.build_stages()
    }

    fn count(&self, question: &FixedRadius<'_>) -> Result<Counts> {
        self.ask(|search| search.count(question), |counts| &mut counts.report)
    }

    fn list(&self, question: &FixedRadius<'_>) -> Result<Neighbors> {
        self.ask(|search| search.list(question), |neighbors| &mut neighbors.report)
    }

    fn nearest(&self, question: &FixedRadius<'_>) -> Result<Nearest> {
        self.ask(|search| search.nearest(question), |nearest| &mut nearest.report)
    }
}

impl KnnSearch for Index {
    fn knn(&self, question: &Knn<'_>) -> Result<NearestNeighbors> {
        let ask = |search: &dyn Structure| match search.as_knn() {
            Some(search) => search.knn(question),
            None if question.radius.is_none() => Err(choose::no_radius(search.structure())),
            None => {
                question.validate(search.len())?;
                let list = search.list(&question.as_fixed_radius())?;
                Ok(NearestNeighbors::of_list(list, question.k as usize))
            }
        };
        self.ask(ask, |nearest| &mut nearest.report)
    }
}
