//! The projections of all tables, and the hash of a point. `hash.wesl` is the twin of this file.

use nearfield::{Error, Result};

use super::{LshSettings, PieceWidth};
use crate::baselines::exact;
use crate::baselines::points::{Points, Queries, Random};

/// Points whose k-th nearest is asked for the width.
const SAMPLED: usize = 64;
/// Directions are multiples of one over this.
const STEPS: f64 = 64.0;
/// Pieces are numbered from minus to plus this.
const LARGEST_PIECE: f32 = (1 << 30) as f32;

/// The hash functions of `tables` tables over points of one dimension.
#[derive(Debug, Clone, PartialEq)]
pub struct HashFamily {
    dimension: usize,
    tables: usize,
    projections: usize,
    bucket_limit: usize,
    width: f32,
    /// `[tables × projections × dimension]`.
    directions: Vec<f32>,
    /// `[tables × projections]`, from 0 to the width.
    offsets: Vec<f32>,
}

impl HashFamily {
    /// Draws the projections by the seed; the width may need the points.
    ///
    /// # Errors
    /// `InvalidSetting`.
    pub fn draw(points: &Points, settings: &LshSettings) -> Result<Self> {
        settings.validate()?;
        let width = match settings.width {
            PieceWidth::Fixed(width) => width,
            PieceWidth::OfNearest { k, factor } => width_of_nearest(points, k, factor)?,
        };
        let (dimension, n) = (points.dimension(), settings.tables * settings.projections);
        let mut random = Random::new(settings.seed);
        let (mut directions, mut offsets) = (Vec::with_capacity(n * dimension), Vec::with_capacity(n));
        for _ in 0..n {
            directions.extend((0..dimension).map(|_| ((random.normal() * STEPS).round() / STEPS) as f32));
            offsets.push((random.unit() * f64::from(width)) as f32);
        }
        let &LshSettings { tables, projections, bucket_limit, .. } = settings;
        Ok(Self { dimension, tables, projections, bucket_limit, width, directions, offsets })
    }

    /// Coordinates of a point.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Tables.
    pub fn tables(&self) -> usize {
        self.tables
    }

    /// Projections of a table.
    pub fn projections(&self) -> usize {
        self.projections
    }

    /// Points of a bucket that a query looks at.
    pub fn bucket_limit(&self) -> usize {
        self.bucket_limit
    }

    /// Width of the pieces.
    pub fn width(&self) -> f32 {
        self.width
    }

    /// What the pieces' numbers are multiplied by.
    pub(super) fn inverse_width(&self) -> f32 {
        1.0 / self.width
    }

    /// Offsets as the kernel takes them.
    pub(super) fn offsets(&self) -> &[f32] {
        &self.offsets
    }

    /// Directions in groups of four coordinates, as the kernel takes them.
    ///
    /// # Errors
    /// Never: directions are as good as points.
    pub(super) fn direction_quads(&self) -> Result<Vec<[f32; 4]>> {
        Ok(Points::new(self.dimension, self.directions.clone())?.quads())
    }

    /// The hash of a point in a table.
    ///
    /// # Panics
    /// If there is no such table or the point has another dimension.
    pub fn hash(&self, point: &[f32], table: usize) -> u32 {
        assert!(point.len() == self.dimension && table < self.tables, "point and table should be of the family");
        let mut hash = table as u32;
        for p in table * self.projections..(table + 1) * self.projections {
            let direction = &self.directions[p * self.dimension..(p + 1) * self.dimension];
            let along: f32 = point.iter().zip(direction).map(|(x, a)| x * a).sum();
            let piece = ((along + self.offsets[p]) * self.inverse_width()).floor();
            hash = mix(hash, piece.clamp(-LARGEST_PIECE, LARGEST_PIECE) as i32 as u32);
        }
        hash
    }
}

fn mix(hash: u32, piece: u32) -> u32 {
    let product = (hash ^ piece).wrapping_mul(0x9e37_79b1);
    product ^ (product >> 15)
}

/// `factor` times the median distance of the k-th nearest of some points, itself not counted; of equal points 1.
fn width_of_nearest(points: &Points, k: usize, factor: f32) -> Result<f32> {
    let k = k.min(points.len().saturating_sub(1)).max(1);
    let rows = exact::knn(points, Queries::PointsWithoutSelf, &exact::sample(points.len(), SAMPLED), k);
    let kth = |i: usize| rows.row_dist2(i).last().copied().filter(|&dist2| dist2 > 0.0);
    let mut distances: Vec<f32> = (0..rows.len()).filter_map(kth).map(f32::sqrt).collect();
    distances.sort_by(f32::total_cmp);
    let width = factor * distances.get(distances.len() / 2).copied().unwrap_or(1.0);
    LshSettings { width: PieceWidth::Fixed(width), ..LshSettings::for_k(1) }.validate().map_err(|_| {
        Error::InvalidSetting {
            setting: "width",
            found: format!("{width:e}, from the points"),
            expected: "between 1e-15 and 1e18: scale the points, or give the width",
        }
    })?;
    Ok(width)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_gives_the_same_tables_and_another_gives_others() {
        let points = Points::uniform(200, 6, 1).expect("points");
        let draw = |seed| HashFamily::draw(&points, &LshSettings::for_k(5).seed(seed)).expect("a family");
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1).directions, draw(2).directions);
    }

    #[test]
    fn the_width_is_a_multiple_of_the_distance_to_the_nearest() {
        // On a line with steps of 0.5 the second nearest of inner points is 0.5 away.
        let points = Points::new(2, (0..100).flat_map(|i| [0.5 * i as f32, 3.0]).collect()).expect("points");
        let settings = LshSettings::for_k(2).width(PieceWidth::OfNearest { k: 2, factor: 4.0 });
        assert_eq!(HashFamily::draw(&points, &settings).expect("a family").width(), 2.0);
        let equal = Points::new(2, vec![7.0; 40]).expect("points");
        assert_eq!(HashFamily::draw(&equal, &settings).expect("a family").width(), 4.0);
    }

    #[test]
    fn directions_are_normal() {
        let points = Points::uniform(2, 64, 1).expect("points");
        let settings = LshSettings::for_k(1).tables(16).projections(16);
        let directions = HashFamily::draw(&points, &settings).expect("a family").directions;
        let n = directions.len() as f64;
        let mean = directions.iter().map(|&v| f64::from(v)).sum::<f64>() / n;
        let variance = directions.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>() / n;
        // Of 16,384 values: five standard errors are 0.039 and 0.055.
        assert!(mean.abs() < 0.039 && (variance - 1.0).abs() < 0.055, "{mean} {variance}");
    }

    #[test]
    fn near_points_share_a_hash_more_often_than_far_ones() {
        let points = Points::new(3, vec![0.1, 0.2, 0.3, 0.11, 0.2, 0.3, 0.9, 0.7, 0.1]).expect("points");
        let settings = LshSettings::for_k(1).tables(64).projections(2).width(PieceWidth::Fixed(0.25));
        let family = HashFamily::draw(&points, &settings).expect("a family");
        let shared = |a, b| (0..64).filter(|&t| family.hash(points.get(a), t) == family.hash(points.get(b), t)).count();
        assert!(shared(0, 1) > 50 && shared(0, 2) < 20, "{} {}", shared(0, 1), shared(0, 2));
    }

    #[test]
    fn settings_out_of_range_are_errors() {
        let points = Points::uniform(10, 3, 1).expect("points");
        let right = LshSettings::for_k(3);
        for settings in [
            right.tables(0),
            right.tables(65),
            right.projections(33),
            right.bucket_limit(0),
            right.width(PieceWidth::Fixed(0.0)),
            right.width(PieceWidth::Fixed(f32::NAN)),
            right.width(PieceWidth::OfNearest { k: 0, factor: 4.0 }),
        ] {
            assert!(matches!(HashFamily::draw(&points, &settings), Err(Error::InvalidSetting { .. })), "{settings:?}");
        }
    }
}
