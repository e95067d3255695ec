//! Small random streams that are the same everywhere.

use glam::DVec3;

/// SplitMix64 (Steele2014).
pub(crate) struct SplitMix64 {
    state: u64,
}

const GOLDEN_GAMMA: u64 = 0x9e37_79b9_7f4a_7c15;

/// The finalizer of SplitMix64: a bijection that flips half the bits on average.
pub(super) fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl SplitMix64 {
    /// Stream number `index` of `seed`: streams start at unrelated places of the one sequence of 2⁶⁴ numbers.
    pub(crate) fn stream(seed: u64, index: u64) -> Self {
        Self { state: mix(mix(seed.wrapping_add(GOLDEN_GAMMA)).wrapping_add(index.wrapping_mul(GOLDEN_GAMMA))) }
    }

    pub(super) fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GOLDEN_GAMMA);
        mix(self.state)
    }

    /// Uniform in [0, 1) in steps of 2⁻²⁴, exact as an f32.
    pub(super) fn unit_f32(&mut self) -> f32 {
        (self.next_u64() >> 40) as f32 * (1.0 / (1u64 << 24) as f32)
    }

    /// Uniform in [0, 1) in steps of 2⁻⁵³.
    pub(super) fn unit(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in [low, high).
    pub(super) fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Uniform in 0 … count - 1 (count ≥ 1), by the high half of a product; the bias is below count · 2⁻⁶⁴.
    pub(crate) fn below(&mut self, count: u64) -> u64 {
        ((u128::from(self.next_u64()) * u128::from(count)) >> 64) as u64
    }

    /// Two independent standard normal numbers (BoxMuller1958).
    pub(super) fn normal_pair(&mut self) -> (f64, f64) {
        let radius = (-2.0 * libm::log(1.0 - self.unit())).sqrt();
        let (sin, cos) = libm::sincos(std::f64::consts::TAU * self.unit());
        (radius * cos, radius * sin)
    }

    /// Standard normal number.
    pub(super) fn normal(&mut self) -> f64 {
        self.normal_pair().0
    }

    /// Uniform on the unit sphere (Archimedes: height and longitude are independent and uniform).
    pub(super) fn direction(&mut self) -> DVec3 {
        let z = self.range(-1.0, 1.0);
        let (sin, cos) = libm::sincos(std::f64::consts::TAU * self.unit());
        let ring = (1.0 - z * z).sqrt();
        DVec3::new(ring * cos, ring * sin, z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first three numbers of the authors' generator for seed 1234567, as published with it.
    #[test]
    fn the_sequence_is_the_published_one() {
        let mut random = SplitMix64 { state: 1_234_567 };
        let expected = [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423];
        assert_eq!([random.next_u64(), random.next_u64(), random.next_u64()], expected);
    }

    #[test]
    fn unit_numbers_stay_below_one() {
        let mut random = SplitMix64::stream(3, 0);
        for _ in 0..100_000 {
            let (a, b, c) = (random.unit_f32(), random.unit(), random.below(3));
            assert!((0.0..1.0).contains(&a) && (0.0..1.0).contains(&b) && c < 3);
        }
    }

    #[test]
    fn normal_numbers_have_mean_zero_and_variance_one() {
        let mut random = SplitMix64::stream(5, 0);
        let n = 100_000;
        let (mut sum, mut sum2) = (0.0, 0.0);
        for _ in 0..n {
            let (a, b) = random.normal_pair();
            sum += a + b;
            sum2 += a * a + b * b;
        }
        // Five standard errors: 1/√(2n) of the mean, √(2/2n) of the variance.
        let count = f64::from(2 * n);
        assert!((sum / count).abs() < 5.0 / count.sqrt());
        assert!((sum2 / count - 1.0).abs() < 5.0 * (2.0 / count).sqrt());
    }
}
