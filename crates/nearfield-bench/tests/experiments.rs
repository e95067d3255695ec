//! The experiments at a small scale: every method, column and reference value is there, plots and claims are made,
//! a second run resumes, and a wrong answer stops a measurement. The charts of the poster have every method too.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use libtest_mimic::Arguments;
use nearfield::Vec3;
use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield_bench::applications;
use nearfield_bench::baselines::{self, Row};
use nearfield_bench::check::Expected;
use nearfield_bench::device;
use nearfield_bench::grid::method::{Case, Method};
use nearfield_bench::grid::{self, memory};
use nearfield_bench::measure::Effort;
use nearfield_bench::octree;
use nearfield_bench::paper;
use nearfield_bench::paper::methods::{self, Positions, Start};
use nearfield_bench::provenance::{COMMIT, Machine};
use nearfield_bench::sets::SEED;

#[path = "../../nearfield/tests/support/mod.rs"]
mod support;
use support::{gpu_trial, trial};

const SCALE: f64 = 0.002;
const COLUMNS: &str = "device,commit,scale,particles,wanted_neighbors,radius,mean_neighbors,method,stage,clock,\
                       milliseconds,runs,points_bytes,structure_bytes";

fn main() {
    let tests = vec![
        gpu_trial("grid experiments hold every method, column and reference value", experiments_are_complete),
        gpu_trial("the device table of a GPU has every operation", |gpu| {
            table_is_complete(&choice(gpu), GPU_OPERATIONS)
        }),
        gpu_trial("a wrong answer stops every method", |gpu| wrong_answers_are_caught(Some(gpu), &Method::ALL)),
        trial("the device table of the CPU has every operation", || {
            table_is_complete(&DeviceChoice::Cpu, CPU_OPERATIONS);
        }),
        trial("a wrong answer stops the methods of the CPU", || {
            wrong_answers_are_caught(None, &[Method::CpuBruteForce, Method::CpuGrid]);
        }),
        trial("a planted total is caught", planted_total_is_caught),
        gpu_trial("the charts of the poster have every method", |gpu| charts_are_complete(choice(gpu), &CHART_METHODS)),
        trial("without a GPU the charts of the poster have the methods of the CPU", || {
            charts_are_complete(DeviceChoice::Cpu, &CHART_METHODS[..2]);
        }),
        trial("without a GPU its figures are not measured", experiments_on_the_cpu_alone),
        gpu_trial("the baselines of a GPU have every method", |gpu| {
            baselines_are_complete(&choice(gpu), &["shifted sort", "hashing (LSH)"]);
        }),
        trial("the baselines of the CPU have every method", || {
            let references = ["shifted sort, plain reference", "hashing (LSH), plain reference"];
            baselines_are_complete(&DeviceChoice::Cpu, &references);
        }),
    ];
    let tests = [tests, paper_tests(), application_tests()].into_iter().flatten().collect();
    libtest_mimic::run(&Arguments::from_args(), tests).exit();
}

/// A folder of this process that is removed in the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("nearfield-bench-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).expect("a temporary folder");
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn choice(gpu: &Gpu) -> DeviceChoice {
    DeviceChoice::Name(gpu.name().to_owned())
}

fn arguments(device: DeviceChoice, folder: &Folder) -> grid::Arguments {
    // A budget that leaves nothing out.
    grid::Arguments { device, scale: SCALE, budget: 1e6, output: folder.0.clone(), claims: false }
}

type Records = Vec<Vec<String>>;

/// Records of a CSV file by column number; fails where the columns are others.
fn records(folder: &Path, name: &str) -> Records {
    let mut reader = csv::Reader::from_path(folder.join(name)).expect(name);
    assert_eq!(reader.headers().expect(name).iter().collect::<Vec<_>>().join(","), COLUMNS, "{name}");
    let record = |r: Result<csv::StringRecord, csv::Error>| r.expect(name).iter().map(str::to_owned).collect();
    let records: Records = reader.records().map(record).collect();
    for record in &records {
        assert!(record.iter().all(|value| !value.is_empty()), "{name}: {record:?}");
        assert_eq!(record[1], COMMIT, "{name}");
    }
    records
}

fn number(text: &str) -> f64 {
    text.parse().expect("a number")
}

/// Mean neighbours by a plain loop.
fn mean_neighbors(points: &[Vec3], radius: f64) -> f64 {
    let inside = |p: &Vec3, q: &Vec3| p.as_dvec3().distance_squared(q.as_dvec3()) <= radius * radius;
    let total: usize = points.iter().map(|p| points.iter().filter(|q| inside(p, q)).count()).sum();
    total as f64 / points.len() as f64
}

/// Fails unless each case (particles and radius) has a total of each of the methods; returns the cases.
fn assert_methods(name: &str, records: &Records, methods: &[&str]) -> BTreeSet<(String, String)> {
    let cases: BTreeSet<(String, String)> = records.iter().map(|r| (r[3].clone(), r[5].clone())).collect();
    for (particles, radius) in &cases {
        for method in methods {
            let totals = records
                .iter()
                .filter(|r| (&r[3], &r[5], r[7].as_str(), r[8].as_str()) == (particles, radius, *method, "total"));
            assert_eq!(totals.count(), 1, "{name}: {method} of {particles} particles, radius {radius}");
        }
    }
    assert!(records.iter().all(|r| methods.contains(&r[7].as_str())), "{name}: another method");
    cases
}

const GPU_METHODS: [&str; 2] = ["gpu brute force", "gpu grid"];

fn experiments_are_complete(gpu: &Gpu) {
    let folder = Folder::new("grid");
    let arguments = arguments(choice(gpu), &folder);
    grid::run(&arguments).expect("the experiments run");

    let variants = records(&folder.0, "variants.csv");
    let all: Vec<&str> = Method::ALL.iter().map(|m| m.name()).collect();
    let cases = assert_methods("variants.csv", &variants, &all);
    // 1,000 to 1,000,000 particles at this scale; 64 is the least.
    let sizes: BTreeSet<usize> = cases.iter().map(|c| number(&c.0) as usize).collect();
    assert_eq!(sizes.into_iter().collect::<Vec<_>>(), [64, 100, 200, 400, 1000, 2000]);
    assert_eq!(cases.len(), 6 * 4, "four numbers of neighbours");
    for (particles, radius) in &cases {
        let points = cloud(CloudKind::Uniform, number(particles) as usize, SEED).points;
        let expected = mean_neighbors(&points, f64::from(radius.parse::<f32>().expect("a radius")));
        for record in variants.iter().filter(|r| (&r[3], &r[5]) == (particles, radius)) {
            assert!((number(&record[6]) - expected).abs() < 0.01, "{expected} neighbours: {record:?}");
        }
    }

    let methods = records(&folder.0, "gpu-methods.csv");
    assert_methods("gpu-methods.csv", &methods, &GPU_METHODS);
    let most = methods.iter().map(|r| number(&r[4]) / number(&r[3])).fold(0.0, f64::max);
    assert_eq!(most, 1.0, "as many neighbours as particles are asked for");

    let stages = records(&folder.0, "stages.csv");
    assert_eq!(assert_methods("stages.csv", &stages, &GPU_METHODS).len(), 2);
    let has_clock = gpu.limits().timestamp_period.is_some();
    for (method, wanted) in [
        ("gpu brute force", &["count", "scan", "fill", "other"][..]),
        ("gpu grid", &["entries", "sort", "gather", "table", "count", "scan", "fill", "other"][..]),
    ] {
        let found: BTreeSet<&str> = stages.iter().filter(|r| r[7] == method).map(|r| r[8].as_str()).collect();
        assert!(!has_clock || wanted.iter().all(|stage| found.contains(stage)), "{method} has the stages {found:?}");
    }

    let bytes = records(&folder.0, "memory.csv");
    let cases = assert_methods("memory.csv", &bytes, &["cpu grid", "gpu grid", "dense table (computed)"]);
    assert_eq!(cases.len(), 2 * memory::RADII.len());
    for record in &bytes {
        let (n, radius) = (number(&record[3]), number(&record[5]));
        assert!(number(&record[13]) >= number(&record[12]), "a structure holds its points: {record:?}");
        if record[7].starts_with("dense") {
            let cells = (1.0 / radius).ceil().powi(3);
            assert_eq!(number(&record[13]), 12.0 * n + 4.0 * n + 4.0 * cells, "{record:?}");
        }
    }

    let claims = fs::read_to_string(folder.0.join("claims.md")).expect("claims.md");
    assert_eq!(claims.matches("Accel: ").count(), 9, "{claims}");
    assert!(!claims.contains("Not measured") && !claims.contains("NaN") && !claims.contains("inf "), "{claims}");
    for figure in
        ["variants", "variants-zoom", "gpu-particles", "gpu-neighbors", "stages", "memory-small", "memory-large"]
    {
        let svg = fs::read_to_string(folder.0.join(format!("{figure}.svg"))).expect(figure);
        assert!(svg.contains(COMMIT) && svg.contains(gpu.name()), "{figure} names commit and device");
        assert!(claims.contains(&format!("{figure}.svg")), "{figure} has a sentence");
    }

    let before = fs::read(folder.0.join("variants.csv")).expect("variants.csv");
    grid::run(&arguments).expect("the experiments run again");
    assert!(before == fs::read(folder.0.join("variants.csv")).expect("variants.csv"), "complete rows are kept");
}

fn experiments_on_the_cpu_alone() {
    let folder = Folder::new("cpu");
    let mut arguments = arguments(DeviceChoice::Cpu, &folder);
    arguments.budget = 0.0;
    grid::run(&arguments).expect("a spent budget is no error");
    assert!(!folder.0.join("variants.csv").exists(), "nothing is measured after the budget");
    arguments.budget = 1e6;
    grid::run(&arguments).expect("the experiments run");
    assert_methods("variants.csv", &records(&folder.0, "variants.csv"), &["cpu brute force", "cpu grid"]);
    assert_methods("memory.csv", &records(&folder.0, "memory.csv"), &["cpu grid", "dense table (computed)"]);
    let claims = fs::read_to_string(folder.0.join("claims.md")).expect("claims.md");
    assert!(claims.contains("**Not measured**") && claims.contains("GPU: none"), "{claims}");
}

const CPU_OPERATIONS: &[&str] = &["build", "count", "list", "build + list"];
const GPU_OPERATIONS: &[&str] = &["bounds", "build", "count", "list", "build + list", "points in, list out"];

fn table_is_complete(choice: &DeviceChoice, operations: &[&str]) {
    let folder = Folder::new(&format!("device-{}", operations.len()));
    let (csv, markdown) = (folder.0.join("table.csv"), folder.0.join("table.md"));
    let arguments = device::Arguments {
        structures: vec![device::Structure::UniformGrid, device::Structure::AabbTree],
        bucket: 20,
        device: choice.clone(),
        sets: ["uniform-2k", "shell-1k", "clustered-1k"].map(|set| set.parse().expect("a set")).to_vec(),
        repeat: Some(2),
        csv: Some(csv.clone()),
        markdown: Some(markdown.clone()),
    };
    device::run(&arguments).expect("the table is made");
    let text = fs::read_to_string(&markdown).expect("table.md");
    assert!(text.contains(COMMIT), "{text}");
    let mut reader = csv::Reader::from_path(&csv).expect("table.csv");
    let header: Vec<String> = reader.headers().expect("a header").iter().map(str::to_owned).collect();
    let column = |name: &str| header.iter().position(|h| h == name).expect(name);
    let (set, operation, stage, structure) = (column("set"), column("operation"), column("stage"), column("structure"));
    let (milliseconds, commit) = (column("milliseconds"), column("commit"));
    let rows: Vec<csv::StringRecord> = reader.records().map(|r| r.expect("a record")).collect();
    for name in ["uniform-2k", "shell-1k", "clustered-1k"] {
        for &wanted in operations {
            let total = rows.iter().find(|r| (&r[set], &r[operation], &r[stage]) == (name, wanted, "total"));
            let total = total.unwrap_or_else(|| panic!("{name} lacks {wanted}"));
            assert!(number(&total[milliseconds]) > 0.0 && &total[commit] == COMMIT, "{total:?}");
            assert!(text.contains(&format!("| {name} | uniform-grid | {wanted} |")), "{name} {wanted} is printed");
        }
        let of_tree = rows.iter().filter(|r| &r[set] == name && &r[structure] == "aabb-tree" && &r[stage] == "total");
        let of_tree: Vec<&str> = of_tree.map(|r| &r[operation]).collect();
        for wanted in ["build", "refit", "count", "build + list", "kNN 16"] {
            assert!(of_tree.contains(&wanted), "{name} lacks {wanted} of the tree");
        }
    }
}

const CHARTS: [&str; 5] = [
    "curve construction",
    "octree construction",
    "post-order traversal",
    "near neighbours of n points",
    "locations of n points",
];
const CHART_METHODS: [&str; 4] = ["one core", "all cores", "GPU", "GPU with transfers"];

fn charts_are_complete(device: DeviceChoice, methods: &[&str]) {
    let folder = Folder::new(&format!("octree-{}", methods.len()));
    let arguments = octree::Arguments {
        device,
        scale: 1.0,
        numbers: vec![1000, 2500],
        repeat: Some(2),
        kind: CloudKind::Uniform,
        large: false,
        output: Some(folder.0.clone()),
    };
    octree::run(&arguments).expect("the charts are made");
    let mut reader = csv::Reader::from_path(folder.0.join("octree.csv")).expect("octree.csv");
    let header: Vec<String> = reader.headers().expect("a header").iter().map(str::to_owned).collect();
    let column = |name: &str| header.iter().position(|h| h == name).expect(name);
    let key = ["points", "chart", "method"].map(column);
    let (times, commit) = (["milliseconds", "wall_milliseconds", "runs"].map(column), column("commit"));
    let mut found = BTreeSet::new();
    for record in reader.records().map(|r| r.expect("a record")) {
        let positive = |&at: &usize| number(&record[at]).is_finite() && number(&record[at]) > 0.0;
        assert!(times.iter().all(positive) && &record[commit] == COMMIT, "{record:?}");
        assert!(found.insert(key.map(|at| record[at].to_owned())), "twice: {record:?}");
    }
    let mut expected = BTreeSet::new();
    for n in ["1000", "2500"] {
        for chart in CHARTS {
            expected.extend(methods.iter().map(|&method| [n, chart, method].map(str::to_owned)));
        }
    }
    assert_eq!(found, expected);
    let svg = fs::read_to_string(folder.0.join("octree.svg")).expect("octree.svg");
    assert!(svg.contains(COMMIT) && CHARTS.iter().all(|chart| svg.contains(chart)), "{svg}");
    assert!(methods.iter().all(|method| svg.contains(method)), "{svg}");
}

fn planted_total_is_caught() {
    let points = cloud(CloudKind::Uniform, 500, SEED).points;
    let radius = 0.125;
    let right = (mean_neighbors(&points, radius) * points.len() as f64).round() as u64;
    let expected = Expected::of(&points, radius as f32).expect("a reference");
    expected.check_total(right).expect("the plain loop's total is right");
    for wrong in [right - 1, right + 1, 0, 2 * right] {
        assert!(expected.check_total(wrong).is_err(), "{wrong} instead of {right}");
    }
}

fn wrong_answers_are_caught(gpu: Option<&Gpu>, methods: &[Method]) {
    let points = cloud(CloudKind::Uniform, 500, SEED).points;
    let effort = Effort { warm_up: 0.0, runs: 1, seconds: 0.0 };
    let right = Case::new(&points, 0.125).expect("a reference");
    // The reference is that of another radius: every answer is wrong.
    let expected = Expected::of(&points, 0.13).expect("a reference");
    let wrong = Case { points: &points, radius: 0.125, expected };
    for method in methods {
        let measured = method.measure(gpu, &right, effort).expect("the right answer passes");
        assert!(measured.is_some(), "{}", method.name());
        let error = method.measure(gpu, &wrong, effort).expect_err(method.name());
        assert!(error.to_string().contains("wrong answer"), "{}: {error}", method.name());
    }
}

/// Every method answers both questions, exact ones wholly; `approximate` are those that may miss some.
fn baselines_are_complete(device: &DeviceChoice, approximate: &[&str; 2]) {
    for dimension in [3, 5, 20] {
        let (points, k, shifts, tables, projections) = (2000, 10, 5, 8, 8);
        let (device, sample, repeat, ann) = (device.clone(), 200, 1, None);
        let arguments =
            baselines::Arguments { device, points, k, dimension, shifts, tables, projections, sample, repeat, ann };
        let machine = Machine::open(&arguments.device).expect("a device");
        let (rows, radius) = baselines::measure(&arguments, &machine).expect("the baselines run");
        assert!(radius > 0.0);
        let find = |method: &str, question: &str| -> Vec<&Row> {
            rows.iter().filter(|r| (r.method, r.question) == (method, question)).collect()
        };
        let mut expected = vec![(approximate[1], "k nearest"), (approximate[1], "within r")];
        if dimension <= 16 {
            expected.extend([("kiddo, all cores", "k nearest"), ("kiddo, all cores", "within r")]);
        }
        if dimension == 3 {
            expected.extend([(approximate[0], "k nearest"), (approximate[0], "within r")]);
            expected.extend([("linear octree", "k nearest"), ("uniform grid", "within r")]);
        }
        assert_eq!(rows.len(), expected.len(), "{rows:?}");
        for (method, question) in expected {
            let found = find(method, question);
            assert_eq!(found.len(), 1, "{method}, {question}");
            let row = found[0];
            assert!(row.query_ms > 0.0 && row.build_ms >= 0.0, "{row:?}");
            assert_eq!(row.is_exact, !approximate.contains(&method), "{row:?}");
            let least = if row.is_exact { 1.0 } else { 0.3 };
            assert!((least..=1.0).contains(&row.recall) && row.mean_found > 1.0, "{row:?}");
            assert_eq!(row.distance_ratio.is_some(), question == "k nearest", "{row:?}");
        }
        baselines::run(&arguments).expect("the table is printed");
    }
}

fn paper_tests() -> Vec<libtest_mimic::Trial> {
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
fn paper_rows(folder: &Folder, experiment: &str) -> Vec<std::collections::BTreeMap<String, String>> {
    let mut reader = csv::Reader::from_path(folder.0.join(format!("{experiment}.csv"))).expect(experiment);
    let header: Vec<String> = reader.headers().expect(experiment).iter().map(str::to_owned).collect();
    assert_eq!(header.join(","), PAPER_COLUMNS, "{experiment}");
    let rows: Vec<std::collections::BTreeMap<String, String>> = reader
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
        let named = |row: &std::collections::BTreeMap<String, String>| {
            row["note"].contains("budget") || row["note"].contains("GPU")
        };
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

fn application_tests() -> Vec<libtest_mimic::Trial> {
    vec![
        gpu_trial("the applications have every search, and every answer is checked", applications_are_complete),
        trial("without a GPU the applications have the searches of the CPU", applications_on_the_cpu),
        trial("a spent budget leaves applications without values and no error", applications_without_budget),
    ]
}

const APPLICATIONS: [&str; 5] = ["figure-14", "figure-15", "table-3", "figure-17", "quality"];

/// No folder of meshes: balls take their place.
fn application_arguments(device: DeviceChoice, folder: &Folder, budget: f64, only: &[&str]) -> applications::Arguments {
    applications::Arguments {
        device,
        scale: 0.001,
        only: only.iter().map(|name| (*name).to_owned()).collect(),
        budget,
        data: Some(folder.0.join("no meshes")),
        output: folder.0.clone(),
    }
}

fn applications_are_complete(gpu: &Gpu) {
    let folder = Folder::new("applications-gpu");
    applications::run(&application_arguments(choice(gpu), &folder, 2.5, &[])).expect("the experiments run");
    let summary = fs::read_to_string(folder.0.join("summary.md")).expect("summary.md");
    for experiment in APPLICATIONS {
        let rows = paper_rows(&folder, experiment);
        assert!(rows.iter().any(|row| !row["value"].is_empty()), "{experiment} measured something");
        assert!(summary.contains(&format!("## {experiment}")), "{experiment} is in the summary");
    }
    for experiment in ["figure-14", "figure-15"] {
        let rows = paper_rows(&folder, experiment);
        for plug in applications::SEARCHES {
            assert!(rows.iter().any(|row| row["method"] == plug.name), "{experiment}: {}", plug.name);
        }
    }
    // The paper's own values stand in the rows of its own search.
    let rows = paper_rows(&folder, "figure-14");
    let papers: Vec<f64> = rows
        .iter()
        .filter(|row| row["method"] == "tree coherent, GPU" && row["quantity"].starts_with("a search"))
        .filter(|row| !row["value"].is_empty())
        .map(|row| number(&row["paper_value"]))
        .collect();
    assert_eq!(papers.first(), Some(&162.0));
    let is_compared = |row: &&std::collections::BTreeMap<String, String>| {
        row["quantity"].starts_with("a search") && row["note"].contains("compared with")
    };
    assert!(rows.iter().filter(is_compared).count() > 0, "kernels over lists are compared with the CPU");
    // Values of planes are nearer to the truth than those of samples. On the CPU, which comes to the end of them.
    let to_the_end = Folder::new("applications-table-3");
    let only = application_arguments(DeviceChoice::Cpu, &to_the_end, 600.0, &["table-3"]);
    applications::run(&only).expect("the experiment runs");
    let rows = paper_rows(&to_the_end, "table-3");
    let crossings = |mode: &str| -> Vec<f64> {
        let its =
            rows.iter().filter(|row| row["setting"].ends_with(mode) && row["quantity"] == "crossings of edges, RMS");
        its.filter(|row| !row["value"].is_empty()).map(|row| number(&row["value"])).collect()
    };
    let (nearest, plane) = (crossings("nearest"), crossings("plane"));
    assert!(!plane.is_empty() && nearest.len() == plane.len(), "{nearest:?} {plane:?}");
    assert!(nearest.iter().zip(&plane).all(|(samples, planes)| planes < samples), "{nearest:?} {plane:?}");
    for figure in ["figure-14", "figure-15", "table-3", "figure-17"] {
        let svg = fs::read_to_string(folder.0.join(format!("{figure}.svg"))).expect(figure);
        assert!(svg.contains(COMMIT) && svg.contains(gpu.name()), "{figure} names commit and device");
        assert!(summary.contains(&format!("({figure}.svg)")), "{figure} is in the summary");
    }
}

fn applications_on_the_cpu() {
    let folder = Folder::new("applications-cpu");
    let only = ["figure-14", "figure-17"];
    applications::run(&application_arguments(DeviceChoice::Cpu, &folder, 4.0, &only)).expect("the experiments run");
    let rows = paper_rows(&folder, "figure-14");
    let methods: BTreeSet<&str> = rows.iter().map(|row| &*row["method"]).collect();
    assert!(methods.contains("kd-tree, CPU") && methods.contains("fused: tree, CPU, degree 2"), "{methods:?}");
    assert!(methods.iter().all(|method| !method.contains("GPU")), "{methods:?}");
    // The surface of a ball and its offsets are balls.
    let rows = paper_rows(&folder, "figure-17");
    let euler: Vec<f64> =
        rows.iter().filter(|row| row["quantity"] == "Euler number").map(|row| number(&row["value"])).collect();
    assert_eq!(euler, [2.0; 3]);
    let png = fs::read(folder.0.join("figure-17.png")).expect("a picture");
    assert!(png.starts_with(b"\x89PNG\r\n\x1a\n") && png.ends_with(b"IEND\xaeB`\x82"));
    assert!(!folder.0.join("table-3.csv").exists(), "only what was named is measured");
}

fn applications_without_budget() {
    let folder = Folder::new("applications-budget");
    let arguments = application_arguments(DeviceChoice::Cpu, &folder, 0.0, &["quality", "table-3"]);
    applications::run(&arguments).expect("a spent budget is no error");
    for experiment in ["quality", "table-3"] {
        let rows = paper_rows(&folder, experiment);
        assert!(rows.iter().all(|row| row["value"].is_empty() && row["note"].contains("budget")), "{experiment}");
    }
}
