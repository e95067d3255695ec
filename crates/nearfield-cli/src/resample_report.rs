//! What `nearfield resample` tells: a line an iteration and a summary, or one JSON object.

use nearfield::application::{NoiseCheck, PointFlags, WlopReport, WlopSettings};
use serde_json::{Value, json};

use crate::exit::Failure;
use crate::options::Common;
use crate::report::{DIGITS, Times, grouped, print, print_json, rounded, short, shortest, shown_ms, stage_json, table};
use crate::resample::ResampleArgs;
use crate::resample_work::Done;

/// Everything worth telling.
pub(crate) struct Told<'a> {
    pub(crate) args: &'a ResampleArgs,
    pub(crate) settings: &'a WlopSettings,
    pub(crate) points: u64,
    pub(crate) done: &'a Done,
    /// Samples without attraction before any were dropped.
    pub(crate) unattracted: usize,
    /// Mean move to where the samples were snapped.
    pub(crate) snapped: Option<f64>,
    pub(crate) noise: Option<NoiseCheck>,
    pub(crate) device: String,
    pub(crate) times: Times,
    pub(crate) notes: Vec<String>,
}

impl Told<'_> {
    /// The second line of the picture.
    pub(crate) fn subtitle(&self) -> String {
        let samples = grouped(self.done.samples.positions.len() as u64);
        format!("{samples} samples, {}, {} iterations", self.settings.variant, self.done.reports.len())
    }

    /// With the time that the picture took.
    pub(crate) fn with_picture(mut self, milliseconds: f64) -> Self {
        self.times.picture = milliseconds;
        self
    }

    pub(crate) fn tell(&self, common: &Common) -> Result<(), Failure> {
        if self.args.files.json {
            return print_json(&self.json());
        }
        if common.quiet {
            return Ok(());
        }
        let text = self.iterations() + &self.lines();
        if self.args.writes_to_stdout() {
            eprint!("{text}");
            return Ok(());
        }
        print(&text)
    }

    fn iterations(&self) -> String {
        let heading = ["iteration", "mean move", "longest", "points", "samples", "unattracted", "time"];
        let mut rows = vec![heading.map(str::to_owned).to_vec()];
        for report in &self.done.reports {
            rows.push(vec![
                report.iteration.to_string(),
                format!("{:.3e}", report.mean_move),
                format!("{:.3e}", report.largest_move),
                format!("{:.1}", report.mean_inputs),
                format!("{:.1}", report.mean_samples),
                grouped(report.unattracted),
                shown_ms(report.milliseconds),
            ]);
        }
        table(&rows, &[0, 1, 2, 3, 4, 5, 6])
    }

    /// How many samples the output has, and how many are left out.
    fn samples(&self) -> String {
        let (kept, asked) = (self.done.samples.positions.len() as u64, u64::from(self.args.count));
        match asked - kept {
            0 => grouped(kept),
            dropped => format!("{}, {} without attraction are left out", grouped(kept), grouped(dropped)),
        }
    }

    fn lines(&self) -> String {
        let radius = short(self.done.radius, DIGITS);
        let mut rows = vec![
            ("points", grouped(self.points)),
            ("samples", self.samples()),
            ("variant", format!("{} (within {radius})", self.settings.variant)),
        ];
        rows.extend(self.noise.map(|noise| ("noise", format!("some {}", short(noise.deviation as f32, DIGITS)))));
        rows.extend(self.flags().map(|flags| ("flagged", flags)));
        if let (Some(to), Some(moved)) = (self.args.snap, self.snapped) {
            rows.push(("snapped", format!("to {}, by {moved:.3e} on average", to.name())));
        }
        rows.push(("device", self.device.clone()));
        rows.push(("time", self.times.line()));
        rows.extend(self.notes.iter().map(|note| ("note", note.clone())));
        rows.iter().map(|(name, value)| format!("{name:<12}{value}\n")).collect()
    }

    /// How many samples have which flag, where some have one.
    fn flags(&self) -> Option<String> {
        let totals = PointFlags::totals(&self.done.samples.flags);
        let named = PointFlags::NAMES.iter().zip(totals).filter(|(_, count)| *count > 0);
        let named: Vec<String> = named.map(|(name, count)| format!("{} {name}", grouped(count))).collect();
        (!named.is_empty()).then(|| named.join(", "))
    }

    fn json(&self) -> Value {
        let iteration = |report: &WlopReport| {
            json!({
                "iteration": report.iteration,
                "mean_move": report.mean_move,
                "largest_move": report.largest_move,
                "mean_inputs": report.mean_inputs,
                "mean_samples": report.mean_samples,
                "unattracted": report.unattracted,
                "stages": report.stages.iter().map(stage_json).collect::<Vec<_>>(),
                "milliseconds": rounded(report.milliseconds),
            })
        };
        let totals = PointFlags::NAMES.iter().zip(PointFlags::totals(&self.done.samples.flags));
        let flagged: serde_json::Map<String, Value> =
            totals.map(|(name, count)| ((*name).to_owned(), json!(count))).collect();
        json!({
            "points": self.points,
            "samples": self.done.samples.positions.len(),
            "variant": self.settings.variant.name(),
            "radius": shortest(self.done.radius),
            "mu": self.settings.mu,
            "noise": self.noise.map(|noise| noise.deviation),
            "radius_is_small": self.noise.map(|noise| noise.is_too_small()),
            "iterations": self.done.reports.iter().map(iteration).collect::<Vec<_>>(),
            "unattracted": self.unattracted,
            "flagged": flagged,
            "snap_mean_move": self.snapped,
            "device": self.device,
            "milliseconds": self.times.json(),
            "notes": self.notes,
        })
    }
}
