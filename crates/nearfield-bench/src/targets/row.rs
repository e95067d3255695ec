//! What a row of the table is, and what measuring it gives.

use nearfield::query::{Clock, Stage};

use super::bench::Bench;
use crate::Result;
use crate::device::timed::{Attempt, Timed};
use crate::measure::{Measured, Timing};

/// What the figures of a row are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unit {
    /// Less is better.
    Milliseconds,
    /// Thousand million rays a second.
    GigaRays,
    /// Steps of a simulation a second.
    Steps,
    /// Memory; less is better.
    BytesAPoint,
    /// Memory by that of the answer; less is better.
    Times,
}

impl Unit {
    /// As it is printed.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Milliseconds => "ms",
            Self::GigaRays => "Grays/s",
            Self::Steps => "steps/s",
            Self::BytesAPoint => "bytes a point",
            Self::Times => "times",
        }
    }

    /// Whether more is better.
    pub(super) fn is_rate(self) -> bool {
        matches!(self, Self::GigaRays | Self::Steps)
    }

    /// How many times the target a figure is away from it: above 1 it is missed.
    pub(super) fn missed_by(self, figure: f64, target: f64) -> f64 {
        if self.is_rate() { target / figure } else { figure / target }
    }
}

/// The best other program for the same work.
#[derive(Debug, Clone, Copy)]
pub(super) struct Peer {
    /// In the unit of the row.
    pub(super) value: f64,
    /// Who, and where the figure was taken if not on the card of the targets.
    pub(super) who: &'static str,
}

/// What the machine of the targets cannot pass.
#[derive(Debug, Clone, Copy)]
pub(super) struct Floor {
    /// In the unit of the row.
    pub(super) value: f64,
    /// How it is reckoned, in a few words; at length beside the rows.
    pub(super) how: &'static str,
}

/// A row: what is measured, what is asked, and the function that measures it.
pub(super) struct Row {
    /// As `--rows` takes it.
    pub(super) name: &'static str,
    /// What is timed.
    pub(super) work: &'static str,
    /// Unit of all figures.
    pub(super) unit: Unit,
    /// What is asked now; `None` where nothing is, or where the run itself measures it.
    pub(super) target: Option<f64>,
    /// What is asked after that.
    pub(super) then: Option<f64>,
    /// The best peer measured.
    pub(super) peer: Option<Peer>,
    /// The physical floor; `None` where the run itself measures it.
    pub(super) floor: Option<Floor>,
    /// Measures and checks.
    pub(super) measure: fn(&mut Bench) -> Result<Outcome>,
}

/// What measuring a row gave.
pub(super) struct Outcome {
    /// Neighbours of a query, itself included, where there are any.
    pub(super) mean_neighbors: Option<f64>,
    /// One or a few.
    pub(super) figures: Vec<Figure>,
}

impl Outcome {
    /// With neighbours.
    pub(super) fn of(mean_neighbors: f64, figures: Vec<Figure>) -> Self {
        Self { mean_neighbors: Some(mean_neighbors), figures }
    }

    /// Without neighbours.
    pub(super) fn without_neighbors(figures: Vec<Figure>) -> Self {
        Self { mean_neighbors: None, figures }
    }

    /// No figure, and why.
    pub(super) fn missing(note: impl Into<String>) -> Self {
        Self::without_neighbors(vec![Figure::missing("", note)])
    }
}

/// Median and fastest, or one value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Value {
    /// In the unit of the row.
    pub(super) median: f64,
    /// The best of the runs.
    pub(super) fastest: f64,
    /// Whose clock; `None` of memory.
    pub(super) clock: Option<Clock>,
    /// Timed runs or steps.
    pub(super) runs: usize,
}

/// Bytes; 0 where they were not looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Memory {
    /// Points that were searched.
    pub(super) points: usize,
    /// Held by the structure, points included.
    pub(super) structure: u64,
    /// Most that was held on the device while the row was measured, its points included.
    pub(super) peak: u64,
    /// Of the answer.
    pub(super) answer: u64,
}

/// One figure of a row.
#[derive(Debug, Clone)]
pub(super) struct Figure {
    /// How it was done, where there is more than one way.
    pub(super) way: String,
    /// The figure; `None` where there is none, see the note.
    pub(super) value: Option<Value>,
    /// Whether the target is for it; others stand beside.
    pub(super) is_judged: bool,
    /// In place of the row's target, measured in the same run.
    pub(super) target: Option<f64>,
    /// In place of the row's floor, measured in the same run.
    pub(super) floor: Option<f64>,
    /// Stages of a run, medians.
    pub(super) stages: Vec<Stage>,
    /// Bytes.
    pub(super) memory: Memory,
    /// What else there is to say.
    pub(super) note: String,
}

impl Figure {
    /// Milliseconds by the device's clock, where it has one.
    pub(super) fn by_device(way: impl Into<String>, measured: &Measured) -> Self {
        Self::by(way, measured, measured.device)
    }

    /// Milliseconds by the host's clock.
    pub(super) fn by_host(way: impl Into<String>, measured: &Measured) -> Self {
        Self::by(way, measured, None)
    }

    fn by(way: impl Into<String>, measured: &Measured, device: Option<Timing>) -> Self {
        let clock = if device.is_some() { Clock::Device } else { Clock::Host };
        let Timing { median, fastest } = device.unwrap_or(measured.wall);
        let value = Value { median, fastest, clock: Some(clock), runs: measured.runs };
        Self { stages: measured.stages.clone(), ..Self::value(way, value) }
    }

    /// What was timed, or why it was not.
    pub(super) fn attempted(way: &str, attempt: &Attempt, points: usize, structure: u64) -> Self {
        match attempt {
            Ok(timed) => Self::timed(way, timed, points, structure),
            Err(note) => Self::missing(way, note.clone()),
        }
    }

    /// What was timed by the device's clock, with its memory.
    pub(super) fn timed(way: &str, timed: &Timed, points: usize, structure: u64) -> Self {
        let way = match (way, timed.search) {
            (way, "") => way.to_owned(),
            ("", search) => search.to_owned(),
            (way, search) => format!("{way}, {search}"),
        };
        let memory = Memory { points, structure, peak: timed.peak_bytes, answer: timed.answer_bytes };
        Self { memory, ..Self::by_device(way, &timed.measured) }
    }

    /// A value.
    pub(super) fn value(way: impl Into<String>, value: Value) -> Self {
        Self {
            way: way.into(),
            value: Some(value),
            is_judged: true,
            target: None,
            floor: None,
            stages: Vec::new(),
            memory: Memory::default(),
            note: String::new(),
        }
    }

    /// A rate that was measured once.
    pub(super) fn rate(way: impl Into<String>, rate: f64, runs: usize) -> Self {
        Self::value(way, Value { median: rate, fastest: rate, clock: Some(Clock::Host), runs })
    }

    /// Bytes a point.
    pub(super) fn bytes_a_point(way: impl Into<String>, bytes: u64, memory: Memory) -> Self {
        Self::bytes_by_bytes(way, bytes, memory.points as u64, memory)
    }

    /// Bytes by other bytes.
    pub(super) fn bytes_by_bytes(way: impl Into<String>, bytes: u64, by: u64, memory: Memory) -> Self {
        let ratio = bytes as f64 / by.max(1) as f64;
        Self { memory, ..Self::value(way, Value { median: ratio, fastest: ratio, clock: None, runs: 1 }) }
    }

    /// No figure, and why.
    pub(super) fn missing(way: impl Into<String>, note: impl Into<String>) -> Self {
        let nothing = Value { median: f64::NAN, fastest: f64::NAN, clock: None, runs: 0 };
        Self { value: None, is_judged: false, note: note.into(), ..Self::value(way, nothing) }
    }

    /// The median; not a number where there is none.
    pub(super) fn median(&self) -> f64 {
        self.value.map_or(f64::NAN, |value| value.median)
    }

    /// Beside those that the target is for.
    pub(super) fn beside(mut self) -> Self {
        self.is_judged = false;
        self
    }

    /// With a note.
    pub(super) fn note(mut self, note: impl Into<String>) -> Self {
        self.note = note.into();
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_missed_above_and_rates_below_their_target() {
        assert_eq!(Unit::Milliseconds.missed_by(0.6, 0.5), 1.2);
        assert_eq!(Unit::Steps.missed_by(500.0, 1000.0), 2.0);
        assert!(Unit::Milliseconds.missed_by(0.4, 0.5) < 1.0 && Unit::GigaRays.missed_by(3.0, 2.0) < 1.0);
    }
}
