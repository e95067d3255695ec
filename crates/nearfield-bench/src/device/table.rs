//! The rows of `device` and how they are written: as Markdown for people, as CSV with every stage for programs.

use std::fmt::Write as _;
use std::path::Path;

use nearfield::query::{Clock, Stage};

use super::peers::{CPU_MACHINE, GPU_MACHINE, peers, target};
use crate::Result;
use crate::measure::{Measured, Timing};
use crate::provenance::{COMMIT, Device, Machine};
use crate::sets::Set;

/// One operation on one set.
#[derive(Debug, Clone)]
pub(super) struct Row {
    pub(super) set: Set,
    pub(super) radius: f32,
    pub(super) mean_neighbors: f64,
    pub(super) operation: &'static str,
    pub(super) structure: &'static str,
    /// Variant of the search that ran; empty where nothing was searched.
    pub(super) search: &'static str,
    /// Whose clock the figure of the row is by; the host's where the device has none.
    pub(super) clock: Clock,
    /// Times; `None` where the operation is not possible, with the reason in `note`.
    pub(super) measured: Option<Measured>,
    /// Bytes of the structure, points included; 0 where there is none.
    pub(super) structure_bytes: u64,
    /// Largest number of bytes held on the device during the operation; 0 on the CPU.
    pub(super) peak_bytes: u64,
    pub(super) note: String,
}

impl Row {
    /// The figure of the row and the clock it is by.
    fn timing(&self) -> Option<(Timing, Clock)> {
        let measured = self.measured.as_ref()?;
        match (self.clock, measured.device) {
            (Clock::Device, Some(device)) => Some((device, Clock::Device)),
            _ => Some((measured.wall, Clock::Host)),
        }
    }
}

/// All rows of one device.
pub(super) struct Table {
    machine: Machine,
    pub(super) rows: Vec<Row>,
}

const CSV_HEADER: [&str; 21] = [
    "set",
    "points",
    "radius",
    "mean_neighbors",
    "operation",
    "structure",
    "search",
    "stage",
    "clock",
    "milliseconds",
    "fastest_milliseconds",
    "wall_milliseconds",
    "runs",
    "structure_bytes",
    "peak_bytes",
    "target_milliseconds",
    "peers",
    "note",
    "device",
    "driver",
    "commit",
];

impl Table {
    pub(super) fn new(machine: Machine) -> Self {
        Self { machine, rows: Vec::new() }
    }

    /// What was measured where, and the head of the table.
    pub(super) fn markdown_head(&self) -> String {
        let machine = &self.machine;
        let (clock, peers) = match is_gpu(machine) {
            true => ("the device's timestamps unless marked \"wall\"", GPU_MACHINE),
            false => ("the wall clock, all threads", CPU_MACHINE),
        };
        format!(
            "Device: {} (driver: {}; host: {}). Commit {COMMIT}.\n\
             Median milliseconds by {clock}; every answer is checked in the same run.\n\
             Targets and peers are for {peers}.\n\n\
             | set | structure | operation | search | ms | fastest | wall ms | stages, ms | target | peers, ms | mean neighbours | structure MB | device peak MB |\n\
             | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n",
            machine.name, machine.driver, machine.host
        )
    }

    /// Writes the table as Markdown.
    pub(super) fn save_markdown(&self, path: &Path) -> Result<()> {
        let mut text = self.markdown_head();
        for row in &self.rows {
            let _ = writeln!(text, "{}", markdown_row(row, &self.machine));
        }
        std::fs::write(path, text).map_err(|e| format!("{}: {e}", path.display()).into())
    }

    /// Writes every row, and a row for each stage.
    pub(super) fn save_csv(&self, path: &Path) -> Result<()> {
        let mut writer = csv::Writer::from_path(path)?;
        writer.write_record(CSV_HEADER)?;
        for row in &self.rows {
            writer.write_record(self.record(row, None))?;
            for stage in row.measured.iter().flat_map(|m| &m.stages) {
                writer.write_record(self.record(row, Some(stage)))?;
            }
        }
        Ok(writer.flush()?)
    }

    fn record(&self, row: &Row, stage: Option<&Stage>) -> [String; CSV_HEADER.len()] {
        let number = |value: Option<f64>| value.map_or_else(String::new, |v| format!("{v:.4}"));
        let timing = row.timing();
        let (clock, median, fastest) = match stage {
            Some(stage) => (Some(stage.clock), Some(stage.milliseconds), None),
            None => (timing.map(|t| t.1), timing.map(|t| t.0.median), timing.map(|t| t.0.fastest)),
        };
        let on_gpu = is_gpu(&self.machine);
        let wall = row.measured.as_ref().filter(|_| stage.is_none()).map(|m| m.wall.median);
        [
            row.set.to_string(),
            row.set.n.to_string(),
            row.radius.to_string(),
            format!("{:.3}", row.mean_neighbors),
            row.operation.to_owned(),
            row.structure.to_owned(),
            row.search.to_owned(),
            stage.map_or("total", |s| s.name).to_owned(),
            clock.map_or("", clock_name).to_owned(),
            number(median),
            number(fastest),
            number(wall),
            row.measured.as_ref().map_or(0, |m| m.runs).to_string(),
            row.structure_bytes.to_string(),
            row.peak_bytes.to_string(),
            number(target(row.structure, &row.set, row.operation, on_gpu).filter(|_| stage.is_none())),
            if stage.is_none() { peer_text(row, on_gpu) } else { String::new() },
            row.note.clone(),
            self.machine.name.clone(),
            self.machine.driver.clone(),
            COMMIT.to_owned(),
        ]
    }
}

/// One row of the table for people.
pub(super) fn markdown_row(row: &Row, machine: &Machine) -> String {
    let on_gpu = is_gpu(machine);
    let (median, fastest) = match row.timing() {
        Some((timing, Clock::Host)) if on_gpu => (format!("{:.2} (wall)", timing.median), digits(timing.fastest)),
        Some((timing, _)) => (digits(timing.median), digits(timing.fastest)),
        None => (row.note.clone(), String::new()),
    };
    let wall = row.measured.as_ref().map_or_else(String::new, |m| digits(m.wall.median));
    let stage = |s: &Stage| {
        let mark = if on_gpu && s.clock == Clock::Host { " (wall)" } else { "" };
        format!("{} {}{mark}", s.name, digits(s.milliseconds))
    };
    let mut stages: Vec<String> = row.measured.iter().flat_map(|m| &m.stages).map(stage).collect();
    if row.measured.is_some() && !row.note.is_empty() {
        stages.push(row.note.clone());
    }
    let target =
        target(row.structure, &row.set, row.operation, on_gpu).map_or_else(String::new, |ms| format!("≤ {ms}"));
    let megabytes = |bytes: u64| if bytes == 0 { String::new() } else { format!("{:.1}", bytes as f64 * 1e-6) };
    format!(
        "| {} | {} | {} | {} | {median} | {fastest} | {wall} | {} | {target} | {} | {:.2} | {} | {} |",
        row.set,
        row.structure,
        row.operation,
        row.search,
        stages.join(", "),
        peer_text(row, on_gpu),
        row.mean_neighbors,
        megabytes(row.structure_bytes),
        megabytes(row.peak_bytes),
    )
}

fn peer_text(row: &Row, on_gpu: bool) -> String {
    let peers = peers(&row.set, row.operation, on_gpu);
    peers.iter().map(|p| format!("{} {}", p.name, p.milliseconds)).collect::<Vec<_>>().join("; ")
}

fn is_gpu(machine: &Machine) -> bool {
    matches!(machine.device, Device::Gpu(_))
}

fn clock_name(clock: Clock) -> &'static str {
    match clock {
        Clock::Host => "host",
        Clock::Device => "device",
    }
}

/// Milliseconds with three digits or more.
fn digits(milliseconds: f64) -> String {
    let places = if milliseconds < 10.0 { 3 } else { 1 };
    format!("{milliseconds:.places$}")
}
