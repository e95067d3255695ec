//! Neighbours of particles on a device, by any search: a model's visitor is run on them.

use std::ops::Range;

use bytemuck::Pod;
use glam::Vec3;

use super::gpu_list::GpuList;
use super::gpu_state::{GpuState, relative_domain};
use super::{ParticleScene, ParticleSearch};
use crate::Result;
use crate::geometry::Aabb;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu};
use crate::query::{DeviceQueries, Stage, VisitorModule, record_module};
use crate::structure::{
    AabbTreeSettings, BuildOrder, DevicePoint, GpuBruteForce, GpuMovingPoints, GpuStructure, GpuUniformGrid,
    GridBuilder, GridSettings, RebuildPolicy, TreeSearch,
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

/// Structures over the particles of a [`GpuState`].
pub(super) struct GpuNeighborhood {
    gpu: Gpu,
    search: ParticleSearch,
    deterministic: bool,
    domain: Aabb,
    /// `[own class][other class]` the distance within which the other acts.
    reach: Vec<Vec<f64>>,
    levels: Vec<Level>,
    rebuilds: u64,
}

/// Particles that are in one structure.
struct Level {
    /// All, or those of a class.
    members: Range<usize>,
    /// `[members]` their copies, where they are not all.
    part: Option<Buffer<DevicePoint>>,
    /// `[n]` radius of every particle, where they are not all one.
    radii: Option<Buffer<f32>>,
    radius: f32,
    structure: Structure,
}

enum Structure {
    BruteForce(GpuBruteForce),
    Grid(Box<(GridBuilder, GpuUniformGrid)>),
    Tree(Box<GpuMovingPoints>),
    List(Box<GpuList>),
}

/// A visitor of a model.
pub(super) struct ParticleVisitor<'a, P> {
    pub(super) module: &'static str,
    /// Conditions that it is compiled with, but for `deterministic` and `levels`.
    pub(super) features: &'a [(&'a str, bool)],
    /// `[levels]` parameters of each level, the first binding.
    pub(super) parameters: &'a [Buffer<P>],
    /// The other bindings.
    pub(super) bindings: &'a [(Access, Bind)],
    /// The last binding, where there are several levels: what is summed between them.
    pub(super) partial: Option<&'a (Access, Bind)>,
}

impl GpuNeighborhood {
    pub(super) fn new(
        gpu: &Gpu,
        scene: &ParticleScene,
        search: ParticleSearch,
        deterministic: bool,
        reach: Vec<Vec<f64>>,
    ) -> Self {
        let (domain, levels) = (relative_domain(scene), Vec::new());
        Self { gpu: gpu.clone(), search, deterministic, domain, reach, levels, rebuilds: 0 }
    }

    /// Number of structures, as a model must sum over them.
    pub(super) fn n_levels(&self) -> usize {
        if self.search == ParticleSearch::MultiLevelGrid { self.reach.len() } else { 1 }
    }

    /// Whether a step needs the host.
    pub(super) fn needs_host(&self) -> bool {
        let by_itself = matches!(
            self.search,
            ParticleSearch::BruteForce | ParticleSearch::UniformGrid | ParticleSearch::MultiLevelGrid
        );
        // Devices that end long loops are asked how long they would be.
        !by_itself || self.gpu.limits().loop_rounds.is_some()
    }

    /// Whether structures stand that follow without the host: recorded steps can then be submitted again and again.
    pub(super) fn can_repeat(&self) -> bool {
        !self.needs_host() && !self.levels.is_empty()
    }

    /// How often trees and lists were built anew since the start, without the first time.
    pub(super) fn rebuilds(&self) -> u64 {
        self.rebuilds
    }

    /// Forgets all structures: the particles have another order.
    pub(super) fn forget(&mut self) {
        self.levels.clear();
    }

    /// Makes the structures follow the particles.
    ///
    /// # Errors
    /// As the structures.
    pub(super) fn follow(&mut self, recorder: &mut Recorder, state: &GpuState) -> Result<()> {
        if self.levels.is_empty() {
            recorder.submit()?;
            self.levels = self.build_levels(state)?;
        }
        let needs_host = self.needs_host();
        for level in &mut self.levels {
            let points = match &level.part {
                Some(part) => {
                    recorder.commands().copy_from(&state.positions, level.members.start, part);
                    part
                }
                None => &state.positions,
            };
            match &mut level.structure {
                Structure::BruteForce(all) => all.replace_points(points)?,
                Structure::Grid(grid) => grid.0.record_rebuild(recorder.commands(), points, &mut grid.1)?,
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
        }
        if needs_host {
            recorder.submit()?;
        }
        Ok(())
    }

    fn build_levels(&self, state: &GpuState) -> Result<Vec<Level>> {
        if self.search == ParticleSearch::MultiLevelGrid {
            let level = |other: usize| {
                let mut members = state.classes[other].clone();
                if other + 1 == self.reach.len() {
                    members.end = state.len();
                }
                self.build_level(state, members, |own| self.reach[own][other])
            };
            return (0..self.reach.len()).map(level).collect();
        }
        let largest = |own: usize| self.reach[own].iter().copied().fold(0.0, f64::max);
        Ok(vec![self.build_level(state, 0..state.len(), largest)?])
    }

    fn build_level(&self, state: &GpuState, members: Range<usize>, reach: impl Fn(usize) -> f64) -> Result<Level> {
        let gpu = &self.gpu;
        let by_class: Vec<f32> = (0..self.reach.len()).map(|own| (reach(own) as f32).next_up()).collect();
        let radius = by_class.iter().copied().fold(0.0, f32::max);
        let radii = if by_class.iter().any(|&own| own != radius) {
            let mut radii = vec![radius; state.len()];
            state.classes.iter().zip(&by_class).for_each(|(class, &own)| radii[class.clone()].fill(own));
            Some(gpu.upload("radii of particles", &radii)?)
        } else {
            None
        };
        let part = match members.len() == state.len() {
            true => None,
            false => Some(gpu.buffer("particles of a level", members.len())?),
        };
        if let Some(part) = &part {
            let mut commands = gpu.commands("particles of a level");
            commands.copy_from(&state.positions, members.start, part);
            commands.submit()?;
        }
        let points = part.as_ref().unwrap_or(&state.positions);
        let tree = |policy: RebuildPolicy, search: TreeSearch| -> Result<Structure> {
            let at = |p: &DevicePoint| Vec3::new(p[0], p[1], p[2]);
            let points: Vec<Vec3> = gpu.read(points)?.iter().map(at).collect();
            let settings = AabbTreeSettings::DEFAULT.order(BuildOrder::Hilbert).search(search);
            Ok(Structure::Tree(Box::new(GpuMovingPoints::new(gpu, &points, radius, &settings, policy)?)))
        };
        let structure = match self.search {
            ParticleSearch::BruteForce => Structure::BruteForce(GpuBruteForce::build_on_device(gpu, points)?),
            ParticleSearch::UniformGrid | ParticleSearch::MultiLevelGrid => {
                let settings = GridSettings::for_radius(radius);
                let mut builder = GridBuilder::new(gpu, points.len(), &self.domain, &settings)?;
                let grid = builder.build(points)?;
                Structure::Grid(Box::new((builder, grid)))
            }
            ParticleSearch::AabbTree(policy) => tree(policy, TreeSearch::Packed)?,
            ParticleSearch::Primary(policy) => tree(policy, TreeSearch::Primary)?,
            ParticleSearch::Coherent(policy) => tree(policy, TreeSearch::Coherent)?,
            ParticleSearch::Verlet { skin } => {
                Structure::List(Box::new(GpuList::new(gpu, &self.domain, points, radius, skin as f32 * radius)?))
            }
        };
        Ok(Level { members, part, radii, radius, structure })
    }

    /// Records a visitor over all particles, once for each level.
    ///
    /// # Errors
    /// As [`record_module`].
    pub(super) fn record_visit<P: Pod>(
        &self,
        recorder: &mut Recorder,
        state: &GpuState,
        visitor: &ParticleVisitor<'_, P>,
    ) -> Result<()> {
        let mut features = vec![("deterministic", self.deterministic)];
        if let Some(partial) = visitor.partial {
            features.push(("levels", self.levels.len() > 1));
            debug_assert!(partial.0 == Access::ReadWrite, "sums between levels should be written");
        }
        features.extend_from_slice(visitor.features);
        for (number, level) in self.levels.iter().enumerate() {
            let mut bindings: Vec<(Access, Bind)> = vec![(Access::Uniform, (&visitor.parameters[number]).into())];
            bindings.extend_from_slice(visitor.bindings);
            bindings.extend(visitor.partial.filter(|_| self.levels.len() > 1).cloned());
            let module =
                VisitorModule { module: visitor.module, features: &features, bindings: &bindings, rounds: [0, 0] };
            let commands = recorder.commands();
            match &level.structure {
                Structure::BruteForce(all) => level.record(commands, all, state, &module)?,
                Structure::Grid(grid) => level.record(commands, &grid.1, state, &module)?,
                Structure::Tree(tree) => level.record(commands, tree.tree(), state, &module)?,
                Structure::List(list) => level.record(commands, &**list, state, &module)?,
            }
        }
        Ok(())
    }
}

impl Level {
    fn record<S: GpuStructure>(
        &self,
        commands: &mut Commands,
        structure: &S,
        state: &GpuState,
        module: &VisitorModule<'_>,
    ) -> Result<()> {
        // Those of a structure are in the better order, but they may be a part only.
        let points = if self.part.is_some() { &state.positions } else { structure.points() };
        let mut queries = DeviceQueries::new(points, self.radius);
        if let Some(radii) = &self.radii {
            queries = queries.radii(radii);
        }
        record_module(commands, structure, &queries, module)
    }
}
