//! Grains against a table of an independent program, and what they conserve.

use nearfield::application::Watch;
use nearfield::application::particles::{
    BuiltinOptions, DemSettings, Dimensions, Measures, ParticleModel, ParticleScene, ParticleSearch, Particles,
    Simulate, Simulation, SimulationSettings, TimeStep, builtin_scene,
};
use nearfield::{DVec3, Error, RebuildPolicy};

/// Contacts, mean height, kinetic energy a particle, highest speed after so many steps of Green2010's start with 16,384 grains, by a program
/// of its own in double precision that compares all pairs.
const GOLDEN: [(u32, u64, f64, f64, f64); 6] = [
    (1, 23_851, -0.596_846, 1.594_909e-8, 0.000_35),
    (10, 26_849, -0.600_515, 9.301_988e-7, 0.001_63),
    (50, 32_119, -0.659_663, 1.035_629e-5, 0.007_46),
    (100, 48_863, -0.771_646, 1.923_096e-5, 0.012_97),
    (200, 33_340, -0.869_467, 3.359_957e-5, 0.015_22),
    (300, 30_996, -0.922_558, 2.812_795e-5, 0.017_53),
];

fn of(simulation: &Simulation) -> Measures {
    simulation.measure().expect("a simulation on the CPU should be measured")
}

#[test]
fn golden_table_of_green_is_met() {
    let scene = builtin_scene("dem-box", &BuiltinOptions::default()).expect("a built-in scene");
    let mut simulation =
        Simulation::new(&scene, &SimulationSettings::default()).expect("a scene that can be simulated");
    for (step, contacts, height, energy, speed) in GOLDEN {
        let steps = step - simulation.step() as u32;
        let reports = simulation.advance(steps, &mut Watch::none()).expect("steps");
        let measures = of(&simulation);
        let n = scene.particles.len() as f64;
        let found = reports.last().map_or(0.0, |report| report.mean_neighbors * n / 2.0);
        let own = (measures.mean_position.y, measures.kinetic_energy / n, measures.max_speed);
        println!("step {step}: {found} contacts, height {}, energy {:e}, speed {}", own.0, own.1, own.2);
        // Six digits up to step 50; later rounding has grown: 1 % of the energy and 0.1 % of the height.
        let (of_height, of_energy) = if step <= 50 { (5e-7 / height.abs(), 5e-7) } else { (1e-3, 1e-2) };
        assert!((own.0 / height - 1.0).abs() <= of_height, "step {step}: height {}", own.0);
        assert!((own.1 / energy - 1.0).abs() <= of_energy, "step {step}: energy {}", own.1);
        if step <= 50 {
            assert!((found - contacts as f64).abs() < 0.5, "step {step}: {found} contacts");
            assert!((own.2 - speed).abs() <= 5.1e-6, "step {step}: speed {}", own.2);
        }
    }
}
