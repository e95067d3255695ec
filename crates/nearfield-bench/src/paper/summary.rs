//! summary.md: every value in tables beside the paper's, and what is missing.

use std::fmt::Write as _;

use super::lab::Lab;
use super::original;
use super::rows::Row;
use crate::Result;
use crate::plots::short;

/// An experiment and its rows.
pub type Part = (&'static str, Vec<Row>);

/// Writes the summary.
///
/// # Errors
/// A file that cannot be written.
pub fn write(lab: &Lab, command: &str, parts: &[Part]) -> Result<()> {
    let path = lab.path("summary.md");
    std::fs::write(&path, text(lab, command, parts)).map_err(|error| format!("{}: {error}", path.display()).into())
}

fn text(lab: &Lab, command: &str, parts: &[Part]) -> String {
    let mut text = String::from("# The experiments of Xing2017, measured again\n\n");
    let _ = writeln!(text, "`{command}`\n");
    for line in lab.caption() {
        let _ = writeln!(text, "- {line}");
    }
    for note in original::NOTES {
        let _ = writeln!(text, "- {note}");
    }
    text.push_str(
        "\nTimes are wall clock with the device having finished, points on the device and lists left there; the CSV files have the \
         device's own clock beside them. Every answer was checked in the run that timed it. Of a search that may miss neighbours the \
         recall stands behind the time.\n",
    );
    for (experiment, rows) in parts {
        let _ = writeln!(text, "\n## {experiment}\n");
        for figure in figures(lab, experiment) {
            let _ = writeln!(text, "![{figure}]({figure})\n");
        }
        table(&mut text, rows);
        missing(&mut text, rows);
    }
    text
}

/// The plots of an experiment that are there.
fn figures(lab: &Lab, experiment: &str) -> Vec<String> {
    let numbered = (1..=9).map(|number| format!("{experiment}-{number}.svg"));
    std::iter::once(format!("{experiment}.svg")).chain(numbered).filter(|file| lab.path(file).exists()).collect()
}

/// What identifies a line of the table: all but the method.
fn key(row: &Row) -> [String; 6] {
    let neighbors = row.mean_neighbors.map_or("–".to_owned(), |n| format!("{n:.1}"));
    let [points, dimension] = [row.points, row.dimension].map(|n| n.to_string());
    [
        row.setting.clone(),
        row.r_over_l.to_string(),
        points,
        dimension,
        neighbors,
        format!("{}, {}", row.quantity, row.unit),
    ]
}

fn table(text: &mut String, rows: &[Row]) {
    let measured: Vec<&Row> = rows.iter().filter(|row| row.value.is_some()).collect();
    let (mut methods, mut keys): (Vec<&str>, Vec<[String; 6]>) = (Vec::new(), Vec::new());
    for row in &measured {
        if !methods.contains(&row.method.as_str()) {
            methods.push(&row.method);
        }
        if !keys.contains(&key(row)) {
            keys.push(key(row));
        }
    }
    if measured.is_empty() {
        return text.push_str("Nothing was measured.\n");
    }
    let has_dimension = measured.iter().any(|row| row.dimension != 3);
    let has_setting = measured.iter().any(|row| !row.setting.is_empty());
    let names = ["setting", "r/L", "points", "dimension", "mean neighbours", "quantity"];
    let shown: Vec<usize> =
        (0..names.len()).filter(|&c| (c != 0 || has_setting) && (c != 3 || has_dimension)).collect();
    let head: Vec<&str> = shown.iter().map(|&c| names[c]).chain(methods.iter().copied()).chain(["paper"]).collect();
    let _ = writeln!(text, "| {} |\n|{}", head.join(" | "), " --- |".repeat(head.len()));
    for own in keys {
        let line: Vec<&&Row> = measured.iter().filter(|row| key(row) == own).collect();
        let mut cells: Vec<String> = shown.iter().map(|&c| own[c].clone()).collect();
        for method in &methods {
            let row = line.iter().find(|row| row.method == *method);
            cells.push(row.map_or("–".to_owned(), |row| cell(row)));
        }
        let mut papers: Vec<String> = Vec::new();
        for row in &line {
            let Some(paper) = row.paper else { continue };
            let named = format!("{} ({})", short(paper), row.method);
            if !papers.contains(&named) {
                papers.push(named);
            }
        }
        cells.push(if papers.is_empty() { "–".to_owned() } else { papers.join(", ") });
        let _ = writeln!(text, "| {} |", cells.join(" | "));
    }
}

fn cell(row: &Row) -> String {
    let value = row.value.map_or("–".to_owned(), short);
    row.recall.map_or(value.clone(), |recall| format!("{value} (recall {recall:.3})"))
}

/// The rows without a value, by their reason.
fn missing(text: &mut String, rows: &[Row]) {
    let mut reasons: Vec<(&str, Vec<String>)> = Vec::new();
    for row in rows.iter().filter(|row| row.value.is_none()) {
        let setting = if row.setting.is_empty() { String::new() } else { format!(", {}", row.setting) };
        let what = format!("{} ({} points, r/L {}{setting})", row.method, row.points, row.r_over_l);
        match reasons.iter_mut().find(|(reason, _)| *reason == row.note) {
            Some((_, rows)) => rows.push(what),
            None => reasons.push((&row.note, vec![what])),
        }
    }
    for (reason, rows) in reasons {
        let _ = writeln!(text, "\n- {reason}: {}.", rows.join("; "));
    }
}
