//! The rows of all parts: a table for people, a CSV file for programs.

use std::path::Path;

use super::method::Cast;
use crate::Result;
use crate::provenance::COMMIT;

/// One structure, one mesh, one set of rays.
#[derive(Debug, Clone, Default)]
pub struct Row {
    /// Part: "triangles", "counts", "shares", "speed", "build", "paths".
    pub part: &'static str,
    /// The mesh.
    pub mesh: String,
    /// Its triangles.
    pub triangles: usize,
    /// Structure and device.
    pub method: String,
    /// How it was built.
    pub how: String,
    /// Device and threads.
    pub device: String,
    /// Which rays.
    pub shots: String,
    /// How many the row is about.
    pub rays: usize,
    /// How many were cast, where the row's times are an estimate from fewer.
    pub estimated_from: Option<usize>,
    /// Milliseconds of preparation and build.
    pub build: Option<f64>,
    /// Milliseconds of the copy to the device.
    pub upload: Option<f64>,
    /// Times of the cast; none where it was left out, as the note says.
    pub cast: Option<Cast>,
    /// Mean and largest number of triangles tested by a ray.
    pub tests: Option<(f64, u32)>,
    /// Rays compared with brute force.
    pub sample: usize,
    /// Accel's milliseconds.
    pub accel: Option<f64>,
    /// Accel's largest number of triangles tested by a ray.
    pub accel_tests: Option<u32>,
    /// The target in words.
    pub target: String,
    /// What else there is to know.
    pub note: String,
}

/// Columns of the CSV file.
pub const COLUMNS: [&str; 27] = [
    "part",
    "mesh",
    "triangles",
    "structure",
    "how",
    "device",
    "shots",
    "rays",
    "rays_cast",
    "build_ms",
    "upload_ms",
    "cast_device_ms",
    "cast_host_ms",
    "fastest_ms",
    "round_trip_ms",
    "mrays_per_s",
    "mean_tests",
    "max_tests",
    "runs",
    "rays_against_brute_force",
    "rays_differing_within_rounding",
    "accel_ms",
    "accel_max_tests",
    "target",
    "note",
    "driver",
    "commit",
];

impl Row {
    /// Millions of rays a second.
    pub fn mrays(&self) -> Option<f64> {
        Some(self.rays as f64 * 1e-3 / self.cast.as_ref()?.milliseconds())
    }

    /// Rays that were cast: fewer where the times are an estimate, none where they were left out.
    fn rays_cast(&self) -> usize {
        let is_cast = self.cast.is_some() || self.tests.is_some();
        self.estimated_from.unwrap_or(if is_cast { self.rays } else { 0 })
    }

    /// The head of the table for people.
    pub fn head() -> &'static str {
        "| mesh | triangles | structure | built | rays | build ms | upload ms | cast ms, device | cast ms, host | host to host ms | Mrays/s | \
         mean tests | max tests | Accel max tests | Accel ms | target | note |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
    }

    /// A line of the table for people.
    pub fn markdown(&self) -> String {
        let number = |value: Option<f64>| value.map_or_else(String::new, digits);
        let cast = self.cast.as_ref();
        let rays = if self.rays == 0 { String::new() } else { format!("{} {}", self.rays, self.shots) };
        format!(
            "| {} | {} | {} | {} | {rays} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} |",
            self.mesh,
            self.triangles,
            self.method,
            self.how,
            number(self.build),
            number(self.upload),
            number(cast.and_then(|c| c.device).map(|t| t.median)),
            number(cast.map(|c| c.host.median)),
            number(cast.and_then(|c| c.round_trip)),
            number(self.mrays()),
            number(self.tests.map(|t| t.0)),
            self.tests.map_or_else(String::new, |t| t.1.to_string()),
            self.accel_tests.map_or_else(String::new, |most| most.to_string()),
            number(self.accel),
            self.target,
            self.note,
        )
    }

    fn record(&self, driver: &str) -> [String; COLUMNS.len()] {
        let number = |value: Option<f64>| value.map_or_else(String::new, |v| format!("{v:.5}"));
        let cast = self.cast.as_ref();
        let fastest = cast.map(|c| c.device.unwrap_or(c.host).fastest);
        [
            self.part.to_owned(),
            self.mesh.clone(),
            self.triangles.to_string(),
            self.method.clone(),
            self.how.clone(),
            self.device.clone(),
            self.shots.clone(),
            self.rays.to_string(),
            self.rays_cast().to_string(),
            number(self.build),
            number(self.upload),
            number(cast.and_then(|c| c.device).map(|t| t.median)),
            number(cast.map(|c| c.host.median)),
            number(fastest),
            number(cast.and_then(|c| c.round_trip)),
            number(self.mrays()),
            number(self.tests.map(|t| t.0)),
            self.tests.map_or_else(String::new, |t| t.1.to_string()),
            cast.map_or(0, |c| c.runs).to_string(),
            self.sample.to_string(),
            cast.map_or(0, |c| c.differing).to_string(),
            number(self.accel),
            self.accel_tests.map_or_else(String::new, |most| most.to_string()),
            self.target.clone(),
            self.note.clone(),
            driver.to_owned(),
            COMMIT.to_owned(),
        ]
    }
}

/// Writes all rows.
///
/// # Errors
/// A file that cannot be written.
pub fn save(path: &Path, rows: &[Row], driver: &str) -> Result<()> {
    let mut writer = csv::Writer::from_path(path)?;
    writer.write_record(COLUMNS)?;
    for row in rows {
        writer.write_record(row.record(driver))?;
    }
    Ok(writer.flush()?)
}

/// Three digits or more.
pub fn digits(value: f64) -> String {
    match value.abs() {
        v if v >= 100.0 => format!("{value:.0}"),
        v if v >= 10.0 => format!("{value:.1}"),
        v if v >= 1.0 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}
