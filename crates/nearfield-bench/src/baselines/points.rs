//! Points of any dimension, who asks around them, and the distance between two.

use nearfield::{Error, Result, Vec3};

/// Most dimensions of a point.
pub const MOST_DIMENSIONS: usize = 64;
/// Fewest dimensions of a point.
pub const FEWEST_DIMENSIONS: usize = 2;
/// Largest coordinate: its square, and a sum of 64 of them, is an f32.
const LARGEST_COORDINATE: f32 = 1e18;

/// `n` points of `dimension` coordinates each, all finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    dimension: usize,
    coordinates: Vec<f32>,
}

impl Points {
    /// Takes `[n × dimension]` coordinates, point by point.
    ///
    /// # Errors
    /// `InvalidSetting` for a dimension outside 2 to 64; `LengthMismatch` where the last point is not whole; `TooMany`
    /// for 2³¹ points or more; `NonFinite`; `CoordinateTooLarge` beyond ±1e18.
    pub fn new(dimension: usize, coordinates: Vec<f32>) -> Result<Self> {
        if !(FEWEST_DIMENSIONS..=MOST_DIMENSIONS).contains(&dimension) {
            let (setting, expected) = ("dimension", "2 to 64");
            return Err(Error::InvalidSetting { setting, found: dimension.to_string(), expected });
        }
        let (n, len) = (coordinates.len() / dimension, coordinates.len() as u64);
        if !coordinates.len().is_multiple_of(dimension) {
            let expected = ((n + 1) * dimension) as u64;
            return Err(Error::LengthMismatch { what: "coordinates", found: len, expected });
        }
        if n >= 1 << 31 {
            let advice = "use fewer points";
            return Err(Error::TooMany { what: "points", found: n as u64, limit: (1 << 31) - 1, advice });
        }
        let is_bad = |p: &[f32]| p.iter().any(|v| !v.is_finite());
        if let Some(first) = coordinates.chunks_exact(dimension).position(is_bad) {
            let count = coordinates.chunks_exact(dimension).filter(|p| is_bad(p)).count() as u64;
            return Err(Error::NonFinite { what: "points", count, first: first as u64 });
        }
        if let Some(at) = coordinates.iter().position(|v| v.abs() > LARGEST_COORDINATE) {
            let axis = ['x', 'y', 'z'].get(at % dimension).copied().unwrap_or('w');
            let (index, value) = ((at / dimension) as u64, f64::from(coordinates[at]));
            return Err(Error::CoordinateTooLarge { what: "points", index, axis, value });
        }
        Ok(Self { dimension, coordinates })
    }

    /// Points in space.
    ///
    /// # Errors
    /// As [`Points::new`].
    pub fn in_space(points: &[Vec3]) -> Result<Self> {
        Self::new(3, points.iter().flat_map(|p| p.to_array()).collect())
    }

    /// `n` points, uniform in the unit cube; the same seed gives the same points on every machine.
    ///
    /// # Errors
    /// As [`Points::new`].
    pub fn uniform(n: usize, dimension: usize, seed: u64) -> Result<Self> {
        let mut random = Random::new(seed);
        Self::new(dimension, (0..n.saturating_mul(dimension)).map(|_| random.unit() as f32).collect())
    }

    /// Coordinates of a point.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.coordinates.len() / self.dimension
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.coordinates.is_empty()
    }

    /// Coordinates of point `i`.
    ///
    /// # Panics
    /// If there is no such point.
    #[inline]
    pub fn get(&self, i: usize) -> &[f32] {
        &self.coordinates[i * self.dimension..(i + 1) * self.dimension]
    }

    /// `[n × dimension]` coordinates.
    pub fn coordinates(&self) -> &[f32] {
        &self.coordinates
    }

    /// The points as the kernels take them: `[n × quads]` groups of four coordinates, zero behind the last one.
    pub(super) fn quads(&self) -> Vec<[f32; 4]> {
        let quads =
            |p: &[f32]| p.chunks(4).map(|c| std::array::from_fn(|i| c.get(i).copied().unwrap_or(0.0))).collect();
        self.coordinates.chunks_exact(self.dimension).flat_map(|p| -> Vec<[f32; 4]> { quads(p) }).collect()
    }

    /// Checks that other points can be compared with these.
    ///
    /// # Errors
    /// `LengthMismatch` with both dimensions.
    pub fn check_same_dimension(&self, other: &Self) -> Result<()> {
        if self.dimension == other.dimension {
            return Ok(());
        }
        let (found, expected) = (other.dimension as u64, self.dimension as u64);
        Err(Error::LengthMismatch { what: "coordinates of a query", found, expected })
    }
}

/// Who asks.
#[derive(Debug, Clone, Copy)]
pub enum Queries<'a> {
    /// Every point, which finds itself first.
    Points,
    /// Every point, without itself; its exact duplicates stay.
    PointsWithoutSelf,
    /// Other points.
    Other(&'a Points),
}

impl<'a> Queries<'a> {
    /// The points that ask.
    pub fn of<'b>(&self, points: &'b Points) -> &'b Points
    where
        'a: 'b,
    {
        match self {
            Self::Points | Self::PointsWithoutSelf => points,
            Self::Other(queries) => queries,
        }
    }

    /// The index that query `i` must not find.
    #[inline]
    pub fn left_out(&self, i: usize) -> Option<u32> {
        matches!(self, Self::PointsWithoutSelf).then_some(i as u32)
    }
}

/// Squared distance in f32, axis by axis.
#[inline]
pub fn dist2(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// Squared distance in f64: what answers are judged by.
#[inline]
pub fn dist2_in_f64(a: &[f32], b: &[f32]) -> f64 {
    let difference = |(&a, &b): (&f32, &f32)| f64::from(a) - f64::from(b);
    a.iter().zip(b).map(difference).map(|d| d * d).sum()
}

/// Relative error that a squared distance in f32 may have, whatever the order of its operations: with u = 2⁻²⁴, two
/// from the difference, one from the square and one from each sum.
pub fn slack(dimension: usize) -> f64 {
    (dimension + 4) as f64 / f64::from(1 << 24)
}

/// Reproducible random numbers. Source: Steele2014 (SplitMix64).
pub(super) struct Random(u64);

impl Random {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// From 0 to below 1, a multiple of 2⁻²⁴.
    pub(super) fn unit(&mut self) -> f64 {
        (self.bits() >> 40) as f64 / f64::from(1 << 24)
    }

    /// Normal with deviation 1. Source: BoxMuller1958.
    pub(super) fn normal(&mut self) -> f64 {
        let (radius, angle) = (1.0 - self.unit(), std::f64::consts::TAU * self.unit());
        (-2.0 * radius.ln()).sqrt() * angle.cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_points_are_errors_with_their_place() {
        assert!(matches!(Points::new(3, vec![0.0; 7]), Err(Error::LengthMismatch { found: 7, expected: 9, .. })));
        for dimension in [0, 1, 65] {
            assert!(matches!(Points::new(dimension, vec![]), Err(Error::InvalidSetting { .. })), "{dimension}");
        }
        let bad = Points::new(2, vec![0.0, 1.0, f32::NAN, 1.0, 0.0, f32::INFINITY]);
        assert!(matches!(bad, Err(Error::NonFinite { count: 2, first: 1, .. })));
        assert!(matches!(Points::new(2, vec![0.0, 2e18]), Err(Error::CoordinateTooLarge { index: 0, axis: 'y', .. })));
    }

    #[test]
    fn quads_are_padded_with_zeros() {
        let points = Points::new(5, (1..11).map(|v| v as f32).collect()).expect("points");
        let expected = [[1.0, 2.0, 3.0, 4.0], [5.0, 0.0, 0.0, 0.0], [6.0, 7.0, 8.0, 9.0], [10.0, 0.0, 0.0, 0.0]];
        assert_eq!(points.quads(), expected);
    }

    #[test]
    fn distances_in_f32_keep_within_their_slack() {
        let points = Points::uniform(100, 64, 3).expect("points");
        for i in 1..100 {
            let (found, exact) = (dist2(points.get(0), points.get(i)), dist2_in_f64(points.get(0), points.get(i)));
            assert!((f64::from(found) - exact).abs() <= slack(64) * exact, "{found} {exact}");
        }
    }
}
