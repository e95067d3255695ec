//! Subtrees of few triangles: each node is split at the best place between any two of them.
//!
//! Primitives are sorted once along each axis; a split keeps the three orders, as events of a sweep are kept.

use glam::Vec3A;

use super::MOST_SPLIT_LEVELS;
use super::build::{BinaryNode, Builder, CenterBounds, PARALLEL, Primitive, Subtree, split_nodes};

/// Subtrees of at most this many triangles need no memory but the stack's, and are sorted by counting who comes before whom.
const SMALL: usize = 16;

/// Builds the subtree over at least two primitives, which are brought into the order of its leaves.
pub(super) fn sweep(
    builder: &Builder<'_>,
    primitives: &mut [Primitive],
    nodes: &mut [BinaryNode],
    level: u32,
) -> Subtree {
    let n = primitives.len();
    let low = CenterBounds::of(primitives).low;
    if n <= SMALL {
        let mut boxes = [primitives[0]; SMALL];
        boxes[..n].copy_from_slice(primitives);
        let (mut orders, mut spare, mut costs) = ([[0; SMALL]; 3], [0; SMALL], [0.0; SMALL]);
        let ranks = sort_small(&boxes, n, low, &mut orders);
        let orders = orders.each_mut().map(|order| &mut order[..n]);
        let memory = Memory { orders, spare: &mut spare[..n], costs: &mut costs[..n] };
        let ranks = ranks.each_ref().map(|ranks| &ranks[..]);
        return Sweep { builder, boxes: &boxes, ranks }.build(memory, primitives, nodes, level);
    }
    let boxes = primitives.to_vec();
    let mut orders: [Vec<u32>; 3] = std::array::from_fn(|axis| sorted(&boxes, low, axis));
    let ranks = orders.each_ref().map(|order| inverse(order));
    let (mut spare, mut costs) = (vec![0; n], vec![0.0; n]);
    let orders = orders.each_mut().map(Vec::as_mut_slice);
    let memory = Memory { orders, spare: &mut spare, costs: &mut costs };
    let ranks = ranks.each_ref().map(Vec::as_slice);
    Sweep { builder, boxes: &boxes, ranks }.build(memory, primitives, nodes, level)
}

/// Finds the order along each axis, by centre as far as 20 bits of it tell, then by place; how many come before each primitive.
fn sort_small(boxes: &[Primitive; SMALL], n: usize, low: Vec3A, orders: &mut [[u32; SMALL]; 3]) -> [[u32; SMALL]; 3] {
    // Bits of numbers that are not negative are in the order of the numbers. All keys differ.
    let mut keys = [[i32::MAX; SMALL]; 3];
    for (place, primitive) in boxes.iter().enumerate().take(n) {
        let from_low = (primitive.center() - low).to_array();
        for axis in 0..3 {
            keys[axis][place] = (from_low[axis].to_bits() as i32 & !(SMALL as i32 - 1)) | place as i32;
        }
    }
    let mut ranks = [[0; SMALL]; 3];
    for ((keys, order), ranks) in keys.iter().zip(orders).zip(&mut ranks) {
        for key in &keys[..n] {
            for (rank, other) in ranks.iter_mut().zip(keys) {
                *rank += u32::from(key < other);
            }
        }
        for (place, &rank) in ranks.iter().enumerate().take(n) {
            order[rank as usize % SMALL] = place as u32;
        }
    }
    ranks
}

/// The order along an axis, by centre, then by place.
fn sorted(boxes: &[Primitive], low: Vec3A, axis: usize) -> Vec<u32> {
    let key = |(place, p): (usize, &Primitive)| u64::from((p.center() - low)[axis].to_bits()) << 32 | place as u64;
    let mut keys: Vec<u64> = boxes.iter().enumerate().map(key).collect();
    keys.sort_unstable();
    keys.into_iter().map(|key| key as u32).collect()
}

fn inverse(order: &[u32]) -> Vec<u32> {
    let mut ranks = vec![0; order.len()];
    for (rank, &place) in order.iter().enumerate() {
        ranks[place as usize] = rank as u32;
    }
    ranks
}

/// What a subtree needs, `[triangles]` each.
struct Memory<'a> {
    /// Places of its primitives in order along each axis.
    orders: [&'a mut [u32]; 3],
    spare: &'a mut [u32],
    costs: &'a mut [f32],
}

impl<'a> Memory<'a> {
    fn split_at(self, n_left: usize) -> (Self, Self) {
        let [x, y, z] = self.orders.map(|order| order.split_at_mut(n_left));
        let ((spare, spare_right), (costs, costs_right)) =
            (self.spare.split_at_mut(n_left), self.costs.split_at_mut(n_left));
        let left = Self { orders: [x.0, y.0, z.0], spare, costs };
        (left, Self { orders: [x.1, y.1, z.1], spare: spare_right, costs: costs_right })
    }
}

/// A subtree's primitives as they were.
struct Sweep<'a> {
    builder: &'a Builder<'a>,
    boxes: &'a [Primitive],
    /// Along each axis: how many come before each of them.
    ranks: [&'a [u32]; 3],
}

impl Sweep<'_> {
    fn build(&self, mut memory: Memory<'_>, out: &mut [Primitive], nodes: &mut [BinaryNode], level: u32) -> Subtree {
        let n = out.len();
        if n == 1 {
            out[0] = *self.at(memory.orders[0][0]);
            return self.builder.single(&out[0]);
        }
        if n == 2 {
            out.iter_mut().zip(memory.orders[0].iter()).for_each(|(out, &place)| *out = *self.at(place));
            let (left, right) = (self.builder.single(&out[0]), self.builder.single(&out[1]));
            let (subtree, joined) = self.builder.joined(&left, &right, 1, 2);
            nodes[0] = joined;
            return subtree;
        }
        let (axis, n_left) =
            if level < MOST_SPLIT_LEVELS { self.best_place(&mut memory) } else { (self.longest_axis(&memory), n / 2) };
        self.divide(&mut memory, axis, n_left);
        let (left, right) = memory.split_at(n_left);
        let (out_left, out_right) = out.split_at_mut(n_left);
        let (node, left_nodes, right_nodes) = split_nodes(nodes, n_left);
        let build_left = || self.build(left, out_left, left_nodes, level + 1);
        let build_right = || self.build(right, out_right, right_nodes, level + 1);
        let (left, right) =
            if n > PARALLEL { rayon::join(build_left, build_right) } else { (build_left(), build_right()) };
        let (subtree, joined) = self.builder.joined(&left, &right, n_left, n);
        *node = joined;
        subtree
    }

    #[inline(always)]
    fn at(&self, place: u32) -> &Primitive {
        &self.boxes[place as usize]
    }

    /// The axis and the number of primitives on the left that cost least.
    fn best_place(&self, memory: &mut Memory<'_>) -> (usize, usize) {
        let mut best = (f32::INFINITY, 0, 1);
        let right_costs = &mut *memory.costs;
        for (axis, order) in memory.orders.iter().enumerate() {
            let order = &order[..right_costs.len()];
            let (mut min, mut max) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
            let mut n_right = 0.0;
            for (&place, cost) in order.iter().zip(&mut *right_costs).skip(1).rev() {
                (min, max) = (min.min(self.at(place).min()), max.max(self.at(place).max()));
                n_right += 1.0;
                *cost = self.builder.half_area(max - min) * n_right;
            }
            (min, max) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
            for (n_left, (&place, right_cost)) in order.iter().zip(&right_costs[1..]).enumerate() {
                (min, max) = (min.min(self.at(place).min()), max.max(self.at(place).max()));
                let cost = self.builder.half_area(max - min) * (n_left + 1) as f32 + right_cost;
                if cost < best.0 {
                    best = (cost, axis, n_left + 1);
                }
            }
        }
        (best.1, best.2)
    }

    /// The axis along which the centres spread most.
    fn longest_axis(&self, memory: &Memory<'_>) -> usize {
        let spread = |axis: usize| {
            let order = &memory.orders[axis];
            self.at(order[order.len() - 1]).center()[axis] - self.at(order[0]).center()[axis]
        };
        (1..3).fold(0, |longest, axis| if spread(axis) > spread(longest) { axis } else { longest })
    }

    /// Brings those that come first along the axis to the front of the other two orders as well, which are kept on both sides.
    fn divide(&self, memory: &mut Memory<'_>, axis: usize, n_left: usize) {
        let n = memory.spare.len();
        let ranks = self.ranks[axis];
        let first_right = ranks[memory.orders[axis][n_left] as usize];
        for other in [(axis + 1) % 3, (axis + 2) % 3] {
            let order = &mut memory.orders[other][..n];
            let mut n_found = 0;
            for i in 0..n {
                let place = order[i];
                // Both places are behind what has been read.
                (order[n_found], memory.spare[i - n_found]) = (place, place);
                n_found += usize::from(ranks[place as usize] < first_right);
            }
            order[n_left..].copy_from_slice(&memory.spare[..n - n_left]);
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::geometry::Aabb;
    use crate::structure::triangle_bvh::collapse::LeafCost;
    use crate::structure::triangle_bvh::{BvhSettings, build::boxes};

    /// The least of surface times triangles on both sides over all places along all axes, by sorting anew.
    fn least(boxes: &[Primitive]) -> f32 {
        let area = |part: &[Primitive]| {
            let all = part.iter().fold(Aabb::EMPTY, |all, p| all.union(p.bounds())).extent();
            (all.x * all.y + all.y * all.z + all.z * all.x) * part.len() as f32
        };
        let mut least = f32::INFINITY;
        for axis in 0..3 {
            let mut sorted = boxes.to_vec();
            sorted.sort_by(|a, b| a.center()[axis].total_cmp(&b.center()[axis]));
            for n_left in 1..boxes.len() {
                least = least.min(area(&sorted[..n_left]) + area(&sorted[n_left..]));
            }
        }
        least
    }

    #[test]
    fn every_node_is_split_at_the_best_place() {
        let settings = BvhSettings::DEFAULT;
        let cost = LeafCost { most: 8, entry: 1.0, triangle: 0.0 };
        let builder = Builder { settings: &settings, cost: &cost, unit: 1.0 };
        for n in (2..=SMALL + 4).chain([200]) {
            let mut primitives = boxes(n, n as u32);
            let before: Vec<u32> = primitives.iter().map(Primitive::index).collect();
            let mut nodes = bytemuck::zeroed_vec::<BinaryNode>(n - 1);
            sweep(&builder, &mut primitives, &mut nodes, 0);
            let mut after: Vec<u32> = primitives.iter().map(Primitive::index).collect();
            after.sort_unstable();
            assert_eq!(before, after, "{n}");
            // From the root on, nodes with their primitives.
            let mut pending = vec![(0, 0..n)];
            while let Some((node, range)) = pending.pop() {
                let n_left = nodes[node].n_left as usize;
                let (left, right) = (range.start..range.start + n_left, range.start + n_left..range.end);
                let surface = |range: &std::ops::Range<usize>| {
                    let all = primitives[range.clone()].iter().fold(Aabb::EMPTY, |all, p| all.union(p.bounds()));
                    builder.half_area(all.extent().into()) * range.len() as f32
                };
                let (found, expected) = (surface(&left) + surface(&right), least(&primitives[range.clone()]));
                assert!((found - expected).abs() <= 1e-4 * expected, "{n}, {range:?}: {found}, {expected}");
                let all = primitives[range].iter().fold(Aabb::EMPTY, |all, p| all.union(p.bounds()));
                assert_eq!(nodes[node].bounds, all, "{n}");
                pending.extend([(node + 1, left), (node + n_left, right)].into_iter().filter(|(_, r)| r.len() > 1));
            }
        }
    }

    #[test]
    fn few_are_sorted_as_many_are() {
        let primitives = boxes(SMALL, 3);
        let low = CenterBounds::of(&primitives).low;
        for n in 2..=SMALL {
            let (mut orders, few) = ([[0; SMALL]; 3], std::array::from_fn(|i| primitives[i]));
            let ranks = sort_small(&few, n, low, &mut orders);
            for axis in 0..3 {
                let order = sorted(&primitives[..n], low, axis);
                assert_eq!(orders[axis][..n], order, "{n}, axis {axis}");
                assert_eq!(ranks[axis][..n], inverse(&order), "{n}, axis {axis}");
            }
        }
        // Equal centres stay in the order in which they were.
        let equal = [Primitive::new(&Aabb::new(Vec3::ZERO, Vec3::ONE), 0); SMALL];
        let mut orders = [[0; SMALL]; 3];
        sort_small(&equal, SMALL, CenterBounds::of(&equal).low, &mut orders);
        assert!(orders.iter().all(|order| order.iter().copied().eq(0..SMALL as u32)));
    }
}
