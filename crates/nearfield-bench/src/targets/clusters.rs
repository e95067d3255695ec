//! Density-based clusters, with copies to the device and back.

use nearfield::application::{DbscanSettings, Watch, dbscan, dbscan_on_gpu};

use super::bench::Bench;
use super::row::{Figure, Outcome};
use crate::Result;
use crate::everyday::{agree, clustered, eps_for};
use crate::measure::repeat;

/// Mean points within eps that are aimed at, and the fewest of a core point.
const MEAN: f64 = 10.0;
const MIN_POINTS: u32 = 10;

/// Points in host memory to labels there; labels and core points must be those of the CPU.
pub(super) fn dbscan_of(bench: &mut Bench, set: &str) -> Result<Outcome> {
    let (points, gpu, effort) = (bench.set(set)?, bench.gpu.clone(), bench.short_effort());
    let arrays: Vec<[f32; 3]> = points.points.iter().map(|p| p.to_array()).collect();
    let (eps, mean) = eps_for(&points.set, &arrays, MEAN)?;
    let settings = DbscanSettings::new(eps, MIN_POINTS);
    let (there, measured) =
        repeat(effort, || clustered(dbscan_on_gpu(&gpu, &points.points, &settings, &mut Watch::none())))?;
    let [labels, cores] = agree(&there, &dbscan(&arrays, &settings, &mut Watch::none())?)?;
    let note = format!(
        "eps {eps:.5}, {MIN_POINTS} points, {} clusters; {labels} labels and {cores} core points differ from the CPU's",
        there.n_clusters
    );
    Ok(Outcome::of(mean, vec![Figure::by_host("", &measured).note(note)]))
}
