//! The fluid at rest, a lattice of the spacing's width, and what follows from it for every pair of particles.

use glam::DVec3;

use super::PbfSettings;
use crate::Result;
use crate::application::particles::fluid::{Lattice, masses};
use crate::application::particles::neighborhood::Neighborhood;
use crate::application::particles::state::State;
use crate::application::particles::{Dimensions, SmoothingKernel};

/// Kernels and numbers of a position-based fluid that do not change.
#[derive(Debug, Clone, Copy)]
pub(super) struct AtRest {
    pub(super) support: f64,
    pub(super) rest_density: f64,
    /// Volume of a particle: Σ V W over the lattice is 1.
    pub(super) volume: f64,
    /// Factor of the volumes of a wall of one layer, with which it counts one spacing away as much as all the layers of the lattice that it
    /// stands for.
    pub(super) wall: f64,
    /// Σₖ |∇ₖC|² of a particle of the lattice.
    pub(super) squares: f64,
    /// ε of the constraint.
    pub(super) relaxation: f64,
    /// k / S / W(Δq)⁴, without the factor of W.
    tensile: f64,
    /// Factor of poly6.
    value_norm: f64,
    /// Factor of the derivative of spiky by the distance.
    slope_norm: f64,
}

impl AtRest {
    pub(super) fn new(settings: &PbfSettings, dimensions: Dimensions) -> Self {
        let fluid = &settings.fluid;
        let support = fluid.support;
        let value_norm = SmoothingKernel::Poly6.norm(dimensions, support);
        let slope_norm = SmoothingKernel::Spiky.norm(dimensions, support) / support;
        let Lattice { volume, wall, .. } = Lattice::new(fluid, SmoothingKernel::Poly6, dimensions);
        let mut rest = Self {
            support,
            rest_density: fluid.rest_density,
            volume,
            wall,
            squares: 0.0,
            relaxation: 0.0,
            tensile: 0.0,
            value_norm,
            slope_norm,
        };
        let offsets = lattice(fluid.spacing, support, dimensions);
        // On the lattice ∇ of a particle's own constraint by its own place is 0.
        let gradient = |offset: &DVec3| (rest.volume * rest.gradient(*offset, offset.length())).length_squared();
        rest.squares = offsets.iter().map(gradient).sum();
        rest.relaxation = settings.relaxation * rest.squares;
        let at_distance = SmoothingKernel::Poly6.shape(settings.tensile_distance).powi(4);
        rest.tensile = settings.tensile_strength / rest.squares / at_distance;
        rest
    }

    /// Factor of poly6 for a particle: V W is this times the kernel's shape.
    #[cfg(feature = "gpu")]
    pub(super) fn value_factor(&self) -> f64 {
        self.volume * self.value_norm
    }

    /// Factor of the gradient of spiky for a particle, times the support.
    #[cfg(feature = "gpu")]
    pub(super) fn gradient_factor(&self) -> f64 {
        self.volume * self.slope_norm * self.support
    }

    /// Factor of s for the fourth power of poly6's shape.
    #[cfg(feature = "gpu")]
    pub(super) fn tensile_factor(&self) -> f64 {
        self.tensile
    }

    /// W at a distance.
    #[inline]
    pub(super) fn value(&self, distance: f64) -> f64 {
        self.value_norm * SmoothingKernel::Poly6.shape(distance / self.support)
    }

    /// ∇W by the first of two particles, `offset` from the second; 0 where both are at one place, which has no direction.
    #[inline]
    pub(super) fn gradient(&self, offset: DVec3, distance: f64) -> DVec3 {
        if distance == 0.0 {
            return DVec3::ZERO;
        }
        self.slope_norm * SmoothingKernel::Spiky.slope(distance / self.support) / distance * offset
    }

    /// s of the artificial pressure at a distance.
    #[inline]
    pub(super) fn tensile(&self, distance: f64) -> f64 {
        -self.tensile * SmoothingKernel::Poly6.shape(distance / self.support).powi(4)
    }
}

/// `[b]` volumes of the boundary: Akinci2012's masses in parts of the density at rest, times the wall's factor. The structures must have
/// followed the particles.
///
/// # Errors
/// As the search.
pub(super) fn boundary_volumes(
    settings: &PbfSettings,
    rest: &AtRest,
    dimensions: Dimensions,
    state: &State,
    around: &Neighborhood,
) -> Result<Vec<f64>> {
    let masses = masses(&settings.fluid, SmoothingKernel::Poly6, dimensions, state, around)?;
    Ok(masses[state.n_moving()..].iter().map(|mass| rest.wall * mass / rest.rest_density).collect())
}

/// All within the support of a place of the lattice, itself among them: a square lattice in the plane, a cubic one in space.
fn lattice(spacing: f64, support: f64, dimensions: Dimensions) -> Vec<DVec3> {
    let reach = (support / spacing).ceil() as i32;
    let across = match dimensions {
        Dimensions::Two => 0,
        Dimensions::Three => reach,
    };
    let line = |x: i32, y: i32| (-across..=across).map(move |z| spacing * glam::IVec3::new(x, y, z).as_dvec3());
    let plane = |x: i32| (-reach..=reach).flat_map(move |y| line(x, y));
    (-reach..=reach).flat_map(plane).filter(|offset| offset.length() < support).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::application::particles::Fluid;

    /// Of a support of two spacings, where 27 places of space and 9 of the plane are within it: by hand, with q² = r² / 4.
    #[test]
    fn lattices_of_two_spacings_are_those_summed_by_hand() {
        let settings = PbfSettings::new(Fluid::water(0.5));
        let pi = std::f64::consts::PI;
        let [edge, face, corner] = [0.75_f64.powi(3), 0.5_f64.powi(3), 0.25_f64.powi(3)];
        let squares = |q: f64| (1.0 - q).powi(4);
        let [near, middle, far] = [0.25_f64, 0.5, 0.75].map(f64::sqrt).map(squares);
        for (dimensions, values, layer, value_norm, slopes, slope_norm) in [
            (
                Dimensions::Three,
                1.0 + 6.0 * edge + 12.0 * face + 8.0 * corner,
                1.0 + 4.0 * edge + 4.0 * face,
                315.0 / (64.0 * pi),
                6.0 * near + 12.0 * middle + 8.0 * far,
                -45.0 / pi,
            ),
            (
                Dimensions::Two,
                1.0 + 4.0 * edge + 4.0 * face,
                1.0 + 2.0 * edge,
                4.0 / pi,
                4.0 * near + 4.0 * middle,
                -30.0 / pi,
            ),
        ] {
            let rest = AtRest::new(&settings, dimensions);
            // With a support of 1 the factors are those of the kernels.
            let volume = 1.0 / (value_norm * values);
            let by_hand = (volume * slope_norm).powi(2) * slopes;
            assert!((rest.volume / volume - 1.0).abs() < 1e-14, "{dimensions:?}: volume {}", rest.volume);
            // Of the missing side, a wall of two spacings' support has the one layer that there is.
            assert!((rest.wall - layer / values).abs() < 1e-14, "{dimensions:?}: wall {}", rest.wall);
            assert!((rest.squares / by_hand - 1.0).abs() < 1e-13, "{dimensions:?}: {}", rest.squares);
            assert!((rest.relaxation / by_hand - 1e-3).abs() < 1e-15, "{dimensions:?}: {}", rest.relaxation);
        }
    }

    #[test]
    fn artificial_pressure_at_its_distance_is_that_of_a_compression() {
        let settings = PbfSettings::new(Fluid { spacing: 0.3, support: 0.7, rest_density: 1.5 });
        for dimensions in [Dimensions::Two, Dimensions::Three] {
            let rest = AtRest::new(&settings, dimensions);
            let lambda = -settings.tensile_strength / rest.squares;
            let at_distance = rest.tensile(settings.tensile_distance * 0.7);
            assert!((at_distance / lambda - 1.0).abs() < 1e-12, "{dimensions:?}: {at_distance} of {lambda}");
            assert_eq!(rest.tensile(0.7), 0.0);
        }
    }

    #[test]
    fn gradients_are_differences_of_the_spiky_kernel() {
        const STEP: f64 = 1e-6;
        let settings = PbfSettings::new(Fluid { spacing: 0.3, support: 0.7, rest_density: 1.0 });
        let rest = AtRest::new(&settings, Dimensions::Three);
        let norm = SmoothingKernel::Spiky.norm(Dimensions::Three, 0.7);
        let spiky = |at: DVec3| norm * SmoothingKernel::Spiky.shape(at.length() / 0.7);
        let at = DVec3::new(0.2, -0.1, 0.3);
        let slope = |axis: DVec3| (spiky(at + STEP * axis) - spiky(at - STEP * axis)) / (2.0 * STEP);
        let differences = DVec3::new(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z));
        let gradient = rest.gradient(at, at.length());
        assert!((gradient - differences).length() < 1e-7 * gradient.length(), "{gradient} for {differences}");
        assert_eq!(rest.gradient(DVec3::ZERO, 0.0), DVec3::ZERO);
    }
}
