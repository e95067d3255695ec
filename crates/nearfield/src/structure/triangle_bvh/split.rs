//! Where to split a node of many triangles: the border between bins of least surface area times triangles.

use glam::{Vec3A, Vec4};

use super::BvhSettings;
use super::build::{Builder, CenterBounds, Primitive};
use super::settings::MOST_BINS;

/// Bins beyond a share of the triangles tell nothing.
const TRIANGLES_PER_BIN: usize = 2;
/// 2²³: an f32 plus this has the nearest integer in its lowest bits.
const INTEGERS: f32 = 8_388_608.0;

/// A border between bins of one axis.
#[derive(Clone, Copy)]
pub(super) struct Border {
    axis: usize,
    /// Bins on the left.
    n_left: u32,
}

/// How centres go into bins.
#[derive(Clone, Copy)]
pub(super) struct Bins {
    low: Vec3A,
    /// Bins a unit of length; 0 along an axis without an extent.
    scale: Vec3A,
    last: Vec3A,
    n: usize,
}

impl CenterBounds {
    /// The bins for so many primitives; `None` where all centres are in one place.
    pub(super) fn bins(&self, n: usize, settings: &BvhSettings) -> Option<Bins> {
        let extent = self.high - self.low;
        if extent.max_element() <= 0.0 {
            return None;
        }
        let n_bins = (settings.bins as usize).min((n / TRIANGLES_PER_BIN).max(2)).min(MOST_BINS);
        let inverse = |e: f32| if e > 0.0 { (n_bins as f32 / e).min(f32::MAX) } else { 0.0 };
        let scale = Vec3A::from_array(extent.to_array().map(inverse));
        Some(Bins { low: self.low, scale, last: Vec3A::splat(n_bins as f32 - 1.0), n: n_bins })
    }
}

impl Bins {
    #[inline(always)]
    fn of(&self, primitive: &Primitive) -> [usize; 3] {
        let place = (primitive.center() - self.low) * self.scale - 0.5;
        let rounded = place.max(Vec3A::ZERO).min(self.last) + INTEGERS;
        rounded.to_array().map(|place| place.to_bits() as usize % MOST_BINS)
    }
}

/// A border of bins.
pub(super) struct BinPlane {
    pub(super) bins: Bins,
    pub(super) border: Border,
}

impl BinPlane {
    /// Whether the bin of the primitive is on the left: the arithmetic of [`Bins::of`] along one axis.
    #[inline(always)]
    pub(super) fn is_left(&self, primitive: &Primitive) -> bool {
        let axis = self.border.axis;
        let center = primitive.low[axis] + primitive.high[axis];
        let place = (center - self.bins.low[axis]) * self.bins.scale[axis] - 0.5;
        place + INTEGERS < self.border.n_left as f32 + INTEGERS
    }
}

/// A box whose fourth coordinates mean nothing.
#[derive(Clone, Copy)]
struct Bounds {
    low: Vec4,
    high: Vec4,
}

impl Bounds {
    const EMPTY: Self = Self { low: Vec4::INFINITY, high: Vec4::NEG_INFINITY };

    #[inline(always)]
    fn join(&mut self, low: Vec4, high: Vec4) {
        (self.low, self.high) = (self.low.min(low), self.high.max(high));
    }

    #[inline(always)]
    fn extent(&self) -> Vec3A {
        Vec3A::from_vec4(self.high) - Vec3A::from_vec4(self.low)
    }
}

/// Boxes and numbers of the primitives in each bin, axis by axis.
pub(super) struct Filled {
    bounds: [[Bounds; 3]; MOST_BINS],
    counts: [[u32; 3]; MOST_BINS],
}

impl Filled {
    /// Primitives on the left of a border.
    pub(super) fn n_left(&self, border: &Border) -> usize {
        self.counts[..border.n_left as usize].iter().map(|counts| counts[border.axis] as usize).sum()
    }
}

/// Puts primitives into bins.
#[inline(always)]
pub(super) fn fill(primitives: &[Primitive], bins: &Bins) -> Filled {
    let mut filled = Filled { bounds: [[Bounds::EMPTY; 3]; MOST_BINS], counts: [[0; 3]; MOST_BINS] };
    for primitive in primitives {
        for (axis, bin) in bins.of(primitive).into_iter().enumerate() {
            filled.bounds[bin][axis].join(primitive.low, primitive.high);
            filled.counts[bin][axis] += 1;
        }
    }
    filled
}

/// The best border for the primitives; `None` where none has triangles on both sides.
pub(super) fn best_split(primitives: &[Primitive], bins: &Bins, builder: &Builder<'_>) -> Option<Border> {
    best_border(&fill(primitives, bins), bins, builder)
}

/// The best border for primitives in several parts.
pub(super) fn best_split_of(parts: &[Filled], bins: &Bins, builder: &Builder<'_>) -> Option<Border> {
    let mut all = Filled { bounds: [[Bounds::EMPTY; 3]; MOST_BINS], counts: [[0; 3]; MOST_BINS] };
    for part in parts {
        for bin in 0..bins.n {
            for axis in 0..3 {
                let Bounds { low, high } = part.bounds[bin][axis];
                all.bounds[bin][axis].join(low, high);
                all.counts[bin][axis] += part.counts[bin][axis];
            }
        }
    }
    best_border(&all, bins, builder)
}

fn best_border(filled: &Filled, bins: &Bins, builder: &Builder<'_>) -> Option<Border> {
    // Of each axis: what is on the right of each border costs.
    let mut right_costs = [[0.0; 3]; MOST_BINS];
    let (mut right, mut n_right) = ([Bounds::EMPTY; 3], [0; 3]);
    for bin in (1..bins.n).rev() {
        for axis in 0..3 {
            let Bounds { low, high } = filled.bounds[bin][axis];
            right[axis].join(low, high);
            n_right[axis] += filled.counts[bin][axis];
            right_costs[bin][axis] = cost(&right[axis], n_right[axis], builder);
        }
    }
    let (mut left, mut n_left) = ([Bounds::EMPTY; 3], [0; 3]);
    let mut best = (f32::INFINITY, None);
    for (bin, right_costs) in right_costs.iter().enumerate().take(bins.n).skip(1) {
        for axis in 0..3 {
            let Bounds { low, high } = filled.bounds[bin - 1][axis];
            left[axis].join(low, high);
            n_left[axis] += filled.counts[bin - 1][axis];
            let cost = cost(&left[axis], n_left[axis], builder) + right_costs[axis];
            if cost < best.0 {
                best = (cost, Some(Border { axis, n_left: bin as u32 }));
            }
        }
    }
    best.1
}

/// Half the surface times the triangles; infinite for none, so that no border has all on one side.
#[inline(always)]
fn cost(bounds: &Bounds, n: u32, builder: &Builder<'_>) -> f32 {
    if n == 0 { f32::INFINITY } else { builder.half_area(bounds.extent()) * n as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::triangle_bvh::build::boxes;
    use crate::structure::triangle_bvh::collapse::LeafCost;

    #[test]
    fn sides_agree_with_bins() {
        let mut primitives = boxes(1000, 1);
        let mut last = primitives.len();
        // Down to centres that are as near to each other as numbers are.
        while last > 4 {
            primitives.truncate(last);
            for n_bins in [2, 7, 32, 64] {
                let settings = BvhSettings { bins: n_bins, ..BvhSettings::DEFAULT };
                let bins = CenterBounds::of(&primitives).bins(last, &settings).unwrap();
                let filled = fill(&primitives, &bins);
                assert_eq!(filled.counts.iter().map(|counts| counts[0] as usize).sum::<usize>(), last);
                for axis in 0..3 {
                    for n_left in 1..bins.n as u32 {
                        let border = Border { axis, n_left };
                        let plane = BinPlane { bins, border };
                        let found = primitives.iter().filter(|p| plane.is_left(p)).count();
                        assert_eq!(found, filled.n_left(&border), "{n_bins} bins, axis {axis}, border {n_left}");
                    }
                }
            }
            primitives.sort_by(|a, b| a.center().x.total_cmp(&b.center().x));
            last = last * 2 / 3;
        }
    }

    #[test]
    fn parts_of_many_are_split_as_the_whole() {
        let primitives = boxes(5000, 2);
        let settings = BvhSettings::DEFAULT;
        let cost = LeafCost { most: 8, entry: 1.0, triangle: 0.0 };
        let builder = Builder { settings: &settings, cost: &cost, unit: 1.0 };
        let bins = CenterBounds::of(&primitives).bins(primitives.len(), &settings).unwrap();
        let whole = best_split(&primitives, &bins, &builder).unwrap();
        let parts: Vec<Filled> = primitives.chunks(700).map(|part| fill(part, &bins)).collect();
        let found = best_split_of(&parts, &bins, &builder).unwrap();
        assert_eq!((found.axis, found.n_left), (whole.axis, whole.n_left));
        let n_left: usize = parts.iter().map(|part| part.n_left(&found)).sum();
        assert!(n_left > 0 && n_left < primitives.len());
    }
}
