//! Moves vertices that make triangles flip or intersect into their cells, and only those.
//!
//! Planes of a few crossings may meet far outside a cell, and then triangles fold over each other. In rounds, each triangle
//! whose vertices have moved is looked at together with all triangles whose boxes touch its own; of each that is flipped, and
//! of each pair that meets elsewhere than in its common corners, vertices retreat a step: first those that stand outside
//! their cell, to its border on the way to the mean of their crossings; where none does, those that have retreated least, to
//! that mean, then to the mean of the middles of their edges, and last to a place near the middle of the cell. There the surface
//! is that of the signs alone, boxes around nodes with their sheets a little apart, which meets itself nowhere. Steps go one way,
//! so rounds end; a few suffice.
//!
//! Cost: the first round looks at all quads, each beside those whose nodes are within one width or two (`quad_rows.rs`); further
//! rounds only at what has moved, so that they cost next to nothing. All threads work on all of it, and order decides nothing.

use rayon::prelude::*;

use super::quad_rows::{IN_CELLS, QuadRows};
use super::quads::normal_of;
use super::surface::{Contour, position};
use crate::Result;
use crate::application::Watch;
use crate::geometry::Scalar;
use crate::geometry::corner_bounds::{Bounds, bounds_of, overlap};
use crate::geometry::mesh_intersections::meet_beyond_shared;
use crate::geometry::triangles_apart::{Plane, surely_parted};
use crate::geometry::vector::Vector;

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

/// Quads that one thread looks at together at least.
const TOGETHER: usize = 64;

/// Triangles and pairs of triangles that are not as they should be, in any order.
#[derive(Default)]
struct Faults {
    flipped: Vec<u32>,
    pairs: Vec<[u32; 2]>,
}

pub(super) fn untangle<T: Scalar>(contour: &mut Contour<T>, watch: &mut Watch<'_>) -> Result<()> {
    let rows = QuadRows::of(contour);
    let mut retreat = Retreat::new(contour, &rows);
    let mut looked_at = LookedAt::all(retreat.contour, &rows);
    let mut settled = false;
    for round in 0..MOST_ROUNDS {
        watch.report("untangling", round.into(), MOST_ROUNDS.into())?;
        retreat.contour.report.rounds = round + 1;
        let faults = looked_at.faults(retreat.contour, &rows);
        let moved = retreat.step(&faults);
        if moved.is_empty() {
            settled = faults.flipped.is_empty() && faults.pairs.is_empty() && !retreat.steps.contains(&LAST);
            break;
        }
        let quads = retreat.contour.follow(&moved, &rows);
        looked_at.move_to(retreat.contour, &rows, quads);
    }
    let steps = retreat.steps;
    let count = |from: u8, to: u8| steps.iter().filter(|step| (from..=to).contains(*step)).count() as u64;
    contour.report.clamped = count(AT_BORDER, AT_BORDER);
    contour.report.averaged = count(AT_MEAN, AT_MEAN);
    contour.report.rounded = count(AT_MIDDLES, LAST);
    if !settled {
        let faults = LookedAt::all(contour, &rows).faults(contour, &rows);
        contour.report.intersections = faults.pairs.len() as u64;
        contour.report.flipped = faults.flipped.len() as u64;
    }
    Ok(())
}

impl<T: Scalar> Contour<T> {
    /// Triangle 2 q or 2 q + 1 of quad q.
    fn triangle(&self, t: u32) -> [u32; 3] {
        let q = t as usize / 2;
        self.quads[q].triangles(self.other[q])[t as usize % 2]
    }

    fn corners<const N: usize>(&self, vertices: [u32; N]) -> [Vector<T>; N] {
        vertices.map(|v| self.vertices[v as usize])
    }

    /// Cuts the quads of moved vertices anew; which they are, ascending.
    fn follow(&mut self, moved: &[u32], rows: &QuadRows) -> Vec<u32> {
        let of_vertex = |quads: &mut Vec<u32>, &v: &u32| rows.for_each_of(self, v, |q| quads.push(q));
        let mut quads = collected(moved.par_iter(), of_vertex, |a, b| [a, b].concat());
        quads.par_sort_unstable();
        quads.dedup();
        let cut: Vec<bool> = quads.par_iter().map(|&q| self.choose(&self.quads[q as usize])).collect();
        quads.iter().zip(cut).for_each(|(&q, other)| self.other[q as usize] = other);
        quads
    }
}

/// What threads put into lists of their own from each item, in one.
fn collected<I, L>(items: I, add: impl Fn(&mut L, I::Item) + Sync + Send, join: impl Fn(L, L) -> L + Sync + Send) -> L
where
    I: IndexedParallelIterator,
    L: Default + Send,
{
    let with = |mut list: L, item: I::Item| {
        add(&mut list, item);
        list
    };
    items.with_min_len(TOGETHER).fold(L::default, with).reduce(L::default, join)
}

/// The quads that are looked at in a round, and the boxes of all.
struct LookedAt<T> {
    /// `None` for all.
    quads: Option<Vec<u32>>,
    /// `[quads]` whether it is among them.
    is_one: Vec<bool>,
    boxes: Vec<Bounds<T>>,
    /// `[quads]` whether it reaches farther from its node than where vertices are in their cells.
    is_wide: Vec<bool>,
    /// Widths that none passes.
    reach: f64,
}

impl<T: Scalar> LookedAt<T> {
    fn all(contour: &Contour<T>, rows: &QuadRows) -> Self {
        let boxes: Vec<Bounds<T>> =
            contour.quads.par_iter().map(|quad| bounds_of(contour.corners(quad.vertices))).collect();
        let reach = |q: usize| rows.reach(contour, q as u32, &boxes[q]);
        let is_wide = (0..boxes.len()).into_par_iter().map(|q| reach(q) > IN_CELLS).collect();
        let farthest = (0..boxes.len()).into_par_iter().map(reach).reduce(|| IN_CELLS, f64::max);
        Self { quads: None, is_one: vec![true; boxes.len()], boxes, is_wide, reach: farthest }
    }

    /// Other quads, whose vertices have moved.
    fn move_to(&mut self, contour: &Contour<T>, rows: &QuadRows, quads: Vec<u32>) {
        match &self.quads {
            None => self.is_one.fill(false),
            Some(before) => before.iter().for_each(|&q| self.is_one[q as usize] = false),
        }
        for &q in &quads {
            let bounds = bounds_of(contour.corners(contour.quads[q as usize].vertices));
            let reach = rows.reach(contour, q, &bounds);
            (self.boxes[q as usize], self.is_one[q as usize]) = (bounds, true);
            self.is_wide[q as usize] = reach > IN_CELLS;
            self.reach = self.reach.max(reach);
        }
        self.quads = Some(quads);
    }

    /// The faults of the quads that are looked at, among each other and with all others.
    fn faults(&self, contour: &Contour<T>, rows: &QuadRows) -> Faults {
        let add = |faults: &mut Faults, q: u32| self.add_faults(contour, rows, q, faults);
        match &self.quads {
            None => collected((0..self.boxes.len() as u32).into_par_iter(), add, Faults::and),
            Some(quads) => collected(quads.par_iter().copied(), add, Faults::and),
        }
    }

    fn add_faults(&self, contour: &Contour<T>, rows: &QuadRows, a: u32, faults: &mut Faults) {
        let quad = &contour.quads[a as usize];
        let is_flipped = |t: &u32| quad.is_flipped(&normal_of(&contour.corners(contour.triangle(*t))));
        faults.flipped.extend([2 * a, 2 * a + 1].iter().filter(|t| is_flipped(t)));
        let of_a = Placed::of(contour, a);
        faults.add_pair(&of_a, &of_a, [0, 1]);
        let (bounds, planes) = (&self.boxes[a as usize], of_a.planes());
        let mut add = |b: u32| {
            if !overlap(bounds, &self.boxes[b as usize]) {
                return;
            }
            let of_b = Placed::of(contour, b);
            if surely_parted(&of_a.places, &of_b.places, of_a.shared_with(&of_b)) {
                return;
            }
            if !of_b.is_aside_of(&of_a, &planes) && !of_a.is_aside_of(&of_b, &of_b.planes()) {
                [[0, 0], [0, 1], [1, 0], [1, 1]].into_iter().for_each(|which| faults.add_pair(&of_a, &of_b, which));
            }
        };
        // Each pair once. Where all are looked at, those that are wide find the others, and those that are not only each other.
        let is_wide = |q: u32| self.is_wide[q as usize];
        match (&self.quads, is_wide(a)) {
            (None, false) => rows.for_each_near(bounds, IN_CELLS, a + 1, |b| {
                if !is_wide(b) {
                    add(b);
                }
            }),
            (None, true) => rows.for_each_near(bounds, self.reach, 0, |b| {
                if !is_wide(b) || b > a {
                    add(b);
                }
            }),
            (Some(_), _) => rows.for_each_near(bounds, self.reach, 0, |b| {
                if b > a || b < a && !self.is_one[b as usize] {
                    add(b);
                }
            }),
        }
    }
}

/// A quad with the places of its vertices, in `f64`.
struct Placed {
    q: u32,
    vertices: [u32; 4],
    places: [[f64; 3]; 4],
    /// Of each triangle the corners, by their number among the vertices.
    corners: [[usize; 3]; 2],
}

impl Placed {
    #[inline]
    fn of<T: Scalar>(contour: &Contour<T>, q: u32) -> Self {
        let vertices = contour.quads[q as usize].vertices;
        let place = |v: u32| {
            let [x, y, z] = contour.vertices[v as usize];
            [x.to_f64(), y.to_f64(), z.to_f64()]
        };
        let places = [place(vertices[0]), place(vertices[1]), place(vertices[2]), place(vertices[3])];
        let corners = if contour.other[q as usize] { [[1, 2, 3], [1, 3, 0]] } else { [[0, 1, 2], [0, 2, 3]] };
        Self { q, vertices, places, corners }
    }

    /// Of both one bit a vertex, 1 where the other has it too.
    #[inline]
    fn shared_with(&self, other: &Self) -> [u32; 2] {
        let mut shared = [0, 0];
        for (i, v) in self.vertices.iter().enumerate() {
            for (j, w) in other.vertices.iter().enumerate() {
                let is_one = u32::from(v == w);
                shared[0] |= is_one << i;
                shared[1] |= is_one << j;
            }
        }
        shared
    }

    fn triangle(&self, which: usize) -> ([u32; 3], [[f64; 3]; 3]) {
        (self.corners[which].map(|i| self.vertices[i]), self.corners[which].map(|i| self.places[i]))
    }

    #[inline]
    fn planes(&self) -> [Plane; 2] {
        [0, 1].map(|which| Plane::of(&self.corners[which].map(|i| self.places[i])))
    }

    /// Whether all of it but shared corners is surely on one side of the plane of each triangle of another quad, be it the same
    /// side or not: then no triangles of both meet. Quads share two vertices at most.
    #[inline]
    fn is_aside_of(&self, other: &Self, planes: &[Plane; 2]) -> bool {
        (0..2).all(|which| {
            let is_shared = |v: &u32| other.corners[which].iter().any(|&i| other.vertices[i] == *v);
            let beyond = self.vertices.iter().zip(&self.places).filter(|(v, _)| !is_shared(v));
            planes[which].surely_keeps_aside(beyond.map(|(_, place)| place))
        })
    }
}

impl Faults {
    /// These and others.
    fn and(mut self, others: Self) -> Self {
        self.flipped.extend(others.flipped);
        self.pairs.extend(others.pairs);
        self
    }

    /// Adds a triangle of each quad if they meet elsewhere than in what they share.
    fn add_pair(&mut self, a: &Placed, b: &Placed, which: [usize; 2]) {
        let (of_a, of_b) = (a.triangle(which[0]), b.triangle(which[1]));
        if overlap(&bounds_of(of_a.1), &bounds_of(of_b.1)) && meet_beyond_shared((&of_a.0, &of_a.1), (&of_b.0, &of_b.1))
        {
            let [a, b] = [2 * a.q + which[0] as u32, 2 * b.q + which[1] as u32];
            self.pairs.push([a.min(b), a.max(b)]);
        }
    }
}

/// How far each vertex has retreated.
struct Retreat<'a, T> {
    contour: &'a mut Contour<T>,
    steps: Vec<u8>,
}

impl<'a, T: Scalar> Retreat<'a, T> {
    /// Vertices far outside their cells retreat at once.
    fn new(contour: &'a mut Contour<T>, rows: &QuadRows) -> Self {
        let (low, high) = (T::of(-REACH), T::of(1.0 + REACH));
        let is_far = |place: &Vector<T>| place.iter().any(|&x| !(x >= low && x <= high));
        let steps: Vec<u8> =
            contour.sheets.par_iter().map(|sheet| u8::from(is_far(&sheet.place)) * AT_BORDER).collect();
        let mut retreat = Self { contour, steps };
        let far: Vec<u32> = (0..retreat.steps.len() as u32).filter(|&v| retreat.steps[v as usize] > 0).collect();
        far.iter().for_each(|&v| retreat.place(v));
        retreat.contour.follow(&far, rows);
        retreat
    }

    /// Lets vertices of faulty triangles retreat; which have moved.
    fn step(&mut self, faults: &Faults) -> Vec<u32> {
        let corners = |t: &u32| self.contour.triangle(*t);
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
    use super::super::contour;
    use super::super::{ContourSettings, NodeValues};
    use super::*;
    use crate::geometry::RegularGrid;
    use crate::geometry::mesh_intersections::self_intersections;
    use glam::{DVec3, Vec3};

    /// The surface of random values, with vertices wherever planes meet: within `limit` widths of their cells.
    fn random_surface(nodes: [u32; 3], limit: f32, seed: u32) -> Contour<f32> {
        let grid = RegularGrid::new(DVec3::ZERO, Vec3::new(-3.0, 100.0, 0.1), 0.1, nodes).unwrap();
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1u32 << 23) as f32 - 1.0
        };
        let values: Vec<f32> = (0..grid.n_nodes()).map(|_| next()).collect();
        let values = NodeValues::new(&grid, &values).unwrap();
        let mut surface = contour(&values, &ContourSettings::features(), &mut Watch::none()).unwrap();
        for (vertex, sheet) in surface.vertices.iter_mut().zip(&surface.sheets) {
            *vertex = position(&grid, sheet.cell, sheet.place.map(|x| x.clamp(-limit, 1.0 + limit)));
        }
        surface
    }

    #[test]
    fn rows_find_what_lists_of_cells_find() {
        for (seed, limit) in [(1, 0.0), (2, 0.5), (3, 1.0), (4, 5.0)] {
            let surface = random_surface([9, 12, 7], limit, seed);
            let rows = QuadRows::of(&surface);
            let mut looked_at = LookedAt::all(&surface, &rows);
            let sorted = |mut faults: Faults| {
                faults.pairs.sort_unstable();
                faults.pairs
            };
            let all = self_intersections(&surface.mesh());
            assert_eq!(sorted(looked_at.faults(&surface, &rows)), all, "seed {seed}");
            assert!(all.len() > 100 && (limit == 0.0 || looked_at.reach > 1.2), "{} {}", all.len(), looked_at.reach);
            // Of some quads, twice over.
            for step in [5, 7] {
                let quads: Vec<u32> = (0..surface.quads.len() as u32).step_by(step).collect();
                let is_one = |t: u32| ((t / 2) as usize).is_multiple_of(step);
                let some: Vec<_> = all.iter().copied().filter(|&[a, b]| is_one(a) || is_one(b)).collect();
                looked_at.move_to(&surface, &rows, quads);
                assert_eq!(sorted(looked_at.faults(&surface, &rows)), some, "seed {seed}, every {step}.");
            }
        }
    }

    #[test]
    fn the_quads_of_a_vertex_are_those_that_have_it() {
        let surface = random_surface([6, 5, 8], 1.0, 9);
        let rows = QuadRows::of(&surface);
        for vertex in 0..surface.vertices.len() as u32 {
            let mut found = vec![];
            rows.for_each_of(&surface, vertex, |q| found.push(q));
            found.sort_unstable();
            let has = |q: &u32| surface.quads[*q as usize].vertices.contains(&vertex);
            assert_eq!(found, (0..surface.quads.len() as u32).filter(has).collect::<Vec<_>>(), "{vertex}");
        }
    }

    #[test]
    fn places_that_are_not_finite_meet_nothing() {
        let mut surface = random_surface([5, 5, 5], 1.0, 3);
        let some = surface.vertices.len() / 2;
        surface.vertices[some] = [f32::NAN, 0.0, f32::INFINITY];
        let rows = QuadRows::of(&surface);
        let mut pairs = LookedAt::all(&surface, &rows).faults(&surface, &rows).pairs;
        pairs.sort_unstable();
        assert_eq!(pairs, self_intersections(&surface.mesh()));
    }

    #[test]
    fn the_way_ends_at_the_border_of_the_cell() {
        assert_eq!(towards_cell([0.5, 0.5, 0.5], [0.25, 0.75, 0.5]), [0.25, 0.75, 0.5]);
        assert_eq!(towards_cell([0.5, 0.5, 0.5], [1.5, 0.5, 0.0]), [1.0, 0.5, 0.25]);
        assert_eq!(towards_cell([0.0, 0.5, 0.5], [-3.0, 0.5, 0.75]), [0.0, 0.5, 0.5]);
        let far = towards_cell([0.25f32, 0.5, 0.5], [1e30, -1e30, 0.0]);
        assert!(far.iter().all(|x| (0.0..=1.0).contains(x)), "{far:?}");
    }
}
