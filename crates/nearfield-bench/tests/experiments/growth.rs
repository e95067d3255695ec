//! The growth of times at small numbers of points: every structure on every set, files, and what is left out.

use std::fs;

use libtest_mimic::Trial;
use nearfield::gpu::DeviceChoice;
use nearfield_bench::growth::{self, Arguments};

use crate::folder::{Folder, choice, number};
use crate::support::{gpu_trial, trial};

const ON_GPU: [&str; 5] = ["uniform-grid", "multi-level-grid", "aabb-tree", "linear-octree", "brute-force"];
const ON_CPU: [&str; 4] = ["uniform-grid", "aabb-tree", "linear-octree", "brute-force"];

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("growth on a GPU has every structure, set and number", |gpu| {
            growth_is_complete(choice(gpu), &ON_GPU);
        }),
        trial("growth on the CPU has every structure, set and number", || {
            growth_is_complete(DeviceChoice::Cpu, &ON_CPU);
        }),
        trial("growth without time or numbers says so", spent_budget),
    ]
}

fn arguments(device: DeviceChoice, folder: &Folder) -> Arguments {
    Arguments { device, least: 1000, most: Some(3000), budget: 3600.0, output: folder.0.clone() }
}

fn growth_is_complete(device: DeviceChoice, structures: &[&str]) {
    let folder = Folder::new(&format!("growth-{}", structures.len()));
    growth::run(&arguments(device, &folder)).expect("growth is measured");
    let mut reader = csv::Reader::from_path(folder.0.join("growth.csv")).expect("growth.csv");
    let header: Vec<String> = reader.headers().expect("a header").iter().map(str::to_owned).collect();
    let column = |name: &str| header.iter().position(|h| h == name).expect(name);
    let rows: Vec<csv::StringRecord> = reader.records().map(|r| r.expect("a record")).collect();
    assert_eq!(rows.len(), 3 * 2 * structures.len());
    for set in ["uniform", "shell", "clustered"] {
        for points in ["1000", "3000"] {
            for structure in structures {
                let is_it = |r: &&csv::StringRecord| {
                    (&r[column("set")], &r[column("points")], &r[column("structure")]) == (set, points, structure)
                };
                let row = rows.iter().find(is_it).unwrap_or_else(|| panic!("{set} {points} {structure}"));
                let count = number(&row[column("count_ms")]);
                let a_point = number(&row[column("count_ns_a_point")]);
                assert!(count > 0.0 && (a_point / (count * 1e6 / number(points)) - 1.0).abs() < 0.01, "{row:?}");
                assert!((30.0..52.0).contains(&number(&row[column("mean_neighbors")])), "{row:?}");
                assert!(number(&row[column("structure_bytes_a_point")]) >= 12.0, "{row:?}");
            }
        }
    }
    let svg = fs::read_to_string(folder.0.join("growth.svg")).expect("growth.svg");
    for set in ["uniform: build", "shell: count", "clustered: count"] {
        assert!(svg.contains(set), "{set} is drawn");
    }
    let text = fs::read_to_string(folder.0.join("growth.md")).expect("growth.md");
    assert_eq!(text.lines().filter(|line| line.contains("| 3000 |")).count(), 3 * structures.len());
}

fn spent_budget() {
    let folder = Folder::new("growth-spent");
    let usual = arguments(DeviceChoice::Cpu, &folder);
    growth::run(&Arguments { budget: 0.0, ..usual.clone() }).expect("rows are left out");
    let text = fs::read_to_string(folder.0.join("growth.csv")).expect("growth.csv");
    assert_eq!(text.matches("the budget is spent").count(), 6, "{text}");
    let none = growth::run(&Arguments { least: 4000, most: Some(9000), ..usual.clone() }).unwrap_err();
    assert!(none.to_string().contains("4000"), "{none}");
    assert!(growth::run(&Arguments { budget: f64::NAN, ..usual }).is_err());
}
