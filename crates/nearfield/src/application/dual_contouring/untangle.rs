//! Moves vertices that make triangles flip or intersect into their cells, and only those.
//!
//! Planes of a few crossings may meet far outside a cell, and then triangles fold over each other. In rounds, each triangle
//! whose vertices have moved is looked at together with all triangles whose boxes touch its own; of each that is flipped, and
//! of each pair that meets elsewhere than in its common corners, vertices retreat a step: first those that stand outside
//! their cell, to its border on the way to the mean of their crossings; where none does, those that have retreated least, to
//! that mean, then to the mean of the middles of their edges, and last to a place near the middle of the cell. There the surface
//! is that of the signs alone, boxes around nodes with their sheets a little apart, which meets itself nowhere. Steps go one way,
//! so rounds end; a few suffice.

use rayon::prelude::*;

use super::surface::{Contour, position};
use crate::Result;
use crate::application::Watch;
use crate::geometry::Scalar;
use crate::geometry::mesh_intersections::pairs_among;
use crate::geometry::vector::{self, Vector};

/// Steps of a vertex, the last one near the middle of its cell.
const AT_BORDER: u8 = 1;
const AT_MEAN: u8 = 2;
const AT_MIDDLES: u8 = 3;
const LAST: u8 = 4;
/// How far a vertex may stand outside its cell: beyond, triangles that meet would be far apart in the grid.
const REACH: f64 = 1.0;
/// Part of the way from the middle of the cell to the mean of the middles of edges at the last step.
const LAST_PART: f64 = 0.25;
/// No more rounds than this: four steps for each of the vertices of a cluster that waits on its neighbours.
const MOST_ROUNDS: u32 = 64;

/// Triangles and pairs of triangles that are not as they should be.
struct Faults {
    flipped: Vec<u32>,
    pairs: Vec<[u32; 2]>,
}

pub(super) fn untangle<T: Scalar>(contour: &mut Contour<T>, watch: &mut Watch<'_>) -> Result<()> {
    let mut retreat = Retreat::new(contour);
    let mut quads = vec![true; retreat.contour.quads.len()];
    let mut settled = false;
    for round in 0..MOST_ROUNDS {
        watch.report("untangling", round.into(), MOST_ROUNDS.into())?;
        retreat.contour.report.rounds = round + 1;
        let faults = retreat.contour.faults(&quads);
        let moved = retreat.step(&faults);
        if moved.is_empty() {
            settled = faults.flipped.is_empty() && faults.pairs.is_empty() && !retreat.steps.contains(&LAST);
            break;
        }
        quads = retreat.contour.follow(&moved);
    }
    let steps = retreat.steps;
    let count = |from: u8, to: u8| steps.iter().filter(|step| (from..=to).contains(*step)).count() as u64;
    contour.report.clamped = count(AT_BORDER, AT_BORDER);
    contour.report.averaged = count(AT_MEAN, AT_MEAN);
    contour.report.rounded = count(AT_MIDDLES, LAST);
    if !settled {
        let faults = contour.faults(&vec![true; contour.quads.len()]);
        contour.report.intersections = faults.pairs.len() as u64;
        contour.report.flipped = faults.flipped.len() as u64;
    }
    Ok(())
}

impl<T: Scalar> Contour<T> {
    /// Faults of the triangles of the chosen quads.
    fn faults(&self, quads: &[bool]) -> Faults {
        let triangles = self.triangles();
        let chosen: Vec<bool> = (0..triangles.len()).map(|t| quads[t / 2]).collect();
        let is_flipped = |&t: &u32| {
            let corners = triangles[t as usize].map(|v| self.vertices[v as usize]);
            let normal =
                vector::cross(vector::subtract(corners[1], corners[0]), vector::subtract(corners[2], corners[0]));
            chosen[t as usize] && self.quads[t as usize / 2].is_flipped(&normal)
        };
        let flipped = (0..triangles.len() as u32).into_par_iter().filter(is_flipped).collect();
        let positions: Vec<[f64; 3]> = self.vertices.par_iter().map(|p| p.map(|x| x.to_f64())).collect();
        Faults { flipped, pairs: pairs_among(&positions, &triangles, Some(&chosen)) }
    }

    /// Cuts the quads of moved vertices anew; which they are.
    fn follow(&mut self, moved: &[u32]) -> Vec<bool> {
        let mut is_moved = vec![false; self.vertices.len()];
        moved.iter().for_each(|&v| is_moved[v as usize] = true);
        let chosen: Vec<bool> =
            self.quads.par_iter().map(|quad| quad.vertices.iter().any(|&v| is_moved[v as usize])).collect();
        let cut = |(quad, (&other, &chosen))| if chosen { self.choose(quad) } else { other };
        self.other = self.quads.par_iter().zip(self.other.par_iter().zip(&chosen)).map(cut).collect();
        chosen
    }
}

/// How far each vertex has retreated.
struct Retreat<'a, T> {
    contour: &'a mut Contour<T>,
    steps: Vec<u8>,
}

impl<'a, T: Scalar> Retreat<'a, T> {
    /// Vertices far outside their cells retreat at once.
    fn new(contour: &'a mut Contour<T>) -> Self {
        let (low, high) = (T::of(-REACH), T::of(1.0 + REACH));
        let is_far = |place: &Vector<T>| place.iter().any(|&x| !(x >= low && x <= high));
        let steps: Vec<u8> =
            contour.sheets.par_iter().map(|sheet| u8::from(is_far(&sheet.place)) * AT_BORDER).collect();
        let mut retreat = Self { contour, steps };
        let far: Vec<u32> = (0..retreat.steps.len() as u32).filter(|&v| retreat.steps[v as usize] > 0).collect();
        far.iter().for_each(|&v| retreat.place(v));
        retreat.contour.follow(&far);
        retreat
    }

    /// Lets vertices of faulty triangles retreat; which have moved.
    fn step(&mut self, faults: &Faults) -> Vec<u32> {
        let corners = |t: &u32| {
            let quad = &self.contour.quads[*t as usize / 2];
            quad.triangles(self.contour.other[*t as usize / 2])[*t as usize % 2]
        };
        let mut wanted = vec![];
        faults.flipped.iter().for_each(|t| self.retreating(&corners(t), &mut wanted));
        faults.pairs.iter().for_each(|[a, b]| self.retreating(&[corners(a), corners(b)].concat(), &mut wanted));
        wanted.sort_unstable();
        wanted.dedup();
        for &v in &wanted {
            let step = &mut self.steps[v as usize];
            let is_outside = |x: &T| !(*x >= T::ZERO && *x <= T::ONE);
            let outside = *step == 0 && self.contour.sheets[v as usize].place.iter().any(is_outside);
            *step = if *step == 0 && !outside { AT_MEAN } else { *step + 1 };
            self.place(v);
        }
        wanted
    }

    /// Adds those of the vertices of a fault that shall retreat.
    fn retreating(&self, vertices: &[u32], wanted: &mut Vec<u32>) {
        let step = |v: &u32| self.steps[*v as usize];
        let is_outside = |v: &u32| {
            let place = &self.contour.sheets[*v as usize].place;
            step(v) == 0 && place.iter().any(|&x| !(x >= T::ZERO && x <= T::ONE))
        };
        if vertices.iter().any(is_outside) {
            wanted.extend(vertices.iter().filter(|v| is_outside(v)));
            return;
        }
        let least = vertices.iter().map(step).min().unwrap_or(LAST);
        if least < LAST {
            wanted.extend(vertices.iter().filter(|v| step(v) == least));
        }
    }

    /// Puts a vertex where its step says.
    fn place(&mut self, v: u32) {
        let sheet = &self.contour.sheets[v as usize];
        let place = match self.steps[v as usize] {
            0 => sheet.place,
            AT_BORDER => towards_cell(sheet.mass, sheet.place),
            AT_MEAN => sheet.mass,
            AT_MIDDLES => sheet.middle,
            _ => sheet.middle.map(|x| T::of(0.5) + (x - T::of(0.5)) * T::of(LAST_PART)),
        };
        self.contour.vertices[v as usize] = position(&self.contour.grid, sheet.cell, place);
    }
}

/// The last point of the cell on the way from a point in it to another.
fn towards_cell<T: Scalar>(inside: Vector<T>, place: Vector<T>) -> Vector<T> {
    let mut part = T::ONE;
    for axis in 0..3 {
        let way = place[axis] - inside[axis];
        if place[axis] > T::ONE {
            part = part.smaller((T::ONE - inside[axis]) / way);
        } else if place[axis] < T::ZERO {
            part = part.smaller(-inside[axis] / way);
        }
    }
    let part = part.larger(T::ZERO);
    let on_way = [0, 1, 2].map(|axis| inside[axis] + (place[axis] - inside[axis]) * part);
    on_way.map(|x| x.larger(T::ZERO).smaller(T::ONE))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_ends_at_the_border_of_the_cell() {
        assert_eq!(towards_cell([0.5, 0.5, 0.5], [0.25, 0.75, 0.5]), [0.25, 0.75, 0.5]);
        assert_eq!(towards_cell([0.5, 0.5, 0.5], [1.5, 0.5, 0.0]), [1.0, 0.5, 0.25]);
        assert_eq!(towards_cell([0.0, 0.5, 0.5], [-3.0, 0.5, 0.75]), [0.0, 0.5, 0.5]);
        let far = towards_cell([0.25f32, 0.5, 0.5], [1e30, -1e30, 0.0]);
        assert!(far.iter().all(|x| (0.0..=1.0).contains(x)), "{far:?}");
    }
}
