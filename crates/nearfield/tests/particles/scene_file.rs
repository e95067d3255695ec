//! Scene files by hand: what they give, and what they are refused for.

use libtest_mimic::Trial;
use nearfield::application::particles::{
    Collider, Dimensions, PairRule, ParticleModel, SmoothingKernel, TimeStep, parse_particle_scene, read_particle_scene,
};
use nearfield::{DVec3, Error};

use crate::support::trial;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("a_scene_file_places_blocks_and_walls", fluids_are_placed),
        trial("a_scene_file_of_grains_has_classes_and_a_collider", grains_are_placed),
        trial("every_model_has_its_keys", models_have_keys),
        trial("scene_files_that_are_wrong_say_where_and_why", wrong_files),
        trial("rules_and_smoothing_kernels_are_named", choices_have_names),
        trial("scene_files_are_named_in_errors", files_are_named),
    ]
}

const WATER: &str = r#"
name = "tank"
domain = { low = [0, 0, 0], high = [4, 3, 1] }
gravity = [0.0, -1.0, 0.0]
time_step = { factor = 0.4, least = 1e-6, most = 0.01 }

[model]
kind = "pbf"
spacing = 0.1
rest_density = 998.0
iterations = 5

[[box]]
low = [0, 0, 0]
high = [1, 2, 1]
velocity = [1, 0, 0]

[[ball]]
center = [3, 2, 0.5]
radius = 0.05

[[wall]]
low = [0, 0, 0]
high = [4, 3, 1]
"#;

fn fluids_are_placed() {
    let scene = parse_particle_scene(WATER).expect("a sound scene");
    assert_eq!((scene.name.as_str(), scene.dimensions), ("tank", Dimensions::Three));
    assert_eq!(scene.domain, [DVec3::ZERO, DVec3::new(4.0, 3.0, 1.0)]);
    assert_eq!(scene.gravity, DVec3::NEG_Y);
    assert_eq!(scene.time_step, TimeStep::Cfl { factor: 0.4, least: 1e-6, most: 0.01 });
    assert_eq!(scene.particles.len(), 10 * 20 * 10 + 1);
    assert_eq!((scene.particles.velocities[0], scene.particles.velocities[2000]), (DVec3::X, DVec3::ZERO));
    assert_eq!(scene.particles.positions[2000], DVec3::new(3.0, 2.0, 0.5));
    assert_eq!(scene.boundary.len(), 42 * 32 * 12 - 40 * 30 * 10);
    let ParticleModel::Pbf(pbf) = &scene.model else { panic!("{:?}", scene.model) };
    assert_eq!((pbf.fluid.spacing, pbf.fluid.support, pbf.fluid.rest_density), (0.1, 0.2, 998.0));
    assert_eq!((pbf.iterations, pbf.most_iterations), (5, 5));
}

fn grains_are_placed() {
    let scene = parse_particle_scene(
        r#"
        dimensions = 2
        domain = { low = [-1, -1, 0], high = [1, 1, 0] }
        time_step = 0.5
        [model]
        kind = "dem"
        radii = [0.1, 0.05]
        pair_rule = "symmetric"
        spring = 0.25
        collider = { center = [0, -1, 0], radius = 0.3 }
        [[box]]
        low = [-1, 0, 0]
        high = [0, 1, 0]
        [[box]]
        low = [0, 0, 0]
        high = [1, 1, 0]
        class = 1
        "#,
    )
    .expect("a sound scene");
    // Two radii apart: 5 × 5 of the first class, 10 × 10 of the second.
    let count = |class: u8| scene.particles.classes.iter().filter(|&&own| own == class).count();
    assert_eq!((count(0), count(1)), (25, 100));
    assert!(scene.particles.positions.iter().all(|p| p.z == 0.0));
    let ParticleModel::Dem(dem) = &scene.model else { panic!("{:?}", scene.model) };
    assert_eq!((dem.pair_rule, dem.spring, dem.damping), (PairRule::Symmetric, 0.25, 0.02));
    assert_eq!(dem.collider, Some(Collider { center: DVec3::NEG_Y, radius: 0.3 }));
}

fn with_model(model: &str) -> String {
    format!("domain = {{ low = [0, 0, 0], high = [1, 1, 1] }}\ntime_step = 0.01\n[model]\n{model}\n")
}

fn models_have_keys() {
    let text =
        with_model("kind = 'wcsph'\nspacing = 0.1\nsound_speed = 30.0\nsmoothing = 'cubic-spline'\nexponent = 1.0");
    let Ok(ParticleModel::Wcsph(wcsph)) = parse_particle_scene(&text).map(|scene| scene.model) else {
        panic!("{text}")
    };
    assert_eq!((wcsph.sound_speed, wcsph.exponent, wcsph.smoothing), (30.0, 1.0, SmoothingKernel::CubicSpline));
    let text = with_model("kind = 'dfsph'\nspacing = 0.1\nsupport = 0.25\nmost_iterations = 7\nviscosity = 0.01");
    let Ok(ParticleModel::Dfsph(dfsph)) = parse_particle_scene(&text).map(|scene| scene.model) else {
        panic!("{text}")
    };
    assert_eq!((dfsph.fluid.support, dfsph.most_iterations, dfsph.viscosity), (0.25, 7, 0.01));
}

fn wrong_files() {
    // What is changed in the sound file, and what is said.
    let changed = [
        ("name = \"tank\"", "nmae = \"tank\"", ":2:"),
        ("spacing = 0.1", "spacing = 0.1\nmass = -1.0", "mass"),
        ("spacing = 0.1", "spacing = 0.1\nmass = -1.0", ":10:"),
        ("velocity = [1, 0, 0]", "mass = -1.0", ":16:"),
        ("spacing = 0.1", "spacing = 'wide'", ":9:"),
        ("spacing = 0.1", "spacing = -0.1", "spacing"),
        ("spacing = 0.1", "", "no spacing of a pbf model"),
        ("rest_density = 998.0", "rest_density = -998.0", "rest density"),
        ("rest_density = 998.0", "rest_density = nan", "rest density"),
        ("rest_density = 998.0", "sound_speed = 20.0", "sound_speed of a pbf model"),
        ("kind = \"pbf\"", "kind = \"water\"", ":8:"),
        ("iterations = 5", "iterations = 0", "iterations"),
        ("iterations = 5", "iterations = 2.5", ":11:"),
        ("least = 1e-6", "least = 1.0", "time step"),
        ("factor = 0.4, ", "", ":5:"),
        ("gravity = [0.0, -1.0, 0.0]", "gravity = [0.0, -1.0]", ":4:"),
        ("gravity = [0.0, -1.0, 0.0]", "gravity = [0.0, inf, 0.0]", "gravity"),
        ("gravity = [0.0, -1.0, 0.0]", "dimensions = 4", "dimensions = 4"),
        ("high = [4, 3, 1] }\ngravity", "high = [0, 3, 1] }\ngravity", "domain"),
        ("velocity = [1, 0, 0]", "class = 3", "class = 3"),
        ("velocity = [1, 0, 0]", "class = -1", ":16:"),
        ("velocity = [1, 0, 0]", "spacing = 0.0", "spacing"),
        ("velocity = [1, 0, 0]", "spacing = 1e-9", "particles"),
        ("velocity = [1, 0, 0]", "velocity = [nan, 0, 0]", "velocities"),
        ("high = [1, 2, 1]", "high = [1, 9, 1]", "outside"),
        ("radius = 0.05", "radius = -0.05", "radius"),
        ("center = [3, 2, 0.5]", "center = [nan, 2, 0.5]", "center"),
        ("[[wall]]\nlow = [0, 0, 0]", "[[wall]]\nlow = [9, 0, 0]", "[[wall]]"),
        ("[[wall]]", "[[walls]]", "walls"),
    ];
    for (old, new, told) in changed {
        assert!(WATER.contains(old), "{old}");
        let error = parse_particle_scene(&WATER.replace(old, new)).expect_err(new).to_string();
        assert!(error.contains(told), "{new}: expected {told:?} in {error}");
    }
    for (model, told) in [
        ("kind = 'dem'", "no radii"),
        ("kind = 'dem'\nradii = []", "radii"),
        ("kind = 'dem'\nradii = [0.1, -0.1]", "radius"),
        ("kind = 'dem'\nradii = [0.1]\nspacing = 0.1", "spacing of a dem model"),
        ("kind = 'wcsph'\nspacing = 0.1", "no sound_speed"),
        ("kind = 'dfsph'\nspacing = 0.1\nsmoothing = 'gauss'", ":6:"),
        ("kind = 'dfsph'\nspacing = 0.1\nsmoothing = 'gauss'", "cubic-spline, wendland, poly6 or spiky"),
        ("kind = 'dfsph'\nspacing = 0.1\nsmoothing = 3", ":6:"),
        ("kind = 'dem'\nradii = [0.1]\npair_rule = 'touch'", ":6:"),
        ("kind = 'dem'\nradii = [0.1]\npair_rule = 'touch'", "contact, symmetric or gather"),
        ("kind = 'dem'\nradii = [0.1]\n[[wall]]\nlow = [0, 0, 0]\nhigh = [1, 1, 1]", "[[wall]]"),
    ] {
        let error = parse_particle_scene(&with_model(model)).expect_err(model).to_string();
        assert!(error.contains(told), "{model}: expected {told:?} in {error}");
    }
    for text in ["", "domain = 3", "\u{0}", "[model]\nkind = 'pbf'"] {
        assert!(matches!(parse_particle_scene(text), Err(Error::File(_))), "{text:?}");
    }
    // A step of no length is refused, and so is none.
    for step in ["0.0", "-0.1", "nan", "'short'"] {
        let text =
            with_model("kind = 'pbf'\nspacing = 0.1").replace("time_step = 0.01", &format!("time_step = {step}"));
        let error = parse_particle_scene(&text).expect_err(step).to_string();
        assert!(error.contains("step") || error.contains("table with factor"), "{step}: {error}");
    }
}

fn choices_have_names() {
    for rule in PairRule::ALL {
        assert_eq!(rule.to_string().parse::<PairRule>().expect("a name"), rule);
    }
    for kernel in SmoothingKernel::ALL {
        assert_eq!(kernel.to_string().parse::<SmoothingKernel>().expect("a name"), kernel);
    }
    for error in ["Contact".parse::<PairRule>().map(drop), "".parse::<SmoothingKernel>().map(drop)] {
        assert!(matches!(error, Err(Error::InvalidSetting { .. })), "{error:?}");
    }
}

fn files_are_named() {
    let folder = std::env::temp_dir().join(format!("nearfield-particle-scenes-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join("basin.toml");
    std::fs::write(&path, WATER.replace("name = \"tank\"", "")).expect("a file");
    assert_eq!(read_particle_scene(&path).expect("a sound scene").name, "basin");
    std::fs::write(&path, "domain = [").expect("a file");
    let error = read_particle_scene(&path).expect_err("no TOML").to_string();
    assert!(error.contains("basin.toml"), "{error}");
    std::fs::remove_dir_all(&folder).expect("a folder");
    assert!(matches!(read_particle_scene(&path), Err(Error::Io { .. })));
}
