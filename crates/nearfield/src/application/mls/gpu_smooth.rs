//! Smoothing on a device: the points, the tree that follows them and their normals stay there.

use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;

use super::MlsReport;
use super::bilateral;
use super::cpu::{self, KeptSupport};
use super::gpu::{DeviceFits, Ending, MlsPoints, PointPlace, Searches, add_device_stages};
use super::settings::{MlsMethod, MlsSettings, Support};
use crate::Result;
use crate::application::PointFlags;
use crate::gpu::{Access, Buffer, Gpu, Kernel, Pipeline, Workgroups};
use crate::parallel::reduce;
use crate::query::{Knn, Stage};
use crate::structure::{AabbTreeSettings, BuildOrder, GpuMovingPoints, GpuStructure, RebuildPolicy};

const WORKGROUP: u32 = 64;

/// [`super::MlsSmoothing`] on a device, in f32. Positions agree with those of the CPU but for rounding.
///
/// In every iteration the points are fitted, moved, and the tree refitted on the device; the host reads the sums of the report. Under
/// [`Support::Nearest`] the k nearest of all points stand in device memory while their radii are taken from them, and the radii are
/// read.
pub struct GpuMlsSmoothing {
    particles: GpuMovingPoints,
    fits: DeviceFits,
    support: DeviceSupport,
    kth_distance: Arc<Pipeline>,
    center: Vec3,
    oriented: bool,
    iterations: u32,
}

/// A support on the device.
pub(super) enum DeviceSupport {
    One(f32),
    Each { radii: Buffer<f32>, largest: f32 },
    Nearest(u32),
}

impl DeviceSupport {
    pub(super) fn of(gpu: &Gpu, support: &KeptSupport<f32>) -> Result<Self> {
        Ok(match support {
            KeptSupport::Radius(radius) => Self::One(*radius),
            KeptSupport::OfPoints { largest, .. } => Self::One(*largest),
            KeptSupport::OfQueries(radii) => {
                let largest = radii.iter().copied().fold(0.0, f32::max);
                Self::Each { radii: gpu.upload("radii of points", radii)?, largest }
            }
            KeptSupport::Nearest(k) => Self::Nearest(*k),
        })
    }
}

impl GpuMlsSmoothing {
    /// Over these points, with a tree along the Hilbert curve that is refitted in every iteration and never built anew.
    ///
    /// Normals and supports are as for [`super::MlsSmoothing::new`].
    ///
    /// # Errors
    /// As [`super::MlsSmoothing::new`]; `OutOfDeviceMemory`, `DeviceLost`, `KernelRejected`.
    pub fn new(
        gpu: &Gpu,
        points: &[Vec3],
        normals: Option<&[Vec3]>,
        support: &Support<'_, f32>,
        settings: &MlsSettings,
    ) -> Result<Self> {
        settings.validate()?;
        support.validate(points.len(), points.len())?;
        let radius = match KeptSupport::of(support) {
            KeptSupport::Radius(radius) => radius,
            KeptSupport::OfPoints { largest, .. } => largest,
            KeptSupport::OfQueries(radii) => radii.iter().copied().fold(0.0, f32::max),
            KeptSupport::Nearest(_) => 0.0,
        };
        let tree = AabbTreeSettings::DEFAULT.order(BuildOrder::Hilbert);
        let particles = GpuMovingPoints::new(gpu, points, radius, &tree, RebuildPolicy::Never)?;
        Self::over(particles, normals, support, settings)
    }

    /// Over points that have a tree already, with its search and its policy of building anew.
    ///
    /// # Errors
    /// As [`GpuMlsSmoothing::new`].
    pub fn over(
        particles: GpuMovingPoints,
        normals: Option<&[Vec3]>,
        support: &Support<'_, f32>,
        settings: &MlsSettings,
    ) -> Result<Self> {
        settings.validate()?;
        let points = particles.positions()?;
        support.validate(points.len(), points.len())?;
        let normals: Option<Vec<[f32; 3]>> = normals.map(|normals| normals.iter().map(|n| n.to_array()).collect());
        let normals = cpu::unit_normals(&settings.method, normals.as_deref(), points.len())?;
        let kept = KeptSupport::of(support);
        let place = |(i, &at): (usize, &Vec3)| {
            let normal = normals.as_ref().map_or(Vec3::ZERO, |normals| Vec3::from_array(normals[i]));
            let is_invalid = settings.method.needs_normals() && normal == Vec3::ZERO;
            let (done, flags) = if is_invalid { (1, PointFlags::INVALID.0) } else { (0, 0) };
            PointPlace { origin: at, done, at, flags, normal, curvature: 0.0 }
        };
        let places: Vec<PointPlace> = points.iter().enumerate().map(place).collect();
        let gpu = particles.tree().gpu().clone();
        let samples = (points.len(), normals.as_deref(), kept.own_radii());
        let queries = gpu.buffer("places that fits look around", points.len())?;
        let constants = &[("WORKGROUP", f64::from(WORKGROUP))];
        let accesses = [Access::Read, Access::ReadWrite];
        let kernel = Kernel {
            constants,
            ..Kernel::new("package::application::mls::kth_distance", "kth_distance", &accesses, WORKGROUP)
        };
        let bounds = reduce::bounds(&points);
        Ok(Self {
            fits: DeviceFits::new(&gpu, settings, &places, samples, queries)?,
            support: DeviceSupport::of(&gpu, &kept)?,
            kth_distance: gpu.prepare(&kernel)?,
            center: if bounds.is_empty() { Vec3::ZERO } else { 0.5 * bounds.min + 0.5 * bounds.max },
            oriented: normals.is_some(),
            particles,
            iterations: 0,
        })
    }

    /// Moves every point once; the tree follows.
    ///
    /// # Errors
    /// `Unsupported` where the device would end the loops of the search; `NonFinite` and `CoordinateTooLarge` never but for faults of
    /// a device; `OutOfDeviceMemory`, `DeviceLost`. The points are then as they were, or all moved.
    pub fn iterate(&mut self) -> Result<MlsReport> {
        let (start, mut stages) = (Instant::now(), Vec::new());
        let gpu = self.particles.tree().gpu().clone();
        let nearest = match self.support {
            DeviceSupport::Nearest(k) => Some(self.nearest_radii(k, &mut stages)?),
            _ => None,
        };
        let tree = self.particles.tree();
        let mut commands = gpu.commands("begin an iteration");
        commands.copy(tree.points(), &self.fits.queries);
        commands.submit()?;
        let searches = match (&self.support, &nearest) {
            (DeviceSupport::One(radius), _) => Searches { radius: *radius, radii: None, falloff: 0.0 },
            (DeviceSupport::Each { radii, largest }, _) => {
                Searches { radius: *largest, radii: Some(radii), falloff: 0.0 }
            }
            (DeviceSupport::Nearest(_), Some((radii, largest))) => {
                let is_bilateral = matches!(self.fits.settings().method, MlsMethod::Bilateral { .. });
                let falloff = if is_bilateral { largest * bilateral::FALLOFF as f32 } else { 0.0 };
                Searches { radius: *largest, radii: Some(radii), falloff }
            }
            (DeviceSupport::Nearest(_), None) => unreachable!("radii of the nearest should have been found"),
        };
        self.fits.fit(tree, searches, &mut stages)?;
        let sums = self.fits.conclude(Ending { center: self.center, arrival: None }, &mut stages)?;
        let updated = self.particles.update_on_device(&self.fits.moved)?;
        stages.extend(updated.stages.iter().map(Stage::from));
        self.iterations += 1;
        Ok(sums.report(self.iterations, self.oriented, stages, start.elapsed().as_secs_f64() * 1e3))
    }

    /// The distance of the k-th nearest of each point, and the largest of them.
    fn nearest_radii(&self, k: u32, stages: &mut Vec<Stage>) -> Result<(Buffer<f32>, f32)> {
        let start = Instant::now();
        let tree = self.particles.tree();
        let gpu = tree.gpu();
        let rows = tree.knn_on_device(&Knn::new(k).exclude_self())?;
        let radii = gpu.buffer("distances of the k-th nearest", tree.len())?;
        if rows.places == 0 {
            return Ok((gpu.upload("distances of the k-th nearest", &vec![0.0; tree.len()])?, 0.0));
        }
        let mut commands = gpu.commands("distances of the k-th nearest");
        let binds = [(&rows.dist2).into(), (&radii).into()];
        commands.dispatch(&self.kth_distance, &binds, Workgroups::Covering(tree.len() as u64));
        add_device_stages(stages, &commands.run()?);
        let largest = gpu.read(&radii)?.into_iter().fold(0.0, f32::max);
        stages.push(Stage::on_host("nearest", start));
        Ok((radii, largest))
    }

    /// The points as they are now with their normals and flags, read back.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn points(&self) -> Result<MlsPoints> {
        Ok(MlsPoints::of(&self.fits.read()?, &self.fits.settings().method))
    }

    /// The points and the tree that follows them.
    pub fn particles(&self) -> &GpuMovingPoints {
        &self.particles
    }
}
