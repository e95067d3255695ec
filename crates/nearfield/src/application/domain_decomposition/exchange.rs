//! The points that parts must send to each other before each can search within a radius on its own.

use glam::Vec3;
use rayon::prelude::*;

use super::surface::{MIXED, Owners};
use crate::Result;
use crate::geometry::distance::{dist2, norm2};
use crate::geometry::{Aabb, validate};
use crate::structure::LinearOctree;
use crate::structure::linear_octree::Step;

/// What parts exchange.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exchange {
    /// A part needs the points of others within this distance of one of its own; the ball is closed.
    pub radius: f32,
    /// Bytes of a point that is sent.
    pub bytes_per_point: u32,
}

impl Exchange {
    /// Points of 16 bytes: a position and a number.
    pub fn new(radius: f32) -> Self {
        Self { radius, bytes_per_point: 16 }
    }

    pub(super) fn validate(&self) -> Result<()> {
        validate::radius(self.radius, None)
    }
}

/// Points that each part sends and receives `[p]`; one that several parts need counts for each.
///
/// A point is tested against boxes by its distance to the nearest place inside. Subtraction, squares and sums round
/// monotonically, so that is never more than the distance to a point inside, in f32 and to the last bit: what a box
/// leaves out is exactly what no point inside can reach.
pub(super) fn count_sent(tree: &LinearOctree, owners: &Owners, parts: u32, radius: f32) -> (Vec<u64>, Vec<u64>) {
    let search = Search { tree, owners, boxes: boxes(tree), radius2: radius * radius };
    let pairs: Vec<(u32, u32, u64)> =
        owners.leaves.par_iter().with_min_len(16).flat_map_iter(|&leaf| search.sent_from(leaf)).collect();
    let (mut sent, mut received) = (vec![0; parts as usize], vec![0; parts as usize]);
    for (from, to, n) in pairs {
        sent[from as usize] += n;
        received[to as usize] += n;
    }
    (sent, received)
}

/// The smallest box around the points of each node.
fn boxes(tree: &LinearOctree) -> Vec<Aabb> {
    let nodes = tree.nodes();
    let mut boxes = vec![Aabb::EMPTY; nodes.len()];
    for (i, node) in nodes.iter().enumerate().rev() {
        boxes[i] = match node.is_leaf() {
            true => tree.ordered_points().bounds(node.points()),
            false => boxes[node.children()].iter().fold(Aabb::EMPTY, |all, &child| all.union(child)),
        };
    }
    boxes
}

struct Search<'a> {
    tree: &'a LinearOctree,
    owners: &'a Owners,
    boxes: Vec<Aabb>,
    radius2: f32,
}

impl Search<'_> {
    /// From part, to part, number of points of the leaf.
    fn sent_from(&self, leaf: u32) -> Vec<(u32, u32, u64)> {
        let near = self.parts_near(leaf);
        if near.is_empty() {
            return vec![];
        }
        let mut sent: Vec<(u32, u32, u64)> = vec![];
        for place in self.tree.nodes()[leaf as usize].points() {
            let (point, own) = (self.tree.ordered_points().position(place), self.owners.of_points[place]);
            for &other in near.iter().filter(|&&other| other != own && self.reaches(point, other)) {
                match sent.iter_mut().find(|(from, to, _)| (*from, *to) == (own, other)) {
                    Some((_, _, n)) => *n += 1,
                    None => sent.push((own, other, 1)),
                }
            }
        }
        sent
    }

    /// Parts that may have a point within the radius of the leaf's, in order; not the leaf's own, if it has one alone.
    fn parts_near(&self, leaf: u32) -> Vec<u32> {
        let (own, around) = (self.owners.of_nodes[leaf as usize], self.boxes[leaf as usize]);
        let mut near: Vec<u32> = vec![];
        self.tree.walk(|number, node| {
            let part = self.owners.of_nodes[number as usize];
            // A part is contiguous along the walk: once met, the rest of it adds nothing.
            let known = part != MIXED && (part == own || near.last() == Some(&part));
            if known || box_gap2(&around, &self.boxes[number as usize]) > self.radius2 {
                return Step::Over;
            }
            if node.is_leaf() {
                match part {
                    MIXED => near.extend(&self.owners.of_points[node.points()]),
                    part => near.push(part),
                }
            }
            Step::Into
        });
        near.sort_unstable();
        near.dedup();
        near
    }

    /// Whether a point of the part lies within the radius.
    fn reaches(&self, point: Vec3, part: u32) -> bool {
        let (points, owners) = (self.tree.ordered_points(), &self.owners.of_points);
        let mut found = false;
        self.tree.walk(|number, node| {
            let owner = self.owners.of_nodes[number as usize];
            if (owner != part && owner != MIXED) || self.boxes[number as usize].dist2_to(point) > self.radius2 {
                return Step::Over;
            }
            let hit = |i: usize| owners[i] == part && dist2(point, points.position(i)) <= self.radius2;
            found = node.is_leaf() && node.points().any(hit);
            if found { Step::Stop } else { Step::Into }
        });
        found
    }
}

/// Squared distance between two boxes: at most that of any two points in them, in f32 as well.
fn box_gap2(a: &Aabb, b: &Aabb) -> f32 {
    norm2((b.min - a.max).max(a.min - b.max).max(Vec3::ZERO))
}
