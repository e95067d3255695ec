//! Particles while they are simulated on the CPU: in blocks by class, each in an order that is good to search.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::{ParticleModel, ParticleScene, Particles};
use crate::Result;
use crate::curve::{Curve, Domain, order_in};
use crate::geometry::Aabb;

/// Particles and the boundary behind them.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct State {
    /// `[n + b]` where they are: those that move, then the boundary.
    pub(super) positions: Vec<DVec3>,
    /// `[n]` how fast they move.
    pub(super) velocities: Vec<DVec3>,
    /// `[n]` densities of fluids, empty before there are any.
    pub(super) densities: Vec<f64>,
    /// `[n]` pressures of incompressible fluids, empty before there are any.
    pub(super) pressures: Vec<f64>,
    /// `[n]` the index that the caller knows them by.
    pub(super) ids: Vec<u32>,
    /// `[n_classes]` of those that move.
    pub(super) classes: Vec<Range<usize>>,
}

impl State {
    /// The particles of a scene, put into blocks by class.
    pub(super) fn new(scene: &ParticleScene, n_classes: usize) -> Self {
        Self::in_order(scene, n_classes, (0..scene.particles.len() as u32).collect())
    }

    /// The particles of a scene, put into blocks by class, within them in this order of their indices.
    pub(super) fn in_order(scene: &ParticleScene, n_classes: usize, mut ids: Vec<u32>) -> Self {
        let moving = &scene.particles;
        ids.sort_by_key(|&id| moving.classes[id as usize]);
        let end_of = |class: usize| ids.partition_point(|&id| usize::from(moving.classes[id as usize]) <= class);
        let start_of = |class: usize| if class == 0 { 0 } else { end_of(class - 1) };
        let classes = (0..n_classes).map(|class| start_of(class)..end_of(class)).collect();
        let mut positions = gather(&moving.positions, &ids);
        positions.extend(&scene.boundary);
        let velocities = gather(&moving.velocities, &ids);
        let densities = gather_any(&moving.densities, &ids);
        // Those of another model's particles would stay as they are for ever.
        let is_pressed = matches!(scene.model, ParticleModel::Dfsph(_));
        let pressures = if is_pressed { gather_any(&moving.pressures, &ids) } else { Vec::new() };
        Self { positions, velocities, densities, pressures, ids, classes }
    }

    /// Number of particles that move.
    pub(super) fn n_moving(&self) -> usize {
        self.velocities.len()
    }

    /// The class of each particle that moves.
    pub(super) fn class_of(&self, particle: usize) -> usize {
        self.classes.partition_point(|class| class.end <= particle)
    }

    /// Puts the particles of each class into the order of a space-filling curve; equal ones keep their order.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge` for particles that cannot be searched.
    pub(super) fn reorder(&mut self) -> Result<()> {
        let searched: Vec<glam::Vec3> = self.positions[..self.n_moving()].par_iter().map(|p| p.as_vec3()).collect();
        let domain = Domain::of_bounds(&Aabb::of_points(&searched));
        let mut order: Vec<u32> = Vec::with_capacity(searched.len());
        for class in &self.classes {
            let within = order_in(&searched[class.clone()], Curve::Hilbert, &domain)?;
            order.extend(within.into_iter().map(|place| class.start as u32 + place));
        }
        let boundary = self.positions.split_off(self.n_moving());
        self.positions = gather(&self.positions, &order);
        self.positions.extend(boundary);
        self.velocities = gather(&self.velocities, &order);
        self.ids = gather(&self.ids, &order);
        self.densities = gather_any(&self.densities, &order);
        self.pressures = gather_any(&self.pressures, &order);
        Ok(())
    }

    /// The particles by the caller's index.
    pub(super) fn particles(&self) -> Particles {
        let n = self.n_moving();
        let mut particles = Particles::at_rest(vec![DVec3::ZERO; n]);
        if !self.densities.is_empty() {
            particles.densities = vec![0.0; n];
        }
        if !self.pressures.is_empty() {
            particles.pressures = vec![0.0; n];
        }
        for (place, &id) in self.ids.iter().enumerate() {
            let id = id as usize;
            particles.positions[id] = self.positions[place];
            particles.velocities[id] = self.velocities[place];
            particles.classes[id] = self.class_of(place) as u8;
            if let Some(density) = self.densities.get(place) {
                particles.densities[id] = *density;
            }
            if let Some(pressure) = self.pressures.get(place) {
                particles.pressures[id] = *pressure;
            }
        }
        particles
    }
}

fn gather<T: Copy + Send + Sync>(values: &[T], order: &[u32]) -> Vec<T> {
    order.par_iter().with_min_len(1 << 12).map(|&i| values[i as usize]).collect()
}

/// As [`gather`], of what not every simulation has.
fn gather_any(values: &[f64], order: &[u32]) -> Vec<f64> {
    if values.is_empty() { Vec::new() } else { gather(values, order) }
}
