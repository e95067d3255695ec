//! `nearfield downsample`: fewer points, by cells, as Poisson disks or each as far as can be from the others.

use clap::{Args, Subcommand, ValueEnum};
use nearfield::application::{
    Extent, FarthestStart, Length, PoissonDiskSettings, VoxelOrigin, VoxelPoint, VoxelSettings, Voxels,
    farthest_points, farthest_points_on_gpu, poisson_disk, voxel_downsample, voxel_downsample_on_gpu,
};
use nearfield::gpu::DeviceChoice;
use nearfield::{PointCloud, Vec3};
use serde_json::{Map, Value, json};

use crate::exit::Failure;
use crate::options::{Amount, Common};
use crate::point_files::{Job, PointFiles, arrays, resolved};
use crate::report::{DIGITS, grouped, short};

/// Make fewer points of many
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nearfield downsample voxel scan.laz --size 0.05 -o few.ply
  nearfield downsample poisson scan.ply --count 20000 -o even.ply
  nearfield downsample farthest scan.ply --count 1024 --seed 7 -o far.ply

Points of `poisson` keep their order in the file. Those of `voxel` stand in the order of the first point of each cell, and those of
`farthest` in the order in which they were taken: the first N of them are the samples for N. All attributes of a point go with
it.")]
pub(crate) struct DownsampleArgs {
    #[command(subcommand)]
    by: By,
}

#[derive(Debug, Subcommand)]
enum By {
    Voxel(VoxelArgs),
    Poisson(PoissonArgs),
    Farthest(FarthestArgs),
}

/// One point for each occupied cell of a grid
///
/// Cells have 63-bit numbers: more than 2,097,152 along an axis are refused. With --point centroid normals and colours are means too;
/// other attributes are those of the point nearest to the centroid.
#[derive(Debug, Args)]
struct VoxelArgs {
    #[command(flatten)]
    files: PointFiles,

    /// Edge of a cell: a length such as 0.25, a part of the diagonal such as 1%, or spacings such as 4x
    #[arg(long, value_name = "LENGTH")]
    size: Length,

    /// Where a cell begins: at the corner of the points, half a cell below it as in Open3D, or at multiples of its size as in PCL
    #[arg(long, value_name = "WHERE", default_value = "corner")]
    origin: Origin,

    /// The point for a cell: the centroid of its points, the one nearest to that, or the first in the file
    #[arg(long, value_name = "WHICH", default_value = "centroid")]
    point: Point,

    /// Where to compute: auto, cpu, gpu, gpu:N as `nearfield devices` counts, or part of a name
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Origin {
    Corner,
    BelowCorner,
    Zero,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Point {
    Centroid,
    Nearest,
    First,
}

/// An exact number of points, evenly spread, by eliminating the others
#[derive(Debug, Args)]
struct PoissonArgs {
    #[command(flatten)]
    files: PointFiles,

    /// How many points stay
    #[arg(long, value_name = "N")]
    count: Amount,

    /// Area of the surface that the points lie on, in squares of their unit [default: estimated from the points]
    #[arg(long, value_name = "AREA", conflicts_with_all = ["volume", "solid"])]
    area: Option<f64>,

    /// Volume that the points fill, in cubes of their unit
    #[arg(long, value_name = "VOLUME", conflicts_with = "solid")]
    volume: Option<f64>,

    /// The points fill a volume, whose size is estimated from them
    #[arg(long)]
    solid: bool,
}

/// Points each the farthest from all before it
#[derive(Debug, Args)]
struct FarthestArgs {
    #[command(flatten)]
    files: PointFiles,

    /// How many points are taken
    #[arg(long, value_name = "N")]
    count: Amount,

    /// Index of the first one [default: 0]
    #[arg(long, value_name = "INDEX", conflicts_with = "seed")]
    start: Option<u32>,

    /// Take the first one at random, by this seed
    #[arg(long, value_name = "SEED")]
    seed: Option<u64>,

    /// Where to compute: auto, cpu, gpu, gpu:N as `nearfield devices` counts, or part of a name
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,
}

/// What was made of the cloud.
struct Made {
    cloud: PointCloud,
    rows: Vec<(&'static str, String)>,
    object: Value,
}

pub(crate) fn run(args: &DownsampleArgs, common: &Common) -> Result<(), Failure> {
    let files = match &args.by {
        By::Voxel(args) => &args.files,
        By::Poisson(args) => &args.files,
        By::Farthest(args) => &args.files,
    };
    files.check(None)?;
    let mut job = Job::start(common);
    // Positions twice, the tree or keys, and what is found.
    let cloud = files.read(&mut job, 100)?;
    let made = match &args.by {
        By::Voxel(args) => args.make(&cloud, &mut job)?,
        By::Poisson(args) => args.make(&cloud, &mut job)?,
        By::Farthest(args) => args.make(&cloud, &mut job)?,
    };
    files.write(&mut job, &made.cloud)?;
    let (before, after) = (cloud.len() as u64, made.cloud.len() as u64);
    let share = if before == 0 { 0.0 } else { 100.0 * after as f64 / before as f64 };
    let mut rows = vec![("points", grouped(before)), ("left", format!("{} ({share:.2} %)", grouped(after)))];
    rows.extend(made.rows);
    let mut object = match made.object {
        Value::Object(object) => object,
        _ => Map::new(),
    };
    object.insert("points".into(), before.into());
    object.insert("left".into(), after.into());
    job.tell(files, false, rows, object)
}

impl VoxelArgs {
    fn make(&self, cloud: &PointCloud, job: &mut Job<'_>) -> Result<Made, Failure> {
        let arrays = arrays(&cloud.points);
        let settings = VoxelSettings {
            size: resolved(self.size, "size", &arrays)?,
            origin: match self.origin {
                Origin::Corner => VoxelOrigin::Corner,
                Origin::BelowCorner => VoxelOrigin::BelowCorner,
                // Of the file's coordinates.
                Origin::Zero => VoxelOrigin::At((-cloud.origin).to_array()),
            },
            point: match self.point {
                Point::Centroid => VoxelPoint::Centroid,
                Point::Nearest => VoxelPoint::Nearest,
                Point::First => VoxelPoint::First,
            },
        };
        let voxels = job.on_device(
            &self.device,
            |gpu, watch| voxel_downsample_on_gpu(gpu, &cloud.points, &settings, watch),
            |watch| voxel_downsample(&arrays, &settings, watch),
        )?;
        let mut made = cloud.reordered(&voxels.representatives).map_err(Failure::Search)?;
        if self.point == Point::Centroid {
            made.points = voxels.points.iter().map(|&p| Vec3::from_array(p)).collect();
            made.normals = cloud.normals.as_ref().map(|normals| mean_normals(normals, &voxels));
            made.colors = cloud.colors.as_ref().map(|colors| mean_colors(colors, &voxels));
        }
        let largest = voxels.counts.iter().copied().max().unwrap_or(0);
        let mean = cloud.len() as f64 / voxels.counts.len().max(1) as f64;
        Ok(Made {
            cloud: made,
            rows: vec![
                ("cells", format!("of {}", short(settings.size as f32, DIGITS))),
                ("points each", format!("mean {mean:.2}, max {}", grouped(largest.into()))),
            ],
            object: json!({ "method": "voxel", "size": settings.size, "largest_cell": largest }),
        })
    }
}

/// The mean normal of each cell, at length 1 where it has one.
fn mean_normals(normals: &[Vec3], voxels: &Voxels<f32>) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; voxels.counts.len()];
    for (normal, &cell) in normals.iter().zip(&voxels.cells) {
        sums[cell as usize] += normal.normalize_or_zero();
    }
    sums.iter().map(|sum| sum.normalize_or_zero()).collect()
}

/// The mean colour of each cell.
fn mean_colors(colors: &[[u8; 4]], voxels: &Voxels<f32>) -> Vec<[u8; 4]> {
    let mut sums = vec![[0u64; 4]; voxels.counts.len()];
    for (color, &cell) in colors.iter().zip(&voxels.cells) {
        sums[cell as usize].iter_mut().zip(color).for_each(|(sum, &c)| *sum += u64::from(c));
    }
    let mean = |(sum, &n): (&[u64; 4], &u32)| sum.map(|sum| ((sum + u64::from(n) / 2) / u64::from(n)) as u8);
    sums.iter().zip(&voxels.counts).map(mean).collect()
}

impl PoissonArgs {
    fn make(&self, cloud: &PointCloud, job: &mut Job<'_>) -> Result<Made, Failure> {
        let extent = match (self.area, self.volume, self.solid) {
            (Some(area), ..) => Extent::Area(area),
            (_, Some(volume), _) => Extent::Volume(volume),
            (.., true) => Extent::Solid,
            _ => Extent::Surface,
        };
        let settings = PoissonDiskSettings { count: self.count.0, extent };
        let samples = job.on_cpu(|watch| poisson_disk(&arrays(&cloud.points), &settings, watch))?;
        Ok(Made {
            cloud: cloud.reordered(&samples.indices).map_err(Failure::Search)?,
            rows: vec![("radius", format!("{} of the densest packing", short(samples.radius as f32, DIGITS)))],
            object: json!({ "method": "poisson", "radius": samples.radius }),
        })
    }
}

impl FarthestArgs {
    fn make(&self, cloud: &PointCloud, job: &mut Job<'_>) -> Result<Made, Failure> {
        let start = self.seed.map_or(FarthestStart::Index(self.start.unwrap_or(0)), FarthestStart::Seed);
        let samples = job.on_device(
            &self.device,
            |gpu, watch| farthest_points_on_gpu(gpu, &cloud.points, self.count.0, start, watch),
            |watch| farthest_points(&arrays(&cloud.points), self.count.0, start, watch),
        )?;
        let last = samples.distances.last().copied().filter(|distance| distance.is_finite());
        let told = last.map_or("none".to_owned(), |distance| short(distance, DIGITS));
        Ok(Made {
            cloud: cloud.reordered(&samples.indices).map_err(Failure::Search)?,
            rows: vec![("distance", format!("{told} from the last one to those before"))],
            object: json!({ "method": "farthest", "first": samples.indices.first(), "last_distance": last }),
        })
    }
}
