//! Devices that go away, and the index that goes on with the CPU only where it may.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use libtest_mimic::Trial;
use nearfield::gpu::{DeviceChoice, Gpu, wgpu};
use nearfield::query::Report;
use nearfield::{
    Error, FixedRadius, ForEachOnDevice, GpuBruteForce, GpuUniformGrid, GridSettings, Index, IndexSettings,
    NeighborSearch, Neighbors, Result, SearchOnDevice, StructureChoice, Visitor,
};

use crate::support::gpu_trial;
use crate::{RADIUS, lattice_points, own_context, rows_by_loop, wrong_row};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("every_call_on_a_lost_device_says_so", every_call_on_a_lost_device_says_so),
        gpu_trial("a_destroyed_device_is_reported_as_lost", a_destroyed_device_is_reported_as_lost),
        gpu_trial("a_callers_lost_handler_stays_in_place", a_callers_lost_handler_stays_in_place),
        gpu_trial("only_auto_goes_on_with_the_cpu_where_a_build_fails", only_auto_goes_on_where_a_build_fails),
        gpu_trial("only_auto_goes_on_with_the_cpu_where_a_question_fails", only_auto_goes_on_where_a_question_fails),
    ]
}

fn every_call_on_a_lost_device_says_so(gpu: &Gpu) {
    let own = own_context(gpu);
    let points = lattice_points(500);
    let brute_force = GpuBruteForce::build(&own, &points).unwrap();
    let grid = GpuUniformGrid::build(&own, &points, &GridSettings::for_radius(RADIUS)).unwrap();
    let (words, nothing) = (own.upload("words", &[1u32, 2]).unwrap(), own.upload::<u32>("nothing", &[]).unwrap());
    own.mark_lost("pulled out");
    own.mark_lost("a second reason does not count");
    let question = FixedRadius::new(RADIUS);
    let visitor = Visitor::new("", &[]);
    let calls: Vec<(&str, Result<()>)> = vec![
        ("upload", own.upload("more", &[1u32]).map(drop)),
        ("write", own.write(&words, 0, &[3])),
        ("read", own.read(&words).map(drop)),
        ("read nothing", own.read(&nothing).map(drop)),
        ("run", own.commands("nothing").run().map(drop)),
        ("submit", own.commands("nothing").submit()),
        ("build", GpuBruteForce::build(&own, &points).map(drop)),
        ("build a grid", GpuUniformGrid::build(&own, &points, &GridSettings::for_radius(RADIUS)).map(drop)),
        ("count", brute_force.count(&question).map(drop)),
        ("count", grid.count(&question).map(drop)),
        ("list", brute_force.list(&question).map(drop)),
        ("list", grid.list(&question).map(drop)),
        ("capped list", grid.list(&question.max_neighbors(3)).map(drop)),
        ("nearest", grid.nearest(&question).map(drop)),
        ("other queries", grid.count(&question.queries(&points[..9])).map(drop)),
        ("on the device", grid.list_on_device(&question).map(drop)),
        ("visitor", grid.for_each_on_device(&question, &visitor).map(drop)),
    ];
    for (call, result) in calls {
        match result {
            Err(Error::DeviceLost { device, reason }) => {
                assert_eq!((device.as_str(), reason.as_str()), (gpu.name(), "pulled out"), "{call}");
            }
            other => panic!("{call}: {other:?}"),
        }
    }
}

fn a_destroyed_device_is_reported_as_lost(gpu: &Gpu) {
    let own = own_context(gpu);
    let points = lattice_points(500);
    let grid = GpuUniformGrid::build(&own, &points, &GridSettings::for_radius(RADIUS)).unwrap();
    own.device().destroy();
    // The driver's callback comes with the next wait at the latest.
    match grid.count(&FixedRadius::new(RADIUS)) {
        Err(Error::DeviceLost { device, reason }) => {
            assert_eq!(device, gpu.name());
            assert!(reason.starts_with("Destroyed"), "{reason}");
        }
        other => panic!("{other:?}"),
    }
    assert!(matches!(GpuBruteForce::build(&own, &points), Err(Error::DeviceLost { .. })));
    // Another context on the same adapter is untouched.
    let expected = rows_by_loop(&points, &points, RADIUS);
    let list = GpuBruteForce::build(gpu, &points).unwrap().list(&FixedRadius::new(RADIUS)).unwrap();
    assert_eq!(wrong_row(&list, &expected), None);
}

fn a_callers_lost_handler_stays_in_place(gpu: &Gpu) {
    let opened = own_context(gpu);
    let (device, queue) = (opened.device().clone(), opened.queue().clone());
    let told = Arc::new(AtomicBool::new(false));
    let tell = Arc::clone(&told);
    device.set_device_lost_callback(move |_, _| tell.store(true, Ordering::Relaxed));
    let own = Gpu::from_device(device, queue);
    own.device().destroy();
    let _ = own.device().poll(wgpu::PollType::wait_indefinitely());
    assert!(told.load(Ordering::Relaxed), "the caller's handler was replaced");
    own.mark_lost("told by the caller");
    assert!(matches!(own.upload("words", &[1u32]), Err(Error::DeviceLost { .. })));
}

fn settings(structure: StructureChoice, device: DeviceChoice) -> IndexSettings {
    IndexSettings { structure, device, ..IndexSettings::default() }
}

fn is_cpu(device: &str) -> bool {
    device.starts_with("cpu")
}

fn says_that_the_cpu_took_over(notes: &[String]) -> bool {
    notes.iter().any(|note| note.contains("could not be used") && note.contains("the CPU did the work"))
}

fn only_auto_goes_on_where_a_build_fails(gpu: &Gpu) {
    let points = lattice_points(1500);
    let expected = rows_by_loop(&points, &points, RADIUS);
    let question = FixedRadius::new(RADIUS);
    let (short, lost) = (own_context(gpu), own_context(gpu));
    short.set_memory_limit(1000);
    lost.mark_lost("pulled out");
    for structure in StructureChoice::ALL {
        for (case, own) in [("short of memory", &short), ("lost", &lost)] {
            let index = Index::build_on(own, &points, &question, &settings(structure, DeviceChoice::Auto)).unwrap();
            assert!(is_cpu(&index.device()), "{case}: {}", index.device());
            assert!(says_that_the_cpu_took_over(index.notes()), "{case}: {:?}", index.notes());
            let list = index.list(&question).unwrap();
            assert_eq!(wrong_row(&list, &expected), None, "{case}");
            assert_eq!(list.report.structure, structure.name());
            assert!(is_cpu(&list.report.device) && says_that_the_cpu_took_over(&list.report.notes), "{case}");
            let refused = Index::build_on(own, &points, &question, &settings(structure, DeviceChoice::Gpu));
            let right = match refused.map(drop) {
                Err(Error::OutOfDeviceMemory { .. }) => case == "short of memory",
                Err(Error::DeviceLost { .. }) => case == "lost",
                _ => false,
            };
            assert!(right, "{case} with the GPU asked for");
        }
    }
}

fn only_auto_goes_on_where_a_question_fails(gpu: &Gpu) {
    let points = lattice_points(1500);
    let expected = rows_by_loop(&points, &points, RADIUS);
    let question = FixedRadius::new(RADIUS);
    for structure in StructureChoice::ALL {
        let own = own_context(gpu);
        let auto = Index::build_on(&own, &points, &question, &settings(structure, DeviceChoice::Auto)).unwrap();
        let asked = Index::build_on(&own, &points, &question, &settings(structure, DeviceChoice::Gpu)).unwrap();
        let check = |list: &Neighbors, report: &Report, on_cpu: bool| {
            assert_eq!(wrong_row(list, &expected), None);
            assert_eq!((is_cpu(&report.device), says_that_the_cpu_took_over(&report.notes)), (on_cpu, on_cpu));
        };
        let list = auto.list(&question).unwrap();
        check(&list, &list.report, false);

        own.set_memory_limit(own.memory_used());
        let list = auto.list(&question).unwrap();
        check(&list, &list.report, true);
        assert!(matches!(asked.list(&question), Err(Error::OutOfDeviceMemory { .. })));

        own.set_memory_limit(u64::MAX);
        let list = auto.list(&question).unwrap();
        check(&list, &list.report, false);

        own.mark_lost("pulled out");
        let list = auto.list(&question).unwrap();
        check(&list, &list.report, true);
        let counts = auto.count(&question).unwrap();
        assert!(counts.as_slice().iter().zip(&expected).all(|(&count, row)| count as usize == row.len()));
        assert!(says_that_the_cpu_took_over(&counts.report.notes));
        assert!(auto.nearest(&question).unwrap().dist2().iter().all(|&d2| d2 == 0.0));
        assert!(matches!(asked.count(&question), Err(Error::DeviceLost { .. })));
        // A wrong question is the caller's fault on any device.
        assert!(matches!(auto.count(&FixedRadius::new(-1.0)), Err(Error::InvalidRadius { .. })));
    }
}
