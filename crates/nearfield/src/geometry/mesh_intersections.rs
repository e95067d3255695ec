//! Pairs of triangles of a mesh that meet elsewhere than in the corners they share.
//!
//! Triangles are listed by the cells of a grid that their boxes touch; those of a cell are compared with each other. Answers
//! are exact: they go by the signs of `triangle_pair.rs`, but where `triangles_apart.rs` is sure without them.

use rayon::prelude::*;

use super::TriMesh;
use super::corner_bounds::{Bounds, bounds_of, overlap};
use super::triangle_pair::{triangles_meet, triangles_meet_beyond_corner, triangles_meet_beyond_edge};
use super::triangles_apart::surely_apart;

/// Cells of the lists in mean extents of triangles.
const CELL_EXTENTS: f64 = 1.5;
/// A triangle over more cells than this is compared with all others instead.
const MOST_CELLS: u64 = 512;
/// Cells a side at most: their numbers along the axes share a key of 63 bits.
const MOST_SIDE: f64 = 2_097_151.0;

/// Pairs of triangles of the mesh that intersect, touch or lie on each other elsewhere than in the corners and edges they
/// share by index; the lower index first, ascending. Empty for a mesh without self-intersections.
///
/// Corners at one place with different indices count as touching. Coordinates that are not finite meet nothing.
pub fn self_intersections(mesh: &TriMesh) -> Vec<[u32; 2]> {
    let positions: Vec<[f64; 3]> = mesh.vertices.par_iter().map(|p| p.as_dvec3().to_array()).collect();
    let soup = Soup::new(&positions, &mesh.triangles);
    let Some(cells) = Cells::of(&soup) else { return vec![] };
    let (mut entries, large) = soup.entries(&cells);
    entries.par_sort_unstable();
    let mut runs = vec![];
    let mut start = 0;
    for end in 1..=entries.len() {
        if end == entries.len() || entries[end].0 != entries[start].0 {
            runs.push(start..end);
            start = end;
        }
    }
    let in_cells = runs.into_par_iter().with_min_len(64).flat_map_iter(|run| soup.pairs_of_cell(&cells, &entries[run]));
    let mut pairs: Vec<[u32; 2]> = in_cells.collect();
    for &a in &large {
        let others = (0..mesh.triangles.len() as u32).into_par_iter();
        // Two large ones are compared by the lower.
        let others = others.filter(|b| *b != a && !(large.binary_search(b).is_ok() && *b < a));
        pairs.par_extend(others.filter(|&b| soup.meet(a, b)).map(|b| [a.min(b), a.max(b)]));
    }
    pairs.par_sort_unstable();
    pairs
}

/// Whether two triangles, each given by the indices of its corners and their places, meet elsewhere than in the corners and edges
/// they share by index.
pub(crate) fn meet_beyond_shared(a: (&[u32; 3], &[[f64; 3]; 3]), b: (&[u32; 3], &[[f64; 3]; 3])) -> bool {
    let n_shared = a.0.iter().filter(|v| b.0.contains(v)).count();
    let (a, b) = (shared_first(a, b.0), shared_first(b, a.0));
    match n_shared {
        0..=2 if surely_apart(&a, &b, n_shared) => false,
        0 => triangles_meet(&a, &b),
        1 => triangles_meet_beyond_corner(&a, &b),
        2 => triangles_meet_beyond_edge(&a, &b),
        _ => true,
    }
}

/// The places of the corners, those with indices of another triangle first, both by ascending index.
fn shared_first((of, places): (&[u32; 3], &[[f64; 3]; 3]), with: &[u32; 3]) -> [[f64; 3]; 3] {
    let key = |i: usize| u64::from(!with.contains(&of[i])) << 34 | u64::from(of[i]) << 2 | i as u64;
    let ordered = |a: u64, b: u64| (a.min(b), a.max(b));
    let (a, b) = ordered(key(0), key(1));
    let (b, c) = ordered(b, key(2));
    let (a, b) = ordered(a, b);
    [a, b, c].map(|key| places[key as usize & 3])
}

/// Triangles by index.
struct Soup<'a> {
    vertices: &'a [[f64; 3]],
    triangles: &'a [[u32; 3]],
    /// Boxes of the triangles; NaN where a coordinate is not finite.
    boxes: Vec<Bounds<f64>>,
}

/// The grid of the lists.
struct Cells {
    corner: [f64; 3],
    width: f64,
}

impl Cells {
    fn of(soup: &Soup<'_>) -> Option<Self> {
        let boxes = || soup.boxes.iter().filter(|b| is_finite(b));
        let first = *boxes().next()?;
        let all = boxes().fold(first, |[low, high], b| {
            [[0, 1, 2].map(|a| low[a].min(b[0][a])), [0, 1, 2].map(|a| high[a].max(b[1][a]))]
        });
        let extent = |b: &Bounds<f64>| (0..3).map(|a| b[1][a] - b[0][a]).fold(0.0, f64::max);
        let mean = boxes().map(extent).sum::<f64>() / boxes().count() as f64;
        let width = (CELL_EXTENTS * mean).max(extent(&all) / MOST_SIDE);
        // All in one place: one cell.
        Some(Self { corner: all[0], width: if width > 0.0 { width } else { 1.0 } })
    }

    fn cell(&self, p: &[f64; 3]) -> [u64; 3] {
        [0, 1, 2].map(|a| ((p[a] - self.corner[a]) / self.width) as u64)
    }
}

fn key([x, y, z]: [u64; 3]) -> u64 {
    x | y << 21 | z << 42
}

fn is_finite(bounds: &Bounds<f64>) -> bool {
    bounds[0][0].is_finite()
}

impl<'a> Soup<'a> {
    fn new(vertices: &'a [[f64; 3]], triangles: &'a [[u32; 3]]) -> Self {
        let boxes = triangles.par_iter().map(|triangle| bounds_of(triangle.map(|v| vertices[v as usize]))).collect();
        Self { vertices, triangles, boxes }
    }

    /// Keys of the cells that a triangle's box touches; `None` where there are too many.
    fn keys(&self, cells: &Cells, t: u32) -> Option<Vec<u64>> {
        let bounds = &self.boxes[t as usize];
        if !is_finite(bounds) {
            return Some(vec![]);
        }
        let (low, high) = (cells.cell(&bounds[0]), cells.cell(&bounds[1]));
        if (0..3).map(|a| high[a] - low[a] + 1).product::<u64>() > MOST_CELLS {
            return None;
        }
        let mut keys = vec![];
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                keys.extend((low[0]..=high[0]).map(|x| key([x, y, z])));
            }
        }
        Some(keys)
    }

    /// Cell and index of each triangle, and the triangles that are too large for lists.
    fn entries(&self, cells: &Cells) -> (Vec<(u64, u32)>, Vec<u32>) {
        let n = self.triangles.len() as u32;
        let entries = (0..n).into_par_iter().flat_map_iter(|t| {
            let keys = self.keys(cells, t).unwrap_or_default();
            keys.into_iter().map(move |key| (key, t))
        });
        let large = (0..n).into_par_iter().filter(|&t| self.keys(cells, t).is_none());
        (entries.collect(), large.collect())
    }

    /// Pairs of the triangles of a cell that meet, each in only one of the cells that both touch.
    fn pairs_of_cell(&self, cells: &Cells, entries: &[(u64, u32)]) -> Vec<[u32; 2]> {
        let mut pairs = vec![];
        for (i, &(cell, a)) in entries.iter().enumerate() {
            for &(_, b) in &entries[i + 1..] {
                let (of_a, of_b) = (&self.boxes[a as usize], &self.boxes[b as usize]);
                let low = [0, 1, 2].map(|axis| of_a[0][axis].max(of_b[0][axis]));
                if overlap(of_a, of_b) && key(cells.cell(&low)) == cell && self.meet_inside(a, b) {
                    pairs.push([a.min(b), a.max(b)]);
                }
            }
        }
        pairs
    }

    fn meet(&self, a: u32, b: u32) -> bool {
        overlap(&self.boxes[a as usize], &self.boxes[b as usize]) && self.meet_inside(a, b)
    }

    /// Whether two triangles whose boxes overlap meet elsewhere than in what they share.
    fn meet_inside(&self, a: u32, b: u32) -> bool {
        let corners = |t: u32| self.triangles[t as usize].map(|v| self.vertices[v as usize]);
        let of = |t: u32| &self.triangles[t as usize];
        meet_beyond_shared((of(a), &corners(a)), (of(b), &corners(b)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    /// All pairs, one by one.
    fn by_hand(mesh: &TriMesh) -> Vec<[u32; 2]> {
        let vertices: Vec<[f64; 3]> = mesh.vertices.iter().map(|p| p.as_dvec3().to_array()).collect();
        let soup = Soup::new(&vertices, &mesh.triangles);
        let n = mesh.triangles.len() as u32;
        (0..n).flat_map(|a| (a + 1..n).map(move |b| [a, b])).filter(|&[a, b]| soup.meet(a, b)).collect()
    }

    fn random_soup(n: u32, size: f32, seed: u32) -> TriMesh {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1u32 << 24) as f32
        };
        let mut vertices = vec![];
        for _ in 0..n {
            let at = Vec3::new(next(), next(), next());
            // Some are much larger than the rest.
            let size = if next() < 0.02 { 1.0 } else { size };
            vertices.extend([0, 1, 2].map(|_| at + size * Vec3::new(next(), next(), next())));
        }
        // Neighbours share corners.
        let triangles = (0..n).map(|i| [3 * i, 3 * i + 1, if i % 3 == 0 { (3 * i + 5) % (3 * n) } else { 3 * i + 2 }]);
        TriMesh::new(vertices, triangles.collect()).unwrap()
    }

    #[test]
    fn lists_find_what_all_pairs_find() {
        let mut found = 0;
        for seed in 1..6 {
            let mesh = random_soup(400, 0.1, seed);
            let expected = by_hand(&mesh);
            assert_eq!(self_intersections(&mesh), expected, "seed {seed}");
            found += expected.len();
        }
        assert!(found > 500, "only {found} pairs meet");
    }

    #[test]
    fn a_cube_meets_itself_nowhere_and_a_planted_spike_is_found() {
        let cube = crate::geometry::generate::mesh(crate::geometry::generate::MeshKind::Cube, 1200, 1);
        assert!(self_intersections(&cube).is_empty());
        let mut spiked = cube.clone();
        let far = cube.bounds().center() - 3.0 * (cube.vertices[0] - cube.bounds().center());
        spiked.vertices[0] = far;
        assert!(!self_intersections(&spiked).is_empty());
        assert_eq!(self_intersections(&spiked), by_hand(&spiked));
    }

    #[test]
    fn nothing_and_nonsense_meet_nothing() {
        assert!(self_intersections(&TriMesh::default()).is_empty());
        let nan = TriMesh::new(vec![Vec3::splat(f32::NAN); 3], vec![[0, 1, 2], [0, 1, 2]]).unwrap();
        assert!(self_intersections(&nan).is_empty());
        let point = TriMesh::new(vec![Vec3::ONE; 3], vec![[0, 1, 2]]).unwrap();
        assert!(self_intersections(&point).is_empty());
    }
}
