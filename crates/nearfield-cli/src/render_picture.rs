//! Rendered pictures as files: PNG for the screen, EXR with every bit of the light.

use std::io;
use std::path::Path;

use nearfield::application::Film;
use nearfield::io::{WriteSeek, write_atomically, write_exr};

use crate::exit::Failure;
use crate::picture::Image;

/// Format of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PictureFormat {
    Png,
    Exr,
}

impl PictureFormat {
    /// The format by extension; PNG for standard output.
    pub(crate) fn of(path: &Path) -> Result<Self, Failure> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("png") => Ok(Self::Png),
            Some("exr") => Ok(Self::Exr),
            _ if path == Path::new("-") => Ok(Self::Png),
            _ => Err(Failure::Usage(format!("--output {}: pictures are written as .png or .exr", path.display()))),
        }
    }
}

/// Writes the mean of the samples so far, whole or not at all. `exposure` is for PNG alone.
pub(crate) fn write(
    path: &Path,
    film: &Film,
    format: PictureFormat,
    exposure: f32,
    force: bool,
) -> Result<(), Failure> {
    write_atomically(path, force, |w| match format {
        PictureFormat::Png => Image::of_pixels(film.width(), film.height(), film.srgb(exposure)).write_png(w),
        PictureFormat::Exr => exr(film, w),
    })
    .map_err(Failure::writing)
}

fn exr(film: &Film, mut w: &mut dyn WriteSeek) -> io::Result<()> {
    write_exr(film.width(), film.height(), &film.radiance(), &mut w).map_err(|error| match error {
        nearfield::Error::Io { source, .. } => source,
        other => io::Error::other(other),
    })
}
