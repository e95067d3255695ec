//! `nearfield mesh`: a triangle mesh from points, a mesh or a field, by dual contouring.

use clap::Args;
use nearfield::application::{NodeValues, grid_around};
use nearfield::geometry::{DistanceGrid, RegularGrid};

use crate::exit::Failure;
use crate::options::Common;
use crate::surface::{self, Plan, Source, SurfaceArgs};

const EXAMPLES: &str = "Examples:
  nearfield mesh scan.ply --resolution 257 -o surface.ply --picture surface.png
  nearfield mesh field.vti -o surface.obj
  nearfield mesh part.obj --features --resolution 129 -o remeshed.ply

Points need normals (`nearfield normals`). The mesh is manifold and oriented; it is open where distances are undefined, beyond
holes wider than the band, and what it prints says so. Vertices stand where the planes of the surface around them meet, so
creases and corners stay; those that would make triangles flip or intersect are moved, unless --features keeps them.";

/// Make a triangle mesh of points, of another mesh or of a distance field
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct MeshArgs {
    #[command(flatten)]
    surface: SurfaceArgs,

    /// Distance from the points or the mesh up to which nodes have a value, in grid widths
    #[arg(long, value_name = "WIDTHS", default_value_t = 4.0)]
    band: f64,
}

/// The surface of the field itself.
struct OwnSurface {
    band: f64,
}

impl Plan for OwnSurface {
    fn grid(&self, source: &Source, resolution: u32) -> nearfield::Result<(RegularGrid, f64)> {
        let (origin, bounds) = source.bounds();
        Ok((grid_around(origin, &bounds, resolution, self.band)?, self.band))
    }

    fn values<'a>(&self, field: &'a DistanceGrid) -> nearfield::Result<NodeValues<'a, f32>> {
        Ok(field.into())
    }
}

pub(crate) fn run(args: &MeshArgs, common: &Common) -> Result<(), Failure> {
    surface::run(&args.surface, |_| Ok(Box::new(OwnSurface { band: args.band })), common)
}
