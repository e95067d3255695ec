//! Writing OBJ: world coordinates with every digit that they need.

use std::io::{self, Write};

use glam::{DVec3, Vec3};

use crate::io::text::{Exact, ExactF32};
use crate::{PointCloud, TriMesh};

/// Writes a cloud as `v` and `vn` lines, colours behind the position; alpha and attributes have no place in the format.
pub(crate) fn write_cloud(cloud: &PointCloud, w: &mut dyn Write) -> io::Result<()> {
    write_vertices(cloud.origin, &cloud.points, cloud.normals.as_deref(), cloud.colors.as_deref(), w)
}

/// Writes a mesh as `v`, `vn` and `f` lines.
pub(crate) fn write_mesh(mesh: &TriMesh, w: &mut dyn Write) -> io::Result<()> {
    write_vertices(mesh.origin, &mesh.vertices, mesh.normals.as_deref(), mesh.colors.as_deref(), w)?;
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| u64::from(v) + 1);
        match mesh.normals {
            Some(_) => writeln!(w, "f {a}//{a} {b}//{b} {c}//{c}")?,
            None => writeln!(w, "f {a} {b} {c}")?,
        }
    }
    Ok(())
}

fn write_vertices(
    origin: DVec3,
    points: &[Vec3],
    normals: Option<&[Vec3]>,
    colors: Option<&[[u8; 4]]>,
    w: &mut dyn Write,
) -> io::Result<()> {
    for (i, point) in points.iter().enumerate() {
        let [x, y, z] = (origin + point.as_dvec3()).to_array().map(Exact);
        write!(w, "v {x} {y} {z}")?;
        if let Some(colors) = colors {
            let [r, g, b, _] = colors[i].map(|channel| ExactF32(f32::from(channel) / 255.0));
            write!(w, " {r} {g} {b}")?;
        }
        w.write_all(b"\n")?;
    }
    for normal in normals.unwrap_or_default() {
        let [x, y, z] = normal.to_array().map(ExactF32);
        writeln!(w, "vn {x} {y} {z}")?;
    }
    Ok(())
}
