//! A cloud or a mesh to VTP: arrays as they are in memory, behind the XML ("appended raw"), each with its size in 64 bits before it.

use std::io::{self, Write};

use glam::{DVec3, Vec3};

use crate::geometry::{Column, PointCloud, TriMesh};
use crate::io::columns::{check_equal, check_lengths, distinct_names};

/// Bytes gathered before each write.
const BLOCK: usize = 1 << 18;

/// Writes a cloud.
///
/// # Errors
/// `InvalidInput` if a column has another length than the points, and what `out` returns.
pub(crate) fn write_cloud(cloud: &PointCloud, out: &mut dyn Write) -> io::Result<()> {
    check_lengths(cloud)?;
    let mut point_data = standard_arrays(cloud.normals.as_deref(), cloud.colors.as_deref());
    let names = distinct_names(&cloud.attributes, &["normals", "colors"], clean_name);
    for (name, attribute) in names.into_iter().zip(&cloud.attributes) {
        point_data.push(Array { name, components: 1, values: Values::from(&attribute.values) });
    }
    let points = positions(cloud.origin, &cloud.points);
    write(&Piece { n_points: cloud.len(), points, point_data, cells: Cells::Vertices(cloud.len()) }, out)
}

/// Writes a mesh.
///
/// # Errors
/// `InvalidInput` if normals or colours have another length than the vertices, and what `out` returns.
pub(crate) fn write_mesh(mesh: &TriMesh, out: &mut dyn Write) -> io::Result<()> {
    let columns =
        (mesh.normals.iter().map(|n| ("normals", n.len()))).chain(mesh.colors.iter().map(|c| ("colors", c.len())));
    check_equal(columns, mesh.vertices.len())?;
    let point_data = standard_arrays(mesh.normals.as_deref(), mesh.colors.as_deref());
    let points = positions(mesh.origin, &mesh.vertices);
    write(&Piece { n_points: mesh.vertices.len(), points, point_data, cells: Cells::Triangles(&mesh.triangles) }, out)
}

/// The geometry of a file.
struct Piece<'a> {
    n_points: usize,
    points: Array<'a>,
    point_data: Vec<Array<'a>>,
    cells: Cells<'a>,
}

/// A named array of the file.
struct Array<'a> {
    name: String,
    components: usize,
    values: Values<'a>,
}

/// What the points are joined to.
#[derive(Clone, Copy)]
enum Cells<'a> {
    Vertices(usize),
    Triangles(&'a [[u32; 3]]),
}

/// Where the numbers of an array come from.
enum Values<'a> {
    /// Numbers as they are in memory, with VTK's name of their type.
    Memory(&'static str, &'a [u8]),
    /// f64 world coordinates.
    World(DVec3, &'a [Vec3]),
    /// i64: 0, step, 2 step …; starting at `first`.
    Sequence { first: usize, step: usize, len: usize },
    /// i64 point indices of triangles.
    Corners(&'a [[u32; 3]]),
}

impl<'a> From<&'a Column> for Values<'a> {
    fn from(column: &'a Column) -> Self {
        match column {
            Column::I8(values) => Values::Memory("Int8", bytemuck::cast_slice(values)),
            Column::U8(values) => Values::Memory("UInt8", values),
            Column::I16(values) => Values::Memory("Int16", bytemuck::cast_slice(values)),
            Column::U16(values) => Values::Memory("UInt16", bytemuck::cast_slice(values)),
            Column::I32(values) => Values::Memory("Int32", bytemuck::cast_slice(values)),
            Column::U32(values) => Values::Memory("UInt32", bytemuck::cast_slice(values)),
            Column::F32(values) => Values::Memory("Float32", bytemuck::cast_slice(values)),
            Column::F64(values) => Values::Memory("Float64", bytemuck::cast_slice(values)),
        }
    }
}

fn standard_arrays<'a>(normals: Option<&'a [Vec3]>, colors: Option<&'a [[u8; 4]]>) -> Vec<Array<'a>> {
    let normals = normals.map(|normals| Array {
        name: "normals".into(),
        components: 3,
        values: Values::Memory("Float32", bytemuck::cast_slice(normals)),
    });
    let colors = colors.map(|colors| Array {
        name: "colors".into(),
        components: 4,
        values: Values::Memory("UInt8", colors.as_flattened()),
    });
    normals.into_iter().chain(colors).collect()
}

fn positions(origin: DVec3, points: &[Vec3]) -> Array<'_> {
    let values = if origin == DVec3::ZERO {
        Values::Memory("Float32", bytemuck::cast_slice(points))
    } else {
        Values::World(origin, points)
    };
    Array { name: "Points".into(), components: 3, values }
}

/// A name that XML can hold: control characters become `_`.
fn clean_name(name: &str) -> String {
    name.replace(|c: char| c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}'), "_")
}

fn escaped(name: &str) -> String {
    name.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

impl Cells<'_> {
    /// The two arrays that describe the cells: their points one after the other, and where each cell ends.
    fn arrays(&self) -> [Array<'_>; 2] {
        let array = |name: &str, values| Array { name: name.to_owned(), components: 1, values };
        let (corners, per_cell, len) = match *self {
            Cells::Vertices(n) => (Values::Sequence { first: 0, step: 1, len: n }, 1, n),
            Cells::Triangles(triangles) => (Values::Corners(triangles), 3, triangles.len()),
        };
        let ends = Values::Sequence { first: per_cell, step: per_cell, len };
        [array("connectivity", corners), array("offsets", ends)]
    }
}

impl Values<'_> {
    fn kind(&self) -> &'static str {
        match self {
            Values::Memory(kind, _) => kind,
            Values::World(..) => "Float64",
            Values::Sequence { .. } | Values::Corners(_) => "Int64",
        }
    }

    fn size(&self) -> u64 {
        match self {
            Values::Memory(_, bytes) => bytes.len() as u64,
            Values::World(_, points) => 24 * points.len() as u64,
            Values::Sequence { len, .. } => 8 * *len as u64,
            Values::Corners(triangles) => 24 * triangles.len() as u64,
        }
    }

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        match *self {
            Values::Memory(_, bytes) => out.write_all(bytes),
            Values::World(origin, points) => {
                let world = points.iter().flat_map(|p| (origin + p.as_dvec3()).to_array());
                write_blocks(out, world.map(f64::to_ne_bytes))
            }
            Values::Sequence { first, step, len } => {
                write_blocks(out, (0..len).map(|i| ((first + i * step) as i64).to_ne_bytes()))
            }
            Values::Corners(triangles) => {
                write_blocks(out, triangles.as_flattened().iter().map(|&i| i64::from(i).to_ne_bytes()))
            }
        }
    }
}

fn write_blocks(out: &mut dyn Write, values: impl Iterator<Item = [u8; 8]>) -> io::Result<()> {
    let mut block = Vec::with_capacity(BLOCK);
    for value in values {
        block.extend_from_slice(&value);
        if block.len() >= BLOCK {
            out.write_all(&block)?;
            block.clear();
        }
    }
    out.write_all(&block)
}

fn write(piece: &Piece<'_>, out: &mut dyn Write) -> io::Result<()> {
    let cells = piece.cells.arrays();
    let arrays: Vec<&Array<'_>> = piece.point_data.iter().chain([&piece.points]).chain(&cells).collect();
    let mut offset = 0;
    let mut elements = arrays.iter().map(|array| {
        let (kind, name, components) = (array.values.kind(), escaped(&array.name), array.components);
        let at = offset;
        offset += 8 + array.values.size();
        format!(
            "        <DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" \
             format=\"appended\" offset=\"{at}\"/>\n"
        )
    });
    let mut take = |n: usize| elements.by_ref().take(n).collect::<String>();
    let (point_data, points, cell_arrays) = (take(piece.point_data.len()), take(1), take(2));
    let n_points = piece.n_points;
    let (verts, polys, section) = match piece.cells {
        Cells::Vertices(n) => (n, 0, "Verts"),
        Cells::Triangles(triangles) => (0, triangles.len(), "Polys"),
    };
    let byte_order = if cfg!(target_endian = "big") { "BigEndian" } else { "LittleEndian" };
    let has = |name: &str| piece.point_data.iter().any(|array| array.name == name);
    let normals = if has("normals") { " Normals=\"normals\"" } else { "" };
    let scalars = if has("colors") { " Scalars=\"colors\"" } else { "" };
    write!(
        out,
        "<?xml version=\"1.0\"?>\n\
         <VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"{byte_order}\" header_type=\"UInt64\">\n  <PolyData>\n    \
         <Piece NumberOfPoints=\"{n_points}\" NumberOfVerts=\"{verts}\" NumberOfLines=\"0\" NumberOfStrips=\"0\" \
         NumberOfPolys=\"{polys}\">\n      \
         <PointData{normals}{scalars}>\n{point_data}      </PointData>\n      \
         <Points>\n{points}      </Points>\n      \
         <{section}>\n{cell_arrays}      </{section}>\n    \
         </Piece>\n  </PolyData>\n  <AppendedData encoding=\"raw\">\n_"
    )?;
    for array in arrays {
        out.write_all(&array.values.size().to_ne_bytes())?;
        array.values.write(out)?;
    }
    out.write_all(b"\n  </AppendedData>\n</VTKFile>\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Attribute;

    /// The text before the numbers, and the numbers.
    fn halves(bytes: &[u8]) -> (String, &[u8]) {
        let mark = b"<AppendedData encoding=\"raw\">\n_";
        let at = bytes.windows(mark.len()).position(|w| w == mark).unwrap() + mark.len();
        (String::from_utf8(bytes[..at].to_vec()).unwrap(), &bytes[at..])
    }

    /// Type and content of the array called `name`, found as a reader finds it: by the offset in the XML and the size
    /// before the content.
    fn array<'a>(text: &str, appended: &'a [u8], name: &str) -> (String, &'a [u8]) {
        let line = text.lines().find(|l| l.contains(&format!("Name=\"{name}\""))).expect("the array should be there");
        let value = |key: &str| line.split(&format!("{key}=\"")).nth(1).unwrap().split('"').next().unwrap().to_owned();
        let offset: usize = value("offset").parse().unwrap();
        let size = u64::from_ne_bytes(appended[offset..offset + 8].try_into().unwrap()) as usize;
        (value("type"), &appended[offset + 8..offset + 8 + size])
    }

    fn doubles(bytes: &[u8]) -> Vec<f64> {
        bytes.chunks_exact(8).map(|b| f64::from_ne_bytes(b.try_into().unwrap())).collect()
    }

    fn integers(bytes: &[u8]) -> Vec<i64> {
        bytes.chunks_exact(8).map(|b| i64::from_ne_bytes(b.try_into().unwrap())).collect()
    }

    #[test]
    fn a_cloud_has_its_arrays_at_the_offsets_of_the_xml() {
        let mut cloud = PointCloud::new(vec![Vec3::new(1.0, 2.0, 3.0), Vec3::new(-0.5, f32::NAN, 0.25)]);
        cloud.origin = DVec3::new(600_000.0, 5_000_000.0, 0.0);
        cloud.normals = Some(vec![Vec3::X, Vec3::Z]);
        cloud.colors = Some(vec![[1, 2, 3, 4], [5, 6, 7, 8]]);
        cloud.attributes = vec![Attribute { name: "a<\"b\">&c".into(), values: Column::I16(vec![-1, 300]) }];
        let mut bytes = vec![];
        write_cloud(&cloud, &mut bytes).unwrap();
        let (text, appended) = halves(&bytes);
        assert!(text.contains("NumberOfPoints=\"2\" NumberOfVerts=\"2\""));
        assert!(text.contains("<PointData Normals=\"normals\" Scalars=\"colors\">"));
        let (kind, content) = array(&text, appended, "Points");
        let world = doubles(content);
        assert_eq!((kind.as_str(), &world[..4]), ("Float64", &[600_001.0, 5_000_002.0, 3.0, 599_999.5][..]));
        assert!(world[4].is_nan() && world[5] == 0.25);
        assert_eq!(array(&text, appended, "colors"), ("UInt8".into(), &[1, 2, 3, 4, 5, 6, 7, 8][..]));
        let (kind, content) = array(&text, appended, "a&lt;&quot;b&quot;&gt;&amp;c");
        assert_eq!((kind.as_str(), content), ("Int16", [(-1_i16).to_ne_bytes(), 300_i16.to_ne_bytes()].as_flattened()));
        assert_eq!(integers(array(&text, appended, "connectivity").1), [0, 1]);
        assert_eq!(integers(array(&text, appended, "offsets").1), [1, 2]);
        assert!(bytes.ends_with(b"</VTKFile>\n"));
    }

    #[test]
    fn a_cloud_at_the_origin_stays_single_precision() {
        let mut bytes = vec![];
        write_cloud(&PointCloud::new(vec![Vec3::new(0.1, 0.2, 0.3)]), &mut bytes).unwrap();
        let (text, appended) = halves(&bytes);
        let expected = [0.1_f32, 0.2, 0.3].map(f32::to_ne_bytes);
        assert_eq!(array(&text, appended, "Points"), ("Float32".into(), expected.as_flattened()));
    }

    #[test]
    fn a_mesh_has_three_corners_a_cell() {
        let mesh = TriMesh::new(vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z], vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        let mut bytes = vec![];
        write_mesh(&mesh, &mut bytes).unwrap();
        let (text, appended) = halves(&bytes);
        assert!(text.contains("NumberOfPoints=\"4\" NumberOfVerts=\"0\""));
        assert!(text.contains("NumberOfPolys=\"2\"") && text.contains("<Polys>"));
        assert_eq!(integers(array(&text, appended, "connectivity").1), [0, 1, 2, 0, 2, 3]);
        assert_eq!(integers(array(&text, appended, "offsets").1), [3, 6]);
    }

    #[test]
    fn columns_of_another_length_are_refused() {
        let mut mesh = TriMesh::new(vec![Vec3::ZERO; 3], vec![[0, 1, 2]]).unwrap();
        mesh.normals = Some(vec![Vec3::X; 2]);
        assert_eq!(write_mesh(&mesh, &mut vec![]).unwrap_err().kind(), io::ErrorKind::InvalidInput);
        let mut cloud = PointCloud::new(vec![Vec3::ZERO]);
        cloud.colors = Some(vec![]);
        assert_eq!(write_cloud(&cloud, &mut vec![]).unwrap_err().kind(), io::ErrorKind::InvalidInput);
    }
}
