//! `nearfield sample`: points of a surface as a scanner would give them, with noise.

use std::path::PathBuf;

use clap::Args;
use nearfield::geometry::generate::{add_noise, surface_samples};
use nearfield::io::{Polygons, WriteOptions, write_cloud};
use nearfield::{Error, PointCloud};

use crate::exit::Failure;
use crate::generate::fits;
use crate::input::Input;
use crate::options::{Amount, Common, Formats, Length, deviation};
use crate::output;
use crate::progress::Progress;
use crate::report::grouped;

/// Sample the surface of a mesh as a scanner would, with noise
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nearfield sample bunny.obj -n 100000 --noise 0.5% --seed 1 -o scan.ply
  nearfield sample part.stl -n 1e6 --normals -o points.ply

Points are uniform by area; noise is Gaussian along each axis. The same mesh, number and seed give the same bytes on every
machine. With --normals each point has the normal of the triangle it was taken from, as it was before the noise.")]
pub(crate) struct SampleArgs {
    /// The mesh to read, or - for standard input
    input: PathBuf,

    /// Number of points
    #[arg(short = 'n', long = "number", value_name = "N")]
    n: Amount,

    /// Deviation of the noise along each axis, as a length or a part of the diagonal of the mesh
    #[arg(long, value_name = "LENGTH")]
    noise: Option<Length>,

    /// Picks one of the equally likely results
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,

    /// Give each point the normal of its triangle
    #[arg(long)]
    normals: bool,

    /// The file to write, or - for standard output
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    #[command(flatten)]
    formats: Formats,

    /// Replace a file that exists
    #[arg(long)]
    force: bool,
}

/// Bytes of a point with its normal while they are made.
const POINT_BYTES: u64 = 24;

pub(crate) fn run(args: &SampleArgs, common: &Common) -> Result<(), Failure> {
    let to = output::format(&args.output, args.formats.to)?;
    if !to.info().writes_cloud {
        return Err(Failure::Usage(format!("{to} is read, not written; `nearfield formats` lists what is")));
    }
    output::check(&args.output, args.force)?;
    let (n, noise) = (args.n.0, args.noise.map(deviation).transpose()?);
    fits("the samples", n, POINT_BYTES, common)?;
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let mesh = Input::open(&args.input, args.formats.format, common)?.surface(Polygons::Fans)?;
    progress.step("sampling");
    let mut cloud = surface_samples(&mesh, n, args.seed);
    if cloud.len() < n {
        let what = "sampling a mesh without area, or with coordinates that are not finite,".to_owned();
        let advice = "give one whose triangles have an area";
        return Err(Failure::Read(args.input.clone(), Error::Unsupported { what, advice }));
    }
    let sigma = noise.map_or(0.0, |noise| noise.within(&mesh.bounds()));
    add_noise(&mut cloud.points, sigma.into(), args.seed);
    let cloud = PointCloud { normals: cloud.normals.filter(|_| args.normals), ..cloud };
    progress.step(format!("writing {}", args.output.display()));
    let options = WriteOptions { format: Some(to), force: args.force, ascii: args.formats.ascii };
    write_cloud(&args.output, &cloud, &options).map_err(Failure::writing)?;
    drop(progress);
    let (points, triangles) = (grouped(cloud.len() as u64), grouped(mesh.triangles.len() as u64));
    let noise = if sigma > 0.0 { format!(" with noise of {sigma}") } else { String::new() };
    common.note(&format!("{points} points of {triangles} triangles{noise} written to {}", output::shown(&args.output)));
    Ok(())
}
