//! What an iteration did.

use crate::query::Stage;

/// One iteration over all points.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MlsReport {
    /// Its number, from 1 on.
    pub iteration: u32,
    /// Points that were fitted: all while smoothing, those not yet arrived while projecting.
    pub fitted: u64,
    /// Points that have still to move: all while smoothing.
    pub moving: u64,
    /// Mean length of the moves of the fitted points.
    pub mean_move: f64,
    /// Length of the longest move.
    pub largest_move: f64,
    /// Mean move along the normals, negative where the surface shrinks. `None` without oriented normals.
    pub mean_signed_move: Option<f64>,
    /// Estimated relative change of the volume that the fitted points enclose: by the divergence theorem
    /// 3 Σ ⟨move, n⟩ / Σ ⟨x − c, n⟩ with the centre c of the points, as if each stood for the same area. `None` without oriented
    /// normals, and where they do not enclose c.
    pub volume_change: Option<f64>,
    /// Mean number of samples that a point was fitted to, itself among them where it is one.
    pub mean_neighbors: f64,
    /// Number of points with each flag, in the order of [`PointFlags::NAMES`](crate::application::PointFlags::NAMES).
    pub flagged: [u64; 7],
    /// Times of the stages, in order.
    pub stages: Vec<Stage>,
    /// Time of the iteration by the host's clock.
    pub milliseconds: f64,
}

/// The points enclose their centre where normals point away from it by more than this part of the distances.
const ENCLOSES: f64 = 0.05;

/// Sums over the points of an iteration.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Sums {
    pub(super) fitted: u64,
    pub(super) moving: u64,
    pub(super) moves: f64,
    pub(super) largest: f64,
    /// Σ ⟨move, n⟩.
    pub(super) along: f64,
    /// Σ ⟨x − c, n⟩ and Σ |x − c|.
    pub(super) outwards: f64,
    pub(super) distances: f64,
    pub(super) neighbors: u64,
    pub(super) flagged: [u64; 7],
}

impl Sums {
    #[cfg(any(test, feature = "gpu"))]
    pub(super) fn add(&mut self, other: &Self) {
        self.fitted += other.fitted;
        self.moving += other.moving;
        self.moves += other.moves;
        self.largest = self.largest.max(other.largest);
        self.along += other.along;
        self.outwards += other.outwards;
        self.distances += other.distances;
        self.neighbors += other.neighbors;
        self.flagged.iter_mut().zip(other.flagged).for_each(|(total, more)| *total += more);
    }

    /// The report of iteration number `iteration`.
    pub(super) fn report(&self, iteration: u32, oriented: bool, stages: Vec<Stage>, milliseconds: f64) -> MlsReport {
        let mean = |sum: f64| if self.fitted > 0 { sum / self.fitted as f64 } else { 0.0 };
        let encloses = oriented && self.outwards > ENCLOSES * self.distances;
        MlsReport {
            iteration,
            fitted: self.fitted,
            moving: self.moving,
            mean_move: mean(self.moves),
            largest_move: self.largest,
            mean_signed_move: oriented.then(|| mean(self.along)),
            volume_change: encloses.then(|| 3.0 * self.along / self.outwards),
            mean_neighbors: mean(self.neighbors as f64),
            flagged: self.flagged,
            stages,
            milliseconds,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn volumes_change_as_spheres_do() {
        // 100 points of a sphere of radius 2, each 0.01 inwards: the volume falls by 1.5 % to first order.
        let sums = Sums { fitted: 100, along: -1.0, outwards: 200.0, distances: 200.0, ..Sums::default() };
        let report = sums.report(1, true, vec![], 0.0);
        assert_eq!((report.mean_signed_move, report.volume_change), (Some(-0.01), Some(-0.015)));
        let report = sums.report(1, false, vec![], 0.0);
        assert_eq!((report.mean_signed_move, report.volume_change), (None, None));
        // A flat patch encloses nothing.
        let flat = Sums { outwards: 1.0, ..sums };
        assert_eq!(flat.report(1, true, vec![], 0.0).volume_change, None);
        assert_eq!(Sums::default().report(1, true, vec![], 0.0).mean_move, 0.0);
    }

    #[test]
    fn sums_add_up() {
        let flagged = [0, 0, 1, 1, 0, 0, 0];
        let one = Sums { fitted: 1, moves: 0.5, largest: 0.5, neighbors: 7, flagged, ..Sums::default() };
        let mut all = one;
        all.add(&Sums { largest: 0.25, moves: 0.25, fitted: 1, ..Sums::default() });
        let report = all.report(3, false, vec![], 0.0);
        assert_eq!((report.iteration, report.mean_move, report.largest_move), (3, 0.375, 0.5));
        assert_eq!((report.mean_neighbors, report.flagged), (3.5, [0, 0, 1, 1, 0, 0, 0]));
    }
}
