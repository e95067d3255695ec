//! `nearfield cluster`: clusters by density or by distance, as a column and as a picture.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, Subcommand};
use nearfield::application::{
    Clusters, DbscanSettings, EuclideanSettings, Length, dbscan, dbscan_on_gpu, euclidean_clusters,
    euclidean_clusters_on_gpu,
};
use nearfield::geometry::Column;
use nearfield::gpu::DeviceChoice;
use nearfield::io::write_atomically;
use nearfield::{Aabb, PointCloud};
use serde_json::{Map, Value, json};

use crate::colormap::category;
use crate::exit::Failure;
use crate::input::file_name;
use crate::options::{Common, Framing};
use crate::picture::{self, Image, Scene};
use crate::point_files::{Job, PointFiles, arrays, resolved, set_attribute};
use crate::report::{DIGITS, grouped, milliseconds, short, stage_json};

/// Points in no cluster, on pictures.
const GREY: [u8; 3] = [82, 84, 90];
/// Largest clusters that are told one by one.
const TOLD: usize = 5;

/// Find clusters of points
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nearfield cluster dbscan scan.ply --eps 4x --min-points 10 -o labelled.ply --picture clusters.png
  nearfield cluster euclidean scan.pcd --radius 0.5 --min-size 100 -o labelled.ply

The output is the cloud with the attribute `label`: the number of each point's cluster from 0 on, in the order of their smallest
core index, and -1 for points in none. dbscan adds `core`, 1 for core points. The labels are those of scikit-learn.")]
pub(crate) struct ClusterArgs {
    #[command(subcommand)]
    by: By,
}

#[derive(Debug, Subcommand)]
enum By {
    Dbscan(DbscanArgs),
    Euclidean(EuclideanArgs),
}

/// Options of every way to cluster.
#[derive(Debug, Args)]
struct Clustered {
    #[command(flatten)]
    files: PointFiles,

    /// Draw the points, coloured by cluster, into a PNG file
    #[arg(long, value_name = "OUT.png")]
    picture: Option<PathBuf>,

    #[command(flatten)]
    framing: Framing,

    /// Where to compute: auto, cpu, gpu, gpu:N as `nearfield devices` counts, or part of a name
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,
}

/// Clusters of dense points, with noise between them
///
/// A point with enough points within EPS, itself among them, is a core point; core points that near are of one cluster, and points
/// that near to a core point are at its border. A border point of two clusters joins the one with the smaller number.
#[derive(Debug, Args)]
struct DbscanArgs {
    #[command(flatten)]
    clustered: Clustered,

    /// How near neighbours are: a length such as 0.25, a part of the diagonal such as 1%, or spacings such as 4x
    #[arg(long, value_name = "LENGTH")]
    eps: Length,

    /// Fewest points within EPS of a core point, itself among them
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    min_points: u32,
}

/// Points that hang together by distance
#[derive(Debug, Args)]
struct EuclideanArgs {
    #[command(flatten)]
    clustered: Clustered,

    /// Points at most so far apart are of one cluster: a length, a part of the diagonal such as 1%, or spacings such as 4x
    #[arg(long, value_name = "LENGTH")]
    radius: Length,

    /// Leave out clusters of fewer points
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    min_size: u64,

    /// Leave out clusters of more points [default: none]
    #[arg(long, value_name = "N")]
    max_size: Option<u64>,
}

/// What was found, in words and as an object.
struct Found {
    clusters: Clusters,
    method: String,
    object: Value,
    writes_core: bool,
}

pub(crate) fn run(args: &ClusterArgs, common: &Common) -> Result<(), Failure> {
    let clustered = match &args.by {
        By::Dbscan(args) => &args.clustered,
        By::Euclidean(args) => &args.clustered,
    };
    let files = &clustered.files;
    files.check(clustered.picture.as_deref())?;
    let mut job = Job::start(common);
    // Positions twice, the tree, and what is found.
    let mut cloud = files.read(&mut job, 80)?;
    let found = match &args.by {
        By::Dbscan(args) => args.find(&cloud, &mut job)?,
        By::Euclidean(args) => args.find(&cloud, &mut job)?,
    };
    let clusters = &found.clusters;
    set_attribute(&mut cloud, "label", Column::I32(clusters.labels.clone()));
    if found.writes_core {
        set_attribute(&mut cloud, "core", Column::U8(clusters.is_core.iter().map(|&core| core.into()).collect()));
    }
    files.write(&mut job, &cloud)?;
    if let Some(path) = &clustered.picture {
        let clock = Instant::now();
        job.progress.step(format!("drawing {}", path.display()));
        let image = clustered.draw(&cloud, &found);
        write_atomically(path, files.force, |w| image.write_png(w)).map_err(Failure::writing)?;
        job.times.picture = milliseconds(clock);
    }
    let to_stderr = clustered.picture.as_deref() == Some(Path::new("-"));
    let (rows, object) = found.told();
    job.tell(files, to_stderr, rows, object)
}

impl DbscanArgs {
    fn find(&self, cloud: &PointCloud, job: &mut Job<'_>) -> Result<Found, Failure> {
        let arrays = arrays(&cloud.points);
        let eps = resolved(self.eps, "eps", &arrays)?;
        let settings = DbscanSettings::new(eps, self.min_points);
        let clusters = job.on_device(
            &self.clustered.device,
            |gpu, watch| dbscan_on_gpu(gpu, &cloud.points, &settings, watch),
            |watch| dbscan(&arrays, &settings, watch),
        )?;
        let method = format!("dbscan, {} points within {}", self.min_points, short(eps as f32, DIGITS));
        let object = json!({ "method": "dbscan", "eps": eps, "min_points": self.min_points });
        Ok(Found { clusters, method, object, writes_core: true })
    }
}

impl EuclideanArgs {
    fn find(&self, cloud: &PointCloud, job: &mut Job<'_>) -> Result<Found, Failure> {
        let arrays = arrays(&cloud.points);
        let radius = resolved(self.radius, "radius", &arrays)?;
        let max_size = self.max_size.unwrap_or(u64::MAX);
        let settings = EuclideanSettings { radius, min_size: self.min_size, max_size };
        let clusters = job.on_device(
            &self.clustered.device,
            |gpu, watch| euclidean_clusters_on_gpu(gpu, &cloud.points, &settings, watch),
            |watch| euclidean_clusters(&arrays, &settings, watch),
        )?;
        let method = format!("euclidean, within {}", short(radius as f32, DIGITS));
        let object = json!({
            "method": "euclidean", "radius": radius, "min_size": self.min_size, "max_size": self.max_size,
            "too_small": { "clusters": clusters.too_small.clusters, "points": clusters.too_small.points },
            "too_large": { "clusters": clusters.too_large.clusters, "points": clusters.too_large.points },
        });
        Ok(Found { clusters, method, object, writes_core: false })
    }
}

impl Found {
    fn told(self) -> (Vec<(&'static str, String)>, Map<String, Value>) {
        let clusters = &self.clusters;
        let (n, none) = (clusters.labels.len() as u64, clusters.unlabelled());
        let core = clusters.is_core.iter().filter(|core| **core).count() as u64;
        let mut sizes = clusters.sizes();
        sizes.sort_unstable_by(|a, b| b.cmp(a));
        let mut rows = vec![("points", grouped(n)), ("method", self.method)];
        let largest: Vec<String> = sizes.iter().take(TOLD).map(|&size| grouped(size)).collect();
        let largest =
            if largest.is_empty() { String::new() } else { format!(", the largest of {}", largest.join(", ")) };
        rows.push(("clusters", format!("{}{largest} points", grouped(clusters.n_clusters.into()))));
        if self.writes_core {
            rows.push(("core points", grouped(core)));
            rows.push(("border", grouped(n - core - none)));
            rows.push(("noise", grouped(none)));
        }
        for (left, name) in [(clusters.too_small, "too small"), (clusters.too_large, "too large")] {
            if left.clusters > 0 {
                let told = format!("{} clusters of {} points", grouped(left.clusters), grouped(left.points));
                rows.push((name, told));
            }
        }
        let mut object = match self.object {
            Value::Object(object) => object,
            _ => Map::new(),
        };
        object.insert("points".into(), n.into());
        object.insert("clusters".into(), clusters.n_clusters.into());
        object.insert("largest".into(), json!(sizes.iter().take(TOLD).collect::<Vec<_>>()));
        object.insert("core_points".into(), core.into());
        object.insert("unlabelled".into(), none.into());
        object.insert("stages".into(), clusters.stages.iter().map(stage_json).collect());
        (rows, object)
    }
}

impl Clustered {
    fn draw(&self, cloud: &PointCloud, found: &Found) -> Image {
        let color = |&label: &i32| u32::try_from(label).map_or(GREY, category);
        let colors: Vec<[u8; 3]> = found.clusters.labels.iter().map(color).collect();
        let extent = Aabb::of_points(&cloud.points).extent();
        let scene = Scene {
            points: &cloud.points,
            colors: &colors,
            sizes: &[],
            focus: &[],
            up: self.framing.up.unwrap_or_else(|| picture::likely_up(extent, false)),
            title: format!(
                "{}: {} clusters of {} points",
                file_name(&self.files.input),
                grouped(found.clusters.n_clusters.into()),
                grouped(cloud.len() as u64)
            ),
            subtitle: format!("{}; grey points are in none", found.method),
            bar: None,
            swatches: vec![],
        };
        picture::draw(&scene, self.framing.size())
    }
}
