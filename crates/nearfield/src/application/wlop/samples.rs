//! The samples with what is to be said of each.

use crate::application::PointFlags;
use crate::geometry::Scalar;
use crate::geometry::vector::Vector;

/// Points around a sample from which on it has enough.
const FEWEST_INPUTS: u32 = 3;

/// Samples as they are now.
///
/// Of a sample's flags [`PointFlags::NO_ATTRACTION`] says that no point, or hardly any, is around it: it stands on an outlier or in
/// nothing; [`PointFlags::FEW_NEIGHBORS`] that fewer than three points are within the attraction's reach, or too few other samples
/// within the radius to push it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WlopSamples<T> {
    /// `[s]` in the order in which they began.
    pub positions: Vec<Vector<T>>,
    /// `[s]`.
    pub flags: Vec<PointFlags>,
}

/// What the last iteration found around a sample.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Around {
    /// Σ θ over the points in reach, but those where the sample stands.
    pub(super) crowd: f64,
    /// Points in reach.
    pub(super) inputs: u32,
    /// Other samples within the radius.
    pub(super) samples: u32,
    pub(super) is_attracted: bool,
}

impl<T: Scalar> WlopSamples<T> {
    /// - `least_attraction`: part of the median of all samples below which there is none
    /// - `least_samples`: other samples that push
    pub(super) fn new(positions: Vec<Vector<T>>, around: &[Around], least_attraction: f64, least_samples: u32) -> Self {
        let mut crowds: Vec<f64> = around.iter().map(|sample| sample.crowd).collect();
        let middle = crowds.len() / 2;
        let median = match crowds.is_empty() {
            true => 0.0,
            false => *crowds.select_nth_unstable_by(middle, f64::total_cmp).1,
        };
        let flags = |sample: &Around| {
            let mut flags = PointFlags::default();
            if !sample.is_attracted || sample.crowd < least_attraction * median {
                flags |= PointFlags::NO_ATTRACTION;
            }
            if sample.inputs < FEWEST_INPUTS || sample.samples < least_samples {
                flags |= PointFlags::FEW_NEIGHBORS;
            }
            flags
        };
        Self { flags: around.iter().map(flags).collect(), positions }
    }

    /// Number of samples without attraction.
    pub fn unattracted(&self) -> usize {
        self.flags.iter().filter(|flags| flags.contains(PointFlags::NO_ATTRACTION)).count()
    }

    /// Drops the samples without attraction; the others keep their order. Returns how many were dropped.
    pub fn keep_attracted(&mut self) -> usize {
        let dropped = self.unattracted();
        let kept = |flags: &PointFlags| !flags.contains(PointFlags::NO_ATTRACTION);
        let mut flags = self.flags.iter();
        self.positions.retain(|_| flags.next().is_some_and(kept));
        self.flags.retain(kept);
        dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_without_attraction_are_flagged_and_dropped() {
        let around = |crowd, inputs, samples| Around { crowd, inputs, samples, is_attracted: crowd > 0.0 };
        let all =
            [around(100.0, 50, 6), around(4.0, 50, 6), around(0.0, 0, 6), around(110.0, 2, 6), around(90.0, 9, 0)];
        let positions: Vec<[f64; 3]> = (0..5u8).map(|i| [f64::from(i); 3]).collect();
        let mut samples = WlopSamples::new(positions, &all, 0.05, 1);
        let (none, few) = (PointFlags::NO_ATTRACTION, PointFlags::FEW_NEIGHBORS);
        let mut both = none;
        both |= few;
        assert_eq!(samples.flags, [PointFlags::default(), none, both, few, few]);
        assert_eq!((samples.unattracted(), samples.keep_attracted()), (2, 2));
        assert_eq!(samples.positions, [[0.0; 3], [3.0; 3], [4.0; 3]]);
        assert_eq!((samples.flags.len(), samples.unattracted()), (3, 0));
    }

    #[test]
    fn no_sample_has_no_flag() {
        let mut samples = WlopSamples::<f32>::new(vec![], &[], 0.05, 1);
        assert_eq!((samples.keep_attracted(), samples.flags.len()), (0, 0));
    }
}
