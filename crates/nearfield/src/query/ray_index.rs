//! A structure over triangles and a device chosen by words, for programs that let their users choose.

use std::sync::{Arc, OnceLock};

use super::index::{open, taken_over};
use super::ray_choice::{RayStructureChoice, RayTask};
use super::{HitCounts, HitLists, Hits, Occlusion, RayHit, RaySearch, Report, Stage};
use crate::Result;
use crate::geometry::{Ray, TriMesh};
use crate::gpu::{AdapterKind, DeviceChoice, Gpu};
use crate::structure::{
    BruteForceMesh, BvhSettings, GpuBruteForceMesh, GpuKdTree, GpuTriangleBvh, KdTree, KdTreeSettings,
    PreparedTriangles, RayWork, TriangleBvh,
};

/// What to build over a mesh and where.
#[derive(Debug, Clone, Default)]
pub struct RayIndexSettings {
    /// The structure.
    pub structure: RayStructureChoice,
    /// The device.
    pub device: DeviceChoice,
}

/// A structure over the triangles of a mesh on a device, ready for rays.
///
/// ```
/// use nearfield::{DeviceChoice, Ray, RayIndex, RayIndexSettings, RaySearch, RayTask, TriMesh, Vec3};
///
/// let corners = vec![Vec3::ZERO, Vec3::new(4.0, 0.0, 0.0), Vec3::new(0.0, 4.0, 0.0)];
/// let mesh = TriMesh::new(corners, vec![[0, 1, 2]])?;
/// let settings = RayIndexSettings { device: DeviceChoice::Cpu, ..RayIndexSettings::default() };
/// let index = RayIndex::build(&mesh, &RayTask::new(1), &settings)?;
/// assert_eq!(index.structure(), "brute-force");
/// assert!(index.any_hit(&Ray::new(Vec3::new(1.0, 1.0, 5.0), -Vec3::Z))?);
/// # Ok::<(), nearfield::Error>(())
/// ```
pub struct RayIndex {
    held: Held,
    /// Why this structure, where it was chosen.
    reason: Option<String>,
    notes: Vec<String>,
    /// The CPU's structure, built when the GPU fails; `None` where the CPU must not take over.
    substitute: Option<OnceLock<Held>>,
    /// The rays to choose for, where the structure is not named.
    chooses_for: Option<RayTask>,
}

/// The structures there are.
enum Held {
    BruteForce(BruteForceMesh),
    KdTree(KdTree),
    TriangleBvh(TriangleBvh),
    GpuBruteForce(GpuBruteForceMesh),
    GpuKdTree(GpuKdTree),
    GpuTriangleBvh(GpuTriangleBvh),
}

impl Held {
    fn on_cpu(structure: RayStructureChoice, triangles: Arc<PreparedTriangles>) -> Result<Self> {
        Ok(match structure {
            RayStructureChoice::BruteForce => Self::BruteForce(BruteForceMesh::of(triangles)),
            RayStructureChoice::KdTree => Self::KdTree(KdTree::of(triangles, &KdTreeSettings::default())?),
            RayStructureChoice::TriangleBvh | RayStructureChoice::Auto => {
                Self::TriangleBvh(TriangleBvh::of(triangles, &BvhSettings::default())?)
            }
        })
    }

    fn on_gpu(gpu: &Gpu, structure: RayStructureChoice, triangles: Arc<PreparedTriangles>) -> Result<Self> {
        Ok(match structure {
            RayStructureChoice::BruteForce => Self::GpuBruteForce(GpuBruteForceMesh::of(gpu, triangles)?),
            RayStructureChoice::KdTree => {
                let tree = KdTree::of(triangles, &KdTreeSettings::default())?;
                Self::GpuKdTree(GpuKdTree::upload(gpu, &tree)?)
            }
            RayStructureChoice::TriangleBvh | RayStructureChoice::Auto => {
                Self::GpuTriangleBvh(GpuTriangleBvh::of(gpu, triangles, &BvhSettings::default())?)
            }
        })
    }

    /// What stands here, and the device where that is a GPU.
    fn kind(&self) -> (RayStructureChoice, Option<&Gpu>) {
        use crate::structure::GpuRayStructure;
        match self {
            Self::BruteForce(_) => (RayStructureChoice::BruteForce, None),
            Self::KdTree(_) => (RayStructureChoice::KdTree, None),
            Self::TriangleBvh(_) => (RayStructureChoice::TriangleBvh, None),
            Self::GpuBruteForce(structure) => (RayStructureChoice::BruteForce, Some(structure.gpu())),
            Self::GpuKdTree(structure) => (RayStructureChoice::KdTree, Some(structure.gpu())),
            Self::GpuTriangleBvh(structure) => (RayStructureChoice::TriangleBvh, Some(structure.gpu())),
        }
    }

    fn search(&self) -> &dyn RaySearch {
        match self {
            Self::BruteForce(structure) => structure,
            Self::KdTree(structure) => structure,
            Self::TriangleBvh(structure) => structure,
            Self::GpuBruteForce(structure) => structure,
            Self::GpuKdTree(structure) => structure,
            Self::GpuTriangleBvh(structure) => structure,
        }
    }

    /// Follows a mesh whose vertices have moved: hierarchies are fitted, the others built anew.
    fn follow(&mut self, moved: &TriMesh) -> Result<()> {
        match self {
            Self::TriangleBvh(structure) => return structure.refit(moved),
            Self::GpuTriangleBvh(structure) => return structure.refit(moved),
            _ => {}
        }
        let triangles = PreparedTriangles::new(moved)?;
        *self = match self.kind() {
            (structure, None) => Self::on_cpu(structure, triangles)?,
            (structure, Some(gpu)) => Self::on_gpu(gpu, structure, triangles)?,
        };
        Ok(())
    }
}

impl RayIndex {
    /// Builds what `settings` say over the triangles of a mesh, for rays like those of `task`.
    ///
    /// [`RayStructureChoice::Auto`] takes the structure of [`RayTask::choose`]; [`RayIndex::reason`] gives the figures.
    ///
    /// Only `DeviceChoice::Auto` falls back to the CPU: where no hardware GPU is found, or the GPU fails at the build, at a
    /// refit or at a question; the notes say so, those of the reports too.
    ///
    /// # Errors
    /// As the builds: `NoTriangles`, `NonFinite`, `CoordinateTooLarge`, `TooMany`; `NoDevice`; `OutOfDeviceMemory` and
    /// other device errors unless the device is `Auto`.
    pub fn build(mesh: &TriMesh, task: &RayTask, settings: &RayIndexSettings) -> Result<Self> {
        let mut notes = Vec::new();
        let gpu = open(&settings.device, &mut notes)?;
        Self::assemble(gpu.as_ref(), mesh, task, settings, notes)
    }

    /// As [`RayIndex::build`], on a GPU that is open already: of the device in `settings` only counts whether it is
    /// `Auto`, which lets the CPU take over.
    ///
    /// # Errors
    /// As [`RayIndex::build`].
    pub fn build_on(gpu: &Gpu, mesh: &TriMesh, task: &RayTask, settings: &RayIndexSettings) -> Result<Self> {
        Self::assemble(Some(gpu), mesh, task, settings, Vec::new())
    }

    fn assemble(
        gpu: Option<&Gpu>,
        mesh: &TriMesh,
        task: &RayTask,
        settings: &RayIndexSettings,
        mut notes: Vec<String>,
    ) -> Result<Self> {
        let auto = settings.device == DeviceChoice::Auto;
        let triangles = PreparedTriangles::new(mesh)?;
        let chooses_for = (settings.structure == RayStructureChoice::Auto).then_some(*task);
        let choose = |kind| chosen(chooses_for.as_ref(), settings.structure, triangles.len(), kind);
        if let Some(gpu) = gpu {
            if gpu.kind() == AdapterKind::Software {
                notes.push(format!("{} is a software renderer: the CPU in disguise, and slower", gpu.name()));
            }
            let (structure, reason) = choose(Some(gpu.kind()));
            match Held::on_gpu(gpu, structure, triangles.clone()) {
                Ok(held) => {
                    return Ok(Self { held, reason, notes, substitute: auto.then(OnceLock::new), chooses_for });
                }
                Err(error) if auto && error.is_device_fault() => notes.push(taken_over(gpu.name(), &error)),
                Err(error) => return Err(error),
            }
        }
        let (structure, reason) = choose(None);
        Ok(Self { held: Held::on_cpu(structure, triangles)?, reason, notes, substitute: None, chooses_for })
    }

    /// Takes a mesh of the same triangles with moved vertices: a hierarchy is fitted to it ([`TriangleBvh::refit`],
    /// [`GpuTriangleBvh::refit`]), other structures are built anew. Answers are exact.
    ///
    /// # Errors
    /// `LengthMismatch` for another number of triangles; as [`RayIndex::build`]. The index is then as it was.
    pub fn refit(&mut self, moved: &TriMesh) -> Result<()> {
        self.prepared().check_moved(moved)?;
        match self.held.follow(moved) {
            Err(error) if self.substitute.is_some() && error.is_device_fault() => {
                let note = taken_over(&self.device(), &error);
                let (structure, reason) = self.chosen_for_cpu();
                self.held = Held::on_cpu(structure, PreparedTriangles::new(moved)?)?;
                self.reason = reason;
                self.notes.push(note);
                self.substitute = None;
            }
            followed => followed?,
        }
        if let Some(substitute) = &mut self.substitute {
            *substitute = OnceLock::new();
        }
        Ok(())
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

    /// Asks the structure, or the CPU where the GPU fails and the CPU may take over; the answer, and notes on it.
    fn ask<T>(&self, ask: impl Fn(&dyn RaySearch) -> Result<T>) -> Result<(T, Vec<String>)> {
        let mut notes = self.notes.clone();
        let answer = match (ask(self.held.search()), &self.substitute) {
            (Err(error), Some(substitute)) if error.is_device_fault() => {
                notes.push(taken_over(&self.device(), &error));
                notes.extend(self.chosen_for_cpu().1);
                ask(self.substitute(substitute)?.search())?
            }
            (answer, _) => answer?,
        };
        Ok((answer, notes))
    }

    /// As [`RayIndex::ask`] for answers with a report, which `report_of` finds.
    fn ask_reported<T>(
        &self,
        ask: impl Fn(&dyn RaySearch) -> Result<T>,
        report_of: impl Fn(&mut T) -> &mut Report,
    ) -> Result<T> {
        let (mut answer, notes) = self.ask(ask)?;
        let report = report_of(&mut answer);
        report.notes.extend(notes);
        report.reason = self.reason.clone();
        Ok(answer)
    }

    /// What stands on the CPU where that takes over, and why.
    fn chosen_for_cpu(&self) -> (RayStructureChoice, Option<String>) {
        chosen(self.chooses_for.as_ref(), self.held.kind().0, self.prepared().len(), None)
    }

    /// The structure on the CPU, built at the first use.
    fn substitute<'a>(&self, substitute: &'a OnceLock<Held>) -> Result<&'a Held> {
        if substitute.get().is_none() {
            let triangles = Arc::new(self.prepared().clone());
            // Where two threads come here at once, the structure of the first one stays.
            let _ = substitute.set(Held::on_cpu(self.chosen_for_cpu().0, triangles)?);
        }
        Ok(substitute.get().expect("the structure should have been set above"))
    }
}

/// The structure for the rays of a task and why, or without a task the one that was named.
fn chosen(
    task: Option<&RayTask>,
    named: RayStructureChoice,
    triangles: usize,
    device: Option<AdapterKind>,
) -> (RayStructureChoice, Option<String>) {
    let Some(task) = task else { return (named, None) };
    let (structure, reason) = task.choose(triangles, device);
    (structure, Some(reason))
}

impl RaySearch for RayIndex {
    fn structure(&self) -> &'static str {
        self.held.search().structure()
    }

    fn device(&self) -> String {
        self.held.search().device()
    }

    fn prepared(&self) -> &PreparedTriangles {
        self.held.search().prepared()
    }

    fn memory_bytes(&self) -> u64 {
        self.held.search().memory_bytes()
    }

    fn build_stages(&self) -> Vec<Stage> {
        self.held.search().build_stages()
    }

    fn closest_hits(&self, rays: &[Ray]) -> Result<Hits> {
        self.ask_reported(|search| search.closest_hits(rays), |hits| &mut hits.report)
    }

    fn closest_hits_with_work(&self, rays: &[Ray]) -> Result<(Hits, Vec<RayWork>)> {
        self.ask_reported(|search| search.closest_hits_with_work(rays), |(hits, _)| &mut hits.report)
    }

    fn any_hits(&self, rays: &[Ray]) -> Result<Occlusion> {
        self.ask_reported(|search| search.any_hits(rays), |hits| &mut hits.report)
    }

    fn all_hits(&self, rays: &[Ray]) -> Result<HitLists> {
        self.ask_reported(|search| search.all_hits(rays), |hits| &mut hits.report)
    }

    fn count_hits(&self, rays: &[Ray]) -> Result<HitCounts> {
        self.ask_reported(|search| search.count_hits(rays), |hits| &mut hits.report)
    }

    fn closest_hit(&self, ray: &Ray) -> Result<Option<RayHit>> {
        self.ask(|search| search.closest_hit(ray)).map(|(hit, _)| hit)
    }

    fn any_hit(&self, ray: &Ray) -> Result<bool> {
        self.ask(|search| search.any_hit(ray)).map(|(is_hit, _)| is_hit)
    }

    fn all_hits_of(&self, ray: &Ray) -> Result<Vec<RayHit>> {
        self.ask(|search| search.all_hits_of(ray)).map(|(hits, _)| hits)
    }

    fn count_hits_of(&self, ray: &Ray) -> Result<u32> {
        self.ask(|search| search.count_hits_of(ray)).map(|(count, _)| count)
    }
}
