//! Normals turned to the side of their neighbours', along the edges where they differ least.
//!
//! Source: Hoppe1992, §3.3. The graph joins every point with its k nearest, an edge costs 1 − |n·n′|, and the sides are passed
//! along its least spanning tree (Kruskal1956). Differs: the graph is left in its components, and each gets its side by itself,
//! by an extreme point; Hoppe1992 joins all by a spanning tree of distances and asks the highest point only. Sheets closer than
//! a few spacings, and surfaces that touch, are joined by cheap edges with the wrong side on one end:
//! [`super::orient_by_winding_number`] is for those.

use super::Normals;
use super::neighbor_graph::{Edge, Sets, sorted_edges};
use crate::Result;
use crate::application::Watch;
use crate::geometry::Scalar;
use crate::geometry::vector;
use crate::structure::AabbTreeN;

/// Directions in which extreme points are looked for, in the order in which they are preferred: axis, and whether down.
const DIRECTIONS: [(usize, bool); 6] = [(2, false), (2, true), (0, false), (0, true), (1, false), (1, true)];
/// An extreme point whose normal has so much of its direction is good enough.
const CLEAR: f64 = 0.7;

/// What was done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SpanningTree {
    /// Connected parts of the graph among points with normals.
    pub components: u64,
    /// Points of the largest.
    pub largest: u64,
    /// Normals that were turned.
    pub flipped: u64,
}

/// Turns every normal to the side of its neighbours', and of each connected part its extreme point outward: of the points
/// farthest up, down, and along the other axes, the first whose normal is clearly along that direction.
///
/// - `tree`: over the points of the normals
/// - `k`: neighbours that a point is joined with, itself not counted; 8 to 20 are usual
///
/// Points without a normal are left out. A surface with a border, such as terrain, faces up.
///
/// # Errors
/// `LengthMismatch`, `Interrupted`: the normals are then as they were.
pub fn orient_by_spanning_tree<T: Scalar>(
    tree: &AabbTreeN<T, 3>,
    normals: &mut Normals<T>,
    k: u32,
    watch: &mut Watch<'_>,
) -> Result<SpanningTree> {
    let n = tree.len();
    normals.check_length(n)?;
    let mut edges = sorted_edges(tree, normals, k, watch)?;
    watch.report("spanning tree", 0, edges.len() as u64)?;
    let mut sets = Sets::new(n);
    edges.retain(|edge| sets.unite(edge.low, edge.high));
    let mut turned = passed_along(normals, &Branches::of(n, &edges));
    let roots: Vec<u32> = (0..n as u32).map(|point| sets.find(point)).collect();
    let inward = inward_components(tree, normals, &roots, &turned);
    let mut sizes = vec![0u64; n];
    let mut made = SpanningTree::default();
    for i in (0..n).filter(|&i| normals.has(i)) {
        let root = roots[i] as usize;
        sizes[root] += 1;
        made.components += u64::from(sizes[root] == 1);
        made.largest = made.largest.max(sizes[root]);
        turned[i] ^= inward[root];
    }
    for i in (0..n).filter(|&i| turned[i] && normals.has(i)).collect::<Vec<_>>() {
        normals.flip(i);
        made.flipped += 1;
    }
    Ok(made)
}

/// The other ends of the edges at each point.
struct Branches {
    /// `[n + 1]` into `ends`.
    offsets: Vec<u32>,
    ends: Vec<u32>,
}

impl Branches {
    fn of(n: usize, edges: &[Edge]) -> Self {
        let mut offsets = vec![0u32; n + 1];
        for edge in edges {
            offsets[edge.low as usize + 1] += 1;
            offsets[edge.high as usize + 1] += 1;
        }
        for i in 0..n {
            offsets[i + 1] += offsets[i];
        }
        let mut next = offsets.clone();
        let mut ends = vec![0u32; 2 * edges.len()];
        for edge in edges {
            for (from, to) in [(edge.low, edge.high), (edge.high, edge.low)] {
                ends[next[from as usize] as usize] = to;
                next[from as usize] += 1;
            }
        }
        Self { offsets, ends }
    }

    fn at(&self, point: u32) -> &[u32] {
        let [start, end] = [0, 1].map(|i| self.offsets[point as usize + i] as usize);
        &self.ends[start..end]
    }
}

/// Whether each normal is to be turned for the side of the lowest point of its component.
fn passed_along<T: Scalar>(normals: &Normals<T>, branches: &Branches) -> Vec<bool> {
    let n = normals.len();
    let (mut turned, mut reached, mut open) = (vec![false; n], vec![false; n], Vec::new());
    for root in 0..n as u32 {
        if reached[root as usize] {
            continue;
        }
        reached[root as usize] = true;
        open.push(root);
        while let Some(point) = open.pop() {
            for &end in branches.at(point) {
                let (from, to) = (point as usize, end as usize);
                if !reached[to] {
                    reached[to] = true;
                    let opposite = vector::dot(normals.vectors[from], normals.vectors[to]) < T::ZERO;
                    turned[to] = turned[from] ^ opposite;
                    open.push(end);
                }
            }
        }
    }
    turned
}

/// By root, whether the component faces inward at its extreme point.
fn inward_components<T: Scalar>(
    tree: &AabbTreeN<T, 3>,
    normals: &Normals<T>,
    roots: &[u32],
    turned: &[bool],
) -> Vec<bool> {
    let points = super::estimate::in_caller_order(tree);
    let n = points.len();
    // By root: the best direction so far, how much the extreme point's normal has of it, and whether it faces inward.
    let mut best = vec![(-1.0f64, false); n];
    for (axis, down) in DIRECTIONS {
        let height = |i: usize| if down { T::ZERO - points[i][axis] } else { points[i][axis] };
        let mut extreme = vec![u32::MAX; n];
        for i in (0..n).filter(|&i| normals.has(i)) {
            let highest = &mut extreme[roots[i] as usize];
            if *highest == u32::MAX || height(i) > height(*highest as usize) {
                *highest = i as u32;
            }
        }
        for (root, &i) in extreme.iter().enumerate().filter(|(_, i)| **i != u32::MAX) {
            let along = normals.vectors[i as usize][axis].to_f64();
            let outward = (along > 0.0) != (down ^ turned[i as usize]);
            if best[root].0 < CLEAR && along.abs() > best[root].0 {
                best[root] = (along.abs(), !outward);
            }
        }
    }
    best.into_iter().map(|(_, inward)| inward).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::AabbTreeNSettings;

    fn tree(points: &[[f64; 3]]) -> AabbTreeN<f64, 3> {
        AabbTreeN::build(points, &AabbTreeNSettings::default()).unwrap()
    }

    /// Points of a ball's surface about `center` and their outward normals, every other one turned.
    fn ball(center: [f64; 3], n: u32) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
        let normal = |i: u32| {
            let z = 1.0 - (f64::from(i) + 0.5) * 2.0 / f64::from(n);
            let (r, angle) = ((1.0 - z * z).sqrt(), f64::from(i) * 2.399_963);
            [r * angle.cos(), r * angle.sin(), z]
        };
        let points = (0..n).map(|i| vector::add(center, normal(i))).collect();
        (points, (0..n).map(normal).collect())
    }

    #[test]
    fn each_component_faces_outward() {
        let (mut points, mut outward) = ball([0.0; 3], 500);
        let (other, its) = ball([10.0, 1.0, -3.0], 300);
        points.extend(other);
        outward.extend(its);
        let given: Vec<[f64; 3]> =
            outward.iter().zip(0u32..).map(|(&n, i)| if i * i % 7 < 3 { n.map(|x| -x) } else { n }).collect();
        let mut normals = Normals::of_vectors(&given);
        normals.vectors[17] = [0.0; 3];
        let made = orient_by_spanning_tree(&tree(&points), &mut normals, 8, &mut Watch::none()).unwrap();
        assert_eq!((made.components, made.largest), (2, 499));
        for (i, (found, expected)) in normals.vectors.iter().zip(&outward).enumerate() {
            assert!(i == 17 || vector::dot(*found, *expected) > 0.999, "{i}: {found:?}, {expected:?}");
        }
        let changed = normals.vectors.iter().zip(&given).filter(|(a, b)| vector::dot(**a, **b) < 0.0).count();
        assert_eq!(made.flipped, changed as u64);
    }

    #[test]
    fn terrain_faces_up() {
        let points: Vec<[f64; 3]> =
            (0..400u32).map(|i| [f64::from(i % 20), f64::from(i / 20), (f64::from(i % 20) * 0.7).sin()]).collect();
        let mut normals = Normals::of_vectors(&vec![[0.0, 0.0, -1.0]; 400]);
        let made = orient_by_spanning_tree(&tree(&points), &mut normals, 8, &mut Watch::none()).unwrap();
        assert_eq!((made.components, made.flipped), (1, 400));
    }

    #[test]
    fn nothing_to_orient_is_no_error() {
        let mut none = Normals::default();
        let made = orient_by_spanning_tree(&tree(&[]), &mut none, 8, &mut Watch::none()).unwrap();
        assert_eq!(made, SpanningTree::default());
        let mut flagged = Normals::of_vectors(&[[0.0f64; 3]; 3]);
        let made = orient_by_spanning_tree(&tree(&[[1.0; 3]; 3]), &mut flagged, 0, &mut Watch::none()).unwrap();
        assert_eq!(made, SpanningTree::default());
    }
}
