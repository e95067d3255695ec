//! A simulation as it is between two steps, in a file from which it goes on.

#[cfg(feature = "io")]
use std::path::Path;

#[cfg(feature = "io")]
use glam::DVec3;

use super::{Particles, Simulate};
#[cfg(feature = "io")]
use crate::Error;
use crate::Result;
#[cfg(feature = "io")]
use crate::error::{FileError, Place};
#[cfg(feature = "io")]
use crate::io::{NpyArray, read_npz_list, read_npz_vectors, with_path, write_atomically, write_npz};

/// A simulation between two steps.
///
/// On the CPU a simulation that goes on from one makes the same steps, bit by bit, as one that was never interrupted, where the search has
/// no memory of earlier steps (brute force and grids) or sums are deterministic.
#[derive(Debug, Clone, PartialEq)]
pub struct Checkpoint {
    /// The particles by their index in the scene.
    pub particles: Particles,
    /// `[n]` the indices in the order in which the simulation keeps them: sums depend on it in their last bits.
    pub order: Vec<u32>,
    /// Steps made.
    pub step: u64,
    /// Time that has passed in the scene.
    pub time: f64,
}

impl Checkpoint {
    /// Of a simulation as it is now.
    ///
    /// # Errors
    /// As [`Simulate::particles`].
    pub fn of(simulation: &dyn Simulate) -> Result<Self> {
        Ok(Self {
            particles: simulation.particles()?,
            order: simulation.order()?,
            step: simulation.step(),
            time: simulation.time(),
        })
    }

    /// Makes a simulation of the same scene go on from here.
    ///
    /// # Errors
    /// As [`Simulate::resume_in_order`].
    pub fn resume(&self, simulation: &mut dyn Simulate) -> Result<()> {
        simulation.resume_in_order(&self.particles, &self.order, self.step, self.time)
    }

    /// Writes it as NPZ: `positions` and `velocities` (f64, [n, 3]), `classes` (u8), `densities` and `pressures` (f64, where there are any),
    /// `order` (u32), `step` (u64, `[1]`) and `time` (f64, `[1]`). The file is there whole or as it was before.
    ///
    /// # Errors
    /// `Io` with the path, where the file exists and `force` is not set too.
    #[cfg(feature = "io")]
    pub fn write(&self, path: &Path, force: bool) -> Result<()> {
        let (step, time) = ([self.step], [self.time]);
        let mut arrays = vec![
            ("positions", NpyArray::F64x3(&self.particles.positions)),
            ("velocities", NpyArray::F64x3(&self.particles.velocities)),
            ("classes", NpyArray::U8(&self.particles.classes)),
        ];
        if !self.particles.densities.is_empty() {
            arrays.push(("densities", NpyArray::F64(&self.particles.densities)));
        }
        if !self.particles.pressures.is_empty() {
            arrays.push(("pressures", NpyArray::F64(&self.particles.pressures)));
        }
        let last =
            [("order", NpyArray::U32(&self.order)), ("step", NpyArray::U64(&step)), ("time", NpyArray::F64(&time))];
        arrays.extend(last);
        write_atomically(path, force, |w| write_npz(&arrays, w))
    }

    /// Reads what [`Checkpoint::write`] wrote.
    ///
    /// # Errors
    /// `Io` and `File` with the path.
    #[cfg(feature = "io")]
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.to_owned(), source })?;
        Self::parse(&bytes).map_err(|error| with_path(error, path))
    }

    /// As [`Checkpoint::read`], from the bytes of a file.
    ///
    /// # Errors
    /// `File` for arrays that are missing, of another shape, or with numbers that cannot be.
    #[cfg(feature = "io")]
    pub fn parse(bytes: &[u8]) -> Result<Self> {
        let needed = |name: &'static str| {
            let list = read_npz_list(bytes, name)?;
            list.ok_or_else(|| fault(format!("no array {name:?}"), "a checkpoint of a simulation"))
        };
        let vectors = |name: &'static str| {
            let vectors = read_npz_vectors(bytes, name)?;
            vectors.ok_or_else(|| fault(format!("no array {name:?}"), "a checkpoint of a simulation"))
        };
        let (positions, velocities): (Vec<DVec3>, Vec<DVec3>) = (vectors("positions")?, vectors("velocities")?);
        let n = positions.len();
        let classes: Vec<u8> = whole("classes", &needed("classes")?, 255.0)?.into_iter().map(|v| v as u8).collect();
        let densities = read_npz_list(bytes, "densities")?.unwrap_or_default();
        let pressures = read_npz_list(bytes, "pressures")?.unwrap_or_default();
        let most = (n as f64 - 1.0).max(0.0);
        let order: Vec<u32> = whole("order", &needed("order")?, most)?.into_iter().map(|v| v as u32).collect();
        let lengths = [("velocities", velocities.len()), ("classes", classes.len()), ("order", order.len())];
        let optional = [("densities", densities.len()), ("pressures", pressures.len())];
        let optional = optional.into_iter().filter(|&(_, length)| length > 0);
        let other = lengths.into_iter().chain(optional).find(|&(_, length)| length != n);
        if let Some((name, length)) = other {
            return Err(fault(format!("{length} {name} of {n} particles"), "arrays of one length"));
        }
        // Beyond 2⁵³ numbers of steps would not be exact; no simulation comes near.
        let steps = whole("step", &needed("step")?, 9e15)?;
        let times = needed("time")?;
        let (&[step], &[time]) = (&steps[..], &times[..]) else {
            return Err(fault(format!("{} steps and {} times", steps.len(), times.len()), "one of each"));
        };
        if !(time.is_finite() && time >= 0.0) {
            return Err(fault(format!("time {time}"), "a finite time, 0 or more"));
        }
        let particles = Particles { positions, velocities, classes, densities, pressures };
        Ok(Self { particles, order, step, time })
    }
}

/// Numbers that should be whole and not above a limit.
#[cfg(feature = "io")]
fn whole(name: &'static str, values: &[f64], most: f64) -> Result<Vec<u64>> {
    match values.iter().find(|value| !(**value >= 0.0 && **value <= most && value.fract() == 0.0)) {
        Some(value) => Err(fault(format!("{value} among {name:?}"), "whole numbers within their range")),
        None => Ok(values.iter().map(|&value| value as u64).collect()),
    }
}

#[cfg(feature = "io")]
fn fault(found: String, expected: &'static str) -> Error {
    FileError::new("checkpoint", Place::Whole, found, expected).into()
}
