//! The one table of file formats: names, extensions and what each can do.

use std::path::Path;
use std::str::FromStr;

use crate::{Error, Result};

/// A file format.
#[non_exhaustive]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[allow(missing_docs, reason = "the variants are the names; the table says the rest")]
pub enum Format {
    Ply,
    Obj,
    Stl,
    Xyz,
    Csv,
    Pcd,
    Las,
    Laz,
    Npy,
    Npz,
    Vtp,
}

/// A row of the table: what a format is called and what can be done with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FormatInfo {
    /// The format.
    pub format: Format,
    /// Name for `--format` and messages, upper case.
    pub name: &'static str,
    /// One line on what the format is and which of its variants are handled.
    pub summary: &'static str,
    /// File extensions without the dot, lower case.
    pub extensions: &'static [&'static str],
    /// Whether a [`crate::PointCloud`] can be read.
    pub reads_cloud: bool,
    /// Whether a [`crate::TriMesh`] can be read.
    pub reads_mesh: bool,
    /// Whether a cloud can be written.
    pub writes_cloud: bool,
    /// Whether a mesh can be written.
    pub writes_mesh: bool,
}

/// Says what a row can do as letters: `c`, `m` read, `C`, `M` write a cloud or a mesh.
const fn row(
    format: Format,
    name: &'static str,
    extensions: &'static [&'static str],
    can: &'static [u8],
    summary: &'static str,
) -> FormatInfo {
    const fn has(can: &[u8], letter: u8) -> bool {
        let mut i = 0;
        while i < can.len() {
            if can[i] == letter {
                return true;
            }
            i += 1;
        }
        false
    }
    FormatInfo {
        format,
        name,
        summary,
        extensions,
        reads_cloud: has(can, b'c'),
        reads_mesh: has(can, b'm'),
        writes_cloud: has(can, b'C'),
        writes_mesh: has(can, b'M'),
    }
}

/// Every format, in the order of [`Format`].
pub const FORMATS: [FormatInfo; 11] = [
    row(Format::Ply, "PLY", &["ply"], b"cmCM", "Stanford polygon file: ascii, binary little- and big-endian"),
    row(Format::Obj, "OBJ", &["obj"], b"cmCM", "Wavefront object: positions, colours, normals, polygons"),
    row(Format::Stl, "STL", &["stl"], b"cm", "stereolithography: ascii and binary, vertices welded"),
    row(Format::Xyz, "XYZ", &["xyz", "txt", "asc"], b"cC", "text, one point a line, separated by spaces"),
    row(Format::Csv, "CSV", &["csv", "tsv"], b"cC", "text with a header, separated by commas"),
    row(Format::Pcd, "PCD", &["pcd"], b"cC", "Point Cloud Library: ascii, binary, binary_compressed"),
    row(Format::Las, "LAS", &["las"], b"c", "airborne LiDAR"),
    row(Format::Laz, "LAZ", &["laz"], b"c", "airborne LiDAR, compressed"),
    row(Format::Npy, "NPY", &["npy"], b"c", "NumPy array of shape [n, 3]"),
    row(Format::Npz, "NPZ", &["npz"], b"cC", "NumPy archive of named arrays"),
    row(Format::Vtp, "VTP", &["vtp"], b"cCM", "VTK XML poly data of ParaView: ascii, base64 and raw, not compressed"),
];

/// The accepted extensions, as errors list them.
const EXTENSIONS: &str = "one of ply, obj, stl, xyz, txt, asc, csv, tsv, pcd, las, laz, npy, npz, vtp";

impl Format {
    /// The format's row of [`FORMATS`].
    pub fn info(self) -> &'static FormatInfo {
        &FORMATS[self as usize]
    }

    /// Name in messages, upper case.
    pub fn name(self) -> &'static str {
        self.info().name
    }

    /// The format that the extension of `path` names, in upper or lower case.
    ///
    /// # Errors
    /// `InvalidSetting`, listing the extensions there are, where it is none of them.
    pub fn from_path(path: &Path) -> Result<Self> {
        let extension = path.extension().map(|e| e.to_string_lossy().into_owned()).unwrap_or_default();
        Self::from_extension(&extension).ok_or_else(|| Error::InvalidSetting {
            setting: "file format",
            found: if extension.is_empty() {
                format!("{} (no extension; give the format)", path.display())
            } else {
                format!("{} (extension {extension:?})", path.display())
            },
            expected: EXTENSIONS,
        })
    }

    fn from_extension(extension: &str) -> Option<Self> {
        let matches = |info: &&FormatInfo| info.extensions.iter().any(|e| e.eq_ignore_ascii_case(extension));
        FORMATS.iter().find(matches).map(|info| info.format)
    }
}

impl FromStr for Format {
    type Err = Error;

    /// Takes a format's name or one of its extensions, in upper or lower case.
    fn from_str(name: &str) -> Result<Self> {
        Self::from_extension(name).ok_or_else(|| Error::InvalidSetting {
            setting: "file format",
            found: name.to_owned(),
            expected: EXTENSIONS,
        })
    }
}

impl std::fmt::Display for Format {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_stands_in_the_order_of_the_enum_and_the_message_lists_it() {
        let mut listed: Vec<&str> = vec![];
        for (i, info) in FORMATS.iter().enumerate() {
            assert_eq!(info.format as usize, i, "{}", info.name);
            assert_eq!(info.name.parse::<Format>().unwrap(), info.format);
            listed.extend(info.extensions);
        }
        assert_eq!(EXTENSIONS, format!("one of {}", listed.join(", ")));
    }

    #[test]
    fn the_extension_decides_in_any_case() {
        assert_eq!(Format::from_path(Path::new("a/b.c/scan.PlY")).unwrap(), Format::Ply);
        assert_eq!(Format::from_path(Path::new("points.txt")).unwrap(), Format::Xyz);
        assert_eq!("laz".parse::<Format>().unwrap(), Format::Laz);
    }

    #[test]
    fn an_unknown_extension_lists_the_formats() {
        for path in ["scan.doc", "scan", "-"] {
            let message = Format::from_path(Path::new(path)).unwrap_err().to_string();
            assert!(message.contains(path) && message.contains("ply, obj, stl"), "{message}");
        }
    }
}
