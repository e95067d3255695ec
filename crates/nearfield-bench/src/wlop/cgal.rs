//! CGAL's weighted locally optimal projection, through a program of its own, beside the library's variant of that name.
//!
//! `scripts/build_cgal_peer.sh` makes the program where CGAL's headers and a C++ compiler are installed. CGAL shuffles its input and
//! begins with the last points of it, which the program hands back in their order: both sides then move the same samples, and the
//! i-th of one is to be the i-th of the other.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use nearfield::application::{Length, Watch, Wlop, WlopSettings, WlopStart, WlopVariant, diagonal};
use nearfield::geometry::generate::{CloudKind, add_noise, cloud};
use nearfield::geometry::vector;
use nearfield::{AabbTreeN, AabbTreeNSettings};

use super::farthest;
use crate::Result;

const SEED: u64 = 20_261_129;
const N_POINTS: usize = 50_000;
/// Part of the diagonal.
const NOISE: f64 = 0.002;
const PERCENT: f64 = 5.0;
/// Iterations, and the largest distance by the diagonal that samples of both may then have.
const ROWS: [(u32, f64); 2] = [(1, 1e-9), (35, 1e-6)];

/// What the program gave.
struct Peer {
    version: String,
    /// CGAL's default radius.
    usual: f64,
    milliseconds: f64,
    /// Samples as they began, and at the end.
    first: Vec<[f64; 3]>,
    last: Vec<[f64; 3]>,
}

/// A folder that is removed in the end.
struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Compares samples of both; prints a row a question.
pub(super) fn compare(program: &Path) -> Result<()> {
    let folder = Scratch(std::env::temp_dir().join(format!("nearfield-cgal-{}", std::process::id())));
    fs::create_dir_all(&folder.0)?;
    let mut exact = cloud(CloudKind::Torus, N_POINTS, SEED).points;
    add_noise(&mut exact, NOISE * 4.04, SEED);
    // Numbers that are no f32.
    let points: Vec<[f64; 3]> = exact.iter().map(|p| p.as_dvec3().to_array().map(|x| x * 1.1 + 0.3)).collect();
    fs::write(folder.0.join("points"), bytes(&points))?;
    let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default())?;
    let size = diagonal(&tree);
    println!(
        "| iterations | uniform | radius | samples | farthest / diagonal | limit | CGAL, one thread | Nearfield |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    let (mut version, mut failed) = (String::new(), Vec::new());
    for uniform in [false, true] {
        for (iterations, limit) in ROWS {
            let peer = ask(program, &folder.0, iterations, uniform)?;
            let settings = WlopSettings {
                weigh_inputs: uniform,
                tolerance: 0.0,
                ..WlopSettings::new(WlopVariant::Cgal).iterations(iterations)
            };
            let start = Instant::now();
            let first = WlopStart::Positions(&peer.first);
            let mut wlop = Wlop::new(&tree, &first, &settings, &mut Watch::none())?;
            // The default radius is CGAL's but for rounding, which is not what is compared.
            let radius = wlop.radius();
            if !((radius - peer.usual).abs() <= 1e-12 * radius) {
                return Err(format!("the default radius is {radius}, CGAL's {}", peer.usual).into());
            }
            let settings = settings.radius(Length::Absolute(peer.usual));
            wlop = Wlop::new(&tree, &first, &settings, &mut Watch::none())?;
            wlop.run(&mut Watch::none())?;
            let own_ms = start.elapsed().as_secs_f64() * 1e3;
            let far = |(a, b): (&[f64; 3], &[f64; 3])| vector::norm(vector::subtract(*a, *b)) / size;
            let farthest = farthest(wlop.positions(), &peer.last)? / size;
            let moved = peer.first.iter().zip(&peer.last).map(far).sum::<f64>() / peer.first.len() as f64;
            if !(moved > 1e-4) {
                return Err(format!("CGAL moved its samples by {moved} of the diagonal: nothing is compared").into());
            }
            println!(
                "| {iterations} | {uniform} | {radius:.5} | {} | {farthest:.2e} | {limit:e} | {:.0} ms | {own_ms:.0} ms |",
                peer.first.len(),
                peer.milliseconds
            );
            if !(farthest <= limit) {
                failed.push(format!("{iterations} iterations, uniform {uniform}: {farthest:e} of the diagonal apart"));
            }
            version = peer.version;
        }
    }
    println!("\nCGAL {version}, {N_POINTS} points, noise {NOISE} of the diagonal; Nearfield with all threads.");
    if failed.is_empty() { Ok(()) } else { Err(failed.join("; ").into()) }
}

fn ask(program: &Path, folder: &Path, iterations: u32, uniform: bool) -> Result<Peer> {
    let output = folder.join("samples");
    let numbers = [PERCENT.to_string(), "-1".to_owned(), iterations.to_string(), u8::from(uniform).to_string()];
    let ran = Command::new(program)
        .arg(folder.join("points"))
        .arg(N_POINTS.to_string())
        .args(numbers)
        .arg(&output)
        .output()
        .map_err(|error| format!("{}: {error}", program.display()))?;
    if !ran.status.success() {
        return Err(format!("{}: {}", program.display(), String::from_utf8_lossy(&ran.stderr).trim()).into());
    }
    let told = String::from_utf8_lossy(&ran.stdout).into_owned();
    let words: Vec<&str> = told.split_whitespace().collect();
    let &[version, n, usual, milliseconds] = words.as_slice() else {
        return Err(format!("{}: found {} words, expected 4", program.display(), words.len()).into());
    };
    let (n, usual, milliseconds): (usize, f64, f64) = (n.parse()?, usual.parse()?, milliseconds.parse()?);
    let mut first = numbers_of(&fs::read(&output)?);
    if first.len() != 2 * n || n == 0 {
        return Err(format!("{}: found {} samples, expected twice {n}", program.display(), first.len()).into());
    }
    let last = first.split_off(n);
    Ok(Peer { version: version.to_owned(), usual, milliseconds, first, last })
}

fn bytes(points: &[[f64; 3]]) -> Vec<u8> {
    points.iter().flatten().flat_map(|x| x.to_le_bytes()).collect()
}

fn numbers_of(bytes: &[u8]) -> Vec<[f64; 3]> {
    let number = |bytes: &[u8]| bytes.try_into().map_or(f64::NAN, f64::from_le_bytes);
    bytes.chunks_exact(24).map(|p| [number(&p[..8]), number(&p[8..16]), number(&p[16..])]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_written_as_they_are_read() {
        let points = [[0.1, -2.5e-300, 3.0], [f64::MAX, 0.0, 1.0 / 3.0]];
        assert_eq!(numbers_of(&bytes(&points)), points);
    }
}
