//! Walls of particles: each counts by the part of the wall that it stands for (Akinci2012).

use super::{Fluid, SmoothingKernel};
use crate::Result;
use crate::application::particles::Dimensions;
use crate::application::particles::neighborhood::Neighborhood;
use crate::application::particles::state::State;

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
