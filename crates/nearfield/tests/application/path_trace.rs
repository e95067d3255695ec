//! The path tracer against what is known of light: furnaces that must not change it, an independent tracer of the
//! Cornell box, and the same picture whatever the number of threads, the structure and the way of sampling.

use nearfield::application::{EnvironmentImage, PathCounters, PointLight};
use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::{
    BruteForceMesh, BvhSettings, Camera, Environment, Error, Film, KdTraversal, KdTree, KdTreeSettings, Material,
    PathSettings, PathTracer, Ray, RaySearch, Scene, Surface, TriMesh, TriangleBvh,
};
use nearfield::{DVec3, Vec3};

use crate::scenes::everything;

fn render(scene: &Scene, settings: PathSettings, width: u32, height: u32, samples: u32) -> (Film, PathCounters) {
    let structure = BruteForceMesh::build(&scene.mesh).unwrap();
    render_over(&structure, scene, settings, width, height, samples)
}

fn render_over(
    structure: &dyn RaySearch,
    scene: &Scene,
    settings: PathSettings,
    width: u32,
    height: u32,
    samples: u32,
) -> (Film, PathCounters) {
    let mut tracer = PathTracer::new(scene.clone(), structure, settings).unwrap();
    let mut film = Film::new(width, height).unwrap();
    for _ in 0..samples {
        tracer.render_pass(&mut film).unwrap();
    }
    assert_eq!(film.dropped(), 0);
    (film, tracer.counters())
}

/// Mean of all pixels and channels.
fn mean_of(film: &Film) -> f64 {
    let sum: f64 = film.sums().iter().map(|s| f64::from(s.x) + f64::from(s.y) + f64::from(s.z)).sum();
    sum / (3.0 * film.sums().len() as f64 * f64::from(film.samples()))
}

/// Mean of several independent numbers, and the standard error of that mean.
fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

/// The mean picture value over pictures of independent seeds.
fn mean_over_seeds(scene: &Scene, settings: PathSettings, side: u32, samples: u32, seeds: u32) -> (f64, f64) {
    let mean = |seed| mean_of(&render(scene, PathSettings { seed, ..settings }, side, side, samples).0);
    mean_and_error(&(1..=seeds).map(mean).collect::<Vec<_>>())
}

/// A convex mesh seen from near, in light of radiance 1 from everywhere: every pixel shows 1 if nothing is lost.
fn furnace(kind: MeshKind, surface: Surface) -> Scene {
    let mut scene = Scene::of_mesh(mesh(kind, 80, 0), Material::new(surface));
    let bounds = scene.bounds();
    scene.camera.position = bounds.center() + 0.75 * bounds.diagonal() * Vec3::new(0.3, 0.5, 0.81).normalize();
    scene.camera.target = bounds.center();
    scene
}

/// Asserts that a furnace shows `1` within 3σ, with a σ that makes this say something.
fn assert_white(scene: &Scene, settings: PathSettings, what: &str) {
    let (mean, error) = mean_over_seeds(scene, settings, 24, 16, 12);
    assert!(error < 2e-3, "{what}: σ = {error}");
    // Rounding of 1 + 16 sums of f32 is far below 1e-5.
    assert!((mean - 1.0).abs() <= 3.0 * error + 1e-5, "{what}: {mean} ± {error}");
}

#[test]
fn a_white_lambert_body_vanishes_in_a_white_furnace() {
    let white = Surface::Lambert { albedo: Vec3::ONE };
    for kind in [MeshKind::Icosphere, MeshKind::Cube] {
        for next_event in [true, false] {
            let settings = PathSettings { next_event, ..PathSettings::default() };
            assert_white(&furnace(kind, white), settings, &format!("{kind:?}, next event {next_event}"));
        }
    }
}

#[test]
fn mirrors_and_clear_glass_vanish_in_a_white_furnace() {
    let mirror = Surface::Mirror { reflectance: Vec3::ONE };
    assert_white(&furnace(MeshKind::Icosphere, mirror), PathSettings::default(), "mirror");
    let glass = Surface::Dielectric { ior: 1.5, tint: Vec3::ONE };
    // Light that is reflected inside takes many scatterings to get out.
    let settings = PathSettings { depth: 1000, ..PathSettings::default() };
    assert_white(&furnace(MeshKind::Icosphere, glass), settings, "glass");
    let bubble = Surface::Dielectric { ior: 1.0 / 1.5, tint: Vec3::ONE };
    assert_white(&furnace(MeshKind::Icosphere, bubble), settings, "bubble");
}

#[test]
fn half_white_bodies_show_half_where_they_are_and_glossy_ones_no_more_than_all() {
    let scene = furnace(MeshKind::Icosphere, Surface::Lambert { albedo: Vec3::splat(0.5) });
    let film = render(&scene, PathSettings::default(), 24, 24, 64).0;
    let radiance = film.radiance();
    let (center, corner) = (radiance[12 * 24 + 12], radiance[0]);
    assert!((center.x - 0.5).abs() < 0.05 && corner == Vec3::ONE, "{center} {corner}");
    for (metallic, roughness) in [(1.0, 0.0), (1.0, 0.2), (1.0, 1.0), (0.0, 0.1), (0.0, 0.8), (0.5, 0.5)] {
        let scene = furnace(MeshKind::Icosphere, Surface::Ggx { color: Vec3::ONE, metallic, roughness });
        let (mean, error) = mean_over_seeds(&scene, PathSettings::default(), 24, 16, 8);
        assert!(mean <= 1.0 + 3.0 * error + 1e-5, "metallic {metallic}, roughness {roughness}: {mean} ± {error}");
        // What is lost between microfacets: more than half of it for the roughest metal, as the integral of the formula says.
        assert!(mean > 0.4, "metallic {metallic}, roughness {roughness}: {mean}");
        // With light samples or without, in all of them.
        let plain = PathSettings { next_event: false, ..PathSettings::default() };
        let (other, other_error) = mean_over_seeds(&scene, plain, 24, 16, 8);
        let sigma = error.hypot(other_error);
        assert!((mean - other).abs() <= 4.0 * sigma + 1e-5, "metallic {metallic}, {roughness}: {mean} {other}");
    }
}

/// A path tracer of its own: f64, another generator, hits of one ray at a time, scattered rays alone, no weights.
struct Reference<'a> {
    scene: &'a Scene,
    structure: &'a BruteForceMesh,
    state: u64,
}

impl Reference<'_> {
    fn number(&mut self) -> f64 {
        // SplitMix64.
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn path(&mut self, depth: u32) -> f64 {
        let camera = &self.scene.camera;
        let forward = (camera.target - camera.position).as_dvec3().normalize();
        let right = forward.cross(camera.up.as_dvec3()).normalize();
        let up = right.cross(forward);
        let reach = (0.5 * f64::from(camera.vertical_fov).to_radians()).tan();
        let (x, y) = (2.0 * self.number() - 1.0, 2.0 * self.number() - 1.0);
        let mut direction = (forward + reach * (x * right + y * up)).normalize();
        let mut origin = camera.position.as_dvec3();
        let (mut throughput, mut light) = (DVec3::ONE, DVec3::ZERO);
        for scattered in 0..=depth {
            let ray = Ray::new(origin.as_vec3(), direction.as_vec3());
            let Some(hit) = self.structure.closest_hit(&ray).unwrap() else { break };
            let material = &self.scene.materials[self.scene.material_of[hit.triangle as usize] as usize];
            let normal = hit.normal.as_dvec3().normalize();
            let front = normal.dot(direction) < 0.0;
            if front {
                light += throughput * material.emission.as_dvec3();
            }
            if scattered == depth {
                break;
            }
            let Surface::Lambert { albedo } = material.surface else { panic!("only matte surfaces") };
            throughput *= albedo.as_dvec3();
            if scattered >= 2 {
                let survives = throughput.max_element();
                if self.number() >= survives {
                    break;
                }
                throughput /= survives;
            }
            let normal = if front { normal } else { -normal };
            // A point of the unit sphere on top of the normal is distributed by the cosine.
            let z = 2.0 * self.number() - 1.0;
            let angle = std::f64::consts::TAU * self.number();
            let sine = (1.0 - z * z).sqrt();
            direction = (normal + DVec3::new(sine * angle.cos(), sine * angle.sin(), z)).normalize();
            origin = hit.position.as_dvec3() + 1e-2 * normal;
        }
        (light.x + light.y + light.z) / 3.0
    }

    /// Mean over paths and its standard error.
    fn mean(&mut self, depth: u32, paths: u64) -> (f64, f64) {
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..paths {
            let value = self.path(depth);
            sum += value;
            squares += value * value;
        }
        let mean = sum / paths as f64;
        (mean, ((squares / paths as f64 - mean * mean) / paths as f64).sqrt())
    }
}

/// Mean of the Cornell box by the reference, on two threads of different seeds.
fn cornell_by_reference(depth: u32, paths: u64, seeds: [u64; 2]) -> (f64, f64) {
    let scene = Scene::cornell_box();
    let structure = BruteForceMesh::build(&scene.mesh).unwrap();
    let parts: Vec<(f64, f64)> = std::thread::scope(|scope| {
        let part = |state| {
            let (scene, structure) = (&scene, &structure);
            scope.spawn(move || Reference { scene, structure, state }.mean(depth, paths / 2))
        };
        seeds.map(part).map(|thread| thread.join().unwrap()).to_vec()
    });
    (0.5 * (parts[0].0 + parts[1].0), 0.5 * parts[0].1.hypot(parts[1].1))
}

/// Mean of the Cornell box and its standard error, by 60 million paths of the reference: printed by
/// `the_reference_of_the_cornell_box`.
const CORNELL: (f64, f64) = (0.1209785, 0.0001335);

#[test]
fn the_cornell_box_is_as_bright_as_an_independent_tracer_makes_it() {
    let scene = Scene::cornell_box();
    let (mean, error) = mean_over_seeds(&scene, PathSettings::default(), 32, 64, 16);
    let (reference, reference_error) = CORNELL;
    let sigma = error.hypot(reference_error);
    assert!(3.0 * sigma <= 0.005 * reference, "3σ = {} is too wide for 0.5 % of {reference}", 3.0 * sigma);
    assert!((mean - reference).abs() <= 3.0 * sigma, "{mean} ± {error}, reference {reference} ± {reference_error}");
    // The tracer that made the number is the one above.
    let (again, again_error) = cornell_by_reference(10, 1_000_000, [11, 12]);
    let sigma = again_error.hypot(reference_error);
    assert!((again - reference).abs() <= 4.0 * sigma, "{again} ± {again_error}, reference {reference}");
}

#[test]
#[ignore = "a minute and a half; prints the number that the test above holds"]
fn the_reference_of_the_cornell_box() {
    let (mean, error) = cornell_by_reference(10, 60_000_000, [1, 1 << 60]);
    println!("({mean:.7}, {error:.7})");
    assert!((mean - CORNELL.0).abs() < 1e-7);
}

#[test]
fn light_samples_change_the_noise_and_not_the_picture() {
    // Both estimate the same; four times the difference of two σ is passed once in 16,000.
    for (name, scene) in [
        ("everything", everything()),
        ("furnace", furnace(MeshKind::Torus, Surface::Lambert { albedo: Vec3::splat(0.8) })),
    ] {
        let settings = PathSettings { depth: 6, ..PathSettings::default() };
        let (with, with_error) = mean_over_seeds(&scene, settings, 32, 16, 24);
        let without = PathSettings { next_event: false, ..settings };
        let (without, without_error) = mean_over_seeds(&scene, without, 32, 64, 24);
        let sigma = with_error.hypot(without_error);
        println!("{name}: {with:.6} ± {with_error:.6} with, {without:.6} ± {without_error:.6} without");
        assert!(sigma < 0.01 * with, "{name}: σ = {sigma} of {with}");
        assert!((with - without).abs() <= 4.0 * sigma, "{name}: {with} ± {with_error}, {without} ± {without_error}");
    }
}

#[test]
fn roulette_changes_the_noise_and_not_the_picture() {
    let scene = everything();
    let long = PathSettings { depth: 12, roulette_depth: 1, ..PathSettings::default() };
    let (with, with_error) = mean_over_seeds(&scene, long, 32, 16, 24);
    let never = PathSettings { roulette_depth: u32::MAX, ..long };
    let (without, without_error) = mean_over_seeds(&scene, never, 32, 16, 24);
    let sigma = with_error.hypot(without_error);
    assert!(sigma < 0.01 * with && (with - without).abs() <= 4.0 * sigma, "{with} {without} ± {sigma}");
}

#[test]
fn a_point_light_over_a_floor_gives_what_the_formula_says() {
    let floor = [[-50.0, 0.0, -50.0], [-50.0, 0.0, 50.0], [50.0, 0.0, 50.0], [50.0, 0.0, -50.0]].map(Vec3::from_array);
    let floor = TriMesh::new(floor.to_vec(), vec![[0, 1, 2], [0, 2, 3]]).unwrap();
    let mut scene = Scene::of_mesh(floor, Material::lambert(Vec3::new(0.8, 0.4, 0.2)));
    scene.environment = Environment::NONE;
    scene.lights = vec![PointLight { position: Vec3::new(0.0, 2.0, 0.0), intensity: Vec3::splat(10.0) }];
    let target = Vec3::new(1.5, 0.0, 0.0);
    scene.camera = Camera { position: Vec3::new(1.5, 3.0, 4.0), target, up: Vec3::Y, vertical_fov: 0.01 };
    let radiance = render(&scene, PathSettings::default(), 1, 1, 4).0.radiance()[0];
    // E = I cos θ / d² = 10 · (2 / 2.5) / 6.25, L = albedo E / π.
    let expected = Vec3::new(0.8, 0.4, 0.2) * (10.0 * 0.8 / 6.25 / std::f32::consts::PI);
    assert!((radiance - expected).abs().max_element() < 1e-3 * expected.x, "{radiance} {expected}");
}

#[test]
fn the_same_picture_comes_from_any_number_of_threads_and_again() {
    let scene = everything();
    // More than one tile of paths.
    let picture = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| render(&scene, PathSettings::default(), 240, 160, 2).0)
    };
    let one = picture(1);
    for threads in [1, 2, 3, 8] {
        assert_eq!(picture(threads), one, "{threads} threads");
    }
    let other = PathSettings { seed: 1, ..PathSettings::default() };
    assert_ne!(render(&scene, other, 240, 160, 2).0, one);
}

#[test]
fn every_structure_gives_the_same_picture_bit_for_bit() {
    let scene = everything();
    let brute = BruteForceMesh::build(&scene.mesh).unwrap();
    let expected = render_over(&brute, &scene, PathSettings::default(), 64, 64, 2).0;
    for structure in ray_structures(&scene.mesh) {
        let film = render_over(&*structure, &scene, PathSettings::default(), 64, 64, 2).0;
        assert_eq!(film, expected, "{}", structure.structure());
    }
}

/// Every structure of the CPU that rays can be cast into, in every way it is searched.
fn ray_structures(mesh: &TriMesh) -> Vec<Box<dyn RaySearch>> {
    let kd_tree = KdTree::build(mesh, &KdTreeSettings::default()).unwrap();
    vec![
        Box::new(BruteForceMesh::build(mesh).unwrap().within_box()),
        Box::new(kd_tree.clone().with_traversal(KdTraversal::Stack)),
        Box::new(kd_tree.with_traversal(KdTraversal::Ropes)),
        Box::new(TriangleBvh::build(mesh, &BvhSettings::default()).unwrap()),
    ]
}

#[test]
fn pictures_do_not_depend_on_where_and_how_large_the_scene_is() {
    // The same box, 2^10 times as large, and 2^20 times smaller: powers of two keep every bit of the geometry.
    let scene = Scene::cornell_box();
    let film = render(&scene, PathSettings::default(), 32, 32, 8).0;
    for scale in [1024.0, 1.0 / 1_048_576.0] {
        let mut scaled = scene.clone();
        for vertex in &mut scaled.mesh.vertices {
            *vertex *= scale;
        }
        scaled.camera.position *= scale;
        scaled.camera.target *= scale;
        assert_eq!(render(&scaled, PathSettings::default(), 32, 32, 8).0, film, "{scale}");
    }
    // Shifted far enough that coordinates have a fortieth of the digits, nothing leaks or darkens.
    let shift = Vec3::new(20_000.0, -20_000.0, 20_000.0);
    let mut shifted = scene.clone();
    for vertex in &mut shifted.mesh.vertices {
        *vertex += shift;
    }
    shifted.camera.position += shift;
    shifted.camera.target += shift;
    let moved = mean_of(&render(&shifted, PathSettings::default(), 32, 32, 8).0);
    assert!((moved / mean_of(&film) - 1.0).abs() < 2e-3, "{moved} {}", mean_of(&film));
}

#[test]
fn a_closed_box_lets_no_light_out_or_in() {
    // Inside a black-lit cube every pixel is dark however bright the outside is: no ray slips through its edges.
    let mut scene = Scene::of_mesh(mesh(MeshKind::Cube, 1200, 0), Material::lambert(Vec3::splat(0.9)));
    scene.environment = Environment::Constant(Vec3::splat(1e6));
    scene.camera = Camera {
        position: Vec3::new(0.3, 0.4, 0.9),
        target: Vec3::new(0.6, 0.5, 0.1),
        up: Vec3::Y,
        vertical_fov: 110.0,
    };
    let film = render(&scene, PathSettings { depth: 5, ..PathSettings::default() }, 48, 48, 4).0;
    let lit = film.sums().iter().filter(|s| **s != Vec3::ZERO).count();
    assert_eq!(lit, 0, "{lit} of {} pixels see the outside", film.sums().len());
}

#[test]
fn counters_count_what_was_asked() {
    let scene = Scene::cornell_box();
    let (_, direct) = render(&scene, PathSettings { depth: 0, ..PathSettings::default() }, 20, 10, 3);
    assert_eq!((direct.paths, direct.rays, direct.shadow_rays), (600, 600, 0));
    let (_, once) = render(&scene, PathSettings { depth: 1, ..PathSettings::default() }, 20, 10, 3);
    assert!(once.rays > 700 && once.rays <= 1200 && once.shadow_rays > 100 && once.shadow_rays <= 600, "{once:?}");
    assert!(once.mrays_a_second() > 0.0 && once.paths_a_second() > 0.0);
}

#[test]
fn rooms_hold_their_mesh_and_are_lit() {
    let bunny = mesh(MeshKind::Torus, 200, 0);
    let bounds = bunny.bounds();
    let n = bunny.triangles.len();
    let scene = Scene::room_around(bunny, Material::default()).unwrap();
    assert_eq!(scene.mesh.triangles.len(), n + 12);
    let room = scene.bounds();
    assert!(room.contains(bounds.min) && room.contains(bounds.max) && room.min.y == bounds.min.y);
    let film = render(&scene, PathSettings::default(), 24, 24, 8).0;
    let radiance = film.radiance();
    let (left, right) = (radiance[12 * 24 + 1], radiance[12 * 24 + 22]);
    assert!(left.x > 2.0 * left.y && right.y > 2.0 * right.x, "red {left}, green {right}");
    let mean = mean_of(&film);
    assert!((0.1..0.8).contains(&mean), "{mean}");
}

#[test]
fn bad_scenes_are_refused_and_named() {
    let good = Scene::cornell_box();
    let fails = |change: &dyn Fn(&mut Scene)| {
        let mut scene = good.clone();
        change(&mut scene);
        scene.check().unwrap_err().to_string()
    };
    for (message, words) in [
        (fails(&|s| s.material_of[3] = 9), ["material index", "9 asked for", "at most 3"]),
        (fails(&|s| s.material_of.truncate(5)), ["materials of triangles", "5", "32"]),
        (fails(&|s| s.mesh.triangles.clear()), ["no triangles", "vertices", "faces"]),
        (fails(&|s| s.mesh.triangles[1][2] = 1000), ["vertex index", "1000", "63"]),
        (fails(&|s| s.materials[2] = Material::lambert(Vec3::new(0.5, 1.5, 0.0))), ["albedo", "1.5", "material 2"]),
        (fails(&|s| s.materials[0].emission = Vec3::NAN), ["emission", "NaN", "material 0"]),
        (
            fails(&|s| s.materials[1].surface = Surface::Dielectric { ior: 0.0, tint: Vec3::ONE }),
            ["refraction", "0", "material 1"],
        ),
        (
            fails(&|s| {
                s.materials[1].surface = Surface::Ggx { color: Vec3::ONE, metallic: 0.0, roughness: -1.0 };
            }),
            ["roughness", "-1", "material 1"],
        ),
        (
            fails(&|s| s.lights.push(PointLight { position: Vec3::NAN, intensity: Vec3::ONE })),
            ["position", "NaN", "light 0"],
        ),
        (fails(&|s| s.environment = Environment::Constant(Vec3::splat(-1.0))), ["environment", "-1", "from 0"]),
        (
            fails(&|s| {
                let texels = vec![Vec3::ONE; 5];
                s.environment = Environment::Image(EnvironmentImage { width: 2, height: 3, texels });
            }),
            ["texels", "5", "6"],
        ),
        (fails(&|s| s.camera.vertical_fov = 0.0), ["field of view", "0", "between 0 and 180"]),
    ] {
        for word in words {
            assert!(message.contains(word), "{word:?} is not in {message:?}");
        }
    }
    let structure = BruteForceMesh::build(&mesh(MeshKind::Cube, 12, 0)).unwrap();
    let error = PathTracer::new(good.clone(), &structure, PathSettings::default()).err().unwrap();
    assert!(matches!(error, Error::LengthMismatch { found: 12, expected: 32, .. }), "{error}");
    let structure = BruteForceMesh::build(&good.mesh).unwrap();
    let deep = PathSettings { depth: 1001, ..PathSettings::default() };
    assert!(PathTracer::new(good, &structure, deep).err().unwrap().to_string().contains("1001"));
    let empty = Scene::room_around(TriMesh::default(), Material::default()).unwrap_err();
    assert!(matches!(empty, Error::NoTriangles { vertices: 0 }), "{empty}");
}
