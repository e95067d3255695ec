//! What is asked of single rays, of rays that cannot be cast, and of meshes that cannot be searched.

use libtest_mimic::Trial;
use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::gpu::{AdapterKind, Gpu};
use nearfield::structure::GpuRayStructure;
use nearfield::{
    BruteForceMesh, BvhSettings, Error, GpuBruteForceMesh, GpuKdTree, GpuTriangleBvh, Hits, KdTreeSettings, Ray,
    RaySearch, TriMesh, TriangleBvh, Vec3,
};

use crate::support::{gpu_trial, own_context, refuse_each, trial};

fn square() -> TriMesh {
    let vertices = vec![Vec3::ZERO, Vec3::new(2.0, 0.0, 0.0), Vec3::new(2.0, 2.0, 0.0), Vec3::new(0.0, 2.0, 0.0)];
    TriMesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]]).unwrap()
}

fn single_rays(search: &dyn RaySearch) {
    let ray = Ray::new(Vec3::new(1.5, 0.5, 3.0), Vec3::new(0.0, 0.0, -2.0));
    let hit = search.closest_hit(&ray).unwrap().unwrap();
    assert_eq!((hit.triangle, hit.t), (0, 1.5));
    assert_eq!(hit.position, Vec3::new(1.5, 0.5, 0.0));
    assert_eq!(hit.normal, Vec3::Z);
    let sum: f32 = hit.barycentrics.iter().sum();
    assert!((sum - 1.0).abs() < 1e-6);
    assert!(search.any_hit(&ray).unwrap());
    assert_eq!(search.count_hits_of(&ray).unwrap(), 1);
    assert_eq!(search.all_hits_of(&ray).unwrap(), [hit]);
    // The diagonal belongs to both triangles: the lower one is named, both are counted.
    let diagonal = Ray::new(Vec3::new(1.0, 1.0, 3.0), -Vec3::Z);
    assert_eq!(search.closest_hit(&diagonal).unwrap().unwrap().triangle, 0);
    assert_eq!(search.count_hits_of(&diagonal).unwrap(), 2);
    // The range of t is closed.
    for (t_min, t_max, expected) in
        [(1.5, 9.0, true), (0.0, 1.5, true), (1.6, 9.0, false), (0.0, 1.4, false), (2.0, 1.0, false)]
    {
        let limited = Ray { t_min, t_max, ..ray };
        assert_eq!(search.any_hit(&limited).unwrap(), expected, "{t_min} to {t_max}");
        assert_eq!(search.closest_hit(&limited).unwrap().is_some(), expected, "{t_min} to {t_max}");
    }
}

/// Directions of any length that can be cast find what lies ahead, also where t is beyond the largest number.
fn tiny_and_huge_directions(search: &dyn RaySearch) {
    let from = |distance: f32, length: f32| Ray::new(Vec3::new(1.5, 0.5, distance), Vec3::new(0.0, 0.0, -length));
    for (distance, length) in [(3.0, 1e-37), (3.0, 1e37), (1000.0, 1e-37), (3.0, 1e-20)] {
        let hit = search.closest_hit(&from(distance, length)).unwrap();
        let expected = (f64::from(distance) / f64::from(length)).min(f64::from(f32::MAX));
        let t = f64::from(hit.unwrap_or_else(|| panic!("{distance} away, {length:e} long: a miss")).t);
        assert!((t - expected).abs() <= 1e-5 * expected, "{distance} away, {length:e} long: {t:e}");
    }
}

fn rays_that_cannot_be_cast(search: &dyn RaySearch) {
    let good = Ray::new(Vec3::new(1.5, 0.5, 3.0), -Vec3::Z);
    let bad = [
        Ray::new(Vec3::ZERO, Vec3::ZERO),
        Ray::new(Vec3::new(0.0, f32::NAN, 0.0), Vec3::X),
        Ray::new(Vec3::ZERO, Vec3::new(1.0, f32::INFINITY, 0.0)),
        Ray { t_min: f32::NAN, ..good },
        Ray::new(Vec3::splat(3e18), Vec3::X),
    ];
    for ray in &bad {
        for result in [
            search.closest_hit(ray).map(drop),
            search.any_hit(ray).map(drop),
            search.count_hits_of(ray).map(drop),
            search.all_hits_of(ray).map(drop),
        ] {
            assert!(matches!(result, Err(Error::InvalidRay { index: None, .. })), "{ray:?}");
        }
    }
    let rays: Vec<Ray> = bad.iter().flat_map(|&ray| [ray, good]).collect();
    let hits = search.closest_hits(&rays).unwrap();
    let (any, counts, all) =
        (search.any_hits(&rays).unwrap(), search.count_hits(&rays).unwrap(), search.all_hits(&rays).unwrap());
    for i in 0..rays.len() {
        let is_bad = i % 2 == 0;
        assert_eq!((hits.is_invalid(i), any.is_invalid(i)), (is_bad, is_bad), "ray {i}");
        assert_eq!((hits.hit(i).is_some(), any.is_hit(i)), (!is_bad, !is_bad), "ray {i}");
        assert_eq!((counts.as_slice()[i], all.row(i).len()), (u32::from(!is_bad), usize::from(!is_bad)), "ray {i}");
    }
    assert_eq!(hits.n_hits(), bad.len());
    assert!(search.closest_hits(&[]).unwrap().is_empty());
    assert!(search.all_hits(&[]).unwrap().is_empty());
}

fn bad_meshes_are_refused() {
    let square = square();
    let error = BruteForceMesh::build(&TriMesh { triangles: vec![], ..square.clone() }).unwrap_err();
    assert!(matches!(error, Error::NoTriangles { vertices: 4 }), "{error}");
    let error =
        BruteForceMesh::build(&TriMesh { triangles: vec![[0, 1, 2], [1, 2, 7]], ..square.clone() }).unwrap_err();
    assert!(matches!(error, Error::TooMany { found: 7, limit: 3, .. }), "{error}");
    let mut broken = square;
    broken.vertices[2].y = f32::NAN;
    let error = BruteForceMesh::build(&broken).unwrap_err();
    assert!(matches!(error, Error::NonFinite { what: "vertices", count: 1, first: 2 }), "{error}");
}

/// A ray along a row of triangles longer than loops may be: an answer, or an error on devices that end loops.
fn a_ray_that_takes_too_many_rounds_is_never_cut_silently(gpu: &Gpu) {
    let n = 70_000u32;
    let sheet = |i: u32| [Vec3::new(0.0, 0.0, i as f32), Vec3::new(1.0, 0.0, i as f32), Vec3::new(0.0, 1.0, i as f32)];
    let triangles = (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let mesh = TriMesh::new((0..n).flat_map(sheet).collect(), triangles).unwrap();
    let rays = [Ray::new(Vec3::new(0.25, 0.25, -1.0), Vec3::Z)];
    let tree = GpuKdTree::build(gpu, &mesh, &KdTreeSettings::default()).unwrap();
    let bvh = GpuTriangleBvh::build(gpu, &mesh, &BvhSettings::default()).unwrap();
    let searches: [&dyn RaySearch; 2] = [&tree, &bvh];
    for search in searches {
        match search.count_hits(&rays) {
            Ok(counts) => assert_eq!(counts.as_slice(), [n], "{}", search.structure()),
            Err(Error::Unsupported { .. }) => assert!(gpu.limits().loop_rounds.is_some(), "{}", search.structure()),
            Err(error) => panic!("{}: {error}", search.structure()),
        }
        assert!(search.closest_hit(&rays[0]).unwrap().is_some_and(|hit| hit.triangle == 0), "{}", search.structure());
    }
}

/// Rays times triangles pass what one submission is made for: they go in two, and answers are whole.
fn long_casts_go_in_several_submissions(gpu: &Gpu) {
    let mesh = mesh(MeshKind::Soup, 400_000, 3);
    let search = GpuBruteForceMesh::build(gpu, &mesh).unwrap().within_box().unwrap();
    let most = search.rays_a_submission();
    // Never fewer than keep a card busy.
    let fewest = if gpu.kind() == AdapterKind::Software { 1 << 10 } else { 1 << 16 };
    assert_eq!(most, ((1 << 30) / 400_000).max(fewest));
    // Few of the rays meet the box, so that a software device is not kept for long.
    let bounds = mesh.bounds();
    let ray = |i: usize| {
        let aside = if i % 200 == 7 { 0.0 } else { 2.0 };
        let from = bounds.center() + bounds.extent() * Vec3::new(aside, 0.001 * (i % 97) as f32, 1.0);
        Ray::new(from, -Vec3::Z)
    };
    let rays: Vec<Ray> = (0..most + most / 2).map(ray).collect();
    let hits = search.closest_hits(&rays).unwrap();
    assert_eq!(hits.report.batches, 2);
    assert_eq!(hits.report.stages.iter().filter(|stage| stage.name == "upload").count(), 1);
    let bvh = TriangleBvh::build(&mesh, &BvhSettings::default()).unwrap();
    let expected = bvh.closest_hits(&rays).unwrap();
    let triangles = |hits: &Hits| hits.records().iter().map(|hit| hit.triangle).collect::<Vec<_>>();
    assert!(expected.n_hits() > 5);
    assert_eq!(triangles(&hits), triangles(&expected));
    let all = search.all_hits(&rays).unwrap();
    assert_eq!(all.offsets(), bvh.all_hits(&rays).unwrap().offsets());
}

fn work_is_counted(search: &dyn RaySearch, triangles: u32) {
    let rays = vec![Ray::new(Vec3::new(0.1, 0.2, 5.0), -Vec3::Z); 70];
    let (hits, work) = search.closest_hits_with_work(&rays).unwrap();
    assert_eq!(hits.records(), search.closest_hits(&rays).unwrap().records());
    assert!(work.iter().all(|w| w.triangle_tests == triangles && w.leaf_visits == 1 && w.rope_steps == 0));
}

pub(crate) fn trials() -> Vec<Trial> {
    let gpu_square = |gpu: &Gpu| GpuBruteForceMesh::build(gpu, &square()).unwrap();
    vec![
        trial("bad_meshes_are_refused", bad_meshes_are_refused),
        trial("cpu::single_rays", || single_rays(&BruteForceMesh::build(&square()).unwrap())),
        gpu_trial("gpu::single_rays", move |gpu| single_rays(&gpu_square(gpu))),
        trial("cpu::tiny_and_huge_directions", || tiny_and_huge_directions(&BruteForceMesh::build(&square()).unwrap())),
        gpu_trial("gpu::tiny_and_huge_directions", move |gpu| tiny_and_huge_directions(&gpu_square(gpu))),
        trial("cpu::rays_that_cannot_be_cast", || rays_that_cannot_be_cast(&BruteForceMesh::build(&square()).unwrap())),
        gpu_trial("gpu::rays_that_cannot_be_cast", move |gpu| rays_that_cannot_be_cast(&gpu_square(gpu))),
        trial("cpu::work_is_counted", || {
            let mesh = mesh(MeshKind::Icosphere, 320, 1);
            work_is_counted(&BruteForceMesh::build(&mesh).unwrap(), mesh.triangles.len() as u32);
        }),
        gpu_trial("gpu::work_is_counted", |gpu| {
            let mesh = mesh(MeshKind::Icosphere, 320, 1);
            work_is_counted(&GpuBruteForceMesh::build(gpu, &mesh).unwrap(), mesh.triangles.len() as u32);
        }),
        gpu_trial("gpu::long_casts_go_in_several_submissions", long_casts_go_in_several_submissions),
        gpu_trial(
            "gpu::a_ray_that_takes_too_many_rounds_is_never_cut_silently",
            a_ray_that_takes_too_many_rounds_is_never_cut_silently,
        ),
        gpu_trial("gpu::memory_that_runs_out_is_an_error_at_every_allocation", |gpu| {
            let gpu = own_context(gpu);
            let search = GpuBruteForceMesh::build(&gpu, &square()).unwrap();
            let rays = vec![Ray::new(Vec3::new(1.5, 0.5, 3.0), -Vec3::Z); 300];
            let refused = refuse_each(&gpu, "closest", || search.closest_hits(&rays), |hits| hits.n_hits() == 300);
            assert!(refused > 2);
            let refused = refuse_each(&gpu, "all", || search.all_hits(&rays), |lists| lists.records().len() == 300);
            assert!(refused > 4);
        }),
    ]
}
