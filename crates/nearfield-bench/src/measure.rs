//! Repeated runs and their medians, in all and by stage.

use std::time::Instant;

use nearfield::query::{Clock, Stage};

use crate::{Result, clocks};

/// How often a measurement is repeated.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Seconds of untimed runs before, after one run and after the clocks of a card were raised; 0 for one run alone.
    pub warm_up: f64,
    /// Timed runs wanted.
    pub runs: usize,
    /// No further run is begun after this many seconds; at least one is.
    pub seconds: f64,
}

/// Median and fastest of some runs, in milliseconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Median.
    pub median: f64,
    /// Fastest.
    pub fastest: f64,
}

impl Timing {
    /// Of these milliseconds; zero of none.
    pub fn of(milliseconds: &[f64]) -> Self {
        let fastest = milliseconds.iter().copied().fold(f64::INFINITY, f64::min);
        Self { median: median(milliseconds), fastest: if fastest.is_finite() { fastest } else { 0.0 } }
    }
}

/// Median; the mean of the middle two of an even number, 0 of nothing.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match (sorted.len(), sorted.len() / 2) {
        (0, _) => 0.0,
        (len, middle) if len % 2 == 1 => sorted[middle],
        (_, middle) => 0.5 * (sorted[middle - 1] + sorted[middle]),
    }
}

/// Times of one operation.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Wall clock from the call to its return, the device having finished.
    pub wall: Timing,
    /// Sum of the device's stages; `None` where the device has no timestamps or did nothing.
    pub device: Option<Timing>,
    /// Median of each stage, in order of first appearance.
    pub stages: Vec<Stage>,
    /// Timed runs.
    pub runs: usize,
}

/// Warms up and then runs as often as `effort` says; returns the last answer with the times.
///
/// `run` returns its answer and the stages of that run. Answers are dropped before the next run begins.
///
/// # Errors
/// What `run` returns.
pub fn repeat<T>(effort: Effort, mut run: impl FnMut() -> Result<(T, Vec<Stage>)>) -> Result<(T, Measured)> {
    let (mut answer, _) = run()?;
    if effort.warm_up > 0.0 {
        clocks::raise()?;
    }
    let warming = Instant::now();
    while warming.elapsed().as_secs_f64() < effort.warm_up {
        drop(answer);
        answer = run()?.0;
    }
    let (mut walls, mut devices, mut stages) = (Vec::new(), Vec::new(), Stages::default());
    let begin = Instant::now();
    loop {
        drop(answer);
        let start = Instant::now();
        let (made, times) = run()?;
        walls.push(start.elapsed().as_secs_f64() * 1e3);
        answer = made;
        if times.iter().any(|s| s.clock == Clock::Device) {
            devices.push(times.iter().filter(|s| s.clock == Clock::Device).map(|s| s.milliseconds).sum());
        }
        stages.add_run(&times);
        if walls.len() >= effort.runs || begin.elapsed().as_secs_f64() > effort.seconds {
            break;
        }
    }
    let device = (!devices.is_empty()).then(|| Timing::of(&devices));
    Ok((answer, Measured { wall: Timing::of(&walls), device, stages: stages.medians(), runs: walls.len() }))
}

/// Times of the same stages in several runs.
#[derive(Default)]
struct Stages {
    seen: Vec<(&'static str, Clock, Vec<f64>)>,
}

impl Stages {
    /// Adds a run; stages of one name on one clock are summed.
    fn add_run(&mut self, times: &[Stage]) {
        let mut run: Vec<Stage> = Vec::new();
        for stage in times {
            match run.iter_mut().find(|s| s.name == stage.name && s.clock == stage.clock) {
                Some(same) => same.milliseconds += stage.milliseconds,
                None => run.push(stage.clone()),
            }
        }
        for stage in run {
            match self.seen.iter_mut().find(|(name, clock, _)| *name == stage.name && *clock == stage.clock) {
                Some((_, _, values)) => values.push(stage.milliseconds),
                None => self.seen.push((stage.name, stage.clock, vec![stage.milliseconds])),
            }
        }
    }

    fn medians(&self) -> Vec<Stage> {
        let stage = |(name, clock, values): &(&'static str, Clock, Vec<f64>)| Stage {
            name,
            milliseconds: median(values),
            clock: *clock,
        };
        self.seen.iter().map(stage).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_is_the_middle_of_any_order() {
        assert_eq!(median(&[]), 0.0);
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0, 2.0, 9.0]), 3.0);
    }

    #[test]
    fn the_warm_up_is_not_timed_and_stages_are_summed_within_a_run() {
        let mut calls = 0;
        let stage = |name, milliseconds, clock| Stage { name, milliseconds, clock };
        let effort = Effort { warm_up: 0.0, runs: 3, seconds: 60.0 };
        let (answer, measured) = repeat(effort, || {
            calls += 1;
            let first = if calls == 1 { 1000.0 } else { calls as f64 };
            let stages =
                vec![stage("a", first, Clock::Device), stage("a", 1.0, Clock::Device), stage("b", 0.5, Clock::Host)];
            Ok((calls, stages))
        })
        .expect("runs succeed");
        assert_eq!((answer, measured.runs), (4, 3));
        assert_eq!(measured.stages, [stage("a", 4.0, Clock::Device), stage("b", 0.5, Clock::Host)]);
        assert_eq!(measured.device, Some(Timing { median: 4.0, fastest: 3.0 }));
    }
}
