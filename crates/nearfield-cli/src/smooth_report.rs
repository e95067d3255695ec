//! What `nearfield smooth` tells: a line an iteration and a summary, or one JSON object.

use nearfield::application::{MlsReport, PointFlags, Support};
use serde_json::{Value, json};

use crate::exit::Failure;
use crate::options::Common;
use crate::report::{DIGITS, Times, grouped, print, print_json, rounded, short, shown_ms, stage_json, table};
use crate::smooth::{Method, Mode, SmoothArgs};

/// Everything worth telling.
pub(crate) struct Told<'a> {
    pub(crate) args: &'a SmoothArgs,
    pub(crate) support: Support<'a, f32>,
    pub(crate) points: u64,
    pub(crate) reports: &'a [MlsReport],
    pub(crate) device: String,
    pub(crate) times: Times,
    pub(crate) notes: Vec<String>,
}

/// The method by its name.
fn name(method: Method) -> &'static str {
    match method {
        Method::Apss => "apss",
        Method::Pss => "pss",
        Method::Rimls => "rimls",
        Method::Bilateral => "bilateral",
        Method::Jet => "jet",
    }
}

/// The second line of the picture.
pub(crate) fn subtitle(args: &SmoothArgs, reports: &[MlsReport]) -> String {
    let neighbors = reports.first().map_or(0.0, |report| report.mean_neighbors);
    let steps = if args.mode == Mode::Smooth { "iterations" } else { "steps of projection" };
    format!("{}, {neighbors:.0} neighbours, {} {steps}", name(args.method), reports.len())
}

/// The product of what the iterations did to the volume; `None` where one could not say.
fn volume_drift(reports: &[MlsReport]) -> Option<f64> {
    reports.iter().try_fold(1.0, |volume, report| Some(volume * (1.0 + report.volume_change?))).map(|v| v - 1.0)
}

fn percent(share: Option<f64>) -> String {
    share.map_or("unknown".to_owned(), |share| format!("{:+.4} %", 100.0 * share))
}

impl Told<'_> {
    pub(crate) fn tell(&self, common: &Common, to_stderr: bool) -> Result<(), Failure> {
        if self.args.files.json {
            return print_json(&self.json());
        }
        if common.quiet {
            return Ok(());
        }
        let text = self.iterations() + &self.lines();
        if to_stderr {
            eprint!("{text}");
            return Ok(());
        }
        print(&text)
    }

    fn iterations(&self) -> String {
        let heading = ["iteration", "moving", "mean move", "longest", "volume", "neighbours", "flagged", "time"];
        let mut rows = vec![heading.map(str::to_owned).to_vec()];
        for report in self.reports {
            rows.push(vec![
                report.iteration.to_string(),
                grouped(report.moving),
                format!("{:.3e}", report.mean_move),
                format!("{:.3e}", report.largest_move),
                percent(report.volume_change),
                format!("{:.1}", report.mean_neighbors),
                grouped(report.flagged.iter().sum()),
                shown_ms(report.milliseconds),
            ]);
        }
        table(&rows, &[0, 1, 2, 3, 4, 5, 6, 7])
    }

    fn lines(&self) -> String {
        let support = match self.support {
            Support::Nearest(k) => format!("the {k} nearest"),
            Support::Radius(radius) => format!("within {}", short(radius, DIGITS)),
            _ => String::new(),
        };
        let mut rows = vec![
            ("points", grouped(self.points)),
            ("method", format!("{}, {} ({support})", name(self.args.method), self.args.mode.name())),
            ("volume", format!("{} by all iterations", percent(volume_drift(self.reports)))),
        ];
        rows.extend(self.flags().map(|flags| ("flagged", flags)));
        rows.push(("device", self.device.clone()));
        rows.push(("time", self.times.line()));
        rows.extend(self.notes.iter().map(|note| ("note", note.clone())));
        rows.iter().map(|(name, value)| format!("{name:<12}{value}\n")).collect()
    }

    /// How many points have which flag, where some have one.
    fn flags(&self) -> Option<String> {
        let flagged = self.reports.last()?.flagged;
        let named = PointFlags::NAMES.iter().zip(flagged).filter(|(_, count)| *count > 0);
        let named: Vec<String> = named.map(|(name, count)| format!("{} {name}", grouped(count))).collect();
        (!named.is_empty()).then(|| named.join(", "))
    }

    fn json(&self) -> Value {
        let iteration = |report: &MlsReport| {
            json!({
                "iteration": report.iteration,
                "fitted": report.fitted,
                "moving": report.moving,
                "mean_move": report.mean_move,
                "largest_move": report.largest_move,
                "mean_signed_move": report.mean_signed_move,
                "volume_change": report.volume_change,
                "mean_neighbors": report.mean_neighbors,
                "flagged": flag_counts(report.flagged),
                "stages": report.stages.iter().map(stage_json).collect::<Vec<_>>(),
                "milliseconds": rounded(report.milliseconds),
            })
        };
        let (radius, k) = match self.support {
            Support::Radius(radius) => (Some(crate::report::shortest(radius)), None),
            Support::Nearest(k) => (None, Some(k)),
            _ => (None, None),
        };
        json!({
            "points": self.points,
            "method": name(self.args.method),
            "mode": self.args.mode.name(),
            "radius": radius,
            "k": k,
            "iterations": self.reports.iter().map(iteration).collect::<Vec<_>>(),
            "volume_drift": volume_drift(self.reports),
            "device": self.device,
            "milliseconds": self.times.json(),
            "notes": self.notes,
        })
    }
}

/// Number of points by the name of the flag.
fn flag_counts(flagged: [u64; 7]) -> Value {
    let named = PointFlags::NAMES.iter().zip(flagged);
    Value::Object(named.map(|(name, count)| ((*name).to_owned(), json!(count))).collect())
}
