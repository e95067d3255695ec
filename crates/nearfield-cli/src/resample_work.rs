//! What `nearfield resample` does on either device: iterations until the samples rest or the user wants to end.

use nearfield::application::{NoiseCheck, WlopReport, WlopSamples, WlopSettings};
use nearfield::geometry::{Attribute, Column};
use nearfield::{GpuWlop, PointCloud, Vec3, Wlop};

use crate::interrupt;
use crate::options::Common;
use crate::progress::CountBar;

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
    pub(crate) interrupted: bool,
}

/// Iterates until all is done or the user wants to end.
pub(crate) fn resample(
    radius: f32,
    mut wlop: impl Resampler,
    settings: &WlopSettings,
    common: &Common,
) -> nearfield::Result<Done> {
    interrupt::watch();
    let bar = CountBar::start(common, settings.iterations.into(), "iterations");
    let mut reports: Vec<WlopReport> = Vec::new();
    while !wlop.is_done() && !interrupt::asked() {
        reports.extend(wlop.iterate_some()?);
        let moved = reports.last().map_or(0.0, |report| report.mean_move);
        bar.show(reports.len() as u64, &format!("mean move {moved:.3e}"));
    }
    let interrupted = !wlop.is_done();
    Ok(Done { samples: wlop.samples()?, reports, radius, interrupted })
}

/// What is to be said of a radius that is small for the noise.
pub(crate) fn noise_note(noise: &NoiseCheck, settings: &WlopSettings, radius: f32) -> Option<String> {
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
