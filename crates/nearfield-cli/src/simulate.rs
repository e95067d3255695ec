//! `nearfield simulate`: grains and fluids that move, as pictures, a film, clouds and numbers.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nearfield::application::Watch;
use nearfield::application::particles::{
    Checkpoint, Dimensions, FluidModel, GpuSimulation, PairRule, ParticleScene, ParticleSearch, Simulate, Simulation,
    SimulationSettings, StepReport,
};
use nearfield::{DeviceChoice, Error};

use crate::exit::Failure;
use crate::fallback::on_gpu;
use crate::interrupt;
use crate::options::{Amount, Common, PictureSize};
use crate::progress::CountBar;
use crate::report::{milliseconds, short};
use crate::simulate_folder::Folder;
use crate::simulate_measures::{Measured, Row};
use crate::simulate_picture::{ColorBy, Look};
use crate::simulate_report::Told;
use crate::simulate_scene::{self, End};

const EXAMPLES: &str = "Examples:
  nearfield simulate dam-break --seconds 2 --video -o out
  nearfield simulate drop --model dfsph --particles 50000 --vtp -o drop
  nearfield simulate dem-box --steps 500 --search coherent --color class -o grains
  nearfield simulate scene.toml --seconds 5 -o out
  nearfield simulate scene.toml --seconds 10 --resume out/checkpoint.npz -o out

Scenes without a file: dam-break, double-dam, drop, column, accel-fluid (fluids), dem-box, paper-fig18, paper-fig20 (grains).
A scene file (.toml) places blocks of particles in a box:
  dimensions = 3
  domain = { low = [0.0, 0.0, 0.0], high = [4.0, 3.0, 1.0] }
  gravity = [0.0, -9.81, 0.0]
  time_step = 0.003               # or { factor = 0.4, least = 1e-6, most = 0.003 }

  [model]
  kind = 'pbf'                    # pbf, wcsph, dfsph or dem
  spacing = 0.05

  [[box]]                         # or [[ball]] with center and radius
  low = [0.0, 0.0, 0.0]
  high = [1.0, 2.0, 1.0]

  [[wall]]                        # one layer of particles around a box
  low = [0.0, 0.0, 0.0]
  high = [4.0, 3.0, 1.0]
All keys, units and defaults: documentation of `nearfield::application::particles::read_particle_scene`.

The folder gets frame-00000.png and so on, measures.csv (a row a frame, and one before a blow-up), checkpoint.npz (now and then, and at the end), with --vtp
or --ply the particles of each frame, with --video film.png, an animated PNG that browsers show. Ctrl-C ends after the step that is
under way, keeps everything so far and exits with code 130.";

/// Simulate grains or fluids of particles
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct SimulateArgs {
    /// A scene file (.toml), or the name of a built-in scene
    #[arg(value_name = "SCENE|NAME")]
    pub(crate) scene: PathBuf,

    /// About how many particles a built-in scene has
    #[arg(long, value_name = "N")]
    pub(crate) particles: Option<Amount>,

    /// How the fluid of a built-in scene moves: pbf, wcsph or dfsph [default: pbf]
    #[arg(long, value_name = "MODEL")]
    pub(crate) model: Option<FluidModel>,

    /// Dimensions of a built-in scene of a fluid [default: 3]
    #[arg(long, value_name = "2|3", value_parser = dimensions)]
    pub(crate) dimensions: Option<Dimensions>,

    /// Which grains of paper-fig20 act on each other: contact, symmetric or gather [default: contact]
    #[arg(long, value_name = "RULE")]
    pub(crate) pair_rule: Option<PairRule>,

    /// Radius of the smallest grains of paper-fig20 in percent of the domain's diagonal, such as 0.25%
    #[arg(long, value_name = "P%", value_parser = percent)]
    pub(crate) radius: Option<f64>,

    /// Steps of the whole simulation [default for grains: 1000]
    #[arg(long, value_name = "N", conflicts_with = "seconds")]
    pub(crate) steps: Option<u64>,

    /// Time of the whole simulation, in the unit of the scene [default for fluids: 2]
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    pub(crate) seconds: Option<f64>,

    /// Who finds neighbours: brute-force, primary, coherent, uniform-grid, multi-level-grid, aabb-tree or verlet; uniform-grid:0.5 has cells
    /// of half the largest reach, verlet:0.2 a skin of a fifth of it
    #[arg(long, value_name = "SEARCH", default_value = "uniform-grid")]
    search: ParticleSearch,

    /// Where to simulate: auto, cpu, gpu, or a device of `nearfield devices`
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,

    /// Make sums that do not depend on the search: the same bytes from run to run
    #[arg(long)]
    deterministic: bool,

    /// Steps after which particles are put into the order of a space-filling curve; 0 for never
    #[arg(long, value_name = "N", default_value_t = 100)]
    reorder_every: u32,

    /// Speed above which the simulation is ended [default: none]
    #[arg(long, value_name = "V", default_value_t = f64::INFINITY, hide_default_value = true, allow_negative_numbers = true)]
    max_speed: f64,

    /// Frames for each unit of the scene's time [default: 25 for fluids, one every ten steps for grains]
    #[arg(long, value_name = "F", allow_negative_numbers = true)]
    frames_per_second: Option<f64>,

    /// What colours mean: speed, density or class [default: speed; class for grains of several radii]
    #[arg(long, value_name = "WHAT")]
    color: Option<ColorBy>,

    /// Width and height of the frames in pixels
    #[arg(long, value_name = "WxH", default_value = "960x720")]
    size: PictureSize,

    /// Make a film of the frames: film.png, an animated PNG
    #[arg(long)]
    video: bool,

    /// Linear factor by which the film is smaller than the frames
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=8))]
    shrink: u32,

    /// Write the particles of each frame as .vtp, for ParaView
    #[arg(long)]
    vtp: bool,

    /// Write the particles of each frame as .ply
    #[arg(long)]
    ply: bool,

    /// Go on from a checkpoint of the same scene; frames and measures in the folder up to there are kept
    #[arg(long, value_name = "FILE")]
    resume: Option<PathBuf>,

    /// Seconds after which a checkpoint is written
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0)]
    checkpoint_every: f64,

    /// The folder to write into; it is made where it is not there
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,

    /// Print everything as one JSON object
    #[arg(long)]
    json: bool,

    /// Replace what an earlier simulation left in the folder
    #[arg(long)]
    force: bool,
}

/// Longest time between two looks at the wish to end and the bar.
const LOOK_EVERY: f64 = 0.2;
/// Most steps between two of them.
const MOST_STEPS: u32 = 256;

pub(crate) fn run(args: &SimulateArgs, common: &Common) -> Result<(), Failure> {
    args.check()?;
    let scene = simulate_scene::read(args)?;
    let settings = args.settings();
    let end = End::of(args, &scene);
    let look = Look::of(&scene, args.color, args.size)?;
    let saved =
        args.resume.as_deref().map(|path| Checkpoint::read(path).map_err(Failure::reading(path))).transpose()?;
    let goes_on = args.resume.as_deref().is_some_and(|path| lies_in(path, &args.output));
    let folder = Folder::open(&args.output, args.force || goes_on)?;
    if !goes_on {
        folder.remove_frames()?;
    }
    interrupt::watch();

    let mut notes = Vec::new();
    let mut simulation = open(&args.device, &scene, &settings, &mut notes).map_err(Failure::Search)?;
    if let (Some(saved), Some(path)) = (&saved, &args.resume) {
        saved.resume(simulation.as_mut()).map_err(Failure::reading(path))?;
    }
    let rate = args.frames_per_second.unwrap_or_else(|| simulate_scene::frame_rate(&scene));
    let mut course = Course {
        args,
        folder: &folder,
        look: &look,
        measured: Measured::start(&folder, simulation.as_ref(), saved.is_some(), rate)?,
        rate,
        seconds: 0.0,
        picture_seconds: 0.0,
        written: Instant::now(),
    };
    let bar = CountBar::start(common, end.total(), end.unit());
    let ended = course.simulate(simulation.as_mut(), &end, &bar);
    drop(bar);
    let finished = course.finish(simulation.as_ref(), &mut notes);
    let is_whole = match ended {
        Ok(is_whole) => finished.map(|()| is_whole)?,
        Err(error) => return Err(failure(error, simulation.step(), finished, &folder)),
    };
    let told = Told {
        scene: &scene,
        settings: &settings,
        device: simulation.device(),
        measured: &course.measured,
        seconds: course.seconds,
        picture_seconds: course.picture_seconds,
        output: &args.output,
        video: args.video,
        notes,
    };
    told.tell(args.json, common)?;
    if is_whole {
        return Ok(());
    }
    let step = simulation.step();
    Err(Failure::Interrupted(format!("interrupted after step {step}; the folder has everything up to there")))
}

/// What is told of a simulation that could not go on; whether its last state was kept is told too, but does not take the place of why.
fn failure(error: Error, step: u64, finished: Result<(), Failure>, folder: &Folder) -> Failure {
    if !matches!(error, Error::BlowUp { .. }) {
        return Failure::Search(error);
    }
    let kept = match finished {
        Ok(()) => format!("in {}", folder.checkpoint().display()),
        Err(why) => format!("which could not be kept: {}", why.message().unwrap_or_default()),
    };
    Failure::BlowUp(format!("{error} (step {step}, {kept})"))
}

/// Whether a file is one of a folder.
fn lies_in(file: &Path, folder: &Path) -> bool {
    let of_file = file.canonicalize().ok().and_then(|file| file.parent().map(Path::to_owned));
    of_file.is_some() && of_file == folder.canonicalize().ok()
}

/// The simulation where it was chosen to run.
fn open(
    device: &DeviceChoice,
    scene: &ParticleScene,
    settings: &SimulationSettings,
    notes: &mut Vec<String>,
) -> nearfield::Result<Box<dyn Simulate>> {
    match on_gpu(device, notes, |gpu| GpuSimulation::new(gpu, scene, settings))? {
        Some(simulation) => Ok(Box::new(simulation)),
        None => Ok(Box::new(Simulation::new(scene, settings)?)),
    }
}

impl SimulateArgs {
    /// Says what cannot work before the work is done.
    fn check(&self) -> Result<(), Failure> {
        let positive = [
            ("--seconds", self.seconds),
            ("--frames-per-second", self.frames_per_second),
            ("--checkpoint-every", Some(self.checkpoint_every)),
        ];
        for (name, value) in positive {
            if let Some(value) = value.filter(|value| !(*value > 0.0 && value.is_finite())) {
                return Err(Failure::Usage(format!("{name} {value}: expected a finite number above 0")));
            }
        }
        if self.output == Path::new("-") {
            return Err(Failure::Usage("--output: expected a folder".to_owned()));
        }
        Ok(())
    }

    fn settings(&self) -> SimulationSettings {
        SimulationSettings {
            search: self.search,
            deterministic: self.deterministic,
            reorder_every: self.reorder_every,
            max_speed: self.max_speed,
        }
    }
}

/// What happens while a simulation runs.
struct Course<'a> {
    args: &'a SimulateArgs,
    folder: &'a Folder,
    look: &'a Look,
    measured: Measured,
    /// Frames for each unit of time.
    rate: f64,
    /// Seconds that steps took, and what else was done.
    seconds: f64,
    picture_seconds: f64,
    written: Instant,
}

impl Course<'_> {
    /// Makes steps and frames until the end or until the user wants to end; returns whether the end was reached.
    fn simulate(&mut self, simulation: &mut dyn Simulate, end: &End, bar: &CountBar) -> nearfield::Result<bool> {
        let mut frame = simulate_scene::frame_at(simulation.time(), self.rate);
        if simulation.step() == 0 {
            self.frame(simulation, 0, StepReport::default())?;
        }
        let mut chunk = 1;
        while !end.is_reached(simulation) {
            let next_frame = (frame + 1) as f64 / self.rate;
            let clock = Instant::now();
            let steps = chunk.min(end.steps_until(simulation, next_frame));
            let advanced = simulation.advance(steps, &mut Watch::none());
            let took = milliseconds(clock) / 1e3;
            self.seconds += took;
            let reports = match advanced {
                Ok(reports) => reports,
                Err(error) => {
                    // Why it has ended is told, not why its last row is missing.
                    let _ = self.row_before_failure(simulation);
                    return Err(error);
                }
            };
            self.measured.count(&reports);
            chunk = if took < 0.5 * LOOK_EVERY { (2 * chunk).min(MOST_STEPS) } else { (chunk / 2).max(1) };
            bar.show(end.done(simulation), &self.speed());
            let last = reports.last().copied().unwrap_or_default();
            // Steps add up in another way than frames: a frame may come a rounding early.
            if simulation.time() >= next_frame * (1.0 - 1e-12) || end.is_reached(simulation) {
                frame = ((simulation.time() * self.rate) * (1.0 + 1e-12)).floor().max(frame as f64 + 1.0) as u64;
                self.frame(simulation, frame, last)?;
            }
            if self.written.elapsed().as_secs_f64() >= self.args.checkpoint_every {
                self.keep(simulation)?;
            }
            if interrupt::asked() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// A row of measures of the particles as the last finished step has left them, where they have none yet.
    fn row_before_failure(&mut self, simulation: &mut dyn Simulate) -> nearfield::Result<()> {
        let reports = simulation.take_reports();
        self.measured.count(&reports);
        if let Some(last) = reports.last() {
            let row = Row::of(simulation, &simulation.particles()?, *last, self.measured.rebuilds());
            self.measured.push(row, self.measured.last_frame(), self.seconds);
        }
        Ok(())
    }

    fn speed(&self) -> String {
        format!("{} steps/s", short(self.measured.steps_a_second(self.seconds) as f32, 3))
    }

    /// A row of measures, a picture, and the particles where they are wanted.
    fn frame(&mut self, simulation: &dyn Simulate, number: u64, last: StepReport) -> nearfield::Result<()> {
        let clock = Instant::now();
        let particles = simulation.particles()?;
        let row = Row::of(simulation, &particles, last, self.measured.rebuilds());
        self.measured.push(row, number, self.seconds);
        let image = self.look.draw(simulation, &particles);
        self.folder.write_picture(number, &image)?;
        for (is_wanted, extension) in [(self.args.vtp, "vtp"), (self.args.ply, "ply")] {
            if is_wanted {
                self.folder.write_particles(number, extension, simulation.scene(), &particles)?;
            }
        }
        self.picture_seconds += milliseconds(clock) / 1e3;
        Ok(())
    }

    /// Checkpoint and measures so far.
    fn keep(&mut self, simulation: &dyn Simulate) -> nearfield::Result<()> {
        Checkpoint::of(simulation)?.write(&self.folder.checkpoint(), true)?;
        self.folder.write_measures(&self.measured)?;
        self.written = Instant::now();
        Ok(())
    }

    /// Everything that is to be there at the end.
    fn finish(&mut self, simulation: &dyn Simulate, notes: &mut Vec<String>) -> Result<(), Failure> {
        self.keep(simulation).map_err(Failure::writing)?;
        if self.args.video {
            let clock = Instant::now();
            let rate =
                if simulation.scene().model.is_fluid() { self.rate.round().clamp(1.0, 100.0) as u16 } else { 25 };
            let size = self.folder.write_film(self.measured.last_frame(), self.args.shrink, rate)?;
            notes.extend(size.filter(|&bytes| bytes > 64 << 20).map(|bytes| {
                format!("the film has {} MiB; --shrink or a lower --frames-per-second makes it smaller", bytes >> 20)
            }));
            self.picture_seconds += milliseconds(clock) / 1e3;
        }
        Ok(())
    }
}

fn dimensions(text: &str) -> Result<Dimensions, String> {
    match text {
        "2" => Ok(Dimensions::Two),
        "3" => Ok(Dimensions::Three),
        _ => Err("expected 2 or 3".to_owned()),
    }
}

fn percent(text: &str) -> Result<f64, String> {
    let number = text.strip_suffix('%').and_then(|number| number.trim().parse::<f64>().ok());
    number.map(|percent| percent / 100.0).ok_or_else(|| "expected a part of the diagonal such as 0.25%".to_owned())
}
