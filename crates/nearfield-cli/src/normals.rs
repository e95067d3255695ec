//! `nearfield normals`: normals of the points of a cloud, and their sides.

use std::fmt;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use clap::Args;
use nearfield::application::{
    self, Length, Neighborhood, NormalMethod, NormalSettings, Normals, PointFlags, Viewpoint, Watch,
};
use nearfield::geometry::{Attribute, Column};
use nearfield::gpu::DeviceChoice;
use nearfield::io::{Format, WriteOptions, write_atomically, write_cloud};
use nearfield::{AabbTreeN, AabbTreeNSettings, DVec3, Error, PointCloud, Vec3};
use serde_json::{Map, Value, json};

use crate::exit::Failure;
use crate::fallback::on_gpu;
use crate::input::{Input, file_name, searchable};
use crate::interrupt;
use crate::options::{Common, Framing, SummaryOptions, place};
use crate::output;
use crate::picture::{self, Image, Scene};
use crate::progress::Progress;
use crate::report::{Times, grouped, milliseconds, print, print_json, rounded, shown_ms};

/// Neighbours that orientation is passed along.
const JOINED: u32 = 12;
const GREY: [u8; 3] = [120, 124, 130];

/// Estimate normals of a point cloud and turn them to one side
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nearfield normals scan.ply -o normals.ply --picture normals.png
  nearfield normals scan.laz --radius 2% --method jet --orient viewpoint:637000,851200,900 -o normals.ply
  nearfield normals leaves.ply --k 32 --orient winding-number -o normals.ply

pca takes the direction in which the neighbours spread least; jet fits a surface of degree 2 to them, which is better where the
surface is curved and under noise with many neighbours, and gives its principal curvatures.

viewpoint:X,Y,Z turns every normal to that place, in the coordinates of the file. spanning-tree passes the side from neighbour to
neighbour along the safest way, and turns each connected part outward. winding-number turns all to the outside of the surface
that they bound; it takes longer, and is right on thin sheets and on surfaces that touch.

The cloud is written with everything it had, and with its normals, surface_variation (0 on a plane, 1/3 at most), curvature_max
and curvature_min by jet, and flags where any is set: 1 few neighbours, 2 neighbours on a line or at one place. Points
without a normal get 0 0 0.")]
pub(crate) struct NormalsArgs {
    /// Points: any file that `nearfield formats` lists, or - for standard input
    input: PathBuf,

    /// Nearest points that an estimate is made from, the point itself among them
    #[arg(long, value_name = "N", default_value_t = 24, conflicts_with = "radius")]
    k: u32,

    /// Take all points within this distance instead: 0.25, 2% of the diagonal, or 4x the spacing
    #[arg(long, value_name = "LENGTH")]
    radius: Option<Length>,

    /// How normals are estimated
    #[arg(long, value_name = "METHOD", value_enum, default_value_t = Method::Pca)]
    method: Method,

    /// Count near neighbours more
    #[arg(long)]
    weighted: bool,

    /// To which side normals are turned: none, viewpoint:X,Y,Z, spanning-tree or winding-number
    #[arg(long, value_name = "HOW", default_value_t = Orient::SpanningTree)]
    orient: Orient,

    /// Where normals are estimated: auto, cpu, gpu, gpu:N as `nearfield devices` counts, or part of a name
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,

    /// Write the cloud with its normals, or - for standard output
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,

    /// Draw the points, coloured by their normals, into a PNG file
    #[arg(long, value_name = "OUT.png")]
    picture: Option<PathBuf>,

    #[command(flatten)]
    framing: Framing,

    #[command(flatten)]
    files: SummaryOptions,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    Pca,
    Jet,
}

/// To which side normals are turned.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Orient {
    None,
    Viewpoint(DVec3),
    SpanningTree,
    WindingNumber,
}

impl Orient {
    fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Viewpoint(_) => "viewpoint",
            Self::SpanningTree => "spanning-tree",
            Self::WindingNumber => "winding-number",
        }
    }
}

impl fmt::Display for Orient {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Viewpoint(eye) => write!(f, "viewpoint:{},{},{}", eye.x, eye.y, eye.z),
            other => f.write_str(other.name()),
        }
    }
}

impl FromStr for Orient {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "none" => Ok(Self::None),
            "spanning-tree" => Ok(Self::SpanningTree),
            "winding-number" => Ok(Self::WindingNumber),
            other => match other.strip_prefix("viewpoint:") {
                Some(eye) => place(eye).map(Self::Viewpoint),
                None => Err("expected none, viewpoint:X,Y,Z, spanning-tree or winding-number".to_owned()),
            },
        }
    }
}

/// What was made, and how.
struct Made {
    normals: Normals<f32>,
    device: String,
    /// Words and numbers on the orientation.
    turned: Turned,
    notes: Vec<String>,
    times: Times,
    /// Milliseconds of the orientation.
    orient: f64,
}

/// What an orientation tells.
#[derive(Default)]
struct Turned {
    words: String,
    numbers: Map<String, Value>,
}

pub(crate) fn run(args: &NormalsArgs, common: &Common) -> Result<(), Failure> {
    let to = args.check_outputs()?;
    let settings = args.settings();
    settings.validate().map_err(Failure::Search)?;
    interrupt::watch();
    let (mut notes, mut times) = (vec![], Times::default());
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let clock = Instant::now();
    let input = Input::open(&args.input, args.files.format, common)?;
    if let (Some(_), Some(mesh)) = (to, input.mesh()?) {
        let triangles = grouped(mesh.triangles.len() as u64);
        notes.push(format!("{triangles} triangles are left out, normals are of the vertices as points"));
    }
    let mut cloud = searchable(input.cloud()?, &args.input, args.files.drop_invalid, &mut notes)?;
    drop(input);
    times.read = milliseconds(clock);
    // The tree, positions, and what is found.
    common.allow("the normals", 120 * cloud.len() as u64).map_err(Failure::Search)?;
    let mut made = args.estimate(&cloud, &settings, (notes, times), &progress)?;
    args.orient(&cloud, &mut made, &progress)?;
    if cloud.normals.is_some() {
        made.notes.push("the normals of the file are replaced".to_owned());
    }
    add_columns(&mut cloud, &made.normals);
    args.write(&cloud, &mut made, to, &progress)?;
    drop(progress);
    args.tell(&cloud, &made, common)
}

/// Runs `work` with a watch that shows how far it is and ends it where the user wants that.
fn watched<T>(progress: &Progress, work: impl FnOnce(&mut Watch<'_>) -> nearfield::Result<T>) -> Result<T, Failure> {
    let mut tell = |at: application::Progress| {
        let percent = (100 * at.done).checked_div(at.total).unwrap_or(100);
        progress.step(format!("{}, {percent} %", at.stage));
        if interrupt::asked() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    work(&mut Watch::new(&mut tell)).map_err(|error| match error {
        Error::Interrupted { .. } => Failure::Interrupted(format!("{error}; nothing was written")),
        other => Failure::Search(other),
    })
}

fn tree_of(points: &[Vec3]) -> nearfield::Result<AabbTreeN<f32, 3>> {
    AabbTreeN::build(&arrays(points), &AabbTreeNSettings::default())
}

fn arrays(points: &[Vec3]) -> Vec<[f32; 3]> {
    points.iter().map(|p| p.to_array()).collect()
}

impl NormalsArgs {
    fn settings(&self) -> NormalSettings {
        NormalSettings {
            neighborhood: self.radius.map_or(Neighborhood::Nearest(self.k), Neighborhood::Within),
            method: match self.method {
                Method::Pca => NormalMethod::Pca,
                Method::Jet => NormalMethod::Jet,
            },
            weighted: self.weighted,
        }
    }

    /// Says what cannot work before the work is done; the format of the output, where there is one.
    fn check_outputs(&self) -> Result<Option<Format>, Failure> {
        let stdout = |path: &Option<PathBuf>| path.as_deref() == Some(Path::new("-"));
        let to_stdout =
            usize::from(self.files.json) + usize::from(stdout(&self.output)) + usize::from(stdout(&self.picture));
        if to_stdout > 1 {
            return Err(Failure::Usage(
                "only one of --json, --output - and --picture - can have standard output".into(),
            ));
        }
        if let Some(path) = self.picture.as_deref().filter(|p| *p != Path::new("-"))
            && !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"))
        {
            return Err(Failure::Usage(format!("--picture {}: pictures are written as .png", path.display())));
        }
        let to = self.output.as_deref().map(|path| output::format(path, self.files.to)).transpose()?;
        if let Some(to) = to.filter(|to| !to.info().writes_cloud) {
            return Err(Failure::Usage(format!("{to} is not written for points; `nearfield formats` lists what is")));
        }
        for path in [&self.output, &self.picture].into_iter().flatten() {
            output::check(path, self.files.force)?;
        }
        Ok(to)
    }

    fn estimate(
        &self,
        cloud: &PointCloud,
        settings: &NormalSettings,
        (mut notes, mut times): (Vec<String>, Times),
        progress: &Progress,
    ) -> Result<Made, Failure> {
        progress.step("estimating normals");
        let clock = Instant::now();
        let on_device = |gpu: &nearfield::Gpu| {
            let normals = application::estimate_normals_on_gpu(gpu, &cloud.points, settings)?;
            Ok((normals, gpu.name().to_owned()))
        };
        let on_device = on_gpu(&self.device, &mut notes, on_device).map_err(Failure::Search)?;
        let (normals, device) = match on_device {
            Some(made) => made,
            None => {
                let clock = Instant::now();
                let tree = tree_of(&cloud.points).map_err(Failure::Search)?;
                times.build = milliseconds(clock);
                let normals = watched(progress, |watch| application::estimate_normals(&tree, settings, watch))?;
                (normals, format!("cpu ({} threads)", rayon::current_num_threads()))
            }
        };
        times.query = milliseconds(clock) - times.build;
        Ok(Made { normals, device, turned: Turned::default(), notes, times, orient: 0.0 })
    }

    fn orient(&self, cloud: &PointCloud, made: &mut Made, progress: &Progress) -> Result<(), Failure> {
        let clock = Instant::now();
        let normals = &mut made.normals;
        made.turned = match self.orient {
            Orient::None => Turned::default(),
            Orient::Viewpoint(eye) => {
                let eye = Viewpoint::One((eye - cloud.origin).as_vec3().to_array());
                let flipped = application::orient_by_viewpoint(&arrays(&cloud.points), normals, eye);
                Turned::of(None, flipped.map_err(Failure::Search)?, &[])
            }
            Orient::SpanningTree => {
                progress.step("orienting normals");
                let tree = tree_of(&cloud.points).map_err(Failure::Search)?;
                let tree =
                    watched(progress, |watch| application::orient_by_spanning_tree(&tree, normals, JOINED, watch))?;
                let words =
                    format!("{} parts, the largest of {} points", grouped(tree.components), grouped(tree.largest));
                let numbers = [("components", json!(tree.components)), ("largest_component", json!(tree.largest))];
                Turned::of(Some(words), tree.flipped, &numbers)
            }
            Orient::WindingNumber => {
                progress.step("orienting normals");
                let tree = tree_of(&cloud.points).map_err(Failure::Search)?;
                let by =
                    watched(progress, |watch| application::orient_by_winding_number(&tree, normals, JOINED, watch))?;
                let words = format!("{} patches, winding number off by {:.3}", grouped(by.patches), by.deviation);
                let numbers = [("patches", json!(by.patches)), ("winding_deviation", json!(by.deviation))];
                Turned::of(Some(words), by.flipped, &numbers)
            }
        };
        made.orient = milliseconds(clock);
        Ok(())
    }

    fn write(
        &self,
        cloud: &PointCloud,
        made: &mut Made,
        to: Option<Format>,
        progress: &Progress,
    ) -> Result<(), Failure> {
        let clock = Instant::now();
        if let (Some(path), Some(format)) = (&self.output, to) {
            progress.step(format!("writing {}", path.display()));
            let options = WriteOptions { format: Some(format), force: self.files.force, ascii: self.files.ascii };
            write_cloud(path, cloud, &options).map_err(Failure::writing)?;
            made.times.write = milliseconds(clock);
        }
        let clock = Instant::now();
        if let Some(path) = &self.picture {
            progress.step(format!("drawing {}", path.display()));
            let image = self.draw(cloud, made);
            write_atomically(path, self.files.force, |w| image.write_png(w)).map_err(Failure::writing)?;
            made.times.picture = milliseconds(clock);
        }
        Ok(())
    }

    fn draw(&self, cloud: &PointCloud, made: &Made) -> Image {
        let format = self.files.format.or_else(|| Format::from_path(&self.input).ok());
        let modelling = matches!(format, Some(Format::Obj | Format::Ply));
        let colors: Vec<[u8; 3]> = made.normals.vectors.iter().map(|&normal| color(normal)).collect();
        let scene = Scene {
            points: &cloud.points,
            colors: &colors,
            sizes: &[],
            focus: &[],
            up: self.framing.up.unwrap_or_else(|| picture::likely_up(cloud.bounds().extent(), modelling)),
            title: format!("{}: normals of {} points", file_name(&self.input), grouped(cloud.len() as u64)),
            subtitle: format!("red, green and blue grow along x, y and z; {}", self.words(made)),
            bar: None,
            swatches: vec![],
        };
        picture::draw(&scene, self.framing.size())
    }

    /// How normals were turned, in words.
    fn words(&self, made: &Made) -> String {
        match (self.orient, made.turned.words.as_str()) {
            (Orient::None, _) => "not oriented".to_owned(),
            (how, "") => format!("by {}", how.name()),
            (how, words) => format!("by {}: {words}", how.name()),
        }
    }

    fn tell(&self, cloud: &PointCloud, made: &Made, common: &Common) -> Result<(), Failure> {
        let points = cloud.len() as u64;
        let flags = &made.normals.flags;
        let flagged = flags.iter().filter(|flags| !flags.is_empty()).count() as u64;
        let totals: Vec<(&str, u64)> =
            PointFlags::NAMES.into_iter().zip(PointFlags::totals(flags)).filter(|(_, total)| *total > 0).collect();
        let without = (0..made.normals.len()).filter(|&i| !made.normals.has(i)).count() as u64;
        let method = self.settings().method;
        let method = if method == NormalMethod::Jet { "jet" } else { "pca" };
        if self.files.json {
            let mut object = json!({
                "points": points,
                "method": method,
                "k": self.radius.is_none().then_some(self.k),
                "radius": self.radius.map(|radius| radius.to_string()),
                "weighted": self.weighted,
                "flagged": flagged,
                "without_normal": without,
                "flags": totals.iter().map(|(name, total)| ((*name).to_owned(), json!(total))).collect::<Map<_, _>>(),
                "orientation": self.orient.name(),
                "device": made.device,
                "milliseconds": made.times.json(),
                "notes": made.notes,
            });
            object["milliseconds"]["orient"] = rounded(made.orient);
            if let Some(object) = object.as_object_mut() {
                object.extend(made.turned.numbers.clone());
            }
            return print_json(&object);
        }
        let from = match self.radius {
            Some(radius) => format!("points within {radius}"),
            None => format!("{} nearest points", self.k),
        };
        let weighted = if self.weighted { ", near ones count more" } else { "" };
        let named: String = totals.iter().map(|(name, total)| format!(", {name} {}", grouped(*total))).collect();
        let mut rows = vec![
            ("points", grouped(points)),
            ("normals", format!("{method} from {from}{weighted}")),
            ("flagged", format!("{}{named}; {} without a normal", grouped(flagged), grouped(without))),
            ("sides", self.words(made)),
            ("device", made.device.clone()),
            ("time", format!("{}, orient {}", made.times.line(), shown_ms(made.orient))),
        ];
        rows.extend(made.notes.iter().map(|note| ("note", note.clone())));
        let lines: String = rows.iter().map(|(name, value)| format!("{name:<12}{value}\n")).collect();
        if common.quiet {
            return Ok(());
        }
        if [&self.output, &self.picture].iter().any(|path| path.as_deref() == Some(Path::new("-"))) {
            eprint!("{lines}");
            return Ok(());
        }
        print(&lines)
    }
}

impl Turned {
    fn of(words: Option<String>, flipped: u64, numbers: &[(&str, Value)]) -> Self {
        let mut made: Map<String, Value> =
            numbers.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
        made.insert("flipped".to_owned(), json!(flipped));
        let words = words.map_or(String::new(), |words| format!("{words}, "));
        Self { words: format!("{words}{} turned", grouped(flipped)), numbers: made }
    }
}

/// The normals, and what belongs to them, in place of columns of these names.
fn add_columns(cloud: &mut PointCloud, normals: &Normals<f32>) {
    cloud.normals = Some(normals.vectors.iter().map(|&v| Vec3::from_array(v)).collect());
    let mut columns = vec![("surface_variation", Column::F32(normals.variation.clone()))];
    if !normals.curvatures.is_empty() {
        for (i, name) in ["curvature_max", "curvature_min"].into_iter().enumerate() {
            columns.push((name, Column::F32(normals.curvatures.iter().map(|c| c[i]).collect())));
        }
    }
    if normals.flags.iter().any(|flags| !flags.is_empty()) {
        columns.push(("flags", Column::U32(normals.flags.iter().map(|flags| flags.0).collect())));
    }
    for (name, values) in columns {
        cloud.attributes.retain(|attribute| attribute.name != name);
        cloud.attributes.push(Attribute { name: name.to_owned(), values });
    }
}

/// The direction as a colour.
fn color(normal: [f32; 3]) -> [u8; 3] {
    if normal == [0.0; 3] { GREY } else { normal.map(|x| (127.5 + 127.5 * x).clamp(0.0, 255.0) as u8) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orientations_are_read_and_written() {
        let eye = Orient::Viewpoint(DVec3::new(1.0, -2.5, 1e6));
        for (text, orient) in [
            ("none", Orient::None),
            ("viewpoint:1,-2.5,1000000", eye),
            ("spanning-tree", Orient::SpanningTree),
            ("winding-number", Orient::WindingNumber),
        ] {
            assert_eq!(text.parse(), Ok(orient));
            assert_eq!(orient.to_string(), text);
        }
        for text in ["", "viewpoint", "viewpoint:", "viewpoint:1,2", "up"] {
            assert!(text.parse::<Orient>().is_err(), "{text}");
        }
    }

    #[test]
    fn columns_replace_those_of_their_names() {
        let mut cloud = PointCloud::new(vec![Vec3::ZERO; 2]);
        let attribute = |name: &str| Attribute { name: name.to_owned(), values: Column::U8(vec![1, 2]) };
        cloud.attributes = vec![attribute("flags"), attribute("intensity"), attribute("surface_variation")];
        let mut normals = Normals::of_vectors(&[[0.0, 0.0, 2.0], [1.0, 0.0, 0.0]]);
        normals.variation = vec![0.0, 0.25];
        add_columns(&mut cloud, &normals);
        let names = |cloud: &PointCloud| cloud.attributes.iter().map(|a| a.name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&cloud), ["flags", "intensity", "surface_variation"]);
        assert_eq!(cloud.attributes[2].values, Column::F32(vec![0.0, 0.25]));
        normals.flags[1] = PointFlags::DEGENERATE;
        normals.curvatures = vec![[1.0, 0.5]; 2];
        add_columns(&mut cloud, &normals);
        assert_eq!(names(&cloud), ["intensity", "surface_variation", "curvature_max", "curvature_min", "flags"]);
        assert_eq!(cloud.attributes[4].values, Column::U32(vec![0, 2]));
    }
}
