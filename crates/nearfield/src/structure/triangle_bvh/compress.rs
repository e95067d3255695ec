//! Nodes of 80 bytes for the GPU: eight boxes of 8 bits a side. Source: Ylitie2017 §3.2.

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::collapse::{WIDTH, WideChild, WideNode, WideTree};
use crate::geometry::{Aabb, PreparedTriangle, RaySpace};
use crate::structure::PreparedTriangles;

/// Most triangles of a leaf: a child has eight bits, five of which say where its triangles begin.
pub(super) const LEAF: u32 = 3;
/// Boxes are wider than on the CPU by this many longest sides of the bounds: 2⁻¹⁹ covers the rounding of the walk's
/// arithmetic, which is one fused step a plane and off by at most 7 · 2⁻²⁴ of them. Twin of `SLACK` in fit.wesl.
pub const SLACK: f64 = 1.0 / (1u32 << 19) as f64;
/// Bit of `slots` from which on children that are nodes stand.
const FIRST_NODE_BIT: u8 = 24;
/// Steps of a box along each axis.
const STEPS: f64 = 255.0;

/// A node on the GPU; `CompressedNode` in compressed_node.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct CompressedNode {
    /// Where the boxes are counted from.
    pub origin: [f32; 3],
    /// Exponents of the steps along x, y and z, as in an f32, a byte each from the lowest on; the last byte has a bit for
    /// each slot that holds a node.
    pub steps: u32,
    /// The first child that is a node; the others follow by slot.
    pub first_node: u32,
    /// The first triangle of the leaves.
    pub first_triangle: u32,
    /// What is in each slot: of a node, 1 in the three highest bits and 24 plus the slot in the others; of a leaf, a bit a
    /// triangle and the first one; 0 for nothing.
    pub slots: [u8; WIDTH],
    /// Smallest x of each slot in steps from the origin, and smallest y.
    pub low_xy: [[u8; WIDTH]; 2],
    /// Smallest z, largest x.
    pub low_z_high_x: [[u8; WIDTH]; 2],
    /// Largest y, largest z.
    pub high_yz: [[u8; WIDTH]; 2],
}

impl CompressedNode {
    fn step(&self, axis: usize) -> f32 {
        f32::from_bits((self.steps >> (8 * axis) & 255) << 23)
    }

    /// Smallest x, y, z, largest x, y, z of each slot.
    fn planes_mut(&mut self) -> [&mut [u8; WIDTH]; 6] {
        let ([a, b], [c, d], [e, f]) = (&mut self.low_xy, &mut self.low_z_high_x, &mut self.high_yz);
        [a, b, c, d, e, f]
    }

    /// The box of a slot as f32 arithmetic gives it.
    pub fn bounds(&self, slot: usize) -> Aabb {
        let ([a, b], [c, d], [e, f]) = (&self.low_xy, &self.low_z_high_x, &self.high_yz);
        let place = |axis: usize, row: &[u8; WIDTH]| self.origin[axis] + f32::from(row[slot]) * self.step(axis);
        let corner = |x, y, z| Vec3::new(place(0, x), place(1, y), place(2, z));
        Aabb::new(corner(a, b, c), corner(d, e, f))
    }

    /// The node in a slot, or the triangles; `None` for nothing.
    pub(super) fn content(&self, slot: usize) -> Option<Content> {
        let slots = self.slots[slot];
        let (first, bits) = (slots & 31, u32::from(slots >> 5));
        if bits == 0 {
            return None;
        }
        if first >= FIRST_NODE_BIT {
            let below = (self.steps >> 24) & ((1 << slot) - 1);
            return Some(Content::Node(self.first_node + below.count_ones()));
        }
        let first = self.first_triangle + u32::from(first);
        Some(Content::Triangles(first..first + bits.count_ones()))
    }
}

/// What a slot holds.
pub(super) enum Content {
    Node(u32),
    Triangles(std::ops::Range<u32>),
}

/// Nodes, the root first, and triangles in the order of the leaves.
pub(super) struct Compressed {
    pub(super) nodes: Vec<CompressedNode>,
    pub(super) triangles: Vec<PreparedTriangle>,
}

/// Compresses a wide tree over the triangles that `order` names; an empty node where there is none.
pub(super) fn compress(wide: Option<(Vec<u32>, WideTree)>, prepared: &PreparedTriangles) -> Compressed {
    let mut compressed = Compressed { nodes: vec![CompressedNode::zeroed()], triangles: vec![] };
    let Some((order, wide)) = wide else { return compressed };
    let slack = SLACK * f64::from(prepared.space().reach);
    let slots: Vec<[Option<usize>; WIDTH]> = wide.nodes.par_iter().with_min_len(1 << 8).map(in_slots).collect();
    // Places in the wide tree and in the result.
    let mut pending = vec![(0, 0)];
    while let Some((from, to)) = pending.pop() {
        let node = &wide.nodes[from];
        let mut made = boxes(node, slack);
        made.first_node = compressed.nodes.len() as u32;
        made.first_triangle = compressed.triangles.len() as u32;
        for (slot, child) in slots[from].iter().enumerate() {
            let Some(child) = child.map(|i| &node.children[i]) else { continue };
            set_bounds(&mut made, slot, child, slack);
            if child.n_triangles == 0 {
                made.steps |= 1 << (24 + slot);
                made.slots[slot] = 1 << 5 | (FIRST_NODE_BIT + slot as u8);
                pending.push((child.first as usize, compressed.nodes.len()));
                compressed.nodes.push(CompressedNode::zeroed());
            } else {
                let first = (compressed.triangles.len() as u32 - made.first_triangle) as u8;
                made.slots[slot] = ((1 << child.n_triangles) - 1) << 5 | first;
                let places = child.first..child.first + child.n_triangles;
                let triangle = |place: u32| prepared.as_slice()[order[place as usize] as usize];
                compressed.triangles.extend(places.map(triangle));
            }
        }
        compressed.nodes[to] = made;
    }
    compressed
}

fn wider(child: &WideChild, slack: f64) -> (DVec3, DVec3) {
    (child.bounds.min.as_dvec3() - slack, child.bounds.max.as_dvec3() + slack)
}

/// A node without children: where its boxes are counted from, and in which steps.
fn boxes(node: &WideNode, slack: f64) -> CompressedNode {
    let empty = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (low, high) = node.children().iter().fold(empty, |(low, high), child| {
        let (min, max) = wider(child, slack);
        (low.min(min), high.max(max))
    });
    let mut made = CompressedNode::zeroed();
    for axis in 0..3 {
        let nearest = low[axis] as f32;
        let origin = if f64::from(nearest) > low[axis] { nearest.next_down() } else { nearest };
        made.origin[axis] = origin;
        // The smallest power of two of which 255 reach the far side.
        let mut exponent = 1u32;
        let step = |exponent: u32| f64::from(f32::from_bits(exponent << 23));
        let span = (high[axis] - f64::from(origin)) / STEPS;
        if span > step(1) {
            exponent = ((span as f32).to_bits() >> 23).max(1);
            while step(exponent) < span {
                exponent += 1;
            }
        }
        made.steps |= exponent << (8 * axis);
    }
    made
}

fn set_bounds(made: &mut CompressedNode, slot: usize, child: &WideChild, slack: f64) {
    let (low, high) = wider(child, slack);
    for axis in 0..3 {
        let (origin, step) = (f64::from(made.origin[axis]), f64::from(made.step(axis)));
        let planes = made.planes_mut();
        planes[axis][slot] = ((low[axis] - origin) / step).floor() as u8;
        planes[axis + 3][slot] = ((high[axis] - origin) / step).ceil() as u8;
    }
}

/// Which child stands in which slot: walks go through the slots in an order that depends on the signs of the direction,
/// so that children of a corner of the node come first for rays from there. Greedy: the best pair first.
fn in_slots(node: &WideNode) -> [Option<usize>; WIDTH] {
    let mut slots = [None; WIDTH];
    let all = node.children().iter().fold(Aabb::EMPTY, |all, child| all.union(child.bounds));
    let mut pairs = [(0.0, 0, 0); WIDTH * WIDTH];
    for (i, child) in node.children().iter().enumerate() {
        let from_center = child.bounds.center() - all.center();
        for slot in 0..WIDTH {
            let sign = |bit: usize| if slot & bit == 0 { 1.0 } else { -1.0 };
            pairs[WIDTH * i + slot] = (from_center.dot(Vec3::new(sign(4), sign(2), sign(1))), i, slot);
        }
    }
    let pairs = &mut pairs[..WIDTH * node.n];
    pairs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut is_placed = [false; WIDTH];
    for &mut (_, i, slot) in pairs {
        if !is_placed[i] && slots[slot].is_none() {
            (slots[slot], is_placed[i]) = (Some(i), true);
        }
    }
    slots
}

impl Compressed {
    /// The first broken invariant of the module's page, in words; `None` for a sound tree.
    pub(super) fn broken_invariant(&self, prepared: &PreparedTriangles) -> Option<String> {
        let mut seen = vec![false; prepared.len()];
        let mut n_parents = vec![0; self.nodes.len()];
        for (place, node) in self.nodes.iter().enumerate() {
            for slot in 0..WIDTH {
                match node.content(slot) {
                    Some(Content::Node(below)) if below as usize > place => n_parents[below as usize] += 1,
                    Some(Content::Node(below)) => return Some(format!("3: node {below} is below node {place}")),
                    Some(Content::Triangles(places)) => {
                        for triangle in &self.triangles[places.start as usize..places.end as usize] {
                            if std::mem::replace(&mut seen[triangle.index as usize], true) {
                                return Some(format!("1: triangle {} stands twice", triangle.index));
                            }
                            if *triangle != prepared.as_slice()[triangle.index as usize] {
                                return Some(format!("1: triangle {} is not the one prepared", triangle.index));
                            }
                        }
                    }
                    None => {}
                }
            }
        }
        if n_parents[1..].iter().any(|&n| n != 1) {
            return Some("3: a node has no parent, or two".to_owned());
        }
        if let Some(lost) = prepared.as_slice().iter().zip(seen).find(|(triangle, seen)| triangle.has_area() && !seen) {
            return Some(format!("1: triangle {} is in no leaf", lost.0.index));
        }
        self.broken_boxes(prepared.space())
    }

    /// Decoded boxes hold the widened boxes of all triangles below.
    fn broken_boxes(&self, space: &RaySpace) -> Option<String> {
        let mut below = vec![Aabb::EMPTY; self.nodes.len()];
        for (place, node) in self.nodes.iter().enumerate().rev() {
            for slot in 0..WIDTH {
                let held = match node.content(slot) {
                    None => continue,
                    Some(Content::Node(child)) => below[child as usize],
                    Some(Content::Triangles(places)) => self.triangles[places.start as usize..places.end as usize]
                        .iter()
                        .fold(Aabb::EMPTY, |all, triangle| all.union(space.widened(&triangle.bounds()))),
                };
                if node.bounds(slot).union(held) != node.bounds(slot) {
                    return Some(format!("5: slot {slot} of node {place} does not hold what is below it"));
                }
                below[place] = below[place].union(held);
            }
        }
        None
    }
}
