//! How much pairs count, some of them at once. `pairs.wesl` is the twin.
//!
//! Neighbours are gathered as a search meets them and weighed a block at a time, in straight code that compilers do for several pairs
//! at once; sums are then taken one by one, in the order of the search.

use super::variant::{Pairs, Power};
use crate::geometry::Scalar;

/// Pairs that are weighed at once.
const BLOCK: usize = 64;

/// [`Pairs`] at a radius, in one precision.
#[derive(Debug, Clone, Copy)]
pub(super) struct PairWeight<T> {
    inverse_radius2: T,
    falloff: T,
    least_y: T,
    power: Power,
}

impl<T: Scalar> PairWeight<T> {
    pub(super) fn new(pairs: &Pairs, power: Power, radius: T) -> Self {
        Self {
            inverse_radius2: T::ONE / (radius * radius),
            falloff: T::of(-pairs.falloff),
            least_y: T::of(pairs.least_y),
            power,
        }
    }
}

/// Pairs that wait to be weighed: the place of the other one, and the squared distance.
pub(super) struct Block<T> {
    places: [usize; BLOCK],
    dist2: [T; BLOCK],
    n: usize,
}

impl<T: Scalar> Block<T> {
    pub(super) fn new() -> Self {
        Self { places: [0; BLOCK], dist2: [T::ZERO; BLOCK], n: 0 }
    }

    /// Takes a pair; true where there is no room for another before [`Block::weigh`].
    #[inline(always)]
    pub(super) fn add(&mut self, place: usize, dist2: T) -> bool {
        self.places[self.n] = place;
        self.dist2[self.n] = dist2;
        self.n += 1;
        self.n == BLOCK
    }

    /// Calls `each(place, θ, weight)` for all that wait, in their order, and forgets them.
    #[inline(always)]
    pub(super) fn weigh(&mut self, pairs: &PairWeight<T>, mut each: impl FnMut(usize, T, T)) {
        // The whole block: places behind the last hold what was there before.
        let mut thetas = self.dist2;
        thetas.iter_mut().for_each(|dist2| *dist2 = pairs.falloff * (*dist2 * pairs.inverse_radius2));
        T::exp_each(&mut thetas);
        let mut weights = thetas;
        match pairs.power {
            Power::Zero => {}
            Power::Half => self.divide(pairs, &mut weights, |y| y.sqrt().sqrt()),
            Power::One => self.divide(pairs, &mut weights, |y| y.sqrt()),
            Power::Two => self.divide(pairs, &mut weights, |y| y),
            Power::Three => self.divide(pairs, &mut weights, |y| y * y.sqrt()),
        }
        let waiting = self.places.iter().zip(&thetas).zip(&weights).take(self.n);
        waiting.for_each(|((&place, &theta), &weight)| each(place, theta, weight));
        self.n = 0;
    }

    /// Divides each weight by a function of y, which is no smaller than it may be.
    #[inline(always)]
    fn divide(&self, pairs: &PairWeight<T>, weights: &mut [T; BLOCK], by: impl Fn(T) -> T) {
        for (weight, &dist2) in weights.iter_mut().zip(&self.dist2) {
            *weight = *weight / by((dist2 * pairs.inverse_radius2).larger(pairs.least_y));
        }
    }

    /// The sum of exp(falloff · squared distance) of all that wait, added to `sum` in their order; forgets them.
    #[inline(always)]
    pub(super) fn add_to(&mut self, sum: &mut T, falloff: T) {
        let mut thetas = self.dist2;
        thetas.iter_mut().for_each(|dist2| *dist2 = falloff * *dist2);
        T::exp_each(&mut thetas);
        thetas.iter().take(self.n).for_each(|&theta| *sum += theta);
        self.n = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::application::wlop::WlopVariant;
    use crate::application::wlop::variant::Formula;

    fn weigh(pairs: &PairWeight<f64>, dist2: &[f64]) -> Vec<(usize, f64, f64)> {
        let (mut block, mut found) = (Block::new(), Vec::new());
        for (place, &d2) in dist2.iter().enumerate() {
            if block.add(place, d2) {
                block.weigh(pairs, |place, theta, weight| found.push((place, theta, weight)));
            }
        }
        block.weigh(pairs, |place, theta, weight| found.push((place, theta, weight)));
        found
    }

    #[test]
    fn all_pairs_are_weighed_in_their_order() {
        let mut pairs = Formula::new(WlopVariant::Paper, true, 2.0).attraction;
        pairs.falloff = 3.0;
        let dist2: Vec<f64> = (0..150).map(|i| 4.0 * f64::from(i + 1) / 150.0).collect();
        let powers =
            [(Power::Zero, 0.0), (Power::Half, 0.5), (Power::One, 1.0), (Power::Two, 2.0), (Power::Three, 3.0)];
        for (power, exponent) in powers {
            let found = weigh(&PairWeight::new(&pairs, power, 2.0), &dist2);
            assert_eq!(found.len(), 150);
            for (i, (place, theta, weight)) in found.into_iter().enumerate() {
                let r = dist2[i].sqrt() / 2.0;
                let expected = (-3.0 * r * r).exp();
                assert!(place == i && (theta - expected).abs() < 1e-15);
                let expected = expected * r.powf(-exponent);
                assert!((weight - expected).abs() < 1e-13 * expected, "{power:?} at {r}: {weight}, {expected}");
            }
        }
        let (mut block, mut sum) = (Block::new(), 1.0);
        assert!(dist2.iter().take(50).all(|&d2| !block.add(0, d2)));
        block.add_to(&mut sum, -0.5);
        let expected: f64 = dist2.iter().take(50).map(|d2| (-0.5 * d2).exp()).sum();
        assert!((sum - 1.0 - expected).abs() < 1e-12 && !block.add(0, 1.0));
    }

    #[test]
    fn near_pairs_count_as_a_thousandth_of_the_radius() {
        let formula = Formula::new(WlopVariant::Paper, true, 2.0);
        let found = weigh(&PairWeight::new(&formula.attraction, Power::One, 2.0), &[0.0, 1e-8, 0.25]);
        assert!(found[0].1 == 1.0 && (found[0].2 - 1e3).abs() < 1e-9 && (found[1].2 - found[0].2).abs() < 1e-4);
        // At a quarter of the radius θ is 1 / e.
        assert!((found[2].1 - (-1.0f64).exp()).abs() < 1e-15 && (found[2].2 - 4.0 * found[2].1).abs() < 1e-14);
    }
}
