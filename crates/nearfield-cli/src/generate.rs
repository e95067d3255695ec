//! `nearfield generate`: synthetic clouds and meshes, the same bytes everywhere.

use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;
use nearfield::geometry::generate::{CloudKind, MeshKind, add_noise, cloud, mesh};
use nearfield::io::{Format, WriteOptions, write_cloud, write_mesh};

use crate::exit::Failure;
use crate::options::{Amount, Common, Length, deviation};
use crate::output;
use crate::progress::Progress;
use crate::report::grouped;

/// Make a synthetic cloud or mesh
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nearfield generate lidar -n 200000 --seed 7 -o street.ply
  nearfield generate icosphere -n 20000 -o ball.obj
  nearfield generate torus -n 100000 --noise 0.5% -o noisy.ply

Clouds: uniform, shell, clustered, plummer, lidar, torus, terrain, all-equal, line, lattice.
Meshes: icosphere, cube, torus-mesh, cornell, soup; -n is about the number of triangles.
The same kind, number and seed give the same bytes on every machine.")]
pub(crate) struct GenerateArgs {
    /// What to make
    kind: Kind,

    /// Number of points, or about the number of triangles
    #[arg(short = 'n', long = "number", value_name = "N")]
    n: Amount,

    /// Picks one of the equally likely results
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,

    /// Gaussian noise that every point of a cloud is moved by: its deviation along each axis, as a length or a part of the diagonal
    #[arg(long, value_name = "LENGTH")]
    noise: Option<Length>,

    /// The file to write, or - for standard output
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Format of the output, where its extension does not say it
    #[arg(long, value_name = "F")]
    format: Option<Format>,

    /// Write PLY as text
    #[arg(long)]
    ascii: bool,

    /// Replace a file that exists
    #[arg(long)]
    force: bool,
}

/// A cloud or a mesh.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Cloud(CloudKind),
    Mesh(MeshKind),
}

impl FromStr for Kind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Ok(kind) = text.parse() {
            return Ok(Self::Cloud(kind));
        }
        text.parse().map(Self::Mesh).map_err(|_| {
            let clouds = CloudKind::ALL.iter().map(|k| k.name());
            let names: Vec<&str> = clouds.chain(MeshKind::ALL.iter().map(|k| k.name())).collect();
            format!("expected one of {}", names.join(", "))
        })
    }
}

/// Bytes of a point, and of a triangle with its share of vertices, while they are made.
const POINT_BYTES: u64 = 12;
const TRIANGLE_BYTES: u64 = 48;

pub(crate) fn run(args: &GenerateArgs, common: &Common) -> Result<(), Failure> {
    let format = output::format(&args.output, args.format)?;
    output::check(&args.output, args.force)?;
    let options = WriteOptions { format: Some(format), force: args.force, ascii: args.ascii };
    let n = args.n.0;
    let noise = args.noise()?;
    let progress = Progress::start(common, "making points");
    let written = match args.kind {
        Kind::Cloud(kind) => {
            fits("the cloud", n, POINT_BYTES, common)?;
            let mut cloud = cloud(kind, n, args.seed);
            if let Some(noise) = noise {
                let sigma = noise.within(&cloud.bounds());
                add_noise(&mut cloud.points, sigma.into(), args.seed);
            }
            progress.step(format!("writing {}", args.output.display()));
            write_cloud(&args.output, &cloud, &options).map_err(Failure::writing)?;
            format!("{} points", grouped(cloud.len() as u64))
        }
        Kind::Mesh(kind) => {
            fits("the mesh", n, TRIANGLE_BYTES, common)?;
            let mesh = mesh(kind, n, args.seed);
            progress.step(format!("writing {}", args.output.display()));
            write_mesh(&args.output, &mesh, &options).map_err(Failure::writing)?;
            let (vertices, triangles) = (mesh.vertices.len() as u64, mesh.triangles.len() as u64);
            format!("{} vertices and {} triangles", grouped(vertices), grouped(triangles))
        }
    };
    drop(progress);
    common.note(&format!("{written} written to {}", output::shown(&args.output)));
    Ok(())
}

impl GenerateArgs {
    fn noise(&self) -> Result<Option<Length>, Failure> {
        match (self.noise, self.kind) {
            (Some(_), Kind::Mesh(kind)) => {
                Err(Failure::Usage(format!("--noise moves points of clouds, and {kind} is a mesh")))
            }
            (noise, _) => noise.map(deviation).transpose(),
        }
    }
}

/// Checks that `n` elements may be had, by the user's limit and by trying: the generators themselves do not fail.
pub(crate) fn fits(what: &'static str, n: usize, each: u64, common: &Common) -> Result<(), Failure> {
    let needed = (n as u64).saturating_mul(each);
    common.allow(what, needed).map_err(Failure::Search)?;
    let had = usize::try_from(needed).is_ok_and(|bytes| Vec::<u8>::new().try_reserve_exact(bytes).is_ok());
    if n as u64 >= u64::from(u32::MAX) {
        return Err(Failure::Usage(format!("-n {n}: at most {} points have a 32-bit index", u32::MAX - 1)));
    }
    if !had {
        return Err(Failure::Search(nearfield::Error::OutOfMemory { what, needed, available: 0 }));
    }
    Ok(())
}
