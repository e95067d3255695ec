//! Where to split a node of the binary tree: the place of least surface area times triangles, by bins or exactly.

use glam::Vec3A;
use rayon::prelude::*;

use super::BvhSettings;
use super::build::Primitive;
use super::settings::MOST_BINS;

/// Nodes of more triangles are put into bins by several threads, this many triangles each.
const CHUNK: usize = 1 << 15;
/// Bins beyond a share of the triangles tell nothing.
const TRIANGLES_PER_BIN: usize = 2;

/// Where a node is split.
pub(super) enum Split {
    /// The primitives were sorted: the first ones go left.
    Sorted { n_left: usize },
    /// By the bins of their centres.
    Bins(BinPlane),
    /// All centres are in one place.
    None,
}

/// A border between bins of one axis.
pub(super) struct BinPlane {
    bins: Bins,
    axis: usize,
    /// Bins on the left.
    n_left: u32,
}

impl BinPlane {
    pub(super) fn is_left(&self, primitive: &Primitive) -> bool {
        self.bins.of(primitive)[self.axis] < self.n_left
    }
}

/// How centres go into bins.
#[derive(Clone, Copy)]
struct Bins {
    low: Vec3A,
    /// Bins a unit of length; 0 along an axis without an extent.
    scale: Vec3A,
    n: u32,
}

impl Bins {
    fn of(&self, primitive: &Primitive) -> [u32; 3] {
        let place = (primitive.center() - self.low) * self.scale;
        place.to_array().map(|p| (p as u32).min(self.n - 1))
    }
}

/// A box and how many triangles are in it.
#[derive(Clone, Copy)]
struct Filled {
    min: Vec3A,
    max: Vec3A,
    n: u32,
}

impl Filled {
    const EMPTY: Self = Self { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY, n: 0 };

    fn add(&mut self, primitive: &Primitive) {
        self.join(&Self { min: primitive.min(), max: primitive.max(), n: 1 });
    }

    fn join(&mut self, other: &Self) {
        (self.min, self.max, self.n) = (self.min.min(other.min), self.max.max(other.max), self.n + other.n);
    }

    /// Half the surface times the triangles. In f64: squares of f32 coordinates can leave the range of an f32.
    fn cost(&self) -> f64 {
        if self.n == 0 { 0.0 } else { half_area(self.max - self.min) * f64::from(self.n) }
    }
}

/// Half the surface of a box.
pub(super) fn half_area(extent: Vec3A) -> f64 {
    let [x, y, z] = extent.to_array().map(f64::from);
    x * y + y * z + z * x
}

/// The best place to split at least two primitives.
pub(super) fn best_split(primitives: &mut [Primitive], settings: &BvhSettings) -> Split {
    let n = primitives.len();
    if n == 2 {
        return Split::Sorted { n_left: 1 };
    }
    if n <= settings.sweep_below as usize {
        return sweep(primitives);
    }
    let (low, high) = center_bounds(primitives);
    let extent = high - low;
    let n_bins = (settings.bins as usize).min((n / TRIANGLES_PER_BIN).max(2)) as u32;
    let inverse = |e: f32| if e > 0.0 { (n_bins as f32 / e).min(f32::MAX) } else { 0.0 };
    let bins = Bins { low, scale: Vec3A::from_array(extent.to_array().map(inverse)), n: n_bins };
    if extent.max_element() <= 0.0 {
        return Split::None;
    }
    let filled = fill(primitives, &bins);
    let mut best = (f64::INFINITY, 0, 0);
    for (axis, row) in filled.iter().enumerate() {
        if extent[axis] > 0.0 {
            let (cost, n_left) = best_border(&row[..n_bins as usize]);
            if cost < best.0 {
                best = (cost, axis, n_left);
            }
        }
    }
    // Where no border has triangles on both sides, or one side's centres are all in one bin, sorting finds a place.
    if best.0 == f64::INFINITY {
        return sweep(primitives);
    }
    Split::Bins(BinPlane { bins, axis: best.1, n_left: best.2 })
}

fn center_bounds(primitives: &[Primitive]) -> (Vec3A, Vec3A) {
    let none = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
    let grow = |(low, high): (Vec3A, Vec3A), p: &Primitive| (low.min(p.center()), high.max(p.center()));
    if primitives.len() <= CHUNK {
        return primitives.iter().fold(none, grow);
    }
    let chunks = primitives.par_chunks(CHUNK).map(|chunk| chunk.iter().fold(none, grow));
    chunks.reduce(|| none, |a, b| (a.0.min(b.0), a.1.max(b.1)))
}

type Rows = [[Filled; MOST_BINS]; 3];

fn fill(primitives: &[Primitive], bins: &Bins) -> Rows {
    let fill_chunk = |chunk: &[Primitive]| {
        let mut rows: Rows = [[Filled::EMPTY; MOST_BINS]; 3];
        for primitive in chunk {
            for (row, bin) in rows.iter_mut().zip(bins.of(primitive)) {
                row[bin as usize].add(primitive);
            }
        }
        rows
    };
    if primitives.len() <= CHUNK {
        return fill_chunk(primitives);
    }
    let join = |mut a: Rows, b: Rows| {
        a.as_flattened_mut().iter_mut().zip(b.as_flattened()).for_each(|(a, b)| a.join(b));
        a
    };
    primitives.par_chunks(CHUNK).map(fill_chunk).reduce(|| [[Filled::EMPTY; MOST_BINS]; 3], join)
}

/// Cost of the best border, and the bins on its left; infinite where no border has triangles on both sides.
fn best_border(bins: &[Filled]) -> (f64, u32) {
    let mut right_costs = [(0.0, 0); MOST_BINS];
    let mut right = Filled::EMPTY;
    for (bin, filled) in bins.iter().enumerate().skip(1).rev() {
        right.join(filled);
        right_costs[bin] = (right.cost(), right.n);
    }
    let mut left = Filled::EMPTY;
    let mut best = (f64::INFINITY, 0);
    for (bin, filled) in bins.iter().enumerate().take(bins.len() - 1) {
        left.join(filled);
        let (right_cost, n_right) = right_costs[bin + 1];
        if left.n > 0 && n_right > 0 && left.cost() + right_cost < best.0 {
            best = (left.cost() + right_cost, bin as u32 + 1);
        }
    }
    best
}

/// The best place between any two primitives, which are sorted along the axis chosen.
fn sweep(primitives: &mut [Primitive]) -> Split {
    let mut best = (f64::INFINITY, 0, 0);
    let mut right_costs = vec![0.0; primitives.len()];
    for axis in 0..3 {
        sort(primitives, axis);
        let mut right = Filled::EMPTY;
        for (place, primitive) in primitives.iter().enumerate().skip(1).rev() {
            right.add(primitive);
            right_costs[place] = right.cost();
        }
        let mut left = Filled::EMPTY;
        for (place, primitive) in primitives.iter().enumerate().take(primitives.len() - 1) {
            left.add(primitive);
            let cost = left.cost() + right_costs[place + 1];
            if cost < best.0 {
                best = (cost, axis, place + 1);
            }
        }
    }
    let (_, axis, n_left) = best;
    if axis != 2 {
        sort(primitives, axis);
    }
    Split::Sorted { n_left }
}

/// By centre, then by index, so that the order does not depend on what it was.
fn sort(primitives: &mut [Primitive], axis: usize) {
    primitives.sort_unstable_by(|a, b| a.center()[axis].total_cmp(&b.center()[axis]).then(a.index().cmp(&b.index())));
}
