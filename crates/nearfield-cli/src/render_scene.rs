//! What `nearfield render` renders: a scene file, a mesh that is turned upright and put into a room, or the Cornell box.

use std::path::Path;

use clap::ValueEnum;
use nearfield::application::{Environment, Material, Scene, SceneReader};
use nearfield::io::Polygons;
use nearfield::{DVec3, Error};

use crate::exit::{Failure, shown};
use crate::input::Input;
use crate::options::{Common, PictureSize};
use crate::ray_structure::failed;

/// Name of the scene that needs no file.
const CORNELL_BOX: &str = "cornell-box";

/// The direction of a mesh that becomes up, +y of the room.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Up {
    X,
    Y,
    Z,
    #[value(name = "-x")]
    MinusX,
    #[value(name = "-y")]
    MinusY,
    #[value(name = "-z")]
    MinusZ,
}

impl Up {
    /// A place after the turn, by a quarter or a half about x or z, exact in every bit.
    fn turned(self, p: DVec3) -> DVec3 {
        match self {
            Self::X => DVec3::new(-p.y, p.x, p.z),
            Self::Y => p,
            Self::Z => DVec3::new(p.x, p.z, -p.y),
            Self::MinusX => DVec3::new(p.y, -p.x, p.z),
            Self::MinusY => DVec3::new(-p.x, -p.y, p.z),
            Self::MinusZ => DVec3::new(p.x, -p.z, p.y),
        }
    }
}

/// The input of the command line.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Source<'a> {
    pub(crate) path: &'a Path,
    pub(crate) up: Option<Up>,
    pub(crate) size: PictureSize,
}

impl Source<'_> {
    /// Says what cannot work before the file is read.
    pub(crate) fn check(&self) -> Result<(), Failure> {
        if self.up.is_none() || self.is_mesh() {
            return Ok(());
        }
        let advice = match self.is_cornell_box() {
            true => "leave it out",
            false => "use `rotate` of its [[mesh]], or `up` of its [camera]",
        };
        Err(Failure::Usage(format!("--up turns a mesh, and {} is a scene: {advice}", shown(self.path))))
    }

    /// Whether the input is a mesh, which gets a room.
    pub(crate) fn is_mesh(&self) -> bool {
        let is_scene = self.path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
        !is_scene && !self.is_cornell_box()
    }

    fn is_cornell_box(&self) -> bool {
        self.path == Path::new(CORNELL_BOX) && !self.path.exists()
    }

    /// Reads the scene, within the limit of memory.
    pub(crate) fn read(&self, common: &Common, notes: &mut Vec<String>) -> Result<Scene, Failure> {
        if self.is_cornell_box() {
            return Ok(Scene::cornell_box());
        }
        let path = self.path;
        std::fs::metadata(path)
            .map_err(|source| Failure::Read(path.to_owned(), Error::Io { path: path.to_owned(), source }))?;
        let mut reader = common.memory_left(0).map_or_else(SceneReader::default, SceneReader::within);
        let (width, height) = (self.size.width, self.size.height);
        let read = if self.is_mesh() { reader.mesh(path) } else { reader.scene(path, width, height) };
        let scene = match read {
            Err(Error::Io { path: lost, source }) if self.is_mesh() && lost != *path => {
                notes.push(format!("{}: {source}; the mesh is light grey", lost.display()));
                let mesh = Input::open(path, None, common)?.surface(Polygons::Fans)?;
                Scene { environment: Environment::NONE, ..Scene::of_mesh(mesh, Material::default()) }
            }
            Err(error @ (Error::InvalidSetting { setting: "file format", .. } | Error::OutOfMemory { .. })) => {
                return Err(Failure::Search(error));
            }
            read => read.map_err(Failure::reading(path))?,
        };
        notes.append(&mut reader.notes);
        if !self.is_mesh() {
            return Ok(scene);
        }
        let scene = upright(scene, self.up.unwrap_or(Up::Y));
        let mut scene = scene.in_room().map_err(|error| failed(path, error))?;
        scene.check().map_err(Failure::reading(path))?;
        fill_with_room(&mut scene, f64::from(width) / f64::from(height));
        Ok(scene)
    }
}

/// Turns the mesh about the origin of its file until that direction is +y.
fn upright(mut scene: Scene, up: Up) -> Scene {
    for vertex in &mut scene.mesh.vertices {
        *vertex = up.turned(vertex.as_dvec3()).as_vec3();
    }
    scene.mesh.origin = up.turned(scene.mesh.origin);
    scene
}

/// Brings the edges of the picture to those of the open front of the room of `Scene::in_room`, so that nothing outside
/// shows.
pub(crate) fn fill_with_room(scene: &mut Scene, aspect: f64) {
    let bounds = scene.bounds();
    let half = 0.5 * bounds.extent().as_dvec3();
    let away = f64::from(scene.camera.position.z) - f64::from(bounds.max.z);
    let reach = half.y.min(half.x / aspect) / away;
    if reach.is_finite() && reach > 0.0 {
        scene.camera.vertical_fov = (2.0 * reach.atan()).to_degrees() as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_direction_turns_up_without_mirroring() {
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        for (up, direction) in [
            (Up::X, DVec3::X),
            (Up::Y, DVec3::Y),
            (Up::Z, DVec3::Z),
            (Up::MinusX, -DVec3::X),
            (Up::MinusY, -DVec3::Y),
            (Up::MinusZ, -DVec3::Z),
        ] {
            assert_eq!(up.turned(direction), DVec3::Y, "{up:?}");
            let [x, y, z] = axes.map(|axis| up.turned(axis));
            assert_eq!(x.cross(y), z, "{up:?} mirrors");
        }
    }
}
