//! What is done to velocities after the rounds: vorticity confinement and XSPH viscosity.

use glam::DVec3;

use super::cpu::Rounds;
use crate::Result;
use crate::application::particles::neighborhood::Neighborhood;

/// Change of the vorticity over a support, in parts of the vorticity, at which confinement has half its strength: where vorticity is even, its
/// gradient is rounding and has no direction to push in.
const EVEN: f64 = 1e-3;

impl Rounds<'_> {
    /// N × ω of every particle, `[n + b]`: a push of ε N × ω turns the fluid faster around where it turns fastest.
    ///
    /// ωᵢ = Σ (m / ρⱼ) (vⱼ − vᵢ) × ∇ⱼW is the curl of the velocities, N the direction in which its length grows.
    ///
    /// # Errors
    /// As the search.
    pub(super) fn confine_vorticity(
        &self,
        around: &Neighborhood,
        velocities: &[DVec3],
        densities: &[f64],
    ) -> Result<Vec<DVec3>> {
        let volume = |j: usize| self.rest.volume * self.rest.rest_density / densities[j];
        let curls = around.fold(|i, row, mut curl: DVec3| {
            if i < self.n_moving {
                for (j, offset, distance) in self.moving_neighbors(i, row) {
                    let by_other = -self.rest.gradient(offset, distance);
                    curl += volume(j) * (velocities[j] - velocities[i]).cross(by_other);
                }
            }
            curl
        })?;
        let growth = around.fold(|i, row, mut growth: DVec3| {
            if i < self.n_moving {
                let own = curls[i].length();
                for (j, offset, distance) in self.moving_neighbors(i, row) {
                    growth += volume(j) * (curls[j].length() - own) * self.rest.gradient(offset, distance);
                }
            }
            growth
        })?;
        let push = |(curl, growth): (&DVec3, &DVec3)| {
            let length = growth.length() + EVEN * curl.length() / self.rest.support;
            if length > 0.0 { (*growth / length).cross(*curl) } else { DVec3::ZERO }
        };
        Ok(curls.iter().zip(&growth).map(push).collect())
    }

    /// Σ (m / ρⱼ) (vⱼ − vᵢ) W of every particle, `[n + b]`: towards the mean velocity around it.
    ///
    /// # Errors
    /// As the search.
    pub(super) fn average_velocities(
        &self,
        around: &Neighborhood,
        velocities: &[DVec3],
        densities: &[f64],
    ) -> Result<Vec<DVec3>> {
        around.fold(|i, row, mut sum: DVec3| {
            if i < self.n_moving {
                for (j, _, distance) in self.moving_neighbors(i, row) {
                    let volume = self.rest.volume * self.rest.rest_density / densities[j];
                    sum += volume * self.rest.value(distance) * (velocities[j] - velocities[i]);
                }
            }
            sum
        })
    }
}
