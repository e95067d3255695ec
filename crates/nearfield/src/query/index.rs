//! A structure and a device chosen by words, for programs that let their users choose.

use std::str::FromStr;
use std::sync::OnceLock;

use glam::Vec3;

use super::{Counts, FixedRadius, Nearest, NeighborSearch, Neighbors, Stage};
use crate::geometry::Period;
use crate::gpu::{AdapterKind, DeviceChoice, Gpu};
use crate::structure::{
    BruteForce, GpuBruteForce, GpuLinearOctree, GpuUniformGrid, GridSettings, LinearOctree, OctreeSettings, UniformGrid,
};
use crate::{Error, Result};

/// Below this many pairs of query and point, testing all of them beats building anything.
const BRUTE_FORCE_PAIRS: u64 = 1 << 20;

/// Which structure to build.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StructureChoice {
    /// Brute force for a few thousand points, else the uniform grid.
    #[default]
    Auto,
    /// [`BruteForce`].
    BruteForce,
    /// [`UniformGrid`].
    UniformGrid,
    /// [`LinearOctree`].
    LinearOctree,
}

impl StructureChoice {
    /// Every structure there is, without `Auto`.
    pub const ALL: [Self; 3] = [Self::BruteForce, Self::UniformGrid, Self::LinearOctree];

    /// The structure's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::BruteForce => "brute-force",
            Self::UniformGrid => "uniform-grid",
            Self::LinearOctree => "linear-octree",
        }
    }
}

impl FromStr for StructureChoice {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        std::iter::once(Self::Auto).chain(Self::ALL).find(|c| c.name() == text).ok_or_else(|| Error::InvalidSetting {
            setting: "structure",
            found: text.into(),
            expected: "auto, brute-force, uniform-grid or linear-octree",
        })
    }
}

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

/// A structure on a device, ready for questions.
pub struct Index {
    search: Box<dyn NeighborSearch + Send>,
    notes: Vec<String>,
    substitute: Option<Substitute>,
}

/// What the CPU needs to take over from a GPU that fails at a question.
struct Substitute {
    points: Vec<Vec3>,
    structure: StructureChoice,
    period: Period,
    built: OnceLock<Box<dyn NeighborSearch + Send>>,
}

impl Index {
    /// Builds what `settings` say over `points`, for questions like `question`.
    ///
    /// Only `DeviceChoice::Auto` falls back to the CPU: where no hardware GPU is found, or the GPU fails at the build
    /// or at a question (for which the index keeps a copy of the points); the notes say so, those of the reports too.
    ///
    /// # Errors
    /// As the builds: `NonFinite`, `CoordinateTooLarge`, `TooMany`, `InvalidSetting`; `NoDevice`;
    /// `OutOfDeviceMemory` and other device errors unless the device is `Auto`.
    pub fn build(points: &[Vec3], question: &FixedRadius<'_>, settings: &IndexSettings) -> Result<Self> {
        let mut notes = Vec::new();
        let gpu = match Gpu::open(&settings.device) {
            Ok(gpu) => gpu,
            Err(error) if settings.device == DeviceChoice::Auto => {
                notes.push(format!("the GPU could not be used ({error}); the CPU did the work"));
                None
            }
            Err(error) => return Err(error),
        };
        Self::assemble(gpu.as_ref(), points, question, settings, notes)
    }

    /// As [`Index::build`], on a GPU that is open already: of the device in `settings` only counts whether it is
    /// `Auto`, which lets the CPU take over.
    ///
    /// # Errors
    /// As [`Index::build`].
    pub fn build_on(gpu: &Gpu, points: &[Vec3], question: &FixedRadius<'_>, settings: &IndexSettings) -> Result<Self> {
        Self::assemble(Some(gpu), points, question, settings, Vec::new())
    }

    fn assemble(
        gpu: Option<&Gpu>,
        points: &[Vec3],
        question: &FixedRadius<'_>,
        settings: &IndexSettings,
        mut notes: Vec<String>,
    ) -> Result<Self> {
        let (auto, period) = (settings.device == DeviceChoice::Auto, settings.period);
        let structure = match settings.structure {
            StructureChoice::Auto => {
                let pairs = points.len() as u64 * question.len(points.len()) as u64;
                if pairs <= BRUTE_FORCE_PAIRS { StructureChoice::BruteForce } else { StructureChoice::UniformGrid }
            }
            chosen => chosen,
        };
        if let Some(gpu) = gpu {
            if gpu.kind() == AdapterKind::Software {
                notes.push(format!("{} is a software renderer: the CPU in disguise, and slower", gpu.name()));
            }
            match Self::on_gpu(gpu, points, question, structure, period) {
                Ok(search) => {
                    let copy = || Substitute { points: points.to_vec(), structure, period, built: OnceLock::new() };
                    return Ok(Self { search, notes, substitute: auto.then(copy) });
                }
                Err(error) if auto && error.is_device_fault() => notes.push(taken_over(gpu.name(), &error)),
                Err(error) => return Err(error),
            }
        }
        Ok(Self { search: Self::on_cpu(points, question, structure, period)?, notes, substitute: None })
    }

    /// Asks the structure, or the CPU where the GPU fails and the CPU may take over. Also returns the notes of the
    /// answer's report.
    fn ask<T>(
        &self,
        question: &FixedRadius<'_>,
        ask: impl Fn(&dyn NeighborSearch) -> Result<T>,
    ) -> Result<(T, Vec<String>)> {
        let mut notes = self.notes.clone();
        match (ask(self.search.as_ref()), &self.substitute) {
            (Err(error), Some(substitute)) if error.is_device_fault() => {
                notes.push(taken_over(&self.search.device(), &error));
                Ok((ask(substitute.search(question)?)?, notes))
            }
            (answer, _) => Ok((answer?, notes)),
        }
    }

    fn on_cpu(
        points: &[Vec3],
        question: &FixedRadius<'_>,
        structure: StructureChoice,
        period: Period,
    ) -> Result<Box<dyn NeighborSearch + Send>> {
        Ok(match structure {
            StructureChoice::BruteForce => Box::new(BruteForce::build_periodic(points, period)?),
            StructureChoice::UniformGrid | StructureChoice::Auto => {
                let settings = GridSettings::for_radius(question.largest_radius()).periodic(period);
                Box::new(UniformGrid::build(points, &settings)?)
            }
            StructureChoice::LinearOctree => {
                Box::new(LinearOctree::build(points, &OctreeSettings::default().periodic(period))?)
            }
        })
    }

    fn on_gpu(
        gpu: &Gpu,
        points: &[Vec3],
        question: &FixedRadius<'_>,
        structure: StructureChoice,
        period: Period,
    ) -> Result<Box<dyn NeighborSearch + Send>> {
        Ok(match structure {
            StructureChoice::BruteForce => Box::new(GpuBruteForce::build_periodic(gpu, points, period)?),
            StructureChoice::UniformGrid | StructureChoice::Auto => {
                let settings = GridSettings::for_radius(question.largest_radius()).periodic(period);
                Box::new(GpuUniformGrid::build(gpu, points, &settings)?)
            }
            StructureChoice::LinearOctree => {
                Box::new(GpuLinearOctree::build(gpu, points, &OctreeSettings::default().periodic(period))?)
            }
        })
    }

    /// What a user should know about the choice: a fallback, a software adapter.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }
}

impl Substitute {
    /// The structure on the CPU, built at the first use.
    fn search(&self, question: &FixedRadius<'_>) -> Result<&dyn NeighborSearch> {
        if self.built.get().is_none() {
            let built = Index::on_cpu(&self.points, question, self.structure, self.period)?;
            // Where two threads come here at once, the structure of the first one stays.
            let _ = self.built.set(built);
        }
        Ok(self.built.get().expect("the structure should have been set above").as_ref())
    }
}

/// The note on a GPU that the CPU replaced.
fn taken_over(device: &str, error: &Error) -> String {
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
        let (mut counts, notes) = self.ask(question, |search| search.count(question))?;
        counts.report.notes.extend(notes);
        Ok(counts)
    }

    fn list(&self, question: &FixedRadius<'_>) -> Result<Neighbors> {
        let (mut neighbors, notes) = self.ask(question, |search| search.list(question))?;
        neighbors.report.notes.extend(notes);
        Ok(neighbors)
    }

    fn nearest(&self, question: &FixedRadius<'_>) -> Result<Nearest> {
        let (mut nearest, notes) = self.ask(question, |search| search.nearest(question))?;
        nearest.report.notes.extend(notes);
        Ok(nearest)
    }
}
