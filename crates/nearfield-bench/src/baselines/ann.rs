//! Exact search by Debian's libann, the paper's own baseline on the CPU, through a program of its own.
//!
//! `scripts/build_ann_peer.sh` makes the program where libann's header and a C++ compiler are installed. It takes the
//! points from a file, answers on one thread, as the library does, and leaves its rows in another file, so that they are judged as
//! all others are.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::points::Points;
use super::rows::{KnnRows, NONE};
use crate::Result;

/// What the program gave.
#[derive(Debug, Clone)]
pub struct AnnRun {
    /// The k nearest of every point, itself first.
    pub rows: KnnRows,
    /// Points within the radius of every point.
    pub counts: Vec<u32>,
    /// Milliseconds of the build, on one thread.
    pub build_ms: f64,
    /// Milliseconds of all k nearest, on one thread.
    pub knn_ms: f64,
    /// Milliseconds of all counts, on one thread.
    pub count_ms: f64,
}

/// A folder that is removed in the end.
struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Lets `program` search the k nearest of every point, and count within `radius`.
///
/// # Errors
/// Files that cannot be written or read; a program that fails or whose answer is not whole.
pub fn run(program: &Path, points: &Points, k: usize, radius: f32) -> Result<AnnRun> {
    super::check_k(k)?;
    let folder = Scratch(std::env::temp_dir().join(format!("nearfield-ann-{}", std::process::id())));
    fs::create_dir_all(&folder.0)?;
    let (input, output) = (folder.0.join("points"), folder.0.join("rows"));
    fs::write(&input, little_endian(points.coordinates().iter().map(|v| v.to_bits())))?;
    let numbers = [points.dimension().to_string(), points.len().to_string(), k.to_string(), radius.to_string()];
    let ran = Command::new(program).arg(&input).args(&numbers).arg(&output).output();
    let ran = ran.map_err(|error| format!("{}: {error}", program.display()))?;
    if !ran.status.success() {
        return Err(format!("{}: {}", program.display(), String::from_utf8_lossy(&ran.stderr).trim()).into());
    }
    let times = String::from_utf8_lossy(&ran.stdout).into_owned();
    let times: Vec<f64> = times.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    let &[build_ms, knn_ms, count_ms] = times.as_slice() else {
        return Err(format!("{}: found {} times, expected 3", program.display(), times.len()).into());
    };
    let words = words(&fs::read(&output)?);
    let (n, found, expected) = (points.len(), words.len(), points.len() * (k + 1));
    if found != expected {
        return Err(format!("{}: found {found} words of an answer, expected {expected}", program.display()).into());
    }
    let (ids, counts) = words.split_at(n * k);
    Ok(AnnRun { rows: rows(points, k, ids), counts: counts.to_vec(), build_ms, knn_ms, count_ms })
}

/// Rows of these indices with the distances in f32: libann's own are of another type.
fn rows(points: &Points, k: usize, ids: &[u32]) -> KnnRows {
    let candidate = |query: usize, id: u32| (super::points::dist2(points.get(query), points.get(id as usize)), id);
    let is_point = |id: &&u32| **id != NONE && (**id as usize) < points.len();
    let row = |(query, ids): (usize, &[u32])| ids.iter().filter(is_point).map(|&id| candidate(query, id)).collect();
    KnnRows::of_candidates(k, ids.chunks_exact(k).enumerate().map(row).collect())
}

fn little_endian(words: impl Iterator<Item = u32>) -> Vec<u8> {
    words.flat_map(u32::to_le_bytes).collect()
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]])).collect()
}
