//! The paper's approximate baseline in a simulation: a search for the k nearest by shifted sorts, k being the largest number of
//! neighbours that an exact search finds at sampled moments.

use std::time::Instant;

use nearfield::application::Watch;
use nearfield::application::particles::{ParticleSearch, Particles};
use nearfield::gpu::{Buffer, Gpu};
use nearfield::{Aabb, FixedRadius, GridSettings, NeighborSearch, UniformGrid, Vec3};

use super::case::Case;
use super::timing;
use super::ways::Way;
use crate::Result;
use crate::baselines::MOST_K;
use crate::baselines::shifted_sort::{Asks, GpuShiftedSort, ShiftedSortSettings};
use crate::device::device_points;
use crate::measure::median;
use crate::paper::lab::Lab;
use crate::paper::rows::Row;

/// Its name.
pub const NAME: &str = "shifted sort";
/// Moments of a run.
const MOMENTS: u32 = 8;
/// Timed searches, and steps of a list that is still good, a moment.
const REPEATS: usize = 5;

/// What the searches at some moments of a run take and find.
pub struct Sampled {
    /// Neighbours that are searched for.
    pub k: usize,
    /// The steps of the moments, and the milliseconds of a search at each.
    pub times: Vec<(u64, f64)>,
    /// Share of the neighbours that were found.
    pub recall: f64,
    /// Neighbours of a particle, itself not counted.
    pub mean_neighbors: f64,
    moments: Vec<Moment>,
}

impl Sampled {
    /// Milliseconds of a search.
    pub fn milliseconds(&self) -> f64 {
        let times: Vec<f64> = self.times.iter().map(|(_, milliseconds)| *milliseconds).collect();
        median(&times)
    }
}

/// Particles at a moment, and what an exact search finds.
struct Moment {
    step: u64,
    particles: Particles,
    places: Vec<Vec3>,
    /// Neighbours of all, each itself included.
    total: u64,
    /// Of the particle with the most.
    most: u32,
}

/// Steps a second with this search, by positions of a run of the uniform grid.
///
/// # Errors
/// As [`sample`] and the simulations.
pub fn measure(lab: &Lab, case: &Case, mut row: Row, seconds: f64) -> Result<Row> {
    let sampled = sample(lab, case, seconds)?;
    let rests: Vec<f64> =
        sampled.moments.iter().map(|moment| rest_of_step(lab, case, &moment.particles)).collect::<Result<_>>()?;
    let (search_ms, rest_ms) = (sampled.milliseconds(), median(&rests));
    row.recall = Some(sampled.recall);
    row.mean_neighbors = Some(sampled.mean_neighbors);
    row.runs = sampled.times.len();
    row.note = format!(
        "k {}; search {search_ms:.3} ms at {} moments and {rest_ms:.3} ms for the rest of a step; all that was found is within reach",
        sampled.k,
        sampled.times.len()
    );
    Ok(row.value(1e3 / (search_ms + rest_ms)))
}

/// Searches at some moments of a run of the uniform grid, k being the largest count among them.
///
/// # Errors
/// `Unsupported` on the CPU and where a particle has too many neighbours; a wrong answer; as the simulation.
pub fn sample(lab: &Lab, case: &Case, seconds: f64) -> Result<Sampled> {
    let Some(gpu) = lab.gpu() else {
        let what = "a timed shifted sort on the CPU".to_owned();
        return Err(nearfield::Error::Unsupported { what, advice: "measure it on a GPU" }.into());
    };
    let reach = case.scene.model.largest_reach() as f32;
    let moments = moments(lab, case, reach, seconds)?;
    let k = moments.iter().map(|moment| moment.most).max().unwrap_or(1) as usize;
    if k > MOST_K {
        let what = format!("a shifted sort for the {k} nearest");
        return Err(nearfield::Error::Unsupported { what, advice: "it keeps at most 128" }.into());
    }
    let [low, high] = case.scene.domain.map(|corner| corner.as_vec3());
    let search = Search {
        gpu,
        plan: GpuShiftedSort::new(gpu, case.scene.particles.len(), ShiftedSortSettings::new(k))?,
        bounds: Aabb::new(low, high),
    };
    let (mut times, mut found, mut all) = (Vec::new(), 0, 0);
    for moment in &moments {
        let points = gpu.upload("points", &device_points(&moment.places))?;
        times.push((moment.step, search.milliseconds(&points)?));
        found += search.found_within(&points, reach)?;
        all += moment.total;
    }
    // Pairs at the reach may count or not.
    if found > all + 2 + all / 100_000 {
        return Err(format!("wrong answer: {found} neighbours in all, there are {all}").into());
    }
    let n = case.scene.particles.len() as u64 * moments.len() as u64;
    let recall = found.saturating_sub(n) as f64 / all.saturating_sub(n).max(1) as f64;
    let mean_neighbors = all.saturating_sub(n) as f64 / n.max(1) as f64;
    Ok(Sampled { k, times, recall, mean_neighbors, moments })
}

/// Moments of the run, evenly from its first step to its last, or as far as the time leads.
fn moments(lab: &Lab, case: &Case, reach: f32, seconds: f64) -> Result<Vec<Moment>> {
    let way = Way { search: ParticleSearch::UNIFORM_GRID, on_gpu: lab.gpu().is_some() };
    let mut simulation = way.open(lab, &case.scene, false)?;
    let mut moments = Vec::new();
    let begin = Instant::now();
    let every = (case.steps / MOMENTS).max(1);
    while moments.len() < MOMENTS as usize && (moments.is_empty() || begin.elapsed().as_secs_f64() < seconds) {
        simulation.advance(every, &mut Watch::none())?;
        let particles = simulation.particles()?;
        let places: Vec<Vec3> = particles.positions.iter().map(|p| p.as_vec3()).collect();
        let grid = UniformGrid::build(&places, &GridSettings::for_radius(reach))?;
        let counts = grid.count(&FixedRadius::new(reach))?;
        let counts = counts.as_slice();
        let total = counts.iter().map(|&count| u64::from(count)).sum();
        let most = counts.iter().copied().max().unwrap_or(0);
        moments.push(Moment { step: simulation.step(), particles, places, total, most });
    }
    Ok(moments)
}

struct Search<'a> {
    gpu: &'a Gpu,
    plan: GpuShiftedSort,
    bounds: Aabb,
}

impl Search<'_> {
    /// Median milliseconds of the search, its rows left on the device.
    fn milliseconds(&self, points: &Buffer<[f32; 4]>) -> Result<f64> {
        let mut times = Vec::with_capacity(REPEATS);
        for repeat in 0..=REPEATS {
            let start = Instant::now();
            drop(self.plan.run(points, &self.bounds, Asks::Points { without_self: false })?);
            if repeat > 0 {
                times.push(start.elapsed().as_secs_f64() * 1e3);
            }
        }
        Ok(median(&times))
    }

    /// Points of all rows within the reach.
    fn found_within(&self, points: &Buffer<[f32; 4]>, reach: f32) -> Result<u64> {
        let rows = self.plan.run(points, &self.bounds, Asks::Points { without_self: false })?;
        let dist2 = self.gpu.read(&rows.dist2)?;
        Ok(dist2.iter().filter(|&&d2| d2 <= reach * reach).count() as u64)
    }
}

/// Milliseconds of a step but for the search: forces from lists, motion and reports, as the verlet search makes a step while its list
/// is good.
fn rest_of_step(lab: &Lab, case: &Case, particles: &Particles) -> Result<f64> {
    let mut scene = case.scene.clone();
    scene.particles.clone_from(particles);
    let way = Way { search: ParticleSearch::Verlet { skin: ParticleSearch::SKIN }, on_gpu: true };
    let times = timing::each_step(lab, way, &scene, (REPEATS as u32 + 2, 0), f64::INFINITY)?;
    // The first step makes the list.
    let good: Vec<f64> = times[1..].iter().filter(|time| time.rebuilds == 0).map(|time| time.milliseconds).collect();
    let any: Vec<f64> = times.iter().map(|time| time.milliseconds).collect();
    Ok(median(if good.is_empty() { &any } else { &good }))
}
