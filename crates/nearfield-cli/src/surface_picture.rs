//! The picture of a surface: path traced in a room.

use std::path::Path;

use nearfield::application::{Film, Material, PathSettings, PathTracer, Scene};
use nearfield::{BvhSettings, TriMesh, TriangleBvh};

use crate::exit::Failure;
use crate::interrupt;
use crate::options::PictureSize;
use crate::render::ROOM_EXPOSURE;
use crate::render_picture::{self, Development, PictureFormat};
use crate::render_scene::fill_with_room;

/// Samples a pixel.
const SAMPLES: u32 = 16;
/// Scatterings of a path: what light makes after more is not seen in a room with walls of one colour.
const DEPTH: u32 = 4;

/// Renders a mesh on the CPU; Ctrl-C ends after the sample that is under way and keeps the picture so far.
pub(crate) fn draw(mesh: TriMesh, path: &Path, size: PictureSize, force: bool) -> Result<(), Failure> {
    let mut scene = Scene::room_around(mesh, Material::default()).map_err(Failure::Search)?;
    fill_with_room(&mut scene, f64::from(size.width) / f64::from(size.height));
    let structure = TriangleBvh::build(&scene.mesh, &BvhSettings::default()).map_err(Failure::Search)?;
    let mut film = Film::new(size.width, size.height).map_err(Failure::Search)?;
    let mut tracer = PathTracer::new(scene, &structure, PathSettings { depth: DEPTH, ..PathSettings::default() })
        .map_err(Failure::Search)?;
    for _ in 0..SAMPLES {
        tracer.render_pass(&mut film).map_err(Failure::Search)?;
        if interrupt::asked() {
            break;
        }
    }
    let how = Development { format: PictureFormat::Png, exposure: ROOM_EXPOSURE, is_last: true };
    render_picture::write(path, &film, how, force)
}
