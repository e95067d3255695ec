//! The table of the baselines: every method answers both questions.

use libtest_mimic::Trial;
use nearfield::gpu::DeviceChoice;
use nearfield_bench::baselines::{self, Row};
use nearfield_bench::provenance::Machine;

use crate::folder::choice;
use crate::support::{gpu_trial, trial};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("the baselines of a GPU have every method", |gpu| {
            baselines_are_complete(&choice(gpu), &["shifted sort", "hashing (LSH)"]);
        }),
        trial("the baselines of the CPU have every method", || {
            let references = ["shifted sort, plain reference", "hashing (LSH), plain reference"];
            baselines_are_complete(&DeviceChoice::Cpu, &references);
        }),
    ]
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
