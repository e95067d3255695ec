//! `nearfield-bench batches`: the lists of more points than one list has memory for, batch by batch on the CPU, with the memory at its peak.
//!
//! A list of 100 million points with 49 neighbours each has 20 GB of indices. Whoever wants all rows takes them for some queries at a time: the structure
//! is built once, each batch asks with its own part of the points.

use std::time::Instant;

use nearfield::{FixedRadius, GridSettings, NeighborSearch, UniformGrid};

use crate::Result;
use crate::check::{ExpectedOfSome, wrong};
use crate::provenance::{COMMIT, processor};
use crate::sets::Set;

/// Queries whose counts are compared with those of a plain loop over all points.
const SAMPLE: usize = 16;

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The set: one a run, whose memory at its peak is that of the process
    #[arg(long, value_name = "SET", default_value = "uniform-100m")]
    pub set: Set,

    /// Queries of a batch
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    pub batch: usize,

    /// Threads; all where it is not given
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
}

/// Builds and asks, prints a table.
///
/// # Errors
/// Of the library; a wrong answer; `threads` or `batch` of 0.
pub fn run(arguments: &Arguments) -> Result<()> {
    let threads = arguments.threads.unwrap_or_else(rayon::current_num_threads);
    if threads == 0 || arguments.batch == 0 {
        return Err(format!("{threads} threads, batches of {}: expected at least one each", arguments.batch).into());
    }
    println!("{threads} threads of {}, commit {COMMIT}; lists of {} queries at a time", processor(), arguments.batch);
    println!();
    println!(
        "| set | mean neighbours | build, s | all lists, s | entries | bytes at the peak, GiB | of them points and structure |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    pool.install(|| measure(&arguments.set, arguments.batch))
}

fn measure(set: &Set, batch: usize) -> Result<()> {
    let (points, radius) = (set.points(), set.radius());
    let start = Instant::now();
    let grid = UniformGrid::build(&points, &GridSettings::for_radius(radius))?;
    let build = start.elapsed().as_secs_f64();
    let held = size_of_val(&points[..]) as u64 + grid.memory_bytes();
    let mut lengths: Vec<u32> = Vec::with_capacity(points.len());
    let mut lists = 0.0;
    for queries in points.chunks(batch) {
        let start = Instant::now();
        let list = grid.list(&FixedRadius::new(radius).queries(queries))?;
        lists += start.elapsed().as_secs_f64();
        if list.offsets().last() != Some(&(list.indices().len() as u64)) {
            return Err(wrong(format!(
                "{} indices, the offsets end at {:?}",
                list.indices().len(),
                list.offsets().last()
            )));
        }
        lengths.extend(list.offsets().windows(2).map(|pair| (pair[1] - pair[0]) as u32));
    }
    let peak = peak_memory();
    ExpectedOfSome::of(&points, radius, SAMPLE).check_counts(&lengths)?;
    let entries: u64 = lengths.iter().map(|&length| u64::from(length)).sum();
    println!(
        "| {set} | {:.1} | {build:.2} | {lists:.2} | {entries} | {} | {:.2} |",
        entries as f64 / points.len() as f64,
        peak.map_or("–".to_owned(), |bytes| format!("{:.2}", gib(bytes))),
        gib(held)
    );
    Ok(())
}

fn gib(bytes: u64) -> f64 {
    bytes as f64 / (1u64 << 30) as f64
}

/// Most bytes that the process has had in memory; `None` where the system does not tell.
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(1024 * line.trim().trim_end_matches("kB").trim().parse::<u64>().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_in_batches_are_right_and_settings_that_mean_nothing_are_refused() {
        let set = |text: &str| text.parse().expect("a set");
        for batch in [1000, 4999, 10_000] {
            run(&Arguments { set: set("uniform-5k"), batch, threads: Some(2) }).expect("right lists");
            run(&Arguments { set: set("clustered-3k"), batch, threads: None }).expect("right lists");
        }
        assert!(run(&Arguments { set: set("uniform-5k"), batch: 0, threads: None }).is_err());
        assert!(run(&Arguments { set: set("uniform-5k"), batch: 1, threads: Some(0) }).is_err());
    }
}
