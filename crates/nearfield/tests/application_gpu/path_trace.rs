//! The path tracer of the device against that of the CPU: the same samples, the same picture up to rounding.

use libtest_mimic::Trial;
use nearfield::application::PointLight;
use nearfield::gpu::Gpu;
use nearfield::structure::GpuRayStructure;
use nearfield::{
    BruteForceMesh, BvhSettings, Film, GpuBruteForceMesh, GpuKdTree, GpuPathTracer, GpuTriangleBvh, KdTreeSettings,
    PathSettings, PathTracer, Scene, Vec3,
};

use crate::scenes;
use crate::support::gpu_trial;

const SIDE: u32 = 40;
const SAMPLES: u32 = 4;

/// Every material and every kind of light.
fn everything() -> Scene {
    let position = Vec3::new(400.0, 300.0, 100.0);
    let lights = vec![PointLight { position, intensity: Vec3::new(2e4, 4e4, 4e4) }];
    Scene { lights, ..scenes::everything() }
}

fn on_cpu(scene: &Scene, settings: PathSettings, samples: u32) -> Film {
    let structure = BruteForceMesh::build(&scene.mesh).unwrap();
    let mut tracer = PathTracer::new(scene.clone(), &structure, settings).unwrap();
    let mut film = Film::new(SIDE, SIDE).unwrap();
    (0..samples).for_each(|_| tracer.render_pass(&mut film).unwrap());
    film
}

fn on_gpu(gpu: &Gpu, scene: &Scene, settings: PathSettings, samples: u32) -> Film {
    render_over(&GpuBruteForceMesh::build(gpu, &scene.mesh).unwrap(), scene, settings, samples)
}

fn render_over<S: GpuRayStructure>(structure: &S, scene: &Scene, settings: PathSettings, samples: u32) -> Film {
    let mut tracer = GpuPathTracer::new(scene.clone(), structure, settings, SIDE, SIDE).unwrap();
    (0..samples).for_each(|_| tracer.render_pass().unwrap());
    assert_eq!(tracer.samples(), samples);
    tracer.film().unwrap()
}

/// The share of pixels farther apart than rounding carries, and the relative difference of the means.
///
/// A sample is a product of some ten factors a scattering, each off by a few 2⁻²⁴, and geometry adds 2⁻¹⁸ of the scene
/// to places: a relative 1e-3 of a pixel covers both. What differs more has a choice that fell the other way.
fn difference(a: &Film, b: &Film) -> (f64, f64) {
    let far = |(x, y): (&Vec3, &Vec3)| (*x - *y).abs().max_element() > 1e-3 * x.max(*y).max_element();
    let differ = a.sums().iter().zip(b.sums()).filter(|pair| far(*pair)).count();
    let mean = |film: &Film| film.sums().iter().map(|s| f64::from(s.x + s.y + s.z)).sum::<f64>();
    (differ as f64 / a.sums().len() as f64, (mean(a) / mean(b) - 1.0).abs())
}

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials: Vec<Trial> = vec![gpu_trial("a_planted_difference_is_seen", |_| {
        let scene = Scene::cornell_box();
        let film = on_cpu(&scene, PathSettings::default(), 1);
        let other = on_cpu(&scene, PathSettings { seed: 1, ..PathSettings::default() }, 1);
        assert!(difference(&film, &other).0 > 0.5);
        assert_eq!(difference(&film, &film), (0.0, 0.0));
    })];
    type Case = (&'static str, fn() -> Scene, PathSettings);
    let plain = PathSettings::default();
    let cases: [Case; 5] = [
        ("cornell_box", Scene::cornell_box, plain),
        ("everything", everything, plain),
        ("everything_without_light_samples", everything, PathSettings { next_event: false, ..plain }),
        ("everything_direct", everything, PathSettings { depth: 1, ..plain }),
        ("lights_alone", everything, PathSettings { depth: 0, ..plain }),
    ];
    for (name, scene, settings) in cases {
        trials.push(gpu_trial(format!("{name}_on_the_device_is_that_of_the_cpu"), move |gpu| {
            let scene = scene();
            let (here, there) = (on_cpu(&scene, settings, SAMPLES), on_gpu(gpu, &scene, settings, SAMPLES));
            assert_eq!((there.samples(), there.dropped()), (SAMPLES, 0));
            let (differ, mean) = difference(&here, &there);
            println!("{name}: {differ:.4} of the pixels differ, the mean by {mean:.2e}");
            assert!(differ <= 0.02 && mean <= 5e-3, "{differ} of the pixels differ, the mean by {mean}");
        }));
    }
    trials.push(gpu_trial("every_structure_of_the_device_gives_the_picture_of_the_cpu", |gpu| {
        let (scene, settings) = (everything(), PathSettings::default());
        let expected = on_cpu(&scene, settings, SAMPLES);
        let kd_tree = GpuKdTree::build(gpu, &scene.mesh, &KdTreeSettings::default()).unwrap();
        let bvh = GpuTriangleBvh::build(gpu, &scene.mesh, &BvhSettings::default()).unwrap();
        let films = [render_over(&kd_tree, &scene, settings, SAMPLES), render_over(&bvh, &scene, settings, SAMPLES)];
        for (film, name) in films.iter().zip(["kd-tree", "triangle-bvh"]) {
            let (differ, mean) = difference(&expected, film);
            println!("{name}: {differ:.4} of the pixels differ, the mean by {mean:.2e}");
            assert!(differ <= 0.02 && mean <= 5e-3, "{name}: {differ} of the pixels differ, the mean by {mean}");
        }
    }));
    trials.push(gpu_trial("rays_are_counted_as_on_the_cpu", |gpu| {
        let scene = everything();
        let structure = BruteForceMesh::build(&scene.mesh).unwrap();
        let mut here = PathTracer::new(scene.clone(), &structure, PathSettings::default()).unwrap();
        here.render_pass(&mut Film::new(SIDE, SIDE).unwrap()).unwrap();
        let structure = GpuBruteForceMesh::build(gpu, &scene.mesh).unwrap();
        let mut there = GpuPathTracer::new(scene, &structure, PathSettings::default(), SIDE, SIDE).unwrap();
        there.render_pass().unwrap();
        let (here, there) = (here.counters(), there.counters());
        // A path that differs by rounding has other rays.
        let close = |a: u64, b: u64| a.abs_diff(b) <= a / 100;
        assert_eq!(here.paths, there.paths);
        assert!(close(here.rays, there.rays) && close(here.shadow_rays, there.shadow_rays), "{here:?} {there:?}");
    }));
    trials
}
