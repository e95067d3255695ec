//! From a path or bytes to a cloud or a mesh.

use std::io::Read;
use std::path::Path;

use super::{Format, las, npy, obj, pcd, ply, stl, vtp, xyz};
use crate::{Error, PointCloud, Result, TriMesh};

/// What becomes of faces with more than three corners.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Polygons {
    /// A fan of triangles around the first corner: the whole face, where it is convex.
    #[default]
    Fans,
    /// The triangle of its first three corners; the rest of the face is missing, and the mesh has holes. As Accel read
    /// its meshes, for comparison with it.
    FirstThree,
}

/// Reads a point cloud; a mesh file gives all of its vertices.
///
/// `path` `-` reads standard input and needs `format`; otherwise the extension decides where `format` is `None`.
/// NaN and infinite coordinates are kept.
///
/// # Errors
/// `Io`; `File` with path, line or byte; `InvalidSetting` for an unknown extension.
pub fn read_cloud(path: &Path, format: Option<Format>) -> Result<PointCloud> {
    let format = chosen(path, format)?;
    parse_cloud(&contents(path)?, format).map_err(|error| with_path(error, path))
}

/// Reads a triangle mesh; polygons come as fans of triangles.
///
/// `path` and `format` as in [`read_cloud`].
///
/// # Errors
/// As [`read_cloud`]; `File` for a file without faces, `Unsupported` for a format that holds only points.
pub fn read_mesh(path: &Path, format: Option<Format>) -> Result<TriMesh> {
    let format = chosen(path, format)?;
    parse_mesh(&contents(path)?, format).map_err(|error| with_path(error, path))
}

/// As [`read_cloud`], from the bytes of a file; the error names no path.
///
/// # Errors
/// `File`.
pub fn parse_cloud(bytes: &[u8], format: Format) -> Result<PointCloud> {
    match format {
        Format::Ply => ply::read_cloud(bytes),
        Format::Obj => obj::read_cloud(bytes),
        Format::Stl => stl::read_cloud(bytes),
        Format::Xyz => xyz::read("XYZ", bytes),
        Format::Csv => xyz::read("CSV", bytes),
        Format::Pcd => pcd::read(bytes),
        Format::Las | Format::Laz => las::read(bytes),
        Format::Npy | Format::Npz => npy::read(bytes),
        Format::Vtp => vtp::read(bytes),
    }
}

/// As [`read_mesh`], from the bytes of a file; the error names no path.
///
/// # Errors
/// `File`; `Unsupported` for a format that holds only points.
pub fn parse_mesh(bytes: &[u8], format: Format) -> Result<TriMesh> {
    parse_mesh_with(bytes, format, Polygons::Fans)
}

/// As [`parse_mesh`], with a choice of what becomes of polygons. Strips of triangles are no polygons.
///
/// # Errors
/// As [`parse_mesh`].
pub fn parse_mesh_with(bytes: &[u8], format: Format, polygons: Polygons) -> Result<TriMesh> {
    match format {
        Format::Ply => ply::read_mesh(bytes, polygons),
        Format::Obj => obj::read_mesh(bytes, polygons),
        Format::Stl => stl::read_mesh(bytes),
        _ => Err(Error::Unsupported {
            what: format!("reading a mesh from {format}"),
            advice: "meshes come from PLY, OBJ or STL",
        }),
    }
}

fn chosen(path: &Path, format: Option<Format>) -> Result<Format> {
    format.map_or_else(|| Format::from_path(path), Ok)
}

fn contents(path: &Path) -> Result<Vec<u8>> {
    let read = || {
        if path == Path::new("-") {
            let mut bytes = vec![];
            std::io::stdin().lock().read_to_end(&mut bytes)?;
            return Ok(bytes);
        }
        std::fs::read(path)
    };
    read().map_err(|source| Error::Io { path: path.to_owned(), source })
}

/// A fault of a file with the name of the file, where it has none yet.
pub(crate) fn with_path(error: Error, path: &Path) -> Error {
    match error {
        Error::File(mut file) => {
            file.path.get_or_insert_with(|| path.to_owned());
            Error::File(file)
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_malformed_file_is_named_with_its_line() {
        let folder = std::env::temp_dir().join(format!("nearfield-open-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("bad.xyz");
        std::fs::write(&path, "1 2 3\n4 five 6\n").unwrap();
        let message = read_cloud(&path, None).unwrap_err().to_string();
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(message.contains("bad.xyz:2") && message.contains("five"), "{message}");
    }

    #[test]
    fn a_missing_file_is_an_io_error_that_names_it() {
        let error = read_cloud(Path::new("/nowhere/scan.ply"), None).unwrap_err();
        assert!(matches!(&error, Error::Io { .. }) && error.to_string().contains("/nowhere/scan.ply"), "{error}");
    }

    #[test]
    fn points_only_formats_give_no_mesh() {
        for info in super::super::FORMATS {
            let cloud_refused = matches!(parse_cloud(b"", info.format), Err(Error::Unsupported { .. }));
            let mesh_refused = matches!(parse_mesh(b"", info.format), Err(Error::Unsupported { .. }));
            assert_eq!((!cloud_refused, !mesh_refused), (info.reads_cloud, info.reads_mesh), "{}", info.name);
        }
    }

    #[test]
    fn an_empty_file_of_every_format_is_an_error() {
        for info in super::super::FORMATS.iter().filter(|info| info.reads_cloud) {
            assert!(matches!(parse_cloud(b"", info.format), Err(Error::File(_))), "{}", info.name);
        }
    }
}
