//! What is conserved, bounded or otherwise worth knowing of all particles together.

use glam::DVec3;

use super::{Dimensions, ParticleScene, Particles};

/// Sums over all particles. Grains have mass 1, particles of a fluid that of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Measures {
    /// ½ m v², summed.
    pub kinetic_energy: f64,
    /// −m g · x, summed.
    pub potential_energy: f64,
    /// m v, summed.
    pub momentum: DVec3,
    /// Mean of the positions; zero without particles.
    pub mean_position: DVec3,
    /// The highest speed.
    pub max_speed: f64,
    /// Smallest coordinates of all.
    pub min: DVec3,
    /// Largest coordinates of all.
    pub max: DVec3,
    /// Mean of how much denser a particle is than at rest, in parts of the rest density; thinner ones count as 0. 0 without densities.
    pub mean_compression: f64,
    /// The largest of these.
    pub max_compression: f64,
    /// Particles outside the domain.
    pub outside: u64,
}

impl Measures {
    /// Of particles of the scene. Sums are taken in the order of indices.
    pub fn of(scene: &ParticleScene, particles: &Particles) -> Self {
        let mass = scene.model.fluid().map_or(1.0, |fluid| fluid.mass(scene.dimensions));
        let rest_density = scene.model.rest_density();
        let n = particles.len().max(1) as f64;
        let mut measures = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY, ..Self::default() };
        let mut sum = DVec3::ZERO;
        let [mut low, mut high] = scene.domain;
        if scene.dimensions == Dimensions::Two {
            (low.z, high.z) = (f64::NEG_INFINITY, f64::INFINITY);
        }
        for (position, velocity) in particles.positions.iter().zip(&particles.velocities) {
            measures.kinetic_energy += 0.5 * mass * velocity.length_squared();
            measures.potential_energy -= mass * scene.gravity.dot(*position);
            measures.momentum += mass * *velocity;
            measures.max_speed = measures.max_speed.max(velocity.length());
            measures.min = measures.min.min(*position);
            measures.max = measures.max.max(*position);
            measures.outside += u64::from(position.cmplt(low).any() || position.cmpgt(high).any());
            sum += *position;
        }
        measures.mean_position = sum / n;
        for density in &particles.densities {
            let compression = (density / rest_density - 1.0).max(0.0);
            measures.mean_compression += compression / n;
            measures.max_compression = measures.max_compression.max(compression);
        }
        measures
    }

    /// Kinetic and potential energy.
    pub fn energy(&self) -> f64 {
        self.kinetic_energy + self.potential_energy
    }
}
