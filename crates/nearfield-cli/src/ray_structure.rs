//! What subcommands over rays share: the choice of structure and device, and the structure once it is built.

use std::path::Path;
use std::time::Instant;

use clap::{Args, ValueEnum};
use nearfield::gpu::{AdapterKind, DeviceChoice};
use nearfield::query::Stage;
use nearfield::structure::{GpuRayStructure, RayStructure};
use nearfield::{
    BruteForceMesh, BvhSettings, Gpu, GpuBruteForceMesh, GpuKdTree, GpuTriangleBvh, KdBuild, KdStats, KdTraversal,
    KdTree, KdTreeSettings, Ray, RaySearch, RayStructureChoice, RayTask, TriMesh, TriangleBvh, Vec3,
};

use crate::exit::Failure;
use crate::fallback;
use crate::report::{Times, milliseconds};

/// Which structure is searched, and where.
#[derive(Debug, Args)]
pub(crate) struct StructureArgs {
    /// What finds the triangles along a ray; auto takes what is fastest for the number of rays and triangles, and says why;
    /// bounding-box is brute force for rays that meet the mesh's box [default: kd-tree for heat maps, else auto]
    #[arg(long, value_name = "S")]
    structure: Option<Structure>,

    /// Most triangles of a leaf of the kd-tree that is not cut; without --build its nodes are cut in the middle of their
    /// longest side
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    leaf: Option<u32>,

    /// Where nodes of the kd-tree are cut [default: spatial-median with --leaf, else binned-sah]
    #[arg(long, value_name = "B")]
    build: Option<Build>,

    /// How the kd-tree is walked on the CPU [default: ropes]
    #[arg(long, value_name = "W")]
    walk: Option<Walk>,

    /// Where rays are cast: auto, cpu, gpu, gpu:N as `nearfield devices` counts, or part of a name
    #[arg(long, value_name = "D", default_value = "auto")]
    device: DeviceChoice,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Structure {
    Auto,
    BruteForce,
    BoundingBox,
    KdTree,
    TriangleBvh,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Build {
    SpatialMedian,
    BinnedSah,
    ExactSah,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Walk {
    Ropes,
    Stack,
}

/// Triangles of a leaf of the tree cut in the middle where nothing is said: Accel's smallest.
const MEDIAN_LEAF: u32 = 20;

/// What is built, said once for all devices.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Plan {
    /// What is fastest for these rays.
    Auto(RayTask),
    BruteForce {
        within_box: bool,
    },
    KdTree {
        settings: KdTreeSettings,
        traversal: KdTraversal,
    },
    TriangleBvh,
}

impl StructureArgs {
    /// What to build, `usual` where nothing is said.
    pub(crate) fn plan(&self, usual: Structure) -> Result<Plan, Failure> {
        let structure = self.structure.unwrap_or(usual);
        if structure != Structure::KdTree {
            let set = [("leaf", self.leaf.is_some()), ("build", self.build.is_some()), ("walk", self.walk.is_some())];
            if let Some((option, _)) = set.into_iter().find(|(_, is_set)| *is_set) {
                let name = structure.to_possible_value().map_or(String::new(), |value| value.get_name().to_owned());
                return Err(Failure::Usage(format!(
                    "--{option} is about the kd-tree, and --structure is {name}: say --structure kd-tree or leave it out"
                )));
            }
        }
        Ok(match structure {
            Structure::Auto => Plan::Auto(RayTask::new(0)),
            Structure::BruteForce => Plan::BruteForce { within_box: false },
            Structure::BoundingBox => Plan::BruteForce { within_box: true },
            Structure::TriangleBvh => Plan::TriangleBvh,
            Structure::KdTree => Plan::KdTree {
                settings: self.kd_settings(),
                traversal: match self.walk {
                    Some(Walk::Stack) => KdTraversal::Stack,
                    _ => KdTraversal::Ropes,
                },
            },
        })
    }

    fn kd_settings(&self) -> KdTreeSettings {
        let usual = KdTreeSettings::default();
        match (self.build, self.leaf) {
            (None, None) => usual,
            (None | Some(Build::SpatialMedian), leaf) => KdTreeSettings::spatial_median(leaf.unwrap_or(MEDIAN_LEAF)),
            (Some(Build::BinnedSah), leaf) => usual.leaf_limit(leaf.unwrap_or(usual.leaf_limit)),
            (Some(Build::ExactSah), leaf) => {
                usual.build(KdBuild::ExactSah).leaf_limit(leaf.unwrap_or(usual.leaf_limit))
            }
        }
    }
}

impl Plan {
    /// The same, knowing what rays are to be cast.
    pub(crate) fn expecting(self, task: RayTask) -> Self {
        if let Self::Auto(_) = self { Self::Auto(task) } else { self }
    }

    /// What is built over so many triangles on a GPU of that kind or on the CPU, and why, where that was left open.
    fn chosen(self, triangles: usize, device: Option<AdapterKind>) -> (Self, Option<String>) {
        let Self::Auto(task) = self else { return (self, None) };
        let (structure, reason) = task.choose(triangles, device);
        let plan = match structure {
            RayStructureChoice::BruteForce => Self::BruteForce { within_box: false },
            RayStructureChoice::KdTree => {
                Self::KdTree { settings: KdTreeSettings::default(), traversal: KdTraversal::Ropes }
            }
            RayStructureChoice::TriangleBvh | RayStructureChoice::Auto => Self::TriangleBvh,
        };
        (plan, Some(reason))
    }

    /// What is built in a few words, for pictures and summaries.
    pub(crate) fn describe(&self) -> String {
        match self {
            Self::Auto(_) => "auto".to_owned(),
            Self::BruteForce { within_box: false } => "brute force".to_owned(),
            Self::BruteForce { within_box: true } => "brute force within the bounding box".to_owned(),
            Self::TriangleBvh => "triangle BVH".to_owned(),
            Self::KdTree { settings, .. } => match settings.build {
                KdBuild::SpatialMedian => format!("kd-tree, spatial median, leaves of {}", settings.leaf_limit),
                KdBuild::BinnedSah => "kd-tree, binned SAH".to_owned(),
                KdBuild::ExactSah => "kd-tree, exact SAH".to_owned(),
            },
        }
    }
}

/// A structure that was built, where it was built.
pub(crate) enum Rays {
    Cpu(Box<dyn RaySearch>),
    GpuBruteForce(GpuBruteForceMesh),
    GpuKdTree(GpuKdTree),
    GpuTriangleBvh(GpuTriangleBvh),
}

impl Rays {
    /// The queries.
    pub(crate) fn search(&self) -> &dyn RaySearch {
        match self {
            Self::Cpu(search) => search.as_ref(),
            Self::GpuBruteForce(structure) => structure,
            Self::GpuKdTree(structure) => structure,
            Self::GpuTriangleBvh(structure) => structure,
        }
    }
}

/// A structure and what is worth telling about it.
pub(crate) struct Built {
    pub(crate) rays: Rays,
    /// Name of the way it is searched.
    pub(crate) walk: &'static str,
    pub(crate) plan: Plan,
    /// Why this structure, where it was chosen here.
    pub(crate) reason: Option<String>,
    pub(crate) memory_bytes: u64,
    pub(crate) stages: Vec<Stage>,
    /// Figures of a kd-tree.
    pub(crate) kd: Option<KdStats>,
    /// Nodes and leaves of a hierarchy on the CPU.
    pub(crate) bvh: Option<[u64; 2]>,
}

impl Built {
    /// Builds on the device that was chosen; only `auto` falls back to the CPU, with a note. On a GPU `warm` asks a first
    /// question, so that kernels are compiled before anything is timed.
    ///
    /// # Errors
    /// As the structures' builds and `warm`; `NoDevice`.
    pub(crate) fn of(
        mesh: &TriMesh,
        args: &StructureArgs,
        plan: Plan,
        times: &mut Times,
        notes: &mut Vec<String>,
        warm: impl Fn(&dyn RaySearch, &[Ray]) -> nearfield::Result<()>,
    ) -> nearfield::Result<Self> {
        let clock = Instant::now();
        let on_gpu = |gpu: &Gpu| {
            let (plan, reason) = plan.chosen(mesh.triangles.len(), Some(gpu.kind()));
            let built = Self::on_gpu(gpu, mesh, plan)?;
            warm(built.rays.search(), &[Ray::new(Vec3::ZERO, Vec3::X)])?;
            Ok(Self { reason, ..built })
        };
        match fallback::on_gpu(&args.device, notes, on_gpu)? {
            Some(built) => {
                times.built(milliseconds(clock), &built.stages);
                Ok(built)
            }
            None => {
                let (plan, reason) = plan.chosen(mesh.triangles.len(), None);
                Ok(Self { reason, ..Self::on_cpu(mesh, plan, times)? })
            }
        }
    }

    fn on_cpu(mesh: &TriMesh, plan: Plan, times: &mut Times) -> nearfield::Result<Self> {
        let clock = Instant::now();
        let built = match plan {
            Plan::BruteForce { within_box } => {
                let list = BruteForceMesh::build(mesh)?;
                Self::cpu(if within_box { list.within_box() } else { list }, plan)
            }
            Plan::KdTree { settings, traversal } => {
                let tree = KdTree::build(mesh, &settings)?.with_traversal(traversal);
                let stats = tree.stats();
                Self { kd: Some(stats), ..Self::cpu(tree, plan) }
            }
            Plan::TriangleBvh | Plan::Auto(_) => {
                let bvh = TriangleBvh::build(mesh, &BvhSettings::default())?;
                let counts = [bvh.n_nodes() as u64, bvh.n_leaves() as u64];
                Self { bvh: Some(counts), ..Self::cpu(bvh, plan) }
            }
        };
        times.build = milliseconds(clock);
        Ok(built)
    }

    fn cpu<S: RayStructure + RaySearch + 'static>(structure: S, plan: Plan) -> Self {
        Self {
            walk: RayStructure::search(&structure),
            plan,
            reason: None,
            memory_bytes: RaySearch::memory_bytes(&structure),
            stages: RaySearch::build_stages(&structure),
            kd: None,
            bvh: None,
            rays: Rays::Cpu(Box::new(structure)),
        }
    }

    fn on_gpu(gpu: &Gpu, mesh: &TriMesh, plan: Plan) -> nearfield::Result<Self> {
        let (built, kd) = match plan {
            Plan::BruteForce { within_box } => {
                let list = GpuBruteForceMesh::build(gpu, mesh)?;
                let list = if within_box { list.within_box()? } else { list };
                (Self::gpu(Rays::GpuBruteForce(list), plan), None)
            }
            Plan::KdTree { settings, .. } => {
                let tree = KdTree::build(mesh, &settings)?;
                (Self::gpu(Rays::GpuKdTree(GpuKdTree::upload(gpu, &tree)?), plan), Some(tree.stats()))
            }
            Plan::TriangleBvh | Plan::Auto(_) => {
                let bvh = GpuTriangleBvh::build(gpu, mesh, &BvhSettings::default())?;
                (Self::gpu(Rays::GpuTriangleBvh(bvh), plan), None)
            }
        };
        Ok(Self { kd, ..built })
    }

    fn gpu(rays: Rays, plan: Plan) -> Self {
        let walk = match &rays {
            Rays::Cpu(_) => unreachable!("structures of the CPU should not get here"),
            Rays::GpuBruteForce(structure) => GpuRayStructure::search(structure),
            Rays::GpuKdTree(structure) => GpuRayStructure::search(structure),
            Rays::GpuTriangleBvh(structure) => GpuRayStructure::search(structure),
        };
        let (memory_bytes, stages) = (rays.search().memory_bytes(), rays.search().build_stages());
        Self { rays, walk, plan, reason: None, memory_bytes, stages, kd: None, bvh: None }
    }
}

/// A structure that cannot be built over the mesh is a fault of the file, unless memory or the device failed.
pub(crate) fn failed(input: &Path, error: nearfield::Error) -> Failure {
    match error {
        nearfield::Error::NoTriangles { .. }
        | nearfield::Error::NonFinite { .. }
        | nearfield::Error::CoordinateTooLarge { .. }
        | nearfield::Error::TooMany { .. } => Failure::reading(input)(error),
        other => Failure::Search(other),
    }
}
