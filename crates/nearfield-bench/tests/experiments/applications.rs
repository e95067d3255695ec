//! The paper's applications to point sets, at a thousandth of their size.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use libtest_mimic::Trial;
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield_bench::applications;
use nearfield_bench::provenance::COMMIT;

use crate::folder::{Folder, choice, number};
use crate::paper::paper_rows;
use crate::support::{gpu_trial, trial};

pub(crate) fn trials() -> Vec<Trial> {
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
    let is_compared = |row: &&BTreeMap<String, String>| {
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
