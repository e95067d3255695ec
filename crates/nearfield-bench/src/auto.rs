//! `nearfield-bench auto`: what `auto` builds for each set and question, beside every structure there is.
//!
//! A figure is build and answer together, as one who asks once pays them: by the device's timestamps on a GPU, where copies cost the
//! same by every structure, by the clock on the CPU. The loss is by how much the structure that `auto` picks takes longer than the best.
//! Every answer is checked.

use std::path::PathBuf;

use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield::query::{Clock, Purpose, Stage};
use nearfield::{FixedRadius, Index, IndexSettings, Knn, KnnSearch, NeighborSearch, Report, StructureChoice, Vec3};

use crate::check::{Expected, check_nearest};
use crate::device::timed::not_possible;
use crate::measure::{Effort, Measured, repeat};
use crate::provenance::{COMMIT, Device, Machine};
use crate::sets::Set;
use crate::{Error, Result};

/// Nearest points that are asked for.
const NEAREST: u32 = 16;
/// Loss that is asked for at most.
const ALLOWED: f64 = 0.2;
/// Most pairs that brute force tests: on a GPU in hardware, and elsewhere.
const MOST_PAIRS: [f64; 2] = [1e11, 2e9];

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The sets, such as uniform-1m
    #[arg(
        long,
        value_name = "SET",
        value_delimiter = ',',
        default_value = "uniform-1k,uniform-10k,uniform-100k,uniform-1m,shell-10k,shell-100k,shell-1m,clustered-10k,clustered-100k,clustered-1m"
    )]
    pub sets: Vec<Set>,
    /// auto, cpu, gpu, gpu:N or part of a device name
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,
    /// Timed runs; fewer where they take seconds
    #[arg(long, value_name = "N", default_value_t = 5)]
    pub runs: usize,
    /// Write every row to this CSV file
    #[arg(long)]
    pub csv: Option<PathBuf>,
}

/// What is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Question {
    Count,
    List,
    Nearest,
}

impl Question {
    const ALL: [Self; 3] = [Self::Count, Self::List, Self::Nearest];

    fn name(self) -> &'static str {
        match self {
            Self::Count => "count",
            Self::List => "list",
            Self::Nearest => "16 nearest",
        }
    }
}

/// A question about a set: milliseconds of each structure, and what `auto` picks.
struct Row {
    set: Set,
    mean_neighbors: f64,
    question: Question,
    times: Vec<(StructureChoice, std::result::Result<f64, String>)>,
    picked: String,
    reason: String,
}

impl Row {
    fn best(&self) -> f64 {
        self.times.iter().filter_map(|(_, time)| time.as_ref().ok().copied()).fold(f64::INFINITY, f64::min)
    }

    /// By how much the pick takes longer than the best; `None` where the pick was not measured.
    fn loss(&self) -> Option<f64> {
        let picked = self.times.iter().find(|(structure, _)| structure.name() == self.picked)?;
        picked.1.as_ref().ok().map(|time| time / self.best() - 1.0)
    }
}

/// Measures and prints a line a question; the file is written in the end.
///
/// # Errors
/// `NoDevice`; what a build or a query returns but for what a device does not do; a wrong answer; a file that cannot be written.
pub fn run(arguments: &Arguments) -> Result<()> {
    let machine = Machine::open(&arguments.device)?;
    println!("{} ({}), {}, commit {COMMIT}", machine.name, machine.driver, machine.host);
    println!(
        "Milliseconds of build and answer together; the loss of a pick is asked to be at most {:.0} %.\n",
        100.0 * ALLOWED
    );
    let names: Vec<&str> = StructureChoice::ALL.iter().map(|structure| structure.name()).collect();
    println!("| set | mean neighbours | question | {} | auto picks | loss | why |", names.join(" | "));
    println!("| --- | --- | --- | {}--- | --- | --- |", "--- | ".repeat(names.len()));
    let mut rows = Vec::new();
    for &set in &arguments.sets {
        let (points, radius) = (set.points(), set.radius());
        let asked =
            Asked { machine: &machine, set, expected: Expected::of(&points, radius)?, points, runs: arguments.runs };
        for question in Question::ALL {
            if question == Question::List
                && set.kind == nearfield::geometry::generate::CloudKind::Clustered
                && set.is_big()
            {
                // Hundreds of millions of entries, whose copies are all that would be timed.
                continue;
            }
            let row = asked.row(question)?;
            println!("{}", line(&row));
            rows.push(row);
        }
    }
    let losses: Vec<f64> = rows.iter().filter_map(Row::loss).collect();
    let worst = losses.iter().copied().fold(0.0, f64::max);
    let beyond = losses.iter().filter(|loss| **loss > ALLOWED).count();
    println!(
        "\n{beyond} of {} picks lose more than {:.0} %, the worst {:.0} %",
        rows.len(),
        100.0 * ALLOWED,
        100.0 * worst
    );
    if let Some(path) = &arguments.csv {
        save(path, &rows, &machine)?;
    }
    Ok(())
}

/// A set that is asked about.
struct Asked<'a> {
    machine: &'a Machine,
    set: Set,
    points: Vec<Vec3>,
    expected: Expected,
    runs: usize,
}

impl Asked<'_> {
    fn gpu(&self) -> Option<&Gpu> {
        match &self.machine.device {
            Device::Gpu(gpu) => Some(gpu),
            Device::Cpu => None,
        }
    }

    fn row(&self, question: Question) -> Result<Row> {
        let auto = self.build(question, StructureChoice::Auto)?;
        let (picked, reason) = (auto.structure().to_owned(), auto.reason().unwrap_or_default().to_owned());
        drop(auto);
        let times = StructureChoice::ALL.map(|structure| Ok((structure, self.time(question, structure)?)));
        Ok(Row {
            set: self.set,
            mean_neighbors: self.expected.mean(),
            question,
            times: times.into_iter().collect::<Result<_>>()?,
            picked,
            reason,
        })
    }

    fn build(&self, question: Question, structure: StructureChoice) -> Result<Index> {
        let (fixed, knn) = (FixedRadius::new(self.set.radius()), Knn::new(NEAREST));
        let purpose: Purpose<'_> = if question == Question::Nearest { (&knn).into() } else { (&fixed).into() };
        // The CPU must not take over.
        let device = if self.gpu().is_some() { DeviceChoice::Gpu } else { DeviceChoice::Cpu };
        let settings = IndexSettings { structure, device, ..IndexSettings::default() };
        Ok(match self.gpu() {
            Some(gpu) => Index::build_on(gpu, &self.points, purpose, &settings)?,
            None => Index::build(&self.points, purpose, &settings)?,
        })
    }

    /// Milliseconds of build and answer by a structure, or why it does not answer.
    fn time(&self, question: Question, structure: StructureChoice) -> Result<std::result::Result<f64, String>> {
        let hardware = self.machine.is_hardware_gpu();
        let pairs = (self.points.len() as f64).powi(2);
        if question == Question::Nearest && !structure.finds_nearest() {
            return Ok(Err("needs a radius".to_owned()));
        }
        if structure == StructureChoice::BruteForce && pairs > MOST_PAIRS[usize::from(!hardware)] {
            return Ok(Err("too slow".to_owned()));
        }
        let effort = Effort { warm_up: if hardware { 0.3 } else { 0.0 }, runs: self.runs.max(1), seconds: 3.0 };
        match self.measured(question, structure, effort) {
            Ok(measured) => Ok(Ok(measured.device.filter(|_| self.gpu().is_some()).unwrap_or(measured.wall).median)),
            Err(error) => Ok(Err(not_possible(error)?)),
        }
    }

    fn measured(&self, question: Question, structure: StructureChoice, effort: Effort) -> Result<Measured> {
        let fixed = FixedRadius::new(self.set.radius());
        let stages = |index: &Index, report: &Report| -> Vec<Stage> {
            let all = index.build_stages().into_iter().chain(report.stages.iter().cloned());
            all.filter(|stage| stage.clock == Clock::Device).collect()
        };
        Ok(match question {
            Question::Count => {
                let (counts, measured) = repeat(effort, || {
                    let index = self.build(question, structure)?;
                    let counts = index.count(&fixed)?;
                    let stages = stages(&index, &counts.report);
                    Ok((counts, stages))
                })?;
                self.expected.check_counts(counts.as_slice())?;
                measured
            }
            Question::List => {
                let (list, measured) = repeat(effort, || {
                    let index = self.build(question, structure)?;
                    let list = index.list(&fixed)?;
                    let stages = stages(&index, &list.report);
                    Ok((list, stages))
                })?;
                self.expected.check_list(list.offsets(), list.indices())?;
                measured
            }
            Question::Nearest => {
                let (found, measured) = repeat(effort, || {
                    let index = self.build(question, structure)?;
                    let found = index.knn(&Knn::new(NEAREST))?;
                    let stages = stages(&index, &found.report);
                    Ok((found, stages))
                })?;
                check_nearest(&self.points, NEAREST, found.indices())?;
                measured
            }
        })
    }
}

fn line(row: &Row) -> String {
    let time = |(_, time): &(StructureChoice, std::result::Result<f64, String>)| match time {
        Ok(milliseconds) => format!("{milliseconds:.3}"),
        Err(note) => note.clone(),
    };
    let times: Vec<String> = row.times.iter().map(time).collect();
    let loss = match row.loss() {
        Some(loss) if loss > ALLOWED => format!("**{:.0} %**", 100.0 * loss),
        Some(loss) => format!("{:.0} %", 100.0 * loss),
        None => "not measured".to_owned(),
    };
    format!(
        "| {} | {:.1} | {} | {} | {} | {loss} | {} |",
        row.set,
        row.mean_neighbors,
        row.question.name(),
        times.join(" | "),
        row.picked,
        row.reason
    )
}

fn save(path: &std::path::Path, rows: &[Row], machine: &Machine) -> Result<()> {
    let mut writer =
        csv::Writer::from_path(path).map_err(|error| Error::from(format!("{}: {error}", path.display())))?;
    writer.write_record([
        "set",
        "mean_neighbors",
        "question",
        "structure",
        "milliseconds",
        "is_picked",
        "loss",
        "note",
        "reason",
        "device",
        "commit",
    ])?;
    for row in rows {
        for (structure, time) in &row.times {
            let is_picked = structure.name() == row.picked;
            let loss = row.loss().filter(|_| is_picked).map_or(String::new(), |loss| format!("{loss:.4}"));
            writer.write_record([
                row.set.to_string(),
                format!("{:.3}", row.mean_neighbors),
                row.question.name().to_owned(),
                structure.name().to_owned(),
                time.as_ref().map_or(String::new(), |milliseconds| format!("{milliseconds:.5}")),
                is_picked.to_string(),
                loss,
                time.as_ref().err().cloned().unwrap_or_default(),
                if is_picked { row.reason.clone() } else { String::new() },
                machine.name.clone(),
                COMMIT.to_owned(),
            ])?;
        }
    }
    Ok(writer.flush()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loss_is_that_of_the_pick_over_the_best() {
        let times = vec![
            (StructureChoice::BruteForce, Err("too slow".to_owned())),
            (StructureChoice::UniformGrid, Ok(3.0)),
            (StructureChoice::AabbTree, Ok(2.0)),
        ];
        let row = |picked: &str| Row {
            set: "uniform-1k".parse().expect("a set"),
            mean_neighbors: 40.0,
            question: Question::Count,
            times: times.clone(),
            picked: picked.to_owned(),
            reason: "a reason".to_owned(),
        };
        assert_eq!(row("uniform-grid").loss(), Some(0.5));
        assert!(line(&row("uniform-grid")).contains("**50 %**"), "a loss beyond what is asked stands out");
        assert_eq!(row("aabb-tree").loss(), Some(0.0));
        assert_eq!(row("brute-force").loss(), None);
        assert_eq!(row("linear-octree").loss(), None);
    }
}
