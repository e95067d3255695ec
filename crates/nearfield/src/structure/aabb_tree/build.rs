//! Builds on the CPU: the order of the points, and boxes from the leaves up, in any dimension.

use rayon::prelude::*;

use super::shape::TreeShape;
use crate::geometry::Scalar;

/// A closed box in `D` dimensions; empty where a `min` is greater than its `max`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoxN<T, const D: usize> {
    /// Smallest corner.
    pub min: [T; D],
    /// Largest corner.
    pub max: [T; D],
}

impl<T: Scalar, const D: usize> BoxN<T, D> {
    /// The empty box.
    pub const EMPTY: Self = Self { min: [T::LARGEST; D], max: [T::SMALLEST; D] };

    /// The smallest box that holds `self` and the point.
    #[inline(always)]
    pub fn grown_to(mut self, point: &[T; D]) -> Self {
        for (axis, &value) in point.iter().enumerate() {
            self.min[axis] = self.min[axis].smaller(value);
            self.max[axis] = self.max[axis].larger(value);
        }
        self
    }

    /// The smallest box that holds both.
    #[inline(always)]
    pub fn union(mut self, other: &Self) -> Self {
        for axis in 0..D {
            self.min[axis] = self.min[axis].smaller(other.min[axis]);
            self.max[axis] = self.max[axis].larger(other.max[axis]);
        }
        self
    }

    /// Whether the point lies in the box.
    #[inline(always)]
    pub fn contains(&self, point: &[T; D]) -> bool {
        (0..D).all(|axis| self.min[axis] <= point[axis] && point[axis] <= self.max[axis])
    }

    /// The axis of the longest side, the first one of equals.
    pub(super) fn longest_side(&self) -> usize {
        let length = |axis: usize| self.max[axis] - self.min[axis];
        (1..D).fold(0, |longest, axis| if length(axis) > length(longest) { axis } else { longest })
    }
}

/// A point and its index in the caller's order.
#[derive(Debug, Clone, Copy)]
pub(super) struct Item<T, const D: usize> {
    pub(super) position: [T; D],
    pub(super) id: u32,
}

/// Points of a node below which its subtree is ordered by one thread.
const SEQUENTIAL: usize = 8192;

/// Orders the points so that every node of the shape is split at the median of its longest side; ties by index, so the
/// order does not depend on threads.
pub(super) fn median_order<T: Scalar, const D: usize>(items: &mut [Item<T, D>], shape: &TreeShape) {
    if shape.n_points() > 0 {
        split(items, shape, 0, 0);
    }
}

fn split<T: Scalar, const D: usize>(items: &mut [Item<T, D>], shape: &TreeShape, level: u32, number: usize) {
    if level == shape.depth() {
        return;
    }
    let bounds = if items.len() > SEQUENTIAL {
        let chunks = items.par_chunks(SEQUENTIAL);
        chunks.map(bounds_of).reduce(|| BoxN::EMPTY, |a, b| a.union(&b))
    } else {
        bounds_of(items)
    };
    let axis = bounds.longest_side();
    let half = shape.start(level + 1, 2 * number + 1) - shape.start(level, number);
    if 0 < half && half < items.len() {
        items.select_nth_unstable_by(half, |a, b| {
            a.position[axis].compare(b.position[axis]).then_with(|| a.id.cmp(&b.id))
        });
    }
    let (left, right) = items.split_at_mut(half);
    let (level, numbers) = (level + 1, [2 * number, 2 * number + 1]);
    if left.len() > SEQUENTIAL {
        rayon::join(|| split(left, shape, level, numbers[0]), || split(right, shape, level, numbers[1]));
    } else {
        split(left, shape, level, numbers[0]);
        split(right, shape, level, numbers[1]);
    }
}

fn bounds_of<T: Scalar, const D: usize>(items: &[Item<T, D>]) -> BoxN<T, D> {
    items.iter().fold(BoxN::EMPTY, |bounds, item| bounds.grown_to(&item.position))
}

/// Nodes of a level that one thread makes.
const NODES_A_TASK: usize = 512;

/// The boxes of all nodes in breadth-first order: leaves by `of_leaf`, then level by level upwards.
pub(super) fn fit<T: Scalar, const D: usize>(
    shape: &TreeShape,
    boxes: &mut [BoxN<T, D>],
    of_leaf: impl Fn(std::ops::Range<usize>) -> BoxN<T, D> + Sync,
) {
    let first = shape.leaves().start;
    let leaves = boxes[first..].par_iter_mut().with_min_len(NODES_A_TASK).enumerate();
    leaves.for_each(|(i, made)| *made = of_leaf(shape.points(first + i)));
    for level in (0..shape.depth()).rev() {
        let (above, below) = boxes.split_at_mut(shape.level(level).end);
        let parents = &mut above[shape.level(level)];
        let pairs = parents.par_iter_mut().zip(below.par_chunks(2)).with_min_len(NODES_A_TASK);
        pairs.for_each(|(made, children)| *made = children[0].union(&children[1]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_node_is_split_at_the_median_of_its_longest_side() {
        let points: Vec<[f64; 3]> =
            (0..1000u32).map(|i| [f64::from(i * 7919 % 1009), f64::from(i * 31 % 64), f64::from(i * 17 % 5)]).collect();
        let mut items: Vec<_> = points.iter().zip(0..).map(|(&position, id)| Item { position, id }).collect();
        let shape = TreeShape::new(1000, 20);
        median_order(&mut items, &shape);
        for node in 0..shape.leaves().start {
            let [left, right] = [2 * node + 1, 2 * node + 2].map(|child| &items[shape.points(child)]);
            let axis = bounds_of(&items[shape.points(node)]).longest_side();
            let key = |item: &Item<f64, 3>| (item.position[axis], item.id);
            let largest = left.iter().map(key).max_by(|a, b| a.partial_cmp(b).unwrap()).unwrap();
            assert!(right.iter().map(key).all(|right| right > largest), "node {node}");
        }
        let mut ids: Vec<u32> = items.iter().map(|item| item.id).collect();
        ids.sort_unstable();
        assert!(ids.into_iter().eq(0..1000));
    }

    #[test]
    fn boxes_are_those_of_the_points_below() {
        // With buckets of one point some leaves are empty, left ones and right ones.
        for (n, bucket) in [(77, 4), (11, 1), (240, 1)] {
            let items: Vec<_> = (0..n).map(|id| Item { position: [id as f32, -(id as f32)], id }).collect();
            let shape = TreeShape::new(n, bucket);
            let mut boxes = vec![BoxN::EMPTY; shape.n_nodes()];
            fit(&shape, &mut boxes, |places| bounds_of(&items[places]));
            for (node, made) in boxes.iter().enumerate() {
                assert_eq!(*made, bounds_of(&items[shape.points(node)]), "{n} points, node {node}");
            }
        }
    }
}
