//! Which scene is simulated, and until when.

use nearfield::application::particles::{
    BuiltinOptions, ParticleModel, ParticleScene, Simulate, TimeStep, builtin_names, builtin_scene, read_particle_scene,
};

use crate::exit::Failure;
use crate::options::Amount;
use crate::simulate::SimulateArgs;

/// Steps of grains, and time of fluids, where nothing is asked for.
const STEPS: u64 = 1000;
const SECONDS: f64 = 2.0;
/// Frames a second of fluids, and steps between frames of grains.
const FRAMES_A_SECOND: f64 = 25.0;
const STEPS_A_FRAME: f64 = 10.0;

/// The last frame that is due by a time.
pub(crate) fn frame_at(time: f64, rate: f64) -> u64 {
    (time * rate + 1e-9).floor() as u64
}

/// The scene of the command line.
pub(crate) fn read(args: &SimulateArgs) -> Result<ParticleScene, Failure> {
    let name = args.scene.to_str().filter(|name| builtin_names().contains(name));
    if let Some(name) = name {
        let particles = args.particles.map(|Amount(n)| u32::try_from(n)).transpose();
        let particles =
            particles.map_err(|_| Failure::Usage("--particles: expected at most 4,294,967,295".to_owned()))?;
        let (model, dimensions) = (args.model, args.dimensions);
        let options = BuiltinOptions { particles, model, dimensions, pair_rule: args.pair_rule, radius: args.radius };
        return builtin_scene(name, &options).map_err(Failure::Search);
    }
    if !args.scene.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml")) {
        let (found, names) = (args.scene.display(), builtin_names().join(", "));
        return Err(Failure::Usage(format!("{found}: expected a scene file (.toml) or one of {names}")));
    }
    let of_builtin = [
        ("--particles", args.particles.is_some()),
        ("--model", args.model.is_some()),
        ("--dimensions", args.dimensions.is_some()),
        ("--pair-rule", args.pair_rule.is_some()),
        ("--radius", args.radius.is_some()),
    ];
    if let Some((option, _)) = of_builtin.into_iter().find(|(_, is_set)| *is_set) {
        return Err(Failure::Usage(format!("{option} is for built-in scenes; a scene file says it itself")));
    }
    read_particle_scene(&args.scene).map_err(Failure::reading(&args.scene))
}

/// Frames for each unit of time where nothing is asked for.
pub(crate) fn frame_rate(scene: &ParticleScene) -> f64 {
    match scene.model {
        ParticleModel::Dem(_) => 1.0 / (STEPS_A_FRAME * scene.time_step.most()),
        _ => FRAMES_A_SECOND,
    }
}

/// When a simulation is over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum End {
    Step(u64),
    Time(f64),
}

impl End {
    pub(crate) fn of(args: &SimulateArgs, scene: &ParticleScene) -> Self {
        match (args.steps, args.seconds) {
            (Some(steps), _) => Self::Step(steps),
            (None, Some(seconds)) => Self::Time(seconds),
            (None, None) if scene.model.is_fluid() => Self::Time(SECONDS),
            (None, None) => Self::Step(STEPS),
        }
    }

    pub(crate) fn is_reached(&self, simulation: &dyn Simulate) -> bool {
        match *self {
            Self::Step(step) => simulation.step() >= step,
            Self::Time(time) => simulation.time() >= time * (1.0 - 1e-12),
        }
    }

    /// Steps that can be made before this time or the end is reached, one at least.
    pub(crate) fn steps_until(&self, simulation: &dyn Simulate, time: f64) -> u32 {
        let longest = match simulation.scene().time_step {
            TimeStep::Fixed(step) => step,
            TimeStep::Cfl { most, .. } => most,
        };
        let (until, left) = match *self {
            Self::Step(step) => (time, step.saturating_sub(simulation.step()) as f64),
            Self::Time(end) => (time.min(end), f64::INFINITY),
        };
        let steps = ((until - simulation.time()) / longest - 1e-9).ceil().min(left);
        steps.clamp(1.0, f64::from(u32::MAX)) as u32
    }

    /// Progress in the unit of the bar.
    pub(crate) fn done(&self, simulation: &dyn Simulate) -> u64 {
        match self {
            Self::Step(_) => simulation.step(),
            Self::Time(_) => (1e3 * simulation.time()) as u64,
        }
    }

    /// What the bar goes up to.
    pub(crate) fn total(&self) -> u64 {
        match *self {
            Self::Step(step) => step,
            Self::Time(time) => (1e3 * time) as u64,
        }
    }

    pub(crate) fn unit(&self) -> &'static str {
        match self {
            Self::Step(_) => "steps",
            Self::Time(_) => "thousandths of time",
        }
    }
}
