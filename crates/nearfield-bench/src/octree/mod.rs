//! `nearfield-bench octree`: the charts of the poster on space-filling curves and octrees, redone with checked answers.
//!
//! - construction of the curve: the points' order along Morton's curve;
//! - construction of the octree: points to linked nodes with their numbers in pre- and post-order, capacity 32;
//! - post-order traversal: the number of every node of the dense octree, the poster's own structure;
//! - near neighbours of n points: how many lie within a radius, in the octree;
//! - locations of n points: the node of the octree that holds each of n other points.
//!
//! Each on one core, on all cores, on the GPU (points and answer on the device, by its timestamps) and on the GPU from
//! host memory and back (wall clock). Source: Ajmera2008, whose charts had one core and a GPU without transfers.

mod answers;
mod chart;
pub(crate) mod method;

use std::path::PathBuf;

use nearfield::geometry::generate::CloudKind;
use nearfield::gpu::{DeviceChoice, Gpu};

use crate::Result;
use crate::measure::Effort;
use crate::plots::{self, Axes, Frame, Look, Panel, Series};
use crate::provenance::{COMMIT, Device, Machine, processor};
use crate::sets::Set;
use chart::Chart;
use method::{Case, Method};

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The GPU: auto, gpu, gpu:N or part of a device name; cpu leaves those rows out
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,
    /// Numbers of points are those of the poster and less, times this
    #[arg(long, default_value_t = 1.0)]
    pub scale: f64,
    /// Numbers of points in place of the poster's, such as 1000,20000
    #[arg(long, value_delimiter = ',')]
    pub numbers: Vec<usize>,
    /// Timed runs of a point at most; with it the GPU is not warmed up
    #[arg(long)]
    pub repeat: Option<usize>,
    /// Kind of the points: uniform, shell or clustered
    #[arg(long, default_value = "uniform")]
    pub kind: CloudKind,
    /// Also 100 million points on the GPU, if it holds them
    #[arg(long)]
    pub large: bool,
    /// Folder of octree.csv and octree.svg
    #[arg(short, long)]
    pub output: Option<PathBuf>,
}

impl Arguments {
    fn numbers(&self) -> Vec<usize> {
        let of_poster = || NUMBERS.map(|n| ((n as f64 * self.scale) as usize).max(SMALLEST)).to_vec();
        if self.numbers.is_empty() { of_poster() } else { self.numbers.iter().map(|&n| n.max(SMALLEST)).collect() }
    }

    fn effort(&self, n: usize, method: Method) -> Effort {
        let runs = if n > 10_000_000 { 5 } else { 9 };
        Effort {
            warm_up: if method.on_gpu() && self.repeat.is_none() { 1.0 } else { 0.0 },
            runs: self.repeat.unwrap_or(runs).max(1),
            seconds: if method.on_gpu() { 3.0 } else { 1.0 },
        }
    }
}

/// Numbers of points; the poster has the last two.
const NUMBERS: [usize; 6] = [100_000, 200_000, 500_000, 1_000_000, 2_000_000, 5_000_000];
/// Fewer points are not measured.
const SMALLEST: usize = 1000;
const LARGE: usize = 100_000_000;

/// Column names of the CSV file.
const COLUMNS: [&str; 12] = [
    "device",
    "commit",
    "kind",
    "points",
    "chart",
    "method",
    "milliseconds",
    "wall_milliseconds",
    "runs",
    "nodes",
    "mean_neighbors",
    "stages",
];

/// A measured point of a chart.
struct Row {
    device: String,
    n: usize,
    chart: Chart,
    method: Method,
    measured: crate::measure::Measured,
    nodes: usize,
    mean_neighbors: f64,
}

impl Row {
    /// What the chart shows: device time without transfers on the GPU, else wall clock.
    fn milliseconds(&self) -> f64 {
        let device = self.measured.device.map(|timing| timing.median);
        if self.method == Method::Gpu { device.unwrap_or(self.measured.wall.median) } else { self.measured.wall.median }
    }

    fn stages(&self) -> String {
        let stage = |s: &nearfield::query::Stage| format!("{} {:.4}", s.name, s.milliseconds);
        self.measured.stages.iter().map(stage).collect::<Vec<_>>().join("; ")
    }
}

/// Measures, prints a line a point, and writes the files.
///
/// # Errors
/// `NoDevice`; what a build or a query returns; an answer that is wrong; a file that cannot be written.
pub fn run(arguments: &Arguments) -> Result<()> {
    let machine = Machine::open(&arguments.device)?;
    let gpu = match &machine.device {
        Device::Gpu(gpu) => Some(gpu),
        Device::Cpu => None,
    };
    println!("commit {COMMIT}; GPU: {} ({}); host: {}", machine.name, machine.driver, machine.host);
    println!("| points | nodes | mean neighbours | chart | method | ms | M/s | stages |");
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    let mut rows = Vec::new();
    for n in arguments.numbers() {
        let case = Case::new(Set { kind: arguments.kind, n })?;
        for chart in Chart::ALL {
            for method in Method::ALL {
                rows.extend(point(&machine, gpu, &case, (chart, method), arguments.effort(n, method))?);
            }
        }
    }
    if let (true, Some(gpu)) = (arguments.large, gpu) {
        if (LARGE * 16) as u64 <= gpu.limits().binding_bytes {
            let case = Case::new(Set { kind: arguments.kind, n: LARGE })?;
            for chart in [Chart::Curve, Chart::Octree, Chart::Locations] {
                let effort = arguments.effort(LARGE, Method::Gpu);
                rows.extend(point(&machine, Some(gpu), &case, (chart, Method::Gpu), effort)?);
            }
        } else {
            println!("{LARGE} points do not fit into a binding of this device");
        }
    }
    if let Some(folder) = &arguments.output {
        std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        save(&folder.join("octree.csv"), &rows, arguments.kind)?;
        plot(&folder.join("octree.svg"), &rows, &machine, arguments.kind)?;
    }
    Ok(())
}

/// Measures and prints one point of a chart; none where there is no GPU.
fn point(
    machine: &Machine,
    gpu: Option<&Gpu>,
    case: &Case,
    (chart, method): (Chart, Method),
    effort: Effort,
) -> Result<Option<Row>> {
    let Some(measured) = method::measure(gpu, case, chart, method, effort)? else { return Ok(None) };
    let row = Row {
        device: if method.on_gpu() { machine.name.clone() } else { processor() },
        n: case.points.len(),
        chart,
        method,
        measured,
        nodes: case.tree.nodes().len(),
        mean_neighbors: case.mean_neighbors(),
    };
    let time = row.milliseconds();
    println!(
        "| {} | {} | {:.1} | {} | {} | {time:.3} | {:.1} | {} |",
        row.n,
        row.nodes,
        row.mean_neighbors,
        chart.title(),
        method.name(),
        row.n as f64 / time * 1e-3,
        row.stages()
    );
    Ok(Some(row))
}

fn save(path: &std::path::Path, rows: &[Row], kind: CloudKind) -> Result<()> {
    let mut writer = csv::Writer::from_path(path)?;
    writer.write_record(COLUMNS)?;
    for row in rows {
        writer.write_record([
            row.device.clone(),
            COMMIT.to_owned(),
            kind.to_string(),
            row.n.to_string(),
            row.chart.title().to_owned(),
            row.method.name().to_owned(),
            format!("{:.5}", row.milliseconds()),
            format!("{:.5}", row.measured.wall.median),
            row.measured.runs.to_string(),
            row.nodes.to_string(),
            format!("{:.3}", row.mean_neighbors),
            row.stages(),
        ])?;
    }
    Ok(writer.flush()?)
}

/// A panel a chart, a line a method.
fn plot(path: &std::path::Path, rows: &[Row], machine: &Machine, kind: CloudKind) -> Result<()> {
    let panel = |chart: Chart| {
        let series = Method::ALL.into_iter().enumerate().map(|(color, method)| Series {
            name: method.name().to_owned(),
            color,
            points: rows
                .iter()
                .filter(|row| row.chart == chart && row.method == method)
                .map(|row| (row.n as f64, row.milliseconds()))
                .collect(),
            look: Look::Line,
        });
        Panel { title: chart.title().to_owned(), series: series.filter(|s| !s.points.is_empty()).collect() }
    };
    let frame = Frame {
        title: format!("Curves and octrees, {kind} points"),
        caption: vec![
            format!("GPU: {} ({})", machine.name, machine.driver),
            format!("CPU: {}", machine.host),
            format!(
                "Nearfield commit {COMMIT}. Medians; GPU by device timestamps, with transfers and CPU by wall clock."
            ),
        ],
        x_label: "points".to_owned(),
        y_label: "milliseconds".to_owned(),
        axes: Axes::Logarithmic,
        legend_right: false,
    };
    plots::lines(path, &frame, &Chart::ALL.map(panel))
}
