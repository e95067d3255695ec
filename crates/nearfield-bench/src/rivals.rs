//! `nearfield-bench rivals`: lists and nearest points on the CPU beside kiddo's kd-tree, in one run on the same points.
//!
//! Points are taken in random order and along the Hilbert curve, as a simulation would keep them. Every answer is checked: ours by the rows that
//! must be right, kiddo's by its lengths. Ratios are what carries over to another machine; times do not.

use std::fs;
use std::path::PathBuf;

use nearfield::curve::order;
use nearfield::{AabbTree, AabbTreeSettings, Curve, FixedRadius, GridSettings, Knn, KnnSearch, NeighborSearch};
use nearfield::{UniformGrid, Vec3};

use crate::baselines::kd_tree_cpu::KdTree;
use crate::baselines::points::{Points, Queries};
use crate::check::{Expected, check_nearest};
use crate::measure::{Effort, repeat};
use crate::provenance::{COMMIT, processor};
use crate::sets::Set;
use crate::{Error, Result};

/// Nearest points that are asked for.
const NEAREST: u32 = 16;
/// Runs of kiddo, and of everything by one thread, take long: no further one is begun after so many seconds.
const SECONDS: f64 = 10.0;

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The sets, such as uniform-1m
    #[arg(long, value_name = "SET", value_delimiter = ',', default_value = "uniform-100k,uniform-1m,clustered-100k")]
    pub sets: Vec<Set>,

    /// Timed runs of ours
    #[arg(long, value_name = "N", default_value_t = 7)]
    pub runs: usize,

    /// Threads; all where it is not given
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,

    /// Write every row to this CSV file
    #[arg(long)]
    pub csv: Option<PathBuf>,
}

/// Times of one work in milliseconds.
struct Row {
    set: Set,
    mean_neighbors: f64,
    work: &'static str,
    order: &'static str,
    one_thread: f64,
    all_threads: f64,
    kiddo: Option<f64>,
}

impl Row {
    /// How many times as fast all threads are as one.
    fn scaling(&self) -> f64 {
        self.one_thread / self.all_threads
    }

    fn gain(&self) -> Option<f64> {
        self.kiddo.map(|kiddo| kiddo / self.all_threads)
    }
}

/// Runs what was asked for, prints a table and writes it.
///
/// # Errors
/// Of the library; a wrong answer; a file that cannot be written; `threads` of 0.
pub fn run(arguments: &Arguments) -> Result<()> {
    let threads = arguments.threads.unwrap_or_else(rayon::current_num_threads);
    if threads == 0 {
        return Err("0 threads: expected at least one".into());
    }
    let pool = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().map_err(Error::from);
    let (one, all) = (pool(1)?, pool(threads)?);
    println!(
        "{threads} threads of {}, commit {COMMIT}; kiddo 5 with its immutable tree, shared out by rayon",
        processor()
    );
    println!();
    println!(
        "| set | mean neighbours | work | order of points | one thread, ms | {threads} threads, ms | scaling | kiddo, ms | times as fast |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    let mut rows = Vec::new();
    for set in &arguments.sets {
        let random = set.points();
        let places = order(&random, Curve::Hilbert)?;
        let along: Vec<Vec3> = places.iter().map(|&i| random[i as usize]).collect();
        for (points, order) in [(&random, "random"), (&along, "hilbert")] {
            let work = Work { set, points, order, runs: arguments.runs, one: &one, all: &all };
            for row in work.measure()? {
                print(&row);
                rows.push(row);
            }
        }
    }
    if let Some(path) = &arguments.csv {
        fs::write(path, csv(&rows, threads))?;
    }
    Ok(())
}

/// A set in one order.
struct Work<'a> {
    set: &'a Set,
    points: &'a [Vec3],
    order: &'static str,
    runs: usize,
    one: &'a rayon::ThreadPool,
    all: &'a rayon::ThreadPool,
}

impl Work<'_> {
    fn measure(&self) -> Result<[Row; 2]> {
        let (points, radius) = (self.points, self.set.radius());
        let expected = Expected::of(points, radius)?;
        let question = FixedRadius::new(radius);
        let list = || {
            let grid = UniformGrid::build(points, &GridSettings::for_radius(radius))?;
            Ok((grid.list(&question)?, Vec::new()))
        };
        let nearest = || {
            let tree = AabbTree::build(points, &AabbTreeSettings::default())?;
            Ok((tree.knn(&Knn::new(NEAREST))?, Vec::new()))
        };
        let ours = Effort { warm_up: 0.0, runs: self.runs, seconds: SECONDS };
        let flat: Vec<f32> = points.iter().flat_map(|p| p.to_array()).collect();
        let copied = Points::new(3, flat)?;

        let (rows, alone) = self.one.install(|| repeat(ours, list))?;
        expected.check_list(rows.offsets(), rows.indices())?;
        let (rows, together) = self.all.install(|| repeat(ours, list))?;
        expected.check_list(rows.offsets(), rows.indices())?;
        drop(rows);
        let kiddo = self.kiddo(|| Ok(KdTree::build(&copied)?.list_within(Queries::Points, radius)?.counts()))?;
        if let Some((counts, _)) = &kiddo {
            expected.check_counts(counts)?;
        }
        let row = |work, one_thread, all_threads, kiddo| Row {
            set: *self.set,
            mean_neighbors: expected.mean(),
            work,
            order: self.order,
            one_thread,
            all_threads,
            kiddo,
        };
        let lists =
            row("build + list", alone.wall.median, together.wall.median, kiddo.map(|(_, milliseconds)| milliseconds));

        let (rows, alone) = self.one.install(|| repeat(ours, nearest))?;
        check_nearest(points, NEAREST, rows.indices())?;
        let (rows, together) = self.all.install(|| repeat(ours, nearest))?;
        check_nearest(points, NEAREST, rows.indices())?;
        drop(rows);
        let kiddo = self.kiddo(|| {
            let rows = KdTree::build(&copied)?.knn(Queries::Points, NEAREST as usize)?;
            Ok((0..points.len()).flat_map(|i| rows.row(i).to_vec()).collect::<Vec<u32>>())
        })?;
        if let Some((indices, _)) = &kiddo {
            check_nearest(points, NEAREST, indices)?;
        }
        let nearest = row(
            "build + 16 nearest",
            alone.wall.median,
            together.wall.median,
            kiddo.map(|(_, milliseconds)| milliseconds),
        );
        Ok([lists, nearest])
    }

    /// An answer of kiddo on all threads and its median time; `None` where its tree cannot be built of these points.
    fn kiddo<T>(&self, mut answer: impl FnMut() -> nearfield::Result<T> + Send) -> Result<Option<(T, f64)>>
    where
        T: Send,
    {
        let effort = Effort { warm_up: 0.0, runs: 3, seconds: SECONDS };
        let timed = self.all.install(|| repeat(effort, || Ok((answer()?, Vec::new()))));
        match timed {
            Ok((answer, measured)) => Ok(Some((answer, measured.wall.median))),
            Err(error) => match error.downcast_ref::<nearfield::Error>() {
                Some(nearfield::Error::Unsupported { .. }) => {
                    eprintln!("{}: {error}", self.set);
                    Ok(None)
                }
                _ => Err(error),
            },
        }
    }
}

fn print(row: &Row) {
    let text = |value: Option<f64>| value.map_or("–".to_owned(), |v| format!("{v:.1}"));
    println!(
        "| {} | {:.1} | {} | {} | {:.1} | {:.1} | {:.2} | {} | {} |",
        row.set,
        row.mean_neighbors,
        row.work,
        row.order,
        row.one_thread,
        row.all_threads,
        row.scaling(),
        text(row.kiddo),
        text(row.gain())
    );
}

fn csv(rows: &[Row], threads: usize) -> String {
    let mut text =
        "host,commit,threads,set,mean_neighbors,work,order,one_thread_ms,all_threads_ms,kiddo_ms\n".to_owned();
    for row in rows {
        let kiddo = row.kiddo.map_or(String::new(), |v| format!("{v:.3}"));
        let host = processor();
        text += &format!(
            "\"{host}\",{COMMIT},{threads},{},{:.3},{},{},{:.3},{:.3},{kiddo}\n",
            row.set, row.mean_neighbors, row.work, row.order, row.one_thread, row.all_threads
        );
    }
    text
}
