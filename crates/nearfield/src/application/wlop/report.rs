//! What an iteration did.

use crate::query::Stage;

/// One iteration over all samples.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WlopReport {
    /// Its number, from 1 on.
    pub iteration: u32,
    /// Mean length of the moves.
    pub mean_move: f64,
    /// Length of the longest move.
    pub largest_move: f64,
    /// Mean number of points that attracted a sample.
    pub mean_inputs: f64,
    /// Mean number of other samples that repelled one.
    pub mean_samples: f64,
    /// Samples that nothing attracted.
    pub unattracted: u64,
    /// Times of the stages, in order.
    pub stages: Vec<Stage>,
    /// Time of the iteration by the host's clock; on a device a share of that of the iterations that ran together.
    pub milliseconds: f64,
}

/// Sums over the samples of an iteration.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Sums {
    pub(super) moves: f64,
    pub(super) largest: f64,
    pub(super) inputs: f64,
    pub(super) samples: f64,
    pub(super) unattracted: u64,
}

impl Sums {
    pub(super) fn report(&self, iteration: u32, n: usize, stages: Vec<Stage>, milliseconds: f64) -> WlopReport {
        let n = (n as f64).max(1.0);
        WlopReport {
            iteration,
            mean_move: self.moves / n,
            largest_move: self.largest,
            mean_inputs: self.inputs / n,
            mean_samples: self.samples / n,
            unattracted: self.unattracted,
            stages,
            milliseconds,
        }
    }
}
