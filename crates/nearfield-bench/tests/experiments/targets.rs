//! The table of targets at a small scale: every row has a figure or says why not, rows can be asked for alone, and a spent budget
//! leaves them out.

use std::collections::BTreeSet;
use std::fs;

use libtest_mimic::Trial;
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield_bench::provenance::COMMIT;
use nearfield_bench::targets::{self, Arguments};

use crate::folder::{Folder, choice, number};
use crate::support::{gpu_trial, trial};

const SCALE: f64 = 0.002;
/// Rows that llvmpipe may not be able to answer.
const MAY_BE_MISSING: [&str; 1] = ["16 nearest, build included"];

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("every row of the targets has a figure", every_row_has_a_figure),
        gpu_trial("rows of the targets are measured alone, and say what they are compared with", rows_alone),
        gpu_trial("a spent budget leaves the rows of the targets out", spent_budget),
        trial("targets that cannot be measured are refused", refusals),
    ]
}

fn arguments(device: DeviceChoice, folder: &Folder) -> Arguments {
    Arguments {
        rows: Vec::new(),
        device,
        budget: 3600.0,
        scale: SCALE,
        data: None,
        csv: Some(folder.0.join("targets.csv")),
        markdown: Some(folder.0.join("targets.md")),
    }
}

/// The records of the file by column name.
struct Records {
    header: Vec<String>,
    records: Vec<csv::StringRecord>,
}

impl Records {
    fn read(folder: &Folder) -> Self {
        let mut reader = csv::Reader::from_path(folder.0.join("targets.csv")).expect("targets.csv");
        let header = reader.headers().expect("a header").iter().map(str::to_owned).collect();
        Self { header, records: reader.records().map(|record| record.expect("a record")).collect() }
    }

    fn get<'a>(&self, record: &'a csv::StringRecord, column: &str) -> &'a str {
        &record[self.header.iter().position(|name| name == column).expect(column)]
    }

    /// Figures, without stages.
    fn totals(&self) -> impl Iterator<Item = &csv::StringRecord> {
        self.records.iter().filter(|record| self.get(record, "stage") == "total")
    }
}

fn every_row_has_a_figure(gpu: &Gpu) {
    let folder = Folder::new("targets-all");
    targets::run(&arguments(choice(gpu), &folder)).expect("every row is measured");
    let records = Records::read(&folder);
    let mut seen = BTreeSet::new();
    for record in records.totals() {
        let get = |column| records.get(record, column);
        assert_eq!(get("commit"), COMMIT);
        seen.insert(get("row").to_owned());
        if get("median").is_empty() {
            assert!(MAY_BE_MISSING.contains(&get("work")) && !get("note").is_empty(), "{record:?}");
            continue;
        }
        let (median, fastest) = (number(get("median")), number(get("fastest")));
        assert!(median > 0.0 && fastest > 0.0, "{record:?}");
        assert!(if get("unit").ends_with("/s") { fastest >= median } else { fastest <= median }, "{record:?}");
        assert_eq!(get("clock").is_empty(), ["bytes a point", "times"].contains(&get("unit")), "{record:?}");
        // Nothing is said about targets of another size.
        assert!(get("target").is_empty() && get("peer").is_empty() && get("missed_by").is_empty(), "{record:?}");
        if get("row").ends_with("-list") || get("row").ends_with("-count") {
            assert!(number(get("mean_neighbors")) > 5.0, "{record:?}");
        }
    }
    assert_eq!(seen, targets::names().iter().map(|name| (*name).to_owned()).collect());
    let stages = records.records.iter().filter(|record| records.get(record, "stage") != "total");
    assert!(stages.count() > 20, "stages stand in the file");
    let text = fs::read_to_string(folder.0.join("targets.md")).expect("targets.md");
    assert!(text.contains(COMMIT) && text.contains("nothing is said about targets"), "{text}");
    for name in targets::names() {
        assert!(text.contains(&format!("\n| {name} |")), "{name} is not printed: {text}");
    }
}

fn rows_alone(gpu: &Gpu) {
    let folder = Folder::new("targets-alone");
    // At full scale, where the targets hold.
    let arguments = Arguments { rows: vec!["small-8k-list".to_owned()], scale: 1.0, ..arguments(choice(gpu), &folder) };
    targets::run(&arguments).expect("the row is measured");
    let records = Records::read(&folder);
    let (mut judged, mut beside) = (0, 0);
    for record in records.totals() {
        let get = |column| records.get(record, column);
        assert_eq!((get("row"), get("clock")), ("small-8k-list", "wall"));
        assert!((25.0..49.0).contains(&number(get("mean_neighbors"))), "{record:?}");
        assert_eq!((number(get("peer")), number(get("floor"))), (0.28, 0.08));
        if get("target").is_empty() {
            beside += 1;
        } else {
            judged += 1;
            let missed_by = number(get("median")) / number(get("target"));
            assert!((number(get("missed_by")) / missed_by - 1.0).abs() < 1e-3, "{record:?}");
        }
    }
    assert_eq!((judged, beside), (1, 2), "the grid, brute force and the plan, of which the fastest is judged");
    let text = fs::read_to_string(folder.0.join("targets.md")).expect("targets.md");
    assert!(text.contains("(beside)") && (text.contains("| met") || text.contains("**missed**")), "{text}");
}

fn spent_budget(gpu: &Gpu) {
    let folder = Folder::new("targets-spent");
    targets::run(&Arguments { budget: 0.0, ..arguments(choice(gpu), &folder) }).expect("rows are left out");
    let records = Records::read(&folder);
    assert_eq!(records.totals().count(), targets::names().len());
    for record in records.totals() {
        let get = |column| records.get(record, column);
        assert!(get("median").is_empty() && get("note").contains("budget"), "{record:?}");
    }
}

fn refusals() {
    let folder = Folder::new("targets-refused");
    let on_cpu = arguments(DeviceChoice::Cpu, &folder);
    assert!(targets::run(&on_cpu).unwrap_err().to_string().contains("GPU"));
    for scale in [0.0, -1.0, f64::NAN, 2.0] {
        let error = targets::run(&Arguments { scale, ..on_cpu.clone() }).unwrap_err().to_string();
        assert!(error.contains("--scale"), "{error}");
    }
    for budget in [-1.0, f64::NAN] {
        let error = targets::run(&Arguments { budget, ..on_cpu.clone() }).unwrap_err().to_string();
        assert!(error.contains("--budget"), "{error}");
    }
}
