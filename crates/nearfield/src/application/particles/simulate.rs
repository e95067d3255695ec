//! What a simulation does, on the CPU and on a device.

use super::{Measures, ParticleScene, Particles};
use crate::application::Watch;
use crate::{Error, Result};

/// A simulation under way.
pub trait Simulate: Send {
    /// What it started from.
    fn scene(&self) -> &ParticleScene;

    /// Where it runs: "cpu (…)" or the adapter's name.
    fn device(&self) -> String;

    /// Makes so many steps; returns what each did.
    ///
    /// # Errors
    /// `BlowUp` where a particle has left what can be simulated: step and particle are named, and the particles are as they were before
    /// that step (on a device: before the steps that were submitted together with it). `Interrupted` where the watch ends it, between two
    /// steps. As the search of neighbours. What the steps did that were finished before, and led to where the particles are, says
    /// [`Simulate::take_reports`].
    fn advance(&mut self, steps: u32, watch: &mut Watch<'_>) -> Result<Vec<StepReport>>;

    /// What the finished steps of the last [`Simulate::advance`] did, where it has failed: from its first up to [`Simulate::step`], handed
    /// out once. Nothing after a call that returned its reports, and after [`Simulate::resume`].
    fn take_reports(&mut self) -> Vec<StepReport>;

    /// Finds the neighbours of all particles as a step does, but only counts them, and takes the time: what a step would take without its
    /// model. The structures that the last step has left are fitted or built anew first, as if the particles had moved. The particles are as
    /// they were.
    ///
    /// # Errors
    /// As the search of neighbours; on a device `OutOfDeviceMemory`, `DeviceLost`.
    fn time_search(&mut self) -> Result<SearchTime>;

    /// Steps made so far.
    fn step(&self) -> u64;

    /// Time that has passed in the scene.
    fn time(&self) -> f64;

    /// The particles as they are now, by the index they have in the scene.
    ///
    /// # Errors
    /// On a device: `OutOfDeviceMemory` for staging memory, `OutOfMemory`, `DeviceLost`.
    fn particles(&self) -> Result<Particles>;

    /// Energies, momentum and what else is conserved or bounded, of the particles as they are now.
    ///
    /// # Errors
    /// As [`Simulate::particles`].
    fn measure(&self) -> Result<Measures> {
        Ok(Measures::of(self.scene(), &self.particles()?))
    }

    /// Goes on from particles that were saved.
    ///
    /// # Errors
    /// As [`ParticleScene::validate`] with these particles, which may have left the domain; `LengthMismatch` for another number of them, and
    /// `InvalidSetting` for other classes. The simulation is then as it was.
    fn resume(&mut self, particles: &Particles, step: u64, time: f64) -> Result<()>;

    /// `[n]` the indices of the particles in the order in which they are kept, where going on from it gives the same bits: on the CPU. On a device
    /// that of the scene.
    ///
    /// # Errors
    /// As [`Simulate::particles`].
    fn order(&self) -> Result<Vec<u32>> {
        Ok((0..self.scene().particles.len() as u32).collect())
    }

    /// As [`Simulate::resume`], and on the CPU puts the particles into the order in which they were kept: sums depend on it.
    ///
    /// # Errors
    /// As [`Simulate::resume`], and `InvalidSetting` for an order that does not have every particle once.
    fn resume_in_order(&mut self, particles: &Particles, order: &[u32], step: u64, time: f64) -> Result<()> {
        same_order(order, particles.len())?;
        self.resume(particles, step, time)
    }
}

/// A search of all neighbours by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SearchTime {
    /// Seconds it took; a device was waited for.
    pub seconds: f64,
    /// Pairs that were found, both ways counted and each particle itself among its own, within the reach and what rounding makes of it. For
    /// [`MultiLevelGrid`](super::ParticleSearch::MultiLevelGrid) that is the distance from which the other's class acts on the particle's;
    /// for all other searches, which know one radius a particle, the farthest from which any class does. What lists hold within their
    /// skin alone is looked at, but not counted.
    pub neighbors: u64,
}

/// What one step did.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepReport {
    /// Its number, from 1.
    pub step: u64,
    /// Time in the scene after it.
    pub time: f64,
    /// How far it led.
    pub time_step: f64,
    /// Mean number of others that act on a particle.
    pub mean_neighbors: f64,
    /// Iterations of the model's solvers.
    pub iterations: u32,
    /// Mean and largest compression of a fluid in parts of its rest density, as the model's solver left it.
    pub density_error: [f64; 2],
    /// Trees and lists that were built anew.
    pub rebuilds: u32,
}

/// Checks that particles to go on from are as many as the scene has, each of its class.
pub(super) fn same_particles(own: &Particles, other: &Particles) -> Result<()> {
    if own.len() == other.len() {
        let mut classes = own.classes.iter().zip(&other.classes);
        let Some(first) = classes.position(|(own, other)| own != other) else {
            return Ok(());
        };
        let found =
            format!("{} of particle {first}, which has {} in the scene", other.classes[first], own.classes[first]);
        return Err(Error::InvalidSetting { setting: "class of a particle", found, expected: "that of the scene" });
    }
    let (found, expected) = (other.len() as u64, own.len() as u64);
    Err(Error::LengthMismatch { what: "particles to go on from", found, expected })
}

/// Checks that an order has every particle once.
pub(super) fn same_order(order: &[u32], n: usize) -> Result<()> {
    let mut seen = vec![false; n];
    let is_new = |&&id: &&u32| seen.get_mut(id as usize).is_some_and(|seen| !std::mem::replace(seen, true));
    let new = order.iter().filter(is_new).count();
    if new == n && order.len() == n {
        return Ok(());
    }
    let found = format!("{} indices, {new} of them of different particles", order.len());
    Err(Error::InvalidSetting { setting: "order of particles", found, expected: "every particle once" })
}
