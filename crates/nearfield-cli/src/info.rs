//! `nearfield info`: what a file holds.

use std::path::PathBuf;

use clap::Args;
use nearfield::geometry::Column;
use nearfield::io::Format;
use nearfield::{DVec3, PointCloud};
use serde_json::json;

use crate::exit::Failure;
use crate::input::Input;
use crate::options::Common;
use crate::progress::Progress;
use crate::report::{grouped, print, print_json};
use crate::spacing::{Spacing, spacing};

/// Say what a file holds: counts, bounds, spacing, duplicates, attributes
#[derive(Debug, Args)]
#[command(after_help = "Example:
  nearfield info scan.laz --json

The spacing is the mean distance from a position to the nearest other one. Duplicates are points at exactly the
position of an earlier point.")]
pub(crate) struct InfoArgs {
    /// A file, or - for standard input
    input: PathBuf,

    /// Print one JSON object
    #[arg(long)]
    json: bool,

    /// Format of the input, where its extension does not say it
    #[arg(long, value_name = "F")]
    format: Option<Format>,
}

pub(crate) fn run(args: &InfoArgs, common: &Common) -> Result<(), Failure> {
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let input = Input::open(&args.input, args.format, common)?;
    let mut cloud = input.cloud()?;
    let mesh = input.mesh()?;
    let attributes = attributes(&cloud);
    let points = cloud.len();
    let invalid = cloud.drop_invalid();
    progress.step("measuring the spacing");
    let spacing = spacing(&cloud.points).map_err(Failure::reading(&args.input))?;
    drop(progress);

    let bounds = (!cloud.is_empty()).then(|| world_bounds(&cloud));
    let triangles = mesh.as_ref().map(|m| (m.triangles.len(), m.area()));
    if args.json {
        return print_json(&json!({
            "file": args.input.to_string_lossy(),
            "format": input.format().name(),
            "bytes": input.len(),
            "points": points,
            "invalid": invalid,
            "min": bounds.map(|b| b[0].to_array()),
            "max": bounds.map(|b| b[1].to_array()),
            "diagonal": bounds.map(|b| (b[1] - b[0]).length()),
            "spacing": spacing.mean,
            "duplicates": spacing.duplicates,
            "triangles": triangles.map(|t| t.0),
            "area": triangles.map(|t| t.1),
            "attributes": attributes.iter().map(|(name, kind)| json!({ "name": name, "type": kind })).collect::<Vec<_>>(),
        }));
    }
    let mut rows = vec![
        ("format", input.format().name().to_owned()),
        ("bytes", grouped(input.len())),
        ("points", grouped(points as u64)),
    ];
    if invalid > 0 {
        rows.push(("invalid", format!("{} points have NaN or infinite coordinates", grouped(invalid as u64))));
    }
    if let Some((count, area)) = triangles {
        rows.push(("triangles", format!("{}, area {area:.6}", grouped(count as u64))));
    }
    if let Some([min, max]) = bounds {
        let decimals = decimals(&cloud);
        let corner = |c: DVec3| c.to_array().map(|v| shortest(v, decimals)).join(" ");
        rows.push(("min", corner(min)));
        rows.push(("max", corner(max)));
        rows.push(("diagonal", format!("{}", (max - min).length() as f32)));
    }
    rows.extend(spacing_rows(&spacing));
    let names: Vec<String> = attributes.iter().map(|(name, kind)| format!("{name} ({kind})")).collect();
    rows.push(("attributes", if names.is_empty() { "none".to_owned() } else { names.join(", ") }));
    print(&rows.iter().map(|(name, value)| format!("{name:<12}{value}\n")).collect::<String>())
}

fn spacing_rows(spacing: &Spacing) -> [(&'static str, String); 2] {
    let mean = spacing.mean.map_or("none: fewer than two positions".to_owned(), |mean| format!("{}", mean as f32));
    [("spacing", mean), ("duplicates", grouped(spacing.duplicates))]
}

/// Lowest and highest coordinates in world coordinates.
fn world_bounds(cloud: &PointCloud) -> [DVec3; 2] {
    let bounds = cloud.bounds();
    [cloud.origin + bounds.min.as_dvec3(), cloud.origin + bounds.max.as_dvec3()]
}

/// Decimals that offsets of this size can tell apart.
pub(crate) fn decimals(cloud: &PointCloud) -> usize {
    let bounds = cloud.bounds();
    let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
    let step = f64::from(largest.next_up() - largest);
    (-step.log10()).floor().clamp(0.0, 30.0) as usize
}

/// A number with at most this many decimals, without zeros at the end.
pub(crate) fn shortest(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let text = if decimals > 0 { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Name and type of everything a point has beside its position.
fn attributes(cloud: &PointCloud) -> Vec<(String, &'static str)> {
    let mut found = Vec::new();
    found.extend(cloud.normals.as_ref().map(|_| ("normals".to_owned(), "3 x f32")));
    found.extend(cloud.colors.as_ref().map(|_| ("colors".to_owned(), "4 x u8")));
    found.extend(cloud.attributes.iter().map(|a| (a.name.clone(), type_name(&a.values))));
    found
}

fn type_name(column: &Column) -> &'static str {
    match column {
        Column::I8(_) => "i8",
        Column::U8(_) => "u8",
        Column::I16(_) => "i16",
        Column::U16(_) => "u16",
        Column::I32(_) => "i32",
        Column::U32(_) => "u32",
        Column::F32(_) => "f32",
        Column::F64(_) => "f64",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nearfield::Vec3;

    #[test]
    fn coordinates_show_the_digits_they_have() {
        let cloud = PointCloud::new(vec![Vec3::new(589.0, 0.0, 0.0)]); // steps of 2^-14 = 6.1e-5
        assert_eq!(decimals(&cloud), 4);
        assert_eq!(shortest(636_001.760_009_765_6, 4), "636001.76");
        assert_eq!(shortest(-0.000_001, 4), "0");
        assert_eq!(shortest(1200.0, 0), "1200");
        assert_eq!(decimals(&PointCloud::new(vec![Vec3::ZERO])), 30);
    }
}
