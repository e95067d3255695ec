//! A cloud to PCD bytes.

use std::io::{self, Write};

use crate::geometry::{Column, PointCloud};
use crate::io::columns::{check_lengths, distinct_names};

/// Bytes gathered before each write.
const BLOCK: usize = 1 << 18;

/// Writes a binary PCD file.
///
/// Positions are doubles in world coordinates where the origin is not zero, else floats; normals are floats, colours
/// one packed `rgba`, attributes fields of their own type. An attribute whose name PCD cannot hold is renamed: white
/// space becomes `_`, and a clash gets a number.
///
/// # Errors
/// `InvalidInput` if a column has another length than the points, and what `out` returns.
pub(crate) fn write(cloud: &PointCloud, out: &mut dyn Write) -> io::Result<()> {
    check_lengths(cloud)?;
    let fields = fields(cloud);
    out.write_all(header(&fields, cloud.len()).as_bytes())?;
    let record_size: usize = fields.iter().map(|field| field.size).sum();
    let mut block = Vec::with_capacity(BLOCK + record_size);
    let doubles = cloud.origin != glam::DVec3::ZERO;
    for i in 0..cloud.len() {
        if doubles {
            block.extend(cloud.world(i).to_array().iter().flat_map(|c| c.to_le_bytes()));
        } else {
            block.extend(cloud.points[i].to_array().iter().flat_map(|c| c.to_le_bytes()));
        }
        if let Some(normals) = &cloud.normals {
            block.extend(normals[i].to_array().iter().flat_map(|c| c.to_le_bytes()));
        }
        if let Some(colors) = &cloud.colors {
            let [red, green, blue, alpha] = colors[i];
            block.extend([blue, green, red, alpha]);
        }
        for attribute in &cloud.attributes {
            match &attribute.values {
                Column::I8(values) => block.extend(values[i].to_le_bytes()),
                Column::U8(values) => block.push(values[i]),
                Column::I16(values) => block.extend(values[i].to_le_bytes()),
                Column::U16(values) => block.extend(values[i].to_le_bytes()),
                Column::I32(values) => block.extend(values[i].to_le_bytes()),
                Column::U32(values) => block.extend(values[i].to_le_bytes()),
                Column::F32(values) => block.extend(values[i].to_le_bytes()),
                Column::F64(values) => block.extend(values[i].to_le_bytes()),
            }
        }
        if block.len() >= BLOCK {
            out.write_all(&block)?;
            block.clear();
        }
    }
    out.write_all(&block)
}

/// A field of the header.
struct Field {
    name: String,
    kind: char,
    size: usize,
}

fn fields(cloud: &PointCloud) -> Vec<Field> {
    let field = |name: &str, kind, size| Field { name: name.to_owned(), kind, size };
    let position_size = if cloud.origin == glam::DVec3::ZERO { 4 } else { 8 };
    let mut fields = Vec::from(["x", "y", "z"].map(|name| field(name, 'F', position_size)));
    if cloud.normals.is_some() {
        fields.extend(["normal_x", "normal_y", "normal_z"].map(|name| field(name, 'F', 4)));
    }
    if cloud.colors.is_some() {
        fields.push(field("rgba", 'U', 4));
    }
    let reserved = ["x", "y", "z", "normal_x", "normal_y", "normal_z", "rgb", "rgba", "_"];
    let clean = |name: &str| name.replace(|c: char| c.is_whitespace() || c.is_control(), "_");
    let names = distinct_names(&cloud.attributes, &reserved, clean);
    for (name, attribute) in names.into_iter().zip(&cloud.attributes) {
        let (kind, size) = match attribute.values {
            Column::I8(_) => ('I', 1),
            Column::U8(_) => ('U', 1),
            Column::I16(_) => ('I', 2),
            Column::U16(_) => ('U', 2),
            Column::I32(_) => ('I', 4),
            Column::U32(_) => ('U', 4),
            Column::F32(_) => ('F', 4),
            Column::F64(_) => ('F', 8),
        };
        fields.push(Field { name, kind, size });
    }
    fields
}

fn header(fields: &[Field], points: usize) -> String {
    let line = |value: &dyn Fn(&Field) -> String| fields.iter().map(value).collect::<Vec<_>>().join(" ");
    let names = line(&|field| field.name.clone());
    let sizes = line(&|field| field.size.to_string());
    let kinds = line(&|field| field.kind.to_string());
    let counts = line(&|_| "1".to_owned());
    format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {names}\nSIZE {sizes}\nTYPE {kinds}\n\
         COUNT {counts}\nWIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA binary\n"
    )
}
