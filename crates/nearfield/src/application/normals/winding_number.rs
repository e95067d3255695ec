//! Normals turned to the outside of the surface that all points bound, by its winding number.
//!
//! Around a closed surface the winding number is 0 just outside and 1 just inside (Jacobson2013); that of oriented samples is a
//! sum over dipoles (Barill2018), linear in the signs of the normals. So the signs are those for which it comes nearest, by least
//! squares over probes on both sides of points, the condition of Xu2023. Differs from Xu2023, who turn every normal freely by a
//! gradient descent: normals keep their directions, and signs are asked for patches, the points of a
//! node of the tree that are joined by edges along the surface; edges between patches count a little, too. The system is solved in real numbers and rounded; from there, and from the
//! signs of the spanning tree, single patches are turned as long as that helps, and the better one is taken. At last every point
//! whose probes contradict it is turned, until none is left.
//!
//! It is right where a spanning tree is not: on sheets as thin as two spacings and on surfaces that touch. Cost: twelve
//! numbers for each pair of at most 1500 patches, and in the last rounds some 2000 terms of the field for each of n points.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::Normals;
use super::estimate::in_caller_order;
use super::neighbor_graph::{Edge, sorted_edges_by};
use super::patches::Patches;
use super::spanning_tree::orient_by_spanning_tree;
use crate::Result;
use crate::application::Watch;
use crate::application::winding_number::disk_areas;
use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};
use crate::structure::AabbTreeN;

/// Cells that are aimed at, and points of one at least.
const CELLS: usize = 512;
const FEWEST: usize = 32;
/// Most patches whose side is asked for: the largest.
const ASKED: usize = 1500;
/// Points of a patch with probes.
const PROBED: usize = 6;
/// What an edge along the surface counts where its ends come to lie on different sides, beside the squares of the probes.
const EDGE: f64 = 0.01;
/// Edges that cost this, or this many times the median, lead along the surface.
const CHEAP: f32 = 0.1;
const TIMES_MEDIAN: f32 = 3.0;
/// Steps of the solver, which stop when the residual has fallen to this part.
const STEPS: usize = 100;
const SOLVED: f64 = 1e-6;
/// The rounded solution has to be better than the spanning tree by this factor.
const CLEARLY: f64 = 0.98;
/// The winding number has to grow by this part of the usual jump along a normal for it to be turned at the end: where surfaces touch it may not
/// change at all.
const CONTRADICTED: f64 = 0.3;
/// Probes are a spacing off the surface, or this many times as far as neighbours are off each other's planes.
const OFF_PLANES: f64 = 2.5;
/// Rounds over all points at the end.
const ROUNDS: usize = 10;
/// Points of a task.
const TASK: usize = 64;

/// What was done.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WindingOrientation {
    /// Groups of points whose side was asked for.
    pub patches: u64,
    /// Normals that were turned.
    pub flipped: u64,
    /// Root of the mean square of how far the winding number was from 0 outside and 1 inside at the probes of patches before
    /// the last rounds: some 0.1 for a closed surface, 0.5 for a flat sheet, which has no inside.
    pub deviation: f64,
}

/// Turns every normal to the outside of the surface that all points bound.
///
/// - `tree`: over the points of the normals
/// - `k`: neighbours that a point is joined with in the graph, itself not counted
///
/// Points without a normal are left out. Surfaces with wide openings are oriented as far as they enclose anything; a flat sheet keeps
/// the side that [`orient_by_spanning_tree`] gives.
///
/// # Errors
/// `LengthMismatch`, `Interrupted`: the normals may then be oriented as by the spanning tree.
pub fn orient_by_winding_number<T: Scalar>(
    tree: &AabbTreeN<T, 3>,
    normals: &mut Normals<T>,
    k: u32,
    watch: &mut Watch<'_>,
) -> Result<WindingOrientation> {
    normals.check_length(tree.len())?;
    let given = normals.vectors.clone();
    orient_by_spanning_tree(tree, normals, k, watch)?;
    let positions: Vec<Vector<f64>> = in_caller_order(tree).iter().map(|p| p.map(T::to_f64)).collect();
    let areas: Vec<f64> = disk_areas(tree).into_iter().map(T::to_f64).collect();
    let cost = |a: u32, b: u32| tangent_cost(&positions, normals, a, b);
    let edges: Vec<Edge> = sorted_edges_by(tree, normals, k, watch, &cost)?;
    let median = edges.get(edges.len() / 2).map_or(0.0, |edge| f32::from_bits(edge.cost));
    let most = CHEAP.max(TIMES_MEDIAN * median);
    let patches = Patches::grow(&positions, normals, &areas, (&edges, most), &cells(tree));
    let probes = Probes::of_points(&positions, &areas, normals, &edges);
    let asked = patches.largest(ASKED);
    let probed = patches.to_probe(&edges, &asked, PROBED);
    let mut system = System::of(&patches, &asked, &probed, normals, &probes, watch)?;
    system.couple(&patches, &asked, normals, edges.iter().filter(|edge| edge.cost <= most.to_bits()));
    drop(edges);
    let (of_asked, deviation) = system.signs();
    let mut of_patches = vec![1.0; patches.len()];
    asked.iter().zip(of_asked).for_each(|(&patch, sign)| of_patches[patch] = sign);
    let sign = |patch: &Option<u32>| patch.map_or(1.0, |patch| of_patches[patch as usize]);
    let mut signs: Vec<f64> = patches.patch_of.iter().map(sign).collect();
    turn_contradicted(&patches, normals, &probes, CONTRADICTED * system.jump, &mut signs, watch)?;
    for i in (0..normals.len()).filter(|&i| signs[i] < 0.0 && normals.has(i)).collect::<Vec<_>>() {
        normals.flip(i);
    }
    let pairs = normals.vectors.iter().zip(&given);
    let flipped = pairs.filter(|(now, before)| vector::dot(**now, **before) < T::ZERO).count() as u64;
    Ok(WindingOrientation { patches: patches.len() as u64, flipped, deviation })
}

/// 1 − |n·n′|, and the part of the way between the points that leaves their planes: across a thin sheet it is long.
fn tangent_cost<T: Scalar>(positions: &[Vector<f64>], normals: &Normals<T>, a: u32, b: u32) -> f64 {
    let [n, m] = [a, b].map(|i| normals.vectors[i as usize].map(T::to_f64));
    let way = vector::subtract(positions[b as usize], positions[a as usize]);
    let off = vector::dot(way, n).powi(2) + vector::dot(way, m).powi(2);
    let length2 = vector::norm2(way);
    1.0 - vector::dot(n, m).abs() + if length2 > 0.0 { off / length2 } else { 0.0 }
}

/// `[n]` the cell of each point: a node of the tree, all on one level.
fn cells<T: Scalar>(tree: &AabbTreeN<T, 3>) -> Vec<u32> {
    let ids = tree.ordered_points().ids();
    let (n, most) = (ids.len(), ids.len().div_ceil(CELLS).max(FEWEST));
    let n_cells = n.div_ceil(most).next_power_of_two();
    let mut cells = vec![0; n];
    for cell in 0..n_cells {
        // Nodes of a level share the points as evenly as whole numbers can.
        let places = cell * n / n_cells..(cell + 1) * n / n_cells;
        ids[places].iter().for_each(|&id| cells[id as usize] = cell as u32);
    }
    cells
}

/// Places off the surface on both sides of points.
struct Probes<'a> {
    positions: &'a [Vector<f64>],
    /// `[n]` how far off.
    distances: Vec<f64>,
}

impl<'a> Probes<'a> {
    /// A spacing off, and beyond the noise.
    fn of_points<T: Scalar>(positions: &'a [Vector<f64>], areas: &[f64], normals: &Normals<T>, edges: &[Edge]) -> Self {
        let off = |edge: &Edge| {
            let [a, b] = [edge.low as usize, edge.high as usize];
            let way = vector::subtract(positions[b], positions[a]);
            vector::dot(way, normals.vectors[a].map(T::to_f64)).abs() / areas[a].sqrt()
        };
        let mut all: Vec<f64> = edges.par_iter().map(off).filter(|off| off.is_finite()).collect();
        let middle = all.len() / 2;
        let median = if all.is_empty() { 0.0 } else { *all.select_nth_unstable_by(middle, f64::total_cmp).1 };
        let spacings = (OFF_PLANES * median).max(1.0);
        Self { positions, distances: areas.iter().map(|area| spacings * area.sqrt()).collect() }
    }

    /// Before and behind a point, as its normal is given.
    fn of<T: Scalar>(&self, normals: &Normals<T>, i: usize) -> [Vector<f64>; 2] {
        let (place, normal) = (self.positions[i], normals.vectors[i].map(T::to_f64));
        [1.0, -1.0].map(|side| vector::add_scaled(place, normal, side * self.distances[i]))
    }
}

/// What the signs of patches should do at the probes: rows · signs = ½.
struct System {
    /// Rows one after the other: the field of each patch at the probe, plus ½ before and minus ½ behind for the patch itself.
    rows: Vec<f32>,
    n_patches: usize,
    /// Pairs of patches and the square root of what it counts where they have different signs; negative where they should have.
    couplings: Vec<(usize, usize, f64)>,
    /// Median of the differences between the field before and behind points, before fields were scaled.
    jump: f64,
}

impl System {
    fn of<T: Scalar>(
        patches: &Patches,
        asked: &[usize],
        probed: &[(usize, u32)],
        normals: &Normals<T>,
        probes: &Probes<'_>,
        watch: &mut Watch<'_>,
    ) -> Result<Self> {
        watch.report("winding number", 0, asked.len() as u64)?;
        let fields = probed.par_iter().flat_map_iter(|&(_, point)| {
            let field = move |place| asked.iter().map(move |&patch| patches.field_of(patch, place) as f32);
            probes.of(normals, point as usize).into_iter().flat_map(field)
        });
        let mut system = Self { rows: fields.collect(), n_patches: asked.len(), jump: 1.0, couplings: Vec::new() };
        system.scale();
        for (rows, (own, _)) in system.rows.chunks_exact_mut(2 * asked.len().max(1)).zip(probed) {
            if let Ok(column) = asked.binary_search(own) {
                rows[column] += 0.5;
                rows[asked.len() + column] -= 0.5;
            }
        }
        Ok(system)
    }

    /// Divides all fields by the median jump between probes on both sides. It is 1 where samples stand for their true share of the
    /// surface and their neighbours are on their side, whatever the side; under noise shares are overestimated.
    fn scale(&mut self) {
        let fields = self.times(&vec![1.0; self.n_patches]);
        let mut jumps: Vec<f64> = fields.chunks_exact(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
        let middle = jumps.len() / 2;
        if !jumps.is_empty() {
            self.jump = *jumps.select_nth_unstable_by(middle, f64::total_cmp).1;
        }
        if self.jump > 0.0 {
            self.rows.iter_mut().for_each(|field| *field = (f64::from(*field) / self.jump) as f32);
        }
    }

    /// Couples patches with edges between them.
    fn couple<'a, T: Scalar>(
        &mut self,
        patches: &Patches,
        asked: &[usize],
        normals: &Normals<T>,
        edges: impl Iterator<Item = &'a Edge>,
    ) {
        let column = |point: u32| asked.binary_search(&(patches.patch_of[point as usize]? as usize)).ok();
        let mut sums = BTreeMap::new();
        for edge in edges {
            let (Some(a), Some(b)) = (column(edge.low), column(edge.high)) else { continue };
            if a != b {
                let [n, m] = [edge.low, edge.high].map(|i| normals.vectors[i as usize]);
                let side = if vector::dot(n, m) < T::ZERO { -EDGE } else { EDGE };
                *sums.entry((a.min(b), a.max(b))).or_insert(0.0) += side;
            }
        }
        let root = |((a, b), sum): ((usize, usize), f64)| (a, b, sum.abs().sqrt().copysign(sum));
        self.couplings = sums.into_iter().map(root).collect();
    }

    /// What a coupling is off by with these signs.
    fn off_by((a, b, root): (usize, usize, f64), x: &[f64]) -> f64 {
        root.abs() * (x[a] - root.signum() * x[b])
    }

    /// Number of rows that are fields.
    fn n_fields(&self) -> usize {
        self.rows.len() / self.n_patches.max(1)
    }

    /// rows · x.
    fn times(&self, x: &[f64]) -> Vec<f64> {
        let row = |row: &[f32]| row.iter().zip(x).map(|(a, x)| f64::from(*a) * x).sum();
        self.rows.par_chunks_exact(self.n_patches.max(1)).map(row).collect()
    }

    /// y · rows.
    fn transposed_times(&self, y: &[f64]) -> Vec<f64> {
        const COLUMNS: usize = 64;
        let n = self.n_patches;
        let starts: Vec<usize> = (0..n).step_by(COLUMNS).collect();
        let part = |&start: &usize| {
            let end = n.min(start + COLUMNS);
            let mut sums = vec![0.0; end - start];
            for (row, y) in self.rows.chunks_exact(n).zip(y) {
                sums.iter_mut().zip(&row[start..end]).for_each(|(sum, a)| *sum += f64::from(*a) * y);
            }
            sums
        };
        starts.par_iter().map(part).collect::<Vec<_>>().concat()
    }

    /// The signs and the root of the mean square of what is left.
    fn signs(&self) -> (Vec<f64>, f64) {
        if self.rows.is_empty() {
            return (vec![1.0; self.n_patches], 0.0);
        }
        let columns = self.columns();
        let rounded = self.solve().iter().map(|x| if *x < 0.0 { -1.0 } else { 1.0 }).collect();
        let (solved, its) = self.turn_single(rounded, &columns);
        let (kept, rest) = self.turn_single(vec![1.0; self.n_patches], &columns);
        let signs = if its < CLEARLY * rest { solved } else { kept };
        let deviation: f64 = self.times(&signs).iter().map(|w| (w - 0.5).powi(2)).sum();
        (signs, (deviation / self.n_fields() as f64).sqrt())
    }

    /// The least squares solution in real numbers, by conjugate gradients on the normal equations (GolubVanLoan2013, §11.3).
    fn solve(&self) -> Vec<f64> {
        let mut x = vec![0.0; self.n_patches];
        let mut left = vec![0.5; self.n_fields()];
        let mut apart = vec![0.0; self.couplings.len()];
        let mut slope = self.slope(&left, &apart);
        let mut direction = slope.clone();
        let norm2 = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>();
        let first = norm2(&slope);
        let mut now = first;
        for _ in 0..STEPS {
            let along = self.times(&direction);
            let between: Vec<f64> = self.couplings.iter().map(|&c| Self::off_by(c, &direction)).collect();
            let length2 = norm2(&along) + norm2(&between);
            if now <= SOLVED * SOLVED * first || length2 <= 0.0 {
                break;
            }
            let step = now / length2;
            x.iter_mut().zip(&direction).for_each(|(x, d)| *x += step * d);
            left.iter_mut().zip(&along).for_each(|(r, a)| *r -= step * a);
            apart.iter_mut().zip(&between).for_each(|(r, b)| *r -= step * b);
            slope = self.slope(&left, &apart);
            let next = norm2(&slope);
            direction.iter_mut().zip(&slope).for_each(|(d, s)| *d = s + next / now * *d);
            now = next;
        }
        x
    }

    /// The transposed rows times what is left of fields and of couplings.
    fn slope(&self, left: &[f64], apart: &[f64]) -> Vec<f64> {
        let mut slope = self.transposed_times(left);
        for (&(a, b, root), apart) in self.couplings.iter().zip(apart) {
            slope[a] += root.abs() * apart;
            slope[b] -= root * apart;
        }
        slope
    }

    fn columns(&self) -> Vec<Vec<f32>> {
        let column = |c: usize| self.rows.iter().skip(c).step_by(self.n_patches).copied().collect();
        (0..self.n_patches).into_par_iter().map(column).collect()
    }

    /// Turns single patches as long as that brings the sum of squares down; the signs and that sum.
    fn turn_single(&self, mut signs: Vec<f64>, columns: &[Vec<f32>]) -> (Vec<f64>, f64) {
        let mut off: Vec<f64> = self.times(&signs).iter().map(|w| w - 0.5).collect();
        let mut coupled = vec![Vec::new(); self.n_patches];
        for &(a, b, root) in &self.couplings {
            coupled[a].push((b, root * root.abs()));
            coupled[b].push((a, root * root.abs()));
        }
        let squares: Vec<f64> = columns.iter().map(|c| c.iter().map(|a| f64::from(*a).powi(2)).sum()).collect();
        for _ in 0..STEPS {
            let mut turned = false;
            for (patch, column) in columns.iter().enumerate() {
                let along: f64 = column.iter().zip(&off).map(|(a, off)| f64::from(*a) * off).sum();
                // |off − 2 s a|² − |off|² = 4 (|a|² − s a·off), and a coupling that was kept is then off by 2.
                let kept: f64 = coupled[patch].iter().map(|&(other, square)| square * signs[other]).sum();
                let gain = signs[patch] * (along - kept) - squares[patch];
                if gain > 1e-9 * squares[patch] {
                    off.iter_mut().zip(column).for_each(|(off, a)| *off -= 2.0 * signs[patch] * f64::from(*a));
                    signs[patch] = -signs[patch];
                    turned = true;
                }
            }
            if !turned {
                break;
            }
        }
        let apart: f64 = self.couplings.iter().map(|&c| Self::off_by(c, &signs).powi(2)).sum();
        let rest = off.iter().map(|off| off * off).sum::<f64>();
        (signs, rest + apart)
    }
}

/// Turns every point before which the winding number is clearly larger than behind it, until there is none.
fn turn_contradicted<T: Scalar>(
    patches: &Patches,
    normals: &Normals<T>,
    probes: &Probes<'_>,
    clearly: f64,
    signs: &mut [f64],
    watch: &mut Watch<'_>,
) -> Result<()> {
    for round in 0..ROUNDS {
        watch.report("contradictions", round as u64, ROUNDS as u64)?;
        let moments = patches.moments(signs);
        let now: &[f64] = signs;
        let contradicted = |i: &usize| {
            let [before, behind] = probes.of(normals, *i).map(|place| patches.field(now, &moments, place));
            now[*i] * (behind - before) < -clearly
        };
        let of_patches = |i: &usize| patches.patch_of[*i].is_some();
        let all = (0..now.len()).into_par_iter().with_min_len(TASK).filter(of_patches);
        let found: Vec<usize> = all.filter(contradicted).collect();
        found.iter().for_each(|&i| signs[i] = -signs[i]);
        if found.is_empty() {
            break;
        }
    }
    Ok(())
}
