//! A smoothing kernel with its factors, and the sums that it has over lattices.

use glam::DVec3;

use super::{Fluid, SmoothingKernel};
use crate::application::particles::images::Images;
use crate::application::particles::neighborhood::Row;
use crate::application::particles::{Dimensions, ParticleScene};

/// How much particles of one fluid count for each other.
#[derive(Debug, Clone, Copy)]
pub(in crate::application::particles) struct Weights {
    smoothing: SmoothingKernel,
    support: f64,
    norm: f64,
    images: Images,
}

impl Weights {
    pub(in crate::application::particles) fn new(
        fluid: &Fluid,
        smoothing: SmoothingKernel,
        scene: &ParticleScene,
    ) -> Self {
        Self {
            smoothing,
            support: fluid.support,
            norm: smoothing.norm(scene.dimensions, fluid.support),
            images: Images::new(scene.domain, scene.periodic),
        }
    }

    /// W.
    #[inline]
    pub(in crate::application::particles) fn value(&self, distance: f64) -> f64 {
        self.norm * self.smoothing.shape(distance / self.support)
    }

    /// W′ / r: ∇W is this times the offset from the neighbour. 0 for two at one place, which have no direction.
    #[inline]
    pub(in crate::application::particles) fn slope(&self, distance: f64) -> f64 {
        if distance > 0.0 {
            self.norm * self.smoothing.slope(distance / self.support) / (self.support * distance)
        } else {
            0.0
        }
    }

    /// Images of places.
    pub(in crate::application::particles) fn images(&self) -> &Images {
        &self.images
    }

    /// Neighbours of a particle within the support, without itself: their index, the offset from them to it, and its length.
    #[inline]
    pub(in crate::application::particles) fn neighbors(
        &self,
        positions: &[DVec3],
        i: usize,
        row: Row<'_>,
    ) -> impl Iterator<Item = (usize, DVec3, f64)> {
        let (at, images, support2) = (positions[i], self.images, self.support * self.support);
        row.iter().filter_map(move |j| {
            let offset = images.nearest(at - positions[j]);
            let dist2 = offset.length_squared();
            (dist2 < support2 && j != i).then(|| (j, offset, dist2.sqrt()))
        })
    }
}

/// What a lattice at rest sums up to.
#[derive(Debug, Clone, Copy)]
pub(in crate::application::particles) struct Lattice {
    /// Volume of a particle with which the density in a lattice is that at rest: 1 / Σ W. It differs from that of a cell by what the sum
    /// differs from the integral.
    pub(in crate::application::particles) volume: f64,
    /// Factor of the boundary's volumes with which the density beside a wall is that at rest, where the lattice goes on into a flat wall
    /// of one layer. Some 0.7 in the plane, as in Band2018; without it particles would be pushed from the wall at the start.
    pub(in crate::application::particles) wall: f64,
    /// Part of the density at rest that such a wall's own particles make at one of them.
    layer: f64,
    /// Part of a full step of Jacobi's that an iteration for pressures makes. Pressures that alternate as the lattice answers to most are
    /// answered by more than twice the diagonal, so that full steps would make them grow; this leaves a quarter of what is stable.
    pub(in crate::application::particles) relaxation: f64,
}

/// Wave numbers along each axis at which a lattice's answer is looked at.
const WAVES: u32 = 16;

impl Lattice {
    pub(in crate::application::particles) fn new(
        fluid: &Fluid,
        smoothing: SmoothingKernel,
        dimensions: Dimensions,
    ) -> Self {
        let reach = (fluid.support / fluid.spacing).ceil() as i32;
        let norm = smoothing.norm(dimensions, fluid.support);
        let across = if dimensions == Dimensions::Two { 0..=0 } else { -reach..=reach };
        let layer = |y: i32| -> f64 {
            let weights = across.clone().flat_map(|z| (-reach..=reach).map(move |x| (x, z)));
            let weights = weights.map(|(x, z)| {
                let distance = DVec3::new(x.into(), y.into(), z.into()).length() * fluid.spacing;
                norm * smoothing.shape(distance / fluid.support)
            });
            weights.sum()
        };
        let on_one_side: f64 = (1..=reach).map(layer).sum();
        let volume = 1.0 / (layer(0) + 2.0 * on_one_side);
        // Of the side that is missing, a wall of one layer with volumes 1 / Σ W has its nearest layer only.
        let wall = volume * on_one_side * layer(0) / layer(1);
        let layer = volume * layer(0);
        Self { volume, wall, layer, relaxation: relaxation(fluid, smoothing, dimensions, reach) }
    }
}

impl Lattice {
    /// Volume of a particle of the boundary, given Akinci2012's 1 / Σ W. Thicker walls than of one layer fill more of the side that the fluid
    /// leaves free, and keep more of it; all of it, where the wall is as dense as the fluid.
    pub(in crate::application::particles) fn wall_volume(&self, volume: f64) -> f64 {
        let thickness = ((self.volume / volume - self.layer) / (1.0 - self.layer)).clamp(0.0, 1.0);
        volume * (self.wall + (1.0 - self.wall) * thickness)
    }
}

/// 3/2 by the largest eigenvalue of the pressures' equations in parts of their diagonal. A wave of pressures exp(i k·x) moves particles by
/// s = Σ sin(k·x) ∇W and is answered by |s|², the diagonal is Σ |∇W|².
fn relaxation(fluid: &Fluid, smoothing: SmoothingKernel, dimensions: Dimensions, reach: i32) -> f64 {
    let flat = dimensions == Dimensions::Two;
    let across = if flat { 0..=0 } else { -reach..=reach };
    let mut gradients = Vec::new();
    for z in across {
        for (x, y) in (-reach..=reach).flat_map(|x| (-reach..=reach).map(move |y| (x, y))) {
            let place = DVec3::new(x.into(), y.into(), z.into());
            let distance = place.length();
            if distance > 0.0 {
                gradients.push((place, smoothing.slope(distance * fluid.spacing / fluid.support) / distance * place));
            }
        }
    }
    let diagonal: f64 = gradients.iter().map(|(_, gradient)| gradient.length_squared()).sum();
    let mut largest = diagonal;
    // By symmetry k.x ≥ k.y ≥ k.z ≥ 0 is enough.
    for x in 0..=WAVES {
        for (y, z) in (0..=x).flat_map(|y| (0..=if flat { 0 } else { y }).map(move |z| (y, z))) {
            let wave = std::f64::consts::PI / f64::from(WAVES) * DVec3::new(x.into(), y.into(), z.into());
            let moved: DVec3 = gradients.iter().map(|(place, gradient)| wave.dot(*place).sin() * *gradient).sum();
            largest = largest.max(moved.length_squared());
        }
    }
    (1.5 * diagonal / largest).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lattices_with_a_support_of_two_spacings_are_summed_by_hand() {
        let lattice = Lattice::new(&Fluid::water(0.5), SmoothingKernel::CubicSpline, Dimensions::Two);
        // In supports the neighbours are at 0, ½ and √½: 1, ¼ and 2 (1 − √½)³.
        let (near, far) = (0.25, 2.0 * (1.0 - 0.5f64.sqrt()).powi(3));
        let norm = 40.0 / (7.0 * std::f64::consts::PI);
        assert!((lattice.volume * norm * (1.0 + 4.0 * near + 4.0 * far) - 1.0).abs() < 1e-14, "{}", lattice.volume);
        let (own, next) = (1.0 + 2.0 * near, near + 2.0 * far);
        let beside_a_wall =
            lattice.volume * norm * (own + next) + lattice.wall_volume(1.0 / (norm * own)) * norm * next;
        assert!((beside_a_wall - 1.0).abs() < 1e-14, "{beside_a_wall}");
        // Of a thick wall the first layer has the second behind it, and the third is out of reach.
        let thick = lattice.wall_volume(1.0 / (norm * (own + next)));
        let beside_a_thick_wall = lattice.volume * norm * (own + next) + thick * norm * next;
        assert!((beside_a_thick_wall - 1.0).abs() < 0.005, "{beside_a_thick_wall}");
        assert!((lattice.wall - 0.7).abs() < 0.05, "{}", lattice.wall);
        // A wave k = (π/2, 0) meets ∇W of four pairs: 2 (W′(½) + √2 W′(√½)) along x, where the diagonal is 4 (W′(½)² + W′(√½)²).
        let (near, far) = (-1.5, -6.0 * (1.0 - 0.5f64.sqrt()).powi(2));
        let of_wave = (2.0 * (near + 2.0f64.sqrt() * far)).powi(2) / (4.0 * (near * near + far * far));
        assert!(lattice.relaxation <= 1.5 / of_wave && lattice.relaxation > 0.5, "{}", lattice.relaxation);
    }
}
