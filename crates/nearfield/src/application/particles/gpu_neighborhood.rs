//! Neighbours of particles on a device, by any search: a model's visitor is run on them.

use std::ops::Range;

use glam::Vec3;

use super::gpu_list::GpuList;
use super::gpu_state::{GpuState, relative_domain};
use super::reach::Reach;
use super::{ParticleScene, ParticleSearch};
use crate::Result;
use crate::geometry::Aabb;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu};
use crate::query::{DeviceQueries, Stage, VisitorModule, record_module};
use crate::structure::{
    AabbTreeSettings, BuildOrder, DevicePoint, EntryOrder, GpuBruteForce, GpuMovingPoints, GpuMultiLevelGrid,
    GpuStructure, GpuUniformGrid, GridBuilder, GridSettings, MultiLevelGridBuilder, RebuildPolicy, TreeSearch,
};

/// Commands of steps, submitted in parts where a structure needs the host.
pub(super) struct Recorder {
    gpu: Gpu,
    commands: Commands,
    /// Times of stages, where they are taken: each submission is then waited for.
    times: Option<Vec<Stage>>,
}

impl Recorder {
    pub(super) fn new(gpu: &Gpu) -> Self {
        Self { gpu: gpu.clone(), commands: gpu.commands("particles"), times: None }
    }

    /// One that takes times.
    pub(super) fn timed(gpu: &Gpu) -> Self {
        Self { times: Some(Vec::new()), ..Self::new(gpu) }
    }

    /// The times that were taken.
    pub(super) fn into_times(self) -> Vec<Stage> {
        self.times.unwrap_or_default()
    }

    /// What is recorded into.
    pub(super) fn commands(&mut self) -> &mut Commands {
        &mut self.commands
    }

    /// Submits what is recorded so far.
    ///
    /// # Errors
    /// As [`Commands::submit`].
    pub(super) fn submit(&mut self) -> Result<()> {
        self.submit_repeated(1)
    }

    /// Submits what is recorded so many times.
    ///
    /// # Errors
    /// As [`Commands::submit`].
    pub(super) fn submit_repeated(&mut self, times: u32) -> Result<()> {
        let commands = std::mem::replace(&mut self.commands, self.gpu.commands("particles"));
        let Some(taken) = &mut self.times else {
            return commands.submit_repeated(times);
        };
        taken.extend(commands.run()?.iter().filter_map(Stage::on_device));
        Ok(())
    }
}

/// A structure over the particles of a [`GpuState`].
pub(super) struct GpuNeighborhood {
    gpu: Gpu,
    search: ParticleSearch,
    deterministic: bool,
    domain: Aabb,
    reach: Reach,
    searched: Option<Searched>,
    rebuilds: u64,
}

/// Particles as they are searched.
struct Searched {
    structure: Structure,
    /// The largest radius of a question.
    radius: f32,
    /// `[n]` that of every particle, where they are not all one.
    radii: Option<Buffer<f32>>,
}

enum Structure {
    BruteForce(GpuBruteForce),
    Grid(Box<(GridBuilder, GpuUniformGrid)>),
    Levels(Box<(MultiLevelGridBuilder, GpuMultiLevelGrid)>),
    Tree(Box<GpuMovingPoints>),
    List(Box<GpuList>),
}

/// A visitor of a model.
pub(super) struct ParticleVisitor<'a> {
    pub(super) module: &'static str,
    /// Conditions that it is compiled with, but for `deterministic`.
    pub(super) features: &'a [(&'a str, bool)],
    pub(super) bindings: &'a [(Access, Bind)],
}

impl GpuNeighborhood {
    pub(super) fn new(
        gpu: &Gpu,
        scene: &ParticleScene,
        search: ParticleSearch,
        deterministic: bool,
        reach: Reach,
    ) -> Self {
        let domain = relative_domain(scene);
        Self { gpu: gpu.clone(), search, deterministic, domain, reach, searched: None, rebuilds: 0 }
    }

    /// Whether the structure takes all points anew in each step, without the host.
    fn starts_anew(&self) -> bool {
        use ParticleSearch::{BruteForce, MultiLevelGrid, UniformGrid};
        matches!(self.search, BruteForce | UniformGrid { .. } | MultiLevelGrid)
    }

    /// Whether a step needs the host.
    fn needs_host(&self) -> bool {
        // Devices that end long loops are asked how long they would be.
        !self.starts_anew() || self.gpu.limits().loop_rounds.is_some()
    }

    /// Whether a structure stands that follows without the host: recorded steps can then be submitted again and again.
    pub(super) fn can_repeat(&self) -> bool {
        !self.needs_host() && self.searched.is_some()
    }

    /// How often trees and lists were built anew since the start, without the first time.
    pub(super) fn rebuilds(&self) -> u64 {
        self.rebuilds
    }

    /// Forgets the structure: the particles are others.
    pub(super) fn forget(&mut self) {
        self.searched = None;
    }

    /// Forgets what the structure knows of single particles: those of each class have another order.
    pub(super) fn forget_order(&mut self) {
        if !self.starts_anew() {
            self.searched = None;
        }
    }

    /// Makes the structure follow the particles.
    ///
    /// # Errors
    /// As the structures.
    pub(super) fn follow(&mut self, recorder: &mut Recorder, state: &GpuState) -> Result<()> {
        let mut searched = match self.searched.take() {
            Some(searched) => searched,
            None => {
                recorder.submit()?;
                self.build(state)?
            }
        };
        let points = &state.positions;
        match &mut searched.structure {
            Structure::BruteForce(all) => all.replace_points(points)?,
            Structure::Grid(grid) => grid.0.record_rebuild(recorder.commands(), points, &mut grid.1)?,
            Structure::Levels(grid) => grid.0.record_rebuild(recorder.commands(), points, &mut grid.1)?,
            Structure::Tree(tree) => {
                recorder.submit()?;
                let report = tree.update_on_device(points)?;
                self.rebuilds += u64::from(report.is_rebuild());
                if let Some(times) = &mut recorder.times {
                    times.extend(report.stages.iter().map(Stage::from));
                }
            }
            Structure::List(list) => {
                recorder.submit()?;
                self.rebuilds += u64::from(list.follow(points)?);
            }
        }
        self.searched = Some(searched);
        if self.needs_host() {
            recorder.submit()?;
        }
        Ok(())
    }

    fn build(&self, state: &GpuState) -> Result<Searched> {
        let (gpu, points, reach) = (&self.gpu, &state.positions, &self.reach);
        // A grid of several levels adds the radius of each; the others are asked for the farthest reach of each class.
        let is_levels = self.search == ParticleSearch::MultiLevelGrid;
        let of_class = |own: usize| if is_levels { reach.radii()[own] } else { reach.farthest(own) };
        let by_class: Vec<f32> = (0..reach.radii().len()).map(|own| (of_class(own) as f32).next_up()).collect();
        let radius = by_class.iter().copied().fold(0.0, f32::max);
        let radii = if by_class.iter().any(|&own| own != radius) {
            let mut radii = vec![radius; state.len()];
            state.classes.iter().zip(&by_class).for_each(|(class, &own)| radii[class.clone()].fill(own));
            Some(gpu.upload("radii of particles", &radii)?)
        } else {
            None
        };
        let tree = |policy: RebuildPolicy, search: TreeSearch| -> Result<Structure> {
            let at = |p: &DevicePoint| Vec3::new(p[0], p[1], p[2]);
            let points: Vec<Vec3> = gpu.read(points)?.iter().map(at).collect();
            let settings = AabbTreeSettings::DEFAULT.order(BuildOrder::Hilbert).search(search);
            Ok(Structure::Tree(Box::new(GpuMovingPoints::new(gpu, &points, radius, &settings, policy)?)))
        };
        let order = if self.deterministic { EntryOrder::AsGiven } else { EntryOrder::Any };
        let structure = match self.search {
            ParticleSearch::BruteForce => Structure::BruteForce(GpuBruteForce::build_on_device(gpu, points)?),
            ParticleSearch::UniformGrid { .. } => {
                let cells = GridSettings::for_radius(self.search.cell_size(radius));
                let mut builder = GridBuilder::with_order(gpu, points.len(), &self.domain, &cells, order)?;
                let grid = builder.build(points)?;
                Structure::Grid(Box::new((builder, grid)))
            }
            ParticleSearch::MultiLevelGrid => {
                let mut levels: Vec<(usize, f32)> = state.classes.iter().map(Range::len).zip(by_class).collect();
                // The boundary stands behind the last class.
                levels.last_mut().expect("a model should have a class").0 += state.len() - state.n_moving;
                let builder = MultiLevelGridBuilder::new(gpu, &levels, reach.level_rule(), &self.domain, order)?;
                let grid = builder.build(points)?;
                Structure::Levels(Box::new((builder, grid)))
            }
            ParticleSearch::AabbTree(policy) => tree(policy, TreeSearch::Packed)?,
            ParticleSearch::Primary(policy) => tree(policy, TreeSearch::Primary)?,
            ParticleSearch::Coherent(policy) => tree(policy, TreeSearch::Coherent)?,
            ParticleSearch::Verlet { skin } => {
                Structure::List(Box::new(GpuList::new(gpu, &self.domain, points, radius, skin as f32 * radius)?))
            }
        };
        Ok(Searched { structure, radius, radii })
    }

    /// Makes the structure follow the particles and records a count of the neighbours of each, itself among them.
    ///
    /// # Errors
    /// As [`GpuNeighborhood::follow`] and [`GpuNeighborhood::record_visit`].
    pub(super) fn record_count(
        &mut self,
        recorder: &mut Recorder,
        state: &GpuState,
        counts: &Buffer<u32>,
    ) -> Result<()> {
        self.follow(recorder, state)?;
        let bindings = [(Access::ReadWrite, counts.into())];
        let visitor = ParticleVisitor { module: "package::query::count", features: &[], bindings: &bindings };
        self.record_visit(recorder, &visitor)
    }

    /// Records a visitor over all particles.
    ///
    /// # Errors
    /// As [`record_module`].
    ///
    /// # Panics
    /// If the structure does not follow the particles yet.
    pub(super) fn record_visit(&self, recorder: &mut Recorder, visitor: &ParticleVisitor<'_>) -> Result<()> {
        let searched = self.searched.as_ref().expect("a structure should follow the particles before it is asked");
        let features = [&[("deterministic", self.deterministic)], visitor.features].concat();
        let ParticleVisitor { module, bindings, .. } = *visitor;
        let module = VisitorModule { module, features: &features, bindings, rounds: [0, 0], combines: true };
        let commands = recorder.commands();
        match &searched.structure {
            Structure::BruteForce(all) => searched.record(commands, all, &module),
            Structure::Grid(grid) => searched.record(commands, &grid.1, &module),
            Structure::Levels(grid) => searched.record(commands, &grid.1, &module),
            Structure::Tree(tree) => searched.record(commands, tree.tree(), &module),
            Structure::List(list) => searched.record(commands, &**list, &module),
        }
    }
}

impl Searched {
    fn record<S: GpuStructure>(
        &self,
        commands: &mut Commands,
        structure: &S,
        module: &VisitorModule<'_>,
    ) -> Result<()> {
        let mut queries = DeviceQueries::new(structure.points(), self.radius);
        if let Some(radii) = &self.radii {
            queries = queries.radii(radii);
        }
        record_module(commands, structure, &queries, module)
    }
}
