//! The table of a device: every operation of every set, printed and as CSV.

use std::fs;

use libtest_mimic::Trial;
use nearfield::gpu::DeviceChoice;
use nearfield_bench::device;
use nearfield_bench::provenance::COMMIT;

use crate::folder::{Folder, choice, number};
use crate::support::{gpu_trial, trial};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("the device table of a GPU has every operation", |gpu| {
            table_is_complete(&choice(gpu), GPU_OPERATIONS)
        }),
        trial("the device table of the CPU has every operation", || {
            table_is_complete(&DeviceChoice::Cpu, CPU_OPERATIONS);
        }),
    ]
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
