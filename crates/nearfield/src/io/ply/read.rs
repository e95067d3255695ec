//! From the columns of a file to a cloud or a mesh.

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::NAME;
use super::body::{Ascii, Binary, Lists, SEPARATOR, Source, Values, read_element};
use super::header::{self, Element, Encoding, Header, Kind};
use crate::error::{FileError, Place, Result};
use crate::geometry::{Attribute, Column};
use crate::io::text::{Lines, shown};
use crate::io::{Polygons, colors};
use crate::{PointCloud, TriMesh};

/// All vertices with normals, colours and, as attributes, every other scalar.
pub(crate) fn read_cloud(bytes: &[u8]) -> Result<PointCloud> {
    Ok(read(bytes, Polygons::Fans)?.0)
}

/// The faces, polygons and strips cut into triangles, with normals and colours of the vertices.
pub(crate) fn read_mesh(bytes: &[u8], polygons: Polygons) -> Result<TriMesh> {
    let (cloud, triangles) = read(bytes, polygons)?;
    let Some(triangles) = triangles else {
        let expected = "faces: an element with a list \"vertex_indices\" or \"tristrips\"";
        return Err(FileError::new(NAME, Place::Whole, "only points", expected).into());
    };
    let PointCloud { origin, points: vertices, normals, colors, .. } = cloud;
    Ok(TriMesh { origin, vertices, triangles, normals, colors })
}

fn read(bytes: &[u8], polygons: Polygons) -> Result<(PointCloud, Option<Vec<[u32; 3]>>)> {
    let mut lines = Lines::new(bytes);
    let header = header::read(&mut lines)?;
    let body = bytes.len() - lines.rest().len();
    match header.encoding {
        Encoding::Ascii => read_elements(&header, Ascii::new(lines), polygons),
        _ => read_elements(&header, Binary::new(bytes, body, &header), polygons),
    }
}

fn read_elements(
    header: &Header,
    mut source: impl Source,
    polygons: Polygons,
) -> Result<(PointCloud, Option<Vec<[u32; 3]>>)> {
    let Some(vertex) = header.elements.iter().find(|e| e.name == "vertex") else {
        return Err(FileError::new(NAME, Place::Whole, "no element \"vertex\"", "one with x, y and z").into());
    };
    check_index_types(header)?;
    // The greatest u32 is kept for the separator of strips.
    let n_vertices = vertex.count.min(u64::from(SEPARATOR)) as i64;
    let mut cloud = None;
    let mut triangles = None;
    for element in &header.elements {
        let is_vertex = element.name == "vertex" && cloud.is_none();
        let wanted = |name: &str| index_range(element, name, n_vertices).filter(|_| !is_vertex);
        let table = read_element(&mut source, element, wanted)?;
        if is_vertex {
            cloud = Some(cloud_from(element, table.columns)?);
            continue;
        }
        for (values, property) in table.columns.iter().zip(&element.properties) {
            if let Values::Lists(lists, _) = values {
                let triangles = triangles.get_or_insert_with(Vec::new);
                if is_strips(element, &property.name) {
                    cut_strips(lists, triangles);
                } else {
                    cut_polygons(lists, polygons, triangles);
                }
            }
        }
    }
    let cloud = cloud.expect("the vertex element found above should have been read");
    Ok((cloud, triangles))
}

/// What the items of a list may be, if the list is one of vertex indices.
fn index_range(element: &Element, property: &str, n_vertices: i64) -> Option<Range<i64>> {
    if is_strips(element, property) {
        return Some(-1..n_vertices);
    }
    matches!(property, "vertex_indices" | "vertex_index").then_some(0..n_vertices)
}

/// Strips are named by their element, their property or both.
fn is_strips(element: &Element, property: &str) -> bool {
    property == "tristrips" || (element.name == "tristrips" && property.starts_with("vertex_ind"))
}

fn check_index_types(header: &Header) -> Result<()> {
    for element in header.elements.iter().filter(|e| e.name != "vertex") {
        for property in element.properties.iter().filter(|p| index_range(element, &p.name, 1).is_some()) {
            let found = match property.kind {
                Kind::List { item, .. } if item.is_integer() => continue,
                Kind::List { item, .. } => format!("a list of {item:?}"),
                Kind::Scalar(scalar) => format!("one {scalar:?}"),
            };
            let expected = format!("a list of an integer type for {:?}", property.name);
            return Err(FileError::new(NAME, Place::Line(element.line), found, expected).into());
        }
    }
    Ok(())
}

fn cut_polygons(lists: &Lists, polygons: Polygons, triangles: &mut Vec<[u32; 3]>) {
    let most = if polygons == Polygons::Fans { usize::MAX } else { 1 };
    let of_face = |&length: &u32| (length as usize).saturating_sub(2).min(most);
    triangles.reserve_exact(lists.lengths.iter().map(of_face).sum());
    let mut rest = &lists.items[..];
    for &length in &lists.lengths {
        let (polygon, behind) = rest.split_at(length as usize);
        rest = behind;
        if let Some((&first, others)) = polygon.split_first() {
            triangles.extend(others.windows(2).take(most).map(|edge| [first, edge[0], edge[1]]));
        }
    }
}

fn cut_strips(lists: &Lists, triangles: &mut Vec<[u32; 3]>) {
    let mut rest = &lists.items[..];
    for &length in &lists.lengths {
        let (strips, behind) = rest.split_at(length as usize);
        rest = behind;
        for strip in strips.split(|&v| v == SEPARATOR) {
            for (i, corners) in strip.windows(3).enumerate() {
                let [a, b, c] = [corners[0], corners[1], corners[2]];
                // Every second triangle of a strip runs the other way round.
                triangles.push(if i % 2 == 0 { [a, b, c] } else { [b, a, c] });
            }
        }
    }
}

fn cloud_from(element: &Element, columns: Vec<Values>) -> Result<PointCloud> {
    let mut named: Vec<(String, Column)> = element
        .properties
        .iter()
        .zip(columns)
        .filter_map(|(property, values)| match values {
            Values::Scalars(column) => Some((property.name.clone(), column)),
            _ => None,
        })
        .collect();
    let Some([x, y, z]) = take_vector(&mut named, ["x", "y", "z"]) else {
        // An element of no record may leave its properties out.
        if element.count == 0 {
            return Ok(PointCloud::default());
        }
        let found: Vec<&str> = element.properties.iter().map(|p| p.name.as_str()).collect();
        let found = format!("vertex properties {}", shown(found.join(" ").as_bytes()));
        return Err(FileError::new(NAME, Place::Line(element.line), found, "x, y and z among them").into());
    };
    let coordinates: Vec<DVec3> = vectors([&x, &y, &z]).collect();
    drop((x, y, z));
    let mut cloud = PointCloud::from_world(&coordinates);
    drop(coordinates);

    let normals = take_vector(&mut named, ["nx", "ny", "nz"])
        .or_else(|| take_vector(&mut named, ["normal_x", "normal_y", "normal_z"]));
    if let Some([x, y, z]) = &normals {
        cloud.normals = Some(vectors([x, y, z]).map(|n| n.as_vec3()).collect::<Vec<Vec3>>());
    }
    cloud.colors = take_colors(&mut named, cloud.len());
    let attribute = |(name, values)| Attribute { name, values };
    cloud.attributes = named.into_iter().map(attribute).collect();
    Ok(cloud)
}

/// Takes three columns out by their names, if all are there.
fn take_vector(named: &mut Vec<(String, Column)>, names: [&str; 3]) -> Option<[Column; 3]> {
    if names.iter().any(|wanted| named.iter().all(|(name, _)| name != wanted)) {
        return None;
    }
    let mut take = |wanted: &str| {
        let at = named.iter().position(|(name, _)| name == wanted)?;
        Some(named.remove(at).1)
    };
    Some([take(names[0])?, take(names[1])?, take(names[2])?])
}

fn vectors(axes: [&Column; 3]) -> impl Iterator<Item = DVec3> {
    let at = |column: &Column, i: usize| column.get(i).unwrap_or(f64::NAN);
    (0..axes[0].len()).map(move |i| DVec3::new(at(axes[0], i), at(axes[1], i), at(axes[2], i)))
}

/// Takes red, green, blue and alpha out of the columns, if the first three are there.
fn take_colors(named: &mut Vec<(String, Column)>, n: usize) -> Option<Vec<[u8; 4]>> {
    let mut channels: [Option<usize>; 4] = [None; 4];
    for (i, (name, _)) in named.iter().enumerate() {
        if let Some(channel) = colors::channel(name) {
            channels[channel].get_or_insert(i);
        }
    }
    let [Some(_), Some(_), Some(_), _] = channels else { return None };
    let mut result = vec![[0, 0, 0, 255]; n];
    for (channel, at) in channels.iter().enumerate() {
        let Some((_, column)) = at.and_then(|at| named.get(at)) else { continue };
        for (i, color) in result.iter_mut().enumerate() {
            color[channel] = byte(column, i);
        }
    }
    let mut i = 0;
    named.retain(|_| {
        i += 1;
        !channels.contains(&Some(i - 1))
    });
    Some(result)
}

/// A colour as PLY writers mean it: floats are 0 … 1, 16-bit integers use their whole range.
fn byte(column: &Column, i: usize) -> u8 {
    match column {
        Column::U8(values) => values[i],
        Column::U16(values) => (values[i] >> 8) as u8,
        Column::F32(values) => colors::from_unit(values[i].into()),
        Column::F64(values) => colors::from_unit(values[i]),
        other => colors::from_byte_range(other.get(i).unwrap_or(0.0)),
    }
}
