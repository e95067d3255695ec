//! The kd-tree: sound for every build on every mesh, and to the bit what brute force says.

mod meshes;
mod on_gpu;
#[path = "../support/mod.rs"]
mod support;

use std::sync::Arc;

use libtest_mimic::{Arguments, Trial};
use meshes::{in_cube, meshes, rays};
use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::{
    BruteForceMesh, Error, KdBuild, KdTraversal, KdTree, KdTreeSettings, PreparedTriangles, Ray, RaySearch, TriMesh,
    Vec3,
};
use support::Random;

const BUILDS: [KdTreeSettings; 4] = [
    KdTreeSettings::spatial_median(4),
    KdTreeSettings::spatial_median(20),
    KdTreeSettings::DEFAULT.build(KdBuild::BinnedSah),
    KdTreeSettings::DEFAULT.build(KdBuild::ExactSah),
];

/// Rays for each build on each mesh.
const RAYS: usize = 10_000;

fn every_tree_keeps_the_invariants() {
    for (name, mesh) in meshes() {
        for settings in BUILDS {
            let tree = KdTree::build(&mesh, &settings).unwrap();
            let stats = tree.stats();
            assert_eq!(tree.broken_invariant(), None, "{name}, {settings:?}, {stats:?}");
            assert_eq!(stats.nodes, 2 * stats.leaves - 1);
        }
    }
}

fn every_walk_gives_what_brute_force_gives() {
    for (name, mesh) in meshes() {
        let triangles = PreparedTriangles::new(&mesh).unwrap();
        let reference = BruteForceMesh::of(triangles.clone());
        for settings in BUILDS {
            let mut tree = KdTree::of(triangles.clone(), &settings).unwrap();
            let rays = rays(&mesh, &tree, RAYS);
            let expected = (
                reference.closest_hits(&rays).unwrap(),
                reference.any_hits(&rays).unwrap(),
                reference.count_hits(&rays).unwrap(),
                reference.all_hits(&rays).unwrap(),
            );
            for traversal in [KdTraversal::Stack, KdTraversal::Ropes] {
                tree.set_traversal(traversal);
                let case = |i: usize| format!("{name}, {:?}, {traversal:?}: ray {i} {:?}", settings.build, rays[i]);
                let closest = tree.closest_hits(&rays).unwrap();
                let (any, count) = (tree.any_hits(&rays).unwrap(), tree.count_hits(&rays).unwrap());
                let all = tree.all_hits(&rays).unwrap();
                for i in 0..rays.len() {
                    assert_eq!(closest.records()[i], expected.0.records()[i], "{}", case(i));
                    assert_eq!(any.is_hit(i), expected.1.is_hit(i), "{}", case(i));
                    assert_eq!(all.row(i), expected.3.row(i), "{}", case(i));
                    assert_eq!(count.as_slice()[i], expected.2.as_slice()[i], "{}", case(i));
                }
            }
        }
    }
}

fn both_walks_test_the_same_triangles() {
    let mesh = mesh(MeshKind::Soup, 3000, 4);
    let tree = KdTree::build(&mesh, &KdTreeSettings::DEFAULT).unwrap();
    let mut random = Random(9);
    let rays: Vec<Ray> = (0..RAYS)
        .map(|_| {
            let from = 2.0 * in_cube(&mut random);
            Ray::new(from, 0.5 * (in_cube(&mut random) + 1.0) - from)
        })
        .collect();
    let work = |traversal| tree.clone().with_traversal(traversal).closest_hits_with_work(&rays).unwrap().1;
    let (stack, ropes) = (work(KdTraversal::Stack), work(KdTraversal::Ropes));
    for (stack, ropes) in stack.iter().zip(&ropes) {
        assert_eq!(stack.triangle_tests, ropes.triangle_tests);
        assert_eq!(stack.rope_steps, 0);
    }
    let nodes = |work: &[nearfield::RayWork]| work.iter().map(|w| u64::from(w.node_visits)).sum::<u64>();
    assert!(nodes(&ropes) < nodes(&stack), "ropes skip nodes: {} and {}", nodes(&ropes), nodes(&stack));
}

fn the_tree_is_the_same_on_one_thread_and_on_many() {
    let mesh = mesh(MeshKind::Icosphere, 40_000, 0);
    let triangles = PreparedTriangles::new(&mesh).unwrap();
    for settings in BUILDS {
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| KdTree::of(triangles.clone(), &settings).unwrap())
        };
        let (one, many) = (on(1), on(4));
        assert!(one.nodes() == many.nodes() && one.leaves() == many.leaves(), "{settings:?}");
        assert!(one.references() == many.references());
    }
}

fn memory_is_bounded_and_the_answers_stay() {
    let mesh = mesh(MeshKind::Soup, 2000, 6);
    let triangles = PreparedTriangles::new(&mesh).unwrap();
    let one_leaf = 72 + 4 * 2000;
    let rays: Vec<Ray> = {
        let mut random = Random(1);
        (0..500).map(|_| Ray::new(in_cube(&mut random) * 3.0, in_cube(&mut random))).collect()
    };
    let expected = BruteForceMesh::of(Arc::clone(&triangles)).closest_hits(&rays).unwrap();
    for settings in BUILDS {
        for bytes in [one_leaf, one_leaf + 100, 20_000, 100_000] {
            let tree = KdTree::of(triangles.clone(), &settings.max_bytes(bytes)).unwrap();
            assert!(tree.stats().bytes <= bytes, "{settings:?}: {:?}", tree.stats());
            assert_eq!(tree.closest_hits(&rays).unwrap().records(), expected.records());
        }
        let refused = KdTree::of(triangles.clone(), &settings.max_bytes(one_leaf - 1));
        assert!(matches!(refused, Err(Error::OutOfMemory { needed, available, .. })
            if (needed, available) == (one_leaf, one_leaf - 1)));
        let flat = KdTree::of(triangles.clone(), &settings.max_depth(0)).unwrap();
        assert_eq!((flat.stats().leaves, flat.stats().references), (1, 2000));
    }
}

fn bad_meshes_and_settings_are_errors() {
    let build = |mesh: &TriMesh, settings| KdTree::build(mesh, settings).map(|_| ());
    let defaults = KdTreeSettings::DEFAULT;
    assert!(matches!(build(&TriMesh::default(), &defaults), Err(Error::NoTriangles { vertices: 0 })));
    let mut bad = mesh(MeshKind::Soup, 4, 0);
    bad.triangles[2][1] = 99;
    assert!(matches!(build(&bad, &defaults), Err(Error::TooMany { found: 99, .. })));
    let mut bad = mesh(MeshKind::Soup, 4, 0);
    bad.vertices[3] = Vec3::NAN;
    assert!(matches!(build(&bad, &defaults), Err(Error::NonFinite { .. })));
    let settings = defaults.max_depth(65);
    assert!(matches!(build(&bad, &settings), Err(Error::InvalidSetting { setting: "max_depth", .. })));
}

fn main() {
    let mut trials: Vec<Trial> = vec![
        support::trial("every_tree_keeps_the_invariants", every_tree_keeps_the_invariants),
        support::trial("every_walk_gives_what_brute_force_gives", every_walk_gives_what_brute_force_gives),
        support::trial("both_walks_test_the_same_triangles", both_walks_test_the_same_triangles),
        support::trial(
            "the_tree_is_the_same_on_one_thread_and_on_many",
            the_tree_is_the_same_on_one_thread_and_on_many,
        ),
        support::trial("memory_is_bounded_and_the_answers_stay", memory_is_bounded_and_the_answers_stay),
        support::trial("bad_meshes_and_settings_are_errors", bad_meshes_and_settings_are_errors),
    ];
    trials.extend(on_gpu::trials());
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
