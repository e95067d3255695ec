//! Plots of the applications: a line or a dot a method, each in a colour of its own, crosses for the paper's.

use crate::Result;
use crate::paper::lab::Lab;
use crate::paper::plotting;
use crate::paper::rows::Row;
use crate::plots::{Axes, Frame, Look, Panel, Series};

/// Times of some quantities over the number of points, a panel each; the paper's own as crosses.
///
/// # Errors
/// A file that cannot be written.
pub fn over_points(lab: &Lab, file: &str, title: &str, y_label: &str, rows: &[Row], quantities: &[&str]) -> Result<()> {
    let panel = |quantity: &&str| {
        let own = || rows.iter().filter(|row| row.quantity == *quantity);
        let mut series: Vec<Series> = Vec::new();
        for row in own() {
            let Some(value) = row.value.filter(|value| *value > 0.0) else { continue };
            match series.iter_mut().find(|line| line.name == row.method) {
                Some(line) => line.points.push((row.points as f64, value)),
                None => series.push(Series {
                    name: row.method.clone(),
                    color: series.len(),
                    points: vec![(row.points as f64, value)],
                    look: Look::Line,
                }),
            }
        }
        for line in &mut series {
            line.points.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        let papers: Vec<Series> = series
            .iter()
            .filter_map(|line| {
                let its = own().filter(|row| row.method == line.name);
                let points: Vec<(f64, f64)> = its.filter_map(|row| Some((row.points as f64, row.paper?))).collect();
                let name = format!("paper: {}", line.name);
                (!points.is_empty()).then(|| plotting::published(&name, line.color, points))
            })
            .collect();
        series.extend(papers);
        Panel { title: (*quantity).to_owned(), series }
    };
    let frame = Frame {
        title: title.to_owned(),
        caption: lab.caption(),
        x_label: "points".to_owned(),
        y_label: y_label.to_owned(),
        axes: Axes::Logarithmic,
        legend_right: false,
    };
    let panels: Vec<Panel> = quantities.iter().map(panel).collect();
    plotting::save(lab, file, &frame, &panels)
}
