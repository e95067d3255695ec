//! `nearfield raycast`: one's own rays into a mesh.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use nearfield::io::{Format, Polygons};
use nearfield::query::Stage;
use nearfield::{Ray, RayQuery, RaySearch, RayTask, TriMesh};
use serde_json::{Value, json};

use crate::exit::Failure;
use crate::input::{self, Input, file_name};
use crate::options::Common;
use crate::progress::Progress;
use crate::ray_structure::{Built, Structure, StructureArgs, failed};
use crate::raycast_file::{self, Answer};
use crate::report::{self, Times, grouped, milliseconds, shown_ms, stage_json};

const EXAMPLES: &str = "Examples:
  nearfield raycast bunny.obj --rays rays.npy -o hits.npz
  nearfield raycast bunny.obj --rays rays.txt --query all --device gpu -o crossings.npz

--rays: an NPY array of shape (n, 6) or (n, 8), the array `rays` or the only one of such a shape in an NPZ archive, or text
with 6 or 8 numbers a line (spaces, tabs, commas or semicolons; # starts a comment). The numbers of a ray are its origin in
the coordinates of the mesh, its direction of any length but 0, and with 8 the smallest and the largest t; else t goes from 0 to
infinity. t counts in lengths of the direction.

A triangle is hit from both sides; edges and corners belong to it; of equal t the lowest triangle counts. A ray with a NaN or
without a direction stops nobody: it hits nothing, is told on the screen and listed in the array `invalid` (u64, [k],
indices of rays).

The archive holds, for n rays:
  closest  triangle (u32, [n], counted from 0; 4294967295 for no hit, 4294967294 for a ray that is invalid), t (f32, [n], infinite
           without a hit), barycentrics (f32, [n, 3], weights of the three corners), position ([n, 3], f64, or f32 where the
           mesh's coordinates are small) and normal (f32, [n, 3], unit length, towards the side from which the corners run
           counter-clockwise), all NaN without a hit
  any      hit (u8, [n]: 0 no, 1 yes, 2 invalid)
  count    count (u32, [n])
  all      offsets (u64, [n + 1]) and, for the hits offsets[i]..offsets[i + 1] of ray i in ascending order of t, triangle, t,
           barycentrics, position and normal as above";

/// Cast rays from a file into a mesh and write what they hit
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct RaycastArgs {
    /// A mesh: PLY, OBJ or STL, or - for standard input
    input: PathBuf,

    /// The rays: an NPY array, an NPZ archive or a text table, or - for standard input
    #[arg(long, value_name = "FILE")]
    rays: PathBuf,

    /// What is asked of each ray: its closest hit, whether there is any, how many there are, or all of them
    #[arg(long, value_name = "Q", default_value = "closest")]
    query: Question,

    #[command(flatten)]
    structure: StructureArgs,

    /// The arrays to write: OUT.npz
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,

    /// Print everything as one JSON object
    #[arg(long)]
    json: bool,

    /// Format of the mesh, where its extension does not say it
    #[arg(long, value_name = "F")]
    format: Option<Format>,

    /// Replace a file that exists
    #[arg(long)]
    force: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Question {
    Closest,
    Any,
    Count,
    All,
}

impl Question {
    fn name(self) -> &'static str {
        ["closest", "any", "count", "all"][self as usize]
    }

    fn ray_query(self) -> RayQuery {
        match self {
            Self::Closest => RayQuery::Closest,
            Self::Any => RayQuery::Any,
            Self::Count => RayQuery::Count,
            Self::All => RayQuery::All,
        }
    }

    fn ask(self, search: &dyn RaySearch, rays: &[Ray]) -> nearfield::Result<Answer> {
        Ok(match self {
            Self::Closest => Answer::Closest(search.closest_hits(rays)?),
            Self::Any => Answer::Any(search.any_hits(rays)?),
            Self::Count => Answer::Count(search.count_hits(rays)?),
            Self::All => Answer::All(search.all_hits(rays)?),
        })
    }
}

/// Everything worth telling.
struct Told {
    mesh: String,
    triangles: u64,
    rays: u64,
    query: &'static str,
    /// Rays that hit something.
    hitting: u64,
    /// Hits, where more than one of a ray counts.
    hits: Option<u64>,
    invalid: Vec<u64>,
    device: String,
    built: Built,
    stages: Vec<Stage>,
    times: Times,
    notes: Vec<String>,
}

pub(crate) fn run(args: &RaycastArgs, common: &Common) -> Result<(), Failure> {
    let plan = args.structure.plan(Structure::Auto)?;
    args.check_files()?;
    let (mut times, mut notes) = (Times::default(), Vec::new());
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let clock = Instant::now();
    let mesh = Input::open(&args.input, args.format, common)?.surface(Polygons::Fans)?;
    progress.step(format!("reading {}", args.rays.display()));
    let rays = input::rays(&args.rays, mesh.origin, common)?;
    common.allow("the rays", (rays.len() * size_of::<Ray>()) as u64).map_err(Failure::Search)?;
    times.read = milliseconds(clock);
    let invalid = invalid(&rays, &mut notes);

    progress.step("building the structure");
    let plan = plan.expecting(RayTask::new(rays.len() as u64).asking(args.query.ray_query()));
    let warm = |search: &dyn RaySearch, rays: &[Ray]| args.query.ask(search, rays).map(drop);
    let built = Built::of(&mesh, &args.structure, plan, &mut times, &mut notes, warm)
        .map_err(|error| failed(&args.input, error))?;
    progress.step("casting rays");
    let clock = Instant::now();
    let answer = args.query.ask(built.rays.search(), &rays).map_err(Failure::Search)?;
    let report = answer.report();
    times.asked(milliseconds(clock), report);
    let stages = report.stages.clone();
    notes.extend(report.notes.iter().cloned());

    progress.step(format!("writing {}", args.output.display()));
    let clock = Instant::now();
    write(args, &answer, &mesh, &invalid, common)?;
    times.write = milliseconds(clock);
    drop(progress);
    let told = Told {
        mesh: file_name(&args.input),
        triangles: mesh.triangles.len() as u64,
        rays: rays.len() as u64,
        query: args.query.name(),
        hitting: answer.hitting(),
        hits: answer.hits(),
        invalid,
        device: built.rays.search().device(),
        built,
        stages,
        times,
        notes,
    };
    if args.json {
        return report::print_json(&told.json());
    }
    if common.quiet {
        return Ok(());
    }
    report::print(&told.lines())
}

fn write(args: &RaycastArgs, answer: &Answer, mesh: &TriMesh, invalid: &[u64], common: &Common) -> Result<(), Failure> {
    common.allow("the hits", answer.bytes()).map_err(Failure::Search)?;
    let arrays = raycast_file::Arrays::of(answer, mesh.origin);
    nearfield::io::write_atomically(&args.output, args.force, |w| arrays.write(invalid, w)).map_err(Failure::writing)
}

/// Indices of rays that cannot be cast; how many there are, and what is wrong with the first, becomes a note.
fn invalid(rays: &[Ray], notes: &mut Vec<String>) -> Vec<u64> {
    let faults = rays.iter().enumerate().filter_map(|(i, ray)| Some((i as u64, ray.fault()?)));
    let faults: Vec<_> = faults.collect();
    if let Some((first, fault)) = faults.first() {
        let n = grouped(faults.len() as u64);
        notes.push(format!(
            "{n} of {} rays cannot be cast; the first, ray {first}, {}",
            grouped(rays.len() as u64),
            fault.reason()
        ));
    }
    faults.into_iter().map(|(i, _)| i).collect()
}

impl RaycastArgs {
    /// Says what cannot work before the work is done.
    fn check_files(&self) -> Result<(), Failure> {
        if self.input == Path::new("-") && self.rays == Path::new("-") {
            return Err(Failure::Usage("only one of the mesh and --rays can be standard input".into()));
        }
        if self.output.extension().is_none_or(|e| !e.eq_ignore_ascii_case("npz")) {
            return Err(Failure::Usage(format!("--output {}: hits are written as .npz", self.output.display())));
        }
        crate::output::check(&self.output, self.force)
    }
}

impl Told {
    fn mrays(&self) -> f64 {
        if self.times.query > 0.0 { self.rays as f64 * 1e-3 / self.times.query } else { 0.0 }
    }

    fn json(&self) -> Value {
        json!({
            "mesh": self.mesh,
            "triangles": self.triangles,
            "rays": self.rays,
            "query": self.query,
            "rays_that_hit": self.hitting,
            "hits": self.hits,
            "invalid": self.invalid.len(),
            "device": self.device,
            "structure": self.built.json(),
            "mrays_per_second": self.mrays(),
            "query_stages": self.stages.iter().map(stage_json).collect::<Vec<_>>(),
            "milliseconds": self.times.json(),
            "notes": self.notes,
        })
    }

    fn lines(&self) -> String {
        let hits = self.hits.map(|hits| format!(", {} hits in all", grouped(hits))).unwrap_or_default();
        let mut text = String::new();
        for (name, value) in [
            ("mesh", format!("{}, {} triangles", self.mesh, grouped(self.triangles))),
            (
                "rays",
                format!(
                    "{}, {} that hit{hits}, {} invalid",
                    grouped(self.rays),
                    grouped(self.hitting),
                    grouped(self.invalid.len() as u64)
                ),
            ),
            ("device", self.device.clone()),
            ("structure", self.built.line()),
            ("time", self.times.line()),
            ("cast", format!("{}, {:.2} Mrays/s", shown_ms(self.times.query), self.mrays())),
        ] {
            text += &format!("{name:<12}{value}\n");
        }
        for note in &self.notes {
            text += &format!("{:<12}{note}\n", "note");
        }
        text
    }
}
