//! The path tracer on the CPU: the stages run over tiles of paths, and the rays of a stage are cast as one batch.

use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;

use super::camera::CameraFrame;
use super::film::Film;
use super::generate::{PathParameters, PathState, generate};
use super::scene::Scene;
use super::shade::{Shaded, shade};
use super::tables::SceneTables;
use super::{PathCounters, PathSettings};
use crate::geometry::Ray;
use crate::query::RaySearch;
use crate::structure::PreparedTriangles;
use crate::{Error, Result};

/// Paths of a tile: enough rays for every thread in each batch, and the states of all of them (some 200 bytes each)
/// stay in the cache.
const TILE: usize = 1 << 15;
/// Least number of paths that a thread takes.
const CHUNK: usize = 256;

/// A path tracer over any structure on any device: rays are cast by `search`, everything else runs on the CPU.
///
/// A picture depends on scene, settings, size and number of samples alone, not on the number of threads, nor on the
/// structure where it names the same triangles.
pub struct PathTracer<'a> {
    search: &'a dyn RaySearch,
    scene: Scene,
    tables: SceneTables,
    settings: PathSettings,
    counters: PathCounters,
}

impl<'a> PathTracer<'a> {
    /// Over `search`, a structure built over the mesh of the scene.
    ///
    /// # Errors
    /// As [`Scene::check`] and [`PathSettings::check`]; `LengthMismatch` where the structure has another number of triangles.
    pub fn new(scene: Scene, search: &'a dyn RaySearch, settings: PathSettings) -> Result<Self> {
        let prepared = search.prepared();
        check(&scene, &settings, prepared)?;
        let tables = SceneTables::new(&scene, prepared.as_slice(), prepared.space());
        Ok(Self { search, scene, tables, settings, counters: PathCounters::default() })
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The settings.
    pub fn settings(&self) -> &PathSettings {
        &self.settings
    }

    /// What all passes so far have done.
    pub fn counters(&self) -> PathCounters {
        self.counters
    }

    /// Bytes of the scene's tables, the structure not included.
    pub fn memory_bytes(&self) -> u64 {
        self.tables.memory_bytes()
    }

    /// Adds one sample to every pixel of the film. A film that this call fails on stays as it was.
    ///
    /// # Errors
    /// As [`RaySearch::closest_hits`]; `TooMany` after 2³² − 1 samples.
    pub fn render_pass(&mut self, film: &mut Film) -> Result<()> {
        let start = Instant::now();
        let parameters = pass_parameters(&self.scene, &self.settings, [film.width(), film.height()], film.samples())?;
        let pixels = film.sums().len();
        let mut counters = PathCounters::default();
        let mut radiance = vec![Vec3::ZERO; pixels];
        for (tile, sums) in radiance.chunks_mut(TILE).enumerate() {
            let first_pixel = (tile * TILE) as u32;
            let parameters = PathParameters { first_pixel, n_paths: sums.len() as u32, ..parameters };
            self.trace_tile(parameters, sums, &mut counters)?;
        }
        film.accumulate(&radiance);
        counters.seconds = start.elapsed().as_secs_f64();
        self.counters.add(&counters);
        Ok(())
    }

    /// The stages, one after the other, over all paths of a tile.
    fn trace_tile(&self, mut parameters: PathParameters, sums: &mut [Vec3], counters: &mut PathCounters) -> Result<()> {
        let mut paths: Vec<PathState> = Vec::with_capacity(sums.len());
        let mut rays: Vec<Ray> = Vec::with_capacity(sums.len());
        let mut shaded: Vec<Shaded> = Vec::with_capacity(sums.len());
        (0..sums.len() as u32)
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|slot| generate(&parameters, slot))
            .collect_into_vec(&mut paths);
        counters.paths += paths.len() as u64;
        for depth in 0..=self.settings.depth {
            parameters.depth = depth;
            paths.par_iter().with_min_len(CHUNK).map(PathState::ray).collect_into_vec(&mut rays);
            let hits = self.search.closest_hits(&rays)?;
            counters.rays += rays.len() as u64;

            paths
                .par_iter()
                .zip(hits.records())
                .with_min_len(CHUNK)
                .map(|(path, hit)| shade(&self.tables, &parameters, path, hit))
                .collect_into_vec(&mut shaded);

            rays.clear();
            rays.extend(shaded.iter().filter(|s| s.asked != Vec3::ZERO).map(|s| s.shadow));
            let occlusion = self.search.any_hits(&rays)?;
            counters.shadow_rays += rays.len() as u64;
            add_light(&shaded, occlusion.as_slice(), sums);

            paths.clear();
            paths.extend(shaded.iter().map(|s| s.path).filter(PathState::is_alive));
            if paths.is_empty() {
                break;
            }
        }
        Ok(())
    }
}

/// Adds to each path what its ray met and what its shadow ray lets through; `occluded` has a word for each shadow ray.
fn add_light(shaded: &[Shaded], occluded: &[u32], sums: &mut [Vec3]) {
    let mut occluded = occluded.iter();
    for shaded in shaded {
        let sum = &mut sums[shaded.path.slot as usize];
        *sum += shaded.found;
        if shaded.asked != Vec3::ZERO && occluded.next() == Some(&0) {
            *sum += shaded.asked;
        }
    }
}

/// Checks what a path tracer is made of.
///
/// # Errors
/// As [`PathTracer::new`].
pub(super) fn check(scene: &Scene, settings: &PathSettings, prepared: &PreparedTriangles) -> Result<()> {
    scene.check()?;
    settings.check()?;
    let (found, expected) = (prepared.len() as u64, scene.mesh.triangles.len() as u64);
    if found != expected {
        return Err(Error::LengthMismatch { what: "the structure over the scene's triangles", found, expected });
    }
    Ok(())
}

/// What all paths of the next pass share, but for their tile.
pub(super) fn pass_parameters(
    scene: &Scene,
    settings: &PathSettings,
    [width, height]: [u32; 2],
    samples: u32,
) -> Result<PathParameters> {
    if samples == u32::MAX {
        return Err(Error::TooMany {
            what: "samples a pixel",
            found: u64::from(u32::MAX) + 1,
            limit: u64::from(u32::MAX),
            advice: "begin a new film",
        });
    }
    Ok(PathParameters {
        camera: CameraFrame::new(&scene.camera, width, height),
        width,
        height,
        first_pixel: 0,
        n_paths: 0,
        sample: samples,
        seed: settings.seed,
        depth: 0,
        most_depth: settings.depth,
        roulette_depth: settings.roulette_depth,
        next_event: u32::from(settings.next_event),
        padding: [0; 6],
    })
}
