//! How rows are printed and written: Markdown for people, CSV with every stage for programs.

use std::fmt::Write as _;
use std::path::Path;

use nearfield::query::Clock;

use super::row::{Figure, Row};
use crate::Result;
use crate::provenance::{COMMIT, Machine};

/// Where targets, peers and floors hold.
const MACHINE: &str = "NVIDIA H200";

const COLUMNS: [&str; 28] = [
    "row",
    "work",
    "way",
    "stage",
    "mean_neighbors",
    "unit",
    "median",
    "fastest",
    "clock",
    "runs",
    "target",
    "then",
    "missed_by",
    "peer",
    "peer_is",
    "floor",
    "floor_is",
    "points",
    "structure_bytes",
    "peak_bytes",
    "answer_bytes",
    "peak_bytes_a_point",
    "note",
    "scale",
    "device",
    "driver",
    "host",
    "commit",
];

/// The figures so far.
pub(super) struct Report {
    machine: Machine,
    scale: f64,
    lines: Vec<String>,
    records: Vec<[String; COLUMNS.len()]>,
}

impl Report {
    pub(super) fn new(machine: Machine, scale: f64) -> Self {
        Self { machine, scale, lines: Vec::new(), records: Vec::new() }
    }

    /// What stands above the rows.
    pub(super) fn head(&self) -> String {
        let Machine { name, driver, host, .. } = &self.machine;
        let scale = if self.scale == 1.0 {
            String::new()
        } else {
            format!(" Scale {}: nothing is said about targets, peers and floors.", self.scale)
        };
        format!(
            "Device: {name} ({driver}); host: {host}; commit {COMMIT}.{scale} Medians; times by the device's timestamps where the \
             column says device, else wall clock. Targets, peers and floors are for one {MACHINE}; every answer is checked in the same \
             run. \"(beside)\" marks figures that the target is not for.\n\n\
             | row | work | mean neighbours | ours | fastest | clock | target | then | best peer | floor | outcome | how, stages, memory |\n\
             | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n"
        )
    }

    /// A figure as a line of the table.
    pub(super) fn line(&self, row: &Row, mean_neighbors: Option<f64>, figure: &Figure) -> String {
        let compares = self.scale == 1.0;
        let text = |value: Option<f64>| value.map_or("–".to_owned(), digits);
        let unit = row.unit.name();
        let ours = figure.value.map_or("–".to_owned(), |value| format!("{} {unit}", digits(value.median)));
        let target = self.target(row, figure);
        let peer = row.peer.filter(|_| compares).map(|peer| format!("{} ({})", digits(peer.value), peer.who));
        let floor = figure.floor.map(|value| (value, "measured in this run"));
        let floor = floor.or(row.floor.filter(|_| compares).map(|floor| (floor.value, floor.how)));
        format!(
            "| {} | {} | {} | {ours} | {} | {} | {} | {} | {} | {} | {} | {} |",
            row.name,
            row.work,
            mean_neighbors.map_or("–".to_owned(), |mean| format!("{mean:.1}")),
            text(figure.value.map(|value| value.fastest)),
            figure.value.and_then(|value| value.clock).map_or("–", clock_name),
            text(target),
            text(row.then.filter(|_| compares && figure.is_judged)),
            peer.unwrap_or("–".to_owned()),
            floor.map_or("–".to_owned(), |(value, how)| format!("{} ({how})", digits(value))),
            self.outcome(row, figure),
            how(figure),
        )
    }

    /// Keeps a figure for the files.
    pub(super) fn add(&mut self, row: &Row, mean_neighbors: Option<f64>, figure: Figure) {
        self.lines.push(self.line(row, mean_neighbors, &figure));
        self.records.push(self.record(row, mean_neighbors, &figure, None));
        for stage in &figure.stages {
            let stage = (stage.name, stage.milliseconds, stage.clock);
            self.records.push(self.record(row, mean_neighbors, &figure, Some(stage)));
        }
    }

    fn target(&self, row: &Row, figure: &Figure) -> Option<f64> {
        figure.target.or(row.target).filter(|_| self.scale == 1.0 && figure.is_judged)
    }

    fn outcome(&self, row: &Row, figure: &Figure) -> String {
        let Some(value) = figure.value else { return "no figure".to_owned() };
        let Some(target) = self.target(row, figure) else {
            return if figure.is_judged { "–" } else { "(beside)" }.to_owned();
        };
        let by = row.unit.missed_by(value.median, target);
        if by > 1.0 {
            return format!("**missed**, {by:.2} times");
        }
        match row.then {
            Some(then) if row.unit.missed_by(value.median, then) <= 1.0 => "met, the next too".to_owned(),
            _ => "met".to_owned(),
        }
    }

    fn record(
        &self,
        row: &Row,
        mean_neighbors: Option<f64>,
        figure: &Figure,
        stage: Option<(&str, f64, Clock)>,
    ) -> [String; COLUMNS.len()] {
        let number = |value: Option<f64>| value.map_or_else(String::new, |v| format!("{v:.5}"));
        let compares = self.scale == 1.0;
        // A stage has its time, and nothing to be compared with.
        let whole = |value: Option<f64>| value.filter(|_| stage.is_none());
        let value = figure.value;
        let (median, fastest, clock) = match stage {
            Some((_, milliseconds, clock)) => (Some(milliseconds), None, Some(clock)),
            None => (value.map(|v| v.median), value.map(|v| v.fastest), value.and_then(|v| v.clock)),
        };
        let target = whole(self.target(row, figure));
        let missed_by = target.zip(value).map(|(target, value)| row.unit.missed_by(value.median, target));
        let peer = row.peer.filter(|_| compares && stage.is_none());
        let floor = row.floor.filter(|_| compares && stage.is_none());
        let memory = figure.memory;
        let bytes = |bytes: u64| if bytes == 0 { String::new() } else { bytes.to_string() };
        let a_point = (memory.peak > 0 && memory.points > 0).then(|| memory.peak as f64 / memory.points as f64);
        [
            row.name.to_owned(),
            row.work.to_owned(),
            figure.way.clone(),
            stage.map_or("total", |(name, _, _)| name).to_owned(),
            number(mean_neighbors),
            stage.map_or(row.unit.name(), |_| "ms").to_owned(),
            number(median),
            number(fastest),
            clock.map_or("", clock_name).to_owned(),
            value.map_or(0, |v| v.runs).to_string(),
            number(target),
            number(whole(row.then.filter(|_| compares && figure.is_judged))),
            number(missed_by),
            number(peer.map(|p| p.value)),
            peer.map_or("", |p| p.who).to_owned(),
            number(whole(figure.floor).or(floor.map(|f| f.value))),
            if figure.floor.is_some() { "measured in this run" } else { floor.map_or("", |f| f.how) }.to_owned(),
            bytes(memory.points as u64),
            bytes(memory.structure),
            bytes(memory.peak),
            bytes(memory.answer),
            number(a_point),
            figure.note.clone(),
            self.scale.to_string(),
            self.machine.name.clone(),
            self.machine.driver.clone(),
            self.machine.host.clone(),
            COMMIT.to_owned(),
        ]
    }

    /// Writes the table as it was printed.
    pub(super) fn save_markdown(&self, path: &Path) -> Result<()> {
        let text = self.head() + &self.lines.join("\n") + "\n";
        std::fs::write(path, text).map_err(|e| format!("{}: {e}", path.display()).into())
    }

    /// Writes every figure, and a record for each stage.
    pub(super) fn save_csv(&self, path: &Path) -> Result<()> {
        let mut writer = csv::Writer::from_path(path)?;
        writer.write_record(COLUMNS)?;
        for record in &self.records {
            writer.write_record(record)?;
        }
        Ok(writer.flush()?)
    }
}

/// How the figure came about, its stages and its memory.
fn how(figure: &Figure) -> String {
    let mut parts = Vec::new();
    parts.extend([&figure.way, &figure.note].into_iter().filter(|text| !text.is_empty()).cloned());
    let stage = |s: &nearfield::query::Stage| {
        let mark = if s.clock == Clock::Host { " (wall)" } else { "" };
        format!("{} {}{mark}", s.name, digits(s.milliseconds))
    };
    if !figure.stages.is_empty() {
        parts.push(figure.stages.iter().map(stage).collect::<Vec<_>>().join(", "));
    }
    let memory = figure.memory;
    if memory.peak > 0 && memory.points > 0 {
        let mut text = format!("peak {:.0} bytes a point", memory.peak as f64 / memory.points as f64);
        for (what, bytes) in [("structure", memory.structure), ("answer", memory.answer)] {
            if bytes > 0 {
                let _ = write!(text, ", {what} {:.0}", bytes as f64 / memory.points as f64);
            }
        }
        parts.push(text);
    }
    // A bar would end the cell.
    parts.join("; ").replace('|', "/")
}

fn clock_name(clock: Clock) -> &'static str {
    match clock {
        Clock::Host => "wall",
        Clock::Device => "device",
    }
}

/// Three digits or more.
fn digits(value: f64) -> String {
    match value.abs() {
        v if v < 10.0 => format!("{value:.3}"),
        v if v < 1000.0 => format!("{value:.1}"),
        _ => format!("{value:.0}"),
    }
}
