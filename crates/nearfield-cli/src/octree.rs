//! `nearfield octree`: the linear octree of a file, where places lie in it, and its parts for many processes.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nearfield::application::{Exchange, Partition, PartitionReport};
use nearfield::gpu::DeviceChoice;
use nearfield::io::Format;
use nearfield::query::Stage;
use nearfield::{
    Curve, DVec3, FixedRadius, Gpu, GpuLinearOctree, LinearOctree, NeighborSearch, OctreeSettings, PointCloud, Vec3,
};

use crate::exit::Failure;
use crate::input::{Input, file_name, searchable};
use crate::options::{Common, Length, PictureSize, place};
use crate::picture::{self, Up};
use crate::progress::Progress;
use crate::report::{self, Times, milliseconds};
use crate::{fallback, octree_file, octree_picture, octree_report};

const EXAMPLES: &str = "Examples:
  nearfield octree scan.pcd --output tree.npz --picture cells.png
  nearfield octree scan.pcd --parts 8 --radius 0.5 --curve hilbert --picture parts.png
  nearfield octree scan.laz --locate 637010.5,849003.25,404 --json

A file with triangles enters by their centroids, one point a triangle; with --vertices by its vertices.
Octants with more than --leaf points are cut into eight, down to --max-depth; octants without points are left out.
--locate tells the smallest node around a place of the file's coordinates: a leaf, or an inner node with nothing there.

--parts cuts the curve between leaves so that the parts have nearly equal numbers of points. `surface` counts leaves that
touch a leaf with points of another part. With --radius, `sent` counts the points that lie within the radius of a point
of another part, once for each such part; a part that receives them can search all its points within the radius alone.

The picture shows the points in the colours of their parts, or without --parts the cells that a plane cuts: across the
axis on which the points spread least, through the median point there.

tree.npz holds, a node each in breadth-first order: octants (u64: a 1 bit and behind it the 3 x level bits of the key),
levels and child_masks (u8), first_points, end_points, parents, first_children, pre_order, post_order (u32; 4294967295
for none); and a point each: order (u32, the points' indices along the curve: node i holds
order[first_points[i]..end_points[i]]) and, with --parts, part_of_point (u32, in the order of the file).";

/// Build an octree: nodes by level, where places lie in it, equal parts along its curve
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct OctreeArgs {
    /// Points or triangles: any file that `nearfield formats` lists, or - for standard input
    input: PathBuf,

    /// Most points of a leaf above the depth limit
    #[arg(long, value_name = "N", default_value_t = OctreeSettings::DEFAULT.leaf_capacity)]
    leaf: u32,

    /// Deepest level, 0 to 21
    #[arg(long, value_name = "LEVEL", default_value_t = 21, value_parser = clap::value_parser!(u32).range(0..=21))]
    max_depth: u32,

    /// Order of points and octants: morton or hilbert
    #[arg(long, value_name = "CURVE", default_value = "morton")]
    curve: Curve,

    /// Split the leaves into P parts of equal work, and tell what they cost on either curve
    #[arg(long, value_name = "P", value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    parts: Option<u32>,

    /// Count what the parts must send each other to search within this radius: a length, or a part of the bounding-box
    /// diagonal such as 0.5%
    #[arg(long, short, value_name = "R|P%", allow_hyphen_values = true, requires = "parts")]
    radius: Option<Length>,

    /// Bytes of a point that is sent
    #[arg(long, value_name = "N", default_value_t = 16, requires = "radius")]
    bytes_per_point: u32,

    /// Tell the node and the part of this place; may be given more than once
    #[arg(long, value_name = "X,Y,Z", value_parser = place, allow_hyphen_values = true)]
    locate: Vec<DVec3>,

    /// Where to build: auto, cpu, gpu, gpu:N as `nearfield devices` counts, or part of a name
    #[arg(long, value_name = "D", default_value = "auto")]
    device: DeviceChoice,

    /// Take the vertices of a mesh, not the centroids of its triangles
    #[arg(long)]
    vertices: bool,

    /// Drop points with NaN or infinite coordinates instead of refusing the file
    #[arg(long)]
    drop_invalid: bool,

    /// Write the tree: OUT.npz
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,

    /// Draw the parts, or without --parts the cells of a slice, into a PNG file
    #[arg(long, value_name = "OUT.png")]
    picture: Option<PathBuf>,

    /// Width and height of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = "1600x1000", requires = "picture")]
    picture_size: PictureSize,

    /// The direction that is up in the picture of the parts [default: guessed from the shape]
    #[arg(long, value_name = "AXIS", requires = "picture")]
    up: Option<Up>,

    /// Print everything as one JSON object
    #[arg(long)]
    json: bool,

    /// Format of the input, where its extension does not say it
    #[arg(long, value_name = "F")]
    format: Option<Format>,

    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

/// Everything worth telling about a tree.
pub(crate) struct Octree {
    pub(crate) name: String,
    /// What the points are: "points" or "triangle centroids".
    pub(crate) source: &'static str,
    pub(crate) cloud: PointCloud,
    pub(crate) tree: LinearOctree,
    pub(crate) split: Option<Split>,
    pub(crate) located: Vec<DVec3>,
    pub(crate) device: String,
    pub(crate) memory_bytes: u64,
    pub(crate) stages: Vec<Stage>,
    pub(crate) times: Vec<(&'static str, f64)>,
    pub(crate) notes: Vec<String>,
}

/// The parts of a tree.
pub(crate) struct Split {
    pub(crate) partition: Partition,
    pub(crate) exchange: Option<Exchange>,
    pub(crate) report: PartitionReport,
    /// The same along the other curve.
    pub(crate) other: PartitionReport,
}

pub(crate) fn run(args: &OctreeArgs, common: &Common) -> Result<(), Failure> {
    args.check_outputs()?;
    let (mut times, mut notes) = (Times::default(), Vec::new());
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let clock = Instant::now();
    let (cloud, source) = args.read(common, &mut notes)?;
    times.read = milliseconds(clock);
    let exchange = args.exchange(&cloud)?;

    progress.step("building the octree");
    let settings = OctreeSettings::default().leaf_capacity(args.leaf).max_level(args.max_depth).curve(args.curve);
    let built = Built::of(&cloud.points, &settings, &args.device, &mut times, &mut notes).map_err(Failure::Search)?;
    common.allow("the octree", 12 * cloud.len() as u64 + built.memory_bytes).map_err(Failure::Search)?;

    let mut partition_ms = None;
    let split = match args.parts {
        Some(parts) => {
            progress.step("measuring the parts");
            let clock = Instant::now();
            let split = Split::of(&built.tree, &cloud.points, parts, exchange).map_err(Failure::Search)?;
            partition_ms = Some(milliseconds(clock));
            Some(split)
        }
        None => None,
    };
    let mut octree = Octree {
        name: file_name(&args.input),
        source,
        cloud,
        tree: built.tree,
        split,
        located: args.locate.clone(),
        device: built.device,
        memory_bytes: built.memory_bytes,
        stages: built.stages,
        times: Vec::new(),
        notes,
    };
    if let Some(path) = &args.output {
        progress.step(format!("writing {}", path.display()));
        let clock = Instant::now();
        octree_file::write(path, &octree, args.force).map_err(Failure::writing)?;
        times.write = milliseconds(clock);
    }
    if let Some(path) = &args.picture {
        progress.step(format!("drawing {}", path.display()));
        let clock = Instant::now();
        let image = octree_picture::draw(&octree, args.up(&octree.cloud), args.picture_size);
        nearfield::io::write_atomically(path, args.force, |w| image.write_png(w)).map_err(Failure::writing)?;
        times.picture = milliseconds(clock);
    }
    drop(progress);
    octree.times = vec![
        ("read", times.read),
        ("open", times.open),
        ("upload", times.upload),
        ("build", times.build),
        ("read_back", times.read_back),
        ("partition", partition_ms.unwrap_or(0.0)),
        ("write", times.write),
        ("picture", times.picture),
    ];
    args.tell(&octree, common)
}

impl OctreeArgs {
    /// Says what cannot work before the work is done.
    fn check_outputs(&self) -> Result<(), Failure> {
        let stdout = Some(Path::new("-"));
        if self.json && self.picture.as_deref() == stdout {
            return Err(Failure::Usage("only one of --json and --picture - can have standard output".into()));
        }
        for (option, path, extension, kind) in
            [("output", &self.output, "npz", "trees"), ("picture", &self.picture, "png", "pictures")]
        {
            let Some(path) = path.as_deref() else { continue };
            let fits = path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
            let is_stdout = option == "picture" && Some(path) == stdout;
            if !(fits || is_stdout) {
                let text = format!("--{option} {}: {kind} are written as .{extension}", path.display());
                return Err(Failure::Usage(text));
            }
            crate::output::check(path, self.force)?;
        }
        Ok(())
    }

    /// The points, and what they are.
    fn read(&self, common: &Common, notes: &mut Vec<String>) -> Result<(PointCloud, &'static str), Failure> {
        let input = Input::open(&self.input, self.format, common)?;
        let mesh = if self.vertices { None } else { input.mesh()? };
        let (cloud, source) = match mesh {
            Some(mesh) => {
                let points = mesh.centroids();
                (PointCloud { origin: mesh.origin, points, ..PointCloud::default() }, "triangle centroids")
            }
            None => (input.cloud()?, "points"),
        };
        Ok((searchable(cloud, &self.input, self.drop_invalid, notes)?, source))
    }

    fn exchange(&self, cloud: &PointCloud) -> Result<Option<Exchange>, Failure> {
        let Some(radius) = self.radius else { return Ok(None) };
        let radius = radius.within(&cloud.bounds());
        FixedRadius::new(radius).validate(cloud.len()).map_err(Failure::Search)?;
        Ok(Some(Exchange { radius, bytes_per_point: self.bytes_per_point }))
    }

    fn up(&self, cloud: &PointCloud) -> Up {
        let format = self.format.or_else(|| Format::from_path(&self.input).ok());
        let modelling = matches!(format, Some(Format::Obj | Format::Ply));
        self.up.unwrap_or_else(|| picture::likely_up(cloud.bounds().extent(), modelling))
    }

    fn tell(&self, octree: &Octree, common: &Common) -> Result<(), Failure> {
        if self.json {
            return report::print_json(&octree_report::json(octree));
        }
        if common.quiet {
            return Ok(());
        }
        let lines = octree_report::lines(octree);
        if self.picture.as_deref() == Some(Path::new("-")) {
            eprint!("{lines}");
            return Ok(());
        }
        report::print(&lines)
    }
}

/// A tree, and where it was built.
struct Built {
    tree: LinearOctree,
    device: String,
    memory_bytes: u64,
    stages: Vec<Stage>,
}

impl Built {
    /// Builds on the device that was chosen; only `auto` falls back to the CPU, with a note.
    fn of(
        points: &[Vec3],
        settings: &OctreeSettings,
        device: &DeviceChoice,
        times: &mut Times,
        notes: &mut Vec<String>,
    ) -> nearfield::Result<Self> {
        let clock = Instant::now();
        let on_gpu = |gpu: &Gpu| Self::on_gpu(gpu, points, settings, clock, times);
        if let Some(built) = fallback::on_gpu(device, notes, on_gpu)? {
            return Ok(built);
        }
        let clock = Instant::now();
        let tree = LinearOctree::build(points, settings)?;
        let stages = NeighborSearch::build_stages(&tree);
        times.build = milliseconds(clock);
        Ok(Self { device: tree.device(), memory_bytes: NeighborSearch::memory_bytes(&tree), stages, tree })
    }

    fn on_gpu(
        gpu: &Gpu,
        points: &[Vec3],
        settings: &OctreeSettings,
        opened: Instant,
        times: &mut Times,
    ) -> nearfield::Result<Self> {
        let on_device = GpuLinearOctree::build(gpu, points, settings)?;
        let stages = NeighborSearch::build_stages(&on_device);
        times.built(milliseconds(opened), &stages);
        let clock = Instant::now();
        let tree = on_device.read()?;
        times.read_back = milliseconds(clock);
        let (device, memory_bytes) = (on_device.device(), NeighborSearch::memory_bytes(&on_device));
        Ok(Self { tree, device, memory_bytes, stages })
    }
}

impl Split {
    fn of(tree: &LinearOctree, points: &[Vec3], parts: u32, exchange: Option<Exchange>) -> nearfield::Result<Self> {
        let partition = Partition::of_tree(tree, parts)?;
        let report = partition.report(tree, exchange.as_ref())?;
        let other = if tree.curve() == Curve::Morton { Curve::Hilbert } else { Curve::Morton };
        let tree = LinearOctree::build(points, &tree.settings().curve(other))?;
        let other = Partition::of_tree(&tree, parts)?.report(&tree, exchange.as_ref())?;
        Ok(Self { partition, exchange, report, other })
    }

    /// Along Morton's curve, then along Hilbert's.
    pub(crate) fn both(&self) -> [&PartitionReport; 2] {
        match self.report.curve {
            Curve::Morton => [&self.report, &self.other],
            Curve::Hilbert => [&self.other, &self.report],
        }
    }
}
