//! summary.md: every value in tables beside the paper's, and what is missing.

use std::fmt::Write as _;

use super::lab::Lab;
use super::original;
use super::rows::{Row, radius_name};
use crate::Result;
use crate::plots::short;

/// An experiment and its rows.
pub type Part = (&'static str, Vec<Row>);

/// What stands above the tables.
#[derive(Debug, Clone, Copy)]
pub struct Head<'a> {
    /// The first line.
    pub title: &'a str,
    /// What a reader of the rows must know.
    pub notes: &'a [&'a str],
    /// What times are.
    pub times: &'a str,
}

/// That of the experiments on moving points.
pub const HEAD: Head<'_> = Head {
    title: "The experiments of Xing2017, measured again",
    notes: &original::NOTES,
    times: "Times are wall clock with the device having finished, points on the device and lists left there; the CSV files have the \
            device's own clock beside them. Every answer was checked in the run that timed it. Of a search that may miss neighbours the \
            recall stands behind the time.",
};

/// Writes the summary.
///
/// # Errors
/// A file that cannot be written.
pub fn write(lab: &Lab, head: &Head<'_>, command: &str, parts: &[Part]) -> Result<()> {
    let path = lab.path("summary.md");
    let text = text(lab, head, command, parts);
    std::fs::write(&path, text).map_err(|error| format!("{}: {error}", path.display()).into())
}

fn text(lab: &Lab, head: &Head<'_>, command: &str, parts: &[Part]) -> String {
    let mut text = format!("# {}\n\n`{command}`\n\n", head.title);
    for line in lab.caption() {
        let _ = writeln!(text, "- {line}");
    }
    for note in head.notes {
        let _ = writeln!(text, "- {note}");
    }
    let _ = writeln!(text, "\n{}", head.times);
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
    let kinds = ["svg", "png"];
    let numbered = kinds.map(|kind| (1..=9).map(move |number| format!("{experiment}-{number}.{kind}")));
    // Figure 13 is figure 12 by phase.
    let by_phase = (experiment == "figure-12").then(|| "figure-13.svg".to_owned());
    let own = kinds.map(|kind| format!("{experiment}.{kind}"));
    let files = own.into_iter().chain(numbered.into_iter().flatten()).chain(by_phase);
    files.filter(|file| lab.path(file).exists()).collect()
}

/// What identifies a line of the table: all but the method and what was measured.
fn key(row: &Row) -> [String; 4] {
    [row.setting.clone(), radius_name(row), row.points.to_string(), format!("{}, {}", row.quantity, row.unit)]
}

/// The neighbours of a line, which differ a little between methods that made more steps or fewer.
fn neighbors(line: &[&&Row]) -> String {
    let all = || line.iter().filter_map(|row| row.mean_neighbors);
    let [low, high] = [all().fold(f64::INFINITY, f64::min), all().fold(0.0, f64::max)].map(|n| format!("{n:.1}"));
    if low == high { low } else { format!("{low} to {high}") }
}

fn table(text: &mut String, rows: &[Row]) {
    let measured: Vec<&Row> = rows.iter().filter(|row| row.value.is_some()).collect();
    let (mut methods, mut keys): (Vec<&str>, Vec<[String; 4]>) = (Vec::new(), Vec::new());
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
    let names = ["setting", "at", "points", "quantity", "mean neighbours"];
    let head: Vec<&str> = names.into_iter().chain(methods.iter().copied()).chain(["paper"]).collect();
    let _ = writeln!(text, "| {} |\n|{}", head.join(" | "), " --- |".repeat(head.len()));
    for own in keys {
        let line: Vec<&&Row> = measured.iter().filter(|row| key(row) == own).collect();
        let mut cells: Vec<String> = own.to_vec();
        cells.push(neighbors(&line));
        for method in &methods {
            let row = line.iter().find(|row| row.method == *method);
            cells.push(row.map_or("–".to_owned(), |row| cell(row)));
        }
        let mut papers: Vec<(f64, Vec<&str>)> = Vec::new();
        for (paper, method) in line.iter().filter_map(|row| Some((row.paper?, row.method.as_str()))) {
            match papers.iter_mut().find(|known| known.0 == paper) {
                Some((_, methods)) => methods.push(method),
                None => papers.push((paper, vec![method])),
            }
        }
        let named = |(paper, methods): &(f64, Vec<&str>)| format!("{} ({})", short(*paper), methods.join("; "));
        let papers: Vec<String> = papers.iter().map(named).collect();
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
        let what = format!("{} ({} points, {}{setting})", row.method, row.points, radius_name(row));
        // Reasons with other seconds are the same.
        let stem = |note: &str| note.split(" took ").next().unwrap_or_default().to_owned();
        match reasons.iter_mut().find(|(reason, _)| stem(reason) == stem(&row.note)) {
            Some((_, rows)) => rows.push(what),
            None => reasons.push((&row.note, vec![what])),
        }
    }
    for (reason, rows) in reasons {
        let _ = writeln!(text, "\n- {reason}: {}.", rows.join("; "));
    }
}
