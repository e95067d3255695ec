//! The charts of the poster.

use std::collections::BTreeSet;
use std::fs;

use libtest_mimic::Trial;
use nearfield::geometry::generate::CloudKind;
use nearfield::gpu::DeviceChoice;
use nearfield_bench::octree;
use nearfield_bench::provenance::COMMIT;

use crate::folder::{Folder, choice, number};
use crate::support::{gpu_trial, trial};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("the charts of the poster have every method", |gpu| charts_are_complete(choice(gpu), &CHART_METHODS)),
        trial("without a GPU the charts of the poster have the methods of the CPU", || {
            charts_are_complete(DeviceChoice::Cpu, &CHART_METHODS[..2]);
        }),
    ]
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
