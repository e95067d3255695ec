//! Times of all variants, transfers and trees included.

use std::path::Path;
use std::time::Instant;

use nearfield::application::{
    Length, Watch, Wlop, WlopReport, WlopSamples, WlopSettings, WlopStart, WlopVariant, diagonal,
};
use nearfield::geometry::generate::{CloudKind, add_noise, cloud};
use nearfield::io::read_cloud;
use nearfield::query::NearestFew;
use nearfield::{AabbTreeN, AabbTreeNSettings, Gpu, GpuWlop, Vec3};

use super::{Arguments, farthest};
use crate::Result;
use crate::provenance::{Device, Machine};

/// The Kitten of Xing2017 has as many points.
pub(crate) const KITTEN: usize = 137_098;
const SEED: u64 = 1;
/// Part of the diagonal of the torus.
const NOISE: f64 = 0.0005;

/// What a run gave, and its milliseconds by the host's clock.
pub(crate) struct Run {
    pub(crate) samples: WlopSamples<f32>,
    pub(crate) reports: Vec<WlopReport>,
    pub(crate) milliseconds: f64,
}

/// Points that are projected.
pub(crate) struct Cloud {
    pub(crate) points: Vec<Vec3>,
    arrays: Vec<[f32; 3]>,
    diagonal: f64,
}

impl Cloud {
    /// Of a file, or of the noisy torus with so many points.
    pub(crate) fn new(file: Option<&Path>, torus: usize) -> Result<Self> {
        let points = match file {
            Some(path) => read_cloud(path, None)?.points,
            None => {
                let mut points = cloud(CloudKind::Torus, torus, SEED).points;
                add_noise(&mut points, NOISE * 4.04, SEED);
                points
            }
        };
        let arrays: Vec<[f32; 3]> = points.iter().map(Vec3::to_array).collect();
        let diagonal = diagonal(&AabbTreeN::build(&arrays, &AabbTreeNSettings::default())?);
        Ok(Self { points, arrays, diagonal })
    }

    /// All iterations towards so many samples, on the GPU after a check of the first one; with the radius.
    ///
    /// # Errors
    /// As the projection; iterations that were not made, and samples that are wrong or no numbers.
    pub(crate) fn project(&self, gpu: Option<&Gpu>, count: usize, settings: &WlopSettings) -> Result<(f32, Run)> {
        let (radius, run) = match gpu {
            None => on_cpu(&self.arrays, count, settings)?,
            Some(gpu) => {
                check_first_iteration(gpu, (&self.points, &self.arrays), count, settings, self.diagonal)?;
                on_gpu(gpu, &self.points, count, settings)?
            }
        };
        if run.reports.len() != settings.iterations as usize {
            return Err(format!("{}: {} iterations were made", settings.variant, run.reports.len()).into());
        }
        if !run.samples.positions.iter().flatten().all(|x| x.is_finite()) {
            return Err(format!("{}: samples that are no numbers", settings.variant).into());
        }
        Ok((radius, run))
    }
}

pub(super) fn run(machine: &Machine, arguments: &Arguments) -> Result<()> {
    let cloud = Cloud::new(arguments.points.as_deref(), KITTEN)?;
    println!("{} points to {} samples, {} iterations\n", cloud.points.len(), arguments.count, arguments.iterations);
    println!(
        "| variant | radius | points around | samples around | total | sample weights | X → P | X → X | variation |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    let gpu = match &machine.device {
        Device::Cpu => None,
        Device::Gpu(gpu) => Some(gpu),
    };
    for variant in WlopVariant::ALL {
        let settings = WlopSettings {
            radius: arguments.spacings.map(Length::Spacings),
            tolerance: 0.0,
            ..WlopSettings::new(variant).iterations(arguments.iterations)
        };
        let (radius, run) = cloud.project(gpu, arguments.count, &settings)?;
        row(variant, radius, &run)?;
    }
    Ok(())
}

fn row(variant: WlopVariant, radius: f32, run: &Run) -> Result<()> {
    let n = run.reports.len() as f64;
    let mean = |of: fn(&WlopReport) -> f64| run.reports.iter().map(of).sum::<f64>() / n;
    // Milliseconds a search, where the device or the host timed it.
    let stage = |name: &str| {
        let all = run.reports.iter().flat_map(|report| &report.stages).filter(|stage| stage.name == name);
        let times: Vec<f64> = all.map(|stage| stage.milliseconds).collect();
        if times.is_empty() {
            "–".to_owned()
        } else {
            format!("{:.3} ms", times.iter().sum::<f64>() / times.len() as f64)
        }
    };
    println!(
        "| {variant} | {radius:.5} | {:.1} | {:.1} | {:.0} ms | {} | {} | {} | {:.3} |",
        mean(|report| report.mean_inputs),
        mean(|report| report.mean_samples),
        run.milliseconds,
        stage("sample weights"),
        stage("attraction"),
        stage("repulsion"),
        variation(&run.samples.positions)?
    );
    Ok(())
}

/// Of the distances of the nearest samples.
fn variation(samples: &[[f32; 3]]) -> Result<f64> {
    let tree = AabbTreeN::build(samples, &AabbTreeNSettings::default())?;
    let mut few = NearestFew::new(2);
    let mut nearest = Vec::with_capacity(samples.len());
    for sample in samples {
        tree.nearest_few(sample, f32::INFINITY, &mut few);
        nearest.extend(few.found().get(1).map(|hit| f64::from(hit.0).sqrt()));
    }
    let n = nearest.len() as f64;
    let mean = nearest.iter().sum::<f64>() / n;
    Ok((nearest.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n).sqrt() / mean)
}

fn start(count: usize) -> WlopStart<'static, f32> {
    WlopStart::Random { count, seed: SEED }
}

fn on_cpu(points: &[[f32; 3]], count: usize, settings: &WlopSettings) -> Result<(f32, Run)> {
    let clock = Instant::now();
    let tree = AabbTreeN::build(points, &AabbTreeNSettings::default())?;
    let mut wlop = Wlop::new(&tree, &start(count), settings, &mut Watch::none())?;
    let reports = wlop.run(&mut Watch::none())?;
    let samples = wlop.samples();
    Ok((wlop.radius(), Run { samples, reports, milliseconds: clock.elapsed().as_secs_f64() * 1e3 }))
}

/// After a short run that compiles the kernels.
fn on_gpu(gpu: &Gpu, points: &[Vec3], count: usize, settings: &WlopSettings) -> Result<(f32, Run)> {
    let mut once = GpuWlop::new(gpu, points, &start(count), &settings.iterations(2), &mut Watch::none())?;
    once.run(&mut Watch::none())?;
    let clock = Instant::now();
    let mut wlop = GpuWlop::new(gpu, points, &start(count), settings, &mut Watch::none())?;
    let reports = wlop.run(&mut Watch::none())?;
    let samples = wlop.samples()?;
    Ok((wlop.radius(), Run { samples, reports, milliseconds: clock.elapsed().as_secs_f64() * 1e3 }))
}

fn check_first_iteration(
    gpu: &Gpu,
    (points, arrays): (&[Vec3], &[[f32; 3]]),
    count: usize,
    settings: &WlopSettings,
    size: f64,
) -> Result<()> {
    let tree = AabbTreeN::build(arrays, &AabbTreeNSettings::default())?;
    let mut here = Wlop::new(&tree, &start(count), settings, &mut Watch::none())?;
    let mut there = GpuWlop::new(gpu, points, &start(count), settings, &mut Watch::none())?;
    here.iterate()?;
    there.iterate()?;
    let farthest = farthest(here.positions(), &there.samples()?.positions)?;
    if !(farthest <= 1e-5 * size) {
        return Err(format!("{}: samples on the device are {farthest} from those on the CPU", settings.variant).into());
    }
    Ok(())
}
