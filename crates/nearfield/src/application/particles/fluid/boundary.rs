//! Walls of particles: each counts by the part of the wall that it stands for (Akinci2012).

use super::{Fluid, SmoothingKernel};
use crate::Result;
use crate::application::particles::Dimensions;
#[cfg(feature = "gpu")]
use crate::application::particles::images::Images;
use crate::application::particles::neighborhood::Neighborhood;
#[cfg(feature = "gpu")]
use crate::application::particles::reach::Reach;
use crate::application::particles::state::State;
#[cfg(feature = "gpu")]
use crate::application::particles::{ParticleScene, ParticleSearch};

/// `[n + b]` masses of the particles and of the boundary as the fluid feels it: ρ₀ / Σ W over the boundary's own neighbours, so that a wall
/// counts alike however densely it is sampled. The structures must have followed the particles.
///
/// # Errors
/// As the search.
pub(in crate::application::particles) fn masses(
    fluid: &Fluid,
    smoothing: SmoothingKernel,
    dimensions: Dimensions,
    state: &State,
    around: &Neighborhood,
) -> Result<Vec<f64>> {
    let (n, mass) = (state.n_moving(), fluid.mass(dimensions));
    let norm = smoothing.norm(dimensions, fluid.support);
    let images = *around.images();
    let sums = around.fold(|i, row, sum: f64| {
        if i < n {
            return sum;
        }
        let distance = |j: usize| images.nearest(state.positions[i] - state.positions[j]).length();
        let weight = |j: usize| norm * smoothing.shape(distance(j) / fluid.support);
        sum + row.iter().filter(|&j| j >= n).map(weight).sum::<f64>()
    })?;
    let counts = |(i, sum): (usize, f64)| if i < n { mass } else { fluid.rest_density / sum };
    Ok(sums.into_iter().enumerate().map(counts).collect())
}

/// The boundary of a scene by itself, searched: its masses are needed before there is a step. All of it stands behind no particle that moves.
///
/// # Errors
/// As the search.
#[cfg(feature = "gpu")]
pub(in crate::application::particles) fn boundary_alone(
    scene: &ParticleScene,
    support: f64,
) -> Result<(State, Neighborhood)> {
    let n = scene.boundary.len();
    let state =
        State { positions: scene.boundary.clone(), classes: std::iter::once(0..0).collect(), ..State::default() };
    let (images, reach) = (Images::new(scene.domain, scene.periodic), Reach::one(support));
    let classes = std::iter::once(0..n).collect();
    let mut around = Neighborhood::new(ParticleSearch::UNIFORM_GRID, true, scene.domain, images, classes, reach);
    around.follow(&state.positions)?;
    Ok((state, around))
}

/// `[b]` masses of a scene's boundary, which the particles that move have no part in.
///
/// # Errors
/// As the search.
#[cfg(feature = "gpu")]
pub(in crate::application::particles) fn boundary_masses(
    fluid: &Fluid,
    smoothing: SmoothingKernel,
    scene: &ParticleScene,
) -> Result<Vec<f64>> {
    if scene.boundary.is_empty() {
        return Ok(Vec::new());
    }
    let (alone, around) = boundary_alone(scene, fluid.support)?;
    masses(fluid, smoothing, scene.dimensions, &alone, &around)
}
