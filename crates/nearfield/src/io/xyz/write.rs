//! Writing a table: world coordinates with every digit that they need.

use std::io::{self, Write};

use crate::PointCloud;
use crate::io::text::{Exact, ExactF32};

/// Writes points separated by spaces; a comment names the columns where there are more than x, y and z.
pub(crate) fn write_xyz(cloud: &PointCloud, w: &mut dyn Write) -> io::Result<()> {
    let names = column_names(cloud);
    if names.len() > 3 || cloud.is_empty() {
        writeln!(w, "# {}", names.join(" "))?;
    }
    write_rows(cloud, ' ', w)
}

/// Writes points separated by commas under a header.
pub(crate) fn write_csv(cloud: &PointCloud, w: &mut dyn Write) -> io::Result<()> {
    writeln!(w, "{}", column_names(cloud).join(","))?;
    write_rows(cloud, ',', w)
}

fn column_names(cloud: &PointCloud) -> Vec<String> {
    let mut names = vec!["x", "y", "z"];
    if cloud.normals.is_some() {
        names.extend(["nx", "ny", "nz"]);
    }
    if cloud.colors.is_some() {
        names.extend(["red", "green", "blue", "alpha"]);
    }
    let safe = |name: &str| match name {
        "" => "attribute".to_owned(),
        name => name.replace(|c: char| c.is_whitespace() || c.is_control() || ",;\"#/".contains(c), "_"),
    };
    let attributes = cloud.attributes.iter().map(|a| safe(&a.name));
    names.into_iter().map(str::to_owned).chain(attributes).collect()
}

fn write_rows(cloud: &PointCloud, separator: char, w: &mut dyn Write) -> io::Result<()> {
    for i in 0..cloud.len() {
        let [x, y, z] = cloud.world(i).to_array().map(Exact);
        write!(w, "{x}{separator}{y}{separator}{z}")?;
        if let Some(normals) = &cloud.normals {
            for c in normals[i].to_array() {
                write!(w, "{separator}{}", ExactF32(c))?;
            }
        }
        if let Some(colors) = &cloud.colors {
            for channel in colors[i] {
                write!(w, "{separator}{channel}")?;
            }
        }
        for value in cloud.attributes.iter().filter_map(|a| a.values.get(i)) {
            write!(w, "{separator}{}", Exact(value))?;
        }
        w.write_all(b"\n")?;
    }
    Ok(())
}
