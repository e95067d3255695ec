//! What `nearfield resample` does on either device: iterations until the samples rest or the user wants to end.

use std::io::IsTerminal;
use std::ops::ControlFlow;

use nearfield::application::{self, NoiseCheck, Watch, WlopReport, WlopSamples, WlopSettings, noise_check};
use nearfield::geometry::{Attribute, Column};
use nearfield::{AabbTreeN, GpuWlop, PointCloud, Vec3, Wlop};

use crate::interrupt;
use crate::options::Common;
use crate::progress::{CountBar, Progress};

/// What moves samples, wherever it runs.
pub(crate) trait Resampler {
    /// Some iterations, none where all is done.
    fn iterate_some(&mut self) -> nearfield::Result<Vec<WlopReport>>;

    fn is_done(&self) -> bool;

    fn samples(&self) -> nearfield::Result<WlopSamples<f32>>;
}

impl Resampler for Wlop<'_, f32> {
    fn iterate_some(&mut self) -> nearfield::Result<Vec<WlopReport>> {
        Ok(vec![self.iterate()?])
    }

    fn is_done(&self) -> bool {
        self.is_done()
    }

    fn samples(&self) -> nearfield::Result<WlopSamples<f32>> {
        Ok(self.samples())
    }
}

impl Resampler for GpuWlop {
    fn iterate_some(&mut self) -> nearfield::Result<Vec<WlopReport>> {
        self.iterate_some()
    }

    fn is_done(&self) -> bool {
        self.is_done()
    }

    fn samples(&self) -> nearfield::Result<WlopSamples<f32>> {
        self.samples()
    }
}

/// What came out.
pub(crate) struct Done {
    pub(crate) samples: WlopSamples<f32>,
    pub(crate) reports: Vec<WlopReport>,
    pub(crate) radius: f32,
    pub(crate) noise: Option<NoiseCheck>,
    pub(crate) notes: Vec<String>,
    pub(crate) interrupted: bool,
}

/// Runs `work` with a watch that shows how far it is and ends it where the user wants that.
pub(crate) fn watched<T>(
    common: &Common,
    words: &str,
    work: impl FnOnce(&mut Watch<'_>) -> nearfield::Result<T>,
) -> nearfield::Result<T> {
    interrupt::watch();
    let progress = Progress::start(common, words);
    let mut tell = |at: application::Progress| {
        let percent = (100 * at.done).checked_div(at.total).unwrap_or(100);
        progress.step(format!("{}, {percent} %", at.stage));
        if interrupt::asked() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    work(&mut Watch::new(&mut tell))
}

/// Compares the radius with the noise of the points, then iterates until all is done or the user wants to end.
///
/// - `tree`: over the points
pub(crate) fn resample(
    tree: &AabbTreeN<f32, 3>,
    radius: f32,
    mut wlop: impl Resampler,
    settings: &WlopSettings,
    common: &Common,
) -> nearfield::Result<Done> {
    interrupt::watch();
    let (noise, note) = noise_of(tree, settings, radius);
    let bar = CountBar::start(common, settings.iterations.into(), "iterations");
    if !common.quiet && std::io::stderr().is_terminal() {
        // Before the work, for who would rather ask for another radius; the report repeats it.
        bar.note(note.clone());
    }
    let mut reports: Vec<WlopReport> = Vec::new();
    while !wlop.is_done() && !interrupt::asked() {
        reports.extend(wlop.iterate_some()?);
        let moved = reports.last().map_or(0.0, |report| report.mean_move);
        bar.show(reports.len() as u64, &format!("mean move {moved:.3e}"));
    }
    let interrupted = !wlop.is_done();
    Ok(Done { samples: wlop.samples()?, reports, radius, noise, notes: note.into_iter().collect(), interrupted })
}

/// The noise of the points, and what is to be said of it. No failure of the estimate is worth the samples.
fn noise_of(tree: &AabbTreeN<f32, 3>, settings: &WlopSettings, radius: f32) -> (Option<NoiseCheck>, Option<String>) {
    match noise_check(tree, settings.variant, radius) {
        Ok(noise) => (noise, noise.and_then(|noise| noise_note(&noise, settings, radius))),
        Err(error) => (None, Some(format!("the noise of the points could not be estimated: {error}"))),
    }
}

/// What is to be said of a radius that is small for the noise.
fn noise_note(noise: &NoiseCheck, settings: &WlopSettings, radius: f32) -> Option<String> {
    let least = noise.least_radius(settings.variant);
    let note = format!(
        "the radius {radius} is small for noise of some {:.3}: samples may follow it; --radius {least:.3} or more holds five \
         deviations in its width",
        noise.deviation
    );
    noise.is_too_small().then_some(note)
}

/// The samples as a cloud, with the flags where there are some.
pub(crate) fn output_cloud(cloud: &PointCloud, samples: &WlopSamples<f32>) -> PointCloud {
    let points = samples.positions.iter().map(|&p| Vec3::from_array(p)).collect();
    let mut resampled = PointCloud { origin: cloud.origin, points, ..PointCloud::default() };
    if samples.flags.iter().any(|flags| !flags.is_empty()) {
        let values = Column::U8(samples.flags.iter().map(|flags| flags.0 as u8).collect());
        resampled.attributes.push(Attribute { name: "flags".to_owned(), values });
    }
    resampled
}
