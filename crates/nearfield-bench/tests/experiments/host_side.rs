//! What the host waits for: transfers, small work and first calls check their own answers and print a row for everything.

use libtest_mimic::Trial;
use nearfield::gpu::DeviceChoice;
use nearfield_bench::{first_call, small, transfers};

use crate::folder::choice;
use crate::support::{gpu_trial, trial};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("transfers come back unchanged", |gpu| {
            transfers::run(&transfers::Arguments { device: choice(gpu), largest: 4 }).expect("a table");
        }),
        gpu_trial("small lists are right by plan and by grid", |gpu| {
            small::run(&small::Arguments { device: choice(gpu), points: vec![100, 700], calls: 2 }).expect("a table");
        }),
        gpu_trial("first calls of every structure are right", |gpu| {
            for structure in first_call::Structure::ALL {
                let alone = Some(structure);
                let (device, set) = (choice(gpu), "uniform-500".parse().expect("a set"));
                let arguments = first_call::Arguments { device, set, repeat: 1, structures: vec![structure], alone };
                first_call::run(&arguments).expect("three numbers");
            }
        }),
        trial("what the host waits for needs a device that it waits for", || {
            let device = DeviceChoice::Cpu;
            assert!(transfers::run(&transfers::Arguments { device: device.clone(), largest: 1 }).is_err());
            assert!(small::run(&small::Arguments { device, points: vec![10], calls: 1 }).is_err());
        }),
    ]
}
