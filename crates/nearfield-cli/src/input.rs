//! Opening input files: a path or `-`, a format by extension or by name, and the memory limit.

use std::io::Read;
use std::path::{Path, PathBuf};

use nearfield::io::{Format, Polygons, parse_cloud, parse_mesh_with, parse_radii, parse_rays};
use nearfield::{DVec3, Error, PointCloud, Ray, TriMesh};

use crate::exit::Failure;
use crate::options::Common;

/// What the readers find in a sound file that holds only points, where a mesh is asked for.
const NO_FACES: [&str; 2] = ["no faces", "only points"];

/// Name of an input as summaries show it.
pub(crate) fn file_name(path: &Path) -> String {
    match path.file_name() {
        Some(name) if path != Path::new("-") => name.to_string_lossy().into_owned(),
        _ => "standard input".to_owned(),
    }
}

/// The bytes of an input file.
pub(crate) struct Input {
    path: PathBuf,
    format: Format,
    bytes: Vec<u8>,
}

impl Input {
    /// Reads the file whole; `-` is standard input and needs `format`.
    pub(crate) fn open(path: &Path, format: Option<Format>, common: &Common) -> Result<Self, Failure> {
        let format = match format {
            Some(format) => format,
            None if path == Path::new("-") => {
                return Err(Failure::Usage("standard input has no extension: say its format with --format".into()));
            }
            None => Format::from_path(path).map_err(|e| missing_first(path, e))?,
        };
        Ok(Self { path: path.to_owned(), format, bytes: contents(path, common)? })
    }

    /// The format it is read as.
    pub(crate) fn format(&self) -> Format {
        self.format
    }

    /// Bytes in the file.
    pub(crate) fn len(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// All points, the vertices where it is a mesh. NaN and infinite coordinates are kept.
    pub(crate) fn cloud(&self) -> Result<PointCloud, Failure> {
        parse_cloud(&self.bytes, self.format).map_err(|e| self.failure(e))
    }

    /// The mesh, where the file has faces.
    pub(crate) fn mesh(&self) -> Result<Option<TriMesh>, Failure> {
        if !self.format.info().reads_mesh {
            return Ok(None);
        }
        self.faces(Polygons::Fans)
    }

    /// The mesh, where nothing but a mesh will do.
    pub(crate) fn surface(&self, polygons: Polygons) -> Result<TriMesh, Failure> {
        match self.faces(polygons)? {
            Some(mesh) => Ok(mesh),
            None => {
                let vertices = self.cloud().map_or(0, |cloud| cloud.len() as u64);
                Err(Failure::Read(self.path.clone(), Error::NoTriangles { vertices }))
            }
        }
    }

    fn faces(&self, polygons: Polygons) -> Result<Option<TriMesh>, Failure> {
        match parse_mesh_with(&self.bytes, self.format, polygons) {
            Ok(mesh) if mesh.triangles.is_empty() => Ok(None),
            Ok(mesh) => Ok(Some(mesh)),
            Err(Error::File(error)) if NO_FACES.contains(&error.found.as_str()) => Ok(None),
            Err(error) => Err(self.failure(error)),
        }
    }

    fn failure(&self, error: Error) -> Failure {
        failure(&self.path, error)
    }
}

/// The bytes of a file or of standard input.
fn contents(path: &Path, common: &Common) -> Result<Vec<u8>, Failure> {
    let failed = |source| Failure::Read(path.to_owned(), Error::Io { path: path.to_owned(), source });
    if path == Path::new("-") {
        let mut bytes = vec![];
        // One byte more than allowed is enough to know.
        let most = common.memory_left(0).unwrap_or(u64::MAX).saturating_add(1);
        std::io::stdin().lock().take(most).read_to_end(&mut bytes).map_err(failed)?;
        common.allow("the input", bytes.len() as u64).map_err(Failure::Search)?;
        return Ok(bytes);
    }
    let size = std::fs::metadata(path).map_err(failed)?.len();
    common.allow("the input", size).map_err(Failure::Search)?;
    std::fs::read(path).map_err(failed)
}

/// Bad content of the file.
fn failure(path: &Path, error: Error) -> Failure {
    match error {
        Error::File(mut file) => {
            file.path = Some(crate::exit::shown(path).into());
            Failure::Read(path.to_owned(), Error::File(file))
        }
        other => Failure::Read(path.to_owned(), other),
    }
}

/// A radius for each of so many queries.
pub(crate) fn radii(path: &Path, n_queries: usize, common: &Common) -> Result<Vec<f32>, Failure> {
    let radii = parse_radii(&contents(path, common)?).map_err(|e| failure(path, e))?;
    let (found, expected) = (radii.len() as u64, n_queries as u64);
    if found != expected {
        let what = "the list of radii, one for each query,";
        return Err(Failure::Read(path.to_owned(), Error::LengthMismatch { what, found, expected }));
    }
    Ok(radii)
}

/// Rays into a mesh of this origin.
pub(crate) fn rays(path: &Path, origin: DVec3, common: &Common) -> Result<Vec<Ray>, Failure> {
    parse_rays(&contents(path, common)?, origin).map_err(|e| failure(path, e))
}

/// A file that is not there is worth saying before its extension.
fn missing_first(path: &Path, error: Error) -> Failure {
    match std::fs::metadata(path) {
        Err(source) => Failure::Read(path.to_owned(), Error::Io { path: path.to_owned(), source }),
        Ok(_) => Failure::Search(error),
    }
}

/// Checks that every point can be searched, after dropping those with NaN or infinite coordinates where wanted.
pub(crate) fn searchable(
    mut cloud: PointCloud,
    path: &Path,
    drop_invalid: bool,
    notes: &mut Vec<String>,
) -> Result<PointCloud, Failure> {
    if drop_invalid {
        let dropped = cloud.drop_invalid();
        if dropped > 0 {
            let what = "points with NaN or infinite coordinates were dropped; indices count those that are left";
            notes.push(format!("{}: {dropped} {what}", crate::exit::shown(path)));
        }
    }
    cloud.validate().map_err(Failure::reading(path))?;
    Ok(cloud)
}
