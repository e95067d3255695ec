//! Built-in scenes: what stands in them, and what they are refused for.

use libtest_mimic::Trial;
use nearfield::application::particles::{
    BuiltinOptions, Dimensions, FluidModel, PairRule, ParticleModel, ParticleScene, builtin_names, builtin_scene,
    fill_ball, fill_box, line_box,
};
use nearfield::{DVec3, Error};

use crate::support::trial;

const FLUIDS: [&str; 5] = ["dam-break", "double-dam", "drop", "column", "accel-fluid"];
const DIMENSIONS: [Dimensions; 2] = [Dimensions::Two, Dimensions::Three];

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("every_scene_can_be_simulated_and_is_as_large_as_asked", scenes_are_sound),
        trial("fluids_stand_a_spacing_off_their_walls", walls_continue_the_lattice),
        trial("lattices_fill_boxes_and_balls", lattices_fill),
        trial("grains_of_three_radii_stand_as_the_benchmark_says", three_radii),
        trial("scenes_refuse_what_they_do_not_have", wrong_options),
    ]
}

fn scene(name: &str, options: &BuiltinOptions) -> ParticleScene {
    builtin_scene(name, options).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// The smallest distance of two different places.
fn closest(places: &[DVec3]) -> f64 {
    let others = |i: usize| places[..i].iter().map(move |other| places[i].distance(*other));
    (0..places.len()).flat_map(others).fold(f64::INFINITY, f64::min)
}

fn scenes_are_sound() {
    for &name in builtin_names() {
        for particles in [None, Some(2000), Some(30_000)] {
            let scene = scene(name, &BuiltinOptions { particles, ..BuiltinOptions::default() });
            scene.validate().unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(scene.name, name);
            let found = scene.particles.len() as f64;
            let asked = particles.map_or(found, f64::from);
            // A spacing that divides the tank is at most half a particle in its narrow side off.
            assert!((0.6..1.6).contains(&(found / asked)), "{name}: {found} particles for {asked}");
            assert_eq!(scene.boundary.is_empty(), !scene.model.is_fluid(), "{name}");
        }
    }
}

fn walls_continue_the_lattice() {
    for name in FLUIDS {
        for (model, dimensions) in FluidModel::ALL.into_iter().flat_map(|m| DIMENSIONS.map(|d| (m, d))) {
            let options = BuiltinOptions {
                particles: Some(500),
                model: Some(model),
                dimensions: Some(dimensions),
                ..Default::default()
            };
            let scene = scene(name, &options);
            scene.validate().unwrap_or_else(|error| panic!("{name}, {model}: {error}"));
            assert_eq!(scene.model.name(), model.name());
            let spacing = match &scene.model {
                ParticleModel::Pbf(pbf) => pbf.fluid.spacing,
                ParticleModel::Wcsph(wcsph) => wcsph.fluid.spacing,
                ParticleModel::Dfsph(dfsph) => dfsph.fluid.spacing,
                ParticleModel::Dem(_) => panic!("{name} is a fluid"),
            };
            let fluid = &scene.particles.positions;
            let to_walls =
                |place: &DVec3| scene.boundary.iter().map(|wall| wall.distance(*place)).fold(f64::INFINITY, f64::min);
            let nearest = fluid.iter().map(to_walls).fold(f64::INFINITY, f64::min);
            // The lattice goes on in the floor; only where the tank's height is no multiple of the spacing cells of walls are a little
            // narrower.
            assert!((0.7..1.1).contains(&(nearest / spacing)), "{name}, {model}: {nearest} with spacing {spacing}");
            assert!(closest(fluid) > 0.999 * spacing || name == "drop", "{name}, {model}");
        }
    }
}

fn lattices_fill() {
    let (low, high) = (DVec3::new(-1.0, 2.0, 0.5), DVec3::new(1.0, 3.0, 2.0));
    let filled = fill_box(low, high, 0.25, Dimensions::Three);
    assert_eq!(filled.len(), 8 * 4 * 6);
    assert_eq!((filled[0], filled[1].x - filled[0].x), (low + 0.125, 0.25));
    assert!(filled.iter().all(|p| p.cmpgt(low).all() && p.cmplt(high).all()));
    assert_eq!(fill_box(low, high, 0.25, Dimensions::Two).len(), 8 * 4);
    assert!(fill_box(high, low, 0.25, Dimensions::Three).is_empty());
    // Of a ball, as many as lattice places lie in it, by the loop.
    let ball = fill_ball(DVec3::ZERO, 1.0, 0.125, Dimensions::Three);
    let range = || -9..=9;
    let inside = |x: i32, y: i32, z: i32| x * x + y * y + z * z < 64;
    let cells = range().flat_map(|x| range().flat_map(move |y| range().map(move |z| (x, y, z))));
    assert_eq!(ball.len(), cells.filter(|&(x, y, z)| inside(x, y, z)).count());
    assert!(ball.contains(&DVec3::ZERO));
    // One layer around 8 × 4 × 6 cells: the cells of the box that is two wider, less those within.
    let wall = line_box(low, high, 0.25, Dimensions::Three);
    assert_eq!(wall.len(), 10 * 6 * 8 - 8 * 4 * 6);
    assert!((closest(&wall) - 0.25).abs() < 1e-12);
    assert_eq!(line_box(low, high, 0.25, Dimensions::Two).len(), 10 * 6 - 8 * 4);
}

fn three_radii() {
    for part in [0.0025, 0.005, 0.01] {
        let scene = scene("paper-fig20", &BuiltinOptions { radius: Some(part), ..BuiltinOptions::default() });
        let ParticleModel::Dem(dem) = &scene.model else { panic!("grains") };
        let diagonal = 2.0 * 3f64.sqrt();
        for (radius, factor) in dem.radii.iter().zip([3.0, 2.0, 1.0]) {
            assert!((radius / (factor * part * diagonal) - 1.0).abs() < 1e-12);
        }
        for class in 0..3 {
            assert_eq!(scene.particles.classes.iter().filter(|&&own| own == class).count(), 10_000);
        }
        // Large ones above on the left, middle ones above on the right, small ones below both.
        let of = |class: u8| {
            let places = scene.particles.positions.iter().zip(&scene.particles.classes);
            places.filter(move |(_, own)| **own == class).map(|(place, _)| *place).collect::<Vec<DVec3>>()
        };
        let (large, middle, small) = (of(0), of(1), of(2));
        let top = small.iter().map(|p| p.y).fold(f64::NEG_INFINITY, f64::max);
        assert!(large.iter().chain(&middle).all(|p| p.y > top), "part {part}");
        let right = large.iter().map(|p| p.x).fold(f64::NEG_INFINITY, f64::max);
        assert!(middle.iter().all(|p| p.x > right), "part {part}");
        // The law is Green's where all have room, and weaker where they stand closer.
        assert_eq!(dem.spring == 0.5, part == 0.0025, "part {part}: spring {}", dem.spring);
        if part == 0.0025 {
            for (places, spacing) in
                [(large, 3.0 * dem.radii[0]), (middle, 3.0 * dem.radii[1]), (small, 1.8 * dem.radii[2])]
            {
                let found = closest(&places[..2000]);
                // Jitter moves each by up to a hundredth of its radius along each axis.
                assert!((found / spacing - 1.0).abs() < 0.04, "{found}, not {spacing}");
            }
        }
    }
}

fn wrong_options() {
    let refused = |name: &str, options: BuiltinOptions| match builtin_scene(name, &options) {
        Err(Error::InvalidSetting { setting, .. }) => setting,
        other => panic!("{name}: {other:?}"),
    };
    let usual = BuiltinOptions::default();
    assert_eq!(refused("no-scene", usual), "scene");
    assert_eq!(refused("dem-box", BuiltinOptions { model: Some(FluidModel::Pbf), ..usual }), "model");
    assert_eq!(refused("dem-box", BuiltinOptions { dimensions: Some(Dimensions::Two), ..usual }), "dimensions");
    assert_eq!(refused("drop", BuiltinOptions { pair_rule: Some(PairRule::Gather), ..usual }), "pair rule");
    assert_eq!(refused("drop", BuiltinOptions { radius: Some(0.01), ..usual }), "radius");
    for radius in [0.0, -1.0, 0.5, f64::NAN] {
        assert_eq!(refused("paper-fig20", BuiltinOptions { radius: Some(radius), ..usual }), "radius");
    }
    for particles in [0, u32::MAX] {
        assert_eq!(refused("column", BuiltinOptions { particles: Some(particles), ..usual }), "particles");
    }
    assert!("grains".parse::<FluidModel>().is_err() && "pbf".parse::<FluidModel>().is_ok());
}
