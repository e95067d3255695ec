//! Farthest-point samples (Gonzalez1985, Eldar1997), exactly, over a tree that knows how far each of its boxes can be.

use crate::application::Watch;
use crate::application::finite_points::{FinitePoints, Place};
use crate::geometry::Scalar;
use crate::geometry::generate::random::SplitMix64;
use crate::geometry::vector::Vector;
use crate::structure::aabb_tree::any_dimension::dist2_to_box;
use crate::structure::{AabbTreeN, AabbTreeNSettings};
use crate::{Error, Result};

/// Samples between two reports.
const BLOCK: usize = 256;
/// What is reported.
pub(super) const STAGE: &str = "farthest points";

/// The first sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FarthestStart {
    /// This point.
    Index(u32),
    /// One of all finite points, by this seed.
    Seed(u64),
}

/// Samples in the order in which they were taken.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FarthestPoints<T> {
    /// `[count]` indices.
    pub indices: Vec<u32>,
    /// `[count]` the distance of each to those before it, which no other point had larger: the first is infinite, and none is larger
    /// than the one before.
    pub distances: Vec<T>,
    /// Indices of the points with a NaN or infinite coordinate, ascending.
    pub invalid: Vec<u32>,
}

/// So many points, each the farthest from all before it, of equals the one with the smallest index.
///
/// ```
/// use nearfield::application::{FarthestStart, Watch, farthest_points};
///
/// let points = [0.0, 1.0, 2.0, 5.0, 6.0].map(|x| [x, 0.0, 0.0]);
/// let samples = farthest_points(&points, 3, FarthestStart::Index(0), &mut Watch::none())?;
/// assert_eq!((samples.indices, &samples.distances[1..]), (vec![0, 4, 2], &[6.0, 2.0][..]));
/// # Ok::<(), nearfield::Error>(())
/// ```
///
/// Every box of a tree keeps the largest distance of its points to the samples; a new sample is not brought into boxes that it is too far from
/// to lower that. So n points give k samples in some n log k steps where comparing all takes n k, with the same bits.
///
/// # Errors
/// `InvalidSetting` for more samples than there are finite points, and for a start that is none; `CoordinateBeyond`, `TooMany` for the
/// points; `Interrupted`.
pub fn farthest_points<T: Scalar>(
    points: &[Vector<T>],
    count: usize,
    start: FarthestStart,
    watch: &mut Watch<'_>,
) -> Result<FarthestPoints<T>> {
    let finite = FinitePoints::of(points)?;
    check_count(count, finite.points().len())?;
    if count == 0 {
        return Ok(FarthestPoints { invalid: finite.invalid(), ..FarthestPoints::default() });
    }
    let tree = AabbTreeN::build(finite.points(), &AabbTreeNSettings::default())?;
    let first = first_sample(start, &finite)?;
    let mut far = Far::new(&tree);
    let (mut taken, mut distances) = (Vec::with_capacity(count), Vec::with_capacity(count));
    let mut next = Candidate { dist2: T::LARGEST, id: first };
    for done in 0..count {
        if done % BLOCK == 0 {
            watch.report(STAGE, done as u64, count as u64)?;
        }
        taken.push(next.id);
        distances.push(if done == 0 { T::of(f64::INFINITY) } else { next.dist2.sqrt() });
        far.add(&finite.points()[next.id as usize], next.id);
        next = far.farthest();
    }
    watch.report(STAGE, count as u64, count as u64)?;
    Ok(FarthestPoints { indices: finite.renamed(taken, u32::MAX), distances, invalid: finite.invalid() })
}

/// Refuses more samples than there are points.
///
/// # Errors
/// `InvalidSetting`.
pub(super) fn check_count(count: usize, n_points: usize) -> Result<()> {
    if count <= n_points {
        return Ok(());
    }
    let found = format!("{count} of {n_points} points");
    Err(Error::InvalidSetting { setting: "number of samples", found, expected: "at most all points" })
}

/// The first sample among the finite points, of which there is one.
///
/// # Errors
/// `InvalidSetting` where it is none of them.
pub(super) fn first_sample<P: Place>(start: FarthestStart, finite: &FinitePoints<'_, P>) -> Result<u32> {
    let n = finite.points().len();
    match start {
        FarthestStart::Seed(seed) => Ok(SplitMix64::stream(seed, 0).below(n as u64) as u32),
        FarthestStart::Index(index) => {
            (0..n as u32).find(|&i| finite.index(i) == index).ok_or_else(|| Error::InvalidSetting {
                setting: "first sample",
                found: index.to_string(),
                expected: "the index of a point with finite coordinates",
            })
        }
    }
}

/// A point and its squared distance to the samples; below 0 once it is one.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Candidate<T> {
    dist2: T,
    id: u32,
}

impl<T: Scalar> Candidate<T> {
    /// The farther one, of equals the one with the smaller index.
    fn or(self, other: Self) -> Self {
        let is_better = other.dist2 > self.dist2 || (other.dist2 == self.dist2 && other.id < self.id);
        if is_better { other } else { self }
    }
}

/// How far points and boxes are from the samples.
struct Far<'a, T: Scalar> {
    tree: &'a AabbTreeN<T, 3>,
    /// `[n]` squared distance of the point at each place of the tree's order.
    dist2: Vec<T>,
    /// `[n_nodes]` the farthest point of each box.
    farthest: Vec<Candidate<T>>,
}

impl<'a, T: Scalar> Far<'a, T> {
    fn new(tree: &'a AabbTreeN<T, 3>) -> Self {
        let nowhere = Candidate { dist2: T::LARGEST, id: u32::MAX };
        Self { tree, dist2: vec![T::LARGEST; tree.len()], farthest: vec![nowhere; tree.shape().n_nodes()] }
    }

    /// The farthest point of all.
    fn farthest(&self) -> Candidate<T> {
        self.farthest[0]
    }

    /// Adds point `id` to the samples.
    fn add(&mut self, sample: &Vector<T>, id: u32) {
        self.lower(0, sample, id);
    }

    /// Brings a sample into a box, unless no point there can be nearer to it than to the others: no point of the box is nearer than the box,
    /// rounded or not. The sample itself lies in a box at distance 0, and boxes of samples alone have no more to lower.
    fn lower(&mut self, node: usize, sample: &Vector<T>, id: u32) {
        // At equality there is nothing to lower, but a sample among points that coincide with it still has to be taken out.
        if dist2_to_box(sample, &self.tree.boxes()[node]) > self.farthest[node].dist2 {
            return;
        }
        if !self.tree.shape().is_leaf(node) {
            let [left, right] = [2 * node + 1, 2 * node + 2];
            self.lower(left, sample, id);
            self.lower(right, sample, id);
            self.farthest[node] = self.farthest[left].or(self.farthest[right]);
            return;
        }
        let (points, dist2) = (self.tree.ordered_points(), &mut self.dist2);
        let mut farthest = Candidate { dist2: T::SMALLEST, id: u32::MAX };
        points.for_each_dist2(self.tree.places(node), sample, |place, to_sample| {
            let own = points.ids()[place];
            dist2[place] = if own == id { -T::ONE } else { dist2[place].smaller(to_sample) };
            farthest = farthest.or(Candidate { dist2: dist2[place], id: own });
        });
        self.farthest[node] = farthest;
    }
}
