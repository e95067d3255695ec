//! The rows of an experiment, one value each: what it was measured on, how it was checked, and the paper's own value.

use std::collections::HashMap;
use std::fs::File;
use std::time::Instant;

use super::lab::Lab;
use crate::plots::short;
use crate::provenance::COMMIT;
use crate::{Error, Result};

/// Columns of every CSV file.
pub const COLUMNS: [&str; 20] = [
    "experiment",
    "device",
    "commit",
    "scale",
    "paper_points",
    "points",
    "dimension",
    "setting",
    "paper_r_over_l",
    "radius",
    "mean_neighbors",
    "method",
    "quantity",
    "unit",
    "value",
    "device_milliseconds",
    "paper_value",
    "recall",
    "runs",
    "note",
];

/// A value, or the reason why there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Device that did the work.
    pub device: String,
    /// Number of points in the paper.
    pub paper_points: usize,
    /// Number of points here.
    pub points: usize,
    /// Coordinates of a point.
    pub dimension: usize,
    /// What else was varied, such as "movement 0.001 L".
    pub setting: String,
    /// Radius in the paper by the diagonal of the points' box; here it is longer where points are fewer.
    pub r_over_l: f64,
    /// Radius here.
    pub radius: f64,
    /// Measured neighbours of a query, itself included; `None` where nothing was measured.
    pub mean_neighbors: Option<f64>,
    /// Who answered.
    pub method: String,
    /// What is measured, such as "query" or "memory".
    pub quantity: &'static str,
    /// Unit of the values.
    pub unit: &'static str,
    /// The value; `None` where it is missing, see the note.
    pub value: Option<f64>,
    /// Of a time, the part that the device's clock saw.
    pub device_milliseconds: Option<f64>,
    /// The paper's value, on its own device and at its own number of points.
    pub paper: Option<f64>,
    /// Share of the neighbours that were found, of methods that may miss some.
    pub recall: Option<f64>,
    /// Timed runs or steps.
    pub runs: usize,
    /// How the answer was checked, or why there is no value.
    pub note: String,
}

impl Row {
    /// A row without a value, in milliseconds, of points in three dimensions.
    ///
    /// - `points`: their number in the paper and here
    /// - `radius`: in the paper by the diagonal of the points' box, and here
    pub fn new(device: String, points: [usize; 2], setting: &str, radius: [f64; 2], method: &str) -> Self {
        Self {
            device,
            paper_points: points[0],
            points: points[1],
            dimension: 3,
            setting: setting.to_owned(),
            r_over_l: radius[0],
            radius: radius[1],
            mean_neighbors: None,
            method: method.to_owned(),
            quantity: "",
            unit: "ms",
            value: None,
            device_milliseconds: None,
            paper: None,
            recall: None,
            runs: 0,
            note: String::new(),
        }
    }

    /// A row with another quantity.
    pub fn of(&self, quantity: &'static str, unit: &'static str) -> Self {
        Self { quantity, unit, paper: None, ..self.clone() }
    }

    /// With a value.
    pub fn value(mut self, value: f64) -> Self {
        self.value = Some(value);
        self
    }

    /// With the paper's value.
    pub fn paper(mut self, paper: Option<f64>) -> Self {
        self.paper = paper;
        self
    }

    /// With a note.
    pub fn note(mut self, note: impl Into<String>) -> Self {
        self.note = note.into();
        self
    }

    fn record(&self, experiment: &str, scale: f64) -> [String; COLUMNS.len()] {
        let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.6}"));
        [
            experiment.to_owned(),
            self.device.clone(),
            COMMIT.to_owned(),
            scale.to_string(),
            self.paper_points.to_string(),
            self.points.to_string(),
            self.dimension.to_string(),
            self.setting.clone(),
            self.r_over_l.to_string(),
            format!("{:.7}", self.radius),
            self.mean_neighbors.map_or(String::new(), |v| format!("{v:.3}")),
            self.method.clone(),
            self.quantity.to_owned(),
            self.unit.to_owned(),
            number(self.value),
            number(self.device_milliseconds),
            number(self.paper),
            self.recall.map_or(String::new(), |v| format!("{v:.4}")),
            self.runs.to_string(),
            self.note.clone(),
        ]
    }

    /// One line for a reader who watches.
    fn line(&self) -> String {
        let Row { points, setting, method, quantity, unit, note, .. } = self;
        let neighbors = self.mean_neighbors.map_or("–".to_owned(), |n| format!("{n:.1}"));
        let value = self.value.map_or("missing".to_owned(), |v| format!("{} {unit}", short(v)));
        let paper = self.paper.map_or(String::new(), |v| format!(" (paper {} {unit})", short(v)));
        let recall = self.recall.map_or(String::new(), |v| format!(", recall {v:.3}"));
        let at = radius_name(self);
        let comma = if setting.is_empty() { "" } else { ", " };
        format!(
            "{points} points{comma}{setting}, {at}, {neighbors} neighbours, {method}: {quantity} {value}{paper}{recall}; {note}"
        )
    }
}

/// The radius by the diagonal, or the dimension where that is what was varied.
pub fn radius_name(row: &Row) -> String {
    if row.dimension == 3 && row.r_over_l > 0.0 {
        format!("r/L {}", row.r_over_l)
    } else {
        format!("{} dimensions", row.dimension)
    }
}

/// The rows of one experiment, in memory and in its CSV file.
pub struct Sheet<'a> {
    lab: &'a Lab,
    /// "table-1", "figure-10" …
    pub experiment: &'static str,
    writer: csv::Writer<File>,
    rows: Vec<Row>,
    /// Seconds that the last attempt of each method in each setting took, all in all.
    took: HashMap<String, f64>,
}

/// A method that took more than this share of the budget for one attempt is not tried again: the others would have no time left.
const LARGEST_SHARE: f64 = 1.0 / 12.0;

impl<'a> Sheet<'a> {
    /// Begins the file anew, and the time of the experiment.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn begin(lab: &'a Lab, experiment: &'static str) -> Result<Self> {
        let mut writer = csv::Writer::from_path(lab.path(&format!("{experiment}.csv")))?;
        writer.write_record(COLUMNS)?;
        lab.begin_experiment();
        println!("\n{experiment}");
        Ok(Self { lab, experiment, writer, rows: Vec::new(), took: HashMap::new() })
    }

    /// The rows so far.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Adds what `measure` gives, or `row` without a value: where the budget is spent, where the device has too little
    /// memory or cannot do it.
    ///
    /// # Errors
    /// Any other error, a wrong answer among them; a file that cannot be written.
    pub fn attempt(&mut self, row: Row, measure: impl FnOnce() -> Result<Vec<Row>>) -> Result<()> {
        if self.lab.is_over() {
            return self.add(Row { value: None, ..row }.note("missing: the budget of the experiment was spent"));
        }
        let attempt = format!("{}, {}", row.method, row.setting);
        let took = self.took.get(&attempt).copied().unwrap_or(0.0);
        if took > LARGEST_SHARE * self.lab.budget {
            return self.add(
                Row { value: None, ..row }
                    .note(format!("missing: an attempt took {took:.1} s before, too much of the budget")),
            );
        }
        let start = Instant::now();
        let measured = measure();
        self.took.insert(attempt, start.elapsed().as_secs_f64());
        match measured {
            Ok(rows) => rows.into_iter().try_for_each(|row| self.add(row)),
            Err(error) => match refusal(&error) {
                Some(reason) => self.add(Row { value: None, ..row }.note(format!("missing: {reason}"))),
                None => Err(format!("{}, {}: {error}", self.experiment, row.line()).into()),
            },
        }
    }

    /// Adds a row.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn add(&mut self, row: Row) -> Result<()> {
        println!("  {}", row.line());
        self.writer.write_record(row.record(self.experiment, self.lab.scale))?;
        self.writer.flush()?;
        self.rows.push(row);
        Ok(())
    }

    /// Ends the experiment.
    pub fn into_rows(self) -> Vec<Row> {
        self.rows
    }
}

/// The message of an error that says what a device cannot do, and not that something is wrong.
pub fn refusal(error: &Error) -> Option<String> {
    use nearfield::Error as E;
    let error = error.downcast_ref::<E>()?;
    let refuses = matches!(
        error,
        E::OutOfDeviceMemory { .. } | E::OutOfMemory { .. } | E::Unsupported { .. } | E::TooMany { .. }
    );
    refuses.then(|| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_a_device_cannot_do_is_a_missing_row() {
        let refused = nearfield::Error::Unsupported { what: "a list".into(), advice: "count" };
        assert!(refusal(&refused.into()).is_some_and(|text| text.contains("a list")));
        assert!(refusal(&"wrong answer: 3 neighbours".into()).is_none());
        let broken = nearfield::Error::NonFinite { what: "points", count: 1, first: 0 };
        assert!(refusal(&broken.into()).is_none());
    }
}
