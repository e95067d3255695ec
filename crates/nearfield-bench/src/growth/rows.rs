//! The rows of the growth, as a table, a CSV file and a plot.

use std::path::Path;

use nearfield::geometry::generate::CloudKind;

use super::KINDS;
use super::clouds::Cloud;
use crate::Result;
use crate::measure::Measured;
use crate::plots::{self, Axes, Frame, Look, Panel, Series};
use crate::provenance::{COMMIT, Machine};

/// All structures, in the order of their colours.
const STRUCTURES: [&str; 5] = ["uniform-grid", "multi-level-grid", "aabb-tree", "linear-octree", "brute-force"];

const COLUMNS: [&str; 17] = [
    "set",
    "points",
    "radius",
    "mean_neighbors",
    "structure",
    "build_ms",
    "build_ns_a_point",
    "count_ms",
    "count_ns_a_point",
    "clock",
    "runs",
    "structure_bytes_a_point",
    "peak_bytes_a_point",
    "note",
    "device",
    "driver",
    "commit",
];

/// What was measured.
#[derive(Debug, Clone, Copy)]
struct Values {
    radius: f32,
    mean_neighbors: f64,
    /// Milliseconds.
    build: f64,
    count: f64,
    by_device: bool,
    runs: usize,
    /// Of the structure, and at the peak of the device's memory; the latter 0 on the CPU.
    bytes: [u64; 2],
}

/// A structure at a number of points.
pub(super) struct Row {
    kind: CloudKind,
    n: usize,
    structure: &'static str,
    values: Option<Values>,
    note: String,
}

impl Row {
    /// Build and count, bytes of the structure and at the peak, neighbours in all.
    pub(super) fn of(
        cloud: &Cloud,
        structure: &'static str,
        [build, count]: [&Measured; 2],
        bytes: [u64; 2],
        total: Option<u64>,
    ) -> Self {
        let n = cloud.points.len();
        let time = |measured: &Measured| measured.device.unwrap_or(measured.wall).median;
        let values = Values {
            radius: cloud.radius,
            mean_neighbors: total.unwrap_or(0) as f64 / n as f64,
            build: time(build),
            count: time(count),
            by_device: count.device.is_some(),
            runs: count.runs,
            bytes,
        };
        Self { kind: cloud.kind, n, structure, values: Some(values), note: String::new() }
    }

    /// No figure, and why.
    pub(super) fn missing(kind: CloudKind, n: usize, structure: &'static str, note: impl Into<String>) -> Self {
        Self { kind, n, structure, values: None, note: note.into() }
    }

    fn nanoseconds(&self, milliseconds: f64) -> f64 {
        milliseconds * 1e6 / self.n as f64
    }
}

/// All rows of one device.
pub(super) struct Table {
    machine: Machine,
    rows: Vec<Row>,
}

impl Table {
    pub(super) fn new(machine: Machine) -> Self {
        Self { machine, rows: Vec::new() }
    }

    /// What stands above the rows.
    pub(super) fn head(&self) -> String {
        let Machine { name, driver, host, .. } = &self.machine;
        format!(
            "Device: {name} ({driver}); host: {host}; commit {COMMIT}. Nanoseconds a point, medians, by the device's timestamps on a GPU, \
             else wall clock; every answer is checked.\n\n\
             | set | points | mean neighbours | structure | build | count | structure, bytes a point | peak on the device, bytes a point |\n\
             | --- | --- | --- | --- | --- | --- | --- | --- |\n"
        )
    }

    /// Prints a row and keeps it.
    pub(super) fn add(&mut self, row: Row) {
        println!("{}", line(&row));
        self.rows.push(row);
    }

    /// Writes the files.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub(super) fn save(&self, folder: &Path) -> Result<()> {
        let lines: String = self.rows.iter().map(|row| line(row) + "\n").collect();
        let path = folder.join("growth.md");
        std::fs::write(&path, self.head() + &lines).map_err(|error| format!("{}: {error}", path.display()))?;
        let mut writer = csv::Writer::from_path(folder.join("growth.csv"))?;
        writer.write_record(COLUMNS)?;
        for row in &self.rows {
            writer.write_record(self.record(row))?;
        }
        writer.flush()?;
        self.plot(&folder.join("growth.svg"))
    }

    fn record(&self, row: &Row) -> [String; COLUMNS.len()] {
        let number = |value: Option<f64>| value.map_or_else(String::new, |v| format!("{v:.5}"));
        let of = |get: fn(&Values) -> f64| row.values.as_ref().map(get);
        let a_point = |bytes: f64| bytes / row.n as f64;
        [
            row.kind.to_string(),
            row.n.to_string(),
            row.values.map_or_else(String::new, |values| values.radius.to_string()),
            number(of(|values| values.mean_neighbors)),
            row.structure.to_owned(),
            number(of(|values| values.build)),
            number(of(|values| values.build).map(|time| row.nanoseconds(time))),
            number(of(|values| values.count)),
            number(of(|values| values.count).map(|time| row.nanoseconds(time))),
            row.values.map_or("", |values| if values.by_device { "device" } else { "wall" }).to_owned(),
            row.values.map_or(0, |values| values.runs).to_string(),
            number(of(|values| values.bytes[0] as f64).map(a_point)),
            number(of(|values| values.bytes[1] as f64).map(a_point).filter(|bytes| *bytes > 0.0)),
            row.note.clone(),
            self.machine.name.clone(),
            self.machine.driver.clone(),
            COMMIT.to_owned(),
        ]
    }

    /// A pair of panels for each set: build on the left, count on the right.
    fn plot(&self, path: &Path) -> Result<()> {
        let panel = |kind: CloudKind, what: &str, time: fn(&Values) -> f64| {
            let series = STRUCTURES.iter().enumerate().map(|(color, &name)| {
                let of_it = self.rows.iter().filter(|row| row.kind == kind && row.structure == name);
                // Builds without work on the device take no time that an axis of logarithms has.
                let point = |row: &Row| Some((row.n as f64, row.nanoseconds(time(row.values.as_ref()?))));
                let points = of_it.filter_map(point).filter(|point| point.1 > 0.0).collect();
                Series { name: name.to_owned(), color, points, look: Look::Line }
            });
            let series = series.filter(|line: &Series| !line.points.is_empty()).collect();
            Panel { title: format!("{kind}: {what}"), series }
        };
        let panels: Vec<Panel> = KINDS
            .into_iter()
            .flat_map(|kind| [panel(kind, "build", |v| v.build), panel(kind, "count", |v| v.count)])
            .collect();
        if panels.iter().all(|panel| panel.series.is_empty()) {
            return Ok(());
        }
        let Machine { name, driver, .. } = &self.machine;
        let frame = Frame {
            title: "Time a point over the number of points, some 50 neighbours".to_owned(),
            caption: vec![format!("{name} ({driver})"), format!("Nearfield commit {COMMIT}")],
            x_label: "points".to_owned(),
            y_label: "nanoseconds a point".to_owned(),
            axes: Axes::Logarithmic,
            legend_right: true,
        };
        plots::lines(path, &frame, &panels)
    }
}

fn line(row: &Row) -> String {
    let Row { kind, n, structure, .. } = row;
    match &row.values {
        None => format!("| {kind} | {n} | – | {structure} | – | – | – | {} |", row.note),
        Some(values) => {
            let a_point = |bytes: u64| match bytes {
                0 => "–".to_owned(),
                bytes => format!("{:.1}", bytes as f64 / *n as f64),
            };
            format!(
                "| {kind} | {n} | {:.1} | {structure} | {:.3} | {:.3} | {} | {} |",
                values.mean_neighbors,
                row.nanoseconds(values.build),
                row.nanoseconds(values.count),
                a_point(values.bytes[0]),
                a_point(values.bytes[1])
            )
        }
    }
}
