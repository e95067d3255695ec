//! The formulas by name, as numbers that one loop on the CPU (`pairs.rs`) and one set of kernels evaluate.
//!
//! Squared distances are in parts of the squared radius: y = r² / h². Factors that are the same for all pairs cancel, as all sums are
//! divided by the sum of their weights.

use std::fmt;

use crate::geometry::Scalar;

/// Distances below this part of the radius count as this where they are divided by.
const LEAST_DISTANCE: f64 = 1e-3;
/// The same where a variant leaves near pairs out instead: only so that no quotient is infinite.
const NO_LEAST: f64 = 1e-15;

/// Which formula moves the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum WlopVariant {
    /// As published (Huang2009, Lipman2007): accurate, slow to spread.
    Paper,
    /// As in the authors' later program: the radius R is half of the paper's h, θ(r) = exp(−4 r² / R²); α = θ / r, β = θ / r · √w, v within
    /// 0.95 R, μ = 0.5.
    Authors,
    /// As CGAL 5.5 does it: the radius R is half of the paper's h, θ(r) = exp(−4 r² / R²); α = θ, β = θ / r², w with the sample counted
    /// twice, v only on request. Pairs at squared distances below 1e-10 in the unit of the points (1e-8 in v) do not count, so that tiny
    /// models are to be scaled up first, as for CGAL.
    Cgal,
    /// Accurate and even at once. α = exp(−24 y) / √r over 0.65 h and β = exp(−8 y) / r³ with y = r² / h², v and w by the same curves.
    ///
    /// On the torus with radii 1 and 0.4, 100,000 points with noise of 0.5 % of the diagonal and 5,000 samples within h = 0.4, 50
    /// iterations leave a root mean square distance of 0.00063 of the diagonal and a variation of the nearest distances of 0.064. The
    /// paper's formula gives 0.00073 and 0.13, CGAL's 0.00125 and 0.071. Of the falloffs 16, 20 and 24, the powers 0.5, 0.75, 1 and 1.5 of
    /// the attraction, and 8, 10, 16 and 1 to 4 of the repulsion this was the most accurate of those below 0.07: the root holds samples
    /// to the noise less than 1 / r does, the third power evens neighbours out, and a wide repulsion pushes outwards on bent surfaces as
    /// much as attraction draws inwards.
    #[default]
    Best,
}

impl WlopVariant {
    /// All variants.
    pub const ALL: [Self; 4] = [Self::Paper, Self::Authors, Self::Cgal, Self::Best];

    /// The name in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Authors => "authors",
            Self::Cgal => "cgal",
            Self::Best => "best",
        }
    }

    /// The paper's h / 4, over which attraction falls to 1 / e, of a radius as this variant takes it.
    pub fn width(self, radius: f64) -> f64 {
        match self {
            Self::Paper | Self::Best => radius / 4.0,
            Self::Authors | Self::Cgal => radius / 2.0,
        }
    }
}

impl fmt::Display for WlopVariant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// 1 / r to a power that is half of a small number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Power {
    Zero,
    Half,
    One,
    Two,
    Three,
}

#[cfg(feature = "gpu")]
impl Power {
    /// Twice the power.
    pub(super) fn twice(self) -> u32 {
        match self {
            Self::Zero => 0,
            Self::Half => 1,
            Self::One => 2,
            Self::Two => 4,
            Self::Three => 6,
        }
    }
}

/// How pairs attract or repel each other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pairs {
    /// θ = exp(−falloff · y).
    pub(super) falloff: f64,
    pub(super) power: Power,
    /// Part of the radius that is searched.
    pub(super) reach: f64,
    /// Pairs at a smaller squared distance, in the unit of the points, do not count; `skip2()` has it in one precision.
    pub(super) skip2: f64,
    /// Smaller squares count as this where they are divided by.
    pub(super) least_y: f64,
    /// Sums of weights below this are none.
    pub(super) least_weight: f64,
}

impl Pairs {
    /// The squared distance below which pairs do not count; above 0 where it is in f64, however small.
    pub(super) fn skip2<T: Scalar>(&self) -> T {
        if self.skip2 > 0.0 { T::of(self.skip2).larger(T::SMALLEST_NORMAL) } else { T::ZERO }
    }
}

/// Weights of points or samples by how crowded they are.
#[derive(Debug, Clone, Copy)]
pub(super) struct Density {
    /// θ = exp(−falloff · y).
    pub(super) falloff: f64,
    /// Part of the radius that is searched.
    pub(super) reach: f64,
    /// Pairs at a smaller squared distance, in the unit of the points, do not count.
    pub(super) skip2: f64,
    /// What it counts itself as.
    pub(super) own: f64,
    pub(super) result: DensityResult,
}

/// What a weight is made of the sum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum DensityResult {
    Inverse,
    Sum,
    Root,
}

impl DensityResult {
    #[inline(always)]
    pub(super) fn of<T: Scalar>(self, sum: T) -> T {
        match self {
            Self::Inverse => T::ONE / sum,
            Self::Sum => sum,
            Self::Root => sum.sqrt(),
        }
    }
}

/// The numbers of a variant at a radius.
#[derive(Debug, Clone, Copy)]
pub(super) struct Formula {
    pub(super) attraction: Pairs,
    /// Power of the attraction in the first iteration.
    pub(super) first_power: Power,
    /// Weights v of the points; `None` where all count alike.
    pub(super) inputs: Option<Density>,
    /// Weights w of the samples.
    pub(super) samples: Density,
    pub(super) repulsion: Pairs,
    /// Other samples within the radius below which there is no repulsion.
    pub(super) least_samples: u32,
    /// Whether samples that nothing attracts are still pushed.
    pub(super) drifts: bool,
}

impl Formula {
    /// Of a variant; the radius matters only to numbers that CGAL has in the unit of the points.
    pub(super) fn new(variant: WlopVariant, weigh_inputs: bool, radius: f64) -> Self {
        let pairs = |falloff: f64, power, reach: f64| Pairs {
            falloff,
            power,
            reach,
            skip2: 0.0,
            least_y: LEAST_DISTANCE * LEAST_DISTANCE,
            least_weight: 0.0,
        };
        // Samples at one place have no direction to part in: each would only weaken what pushes the other.
        let pushes = |falloff, power| Pairs { skip2: f64::MIN_POSITIVE, ..pairs(falloff, power, 1.0) };
        let density = |falloff: f64, reach, result| Density { falloff, reach, skip2: 0.0, own: 1.0, result };
        let inputs = |density| weigh_inputs.then_some(density);
        use DensityResult::{Inverse, Root, Sum};
        let paper = Self {
            attraction: pairs(16.0, Power::One, 1.0),
            first_power: Power::Zero,
            inputs: inputs(density(16.0, 1.0, Inverse)),
            samples: density(16.0, 1.0, Sum),
            repulsion: pushes(16.0, Power::One),
            least_samples: 1,
            drifts: false,
        };
        match variant {
            WlopVariant::Paper => paper,
            WlopVariant::Best => Self {
                attraction: pairs(24.0, Power::Half, 0.65),
                inputs: inputs(density(24.0, 0.65, Inverse)),
                samples: density(8.0, 1.0, Sum),
                repulsion: pushes(8.0, Power::Three),
                ..paper
            },
            WlopVariant::Authors => Self {
                attraction: pairs(4.0, Power::One, 1.0),
                first_power: Power::One,
                inputs: inputs(density(4.0 / (0.95 * 0.95), 0.95, Inverse)),
                samples: density(4.0, 1.0, Root),
                repulsion: pushes(4.0, Power::One),
                ..paper
            },
            WlopVariant::Cgal => {
                let near = |power| Pairs { skip2: 1e-10, least_y: NO_LEAST * NO_LEAST, ..pairs(4.0, power, 1.0) };
                Self {
                    attraction: Pairs { least_weight: 1e-10, ..near(Power::Zero) },
                    first_power: Power::Zero,
                    inputs: inputs(Density { skip2: 1e-8, ..density(4.0, 1.0, Inverse) }),
                    samples: Density { own: 2.0, ..density(4.0, 1.0, Sum) },
                    // Of weights over r² in the unit of the points.
                    repulsion: Pairs { least_weight: 1e-10 * radius * radius, ..near(Power::Two) },
                    least_samples: 2,
                    drifts: true,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_at_one_place_attract_but_do_not_repel() {
        for variant in WlopVariant::ALL {
            let formula = Formula::new(variant, true, 1.0);
            let [attraction, repulsion] = [formula.attraction, formula.repulsion];
            let is_cgal = variant == WlopVariant::Cgal;
            assert_eq!((attraction.skip2::<f32>() > 0.0, attraction.skip2::<f64>() > 0.0), (is_cgal, is_cgal));
            let expected = if is_cgal { (1e-10, 1e-10) } else { (f32::MIN_POSITIVE, f64::MIN_POSITIVE) };
            assert_eq!((repulsion.skip2::<f32>(), repulsion.skip2::<f64>()), expected, "{variant}");
        }
    }
}
