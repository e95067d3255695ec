//! `nearfield convert`: from one file format to another.

use std::path::PathBuf;

use clap::Args;
use nearfield::io::{WriteOptions, write_cloud, write_mesh};

use crate::exit::Failure;
use crate::input::Input;
use crate::options::{Common, Formats};
use crate::output;
use crate::progress::Progress;
use crate::report::grouped;

/// Convert a point cloud or a mesh to another format
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nearfield convert scan.laz scan.ply
  nearfield convert mesh.stl - --to obj | head

A mesh stays a mesh where the output format holds meshes; otherwise its vertices are written.")]
pub(crate) struct ConvertArgs {
    /// The file to read, or - for standard input
    input: PathBuf,

    /// The file to write, or - for standard output
    output: PathBuf,

    #[command(flatten)]
    formats: Formats,

    /// Drop points with NaN or infinite coordinates (point clouds only)
    #[arg(long)]
    drop_invalid: bool,

    /// Write the points of a mesh without its faces
    #[arg(long)]
    points_only: bool,

    /// Replace a file that exists
    #[arg(long)]
    force: bool,
}

pub(crate) fn run(args: &ConvertArgs, common: &Common) -> Result<(), Failure> {
    let to = output::format(&args.output, args.formats.to)?;
    let info = to.info();
    if !info.writes_cloud && !info.writes_mesh {
        return Err(Failure::Usage(format!("{to} is read, not written; `nearfield formats` lists what is")));
    }
    output::check(&args.output, args.force)?;
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let input = Input::open(&args.input, args.formats.format, common)?;
    let options = WriteOptions { format: Some(to), force: args.force, ascii: args.formats.ascii };
    let mesh = if args.points_only || args.drop_invalid { None } else { input.mesh()? };
    let written = match mesh {
        Some(mesh) if info.writes_mesh => {
            progress.step(format!("writing {}", args.output.display()));
            write_mesh(&args.output, &mesh, &options).map_err(Failure::writing)?;
            let (vertices, triangles) = (mesh.vertices.len() as u64, mesh.triangles.len() as u64);
            format!("{} vertices and {} triangles", grouped(vertices), grouped(triangles))
        }
        faces_lost => {
            let mut cloud = input.cloud()?;
            let dropped = if args.drop_invalid { cloud.drop_invalid() } else { 0 };
            if dropped > 0 {
                common
                    .note(&format!("{} points with NaN or infinite coordinates were dropped", grouped(dropped as u64)));
            }
            if let Some(mesh) = faces_lost {
                let triangles = grouped(mesh.triangles.len() as u64);
                common.note(&format!("{to} holds no faces: {triangles} triangles are left out, the vertices stay"));
            }
            progress.step(format!("writing {}", args.output.display()));
            write_cloud(&args.output, &cloud, &options).map_err(Failure::writing)?;
            format!("{} points", grouped(cloud.len() as u64))
        }
    };
    drop(progress);
    common.note(&format!("{written} written to {}", output::shown(&args.output)));
    Ok(())
}
