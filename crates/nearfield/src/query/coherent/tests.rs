//! The phases on the CPU: what they merge, what they report, and counts against the loop over all pairs.

use glam::{DVec3, Vec3};

use crate::geometry::generate::{self, CloudKind};
use crate::query::{FixedRadius, NeighborSearch, SearchCounters};
use crate::structure::{AabbTree, AabbTreeSettings, TreeSearch};

/// Uniform points of the unit cube, the same everywhere.
fn points(n: usize, seed: u64) -> Vec<Vec3> {
    generate::cloud(CloudKind::Uniform, n, seed).points_relative_to(DVec3::ZERO)
}

fn tree(points: &[Vec3], bucket: u32) -> AabbTree {
    AabbTree::build(points, &AabbTreeSettings::DEFAULT.search(TreeSearch::Coherent).bucket_size(bucket)).unwrap()
}

/// Pairs within the radius, by the loop.
fn pairs(points: &[Vec3], queries: &[Vec3], radius: f32) -> u64 {
    let near = |a: Vec3, b: Vec3| (a - b).length_squared() <= radius * radius;
    queries.iter().map(|&query| points.iter().filter(|&&point| near(query, point)).count() as u64).sum()
}

#[test]
fn traversals_are_merged_by_leaf() {
    let points = points(2000, 7);
    let tree = tree(&points, 20);
    let leaves = tree.shape().n_leaves() as u64;
    let question = FixedRadius::new(0.1);
    let (coherent, primary) = (tree.coherent_counters(&question).unwrap(), tree.primary_counters(&question).unwrap());
    assert_eq!((coherent.traversals, primary.traversals), (leaves, 2000));
    assert_eq!(coherent.merged_share(), 1.0 - leaves as f64 / 2000.0);
    assert!(coherent.candidates > 0 && primary.candidates == 0);
    assert!(coherent.nodes_visited < primary.nodes_visited && coherent.tests > primary.tests);
    let expected = pairs(&points, &points, 0.1);
    assert_eq!((coherent.neighbors, primary.neighbors), (expected, expected));
    // Neighbours in the tree's order have leaves of one size: lanes that extract are nearly all busy.
    assert!(coherent.phase("extract").unwrap().active_share() > 0.9, "{:?}", coherent.phases);
    assert_eq!(coherent.phase("pack").unwrap().taken, 0, "points are in packs already");
}

#[test]
fn leaves_without_points_are_no_packs() {
    let points = points(5, 3);
    let counters = tree(&points, 1).coherent_counters(&FixedRadius::new(10.0)).unwrap();
    assert_eq!((counters.traversals, counters.candidates, counters.tests, counters.neighbors), (5, 25, 25, 25));
    let none = tree(&[], 1).coherent_counters(&FixedRadius::new(1.0)).unwrap();
    assert_eq!(SearchCounters { phases: Vec::new(), ..none }, SearchCounters::default());
}

#[test]
fn other_queries_are_packed_by_the_leaf_they_are_nearest_to() {
    let (points, others) = (points(1000, 11), points(400, 12));
    // Far away, at the border and inside, with one radius and with many.
    let others: Vec<Vec3> = others.iter().map(|&p| p * 1.5 - 0.25).chain([Vec3::splat(100.0)]).collect();
    let tree = tree(&points, 20);
    let question = FixedRadius::new(0.2).queries(&others);
    let counters = tree.coherent_counters(&question).unwrap();
    assert!(counters.traversals <= tree.shape().n_leaves() as u64 && counters.traversals > 1);
    assert_eq!(counters.neighbors, pairs(&points, &others, 0.2));
    assert_eq!(counters.phase("pack").unwrap().worked, 401 * u64::from(tree.shape().depth()));
    let found = tree.count(&question).unwrap();
    assert_eq!(found.as_slice().iter().map(|&c| u64::from(c)).sum::<u64>(), counters.neighbors);
    let stages: Vec<&str> = found.report.stages.iter().map(|stage| stage.name).collect();
    assert_eq!((found.report.search, &stages[..]), ("coherent", &["pack", "traverse", "extract"][..]));
}
