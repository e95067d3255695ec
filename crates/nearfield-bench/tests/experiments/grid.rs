//! The experiments on grids: methods, columns, reference values and claims, and answers that are planted wrong.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use libtest_mimic::Trial;
use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield_bench::check::Expected;
use nearfield_bench::grid::method::{Case, Method};
use nearfield_bench::grid::{self, memory};
use nearfield_bench::measure::Effort;
use nearfield_bench::provenance::COMMIT;
use nearfield_bench::sets::SEED;

use crate::folder::{Folder, choice, mean_neighbors, number};
use crate::support::{gpu_trial, trial};

const SCALE: f64 = 0.002;
const COLUMNS: &str = "device,commit,scale,particles,wanted_neighbors,radius,mean_neighbors,method,stage,clock,\
                       milliseconds,runs,points_bytes,structure_bytes";

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("grid experiments hold every method, column and reference value", experiments_are_complete),
        gpu_trial("a wrong answer stops every method", |gpu| wrong_answers_are_caught(Some(gpu), &Method::ALL)),
        trial("a wrong answer stops the methods of the CPU", || {
            wrong_answers_are_caught(None, &[Method::CpuBruteForce, Method::CpuGrid]);
        }),
        trial("a planted total is caught", planted_total_is_caught),
        trial("without a GPU its figures are not measured", experiments_on_the_cpu_alone),
    ]
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
