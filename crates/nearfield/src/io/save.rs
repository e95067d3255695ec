//! From a cloud or a mesh to a file: whole or not at all.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Cursor, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use super::{Format, npy, obj, pcd, ply, vtp, xyz};
use crate::{Error, PointCloud, Result, TriMesh};

/// How to write a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct WriteOptions {
    /// The format; `None` lets the extension decide.
    pub format: Option<Format>,
    /// Whether an existing file may be replaced.
    pub force: bool,
    /// Whether PLY is written as text rather than binary little-endian.
    pub ascii: bool,
}

/// What a file is written to; some formats go back to fill in a size.
pub trait WriteSeek: Write + Seek {}

impl<W: Write + Seek> WriteSeek for W {}

type Writer<T> = fn(&T, &WriteOptions, &mut dyn WriteSeek) -> io::Result<()>;

/// Writes a point cloud with its normals, colours and attributes, as far as the format holds them.
///
/// Text formats and PLY keep world coordinates to the last bit. `path` `-` writes standard output and needs a format.
///
/// # Errors
/// `Io`, also where the file exists and may not be replaced; `InvalidSetting` for an unknown extension; `Unsupported`
/// for a format that is only read; `LengthMismatch` for a column that is not one value a point.
pub fn write_cloud(path: &Path, cloud: &PointCloud, options: &WriteOptions) -> Result<()> {
    let format = chosen(path, options)?;
    let write: Writer<PointCloud> = match format {
        Format::Ply => |cloud, options, w| ply::write_cloud(cloud, options.ascii, w),
        Format::Obj => |cloud, _, w| obj::write_cloud(cloud, w),
        Format::Xyz => |cloud, _, w| xyz::write_xyz(cloud, w),
        Format::Csv => |cloud, _, w| xyz::write_csv(cloud, w),
        Format::Pcd => |cloud, _, w| pcd::write(cloud, w),
        Format::Npz => |cloud, _, w| npy::write_cloud(cloud, w),
        Format::Vtp => |cloud, _, w| vtp::write_cloud(cloud, w),
        Format::Stl | Format::Las | Format::Laz | Format::Npy => {
            let advice = "write PLY, OBJ, XYZ, CSV, PCD, NPZ or VTP";
            return Err(Error::Unsupported { what: format!("writing a point cloud as {format}"), advice });
        }
    };
    let mut columns = vec![];
    columns.extend(cloud.normals.as_ref().map(|n| ("normals", n.len())));
    columns.extend(cloud.colors.as_ref().map(|c| ("colors", c.len())));
    columns.extend(cloud.attributes.iter().map(|a| ("attribute", a.values.len())));
    check_lengths(&columns, cloud.len())?;
    write_atomically(path, options.force, |w| write(cloud, options, w))
}

/// Writes a triangle mesh with the normals and colours of its vertices, as far as the format holds them.
///
/// # Errors
/// As [`write_cloud`]; `TooMany` for a triangle whose vertex is not there.
pub fn write_mesh(path: &Path, mesh: &TriMesh, options: &WriteOptions) -> Result<()> {
    let format = chosen(path, options)?;
    let write: Writer<TriMesh> = match format {
        Format::Ply => |mesh, options, w| ply::write_mesh(mesh, options.ascii, w),
        Format::Obj => |mesh, _, w| obj::write_mesh(mesh, w),
        Format::Vtp => |mesh, _, w| vtp::write_mesh(mesh, w),
        _ => {
            let advice = "write PLY, OBJ or VTP";
            return Err(Error::Unsupported { what: format!("writing a mesh as {format}"), advice });
        }
    };
    let n_vertices = mesh.vertices.len();
    if let Some(&index) = mesh.triangles.iter().flatten().find(|&&i| i as usize >= n_vertices) {
        return Err(Error::TooMany {
            what: "vertex index of a triangle",
            found: u64::from(index),
            limit: (n_vertices as u64).saturating_sub(1),
            advice: "indices count from 0 and must be below the number of vertices",
        });
    }
    let mut columns = vec![];
    columns.extend(mesh.normals.as_ref().map(|n| ("normals", n.len())));
    columns.extend(mesh.colors.as_ref().map(|c| ("colors", c.len())));
    check_lengths(&columns, n_vertices)?;
    write_atomically(path, options.force, |w| write(mesh, options, w))
}

fn chosen(path: &Path, options: &WriteOptions) -> Result<Format> {
    options.format.map_or_else(|| Format::from_path(path), Ok)
}

fn check_lengths(columns: &[(&'static str, usize)], expected: usize) -> Result<()> {
    match columns.iter().find(|&&(_, found)| found != expected) {
        Some(&(what, found)) => Err(Error::LengthMismatch { what, found: found as u64, expected: expected as u64 }),
        None => Ok(()),
    }
}

/// Writes a file whole or not at all: `write` fills a temporary file in the same folder, which then takes the name.
///
/// A file that exists is replaced only with `force`; a link is followed and what it names replaced. `-` is standard
/// output; it, pipes and devices get everything at the end, which until then is in memory.
///
/// # Errors
/// `Io` with the path: where the file exists and `force` is not set (`AlreadyExists`), and whatever `write` or the
/// file system reports. The old file is then untouched and nothing new is left behind.
pub fn write_atomically(
    path: &Path,
    force: bool,
    write: impl FnOnce(&mut dyn WriteSeek) -> io::Result<()>,
) -> Result<()> {
    replace(path, force, write).map_err(|source| Error::Io { path: path.to_owned(), source })
}

fn replace(path: &Path, force: bool, write: impl FnOnce(&mut dyn WriteSeek) -> io::Result<()>) -> io::Result<()> {
    if path == Path::new("-") {
        return all_at_once(io::stdout().lock(), write);
    }
    let old = fs::metadata(path).ok();
    let target = match &old {
        Some(metadata) if !metadata.is_file() && !metadata.is_dir() => {
            return all_at_once(OpenOptions::new().write(true).open(path)?, write);
        }
        Some(_) if !force => {
            let message = "the file exists and may not be replaced (force, `--force`)";
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, message));
        }
        Some(_) => fs::canonicalize(path)?,
        None => path.to_owned(),
    };
    let temporary = Temporary::beside(&target)?;
    {
        let mut w = BufWriter::with_capacity(1 << 16, &temporary.file);
        write(&mut w)?;
        w.flush()?;
    }
    if let Some(metadata) = old {
        temporary.file.set_permissions(metadata.permissions())?;
    }
    fs::rename(&temporary.path, &target)
}

/// For what cannot seek: pipes and devices.
fn all_at_once(mut out: impl Write, write: impl FnOnce(&mut dyn WriteSeek) -> io::Result<()>) -> io::Result<()> {
    let mut spool = Cursor::new(vec![]);
    write(&mut spool)?;
    out.write_all(spool.get_ref())?;
    out.flush()
}

/// A new file that is removed again unless it was renamed.
struct Temporary {
    path: PathBuf,
    file: File,
}

impl Temporary {
    fn beside(target: &Path) -> io::Result<Self> {
        static COUNTER: AtomicU64 = AtomicU64::new(0);
        let Some(name) = target.file_name() else {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "the path names no file"));
        };
        let mut hidden = std::ffi::OsString::from(".");
        hidden.push(name);
        hidden.push(format!(".{}-{}.tmp", std::process::id(), COUNTER.fetch_add(1, Ordering::Relaxed)));
        let path = target.with_file_name(hidden);
        let file = OpenOptions::new().write(true).create_new(true).open(&path)?;
        Ok(Self { path, file })
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        // After the rename there is nothing of this name, and an error path has nobody to tell.
        let _ = fs::remove_file(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder of its own for each test, removed at the end.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("nearfield-save-{name}-{}", std::process::id()));
            fs::create_dir_all(&path).unwrap();
            Self(path)
        }

        fn names(&self) -> Vec<String> {
            fs::read_dir(&self.0).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn an_existing_file_is_replaced_only_by_force() {
        let folder = Folder::new("force");
        let path = folder.0.join("a.txt");
        write_atomically(&path, false, |w| w.write_all(b"one")).unwrap();
        let error = write_atomically(&path, false, |w| w.write_all(b"two")).unwrap_err();
        assert!(matches!(&error, Error::Io { source, .. } if source.kind() == io::ErrorKind::AlreadyExists), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"one");
        write_atomically(&path, true, |w| w.write_all(b"two")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(folder.names(), ["a.txt"]);
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = Folder::new("failed");
        let path = folder.0.join("a.txt");
        fs::write(&path, "old").unwrap();
        let broken = |w: &mut dyn WriteSeek| {
            w.write_all(&[7; 100_000])?;
            Err(io::Error::other("the disk broke"))
        };
        assert!(write_atomically(&path, true, broken).is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(folder.names(), ["a.txt"]);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_device_is_an_error_and_a_link_is_followed() {
        let full = write_atomically(Path::new("/dev/full"), true, |w| w.write_all(b"x")).unwrap_err();
        assert!(full.to_string().contains("/dev/full"), "{full}");
        write_atomically(Path::new("/dev/null"), false, |w| w.write_all(b"x")).unwrap();

        let folder = Folder::new("link");
        let (real, link) = (folder.0.join("real.txt"), folder.0.join("link.txt"));
        fs::write(&real, "old").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        write_atomically(&link, true, |w| w.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&real).unwrap(), b"new");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    }

    #[test]
    fn formats_are_written_as_the_table_says() {
        let folder = Folder::new("table");
        let cloud = PointCloud::new(vec![glam::Vec3::ONE]);
        let mesh = TriMesh::new(vec![glam::Vec3::ONE; 3], vec![[0, 1, 2]]).unwrap();
        for info in super::super::FORMATS {
            let path = folder.0.join(format!("out.{}", info.extensions[0]));
            let options = WriteOptions { force: true, ..WriteOptions::default() };
            let refused = |r: Result<()>| match r {
                Ok(()) => false,
                Err(Error::Unsupported { .. }) => true,
                Err(other) => panic!("{}: {other}", info.name),
            };
            assert_eq!(!refused(write_cloud(&path, &cloud, &options)), info.writes_cloud, "{}", info.name);
            assert_eq!(!refused(write_mesh(&path, &mesh, &options)), info.writes_mesh, "{}", info.name);
        }
    }

    #[test]
    fn a_column_that_does_not_fit_is_refused_before_the_file_is_touched() {
        let folder = Folder::new("columns");
        let mut cloud = PointCloud::new(vec![glam::Vec3::ONE]);
        cloud.colors = Some(vec![]);
        let error = write_cloud(&folder.0.join("a.ply"), &cloud, &WriteOptions::default()).unwrap_err();
        assert!(matches!(error, Error::LengthMismatch { what: "colors", found: 0, expected: 1 }), "{error}");
        assert!(folder.names().is_empty());
    }
}
