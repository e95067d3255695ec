//! PLY files as we write them: f32 where the origin is zero, else f64 world coordinates.

use std::io::{self, Write};

use glam::{DVec3, Vec3};

use crate::geometry::{Attribute, Column};
use crate::io::text::{Exact, ExactF32};
use crate::{PointCloud, TriMesh};

/// Writes a cloud; `ascii` instead of binary little-endian.
pub(crate) fn write_cloud(cloud: &PointCloud, ascii: bool, w: &mut dyn Write) -> io::Result<()> {
    let vertices = Vertices {
        origin: cloud.origin,
        points: &cloud.points,
        normals: cloud.normals.as_deref(),
        colors: cloud.colors.as_deref(),
        attributes: &cloud.attributes,
    };
    start(ascii, w)?;
    vertices.write_header(w)?;
    w.write_all(b"end_header\n")?;
    vertices.write_body(&mut Out { w, ascii, begun: false })
}

/// Writes a mesh; `ascii` instead of binary little-endian.
pub(crate) fn write_mesh(mesh: &TriMesh, ascii: bool, w: &mut dyn Write) -> io::Result<()> {
    let vertices = Vertices {
        origin: mesh.origin,
        points: &mesh.vertices,
        normals: mesh.normals.as_deref(),
        colors: mesh.colors.as_deref(),
        attributes: &[],
    };
    start(ascii, w)?;
    vertices.write_header(w)?;
    // Most programs expect the signed type; beyond its range only the unsigned one is right.
    let index_type = if mesh.vertices.len() <= i32::MAX as usize { "int" } else { "uint" };
    write!(w, "element face {}\nproperty list uchar {index_type} vertex_indices\nend_header\n", mesh.triangles.len())?;
    let mut out = Out { w, ascii, begun: false };
    vertices.write_body(&mut out)?;
    for triangle in &mesh.triangles {
        out.put(&[3], 3)?;
        for &vertex in triangle {
            out.put(&vertex.to_le_bytes(), vertex)?;
        }
        out.end_record()?;
    }
    Ok(())
}

fn start(ascii: bool, w: &mut dyn Write) -> io::Result<()> {
    let encoding = if ascii { "ascii" } else { "binary_little_endian" };
    write!(w, "ply\nformat {encoding} 1.0\ncomment written by nearfield\n")
}

struct Vertices<'a> {
    origin: DVec3,
    points: &'a [Vec3],
    normals: Option<&'a [Vec3]>,
    colors: Option<&'a [[u8; 4]]>,
    attributes: &'a [Attribute],
}

impl Vertices<'_> {
    fn is_far(&self) -> bool {
        self.origin != DVec3::ZERO
    }

    /// Alpha is written only where it says something.
    fn n_channels(&self) -> usize {
        self.colors.map_or(0, |colors| if colors.iter().all(|c| c[3] == 255) { 3 } else { 4 })
    }

    fn write_header(&self, w: &mut dyn Write) -> io::Result<()> {
        writeln!(w, "element vertex {}", self.points.len())?;
        let position = if self.is_far() { "double" } else { "float" };
        for axis in ["x", "y", "z"] {
            writeln!(w, "property {position} {axis}")?;
        }
        if self.normals.is_some() {
            w.write_all(b"property float nx\nproperty float ny\nproperty float nz\n")?;
        }
        for channel in &["red", "green", "blue", "alpha"][..self.n_channels()] {
            writeln!(w, "property uchar {channel}")?;
        }
        for attribute in self.attributes {
            let name = attribute.name.replace(|c: char| c.is_whitespace() || c.is_control(), "_");
            let name = if name.is_empty() { "attribute" } else { &name };
            writeln!(w, "property {} {name}", type_name(&attribute.values))?;
        }
        Ok(())
    }

    fn write_body(&self, out: &mut Out<'_>) -> io::Result<()> {
        let n_channels = self.n_channels();
        for (i, point) in self.points.iter().enumerate() {
            if self.is_far() {
                for c in (self.origin + point.as_dvec3()).to_array() {
                    out.put(&c.to_le_bytes(), Exact(c))?;
                }
            } else {
                out.vector(*point)?;
            }
            if let Some(normals) = self.normals {
                out.vector(normals[i])?;
            }
            if let Some(colors) = self.colors {
                for &channel in &colors[i][..n_channels] {
                    out.put(&[channel], channel)?;
                }
            }
            for attribute in self.attributes {
                out.value(&attribute.values, i)?;
            }
            out.end_record()?;
        }
        Ok(())
    }
}

fn type_name(column: &Column) -> &'static str {
    match column {
        Column::I8(_) => "char",
        Column::U8(_) => "uchar",
        Column::I16(_) => "short",
        Column::U16(_) => "ushort",
        Column::I32(_) => "int",
        Column::U32(_) => "uint",
        Column::F32(_) => "float",
        Column::F64(_) => "double",
    }
}

/// Values one after the other, as bytes or as words.
struct Out<'a> {
    w: &'a mut dyn Write,
    ascii: bool,
    /// Whether the line has a word already.
    begun: bool,
}

impl Out<'_> {
    fn put(&mut self, bytes: &[u8], text: impl std::fmt::Display) -> io::Result<()> {
        if !self.ascii {
            return self.w.write_all(bytes);
        }
        let separator = if self.begun { " " } else { "" };
        self.begun = true;
        write!(self.w, "{separator}{text}")
    }

    fn vector(&mut self, vector: Vec3) -> io::Result<()> {
        vector.to_array().iter().try_for_each(|&c| self.put(&c.to_le_bytes(), ExactF32(c)))
    }

    fn value(&mut self, column: &Column, i: usize) -> io::Result<()> {
        match column {
            Column::I8(v) => self.put(&v[i].to_le_bytes(), v[i]),
            Column::U8(v) => self.put(&v[i].to_le_bytes(), v[i]),
            Column::I16(v) => self.put(&v[i].to_le_bytes(), v[i]),
            Column::U16(v) => self.put(&v[i].to_le_bytes(), v[i]),
            Column::I32(v) => self.put(&v[i].to_le_bytes(), v[i]),
            Column::U32(v) => self.put(&v[i].to_le_bytes(), v[i]),
            Column::F32(v) => self.put(&v[i].to_le_bytes(), ExactF32(v[i])),
            Column::F64(v) => self.put(&v[i].to_le_bytes(), Exact(v[i])),
        }
    }

    fn end_record(&mut self) -> io::Result<()> {
        self.begun = false;
        if self.ascii { self.w.write_all(b"\n") } else { Ok(()) }
    }
}
