//! One method over some steps of moving points, its last answer checked.

use std::collections::HashMap;
use std::time::Instant;

use nearfield::Vec3;
use nearfield::query::{Clock, Stage};

use super::lab::Lab;
use super::methods::{Judged, Plug, Positions, Start};
use super::motion::Motion;
use crate::Result;
use crate::check::Expected;

/// Times of some steps.
pub struct Steps {
    /// Mean milliseconds of an update and a query together.
    pub milliseconds: f64,
    /// Mean milliseconds of the updates.
    pub update: f64,
    /// Mean milliseconds by the device's clock; `None` where it has none.
    pub device: Option<f64>,
    /// Steps that were made.
    pub steps: usize,
    /// Steps in which the structure was built anew.
    pub rebuilds: usize,
    /// Of the lists of the last step.
    pub judged: Judged,
    /// Of the last step.
    pub mean_neighbors: f64,
}

/// References of one number of points and radius, by how the points have moved and how often.
#[derive(Default)]
pub struct References {
    by_step: HashMap<String, Expected>,
}

impl References {
    /// The reference for points that have moved so often.
    ///
    /// # Errors
    /// As [`Expected::of`].
    pub fn after(&mut self, (motion, step): (Motion, usize), points: &[Vec3], radius: f32) -> Result<&Expected> {
        let key = if step == 0 { String::new() } else { format!("{motion:?} {step}") };
        if !self.by_step.contains_key(&key) {
            self.by_step.insert(key.clone(), Expected::of(points, radius)?);
        }
        Ok(&self.by_step[&key])
    }
}

/// Sum of the stages by the device's clock.
pub fn device_milliseconds(stages: &[Stage]) -> Option<f64> {
    let on_device = || stages.iter().filter(|stage| stage.clock == Clock::Device);
    (on_device().count() > 0).then(|| on_device().map(|stage| stage.milliseconds).sum())
}

/// Moves the points, updates and lists, up to `most_steps` times and for about `seconds`.
///
/// The first step, in which pipelines are made, is not timed and its movement not counted.
///
/// # Errors
/// What the method returns; a wrong answer.
pub fn run_steps(
    lab: &Lab,
    plug: &Plug,
    (points, radius): (&[Vec3], f32),
    motion: Motion,
    (most_steps, seconds): (usize, f64),
    references: &mut References,
) -> Result<Steps> {
    let gpu = lab.gpu().filter(|_| plug.on_gpu);
    let mut at = Positions::new(gpu, points.to_vec())?;
    let mean_neighbors = references.after((motion, 0), points, radius)?.mean();
    let mut method = (plug.make)(&Start { gpu, at: &at, radius, mean_neighbors })?;
    drop(method.list(radius)?);
    let (mut total, mut updating, mut on_device, mut rebuilds, mut steps) = (0.0, 0.0, Some(0.0), 0, 0);
    let begin = Instant::now();
    let last = loop {
        let mut moved = std::mem::take(&mut at.host);
        motion.apply(&mut moved, steps as u64);
        at = Positions::new(gpu, moved)?;
        let start = Instant::now();
        let update = method.update(&at)?;
        updating += start.elapsed().as_secs_f64();
        let found = method.list(radius)?;
        total += start.elapsed().as_secs_f64();
        steps += 1;
        rebuilds += usize::from(update.rebuilt);
        let device = device_milliseconds(&[&update.stages[..], found.stages()].concat());
        on_device = on_device.zip(device).map(|(sum, one)| sum + one);
        if steps >= most_steps || begin.elapsed().as_secs_f64() > seconds {
            break found;
        }
    };
    let expected = references.after((motion, steps), &at.host, radius)?;
    let judged = last.check(gpu, expected)?;
    let mean = |sum: f64| sum / steps as f64;
    Ok(Steps {
        milliseconds: 1e3 * mean(total),
        update: 1e3 * mean(updating),
        device: on_device.map(mean),
        steps,
        rebuilds,
        judged,
        mean_neighbors: expected.mean(),
    })
}
