//! The nearest sample of every node of a grid by any search: the part of a distance field that the paper compares searches by.

use std::time::Instant;

use nearfield::Vec3;
use nearfield::application::DistanceField;
use rayon::prelude::*;

use super::field::place;
use crate::Result;
use crate::paper::lab::Lab;
use crate::paper::methods::{Plug, Positions, Start};

/// What a search took and how much of the answer it found.
pub struct Found {
    /// Milliseconds of the query, nodes from host memory and indices there.
    pub query_ms: f64,
    /// The same with build and the copy of the samples.
    pub total_ms: f64,
    /// Share of the nodes with the right sample, of searches that may miss it.
    pub recall: Option<f64>,
}

/// Distances may differ by so much, relatively, where f32 decides between two samples.
const SLACK: f64 = 1e-5;

/// Asks a search for the nearest sample of every node within a radius.
///
/// # Errors
/// What the method returns; a wrong answer.
pub fn by_search(lab: &Lab, plug: &Plug, points: &[Vec3], radius: f32, expected: &DistanceField) -> Result<Found> {
    let gpu = lab.gpu().filter(|_| plug.on_gpu);
    let grid = expected.distances.grid();
    let nodes: Vec<Vec3> = (0..grid.n_nodes()).into_par_iter().map(|number| place(grid, number)).collect();
    let queries = Positions::new(gpu, nodes)?;
    if let Some(gpu) = gpu {
        // Kernels are made in a search of few that is not timed.
        let few = Positions::new(Some(gpu), queries.host.iter().copied().take(1000).collect())?;
        let at = Positions::new(Some(gpu), points.to_vec())?;
        (plug.make)(&Start { gpu: Some(gpu), at: &at, radius, mean_neighbors: 1.0 })?.nearest_around(&few, radius)?;
    }
    let begin = Instant::now();
    let at = Positions::new(gpu, points.to_vec())?;
    let mut method = (plug.make)(&Start { gpu, at: &at, radius, mean_neighbors: 1.0 })?;
    let start = Instant::now();
    let found = method.nearest_around(&queries, radius)?;
    let [query_ms, total_ms] = [start, begin].map(|clock| 1e3 * clock.elapsed().as_secs_f64());
    let right = share_right(points, &queries.host, f64::from(radius), &found.indices, &expected.nearest)?;
    if found.is_exact && right < 1.0 {
        return Err(format!("wrong answer: {} of the nodes have another nearest sample", 1.0 - right).into());
    }
    Ok(Found { query_ms, total_ms, recall: (!found.is_exact).then_some(right) })
}

/// The share of the nodes with a nearest sample whose distance is right.
///
/// # Errors
/// A sample outside of the radius, or that is nearer than the nearest: an answer that no search may give.
fn share_right(points: &[Vec3], nodes: &[Vec3], radius: f64, found: &[u32], expected: &[u32]) -> Result<f64> {
    if found.len() != expected.len() {
        return Err(format!("wrong answer: {} nodes, expected {}", found.len(), expected.len()).into());
    }
    let distance = |node: usize, index: u32| points[index as usize].as_dvec3().distance(nodes[node].as_dvec3());
    let is_right = |node: usize| -> Result<(usize, usize)> {
        let none = DistanceField::NONE;
        let (found, expected) = (found[node], expected[node]);
        let at_edge = |index: u32| (distance(node, index) - radius).abs() <= SLACK * radius;
        Ok(match (found == none, expected == none) {
            (true, true) => (0, 0),
            (true, false) => (usize::from(at_edge(expected)), 1),
            (false, true) if at_edge(found) => (0, 0),
            (false, true) => return Err(format!("wrong answer: node {node} has a sample outside of the radius").into()),
            (false, false) => {
                let [its, right] = [found, expected].map(|index| distance(node, index));
                if its < right - SLACK * radius {
                    return Err(format!("wrong answer: the reference of node {node} is not the nearest").into());
                }
                (usize::from(its <= right + SLACK * radius), 1)
            }
        })
    };
    let sums =
        (0..found.len()).into_par_iter().map(is_right).try_reduce(|| (0, 0), |a, b| Ok((a.0 + b.0, a.1 + b.1)))?;
    Ok(if sums.1 == 0 { 1.0 } else { sums.0 as f64 / sums.1 as f64 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_samples_are_counted_and_impossible_ones_refused() {
        let points = [Vec3::ZERO, Vec3::X];
        let nodes = [Vec3::splat(0.1), Vec3::new(0.9, 0.1, 0.0), Vec3::splat(5.0)];
        let none = DistanceField::NONE;
        let share = |found: [u32; 3]| share_right(&points, &nodes, 1.2, &found, &[0, 1, none]);
        assert_eq!(share([0, 1, none]).expect("right"), 1.0);
        assert_eq!(share([0, 0, none]).expect("one is farther"), 0.5);
        assert_eq!(share([none, 1, none]).expect("one is missing"), 0.5);
        assert!(share([0, 1, 1]).is_err(), "outside of the radius");
        assert!(share_right(&points, &nodes, 1.2, &[0, 1, none], &[0, 0, none]).is_err(), "nearer than the nearest");
    }
}
