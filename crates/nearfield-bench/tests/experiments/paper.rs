//! The experiments of Xing2017 on moving points, at a thousandth of their size.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use libtest_mimic::Trial;
use nearfield::Vec3;
use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield_bench::check::Expected;
use nearfield_bench::paper;
use nearfield_bench::paper::methods::{self, Positions, Start};
use nearfield_bench::provenance::COMMIT;
use nearfield_bench::sets::SEED;

use crate::folder::{Folder, choice, mean_neighbors, number};
use crate::support::{gpu_trial, trial};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("the paper's experiments have every method, and every answer is checked", paper_is_complete),
        trial("without a GPU the paper's experiments have the methods of the CPU", paper_on_the_cpu),
        trial("a spent budget leaves rows without values and no error", paper_without_budget),
        gpu_trial("lists of another radius are caught in every method of the paper", |gpu| {
            wrong_lists_are_caught(Some(gpu))
        }),
        trial("lists of another radius are caught in the paper's methods of the CPU", || wrong_lists_are_caught(None)),
        trial("the paper's experiments refuse a scale, a budget and nothing to do", paper_refuses),
    ]
}

const PAPER_COLUMNS: &str = "experiment,device,commit,scale,paper_points,points,dimension,setting,paper_r_over_l,radius,\
                             mean_neighbors,method,quantity,unit,value,device_milliseconds,paper_value,recall,runs,note";
const PAPER_FILES: [&str; 8] =
    ["table-1", "table-2", "figure-7", "figure-9", "figure-10", "figure-11", "figure-12", "claims"];

fn paper_arguments(device: DeviceChoice, folder: &Folder, budget: f64) -> paper::Arguments {
    paper::Arguments {
        all: Some("all".to_owned()),
        tables: Vec::new(),
        figures: Vec::new(),
        device,
        scale: 0.001,
        budget,
        output: folder.0.clone(),
    }
}

/// Rows of an experiment by column name; each has a value that was checked, or says why it has none.
pub(crate) fn paper_rows(folder: &Folder, experiment: &str) -> Vec<BTreeMap<String, String>> {
    let mut reader = csv::Reader::from_path(folder.0.join(format!("{experiment}.csv"))).expect(experiment);
    let header: Vec<String> = reader.headers().expect(experiment).iter().map(str::to_owned).collect();
    assert_eq!(header.join(","), PAPER_COLUMNS, "{experiment}");
    let rows: Vec<BTreeMap<String, String>> = reader
        .records()
        .map(|record| header.iter().cloned().zip(record.expect(experiment).iter().map(str::to_owned)).collect())
        .collect();
    assert!(!rows.is_empty(), "{experiment}");
    for row in &rows {
        assert_eq!((&*row["experiment"], &*row["commit"]), (experiment, COMMIT), "{row:?}");
        assert!(!row["method"].is_empty() && !row["quantity"].is_empty() && !row["device"].is_empty(), "{row:?}");
        if row["value"].is_empty() {
            assert!(row["note"].starts_with("missing: "), "{row:?}");
            continue;
        }
        assert!(number(&row["value"]).is_finite() && number(&row["mean_neighbors"]) >= 1.0, "{row:?}");
        assert!(number(&row["runs"]) >= 1.0 && !row["note"].is_empty(), "{row:?}");
        if !row["recall"].is_empty() {
            assert!((0.0..=1.0).contains(&number(&row["recall"])), "{row:?}");
        }
    }
    rows
}

fn paper_is_complete(gpu: &Gpu) {
    let folder = Folder::new("paper-gpu");
    paper::run(&paper_arguments(choice(gpu), &folder, 8.0)).expect("the experiments run");
    let summary = fs::read_to_string(folder.0.join("summary.md")).expect("summary.md");
    for experiment in PAPER_FILES {
        let rows = paper_rows(&folder, experiment);
        assert!(rows.iter().any(|row| !row["value"].is_empty()), "{experiment} measured something");
        assert!(summary.contains(&format!("## {experiment}")), "{experiment} is in the summary");
    }
    let rows = paper_rows(&folder, "table-1");
    // A slow device may not come to the last within the budget, and says so.
    for plug in methods::ALL {
        assert!(rows.iter().any(|row| row["method"] == plug.name), "{} is in table 1", plug.name);
    }
    // The paper's own values stand in the rows of its own search.
    let papers: Vec<f64> = rows
        .iter()
        .filter(|row| row["paper_r_over_l"] == "0.005" && row["method"] == "tree coherent, GPU")
        .map(|row| number(&row["paper_value"]))
        .collect();
    assert_eq!(papers, [101.0, 18.33, 91.0, 17.13]);
    let row = rows.iter().find(|row| row["paper_r_over_l"] == "0.005").expect("a row");
    let n = number(&row["points"]) as usize;
    let points: Vec<Vec3> = cloud(CloudKind::Uniform, n, SEED).points.iter().map(|p| *p * 2.0 - 1.0).collect();
    let expected = mean_neighbors(&points, number(&row["radius"]));
    assert!((number(&row["mean_neighbors"]) - expected).abs() < 0.01, "{expected} neighbours: {row:?}");
    for figure in ["table-1", "table-2", "figure-7", "figure-9", "figure-10-1", "figure-11", "figure-12", "figure-13"] {
        let svg = fs::read_to_string(folder.0.join(format!("{figure}.svg"))).expect(figure);
        assert!(svg.contains(COMMIT) && svg.contains(gpu.name()), "{figure} names commit and device");
        assert!(summary.contains(&format!("({figure}.svg)")), "{figure} is in the summary");
    }
}

fn paper_on_the_cpu() {
    let folder = Folder::new("paper-cpu");
    let mut arguments = paper_arguments(DeviceChoice::Cpu, &folder, 6.0);
    (arguments.all, arguments.tables, arguments.figures) = (None, vec![2], vec![7, 11, 13]);
    paper::run(&arguments).expect("the experiments run");
    let methods: BTreeSet<String> =
        paper_rows(&folder, "table-2").into_iter().map(|row| row["method"].clone()).collect();
    let expected = methods::ALL.iter().filter(|plug| !plug.on_gpu).map(|plug| plug.name.to_owned()).collect();
    assert_eq!(methods, expected);
    assert!(paper_rows(&folder, "figure-7").iter().all(|row| row["note"].contains("no GPU")));
    let dimensions: BTreeSet<String> =
        paper_rows(&folder, "figure-11").into_iter().map(|row| row["dimension"].clone()).collect();
    assert_eq!(dimensions.len(), 10, "3 to 12 dimensions");
    let lanes = paper_rows(&folder, "figure-12");
    assert!(lanes.iter().filter(|r| !r["value"].is_empty()).all(|r| number(&r["value"]) <= 100.0));
    assert!(!folder.0.join("table-1.csv").exists(), "only what was named is measured");
}

fn paper_without_budget() {
    let folder = Folder::new("paper-budget");
    paper::run(&paper_arguments(DeviceChoice::Cpu, &folder, 0.0)).expect("a spent budget is no error");
    for experiment in PAPER_FILES {
        let rows = paper_rows(&folder, experiment);
        assert!(rows.iter().all(|row| row["value"].is_empty()), "{experiment}");
        let named = |row: &BTreeMap<String, String>| row["note"].contains("budget") || row["note"].contains("GPU");
        assert!(rows.iter().all(named), "{experiment}");
    }
    let summary = fs::read_to_string(folder.0.join("summary.md")).expect("summary.md");
    assert!(
        summary.contains("the budget of the experiment was spent: ") && summary.contains("kd-tree, CPU ("),
        "{summary}"
    );
}

fn paper_refuses() {
    let folder = Folder::new("paper-refused");
    let right = paper_arguments(DeviceChoice::Cpu, &folder, 0.0);
    for (wrong, said) in [
        (paper::Arguments { scale: 0.0, ..right.clone() }, "--scale 0"),
        (paper::Arguments { scale: f64::NAN, ..right.clone() }, "--scale NaN"),
        (paper::Arguments { budget: -1.0, ..right.clone() }, "--budget -1"),
        (paper::Arguments { all: None, ..right.clone() }, "all, or some of"),
        (paper::Arguments { tables: vec![1], ..right.clone() }, "all, or some of"),
    ] {
        let error = paper::run(&wrong).expect_err(said).to_string();
        assert!(error.contains(said), "{error}");
    }
}

fn wrong_lists_are_caught(gpu: Option<&Gpu>) {
    let points: Vec<Vec3> = cloud(CloudKind::Uniform, 1500, SEED).points.iter().map(|p| *p * 2.0 - 1.0).collect();
    let radius = 0.25;
    let (right, wrong) = (Expected::of(&points, radius).expect("a reference"), Expected::of(&points, 0.5 * radius));
    let wrong = wrong.expect("a reference");
    let at = Positions::new(gpu, points).expect("positions");
    for plug in methods::ALL.iter().filter(|plug| gpu.is_some() || !plug.on_gpu) {
        let start = Start { gpu, at: &at, radius, mean_neighbors: right.mean() };
        let mut method = (plug.make)(&start).expect(plug.name);
        let found = method.list(radius).expect(plug.name);
        let judged = found.check(gpu, &right).expect(plug.name);
        // Five shifts and eight tables miss few.
        assert!(judged.recall.is_none_or(|recall| recall > 0.5), "{}: recall {:?}", plug.name, judged.recall);
        let error = found.check(gpu, &wrong).err().unwrap_or_else(|| panic!("{} passed", plug.name));
        assert!(error.to_string().contains("wrong answer"), "{}: {error}", plug.name);
    }
}
