//! The command `nearfield`: neighbours of real scans, from a terminal.
//!
//! Each subcommand is a file; errors are one line on standard error and an exit code.

mod agreement;
mod cluster;
mod colormap;
mod completions;
mod convert;
mod demo;
mod devices;
mod downsample;
mod exit;
mod fallback;
mod filter;
mod formats;
mod generate;
mod heatmap;
mod heatmap_picture;
mod heatmap_report;
mod info;
mod input;
mod interrupt;
mod lists;
mod mesh;
mod neighbors;
mod neighbors_answer;
mod neighbors_picture;
mod normals;
mod octree;
mod octree_file;
mod octree_picture;
mod octree_report;
mod offset;
mod options;
mod output;
mod picture;
mod point_files;
mod progress;
mod ray_structure;
mod ray_structure_report;
mod raycast;
mod raycast_file;
mod render;
mod render_picture;
mod render_scene;
mod report;
mod resample;
mod resample_report;
mod resample_work;
mod sample;
mod sdf;
mod sdf_picture;
mod simulate;
mod simulate_folder;
mod simulate_measures;
mod simulate_picture;
mod simulate_report;
mod simulate_scene;
mod smooth;
mod smooth_picture;
mod smooth_report;
mod sort;
mod sort_picture;
mod spacing;
mod surface;
mod surface_of_particles;
mod surface_picture;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::sync::Mutex;

use clap::{CommandFactory, Parser, Subcommand};

use exit::Failure;
use options::Common;

/// Exact neighbours within a radius, on the CPU and on any GPU
#[derive(Debug, Parser)]
#[command(
    name = "nearfield",
    version,
    after_help = "Start with `nearfield demo`, or with
  nearfield neighbors scan.ply --radius 0.5% --picture scan.png

Exit codes: 0 ok, 2 usage, 65 bad data, 66 no input, 69 no device, 70 internal error, 73 output cannot be created,
74 reading or writing failed, 75 out of memory (a smaller request may do), 130 interrupted (the picture so far is written)."
)]
struct Arguments {
    #[command(flatten)]
    common: Common,

    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Demo(demo::DemoArgs),
    Neighbors(Box<neighbors::NeighborsArgs>),
    Octree(Box<octree::OctreeArgs>),
    Heatmap(Box<heatmap::HeatmapArgs>),
    Raycast(Box<raycast::RaycastArgs>),
    Render(Box<render::RenderArgs>),
    Mesh(Box<mesh::MeshArgs>),
    Offset(Box<offset::OffsetArgs>),
    Info(info::InfoArgs),
    Normals(Box<normals::NormalsArgs>),
    Convert(convert::ConvertArgs),
    Generate(generate::GenerateArgs),
    Sample(sample::SampleArgs),
    Sdf(Box<sdf::SdfArgs>),
    Simulate(Box<simulate::SimulateArgs>),
    Surface(Box<surface_of_particles::SurfaceOfParticlesArgs>),
    Smooth(Box<smooth::SmoothArgs>),
    Resample(Box<resample::ResampleArgs>),
    Filter(Box<filter::FilterArgs>),
    Downsample(Box<downsample::DownsampleArgs>),
    Cluster(Box<cluster::ClusterArgs>),
    Sort(sort::SortArgs),
    Devices(devices::DevicesArgs),
    Formats(formats::FormatsArgs),
    Completions(completions::CompletionsArgs),
}

/// Where the last panic happened and what it said.
static PANIC: Mutex<String> = Mutex::new(String::new());

fn main() -> ExitCode {
    // File readers catch panics of third-party decoders and report them as bad files, so a panic is told only if it
    // arrives here.
    std::panic::set_hook(Box::new(|panic| {
        if let Ok(mut text) = PANIC.lock() {
            *text = panic.to_string();
        }
    }));
    match catch_unwind(AssertUnwindSafe(run)) {
        Ok(code) => code,
        Err(_) => {
            let text = PANIC.lock().map(|text| text.replace('\n', " ")).unwrap_or_default();
            eprintln!("nearfield: internal error: {text}; please report it");
            ExitCode::from(70)
        }
    }
}

fn run() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) if error.use_stderr() => {
            eprintln!("nearfield: {}", usage_line(&error));
            return ExitCode::from(2);
        }
        Err(help) => {
            // Help or version; a closed pipe is the only thing that can go wrong.
            let _ = help.print();
            return ExitCode::SUCCESS;
        }
    };
    match dispatch(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            if let Some(message) = failure.message() {
                eprintln!("nearfield: {message}");
            }
            ExitCode::from(failure.code())
        }
    }
}

fn dispatch(arguments: &Arguments) -> Result<(), Failure> {
    let common = &arguments.common;
    common.apply()?;
    match &arguments.verb {
        Verb::Demo(args) => demo::run(args, common),
        Verb::Neighbors(args) => neighbors::run(args, common),
        Verb::Octree(args) => octree::run(args, common),
        Verb::Heatmap(args) => heatmap::run(args, common),
        Verb::Raycast(args) => raycast::run(args, common),
        Verb::Render(args) => render::run(args, common),
        Verb::Mesh(args) => mesh::run(args, common),
        Verb::Offset(args) => offset::run(args, common),
        Verb::Info(args) => info::run(args, common),
        Verb::Normals(args) => normals::run(args, common),
        Verb::Convert(args) => convert::run(args, common),
        Verb::Generate(args) => generate::run(args, common),
        Verb::Sample(args) => sample::run(args, common),
        Verb::Sdf(args) => sdf::run(args, common),
        Verb::Simulate(args) => simulate::run(args, common),
        Verb::Surface(args) => surface_of_particles::run(args, common),
        Verb::Smooth(args) => smooth::run(args, common),
        Verb::Resample(args) => resample::run(args, common),
        Verb::Filter(args) => filter::run(args, common),
        Verb::Downsample(args) => downsample::run(args, common),
        Verb::Cluster(args) => cluster::run(args, common),
        Verb::Sort(args) => sort::run(args, common),
        Verb::Devices(args) => devices::run(args),
        Verb::Formats(args) => formats::run(args),
        Verb::Completions(args) => completions::run(args, Arguments::command()),
    }
}

/// What is wrong with the command line, in one line.
fn usage_line(error: &clap::Error) -> String {
    if error.kind() == clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        return "say what to do: demo, neighbors, octree, heatmap, raycast, render, simulate, surface, sdf, info, normals, smooth, resample, filter, \
                downsample, cluster, mesh, offset, convert, generate, sample, sort, devices, formats or completions; \
                `nearfield --help` explains"
            .to_owned();
    }
    let text = error.render().to_string();
    let text = text.strip_prefix("error: ").unwrap_or(&text);
    let told = text.lines().map(str::trim).take_while(|line| !line.starts_with("Usage:"));
    let told: Vec<&str> = told.filter(|line| !line.is_empty() && !line.starts_with("For more information")).collect();
    format!("{}; --help explains", told.join(" "))
}
