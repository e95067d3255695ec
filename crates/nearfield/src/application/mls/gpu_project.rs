//! Projecting on a device, over any structure that is there.

use std::time::Instant;

use glam::Vec3;

use super::MlsReport;
use super::bilateral;
use super::cpu::{self, KeptSupport};
use super::gpu::{DeviceFits, Ending, MlsPoints, PointPlace, Searches};
use super::gpu_smooth::DeviceSupport;
use super::project::accuracy;
use super::settings::{MlsMethod, MlsSettings, Support};
use crate::Result;
use crate::application::{PointFlags, Watch};
use crate::geometry::validate::MAX_COORDINATE;
use crate::structure::{AabbTreeN, AabbTreeNSettings, GpuStructure};

/// [`super::MlsProjection`] on a device, in f32. Positions agree with those of the CPU but for rounding.
///
/// The points of the structure are read back once, for the spacing that the accuracy is measured in. With [`Support::Nearest`] the queries are
/// read back for each step, and the distances of their k-th nearest are found on the CPU.
pub struct GpuMlsProjection<'a, S> {
    structure: &'a S,
    fits: DeviceFits,
    support: DeviceSupport,
    /// What the k nearest are found by, and k.
    nearest: Option<(AabbTreeN<f32, 3>, u32)>,
    /// Radius that the bilateral weight falls over; 0 for that of the search.
    falloff: f32,
    accuracy: f32,
    center: Vec3,
    oriented: bool,
    moving: u64,
    iterations: u32,
}

impl<'a, S: GpuStructure> GpuMlsProjection<'a, S> {
    /// Onto the points of `structure`.
    ///
    /// Normals, queries and supports are as for [`super::MlsProjection::new`].
    ///
    /// # Errors
    /// As [`super::MlsProjection::new`]; `OutOfDeviceMemory`, `DeviceLost`, `KernelRejected`.
    pub fn new(
        structure: &'a S,
        normals: Option<&[Vec3]>,
        queries: &[Vec3],
        support: &Support<'_, f32>,
        settings: &MlsSettings,
    ) -> Result<Self> {
        settings.validate()?;
        support.validate(queries.len(), structure.len())?;
        let normals: Option<Vec<[f32; 3]>> = normals.map(|normals| normals.iter().map(|n| n.to_array()).collect());
        let normals = cpu::unit_normals(&settings.method, normals.as_deref(), structure.len())?;
        let (gpu, kept) = (structure.gpu(), KeptSupport::of(support));
        let points: Vec<[f32; 3]> = gpu.read(structure.points())?.iter().map(|p| [p[0], p[1], p[2]]).collect();
        let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default())?;
        let center = Vec3::from_array(cpu::center(&tree));
        let place = |&at: &Vec3| {
            let (done, flags) = if is_valid(&at) { (0, 0) } else { (1, PointFlags::INVALID.0) };
            PointPlace { origin: at, done, at, flags, ..PointPlace::default() }
        };
        let places: Vec<PointPlace> = queries.iter().map(place).collect();
        // Queries that are no place are searched for at one that is, and never moved.
        let searched: Vec<Vec3> = queries.iter().map(|&q| if is_valid(&q) { q } else { center }).collect();
        let on_device = structure.upload_queries(&searched)?;
        let k = if let KeptSupport::Nearest(k) = kept { Some(k) } else { None };
        let (kept, falloff) = match kept {
            KeptSupport::Nearest(k) => nearest(&tree, &searched, k, settings),
            other => (other, 0.0),
        };
        let samples = (structure.len(), normals.as_deref(), kept.own_radii());
        Ok(Self {
            fits: DeviceFits::new(gpu, settings, &places, samples, on_device)?,
            support: DeviceSupport::of(gpu, &kept)?,
            falloff,
            accuracy: accuracy(&settings.accuracy, &tree)? as f32,
            nearest: k.map(|k| (tree, k)),
            center,
            oriented: normals.is_some(),
            moving: places.iter().filter(|place| place.done == 0).count() as u64,
            structure,
            iterations: 0,
        })
    }

    /// Moves every point that has not arrived by one step.
    ///
    /// # Errors
    /// `Unsupported` where the device would end the loops of the search; `OutOfDeviceMemory`, `DeviceLost`.
    pub fn iterate(&mut self) -> Result<MlsReport> {
        let (start, mut stages) = (Instant::now(), Vec::new());
        if self.iterations > 0 {
            self.fits.send_to_points()?;
            self.find_nearest()?;
        }
        self.iterations += 1;
        let searches = match &self.support {
            DeviceSupport::Each { radii, largest } => {
                Searches { radius: *largest, radii: Some(radii), falloff: self.falloff }
            }
            DeviceSupport::One(radius) => Searches { radius: *radius, radii: None, falloff: 0.0 },
            DeviceSupport::Nearest(_) => unreachable!("the nearest should have been found before"),
        };
        self.fits.fit(self.structure, searches, &mut stages)?;
        let is_last = self.iterations >= self.fits.settings().most_steps;
        let ending = Ending { center: self.center, arrival: Some((self.accuracy, is_last)) };
        let sums = self.fits.conclude(ending, &mut stages)?;
        self.moving = sums.moving;
        Ok(sums.report(self.iterations, self.oriented, stages, start.elapsed().as_secs_f64() * 1e3))
    }

    /// The distances of the k-th nearest from where the queries are now.
    fn find_nearest(&mut self) -> Result<()> {
        let Some((tree, k)) = &self.nearest else { return Ok(()) };
        let at = |place: &PointPlace| if is_valid(&place.at) { place.at } else { self.center };
        let queries: Vec<Vec3> = self.fits.read()?.iter().map(at).collect();
        let (kept, falloff) = nearest(tree, &queries, *k, self.fits.settings());
        (self.support, self.falloff) = (DeviceSupport::of(self.structure.gpu(), &kept)?, falloff);
        Ok(())
    }

    /// Whether every point has arrived, could not be projected, or has taken all its steps.
    pub fn is_done(&self) -> bool {
        self.moving == 0
    }

    /// Steps until all is done.
    ///
    /// # Errors
    /// `Interrupted` where the watch ends it; the points are then where their last step led. As [`GpuMlsProjection::iterate`].
    pub fn run(&mut self, watch: &mut Watch<'_>) -> Result<Vec<MlsReport>> {
        let mut reports = Vec::new();
        while !self.is_done() {
            watch.report("projection", self.iterations.into(), self.fits.settings().most_steps.into())?;
            reports.push(self.iterate()?);
        }
        Ok(reports)
    }

    /// The points as they are now with their normals and flags, read back.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn points(&self) -> Result<MlsPoints> {
        Ok(MlsPoints::of(&self.fits.read()?, &self.fits.settings().method))
    }
}

fn is_valid(query: &Vec3) -> bool {
    query.is_finite() && query.abs().max_element() <= MAX_COORDINATE
}

/// The distances of the k-th nearest of all queries, and the radius that the bilateral weight falls over.
fn nearest(tree: &AabbTreeN<f32, 3>, queries: &[Vec3], k: u32, settings: &MlsSettings) -> (KeptSupport<f32>, f32) {
    let queries: Vec<[f32; 3]> = queries.iter().map(|q| q.to_array()).collect();
    let order: Vec<u32> = (0..queries.len() as u32).collect();
    let radii = cpu::nearest_radii(tree, &queries, &order, (k, false));
    let largest = radii.iter().copied().fold(0.0, f32::max);
    let is_bilateral = matches!(settings.method, MlsMethod::Bilateral { .. });
    (KeptSupport::OfQueries(radii), if is_bilateral { largest * bilateral::FALLOFF as f32 } else { 0.0 })
}
