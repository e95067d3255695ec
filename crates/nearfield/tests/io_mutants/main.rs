//! Damaged files against every reader: no panic and no abort reaches the caller, and no damage asks for much memory.
//!
//! Each seed file is damaged `MUTANTS` times in 1 to 3 places, always the same way. Whatever is read must be consistent;
//! whatever is refused must say so in a readable error; the live peak stays within 32 × file size + 64 MB. As the
//! seeds are small, larger files that hold as many records in a byte as their format can stand beside them.

mod memory;
mod mutate;
mod seeds;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};

use libtest_mimic::{Arguments, Failed, Trial};
use nearfield::io::{Format, parse_cloud, parse_mesh};
use nearfield::{Error, PointCloud, TriMesh};

use mutate::Random;
use seeds::Seed;

#[global_allocator]
static MEMORY: memory::Counting = memory::Counting;

const MUTANTS: u64 = 20_000;

/// The longest an error may be: it is for reading.
const LONGEST_MESSAGE: usize = 600;

/// Panics that a guard caught inside a third-party decoder, and those that it did not catch.
static PANICS: AtomicU64 = AtomicU64::new(0);

fn main() {
    let mut arguments = Arguments::from_args();
    // The peak is of the whole process, so one reader at a time.
    arguments.test_threads = Some(1);
    std::panic::set_hook(Box::new(|_| {
        PANICS.fetch_add(1, Ordering::Relaxed);
    }));
    let mut trials = vec![];
    for seed in seeds::all() {
        let name = format!("{}_mutants_are_read_or_refused", seed.name);
        let cut = seed.clone();
        trials.push(Trial::test(name, move || mutants(&seed)));
        let name = format!("{}_cut_at_any_byte_is_read_or_refused", cut.name);
        trials.push(Trial::test(name, move || cut_anywhere(&cut)));
    }
    for seed in seeds::dense() {
        let name = format!("{}_stays_within_the_memory_bound", seed.name);
        trials.push(Trial::test(name, move || must_be_read(&seed)));
    }
    trials.push(Trial::test("a_planted_leak_of_memory_is_seen", planted_allocation_is_seen));
    trials.push(Trial::test("a_laz_file_that_asks_for_20_gb_is_refused", || {
        let bytes = seeds::laz_with_endless_chunk_table();
        match check(&bytes, Format::Laz)? {
            Outcome::Refused => Ok(()),
            Outcome::Read => Err("it was read".into()),
        }
    }));
    libtest_mimic::run(&arguments, trials).exit();
}

fn mutants(seed: &Seed) -> Result<(), Failed> {
    must_be_read(seed)?;
    let panics_before = PANICS.load(Ordering::Relaxed);
    let mut read = 0;
    for number in 0..MUTANTS {
        let mut random = Random::new(number);
        let bytes = mutate::mutant(&seed.bytes, &mut random);
        match check(&bytes, seed.format) {
            Ok(Outcome::Read) => read += 1,
            Ok(Outcome::Refused) => {}
            Err(failure) => return Err(with_file(seed, number, &bytes, &failure)),
        }
    }
    if read == 0 || read == MUTANTS {
        return Err(format!("{read} of {MUTANTS} mutants were read: the damage tests nothing").into());
    }
    let caught = PANICS.load(Ordering::Relaxed) - panics_before;
    println!("{}: {MUTANTS} mutants, {read} read, {caught} decoder panics turned into errors", seed.name);
    Ok(())
}

fn must_be_read(seed: &Seed) -> Result<(), Failed> {
    match check(&seed.bytes, seed.format)? {
        Outcome::Read => Ok(()),
        Outcome::Refused => Err(format!("the valid file {} is refused", seed.name).into()),
    }
}

fn cut_anywhere(seed: &Seed) -> Result<(), Failed> {
    for end in 0..seed.bytes.len() {
        if let Err(failure) = check(&seed.bytes[..end], seed.format) {
            return Err(with_file(seed, end as u64, &seed.bytes[..end], &failure));
        }
    }
    Ok(())
}

/// Keeps the file that failed, so that it can be looked at.
fn with_file(seed: &Seed, number: u64, bytes: &[u8], failure: &str) -> Failed {
    let path = format!("{}/{}-mutant-{number}", env!("CARGO_TARGET_TMPDIR"), seed.name);
    let kept = match std::fs::write(&path, bytes) {
        Ok(()) => path,
        Err(error) => format!("nowhere ({error})"),
    };
    format!("mutant {number} of {}: {failure}; kept as {kept}", seed.name).into()
}

enum Outcome {
    Read,
    Refused,
}

/// Reads `bytes` as a cloud and, where the format has meshes, as a mesh.
fn check(bytes: &[u8], format: Format) -> Result<Outcome, String> {
    let cloud = guarded(bytes, || parse_cloud(bytes, format))?;
    if format.info().reads_mesh {
        match guarded(bytes, || parse_mesh(bytes, format))? {
            Ok(mesh) => check_mesh(&mesh)?,
            Err(error) => check_error(&error)?,
        }
    }
    match cloud {
        Ok(cloud) => check_cloud(&cloud).map(|()| Outcome::Read),
        Err(error) => check_error(&error).map(|()| Outcome::Refused),
    }
}

fn guarded<T>(bytes: &[u8], read: impl FnOnce() -> nearfield::Result<T>) -> Result<nearfield::Result<T>, String> {
    let limit = 32 * bytes.len() + (64 << 20);
    let (result, peak) = memory::peak_of(|| catch_unwind(AssertUnwindSafe(read)));
    if peak > limit {
        return Err(format!("{peak} bytes of memory for a file of {} bytes, allowed are {limit}", bytes.len()));
    }
    result.map_err(|_| "a panic reached the caller".to_owned())
}

fn check_cloud(cloud: &PointCloud) -> Result<(), String> {
    match cloud.validate() {
        Err(error @ Error::LengthMismatch { .. }) => Err(error.to_string()),
        // Coordinates are the caller's to judge.
        _ => Ok(()),
    }
}

fn check_mesh(mesh: &TriMesh) -> Result<(), String> {
    let n = mesh.vertices.len();
    if let Some(triangle) = mesh.triangles.iter().find(|t| t.iter().any(|&v| v as usize >= n)) {
        return Err(format!("triangle {triangle:?} of {n} vertices"));
    }
    let lengths = [mesh.normals.as_ref().map(Vec::len), mesh.colors.as_ref().map(Vec::len)];
    match lengths.into_iter().flatten().find(|&length| length != n) {
        Some(length) => Err(format!("{length} normals or colors of {n} vertices")),
        None => Ok(()),
    }
}

fn check_error(error: &Error) -> Result<(), String> {
    let message = error.to_string();
    match error {
        Error::File(_) | Error::Unsupported { .. } | Error::OutOfMemory { .. } if message.len() <= LONGEST_MESSAGE => {
            Ok(())
        }
        Error::File(_) => Err(format!("a message of {} bytes", message.len())),
        _ => Err(format!("the wrong kind of error: {message}")),
    }
}

/// The measuring itself can fail a reader.
fn planted_allocation_is_seen() -> Result<(), Failed> {
    let planted = guarded(b"", || Ok(std::hint::black_box(vec![1u8; 65 << 20]).len()));
    match planted {
        Err(message) if message.contains("bytes of memory") => Ok(()),
        other => Err(format!("65 MB for an empty file went through: {other:?}").into()),
    }
}
