//! `nearfield offset`: the surface at a distance from points, a mesh or the surface of a field.

use std::str::FromStr;

use clap::Args;
use nearfield::application::{NodeValues, Offset};
use nearfield::geometry::{DistanceGrid, RegularGrid};
use serde_json::{Value, json};

use crate::exit::Failure;
use crate::options::{Common, Length};
use crate::surface::{self, Plan, Source, SurfaceArgs};

const EXAMPLES: &str = "Examples:
  nearfield offset scan.ply --distance 5% -o grown.ply --picture grown.png
  nearfield offset part.obj --distance=-2% -o shrunk.ply
  nearfield offset sheet.ply --distance 0.1 --two-sided -o thick.ply

Above 0 the body grows, below 0 it shrinks; parts thinner than twice the distance vanish, and it is an error where nothing is
left. With --two-sided an open surface gets a body around it. The grid grows with the body. A percentage is of the diagonal of
the box around the points, the mesh or the grid of a field.";

/// Make the surface at a distance from another
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct OffsetArgs {
    #[command(flatten)]
    surface: SurfaceArgs,

    /// The distance, as a length or a part of the diagonal such as 20% or -20%
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true)]
    distance: Signed,

    /// At this distance from both sides of a surface that may be open
    #[arg(long)]
    two_sided: bool,
}

/// A length with a sign.
#[derive(Debug, Clone, Copy)]
struct Signed(Length);

impl FromStr for Signed {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.parse().map(Self).map_err(|expected| format!("{expected}, or below 0 for the inside"))
    }
}

/// The surface at a distance.
struct AtDistance(Offset);

impl Plan for AtDistance {
    fn grid(&self, source: &Source, resolution: u32) -> nearfield::Result<(RegularGrid, f64)> {
        let (origin, bounds) = source.bounds();
        let grid = self.0.grid(origin, &bounds, resolution)?;
        Ok((grid, self.0.band(&grid) / f64::from(grid.spacing())))
    }

    fn check(&self, field: &DistanceGrid) -> nearfield::Result<()> {
        self.0.check_reach(field)
    }

    fn values<'a>(&self, field: &'a DistanceGrid) -> nearfield::Result<NodeValues<'a, f32>> {
        self.0.values(field)
    }

    fn told(&self) -> Option<(&'static str, String, Value)> {
        let (distance, side) = match self.0 {
            Offset::Signed(distance) if distance < 0.0 => (distance, "inside"),
            Offset::Signed(distance) => (distance, "outside"),
            Offset::TwoSided(distance) => (distance, "on both sides"),
        };
        Some(("offset", format!("{} {side}", distance.abs() as f32), json!(distance)))
    }
}

pub(crate) fn run(args: &OffsetArgs, common: &Common) -> Result<(), Failure> {
    let plan = |source: &Source| -> Result<Box<dyn Plan>, Failure> {
        let distance = f64::from(args.distance.0.within(&source.bounds().1));
        let offset = if args.two_sided { Offset::TwoSided(distance) } else { Offset::Signed(distance) };
        Ok(Box::new(AtDistance(offset)))
    };
    surface::run(&args.surface, plan, common)
}
