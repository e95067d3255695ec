//! `nearfield-bench transfers`: bytes a second to the device and back, beside a copy on the host by all threads.
//!
//! "First" is the first transfer of a context that was just opened, to whose staging memory nothing was written before; else the median of several. A
//! "fresh" destination is memory that was just taken from the system, whose pages are not there yet; a "reused" one has them. A write counts until the
//! device is done with it. What comes back is compared with what went there.

use std::time::Instant;

use nearfield::gpu::{Buffer, DeviceChoice, Gpu, wgpu};
use rayon::prelude::*;

use crate::Result;
use crate::measure::median;
use crate::primitives::words;
use crate::provenance::{COMMIT, Device, Machine};

/// Timed runs of a row.
const RUNS: usize = 11;
/// No further run is begun after so many seconds.
const SECONDS: f64 = 2.0;
/// Bytes that a thread copies at a time on the host.
const BLOCK: usize = 256 << 10;

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// auto, gpu, gpu:N or part of a device name
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,

    /// Largest transfer in MiB; sizes are powers of two from 1 MiB on
    #[arg(long, value_name = "MIB", default_value_t = 1024)]
    pub largest: usize,
}

/// Seconds of one size.
struct Times {
    write_first: f64,
    write: f64,
    read_first: f64,
    read_fresh: f64,
    read_reused: f64,
    copy_fresh: f64,
    copy_reused: f64,
}

/// Prints a table of all sizes.
///
/// # Errors
/// Of the library; no GPU; data that came back changed.
pub fn run(arguments: &Arguments) -> Result<()> {
    let machine = Machine::open(&arguments.device)?;
    let Device::Gpu(gpu) = &machine.device else {
        return Err("transfers need a GPU: there is nothing to transfer to the CPU".into());
    };
    println!("{} ({}), host {}, commit {COMMIT}", machine.name, machine.driver, machine.host);
    println!();
    println!("GB/s (10⁹ bytes), and in brackets milliseconds; median of up to {RUNS} runs");
    println!();
    println!(
        "| MiB | write, first | write | read, first and fresh | read, fresh | read, reused | copy on the host, fresh | reused |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    let limit = gpu.limits().binding_bytes.min(gpu.limits().buffer_bytes);
    for mib in std::iter::successors(Some(1usize), |mib| mib.checked_mul(2)).take_while(|&mib| mib <= arguments.largest)
    {
        let bytes = mib << 20;
        if bytes as u64 > limit {
            println!("| {mib} | does not fit into a buffer of this device | | | | | | |");
            continue;
        }
        let times = measure(&machine, gpu, bytes / 4)?;
        let cell = |seconds: f64| format!("{:.1} ({:.2})", bytes as f64 / seconds * 1e-9, seconds * 1e3);
        let Times { write_first, write, read_first, read_fresh, read_reused, copy_fresh, copy_reused } = times;
        let cells = [write_first, write, read_first, read_fresh, read_reused, copy_fresh, copy_reused].map(cell);
        println!("| {mib} | {} |", cells.join(" | "));
    }
    Ok(())
}

fn measure(machine: &Machine, gpu: &Gpu, n: usize) -> Result<Times> {
    let data = words::<u32>(n);
    let other: Vec<u32> = data.par_iter().map(|word| !word).collect();

    // A context of its own has no staging memory yet.
    let fresh = machine.reopen()?;
    let buffer: Buffer<u32> = fresh.buffer("data", n)?;
    let write_first = seconds(|| write(&fresh, &buffer, &data))?;
    let start = Instant::now();
    let found = fresh.read(&buffer)?;
    let read_first = start.elapsed().as_secs_f64();
    check(&found, &data)?;
    drop((found, buffer, fresh));

    let buffer: Buffer<u32> = gpu.buffer("data", n)?;
    let mut rounds = 0;
    let write_again = repeat(|| {
        rounds += 1;
        seconds(|| write(gpu, &buffer, if rounds % 2 == 0 { &data } else { &other }))
    })?;
    let right = if rounds % 2 == 0 { &data } else { &other };
    let mut found = Vec::new();
    let read_fresh = repeat(|| {
        found = Vec::new();
        let start = Instant::now();
        found = gpu.read(&buffer)?;
        Ok(start.elapsed().as_secs_f64())
    })?;
    check(&found, right)?;
    found.fill(0);
    let read_reused = repeat(|| seconds(|| Ok(gpu.read_into(&buffer, 0, &mut found)?)))?;
    check(&found, right)?;
    let copy_fresh = repeat(|| {
        found = Vec::new();
        let start = Instant::now();
        found = vec![0; n];
        copy(&mut found, &data);
        Ok(start.elapsed().as_secs_f64())
    })?;
    let copy_reused = repeat(|| {
        seconds(|| {
            copy(&mut found, &data);
            Ok(())
        })
    })?;
    check(&found, &data)?;
    Ok(Times { write_first, write: write_again, read_first, read_fresh, read_reused, copy_fresh, copy_reused })
}

/// Writes and waits until the device has all.
fn write(gpu: &Gpu, buffer: &Buffer<u32>, data: &[u32]) -> Result<()> {
    gpu.write(buffer, 0, data)?;
    // What the queue keeps for later goes with a submission.
    gpu.commands("nothing").submit()?;
    gpu.device().poll(wgpu::PollType::wait_indefinitely())?;
    Ok(())
}

/// Copies on the host by all threads.
fn copy(to: &mut [u32], from: &[u32]) {
    to.par_chunks_mut(BLOCK / 4).zip(from.par_chunks(BLOCK / 4)).for_each(|(to, from)| to.copy_from_slice(from));
}

fn check(found: &[u32], expected: &[u32]) -> Result<()> {
    if found.len() == expected.len() && found.par_iter().zip(expected).all(|(a, b)| a == b) {
        return Ok(());
    }
    Err(format!("{} words came back changed", expected.len()).into())
}

fn seconds(work: impl FnOnce() -> Result<()>) -> Result<f64> {
    let start = Instant::now();
    work()?;
    Ok(start.elapsed().as_secs_f64())
}

/// Median of several runs after one that does not count.
fn repeat(mut run: impl FnMut() -> Result<f64>) -> Result<f64> {
    run()?;
    let (start, mut times) = (Instant::now(), Vec::new());
    while times.len() < RUNS && (times.is_empty() || start.elapsed().as_secs_f64() < SECONDS) {
        times.push(run()?);
    }
    Ok(median(&times))
}
