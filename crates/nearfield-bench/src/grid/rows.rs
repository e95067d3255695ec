//! The rows of an experiment and the file they are appended to, so that a later run resumes where one stopped.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::Result;

/// Columns of every experiment.
pub const COLUMNS: [&str; 14] = [
    "device",
    "commit",
    "scale",
    "particles",
    "wanted_neighbors",
    "radius",
    "mean_neighbors",
    "method",
    "stage",
    "clock",
    "milliseconds",
    "runs",
    "points_bytes",
    "structure_bytes",
];

/// Name of the stage that stands for the whole; it closes the rows of a point.
pub const TOTAL: &str = "total";

/// One stage of one method at one point of an experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Name of the device that did it.
    pub device: String,
    /// Commit of the program.
    pub commit: String,
    /// Scale of the experiment.
    pub scale: f64,
    /// Number of particles.
    pub particles: usize,
    /// Neighbours that the radius gives away from the border; 0 where the radius was chosen otherwise.
    pub wanted_neighbors: f64,
    /// Search radius; particles fill the unit cube.
    pub radius: f32,
    /// Measured mean neighbours, the particle itself included; where only memory is measured, of a ball away from the
    /// border by arithmetic.
    pub mean_neighbors: f64,
    /// "cpu grid" …
    pub method: String,
    /// "sort", "count" … or [`TOTAL`].
    pub stage: String,
    /// "host" or "device".
    pub clock: String,
    /// Median milliseconds.
    pub milliseconds: f64,
    /// Timed runs.
    pub runs: usize,
    /// Bytes of the points alone.
    pub points_bytes: u64,
    /// Bytes of the structure, points included.
    pub structure_bytes: u64,
}

impl Row {
    fn record(&self) -> [String; COLUMNS.len()] {
        [
            self.device.clone(),
            self.commit.clone(),
            self.scale.to_string(),
            self.particles.to_string(),
            self.wanted_neighbors.to_string(),
            self.radius.to_string(),
            format!("{:.3}", self.mean_neighbors),
            self.method.clone(),
            self.stage.clone(),
            self.clock.clone(),
            format!("{:.5}", self.milliseconds),
            self.runs.to_string(),
            self.points_bytes.to_string(),
            self.structure_bytes.to_string(),
        ]
    }

    fn parse(record: &csv::StringRecord) -> Result<Self> {
        let text = |column: usize| record.get(column).unwrap_or_default().to_owned();
        Ok(Self {
            device: text(0),
            commit: text(1),
            scale: text(2).parse()?,
            particles: text(3).parse()?,
            wanted_neighbors: text(4).parse()?,
            radius: text(5).parse()?,
            mean_neighbors: text(6).parse()?,
            method: text(7),
            stage: text(8),
            clock: text(9),
            milliseconds: text(10).parse()?,
            runs: text(11).parse()?,
            points_bytes: text(12).parse()?,
            structure_bytes: text(13).parse()?,
        })
    }

    /// Whether both stand for the same point, method and stage.
    fn same_place(&self, other: &Self) -> bool {
        self.is_point(&other.point()) && self.stage == other.stage && self.clock == other.clock
    }

    fn point(&self) -> Point<'_> {
        let Self { device, commit, scale, particles, radius, method, .. } = self;
        Point { device, commit, scale: *scale, particles: *particles, radius: *radius, method }
    }

    fn is_point(&self, point: &Point<'_>) -> bool {
        self.point() == *point
    }
}

/// What identifies a measured point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point<'a> {
    /// Name of the device.
    pub device: &'a str,
    /// Commit of the program.
    pub commit: &'a str,
    /// Scale of the experiment.
    pub scale: f64,
    /// Number of particles.
    pub particles: usize,
    /// Search radius.
    pub radius: f32,
    /// Name of the method.
    pub method: &'a str,
}

/// All rows of an experiment, in memory and in a file.
#[derive(Debug)]
pub struct Rows {
    path: PathBuf,
    rows: Vec<Row>,
}

impl Rows {
    /// Reads the file if it is there; a last line that was cut off is dropped from it.
    ///
    /// # Errors
    /// A file that cannot be read or has other columns.
    pub fn open(path: &Path) -> Result<Self> {
        let here = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        let text = match fs::read_to_string(path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(here(&error).into()),
        };
        let whole = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
        if whole.len() < text.len() {
            fs::write(path, whole).map_err(|e| here(&e))?;
        }
        let mut reader = csv::Reader::from_reader(whole.as_bytes());
        let mut rows: Vec<Row> = Vec::new();
        if !whole.is_empty() {
            if reader.headers().map_err(|e| here(&e))?.iter().ne(COLUMNS) {
                return Err(here(&"the columns are those of another program; move the file away").into());
            }
            for record in reader.records() {
                let row = Row::parse(&record.map_err(|e| here(&e))?).map_err(|e| here(&e))?;
                // A point that was interrupted between its stages is measured again: the later rows count.
                rows.retain(|earlier| !earlier.same_place(&row));
                rows.push(row);
            }
        }
        Ok(Self { path: path.to_owned(), rows })
    }

    /// All rows of the file, in its order.
    pub fn all(&self) -> &[Row] {
        &self.rows
    }

    /// Whether the point is complete.
    pub fn has(&self, point: &Point<'_>) -> bool {
        self.rows.iter().any(|row| row.stage == TOTAL && row.is_point(point))
    }

    /// Total milliseconds of a point that is complete.
    pub fn total(&self, point: &Point<'_>) -> Option<f64> {
        self.rows.iter().find(|row| row.stage == TOTAL && row.is_point(point)).map(|row| row.milliseconds)
    }

    /// Adds the rows of a point to the file, the total last.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn append(&mut self, rows: Vec<Row>) -> Result<()> {
        let here = |error: &dyn std::fmt::Display| format!("{}: {error}", self.path.display());
        let mut writer = csv::Writer::from_writer(Vec::new());
        if self.rows.is_empty() {
            writer.write_record(COLUMNS)?;
        }
        for row in &rows {
            writer.write_record(row.record())?;
        }
        let text = writer.into_inner().map_err(|e| here(&e))?;
        // A file that holds no row may still hold a header.
        let (append, truncate) = (!self.rows.is_empty(), self.rows.is_empty());
        let mut options = fs::OpenOptions::new();
        let file = options.create(true).append(append).write(true).truncate(truncate).open(&self.path);
        file.and_then(|mut file| file.write_all(&text)).map_err(|e| here(&e))?;
        for row in rows {
            self.rows.retain(|earlier| !earlier.same_place(&row));
            self.rows.push(row);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(particles: usize, stage: &str, milliseconds: f64) -> Row {
        Row {
            device: "device, with a comma".into(),
            commit: "abc".into(),
            scale: 0.5,
            particles,
            wanted_neighbors: 50.0,
            radius: 0.1,
            mean_neighbors: 12.25,
            method: "cpu grid".into(),
            stage: stage.into(),
            clock: "host".into(),
            milliseconds,
            runs: 3,
            points_bytes: 160,
            structure_bytes: 200,
        }
    }

    #[test]
    fn a_run_that_was_cut_off_resumes_after_the_last_complete_point() {
        let folder = std::env::temp_dir().join(format!("nearfield-bench-rows-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        let path = folder.join("rows.csv");
        let mut rows = Rows::open(&path).expect("no file is no row");
        rows.append(vec![row(10, "sort", 1.0), row(10, TOTAL, 2.0)]).expect("written");
        rows.append(vec![row(20, "sort", 3.0)]).expect("written");
        let mut file = fs::OpenOptions::new().append(true).open(&path).expect("the file");
        file.write_all(b"device,abc,0.5,20,50").expect("a line cut off");

        let mut rows = Rows::open(&path).expect("the rest is read");
        assert_eq!(rows.all(), [row(10, "sort", 1.0), row(10, TOTAL, 2.0), row(20, "sort", 3.0)]);
        assert!(rows.has(&row(10, TOTAL, 0.0).point()) && !rows.has(&row(20, TOTAL, 0.0).point()));
        rows.append(vec![row(20, "sort", 4.0), row(20, TOTAL, 5.0)]).expect("written");
        let rows = Rows::open(&path).expect("read again");
        assert_eq!(rows.all().len(), 4);
        assert_eq!(rows.total(&row(20, TOTAL, 0.0).point()), Some(5.0));
        fs::remove_dir_all(&folder).expect("removed");
    }

    #[test]
    fn a_file_with_other_columns_is_refused() {
        let path = std::env::temp_dir().join(format!("nearfield-bench-columns-{}.csv", std::process::id()));
        fs::write(&path, "a,b\n1,2\n").expect("written");
        assert!(Rows::open(&path).is_err());
        fs::remove_file(&path).expect("removed");
    }
}
