//! The folder of a simulation: pictures, clouds, measures, the checkpoint and the film.

use std::path::{Path, PathBuf};

use nearfield::application::particles::{ParticleScene, Particles};
use nearfield::geometry::{Attribute, Column};
use nearfield::io::{WriteOptions, write_atomically, write_cloud};
use nearfield::{Error, PointCloud};

use crate::exit::Failure;
use crate::picture::{Film, Image, write_film};
use crate::simulate_measures::Measured;

/// Names of files that are written once.
const CHECKPOINT: &str = "checkpoint.npz";
const MEASURES: &str = "measures.csv";
const FILM: &str = "film.png";

/// Where everything goes.
pub(crate) struct Folder {
    path: PathBuf,
}

impl Folder {
    /// The folder, made where it is not there; refused where another simulation is in it that may not be replaced.
    pub(crate) fn open(path: &Path, replaces: bool) -> Result<Self, Failure> {
        let folder = Self { path: path.to_owned() };
        let failed = |source| Failure::writing(Error::Io { path: path.to_owned(), source });
        std::fs::create_dir_all(path).map_err(failed)?;
        let old = [folder.checkpoint(), folder.measures(), folder.film(), folder.frame(0, "png")];
        if let Some(old) = old.into_iter().find(|old| old.exists() && !replaces) {
            let message = "an earlier simulation is in the folder; replace it with --force, or go on with --resume";
            let source = std::io::Error::new(std::io::ErrorKind::AlreadyExists, message);
            return Err(Failure::writing(Error::Io { path: old, source }));
        }
        Ok(folder)
    }

    pub(crate) fn checkpoint(&self) -> PathBuf {
        self.path.join(CHECKPOINT)
    }

    pub(crate) fn measures(&self) -> PathBuf {
        self.path.join(MEASURES)
    }

    fn film(&self) -> PathBuf {
        self.path.join(FILM)
    }

    fn frame(&self, number: u64, extension: &str) -> PathBuf {
        self.path.join(format!("frame-{number:05}.{extension}"))
    }

    /// Numbers of the pictures that are there.
    fn frames(&self) -> Vec<u64> {
        let Ok(entries) = std::fs::read_dir(&self.path) else { return Vec::new() };
        let number = |name: &str| name.strip_prefix("frame-")?.strip_suffix(".png")?.parse().ok();
        entries.filter_map(|entry| number(entry.ok()?.file_name().to_str()?)).collect()
    }

    /// Takes away the pictures of an earlier simulation, which is replaced.
    pub(crate) fn remove_frames(&self) -> Result<(), Failure> {
        for path in self.frames().into_iter().map(|number| self.frame(number, "png")) {
            std::fs::remove_file(&path).map_err(|source| Failure::writing(Error::Io { path, source }))?;
        }
        Ok(())
    }

    pub(crate) fn write_picture(&self, number: u64, image: &Image) -> nearfield::Result<()> {
        write_atomically(&self.frame(number, "png"), true, |w| image.write_png_quickly(w))
    }

    /// The particles with their velocities, classes and densities.
    pub(crate) fn write_particles(
        &self,
        number: u64,
        extension: &str,
        scene: &ParticleScene,
        particles: &Particles,
    ) -> nearfield::Result<()> {
        let options = WriteOptions { force: true, ..WriteOptions::default() };
        write_cloud(&self.frame(number, extension), &cloud(scene, particles), &options)
    }

    pub(crate) fn write_measures(&self, measured: &Measured) -> nearfield::Result<()> {
        write_atomically(&self.measures(), true, |w| measured.write(w))
    }

    /// A film of the frames up to this one that are there; its size in bytes.
    pub(crate) fn write_film(&self, last: u64, shrink: u32, rate: u16) -> Result<Option<u64>, Failure> {
        let mut numbers: Vec<u64> = self.frames().into_iter().filter(|number| *number <= last).collect();
        numbers.sort_unstable();
        let pictures: Vec<PathBuf> = numbers.into_iter().map(|number| self.frame(number, "png")).collect();
        if pictures.is_empty() {
            return Ok(None);
        }
        let film = Film { pictures, shrink, rate };
        write_atomically(&self.film(), true, |w| write_film(&film, w)).map_err(Failure::writing)?;
        Ok(std::fs::metadata(self.film()).ok().map(|metadata| metadata.len()))
    }
}

/// Particles as a cloud around the lower corner of the domain.
fn cloud(scene: &ParticleScene, particles: &Particles) -> PointCloud {
    let origin = scene.domain[0];
    let column = |name: &str, values: Vec<f32>| Attribute { name: name.to_owned(), values: Column::F32(values) };
    let velocities = &particles.velocities;
    let mut attributes: Vec<Attribute> = ["velocity_x", "velocity_y", "velocity_z"]
        .into_iter()
        .enumerate()
        .map(|(axis, name)| column(name, velocities.iter().map(|velocity| velocity[axis] as f32).collect()))
        .collect();
    attributes.push(Attribute { name: "class".to_owned(), values: Column::U8(particles.classes.clone()) });
    if !particles.densities.is_empty() {
        attributes.push(column("density", particles.densities.iter().map(|&density| density as f32).collect()));
    }
    let points = particles.positions.iter().map(|position| (*position - origin).as_vec3()).collect();
    PointCloud { origin, points, attributes, ..PointCloud::default() }
}
