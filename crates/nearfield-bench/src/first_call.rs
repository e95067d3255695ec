//! `nearfield-bench first-call`: how long a program waits for its first answer, with and without pipelines that were kept.
//!
//! Each row is a process of its own: it opens the device, builds a structure over a small set and lists, twice. Drivers keep compiled pipelines too; that
//! is switched off but in the last rows, by `__GL_SHADER_DISK_CACHE=0` (NVIDIA) and `MESA_SHADER_CACHE_DISABLE=true` (Mesa). Each process checks its answer.

use std::env;
use std::fs;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use nearfield::gpu::shader::{self, Fill};
use nearfield::gpu::wgpu::naga;
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield::{
    AabbTreeSettings, FixedRadius, GpuAabbTree, GpuBruteForce, GpuLinearOctree, GpuUniformGrid, GridSettings,
    NeighborSearch, Neighbors, OctreeSettings,
};

use crate::check::Expected;
use crate::measure::median;
use crate::provenance::{COMMIT, Machine};
use crate::sets::Set;
use crate::{Error, Result};

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// auto, gpu, gpu:N or part of a device name
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,

    /// The set
    #[arg(long, value_name = "SET", default_value = "uniform-10k")]
    pub set: Set,

    /// Processes of a row; the median is told
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub repeat: usize,

    /// Structures
    #[arg(long, value_delimiter = ',', default_value = "uniform-grid,aabb-tree,linear-octree,brute-force")]
    pub structures: Vec<Structure>,

    /// Be one of the processes: measure one structure and print three numbers
    #[arg(long, hide = true)]
    pub alone: Option<Structure>,
}

/// A structure that is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Structure {
    /// The uniform grid.
    UniformGrid,
    /// The AABB-tree.
    AabbTree,
    /// The linear octree.
    LinearOctree,
    /// Brute force.
    BruteForce,
}

impl Structure {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::UniformGrid, Self::AabbTree, Self::LinearOctree, Self::BruteForce];

    fn name(self) -> &'static str {
        match self {
            Self::UniformGrid => "uniform-grid",
            Self::AabbTree => "aabb-tree",
            Self::LinearOctree => "linear-octree",
            Self::BruteForce => "brute-force",
        }
    }
}

/// Which pipelines a process finds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kept {
    /// None, and none are kept.
    Nothing,
    /// None, but they are kept.
    Empty,
    /// Those of the library.
    Library,
    /// Those of the driver itself.
    Driver,
}

impl Kept {
    const ALL: [Self; 4] = [Self::Nothing, Self::Empty, Self::Library, Self::Driver];

    fn name(self) -> &'static str {
        match self {
            Self::Nothing => "none",
            Self::Empty => "none, they are written",
            Self::Library => "the library's",
            Self::Driver => "the driver's",
        }
    }
}

/// Milliseconds of opening the device, of the first build and list, and of the second.
type Times = [f64; 3];

/// Prints a table.
///
/// # Errors
/// Of the library; no GPU; a wrong answer; a process that cannot be started.
pub fn run(arguments: &Arguments) -> Result<()> {
    if let Some(structure) = arguments.alone {
        let [open, first, second] = measure(arguments, structure)?;
        println!("{open} {first} {second}");
        return Ok(());
    }
    let machine = Machine::open(&arguments.device)?;
    println!("{} ({}), host {}, commit {COMMIT}", machine.name, machine.driver, machine.host);
    println!("one kernel on this host: {}", kernel_on_the_host()?);
    println!();
    println!("Milliseconds of {}, median of {} processes", arguments.set, arguments.repeat.max(1));
    println!();
    println!("| structure | pipelines that were kept | open | first build and list | second |");
    println!("| --- | --- | --- | --- | --- |");
    let folder = env::temp_dir().join(format!("nearfield-first-call-{}", std::process::id()));
    let measured = arguments.structures.iter().try_for_each(|&structure| {
        Kept::ALL.into_iter().try_for_each(|kept| {
            let [open, first, second] = processes(arguments, structure, kept, &folder)?;
            println!("| {} | {} | {open:.1} | {first:.1} | {second:.2} |", structure.name(), kept.name());
            Ok(())
        })
    });
    let _ = fs::remove_dir_all(&folder);
    measured
}

/// Medians over several processes, after one that fills what is kept.
fn processes(arguments: &Arguments, structure: Structure, kept: Kept, folder: &Path) -> Result<Times> {
    let folder = folder.join(structure.name());
    let mut all = Vec::new();
    if matches!(kept, Kept::Library | Kept::Driver) {
        process(arguments, structure, kept, &folder)?;
    }
    for _ in 0..arguments.repeat.max(1) {
        if kept == Kept::Empty {
            let _ = fs::remove_dir_all(&folder);
        }
        all.push(process(arguments, structure, kept, &folder)?);
    }
    Ok([0, 1, 2].map(|i| median(&all.iter().map(|times| times[i]).collect::<Vec<_>>())))
}

fn process(arguments: &Arguments, structure: Structure, kept: Kept, folder: &Path) -> Result<Times> {
    let mut command = Command::new(env::current_exe()?);
    command.args(["first-call", "--device", &arguments.device.to_string(), "--set", &arguments.set.to_string()]);
    command.args(["--alone", structure.name()]);
    match kept {
        Kept::Nothing | Kept::Driver => command.env("NEARFIELD_PIPELINE_CACHE", "off"),
        Kept::Empty | Kept::Library => command.env("NEARFIELD_PIPELINE_CACHE", folder),
    };
    if kept != Kept::Driver {
        command.env("__GL_SHADER_DISK_CACHE", "0").env("MESA_SHADER_CACHE_DISABLE", "true");
    }
    let output = command.output()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let numbers: Vec<f64> = text.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    match (<[f64; 3]>::try_from(numbers), output.status.success()) {
        (Ok(times), true) => Ok(times),
        _ => Err(format!("{}: {}{text}", structure.name(), String::from_utf8_lossy(&output.stderr)).into()),
    }
}

/// The work of one process.
fn measure(arguments: &Arguments, structure: Structure) -> Result<Times> {
    let milliseconds = |start: Instant| start.elapsed().as_secs_f64() * 1e3;
    let (points, radius) = (arguments.set.points(), arguments.set.radius());
    let start = Instant::now();
    let gpu = Gpu::open(&arguments.device)?.ok_or("first calls are measured on a GPU")?;
    let open = milliseconds(start);
    let question = FixedRadius::new(radius);
    let list = || -> Result<(Neighbors, f64)> {
        let start = Instant::now();
        let list = match structure {
            Structure::UniformGrid => {
                GpuUniformGrid::build(&gpu, &points, &GridSettings::for_radius(radius))?.list(&question)?
            }
            Structure::AabbTree => GpuAabbTree::build(&gpu, &points, &AabbTreeSettings::default())?.list(&question)?,
            Structure::LinearOctree => {
                GpuLinearOctree::build(&gpu, &points, &OctreeSettings::default())?.list(&question)?
            }
            Structure::BruteForce => GpuBruteForce::build(&gpu, &points)?.list(&question)?,
        };
        Ok((list, milliseconds(start)))
    };
    let expected = Expected::of(&points, radius)?;
    let (first_list, first) = list()?;
    let (second_list, second) = list()?;
    expected.check_list(first_list.offsets(), first_list.indices())?;
    expected.check_list(second_list.offsets(), second_list.indices())?;
    Ok([open, first, second])
}

/// What one kernel costs before the driver sees it: the same on every machine but for its speed.
fn kernel_on_the_host() -> Result<String> {
    let fills = [
        ("package::structure::selected", Fill::Module("package::structure::uniform_grid::traverse")),
        ("package::structure::visitor", Fill::Module("package::query::row_masks")),
    ];
    let features =
        ["distances", "by_index", "hashed", "excludes", "short_loops", "all_points", "shared_queries", "periodic"];
    let features: Vec<(&str, bool)> = features.map(|name| (name, false)).into_iter().chain([("masks", true)]).collect();
    let compose = || shader::compose("package::query::fixed_radius", &fills, &features, false);
    let source = compose()?;
    let parse = || naga::front::wgsl::parse_str(&source).map_err(|error| Error::from(error.emit_to_string(&source)));
    let module = parse()?;
    let validate = || {
        let (flags, capabilities) = (naga::valid::ValidationFlags::all(), naga::valid::Capabilities::SUBGROUP);
        naga::valid::Validator::new(flags, capabilities).validate(&module).map(drop).map_err(Box::new)
    };
    validate()?;
    let composed = time(|| drop(black_box(compose())));
    let parsed = time(|| drop(black_box(parse())));
    let validated = time(|| drop(black_box(validate())));
    Ok(format!("composed in {composed:.2} ms, parsed in {parsed:.2}, validated in {validated:.2}"))
}

fn time(work: impl Fn()) -> f64 {
    let once = || {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64() * 1e3
    };
    median(&std::array::from_fn::<f64, 9, _>(|_| once()))
}
