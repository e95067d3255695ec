//! Reading a table: find separator and header, then a number for each field.

use glam::DVec3;

use crate::PointCloud;
use crate::error::{FileError, Place, Result};
use crate::geometry::{Attribute, Column};
use crate::io::text::{Lines, number, parsed, shown};
use crate::io::{colors, empty};

/// More than any real table; a line of single letters could otherwise declare millions.
const MAX_COLUMNS: usize = 1024;

/// Reads a table of points; `format` is the name for errors.
pub(crate) fn read(format: &'static str, bytes: &[u8]) -> Result<PointCloud> {
    if bytes.is_empty() {
        return Err(empty(format, "three numbers a line").into());
    }
    let mut table: Option<Table> = None;
    let mut header_in_comment = None;
    for (line_number, line) in Lines::new(bytes) {
        let line = line.trim_ascii();
        if let Some(comment) = line.strip_prefix(b"#").or_else(|| line.strip_prefix(b"//")) {
            if table.is_none() {
                header_in_comment = Header::in_comment(comment).or(header_in_comment);
            }
            continue;
        }
        if line.is_empty() {
            continue;
        }
        match &mut table {
            Some(table) => table.add(line_number, line)?,
            None => table = Some(Table::begin(format, line_number, line, header_in_comment.take())?),
        }
    }
    let header_only = header_in_comment.map(|header: Header| header.table(format, Separator::Spaces));
    match table.map(Ok).or(header_only).transpose()? {
        Some(table) => Ok(table.into_cloud()),
        None => Err(FileError::new(format, Place::Whole, "no line with numbers", "three numbers a line").into()),
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Separator {
    Spaces,
    Byte(u8),
}

impl Separator {
    fn of(line: &[u8]) -> Self {
        let known = [b';', b','].into_iter().find(|separator| line.contains(separator));
        known.map_or(Separator::Spaces, Separator::Byte)
    }

    fn split(self, line: &[u8]) -> impl Iterator<Item = &[u8]> {
        let ends = move |b: &u8| match self {
            Separator::Spaces => b.is_ascii_whitespace(),
            Separator::Byte(separator) => *b == separator,
        };
        let keeps_empty = self != Separator::Spaces;
        line.split(ends).map(<[u8]>::trim_ascii).filter(move |field| keeps_empty || !field.is_empty())
    }
}

/// What a column is.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Role {
    Position(usize),
    Normal(usize),
    Color(usize),
    Other(String),
}

struct Header {
    line_number: u64,
    roles: Vec<Role>,
}

impl Header {
    fn from_names<'a>(line_number: u64, names: impl Iterator<Item = &'a [u8]>) -> Self {
        let mut roles: Vec<Role> = vec![];
        for name in names.take(MAX_COLUMNS + 1) {
            let name = String::from_utf8_lossy(name);
            let name = name.trim_matches('"');
            let role = match name.to_ascii_lowercase().as_str() {
                "x" => Role::Position(0),
                "y" => Role::Position(1),
                "z" => Role::Position(2),
                "nx" | "normal_x" => Role::Normal(0),
                "ny" | "normal_y" => Role::Normal(1),
                "nz" | "normal_z" => Role::Normal(2),
                _ => colors::channel(name).map_or_else(|| Role::Other(name.to_owned()), Role::Color),
            };
            // A name that comes twice is a column of its own.
            roles.push(if roles.contains(&role) { Role::Other(name.to_owned()) } else { role });
        }
        // Two of three components are no vector: they stay columns.
        let complete = |roles: &[Role], of: fn(usize) -> Role| (0..3).all(|i| roles.contains(&of(i)));
        let (normals, colors) = (complete(&roles, Role::Normal), complete(&roles, Role::Color));
        for role in &mut roles {
            match role {
                Role::Normal(i) if !normals => *role = Role::Other(["nx", "ny", "nz"][*i].to_owned()),
                Role::Color(i) if !colors => *role = Role::Other(["red", "green", "blue", "alpha"][*i].to_owned()),
                _ => {}
            }
        }
        Self { line_number, roles }
    }

    /// A comment is a header if it names x, y and z.
    fn in_comment(comment: &[u8]) -> Option<Self> {
        let header = Self::from_names(0, Separator::of(comment).split(comment));
        header.has_positions().then_some(header)
    }

    fn has_positions(&self) -> bool {
        (0..3).all(|i| self.roles.contains(&Role::Position(i)))
    }

    fn table(self, format: &'static str, separator: Separator) -> Result<Table> {
        if !self.has_positions() || self.roles.len() > MAX_COLUMNS {
            let missing: Vec<&str> =
                (0..3).filter(|&i| !self.roles.contains(&Role::Position(i))).map(|i| ["x", "y", "z"][i]).collect();
            let found = format!("a header of {} columns without {}", self.roles.len(), missing.join(", "));
            let expected = format!("columns named x, y and z, at most {MAX_COLUMNS} in all");
            return Err(FileError::new(format, Place::Line(self.line_number), found, expected).into());
        }
        let has = |role: fn(usize) -> Role| self.roles.contains(&role(0));
        Ok(Table {
            format,
            separator,
            positions: vec![],
            normals: has(Role::Normal).then(Vec::new),
            colors: has(Role::Color).then(Colors::default),
            others: self.roles.iter().map(|_| vec![]).collect(),
            roles: self.roles,
        })
    }
}

/// Colours before it is known whether they are 0 … 1 or 0 … 255.
#[derive(Default)]
struct Colors {
    values: Vec<[f32; 4]>,
    /// Whether all channels are within 0 … 1 and some not whole.
    beyond_one: bool,
    fractional: bool,
}

impl Colors {
    fn into_bytes(self) -> Vec<[u8; 4]> {
        let unit = self.fractional && !self.beyond_one;
        let byte = |value: f32| {
            if unit { colors::from_unit(value.into()) } else { colors::from_byte_range(value.into()) }
        };
        self.values
            .iter()
            .map(|&[r, g, b, a]| [byte(r), byte(g), byte(b), if a.is_nan() { 255 } else { byte(a) }])
            .collect()
    }
}

struct Table {
    format: &'static str,
    separator: Separator,
    roles: Vec<Role>,
    positions: Vec<DVec3>,
    normals: Option<Vec<DVec3>>,
    colors: Option<Colors>,
    /// Values of the columns that are attributes; empty for the others.
    others: Vec<Vec<f64>>,
}

impl Table {
    /// Takes the first line that is not a comment: a header, or numbers under the header of a comment, or numbers alone.
    fn begin(format: &'static str, line_number: u64, line: &[u8], in_comment: Option<Header>) -> Result<Self> {
        let separator = Separator::of(line);
        let n_numbers = separator.split(line).filter(|field| parsed::<f64>(field).is_some()).count();
        if n_numbers == 0 {
            return Header::from_names(line_number, separator.split(line)).table(format, separator);
        }
        let n_fields = separator.split(line).count();
        if n_fields < 3 {
            let found = format!("{n_fields} columns in {}", shown(line));
            return Err(FileError::new(format, Place::Line(line_number), found, "at least x, y and z").into());
        }
        let named = |i: usize| match i {
            0..3 => Role::Position(i),
            _ => Role::Other(format!("column{}", i + 1)),
        };
        // A comment of another length only happens to mention x, y and z.
        let header = in_comment
            .filter(|header| header.roles.len() == n_fields)
            .unwrap_or_else(|| Header { line_number, roles: (0..n_fields.min(MAX_COLUMNS + 1)).map(named).collect() });
        let mut table = header.table(format, separator)?;
        table.add(line_number, line)?;
        Ok(table)
    }

    fn add(&mut self, line_number: u64, line: &[u8]) -> Result<()> {
        let mut fields = self.separator.split(line);
        let mut position = DVec3::NAN;
        let mut normal = DVec3::NAN;
        let mut color = [f32::NAN; 4];
        for (i, (role, others)) in self.roles.iter().zip(&mut self.others).enumerate() {
            let Some(field) = fields.next() else {
                let expected = format!("{} columns, as the lines before", self.roles.len());
                let found = format!("{i} columns");
                return Err(FileError::new(self.format, Place::Line(line_number), found, expected).into());
            };
            let what = match role {
                Role::Position(axis) => ["x", "y", "z"][*axis],
                Role::Normal(axis) => ["nx", "ny", "nz"][*axis],
                Role::Color(channel) => ["red", "green", "blue", "alpha"][*channel],
                Role::Other(name) => name,
            };
            let value = number(self.format, line_number, field, what)?;
            match role {
                Role::Position(axis) => position[*axis] = value,
                Role::Normal(axis) => normal[*axis] = value,
                Role::Color(channel) => color[*channel] = value as f32,
                Role::Other(_) => others.push(value),
            }
        }
        if let Some(field) = fields.next() {
            let found = format!("one more column, {}", shown(field));
            let expected = format!("{} columns, as the lines before", self.roles.len());
            return Err(FileError::new(self.format, Place::Line(line_number), found, expected).into());
        }
        self.positions.push(position);
        if let Some(normals) = &mut self.normals {
            normals.push(normal);
        }
        if let Some(colors) = &mut self.colors {
            colors.beyond_one |= color.iter().any(|&c| c > 1.0);
            colors.fractional |= color.iter().any(|&c| c.fract() != 0.0 && !c.is_nan());
            colors.values.push(color);
        }
        Ok(())
    }

    fn into_cloud(self) -> PointCloud {
        let mut cloud = PointCloud::from_world(&self.positions);
        cloud.normals = self.normals.map(|normals| normals.iter().map(|n| n.as_vec3()).collect());
        cloud.colors = self.colors.map(Colors::into_bytes);
        for (role, values) in self.roles.into_iter().zip(self.others) {
            if let Role::Other(name) = role {
                cloud.attributes.push(Attribute { name, values: Column::F64(values) });
            }
        }
        cloud
    }
}
