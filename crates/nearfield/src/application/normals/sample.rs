//! The neighbours of one query as a fit takes them: relative to the query, in units of their radius, with weights.
//!
//! Coordinates far from zero lose no digits this way, and no square is too large or too small. Sums are taken in `f64` whatever
//! the points are made of: a covariance has twice the digits of its points.

use crate::geometry::vector::Vector;

/// A neighbour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sample {
    /// From the query to it, in radii.
    pub(super) offset: Vector<f64>,
    pub(super) weight: f64,
}

/// The neighbours of one query.
#[derive(Debug, Clone, Default)]
pub(super) struct Samples {
    pub(super) all: Vec<Sample>,
    /// Length of the unit.
    pub(super) radius: f64,
}

impl Samples {
    /// Begins anew, with offsets in the unit of the coordinates.
    pub(super) fn begin(&mut self) {
        self.all.clear();
        self.radius = 0.0;
    }

    /// Adds a neighbour.
    #[inline(always)]
    pub(super) fn add(&mut self, offset: Vector<f64>) {
        self.all.push(Sample { offset, weight: 1.0 });
    }

    /// Divides by the radius; weights fall to 0 at `support2` squared radii, where there is one.
    pub(super) fn finish(&mut self, radius: f64, support2: Option<f64>) {
        self.radius = radius;
        // All at the place of the query: there is nothing to divide by.
        let inverse = if radius > 0.0 { 1.0 / radius } else { 1.0 };
        for sample in &mut self.all {
            sample.offset = sample.offset.map(|x| x * inverse);
            if let Some(support2) = support2 {
                sample.weight = weight(crate::geometry::vector::norm2(sample.offset), support2);
            }
        }
    }
}

/// (1 − d²/s²)⁴, 0 from s on.
fn weight(dist2: f64, support2: f64) -> f64 {
    let base = (1.0 - dist2 / support2).max(0.0);
    let square = base * base;
    square * square
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_fall_to_zero_at_the_support() {
        assert_eq!([0.0, 0.5, 1.0, 2.0].map(|d2| weight(d2, 1.0)), [1.0, 0.0625, 0.0, 0.0]);
        let mut samples = Samples::default();
        samples.begin();
        samples.add([0.0, 2.0, 4.0]);
        samples.finish(4.0, Some(2.5));
        assert_eq!(samples.all, [Sample { offset: [0.0, 0.5, 1.0], weight: weight(1.25, 2.5) }]);
        samples.finish(0.0, None);
        assert_eq!((samples.all[0].offset, samples.radius), ([0.0, 0.5, 1.0], 0.0));
    }
}
