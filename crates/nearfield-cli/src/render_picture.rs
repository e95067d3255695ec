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

/// How the light of a film becomes a file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Development {
    pub(crate) format: PictureFormat,
    /// What light is multiplied by; for PNG alone.
    pub(crate) exposure: f32,
    /// Whether no other picture follows: then a PNG is made as small as it gets.
    pub(crate) is_last: bool,
}

/// Writes the mean of the samples so far, whole or not at all.
pub(crate) fn write(path: &Path, film: &Film, how: Development, force: bool) -> Result<(), Failure> {
    write_atomically(path, force, |w| match how.format {
        PictureFormat::Png => {
            let image = Image::of_pixels(film.width(), film.height(), film.srgb(how.exposure));
            if how.is_last { image.write_png(w) } else { image.write_png_quickly(w) }
        }
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
