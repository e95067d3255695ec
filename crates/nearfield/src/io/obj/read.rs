//! Reading OBJ: one pass over the lines, indices checked at the end as they may name later vertices.
//!
//! Materials are names here; the parent module opens the files that say what they mean.

use std::collections::HashMap;

use glam::{DVec3, Vec3};

use super::NAME;
use crate::error::{FileError, Place, Result};
use crate::io::text::{Lines, number, parsed, shown, words};
use crate::io::{Polygons, colors, empty, mesh_from_world};
use crate::{PointCloud, TriMesh};

/// Every `v` line, with colours where all have them and normals where they are one to one.
pub(crate) fn read_cloud(bytes: &[u8]) -> Result<PointCloud> {
    let mut object = Object::default().read(bytes)?;
    let mut cloud = PointCloud::from_world(&object.positions);
    cloud.normals = object.vertex_normals();
    cloud.colors = object.take_colors();
    Ok(cloud)
}

/// The materials that an OBJ file names.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct NamedMaterials {
    /// Files of `mtllib` lines.
    pub(crate) libraries: Vec<String>,
    /// Names of `usemtl` lines, in order of first use, with the line that first uses each.
    pub(crate) names: Vec<(String, u64)>,
    /// `[triangles]` index into `names`, or `u32::MAX` before the first `usemtl`.
    pub(crate) name_of: Vec<u32>,
}

/// The faces as triangles over every `v` line.
pub(crate) fn read_mesh(bytes: &[u8], polygons: Polygons) -> Result<TriMesh> {
    read_faces(bytes, polygons).map(|(mesh, _)| mesh)
}

/// The faces as fans of triangles, with the name of each triangle's material.
pub(crate) fn read_named(bytes: &[u8]) -> Result<(TriMesh, NamedMaterials)> {
    read_faces(bytes, Polygons::Fans)
}

fn read_faces(bytes: &[u8], polygons: Polygons) -> Result<(TriMesh, NamedMaterials)> {
    let mut object = Object { polygons, ..Object::default() }.read(bytes)?;
    if object.triangles.is_empty() {
        return Err(FileError::new(NAME, Place::Whole, "no faces", "\"f\" lines of three or more corners").into());
    }
    let normals = object.vertex_normals();
    let mut mesh = mesh_from_world(&object.positions, std::mem::take(&mut object.triangles));
    mesh.normals = normals;
    mesh.colors = object.take_colors();
    Ok((mesh, object.materials))
}

#[derive(Default)]
struct Object {
    positions: Vec<DVec3>,
    colors: Vec<[u8; 4]>,
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    /// Normals of the corners of `triangles`; dropped at the first corner that names none.
    corner_normals: Vec<[u32; 3]>,
    some_corner_has_no_normal: bool,
    largest_vertex: Option<Named>,
    largest_normal: Option<Named>,
    materials: NamedMaterials,
    /// The name in force.
    material: Option<u32>,
    known: HashMap<String, u32>,
    polygons: Polygons,
}

/// An index (from 0) and the line that names it.
#[derive(Clone, Copy)]
struct Named {
    index: u32,
    line: u64,
}

impl Object {
    fn read(self, bytes: &[u8]) -> Result<Self> {
        if bytes.is_empty() {
            return Err(empty(NAME, "\"v\" lines").into());
        }
        let mut object = self;
        let mut joined: Vec<u8> = vec![];
        for (n, line) in Lines::new(bytes) {
            // A backslash at the end of a line joins it with the next.
            if let Some(begun) = line.strip_suffix(b"\\") {
                joined.extend_from_slice(begun);
                joined.push(b' ');
            } else if joined.is_empty() {
                object.take_line(n, line)?;
            } else {
                joined.extend_from_slice(line);
                object.take_line(n, &joined)?;
                joined.clear();
            }
        }
        if object.positions.is_empty() {
            return Err(FileError::new(NAME, Place::Whole, "no vertices", "\"v\" lines").into());
        }
        check_range(object.largest_vertex, object.positions.len(), "vertex")?;
        check_range(object.largest_normal, object.normals.len(), "normal")?;
        Ok(object)
    }

    fn take_line(&mut self, line: u64, text: &[u8]) -> Result<()> {
        let text = text.split(|&b| b == b'#').next().unwrap_or_default();
        let mut rest = words(text);
        match rest.next() {
            Some(b"v") => self.take_vertex(line, rest),
            Some(b"vn") => {
                let [x, y, z] = three(line, &mut rest, "a normal")?;
                self.normals.push(DVec3::new(x, y, z).as_vec3());
                Ok(())
            }
            Some(b"f") => self.take_face(line, rest),
            Some(b"mtllib") => {
                self.materials.libraries.push(name_after(text, b"mtllib"));
                Ok(())
            }
            Some(b"usemtl") => {
                let name = name_after(text, b"usemtl");
                let next = self.materials.names.len() as u32;
                let number = *self.known.entry(name.clone()).or_insert(next);
                if number == next {
                    self.materials.names.push((name, line));
                }
                self.material = Some(number);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn take_vertex<'a>(&mut self, line: u64, mut rest: impl Iterator<Item = &'a [u8]>) -> Result<()> {
        let [x, y, z] = three(line, &mut rest, "a vertex")?;
        self.positions.push(DVec3::new(x, y, z));
        // Behind the position stands nothing, a weight, or a colour in 0 … 1.
        if let (Some(r), Some(g), Some(b)) = (rest.next(), rest.next(), rest.next()) {
            let channel = |word| number(NAME, line, word, "a color").map(colors::from_unit);
            let color = [channel(r)?, channel(g)?, channel(b)?, 255];
            if self.colors.len() + 1 == self.positions.len() {
                self.colors.push(color);
            }
        }
        Ok(())
    }

    fn take_face<'a>(&mut self, line: u64, corners: impl Iterator<Item = &'a [u8]>) -> Result<()> {
        let mut fan: Option<(u32, Option<u32>)> = None;
        let mut previous = None;
        let mut n_corners = 0;
        for word in corners {
            let corner = self.corner(line, word)?;
            n_corners += 1;
            match (fan, previous) {
                (None, _) => fan = Some(corner),
                (Some(_), None) => previous = Some(corner),
                (Some(first), Some(second)) => {
                    if n_corners == 3 || self.polygons == Polygons::Fans {
                        self.add_triangle([first, second, corner]);
                    }
                    previous = Some(corner);
                }
            }
        }
        if n_corners < 3 {
            let found = format!("a face of {n_corners} corners");
            return Err(FileError::new(NAME, Place::Line(line), found, "3 corners or more").into());
        }
        Ok(())
    }

    fn add_triangle(&mut self, corners: [(u32, Option<u32>); 3]) {
        self.triangles.push(corners.map(|(vertex, _)| vertex));
        self.materials.name_of.push(self.material.unwrap_or(u32::MAX));
        if self.some_corner_has_no_normal {
            return;
        }
        match corners.map(|(_, normal)| normal) {
            [Some(a), Some(b), Some(c)] => self.corner_normals.push([a, b, c]),
            _ => {
                self.some_corner_has_no_normal = true;
                self.corner_normals = vec![];
            }
        }
    }

    /// Reads `v`, `v/t`, `v//n` or `v/t/n`.
    fn corner(&mut self, line: u64, word: &[u8]) -> Result<(u32, Option<u32>)> {
        let mut parts = word.split(|&b| b == b'/');
        let vertex = resolve(line, parts.next().unwrap_or_default(), word, self.positions.len())?;
        let _texture = parts.next();
        let normal = match parts.next() {
            None | Some(b"") => None,
            Some(part) => Some(resolve(line, part, word, self.normals.len())?),
        };
        if self.largest_vertex.is_none_or(|largest| vertex > largest.index) {
            self.largest_vertex = Some(Named { index: vertex, line });
        }
        if let Some(index) = normal
            && self.largest_normal.is_none_or(|largest| index > largest.index)
        {
            self.largest_normal = Some(Named { index, line });
        }
        Ok((vertex, normal))
    }

    fn take_colors(&mut self) -> Option<Vec<[u8; 4]>> {
        (self.colors.len() == self.positions.len()).then(|| std::mem::take(&mut self.colors))
    }

    /// One normal a vertex, if the file says it without contradiction.
    fn vertex_normals(&self) -> Option<Vec<Vec3>> {
        if self.triangles.is_empty() {
            return (self.normals.len() == self.positions.len()).then(|| self.normals.clone());
        }
        if self.some_corner_has_no_normal {
            return None;
        }
        let mut of_vertex: Vec<Option<Vec3>> = vec![None; self.positions.len()];
        let mut read = vec![];
        for (vertices, normals) in self.triangles.iter().zip(&self.corner_normals) {
            for (&vertex, &normal) in vertices.iter().zip(normals) {
                let normal = self.normals[normal as usize];
                let seen = of_vertex[vertex as usize].get_or_insert(normal);
                if seen.to_array().map(f32::to_bits) != normal.to_array().map(f32::to_bits) {
                    return None;
                }
            }
        }
        for normal in of_vertex {
            read.push(normal?);
        }
        Some(read)
    }
}

/// What stands behind the key word, spaces inside it included.
pub(super) fn name_after(text: &[u8], key: &[u8]) -> String {
    let trimmed = text.trim_ascii();
    String::from_utf8_lossy(trimmed.strip_prefix(key).unwrap_or(trimmed).trim_ascii()).into_owned()
}

fn three<'a>(line: u64, rest: &mut impl Iterator<Item = &'a [u8]>, what: &str) -> Result<[f64; 3]> {
    let mut values = [0.0; 3];
    for (i, value) in values.iter_mut().enumerate() {
        let Some(word) = rest.next() else {
            let found = format!("{what} of {i} numbers");
            return Err(FileError::new(NAME, Place::Line(line), found, "x, y and z").into());
        };
        *value = number(NAME, line, word, ["x", "y", "z"][i])?;
    }
    Ok(values)
}

/// An index as written (from 1, or from −1 backwards over the `n` read so far) as one from 0.
fn resolve(line: u64, part: &[u8], word: &[u8], n: usize) -> Result<u32> {
    let error = |expected: String| FileError::new(NAME, Place::Line(line), shown(word), expected);
    let index: i64 = parsed(part).ok_or_else(|| error("a corner as v, v/t, v//n or v/t/n".into()))?;
    let from_zero = if index > 0 { index - 1 } else { (n as i64).saturating_add(index) };
    match u32::try_from(from_zero) {
        Ok(resolved) if index != 0 => Ok(resolved),
        _ => Err(error(format!("an index from 1, or from -1 back to -{n}")).into()),
    }
}

fn check_range(largest: Option<Named>, n: usize, what: &str) -> Result<()> {
    match largest {
        Some(Named { index, line }) if index as usize >= n => {
            let found = format!("{what} index {}", u64::from(index) + 1);
            let expected = format!("at most {n}, the number of them in the file");
            Err(FileError::new(NAME, Place::Line(line), found, expected).into())
        }
        _ => Ok(()),
    }
}
