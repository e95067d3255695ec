//! From rows to the lines of a plot.

use std::collections::BTreeMap;

use super::lab::Lab;
use super::methods;
use super::rows::Row;
use crate::Result;
use crate::plots::{self, Frame, Look, Panel, Series};

/// A line a method through the rows with values, in order of first appearance.
pub fn by_method<'a>(rows: impl Iterator<Item = &'a Row>, x: impl Fn(&Row) -> f64) -> Vec<Series> {
    let mut lines: Vec<Series> = Vec::new();
    let mut others = BTreeMap::new();
    for row in rows {
        let Some(value) = row.value else { continue };
        let point = (x(row), value);
        match lines.iter_mut().find(|line| line.name == row.method) {
            Some(line) => line.points.push(point),
            None => {
                let plug = methods::ALL.iter().find(|plug| plug.name == row.method);
                let next = others.len();
                let color = plug.map_or_else(|| *others.entry(row.method.clone()).or_insert(next), |plug| plug.color);
                lines.push(Series { name: row.method.clone(), color, points: vec![point], look: Look::Line });
            }
        }
    }
    for line in &mut lines {
        line.points.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    lines
}

/// The paper's own points.
pub fn published(name: &str, color: usize, points: Vec<(f64, f64)>) -> Series {
    Series { name: name.to_owned(), color, points, look: Look::Published }
}

/// The paper's values of some rows.
pub fn published_of<'a>(
    name: &str,
    color: usize,
    rows: impl Iterator<Item = &'a Row>,
    x: impl Fn(&Row) -> f64,
) -> Series {
    published(name, color, rows.filter_map(|row| Some((x(row), row.paper?))).collect())
}

/// Draws the panels, where there is anything to draw; else removes what an earlier run drew.
///
/// # Errors
/// A file that cannot be written.
pub fn save(lab: &Lab, file: &str, frame: &Frame, panels: &[Panel]) -> Result<()> {
    let path = lab.path(file);
    if panels.iter().all(|panel| panel.series.iter().all(|series| series.points.is_empty())) {
        return match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(format!("{}: {error}", path.display()).into())
            }
            _ => Ok(()),
        };
    }
    plots::lines(&path, frame, panels)
}
