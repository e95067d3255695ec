//! Points grouped into patches of one side, and the field of their dipoles.

use std::ops::Range;

use super::Normals;
use super::neighbor_graph::{Edge, Sets};
use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};

/// Radii of a group beyond which it counts as one dipole.
const FAR: f64 = 3.0;

/// Patches and their dipoles: the samples of an oriented surface, whose field is its winding number (Barill2018).
#[derive(Debug)]
pub(super) struct Patches {
    /// `[n]` the patch of each point; none for points without a normal.
    pub(super) patch_of: Vec<Option<u32>>,
    patches: Vec<Group>,
    /// The patches of each cell together.
    cells: Vec<Group>,
    /// By cell, then by patch.
    samples: Vec<Sample>,
}

/// A point as a dipole.
#[derive(Debug, Clone, Copy)]
struct Sample {
    point: u32,
    place: Vector<f64>,
    /// The normal times the share of the surface over 4π.
    moment: Vector<f64>,
    /// Squared radius of the disk of that share, over which the dipole is spread.
    disk2: f64,
}

/// Consecutive samples.
#[derive(Debug, Clone)]
struct Group {
    samples: Range<usize>,
    center: Vector<f64>,
    /// Squared distance from the centre from which on they are one dipole.
    far2: f64,
    moment: Vector<f64>,
}

impl Patches {
    /// Joins points of one cell along edges that cost at most `most` and whose normals are on one side.
    ///
    /// - `positions`, `areas`: `[n]`
    /// - `cells`: `[n]` the cell of each point
    pub(super) fn grow<T: Scalar>(
        positions: &[Vector<f64>],
        normals: &Normals<T>,
        areas: &[f64],
        (edges, most): (&[Edge], f32),
        cells: &[u32],
    ) -> Self {
        let n = positions.len();
        let mut sets = Sets::new(n);
        for edge in edges.iter().filter(|edge| edge.cost <= most.to_bits()) {
            let [a, b] = [edge.low as usize, edge.high as usize];
            if cells[a] == cells[b] && vector::dot(normals.vectors[a], normals.vectors[b]) > T::ZERO {
                sets.unite(edge.low, edge.high);
            }
        }
        let mut order: Vec<(u32, u32, u32)> =
            (0..n as u32).filter(|&i| normals.has(i as usize)).map(|i| (cells[i as usize], sets.find(i), i)).collect();
        order.sort_unstable();
        let sample = |&(_, _, point): &(u32, u32, u32)| {
            let i = point as usize;
            let normal = normals.vectors[i].map(T::to_f64);
            let moment = vector::scale(normal, areas[i] / (4.0 * std::f64::consts::PI));
            Sample { point, place: positions[i], moment, disk2: areas[i] / std::f64::consts::PI }
        };
        let samples: Vec<Sample> = order.iter().map(sample).collect();
        let patches = groups(&samples, order.chunk_by(|a, b| a.1 == b.1).map(<[_]>::len));
        let cells = groups(&samples, order.chunk_by(|a, b| a.0 == b.0).map(<[_]>::len));
        let mut patch_of = vec![None; n];
        for (patch, group) in (0..).zip(&patches) {
            samples[group.samples.clone()].iter().for_each(|s| patch_of[s.point as usize] = Some(patch));
        }
        Self { patch_of, patches, cells, samples }
    }

    /// Number of patches.
    pub(super) fn len(&self) -> usize {
        self.patches.len()
    }

    /// The patches with the most points, at most so many, ascending.
    pub(super) fn largest(&self, most: usize) -> Vec<usize> {
        let mut all: Vec<usize> = (0..self.len()).collect();
        all.sort_by_key(|&patch| std::cmp::Reverse(self.patches[patch].samples.len()));
        all.truncate(most);
        all.sort_unstable();
        all
    }

    /// Patch and point of probes, at most so many a patch: those with an edge to another patch first, as what is wrong
    /// with a patch shows at its border.
    pub(super) fn to_probe(&self, edges: &[Edge], patches: &[usize], most: usize) -> Vec<(usize, u32)> {
        let mut at_border = vec![false; self.patch_of.len()];
        for edge in edges {
            let ends = [edge.low as usize, edge.high as usize];
            if self.patch_of[ends[0]] != self.patch_of[ends[1]] {
                ends.into_iter().for_each(|end| at_border[end] = true);
            }
        }
        let mut probed = Vec::new();
        for &patch in patches {
            let samples = &self.patches[patch].samples;
            let all = || self.samples[samples.clone()].iter().map(|sample| sample.point);
            let border: Vec<u32> = all().filter(|&i| at_border[i as usize]).collect();
            let from: Vec<u32> = if border.is_empty() { all().collect() } else { border };
            let step = from.len().div_ceil(most).max(1);
            probed.extend(from.into_iter().step_by(step).map(|i| (patch, i)));
        }
        probed
    }

    /// The winding number that one patch gives at a place.
    pub(super) fn field_of(&self, patch: usize, place: Vector<f64>) -> f64 {
        let group = &self.patches[patch];
        self.field_of_group(group, group.moment, |_| 1.0, place)
    }

    /// The winding number at a place with these signs of the normals as they were given.
    ///
    /// - `signs`: `[n]` by point
    /// - `moments`: those of the cells with these signs
    pub(super) fn field(&self, signs: &[f64], moments: &[Vector<f64>], place: Vector<f64>) -> f64 {
        let cells = self.cells.iter().zip(moments);
        cells.map(|(cell, moment)| self.field_of_group(cell, *moment, |i| signs[i as usize], place)).sum()
    }

    /// The sums of the dipoles of each cell with these signs.
    pub(super) fn moments(&self, signs: &[f64]) -> Vec<Vector<f64>> {
        let moment = |cell: &Group| {
            let samples = self.samples[cell.samples.clone()].iter();
            samples.fold([0.0; 3], |sum, s| vector::add_scaled(sum, s.moment, signs[s.point as usize]))
        };
        self.cells.iter().map(moment).collect()
    }

    #[inline(always)]
    fn field_of_group(&self, group: &Group, moment: Vector<f64>, sign: impl Fn(u32) -> f64, place: Vector<f64>) -> f64 {
        let offset = vector::subtract(group.center, place);
        if vector::norm2(offset) > group.far2 {
            return dipole(offset, moment, 0.0);
        }
        let each = self.samples[group.samples.clone()].iter();
        each.map(|s| sign(s.point) * dipole(vector::subtract(s.place, place), s.moment, s.disk2)).sum()
    }
}

/// Groups of so many samples one after the other.
fn groups(samples: &[Sample], lengths: impl Iterator<Item = usize>) -> Vec<Group> {
    let mut first = 0;
    let group = |length: usize| {
        let range = first..first + length;
        first = range.end;
        let own = &samples[range.clone()];
        let sum = own.iter().fold([0.0; 3], |sum, s| vector::add(sum, s.place));
        let center = vector::scale(sum, 1.0 / own.len() as f64);
        let reach2 = own.iter().map(|s| vector::norm2(vector::subtract(s.place, center))).fold(0.0, f64::max);
        let moment = own.iter().fold([0.0; 3], |sum, s| vector::add(sum, s.moment));
        Group { samples: range, center, far2: FAR * FAR * reach2, moment }
    };
    lengths.map(group).collect()
}

/// The part of the full solid angle that an area vector over 4π fills, seen from `offset` before it; less near it, as where it
/// is spread over a disk.
fn dipole(offset: Vector<f64>, moment: Vector<f64>, disk2: f64) -> f64 {
    let dist2 = vector::norm2(offset) + disk2;
    if dist2 > 0.0 { vector::dot(offset, moment) / (dist2 * dist2.sqrt()) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball's surface in equal parts along a spiral, with an edge from each point to the next.
    fn ball() -> (Vec<Vector<f64>>, Vec<Edge>) {
        let mut angle = 0.0f64;
        let mut point = |i: u32| {
            let z = 1.0 - (f64::from(i) + 0.5) / 1000.0;
            let r = (1.0 - z * z).sqrt();
            // As far along the spiral as its turns are apart.
            angle += (4.0 * std::f64::consts::PI / 2000.0).sqrt() / r;
            [r * angle.cos(), r * angle.sin(), z]
        };
        let edge = |i: u32| Edge { cost: 0.5f32.to_bits(), low: i, high: i + 1 };
        ((0..2000).map(&mut point).collect(), (0..1999).map(edge).collect())
    }

    #[test]
    fn the_field_of_a_closed_surface_is_one_inside() {
        let (points, edges) = ball();
        let normals = Normals::of_vectors(&points);
        let areas = vec![4.0 * std::f64::consts::PI / 2000.0; 2000];
        let cells: Vec<u32> = (0..2000).map(|i| i / 100).collect();
        let patches = Patches::grow(&points, &normals, &areas, (&edges, 1.0), &cells);
        assert_eq!((patches.len(), patches.largest(3)), (20, vec![0, 1, 2]));
        let probed = patches.to_probe(&edges, &patches.largest(99), 9);
        assert!(probed.iter().all(|(patch, i)| i / 100 == *patch as u32 && matches!(i % 100, 0 | 99)), "{probed:?}");
        assert_eq!(probed.len(), 38);
        let (signs, turned) = (vec![1.0; 2000], vec![-1.0; 2000]);
        for (place, expected) in
            [([0.1, 0.2, -0.3], 1.0), ([0.8, 0.0, 0.0], 1.0), ([0.0, 1.3, 0.0], 0.0), ([5.0; 3], 0.0)]
        {
            let found = patches.field(&signs, &patches.moments(&signs), place);
            let by_patch: f64 = (0..patches.len()).map(|c| patches.field_of(c, place)).sum();
            assert!((found - expected).abs() < 0.02, "{place:?}: {found}");
            assert!((found - by_patch).abs() < 1e-9, "{place:?}: {found}, {by_patch}");
            let inverted = patches.field(&turned, &patches.moments(&turned), place);
            assert!((found + inverted).abs() < 1e-9, "{place:?}: {found}, {inverted}");
        }
    }

    #[test]
    fn points_without_a_normal_are_in_no_patch() {
        let (points, edges) = ball();
        let mut normals = Normals::of_vectors(&points[..5]);
        normals.vectors[2] = [0.0; 3];
        // The edges to it are not in a graph; here they stand for nothing.
        let edges = [edges[0], edges[3]];
        let patches = Patches::grow(&points[..5], &normals, &[1.0; 5], (&edges, 1.0), &[0; 5]);
        assert_eq!(patches.patch_of, [Some(0), Some(0), None, Some(1), Some(1)]);
        assert_eq!(patches.to_probe(&edges, &[0, 1], 1), [(0, 0), (1, 3)]);
    }
}
