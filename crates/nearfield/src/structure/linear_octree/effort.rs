//! How much a traversal of the octree on a device can have to do: bounds for devices that end long loops.

use glam::Vec3;
use rayon::prelude::*;

use super::LinearOctree;
use super::walk::{BoxCells, Meeting, Step};
use crate::geometry::Aabb;
use crate::structure::{CpuStructure, Effort};

/// Invocations that may run in step on a device that does not say how many do.
pub(super) const MOST_IN_STEP: u32 = 64;

/// Upper bounds for balls of this radius around the points, or around any place within `queries`; `in_step` of them are
/// answered together: a loop of theirs goes on until the last of them is done.
pub(super) fn most(tree: &LinearOctree, radius: f32, queries: Option<&Aabb>, in_step: u32) -> Effort {
    let n_nodes = tree.nodes().len() as u64;
    let everything = Effort { candidates: tree.points.len() as u64 * u64::from(in_step), rounds: 3 * n_nodes };
    if queries.is_some() {
        return everything;
    }
    // What a pack's box touches is no less than what a ball around one of its points does.
    let packs: Vec<_> = tree.packs().windows(2).collect();
    let of_pack = |pack: &&[u32]| {
        let region = tree.layout.region_near(&tree.points.bounds(pack[0] as usize..pack[1] as usize), radius);
        let (mut visited, mut leaves, mut candidates) = (0u64, 0u64, 0u64);
        tree.walk(|_, node| {
            visited += 1;
            if !region.overlaps(node) {
                return Step::Over;
            }
            if node.is_leaf() {
                leaves += 1;
                candidates += u64::from(node.n_points());
            }
            Step::Into
        });
        (visited, leaves, candidates)
    };
    let largest = |a: (u64, u64, u64), b: (u64, u64, u64)| (a.0.max(b.0), a.1.max(b.1), a.2.max(b.2));
    let (visited, leaves, candidates) = packs.par_iter().map(of_pack).reduce(|| (0, 0, 0), largest);
    // Invocations in step need not be in leaves at the same time; a loop over a leaf takes up to two rounds more than
    // full ones.
    let in_step = u64::from(in_step);
    Effort {
        candidates: (candidates * in_step).min(everything.candidates),
        rounds: (visited + 2 * leaves * in_step).min(everything.rounds * in_step),
    }
}

/// The most nodes and points that the kernel `knn` looks at for any of the queries, `None` for the points themselves.
///
/// The kernel's search goes no farther than the k-th point of the node that it starts with, nor than the radius; here that
/// distance is never shortened, and it is lengthened by more than devices differ. `radius` is that of a query.
pub(super) fn most_nearest_steps(
    tree: &LinearOctree,
    queries: Option<&[Vec3]>,
    places: usize,
    exclude_self: bool,
    radius: impl Fn(usize) -> f32 + Sync,
) -> u64 {
    let wanted = places + usize::from(exclude_self);
    let (points, period) = (CpuStructure::points(tree), CpuStructure::period(tree));
    let steps = |query: Vec3, radius: f32, left_out: Option<u32>| {
        let Some(start) = tree.smallest_around(query, wanted, radius) else { return 0 };
        let inside = tree.nodes()[start].points().filter(|&i| Some(points.id(i)) != left_out);
        let mut dist2: Vec<f32> = inside.map(|i| period.dist2(query, points.position(i))).collect();
        let nearest2 = match places {
            0 => 0.0,
            _ if dist2.len() < places => f32::INFINITY,
            _ => *dist2.select_nth_unstable_by(places - 1, f32::total_cmp).1,
        };
        let reach2 = nearest2.min(radius * radius) * (1.0 + 1e-5) + 1e-36;
        let probe = tree.layout.probe(query);
        let mut steps = u64::from(tree.nodes()[start].n_points());
        tree.walk(|number, node| {
            steps += 1;
            if number as usize == start || tree.layout.dist2_below(&probe, node) > reach2 {
                return Step::Over;
            }
            if node.is_leaf() {
                steps += u64::from(node.n_points());
            }
            Step::Into
        });
        steps
    };
    match queries {
        Some(queries) => {
            let other = |(i, &query): (usize, &Vec3)| steps(query, radius(i), None);
            queries.par_iter().enumerate().map(other).max().unwrap_or(0)
        }
        None => {
            let own = |i: usize| {
                let id = points.id(i);
                steps(points.position(i), radius(id as usize), exclude_self.then_some(id))
            };
            (0..points.len()).into_par_iter().map(own).max().unwrap_or(0)
        }
    }
}

/// The most nodes and points that the kernel `boxes` looks at for any of the boxes, given by their lowest and highest
/// cells; with the points of nodes that lie inside, where it writes them out.
pub(super) fn most_box_steps(tree: &LinearOctree, boxes: &[[[u32; 3]; 2]], writes: bool) -> u64 {
    let steps = |&[low, high]: &[[u32; 3]; 2]| {
        let cells = BoxCells::between(low, high);
        let mut steps = 0u64;
        tree.walk(|_, node| {
            steps += 1;
            match cells.meet(node) {
                Meeting::Apart => {}
                Meeting::Inside => steps += if writes { u64::from(node.n_points()) } else { 0 },
                Meeting::Partly if node.is_leaf() => steps += u64::from(node.n_points()),
                Meeting::Partly => return Step::Into,
            }
            Step::Over
        });
        steps
    };
    boxes.par_iter().map(steps).max().unwrap_or(0)
}
