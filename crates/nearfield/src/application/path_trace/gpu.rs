//! The path tracer on a device: the stages are kernels over tiles of paths that never leave it.
//!
//! A pass is a submission a tile, or a few where the structure's walks are long. Rays are cast by the structure's own kernels ([`RaysOnDevice`]); a path that has
//! ended keeps its place and casts a ray of no length.

use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;

use super::cpu::{check, pass_parameters};
use super::film::Film;
use super::generate::{PathParameters, PathState};
use super::gpu_tables::GpuTables;
use super::scene::Scene;
use super::tables::SceneTables;
use super::{PathCounters, PathSettings};
use crate::geometry::Ray;
use crate::gpu::{Access, Buffer, Gpu, Kernel, Pipeline, Workgroups};
use crate::query::{DeviceRays, HitRecord, RaysOnDevice};
use crate::structure::GpuRayStructure;
use crate::{Error, Result};

/// Most paths of a tile: some 230 bytes each, and so few that the rays of all their depths can be counted in 32 bits.
const TILE: usize = 1 << 20;
/// Invocations of a workgroup.
const WORKGROUP: u32 = 64;

/// A path tracer over a structure on a device. Scene, film and paths stay there until [`GpuPathTracer::film`].
///
/// For the same samples the picture is that of [`super::PathTracer`] but for rounding: devices may contract products and sums and
/// round quotients differently. Where a choice falls the other way by that, a path differs.
pub struct GpuPathTracer<'a, S> {
    structure: &'a S,
    scene: Scene,
    settings: PathSettings,
    tables: GpuTables,
    kernels: [Arc<Pipeline>; 3],
    tile: Tile,
    film: Buffer<[f32; 4]>,
    dropped: Buffer<u32>,
    /// Width and height of the film.
    size: [u32; 2],
    samples: u32,
    counters: PathCounters,
}

/// The paths of a tile.
struct Tile {
    len: usize,
    paths: Buffer<PathState>,
    rays: Buffer<Ray>,
    hits: Buffer<HitRecord>,
    shadows: Buffer<Ray>,
    states: Buffer<u32>,
    lights: Buffer<[f32; 4]>,
    samples: Buffer<[f32; 4]>,
    /// Rays and shadow rays of the tile, and how many of both were not followed to their end.
    totals: Buffer<u32>,
}

impl Tile {
    fn new(gpu: &Gpu, len: usize) -> Result<Self> {
        Ok(Self {
            len,
            paths: gpu.buffer("paths", len)?,
            rays: gpu.buffer("rays of paths", len)?,
            hits: gpu.buffer("hits of paths", len)?,
            shadows: gpu.buffer("shadow rays", len)?,
            states: gpu.buffer("answers to shadow rays", len)?,
            lights: gpu.buffer("light of paths", 2 * len)?,
            samples: gpu.buffer("samples", len)?,
            totals: gpu.buffer("numbers of rays", 3)?,
        })
    }
}

impl<'a, S: GpuRayStructure> GpuPathTracer<'a, S> {
    /// Over `structure`, built over the mesh of the scene, with an empty picture of `width` by `height` pixels.
    ///
    /// # Errors
    /// As [`super::PathTracer::new`]; `InvalidSetting` as [`Film::new`]; `OutOfDeviceMemory`, `DeviceLost`, `KernelRejected`.
    pub fn new(scene: Scene, structure: &'a S, settings: PathSettings, width: u32, height: u32) -> Result<Self> {
        let (gpu, prepared) = (structure.gpu(), structure.triangles());
        check(&scene, &settings, prepared)?;
        let pixels = Film::pixels(width, height)?;
        let tables = GpuTables::upload(gpu, &SceneTables::new(&scene, prepared.as_slice(), prepared.space()))?;
        let film = gpu.buffer("film", pixels)?;
        let dropped = gpu.buffer("samples left out", 1)?;
        let tile = Tile::new(gpu, pixels.min(TILE).min(structure.rays_a_submission()))?;
        let mut commands = gpu.commands("clear film");
        commands.clear(&film);
        commands.clear(&dropped);
        commands.submit()?;
        let kernels = [generate_kernel(gpu)?, shade_kernel(gpu)?, accumulate_kernel(gpu)?];
        let counters = PathCounters::default();
        Ok(Self {
            structure,
            scene,
            settings,
            tables,
            kernels,
            tile,
            film,
            dropped,
            size: [width, height],
            samples: 0,
            counters,
        })
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Samples that each pixel has.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// What all passes so far have done.
    pub fn counters(&self) -> PathCounters {
        self.counters
    }

    /// Adds one sample to every pixel, and waits for it.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`, `Device`; `Unsupported` on devices that end long loops; `TooMany` after
    /// 2³² − 1 samples. After an error the picture may hold a part of the pass.
    pub fn render_pass(&mut self) -> Result<()> {
        let start = Instant::now();
        let parameters = pass_parameters(&self.scene, &self.settings, self.size, self.samples)?;
        let pixels = self.film.len();
        let mut counters = PathCounters { paths: pixels as u64, ..PathCounters::default() };
        for first in (0..pixels).step_by(self.tile.len) {
            let n_paths = self.tile.len.min(pixels - first);
            self.trace_tile(PathParameters { first_pixel: first as u32, n_paths: n_paths as u32, ..parameters })?;
            let totals = self.structure.gpu().read(&self.tile.totals)?;
            if totals[2] > 0 {
                return Err(abandoned(self.structure, totals[2]));
            }
            counters.rays += u64::from(totals[0]);
            counters.shadow_rays += u64::from(totals[1]);
        }
        self.samples += 1;
        counters.seconds = start.elapsed().as_secs_f64();
        self.counters.add(&counters);
        Ok(())
    }

    /// The stages, one after the other, over all paths of a tile.
    fn trace_tile(&self, parameters: PathParameters) -> Result<()> {
        let (gpu, tile) = (self.structure.gpu(), &self.tile);
        let n = parameters.n_paths as usize;
        let all = || Workgroups::Covering(n as u64);
        let (rays, shadows) = (DeviceRays::first(&tile.rays, n), DeviceRays::first(&tile.shadows, n));
        let [generate, shade, accumulate] = &self.kernels;
        let most_casts = self.structure.rays_a_submission() / n.max(1);
        let mut casts = 0;
        let mut commands = gpu.commands("trace paths");
        let shared = gpu.uniform("path parameters", &parameters)?;
        let binds = [(&shared).into(), (&tile.paths).into(), (&tile.rays).into(), (&tile.samples).into()];
        commands.stage("generate").clear(&tile.totals).dispatch(generate, &binds, all());
        for depth in 0..=self.settings.depth {
            if casts > 0 && casts + 2 > most_casts {
                std::mem::replace(&mut commands, gpu.commands("trace paths")).submit()?;
                casts = 0;
            }
            casts += 2;
            let shared = gpu.uniform("path parameters", &PathParameters { depth, ..parameters })?;
            commands.stage("closest hits");
            self.structure.record_closest(&mut commands, &rays, &tile.hits)?;
            let binds = [
                (&shared).into(),
                (&self.tables.layout).into(),
                (&self.tables.quads).into(),
                (&self.tables.words).into(),
                (&tile.paths).into(),
                (&tile.hits).into(),
                (&tile.rays).into(),
                (&tile.shadows).into(),
                (&tile.lights).into(),
                (&tile.totals).into(),
            ];
            commands.stage("shade").dispatch(shade, &binds, all());
            commands.stage("any hits");
            self.structure.record_any(&mut commands, &shadows, &tile.states)?;
            let binds = [
                (&shared).into(),
                (&tile.lights).into(),
                (&tile.states).into(),
                (&tile.samples).into(),
                (&self.film).into(),
                (&self.dropped).into(),
                (&tile.totals).into(),
            ];
            commands.stage("accumulate").dispatch(accumulate, &binds, all());
        }
        commands.run().map(drop)
    }

    /// Reads the picture back.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for the staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn film(&self) -> Result<Film> {
        let gpu = self.structure.gpu();
        let mut film = Film::new(self.size[0], self.size[1])?;
        film.samples = self.samples;
        for (sum, [r, g, b, _]) in film.sums.iter_mut().zip(gpu.read(&self.film)?) {
            *sum = Vec3::new(r, g, b);
        }
        film.dropped = u64::from(gpu.read(&self.dropped)?[0]);
        Ok(film)
    }
}

/// The error for a pass with rays that a software device did not follow to their end.
fn abandoned<S: GpuRayStructure>(structure: &S, rays: u32) -> Error {
    Error::Unsupported {
        what: format!(
            "tracing paths through {} triangles by {} on {}, which ended the loops of {rays} rays before their end,",
            structure.triangles().len(),
            S::NAME,
            structure.gpu().name()
        ),
        advice: "use the CPU, or a structure that looks at fewer triangles",
    }
}

use Access::{Read, ReadWrite, Uniform};

fn pipeline(gpu: &Gpu, module: &'static str, entry: &'static str, bindings: &[Access]) -> Result<Arc<Pipeline>> {
    let constants = &[("WORKGROUP", f64::from(WORKGROUP))];
    gpu.prepare(&Kernel { constants, ..Kernel::new(module, entry, bindings, WORKGROUP) })
}

fn generate_kernel(gpu: &Gpu) -> Result<Arc<Pipeline>> {
    let bindings = [Uniform, ReadWrite, ReadWrite, ReadWrite];
    pipeline(gpu, "package::application::path_trace::generate", "generate_rays", &bindings)
}

fn shade_kernel(gpu: &Gpu) -> Result<Arc<Pipeline>> {
    let bindings = [Uniform, Uniform, Read, Read, ReadWrite, Read, ReadWrite, ReadWrite, ReadWrite, ReadWrite];
    pipeline(gpu, "package::application::path_trace::shade", "shade_hits", &bindings)
}

fn accumulate_kernel(gpu: &Gpu) -> Result<Arc<Pipeline>> {
    let bindings = [Uniform, Read, Read, ReadWrite, ReadWrite, ReadWrite, ReadWrite];
    pipeline(gpu, "package::application::path_trace::accumulate", "accumulate_light", &bindings)
}
