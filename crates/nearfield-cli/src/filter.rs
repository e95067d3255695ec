//! `nearfield filter`: outliers and duplicates taken out of a cloud, or marked in it.

use clap::{Args, Subcommand, ValueEnum};
use nearfield::application::{
    Length, OutlierRule, RadiusOutlierSettings, StatisticalOutlierSettings, duplicates, duplicates_on_gpu,
    radius_outliers, radius_outliers_on_gpu, statistical_outliers, statistical_outliers_on_gpu,
};
use nearfield::geometry::Column;
use nearfield::gpu::DeviceChoice;
use nearfield::{PointCloud, query::Summary};
use serde_json::{Map, Value, json};

use crate::exit::Failure;
use crate::options::Common;
use crate::point_files::{Job, PointFiles, arrays, resolved, set_attribute};
use crate::report::{DIGITS, grouped, short};

/// Take outliers or duplicates out of a cloud
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nearfield filter statistical scan.ply --k 20 --ratio 2 -o clean.ply
  nearfield filter radius scan.laz --radius 4x --min-neighbors 3 -o clean.ply
  nearfield filter duplicates scan.xyz --tolerance 0.001 -o clean.xyz

The points that stay keep their order and all of their attributes. With --mark all stay, and attributes of the output say
of each whether it is kept and what was measured.")]
pub(crate) struct FilterArgs {
    #[command(subcommand)]
    by: By,
}

#[derive(Debug, Subcommand)]
enum By {
    Statistical(StatisticalArgs),
    Radius(RadiusArgs),
    Duplicates(DuplicatesArgs),
}

/// Options of every filter.
#[derive(Debug, Args)]
struct Filtered {
    #[command(flatten)]
    files: PointFiles,

    /// Keep all points, and write attributes: `kept`, 1 or 0, and what was measured; indices count the points that are left after
    /// --drop-invalid
    #[arg(long)]
    mark: bool,

    /// Where to compute: auto, cpu, gpu, gpu:N as `nearfield devices` counts, or part of a name
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,
}

/// Points whose mean distance to their nearest is unusually large
///
/// A point is an outlier where that distance lies more than RATIO standard deviations above the mean over all points.
/// Written with --mark: `mean_distance`.
#[derive(Debug, Args)]
struct StatisticalArgs {
    #[command(flatten)]
    filtered: Filtered,

    /// Nearest points that are looked at
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1000))]
    k: u32,

    /// Standard deviations above the mean at which outliers begin
    #[arg(long, value_name = "RATIO", default_value_t = 2.0, allow_negative_numbers = true)]
    ratio: f64,

    /// Whose definition: pcl looks at N other points, open3d counts the point itself as one of them and takes out points that
    /// coincide with all N
    #[arg(long, value_name = "RULE", default_value = "pcl")]
    rule: Rule,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Rule {
    Pcl,
    Open3d,
}

/// Points with few others near them
///
/// Written with --mark: `neighbors`.
#[derive(Debug, Args)]
struct RadiusArgs {
    #[command(flatten)]
    filtered: Filtered,

    /// How near neighbours are: a length such as 0.25, a part of the diagonal such as 1%, or spacings such as 4x
    #[arg(long, value_name = "LENGTH")]
    radius: Length,

    /// Fewest neighbours of a point that stays, not counting itself
    #[arg(long, value_name = "N", default_value_t = 2)]
    min_neighbors: u32,
}

/// Points that are there already
///
/// In the order of the file a point stays where none that stays is within the tolerance. Written with --mark: `original`, the
/// index of the point that stays, counted over the points that are left after --drop-invalid.
#[derive(Debug, Args)]
struct DuplicatesArgs {
    #[command(flatten)]
    filtered: Filtered,

    /// How near duplicates are: 0 for points at one place, a length, a part of the diagonal such as 0.1%, or spacings such as 0.5x
    #[arg(long, value_name = "LENGTH", default_value = "0")]
    tolerance: Length,
}

/// What a filter found.
struct Found {
    kept: Vec<bool>,
    /// Name and values of what was measured.
    measured: (&'static str, Column),
    rows: Vec<(&'static str, String)>,
    object: Map<String, Value>,
}

pub(crate) fn run(args: &FilterArgs, common: &Common) -> Result<(), Failure> {
    let filtered = match &args.by {
        By::Statistical(args) => &args.filtered,
        By::Radius(args) => &args.filtered,
        By::Duplicates(args) => &args.filtered,
    };
    filtered.files.check(None)?;
    let mut job = Job::start(common);
    // Positions twice, the tree, and what is found.
    let cloud = filtered.files.read(&mut job, 80)?;
    let mut found = match &args.by {
        By::Statistical(args) => args.find(&cloud, &mut job)?,
        By::Radius(args) => args.find(&cloud, &mut job)?,
        By::Duplicates(args) => args.find(&cloud, &mut job)?,
    };
    let order: Vec<u32> = found.kept.iter().zip(0..).filter(|(kept, _)| **kept).map(|(_, i)| i).collect();
    let (n, kept) = (cloud.len() as u64, order.len() as u64);
    let after = if filtered.mark {
        let mut marked = cloud;
        set_attribute(&mut marked, "kept", Column::U8(found.kept.iter().map(|&kept| kept.into()).collect()));
        set_attribute(&mut marked, found.measured.0, found.measured.1);
        marked
    } else {
        cloud.reordered(&order).map_err(Failure::Search)?
    };
    filtered.files.write(&mut job, &after)?;
    let share = if n == 0 { 0.0 } else { 100.0 * (n - kept) as f64 / n as f64 };
    let mut rows = vec![("points", grouped(n)), ("kept", grouped(kept))];
    rows.push(("taken out", format!("{} ({share:.2} %)", grouped(n - kept))));
    rows.append(&mut found.rows);
    found.object.insert("points".into(), n.into());
    found.object.insert("kept".into(), kept.into());
    job.tell(&filtered.files, false, rows, found.object)
}

fn object(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(object) => object,
        _ => Map::new(),
    }
}

impl StatisticalArgs {
    fn find(&self, cloud: &PointCloud, job: &mut Job<'_>) -> Result<Found, Failure> {
        let (rule, name) = match self.rule {
            Rule::Pcl => (OutlierRule::Pcl, "pcl"),
            Rule::Open3d => (OutlierRule::Open3d, "open3d"),
        };
        let settings = StatisticalOutlierSettings { k: self.k, ratio: self.ratio, rule };
        let found = job.on_device(
            &self.filtered.device,
            |gpu, watch| statistical_outliers_on_gpu(gpu, &cloud.points, &settings, watch),
            |watch| statistical_outliers(&arrays(&cloud.points), &settings, watch),
        )?;
        let said = |length: f64| short(length as f32, DIGITS);
        let (mean, deviation, limit) = (said(found.mean), said(found.deviation), said(found.limit));
        Ok(Found {
            kept: found.kept,
            rows: vec![
                ("rule", format!("{name}: mean distance to the {} nearest, limit {limit}", self.k)),
                ("distances", format!("mean {mean}, standard deviation {deviation}")),
            ],
            object: object(json!({
                "filter": "statistical", "rule": name, "k": self.k, "ratio": self.ratio, "mean": found.mean,
                "deviation": found.deviation, "limit": found.limit,
            })),
            measured: ("mean_distance", Column::F32(found.mean_distances)),
        })
    }
}

impl RadiusArgs {
    fn find(&self, cloud: &PointCloud, job: &mut Job<'_>) -> Result<Found, Failure> {
        let arrays = arrays(&cloud.points);
        let radius = resolved(self.radius, "radius", &arrays)?;
        let settings = RadiusOutlierSettings::new(radius, self.min_neighbors);
        let found = job.on_device(
            &self.filtered.device,
            |gpu, watch| radius_outliers_on_gpu(gpu, &cloud.points, &settings, watch),
            |watch| radius_outliers(&arrays, &settings, watch),
        )?;
        let of_all = Summary::of(found.neighbors.iter().copied());
        let within = short(radius as f32, DIGITS);
        Ok(Found {
            kept: found.kept,
            rows: vec![
                ("rule", format!("{} or more others within {within}", self.min_neighbors)),
                ("neighbours", format!("mean {:.2}, min {}, max {}", of_all.mean, of_all.min, of_all.max)),
            ],
            object: object(json!({
                "filter": "radius", "radius": radius, "min_neighbors": self.min_neighbors,
                "neighbors_mean": of_all.mean, "neighbors_min": of_all.min, "neighbors_max": of_all.max,
            })),
            measured: ("neighbors", Column::U32(found.neighbors)),
        })
    }
}

impl DuplicatesArgs {
    fn find(&self, cloud: &PointCloud, job: &mut Job<'_>) -> Result<Found, Failure> {
        let arrays = arrays(&cloud.points);
        let tolerance = match self.tolerance {
            Length::Absolute(0.0) => 0.0,
            length => resolved(length, "tolerance", &arrays)?,
        };
        let found = job.on_device(
            &self.filtered.device,
            |gpu, watch| duplicates_on_gpu(gpu, &cloud.points, tolerance, watch),
            |watch| duplicates(&arrays, tolerance, watch),
        )?;
        let rule = match tolerance {
            0.0 => "at one place with one before".to_owned(),
            tolerance => format!("within {} of one before that stays", short(tolerance as f32, DIGITS)),
        };
        Ok(Found {
            kept: found.kept,
            rows: vec![("duplicates", rule)],
            object: object(json!({ "filter": "duplicates", "tolerance": tolerance })),
            measured: ("original", Column::U32(found.originals)),
        })
    }
}
