//! Distance fields of oriented samples on either device: their times, and whether their values are right.

use std::time::Instant;

use nearfield::application::{
    DistanceField, DistanceMode, DistanceSettings, GpuOrientedSamples, OrientedSamples, Watch,
};
use nearfield::gpu::Gpu;
use nearfield::{RegularGrid, Vec3};
use rayon::prelude::*;

use crate::Result;
use crate::measure::{Effort, repeat};
use crate::paper::measured::device_milliseconds;
use nearfield::query::{Clock, Stage};

/// Nodes whose values are checked.
const CHECKED: usize = 200;
/// How far a value in f32 may be from that in f64, in widths; beyond it at most one of the checked nodes.
const OFF: f64 = 2e-3;

/// Samples with their normals.
#[derive(Clone, Copy)]
pub struct Samples<'a> {
    /// `[n]`.
    pub points: &'a [Vec3],
    /// `[n]` pointing out.
    pub normals: &'a [Vec3],
}

/// A field and the milliseconds it took.
pub struct Timed {
    /// The values, on the host.
    pub field: DistanceField,
    /// The field alone, its samples in their structure already, the values left on the device.
    pub field_ms: f64,
    /// That by the device's clock.
    pub device_ms: Option<f64>,
    /// From samples in host memory to values there.
    pub total_ms: f64,
    /// Timed runs.
    pub runs: usize,
}

impl Samples<'_> {
    fn arrays(vectors: &[Vec3]) -> Vec<[f32; 3]> {
        vectors.iter().map(Vec3::to_array).collect()
    }

    /// Once on the CPU.
    ///
    /// # Errors
    /// As the field.
    pub fn field_on_cpu(&self, grid: &RegularGrid, settings: &DistanceSettings) -> Result<Timed> {
        let begin = Instant::now();
        let samples = OrientedSamples::new(&Self::arrays(self.points), &Self::arrays(self.normals))?;
        let start = Instant::now();
        let field = samples.distance_field(grid, settings, &mut Watch::none())?;
        let [field_ms, total_ms] = [start, begin].map(|clock| 1e3 * clock.elapsed().as_secs_f64());
        Ok(Timed { field, field_ms, device_ms: None, total_ms, runs: 1 })
    }

    /// On the GPU, as often as the effort says.
    ///
    /// # Errors
    /// As the field.
    pub fn field_on_gpu(
        &self,
        gpu: &Gpu,
        grid: &RegularGrid,
        settings: &DistanceSettings,
        effort: Effort,
    ) -> Result<Timed> {
        let (distances, whole) = repeat(effort, || {
            let samples = GpuOrientedSamples::build(gpu, self.points, self.normals)?;
            Ok((samples.distances(grid, settings)?, Vec::new()))
        })?;
        let samples = GpuOrientedSamples::build(gpu, self.points, self.normals)?;
        let (left, alone) = repeat(effort, || {
            let field = samples.distance_field(grid, settings)?;
            let timed = field.stages().iter().filter_map(|stage| {
                Some(Stage { name: stage.name, milliseconds: stage.milliseconds?, clock: Clock::Device })
            });
            let stages = timed.collect();
            Ok((field, stages))
        })?;
        // With the nearest samples, by which values are checked.
        let field = left.read()?;
        let pairs = distances.values().iter().zip(field.distances.values());
        if pairs.into_iter().any(|(a, b)| a.to_bits() != b.to_bits()) {
            return Err("wrong answer: two runs gave different fields".into());
        }
        Ok(Timed {
            field,
            field_ms: alone.wall.median,
            device_ms: device_milliseconds(&alone.stages),
            total_ms: whole.wall.median,
            runs: alone.runs,
        })
    }

    /// Mean number of samples within the band of a node that has a value, by some of the nodes.
    pub fn mean_neighbors(&self, field: &DistanceField, settings: &DistanceSettings) -> f64 {
        let grid = field.distances.grid();
        let radius2 = settings.radius(grid).powi(2);
        let places: Vec<Vec3> = defined(field).map(|number| place(grid, number)).collect();
        let within = |at: &Vec3| {
            let near = self.points.iter().filter(|p| p.as_dvec3().distance_squared(at.as_dvec3()) <= radius2);
            near.count() as f64
        };
        places.par_iter().map(within).sum::<f64>() / places.len().max(1) as f64
    }

    /// Checks some values: the nearest sample by a loop over all, and what the mode makes of it in f64.
    ///
    /// # Errors
    /// The first node whose nearest sample is another; more than one node with another value.
    pub fn check(&self, field: &DistanceField, settings: &DistanceSettings) -> Result<&'static str> {
        let wide = |vectors: &[Vec3]| vectors.iter().map(|v| v.as_dvec3().to_array()).collect::<Vec<[f64; 3]>>();
        let exact = OrientedSamples::new(&wide(self.points), &wide(self.normals))?;
        let grid = field.distances.grid();
        let (radius, width) = (settings.radius(grid), f64::from(grid.spacing()));
        let step = grid.n_nodes().div_ceil(CHECKED).max(1);
        let numbers: Vec<usize> = (0..grid.n_nodes()).step_by(step).chain(defined(field)).collect();
        let off = |&number: &usize| -> Result<usize> {
            let at = place(grid, number).as_dvec3();
            let dist2 = |i: usize| self.points[i].as_dvec3().distance_squared(at);
            let least = (0..self.points.len()).map(dist2).fold(f64::INFINITY, f64::min).sqrt();
            let (found, value) = (field.nearest[number], f64::from(field.distances.values()[number]));
            let slack = 1e-5 * width;
            if found == DistanceField::NONE {
                return match least > radius - slack && value.is_nan() {
                    true => Ok(0),
                    false => {
                        Err(format!("wrong answer: node {number} has no value, and a sample is {least} away").into())
                    }
                };
            }
            let its = dist2(found as usize).sqrt();
            if its > least + slack || its > radius + slack {
                return Err(
                    format!("wrong answer: node {number} has a sample at {its}, the nearest is at {least}").into()
                );
            }
            let Some((expected, _)) = exact.distance(&at.to_array(), radius + slack, settings.mode, settings.smoothing)
            else {
                return Err(format!("wrong answer: node {number} has a value outside of the band").into());
            };
            // Samples that are as near may have other planes.
            Ok(usize::from(!((value - expected).abs() <= OFF * width)))
        };
        let off: usize = numbers.par_iter().map(off).collect::<Result<Vec<usize>>>()?.into_iter().sum();
        let most = 1 + numbers.len() / 100;
        if off > most {
            return Err(format!("wrong answer: {off} of {} values are not those in f64", numbers.len()).into());
        }
        Ok("400 nodes checked: the nearest by brute force, the value in f64")
    }
}

/// Some of the nodes that have a value, evenly spread.
fn defined(field: &DistanceField) -> impl Iterator<Item = usize> + '_ {
    let step = field.n_defined().div_ceil(CHECKED).max(1);
    let has_value = |&(_, &index): &(usize, &u32)| index != DistanceField::NONE;
    field.nearest.iter().enumerate().filter(has_value).map(|(number, _)| number).step_by(step)
}

/// The place of a node.
pub fn place(grid: &RegularGrid, number: usize) -> Vec3 {
    grid.position(grid.node(number).expect("the number should be below that of nodes"))
}

/// All modes, the paper's first.
pub const MODES: [DistanceMode; 4] = DistanceMode::ALL;

#[cfg(test)]
mod tests {
    use nearfield::application::grid_around;
    use nearfield::geometry::generate::{MeshKind, mesh, surface_samples};

    use super::*;

    #[test]
    fn right_values_pass_and_planted_ones_are_caught() {
        let ball = mesh(MeshKind::Icosphere, 1280, 0);
        let cloud = surface_samples(&ball, 3000, 1);
        let normals = cloud.normals.clone().expect("normals");
        let samples = Samples { points: &cloud.points, normals: &normals };
        let grid = grid_around(ball.origin, &ball.bounds(), 25, 4.0).expect("a grid");
        for mode in MODES {
            let settings = DistanceSettings::default().mode(mode);
            let timed = samples.field_on_cpu(&grid, &settings).expect("a field");
            samples.check(&timed.field, &settings).expect("right values");
            assert!(samples.mean_neighbors(&timed.field, &settings) > 5.0);
            let mut planted = timed.field.clone();
            planted.distances.values_mut().iter_mut().for_each(|value| *value = -*value);
            assert!(samples.check(&planted, &settings).is_err(), "{mode}: turned signs");
            let mut planted = timed.field;
            planted.nearest.iter_mut().filter(|index| **index < 2999).for_each(|index| *index += 1);
            assert!(samples.check(&planted, &settings).is_err(), "{mode}: other samples");
        }
    }
}
