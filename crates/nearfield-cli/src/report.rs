//! The summary of a search, as lines for people and as one JSON object for programs.

use std::io::Write;
use std::time::Instant;

use nearfield::query::{Clock, Stage};
use nearfield::{Report, query::Summary};
use serde_json::{Value, json};

use crate::exit::Failure;

/// A stage that was timed, and by whose clock.
pub(crate) fn stage_json(stage: &Stage) -> Value {
    let clock = if stage.clock == Clock::Device { "device" } else { "host" };
    json!({ "name": stage.name, "milliseconds": rounded(stage.milliseconds), "clock": clock })
}

/// Milliseconds of the wall clock.
pub(crate) fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

/// Wall-clock milliseconds of the stages of the command, in the order they ran.
#[derive(Debug, Clone, Default)]
pub(crate) struct Times {
    pub(crate) read: f64,
    /// Opening the device and compiling what runs on it.
    pub(crate) open: f64,
    pub(crate) upload: f64,
    pub(crate) build: f64,
    pub(crate) query: f64,
    pub(crate) read_back: f64,
    pub(crate) write: f64,
    pub(crate) picture: f64,
}

impl Times {
    /// Splits the wall time of building an index by what the index says of its stages.
    pub(crate) fn built(&mut self, wall: f64, stages: &[Stage]) {
        let sum =
            |keep: &dyn Fn(&Stage) -> bool| -> f64 { stages.iter().filter(|s| keep(s)).map(|s| s.milliseconds).sum() };
        self.upload += sum(&|s| s.name == "upload");
        self.build += sum(&|s| s.name != "upload" && s.name != "total");
        self.open += (wall - self.upload - self.build).max(0.0);
    }

    /// Splits the wall time of a question by what its report says.
    pub(crate) fn asked(&mut self, wall: f64, report: &Report) {
        let upload = report.milliseconds("upload", Clock::Host);
        let read_back = report.milliseconds("read back", Clock::Host);
        self.upload += upload;
        self.read_back += read_back;
        self.query += (wall - upload - read_back).max(0.0);
    }

    /// A number of milliseconds a stage.
    pub(crate) fn json(&self) -> Value {
        Value::Object(self.named().into_iter().map(|(name, ms)| (name.to_owned(), rounded(ms))).collect())
    }

    /// The stages one after the other, for people.
    pub(crate) fn line(&self) -> String {
        let shown = self.named().into_iter().filter(|&(name, ms)| ms > 0.0 || !matches!(name, "open" | "picture"));
        shown.map(|(name, ms)| format!("{} {}", name.replace('_', " "), shown_ms(ms))).collect::<Vec<_>>().join(", ")
    }

    fn named(&self) -> [(&'static str, f64); 8] {
        [
            ("read", self.read),
            ("open", self.open),
            ("upload", self.upload),
            ("build", self.build),
            ("query", self.query),
            ("read_back", self.read_back),
            ("write", self.write),
            ("picture", self.picture),
        ]
    }
}

/// What was found of the k nearest.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct KnnSummary {
    pub(crate) k: u32,
    /// Queries with k neighbours.
    pub(crate) full_rows: u64,
    /// Mean, smallest and largest distance of the k-th neighbour, of those that have one.
    pub(crate) kth: Option<[f64; 3]>,
}

impl KnnSummary {
    /// From the distance of the k-th neighbour of each query, infinite where there is none.
    pub(crate) fn of(k: u32, kth: &[f32]) -> Self {
        let full: Vec<f64> = kth.iter().filter(|d| d.is_finite()).map(|&d| f64::from(d)).collect();
        let (low, high) = full.iter().fold((f64::INFINITY, 0.0f64), |(l, h), &d| (l.min(d), h.max(d)));
        let mean = full.iter().sum::<f64>() / full.len() as f64;
        Self { k, full_rows: full.len() as u64, kth: (!full.is_empty()).then_some([mean, low, high]) }
    }

    fn line(&self, queries: u64) -> String {
        let Some([mean, low, high]) = self.kth.map(|kth| kth.map(|distance| short(distance as f32, DIGITS))) else {
            return format!("no query has {} neighbours", self.k);
        };
        let full = match self.full_rows {
            all if all == queries => String::new(),
            some => format!(", of the {} queries that have so many", grouped(some)),
        };
        format!("distance of neighbour {}: mean {mean}, min {low}, max {high}{full}", self.k)
    }
}

/// A length with so many digits.
pub(crate) fn short(length: f32, digits: usize) -> String {
    let text = format!("{length:.*e}", digits - 1);
    // Through the number again: 2.500e-3 reads better as 0.0025.
    text.parse::<f64>().map_or(text, |rounded| {
        if rounded == 0.0 || (1e-4..1e6).contains(&rounded) { format!("{rounded}") } else { format!("{rounded:e}") }
    })
}

/// Digits that are enough for people.
pub(crate) const DIGITS: usize = 4;

/// Everything worth saying about a search.
#[derive(Debug, Clone)]
pub(crate) struct SearchSummary {
    pub(crate) points: u64,
    pub(crate) queries: u64,
    /// The smallest and the largest radius; `None` without any.
    pub(crate) radii: Option<[f32; 2]>,
    /// Where the nearest were asked for.
    pub(crate) knn: Option<KnnSummary>,
    pub(crate) neighbors: Summary,
    pub(crate) memory_bytes: u64,
    pub(crate) cut_rows: u64,
    pub(crate) cut_neighbors: u64,
    pub(crate) report: Report,
    pub(crate) build_stages: Vec<Stage>,
    pub(crate) notes: Vec<String>,
    pub(crate) times: Times,
}

impl SearchSummary {
    /// The object that `--json` prints.
    pub(crate) fn json(&self) -> Value {
        let kth = |i: usize| self.knn.as_ref().and_then(|knn| Some(knn.kth?[i]));
        json!({
            "points": self.points,
            "queries": self.queries,
            "radius": self.radii.filter(|[low, high]| low == high).map(|[radius, _]| shortest(radius)),
            "radius_min": self.radii.map(|radii| shortest(radii[0])),
            "radius_max": self.radii.map(|radii| shortest(radii[1])),
            "k": self.knn.as_ref().map(|knn| knn.k),
            "full_rows": self.knn.as_ref().map(|knn| knn.full_rows),
            "kth_distance_mean": kth(0),
            "kth_distance_min": kth(1),
            "kth_distance_max": kth(2),
            "neighbors_total": self.neighbors.total,
            "neighbors_mean": self.neighbors.mean,
            "neighbors_min": self.neighbors.min,
            "neighbors_max": self.neighbors.max,
            "cut_rows": self.cut_rows,
            "cut_neighbors": self.cut_neighbors,
            "device": self.report.device,
            "structure": self.report.structure,
            "reason": self.report.reason,
            "search": self.report.search,
            "kernels": self.report.kernels,
            "batches": self.report.batches,
            "milliseconds": self.times.json(),
            "build_stages": self.build_stages.iter().map(stage_json).collect::<Vec<_>>(),
            "query_stages": self.report.stages.iter().map(stage_json).collect::<Vec<_>>(),
            "memory_bytes": self.memory_bytes,
            "notes": self.notes,
        })
    }

    /// The lines for people.
    pub(crate) fn lines(&self) -> String {
        let n = &self.neighbors;
        let batches = match self.report.batches {
            0 | 1 => String::new(),
            n => format!(", {n} batches"),
        };
        let mut rows = vec![("points", grouped(self.points)), ("queries", grouped(self.queries))];
        match self.radii {
            Some([low, high]) if low < high => rows.push(("radius", format!("{low} to {high}"))),
            Some([radius, _]) => rows.push(("radius", radius.to_string())),
            None => {}
        }
        rows.push((
            "neighbours",
            format!("mean {:.2}, min {}, max {}, total {}", n.mean, n.min, grouped(n.max.into()), grouped(n.total)),
        ));
        rows.extend(self.knn.as_ref().map(|knn| ("nearest", knn.line(self.queries))));
        rows.extend([
            ("device", self.report.device.clone()),
            (
                "structure",
                format!("{} ({}{batches}), {}", self.report.structure, self.report.search, size(self.memory_bytes)),
            ),
        ]);
        rows.extend(self.report.reason.clone().map(|reason| ("reason", reason)));
        rows.push(("time", self.times.line()));
        let mut text = String::new();
        for (name, value) in rows {
            text += &format!("{name:<12}{value}\n");
        }
        for note in self.all_notes() {
            text += &format!("{:<12}{note}\n", "note");
        }
        text
    }

    fn all_notes(&self) -> Vec<String> {
        let mut notes = self.notes.clone();
        notes.extend(self.cut_note());
        notes
    }

    /// What the cap left out, where it did.
    pub(crate) fn cut_note(&self) -> Option<String> {
        let (rows, missing) = (grouped(self.cut_rows), grouped(self.cut_neighbors));
        (self.cut_rows > 0).then(|| {
            format!("{rows} rows were cut by --max-neighbors: the nearest are kept, {missing} neighbours are left out")
        })
    }
}

/// Prints to standard output.
pub(crate) fn print(text: &str) -> Result<(), Failure> {
    let mut stdout = std::io::stdout().lock();
    stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()).map_err(Failure::stdout)
}

/// Prints one JSON value on one line to standard output.
pub(crate) fn print_json(value: &Value) -> Result<(), Failure> {
    print(&format!("{value}\n"))
}

/// The shortest number that is this f32: 0.1 rather than the 0.10000000149 it is as an f64.
pub(crate) fn shortest(value: f32) -> Value {
    json!(value.to_string().parse::<f64>().unwrap_or(f64::from(value)))
}

/// Microseconds are enough.
pub(crate) fn rounded(milliseconds: f64) -> Value {
    json!((milliseconds * 1e3).round() / 1e3)
}

/// Milliseconds for people.
pub(crate) fn shown_ms(milliseconds: f64) -> String {
    match milliseconds {
        ms if ms >= 10_000.0 => format!("{:.1} s", ms / 1e3),
        ms if ms >= 100.0 => format!("{ms:.0} ms"),
        ms if ms >= 1.0 || ms == 0.0 => format!("{ms:.1} ms"),
        ms => format!("{ms:.3} ms"),
    }
}

/// A whole number with commas every three digits.
pub(crate) fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Bytes for people.
pub(crate) fn size(bytes: u64) -> String {
    let units = ["B", "KiB", "MiB", "GiB", "TiB"];
    let (mut value, mut unit) = (bytes as f64, 0);
    while value >= 1024.0 && unit + 1 < units.len() {
        value /= 1024.0;
        unit += 1;
    }
    if unit == 0 { format!("{bytes} B") } else { format!("{value:.1} {}", units[unit]) }
}

/// A table with aligned columns: the first row is the heading; columns of `right` are set to the right.
pub(crate) fn table(rows: &[Vec<String>], right: &[usize]) -> String {
    let n_columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |c: usize| rows.iter().filter_map(|r| r.get(c)).map(|cell| cell.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..n_columns).map(width).collect();
    let mut text = String::new();
    for row in rows {
        let cells: Vec<String> = row
            .iter()
            .enumerate()
            .map(|(c, cell)| {
                let width = widths[c];
                if right.contains(&c) { format!("{cell:>width$}") } else { format!("{cell:<width$}") }
            })
            .collect();
        text += cells.join("  ").trim_end();
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_grouped_by_three() {
        let shown = [0, 12, 999, 1000, 1_234_567].map(grouped);
        assert_eq!(shown, ["0", "12", "999", "1,000", "1,234,567"]);
    }

    #[test]
    fn sizes_have_units() {
        assert_eq!([512, 1536, 3 << 30].map(size), ["512 B", "1.5 KiB", "3.0 GiB"]);
    }

    #[test]
    fn tables_are_aligned() {
        let rows = [vec!["a".to_owned(), "n".to_owned()], vec!["long".to_owned(), "12".to_owned()]];
        assert_eq!(table(&rows, &[1]), "a      n\nlong  12\n");
    }

    #[test]
    fn wall_time_is_split_without_a_rest() {
        let stage = |name, milliseconds, clock| Stage { name, milliseconds, clock };
        let mut times = Times::default();
        times.built(10.0, &[stage("upload", 2.0, Clock::Host), stage("sort", 3.0, Clock::Device)]);
        let stages = vec![stage("query", 1.0, Clock::Device), stage("read back", 4.0, Clock::Host)];
        times.asked(7.0, &Report { stages, ..Report::default() });
        assert_eq!((times.open, times.upload, times.build), (5.0, 2.0, 3.0));
        assert_eq!((times.query, times.read_back), (3.0, 4.0));
    }
}
