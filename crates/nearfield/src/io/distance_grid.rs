//! Files of signed distances on a regular grid: VTK ImageData, NPZ, and raw numbers beside a JSON file.

use std::path::Path;

use super::{NpyArray, vti, write_atomically, write_npz};
use crate::geometry::DistanceGrid;
use crate::{Error, Result};

/// A format of distances on a grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GridFormat {
    /// VTK ImageData, `.vti`: written and read.
    Vti,
    /// Arrays `values` [nz, ny, nx], `origin`, `spacing` and `nearest`, `.npz`: written.
    Npz,
    /// The f32 values in the byte order of the machine, `.raw`, x fastest, and what they are in a `.json` beside it: written.
    Raw,
}

impl GridFormat {
    /// By the extension of a file.
    ///
    /// # Errors
    /// `Unsupported` for any other.
    pub fn from_path(path: &Path) -> Result<Self> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        match extension.as_str() {
            "vti" => Ok(Self::Vti),
            "npz" => Ok(Self::Npz),
            "raw" => Ok(Self::Raw),
            _ => Err(Error::Unsupported {
                what: format!("a distance field as {}", path.display()),
                advice: "name a file .vti (VTK ImageData), .npz or .raw",
            }),
        }
    }
}

/// Writes distances, and the index of what is nearest to each node where it is given and the format has a place for it; the
/// format follows from the extension.
///
/// # Errors
/// `Unsupported` for another extension, `LengthMismatch` where `nearest` has another length than the values, `Io` with the path;
/// the file is written whole or not at all.
pub fn write_distance_grid(path: &Path, field: &DistanceGrid, nearest: Option<&[u32]>, force: bool) -> Result<()> {
    let format = GridFormat::from_path(path)?;
    if let Some(nearest) = nearest.filter(|nearest| nearest.len() != field.values().len()) {
        let (found, expected) = (nearest.len() as u64, field.values().len() as u64);
        return Err(Error::LengthMismatch { what: "what is nearest to the nodes", found, expected });
    }
    match format {
        GridFormat::Vti => write_atomically(path, force, |out| vti::write(field, nearest, out)),
        GridFormat::Npz => {
            let (grid, nodes) = (field.grid(), field.grid().nodes());
            let (corner, spacing) = (grid.world_corner().to_array(), [f64::from(grid.spacing())]);
            let mut arrays = vec![
                ("values", NpyArray::F32Grid(field.values(), nodes)),
                ("origin", NpyArray::F64(&corner)),
                ("spacing", NpyArray::F64(&spacing)),
            ];
            arrays.extend(nearest.map(|nearest| ("nearest", NpyArray::U32Grid(nearest, nodes))));
            write_atomically(path, force, |out| write_npz(&arrays, out))
        }
        GridFormat::Raw => {
            let beside = path.with_extension("json");
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let json = description(field, &name);
            write_atomically(&beside, force, |out| out.write_all(json.as_bytes()))?;
            write_atomically(path, force, |out| out.write_all(bytemuck::cast_slice(field.values())))
        }
    }
}

/// What the numbers of a raw file are.
fn description(field: &DistanceGrid, name: &str) -> String {
    let (grid, corner) = (field.grid(), field.grid().world_corner());
    let order = if cfg!(target_endian = "big") { "big" } else { "little" };
    let [nx, ny, nz] = grid.nodes();
    let name = name.replace('\\', "\\\\").replace('"', "\\\"");
    format!(
        "{{\n  \"file\": \"{name}\",\n  \"type\": \"float32\",\n  \"byte_order\": \"{order}\",\n  \"nodes\": [{nx}, {ny}, {nz}],\n  \
         \"fastest\": \"x\",\n  \"origin\": [{:?}, {:?}, {:?}],\n  \"spacing\": {:?},\n  \"undefined\": \"NaN\",\n  \
         \"inside\": \"negative\"\n}}\n",
        corner.x,
        corner.y,
        corner.z,
        f64::from(grid.spacing())
    )
}

/// Reads distances from a `.vti` file as [`write_distance_grid`] writes it.
///
/// # Errors
/// `Io` and `File` with the path; `Unsupported` for another format.
pub fn read_distance_grid(path: &Path) -> Result<DistanceGrid> {
    match GridFormat::from_path(path)? {
        GridFormat::Vti => {
            let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.to_owned(), source })?;
            parse_distance_grid(&bytes).map_err(|error| super::with_path(error, path))
        }
        GridFormat::Npz | GridFormat::Raw => Err(Error::Unsupported {
            what: format!("reading distances from {}", path.display()),
            advice: "write them as .vti",
        }),
    }
}

/// Reads distances from the bytes of a `.vti` file as [`write_distance_grid`] writes it.
///
/// # Errors
/// `File` with what was found and what was expected.
pub fn parse_distance_grid(bytes: &[u8]) -> Result<DistanceGrid> {
    vti::parse(bytes)
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::geometry::RegularGrid;

    fn field(origin: DVec3) -> DistanceGrid {
        let grid = RegularGrid::new(origin, Vec3::new(-1.5, 0.1, 2.0), 0.25, [4, 3, 2]).unwrap();
        let value = |i: usize| if i == 7 { f32::NAN } else { i as f32 - 10.5 };
        DistanceGrid::new(grid, (0..24).map(value).collect()).unwrap()
    }

    fn vti(field: &DistanceGrid) -> Vec<u8> {
        let (mut bytes, nearest) = (vec![], vec![9u32; 24]);
        vti::write(field, Some(&nearest), &mut bytes).unwrap();
        bytes
    }

    #[test]
    fn image_data_comes_back_as_it_was() {
        for origin in [DVec3::ZERO, DVec3::new(5_403_059.0, -7.0, 0.0)] {
            let written = field(origin);
            let read = parse_distance_grid(&vti(&written)).unwrap();
            assert!((read.grid().world_corner() - written.grid().world_corner()).length() < 1e-6);
            assert_eq!((read.grid().nodes(), read.grid().spacing()), ([4, 3, 2], 0.25));
            let bits = |field: &DistanceGrid| field.values().iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
            assert_eq!(bits(&read), bits(&written));
        }
        assert_eq!(parse_distance_grid(&vti(&field(DVec3::ZERO))).unwrap().grid(), field(DVec3::ZERO).grid());
    }

    #[test]
    fn the_header_is_what_vtk_reads() {
        let bytes = vti(&field(DVec3::ZERO));
        let text = String::from_utf8_lossy(&bytes);
        for part in [
            "<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">",
            "WholeExtent=\"0 3 0 2 0 1\" Origin=\"-1.5 0.10000000149011612 2\" Spacing=\"0.25 0.25 0.25\"",
            "<DataArray type=\"Float32\" Name=\"distance\" format=\"appended\" offset=\"0\"/>",
            "<DataArray type=\"UInt32\" Name=\"nearest\" format=\"appended\" offset=\"104\"/>",
        ] {
            assert!(text.contains(part), "{part} in {text}");
        }
    }

    #[test]
    fn damaged_files_say_what_is_wrong() {
        let bytes = vti(&field(DVec3::ZERO));
        // Behind the distances come 104 bytes of the nearest and the closing tags: those alone may be missing.
        for end in 0..bytes.len() - 140 {
            assert!(parse_distance_grid(&bytes[..end]).is_err(), "cut after {end}");
        }
        let replaced = |from: &str, to: &str| {
            let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
            let changed = [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat();
            parse_distance_grid(&changed).unwrap_err().to_string()
        };
        assert!(replaced("0 3 0 2", "0 30000 0 200000").contains("at most 4294967295"));
        assert!(replaced("0 3 0 2", "0 4 0 2").contains("120 bytes for [5, 3, 2] nodes"));
        assert!(replaced("0.25 0.25 0.25", "0.25 0.5 0.25").contains("one spacing"));
        assert!(replaced("offset=\"0\"", "offset=\"18446744073709551615\"").contains("bytes of distances"));
        assert!(replaced("Float32", "Float64").contains("Float32 without compression"));
        assert!(replaced("\"distance\" f", "\"density\" f").contains("no array `distance`"));
        assert!(replaced("0 3 0 2", "0 -9 x").contains("6 numbers"));
    }

    #[test]
    fn numbers_of_another_length_and_other_formats_are_refused() {
        let path = Path::new("field.vti");
        let error = write_distance_grid(path, &field(DVec3::ZERO), Some(&[1]), false).unwrap_err();
        assert!(matches!(error, Error::LengthMismatch { expected: 24, .. }));
        assert!(write_distance_grid(Path::new("field.ply"), &field(DVec3::ZERO), None, false).is_err());
        assert!(read_distance_grid(Path::new("field.npz")).unwrap_err().to_string().contains(".vti"));
    }
}
