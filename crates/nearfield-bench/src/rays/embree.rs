//! Hits and times beside those of Embree, on the same rays and the same cores, through a program of its own.
//!
//! `scripts/build_embree_peer.sh` makes the program where Embree's header and a C++ compiler are installed. It takes mesh and rays
//! from files and leaves its hits in another one. Each is compared as an answer of a device is: the same triangle with t
//! within rounding, another answer that rounding explains, or one that it does not.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::{HitRecord, Ray, TriMesh, Vec3};

use super::Lab;
use super::check::{Answer, Expected};
use super::meshes::{Named, STANFORD};
use super::method::{self, Method, Scene};
use super::rows::{Row, digits};
use super::shots::{self, Question};
use crate::Result;
use crate::measure::Timing;

/// Rays into each mesh: half of them primary, half random.
const RAYS: usize = 1_000_000;
/// Triangles of the soup.
const SOUP: usize = 100_000;
/// Casts that Embree times.
const RUNS: usize = 5;
/// Embree's kinds of scenes: those that keep edges tight, and those that do not.
const MODES: [&str; 2] = ["robust", "fast"];

/// A folder that is removed in the end.
struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// What the program gave.
struct Run {
    hits: Vec<HitRecord>,
    build: f64,
    cast: f64,
}

fn run(program: &Path, mesh: &TriMesh, rays: &[Ray], threads: usize, mode: &str) -> Result<Run> {
    let folder = Scratch(std::env::temp_dir().join(format!("nearfield-embree-{}", std::process::id())));
    fs::create_dir_all(&folder.0)?;
    let path = |name: &str| folder.0.join(name);
    let floats = |of: Vec3| of.to_array().map(f32::to_bits);
    let ray = |r: &Ray| {
        let ([a, b, c], [d, e, f]) = (floats(r.origin), floats(r.direction));
        [a, b, c, r.t_min.to_bits(), d, e, f, r.t_max.to_bits()]
    };
    fs::write(path("vertices"), little_endian(mesh.vertices.iter().flat_map(|&v| floats(v))))?;
    fs::write(path("triangles"), little_endian(mesh.triangles.iter().flatten().copied()))?;
    fs::write(path("rays"), little_endian(rays.iter().flat_map(ray)))?;
    let files = ["vertices", "triangles", "rays", "hits"].map(path);
    let ran =
        Command::new(program).args(&files).args([threads.to_string(), RUNS.to_string(), mode.to_owned()]).output();
    let ran = ran.map_err(|error| format!("{}: {error}", program.display()))?;
    if !ran.status.success() {
        return Err(format!("{}: {}", program.display(), String::from_utf8_lossy(&ran.stderr).trim()).into());
    }
    let times = String::from_utf8_lossy(&ran.stdout).into_owned();
    let times: Vec<f64> = times.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    let &[build, cast] = times.as_slice() else {
        return Err(format!("{}: found {} times, expected 2", program.display(), times.len()).into());
    };
    let bytes = fs::read(&files[3])?;
    let word = |at: &[u8]| u32::from_le_bytes([at[0], at[1], at[2], at[3]]);
    let hit = |bytes: &[u8]| HitRecord {
        triangle: word(&bytes[..4]),
        t: f32::from_bits(word(&bytes[4..8])),
        weights: [&bytes[8..12], &bytes[12..16]].map(|at| f32::from_bits(word(at))),
    };
    Ok(Run { hits: bytes.chunks_exact(16).map(hit).collect(), build, cast })
}

fn little_endian(words: impl Iterator<Item = u32>) -> Vec<u8> {
    words.flat_map(u32::to_le_bytes).collect()
}

/// Compares on the Stanford bunny and on a soup, and prints agreement and times.
///
/// # Errors
/// A program that fails; what a build or a cast returns; an answer of this library that is wrong.
pub fn measure(lab: &mut Lab, program: &Path) -> Result<()> {
    let soup = Named { name: format!("soup of {SOUP}"), mesh: mesh(MeshKind::Soup, SOUP, shots::SEED) };
    let threads = rayon::current_num_threads();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let half = lab.rays(RAYS / 2);
    for named in [lab.source.mesh(STANFORD)?, soup] {
        let scene = Scene::new(&named.mesh, &lab.tree)?;
        let primary = shots::primary(&named.mesh, (half as f64).sqrt() as usize);
        let random = shots::random(&named.mesh, 2 * half - primary.len());
        for (name, rays) in [("primary", primary), ("random", random)] {
            let expected = Expected::of(&scene.triangles, &rays, Question::Closest)?;
            let row = Row {
                part: "embree",
                mesh: named.name.clone(),
                triangles: named.triangles(),
                device: lab.machine.host.clone(),
                shots: name.to_owned(),
                rays: rays.len(),
                sample: expected.sample(),
                ..Row::default()
            };
            for (threads, place) in [(threads, ""), (1, ", one thread")] {
                let mut best = f64::INFINITY;
                for mode in MODES {
                    let run = run(program, &named.mesh, &rays, threads, mode)?;
                    best = best.min(run.cast);
                    let compared = expected.compare(&Answer::Closest(run.hits))?;
                    let cast = method::Cast {
                        device: None,
                        host: Timing { median: run.cast, fastest: run.cast },
                        round_trip: None,
                        runs: RUNS,
                        differing: compared.within_rounding,
                    };
                    let note = format!(
                        "{} the same, {} other within rounding, {} other beyond{}",
                        compared.same,
                        compared.within_rounding,
                        compared.beyond,
                        compared.first.map_or_else(String::new, |first| format!(", the first: {first}"))
                    );
                    let method = format!("Embree, {mode}{place}");
                    lab.add(Row { method, build: Some(run.build), cast: Some(cast), note, ..row.clone() });
                }
                for method in [Method::CpuRopes, Method::CpuBvh] {
                    let Some(built) = scene.build(method, None)? else { continue };
                    let effort = lab.effort(method);
                    let run = || method::cast(&built.search, &rays, Question::Closest, &expected, effort);
                    let cast = if threads == 1 { one.install(run) } else { run() }?;
                    let note = format!("{} of Embree's time", digits(cast.host.median / best));
                    let method = format!("{}{place}", method.name());
                    lab.add(Row { method, build: Some(built.build), cast: Some(cast), note, ..row.clone() });
                }
            }
        }
    }
    Ok(())
}
