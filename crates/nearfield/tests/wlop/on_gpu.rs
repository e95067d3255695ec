//! The device against the CPU in f32: the same places up to rounding, the same flags and reports.

use std::ops::ControlFlow;

use libtest_mimic::Trial;
use nearfield::application::{
    Length, PointFlags, Progress, Watch, Wlop, WlopReport, WlopSamples, WlopSettings, WlopStart, WlopVariant,
};
use nearfield::gpu::Gpu;
use nearfield::{Error, GpuWlop, Vec3};

use crate::support::{gpu_trial, refuse_each, trial};
use crate::surfaces::torus;
use crate::{settings, tree};

const ITERATIONS: u32 = 6;

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = vec![
        trial("planted_differences_of_samples_are_seen", planted_differences_are_seen),
        gpu_trial("samples_that_rest_on_the_device_are_left_alone", samples_rest),
        gpu_trial("a_watch_can_end_it_on_the_device", a_watch_can_end_it),
        gpu_trial("points_that_are_no_surface_give_finite_samples_on_the_device", degenerate_points),
        gpu_trial("wrong_questions_are_errors_on_the_device", wrong_questions_are_errors),
        gpu_trial("device_memory_may_run_out_in_the_middle_of_resampling", memory_may_run_out),
    ];
    for variant in WlopVariant::ALL {
        for weigh_inputs in [false, true] {
            let name = format!("{variant}_{weigh_inputs}_on_the_device_is_that_of_the_cpu");
            trials.push(gpu_trial(name, move |gpu| device_is_cpu(gpu, variant, weigh_inputs)));
        }
    }
    trials
}

/// A noisy torus with two far points, samples on one of them, in nothing and at one place.
fn cloud() -> (Vec<[f32; 3]>, Vec<[f32; 3]>, f32) {
    let surface = torus(5000, 0.003);
    let mut points: Vec<[f32; 3]> = surface.points.iter().map(|p| p.map(|x| x as f32)).collect();
    points.extend([[3.0; 3], [-3.0; 3]]);
    let mut samples: Vec<[f32; 3]> = points.iter().step_by(9).copied().collect();
    samples.extend([[3.0; 3], [0.0, 0.0, 4.0], samples[5]]);
    (points, samples, surface.diagonal as f32)
}

fn vectors(points: &[[f32; 3]]) -> Vec<Vec3> {
    points.iter().map(|&p| Vec3::from_array(p)).collect()
}

/// How many samples differ in place by more than 1e-5 of the diagonal, and in flags.
fn differ(here: &WlopSamples<f32>, there: &WlopSamples<f32>, diagonal: f32) -> (usize, usize) {
    assert_eq!(here.positions.len(), there.positions.len());
    let far =
        |(a, b): &(&[f32; 3], &[f32; 3])| !(Vec3::from_array(**a).distance(Vec3::from_array(**b)) <= 1e-5 * diagonal);
    let places = here.positions.iter().zip(&there.positions).filter(far).count();
    (places, here.flags.iter().zip(&there.flags).filter(|(a, b)| a != b).count())
}

fn planted_differences_are_seen() {
    let positions = vec![[0.5, 1.0, 2.0]; 3];
    let here = WlopSamples { positions, flags: vec![PointFlags::default(); 3] };
    assert_eq!(differ(&here, &here, 1.0), (0, 0));
    let mut there = here.clone();
    there.positions[1][2] += 2e-5;
    there.flags[2] = PointFlags::NO_ATTRACTION;
    assert_eq!(differ(&here, &there, 1.0), (1, 1));
    there.positions[0][0] = f32::NAN;
    assert_eq!(differ(&here, &there, 1.0), (2, 1));
}

fn check_reports(here: &[WlopReport], there: &[WlopReport]) {
    let close = |a: f64, b: f64| (a - b).abs() <= 1e-3 * a.abs().max(1e-6);
    assert_eq!(here.len(), there.len());
    for (a, b) in here.iter().zip(there) {
        assert_eq!((a.iteration, a.unattracted), (b.iteration, b.unattracted));
        let pairs = [
            (a.mean_move, b.mean_move),
            (a.largest_move, b.largest_move),
            (a.mean_inputs, b.mean_inputs),
            (a.mean_samples, b.mean_samples),
        ];
        assert!(pairs.iter().all(|&(a, b)| close(a, b)), "{a:?}, {b:?}");
    }
}

fn device_is_cpu(gpu: &Gpu, variant: WlopVariant, weigh_inputs: bool) {
    let (points, samples, diagonal) = cloud();
    let settings = WlopSettings { weigh_inputs, ..settings(variant, 0.4).iterations(ITERATIONS) };
    let start = WlopStart::Positions(&samples);
    let tree = tree(&points);
    let mut here = Wlop::new(&tree, &start, &settings, &mut Watch::none()).unwrap();
    let reports = here.run(&mut Watch::none()).unwrap();
    let mut there = GpuWlop::new(gpu, &vectors(&points), &start, &settings, &mut Watch::none()).unwrap();
    assert_eq!(
        there.samples().unwrap(),
        WlopSamples { flags: vec![PointFlags::default(); samples.len()], positions: samples.clone() }
    );
    let run = there.run(&mut Watch::none()).unwrap();
    let found = there.samples().unwrap();
    let differences = differ(&here.samples(), &found, diagonal);
    println!("{variant}, {weigh_inputs}: places and flags that differ: {differences:?} of {}", samples.len());
    // Two variants end at the radius with weights of 0.02: a point there may be within on one side and beyond on the other.
    let most = if matches!(variant, WlopVariant::Authors | WlopVariant::Cgal) { 2 } else { 0 };
    assert!(differences.0 <= most && differences.1 == 0, "{variant}: {differences:?}");
    assert_eq!(found.unattracted(), 2);
    check_reports(&reports, &run);
    // One at a time is the same as some together.
    let mut single = GpuWlop::new(gpu, &vectors(&points), &start, &settings, &mut Watch::none()).unwrap();
    (0..ITERATIONS).for_each(|_| drop(single.iterate().unwrap()));
    assert!(single.is_done() && single.samples().unwrap() == found);
}

fn samples_rest(gpu: &Gpu) {
    let points: Vec<[f32; 3]> = torus(3000, 0.002).points.iter().map(|p| p.map(|x| x as f32)).collect();
    let start = WlopStart::Random { count: 600, seed: 2 };
    let settings = WlopSettings { tolerance: 0.05, ..settings(WlopVariant::Best, 0.5) };
    let tree = tree(&points);
    let mut here = Wlop::new(&tree, &start, &settings, &mut Watch::none()).unwrap();
    let reports = here.run(&mut Watch::none()).unwrap();
    let mut there = GpuWlop::new(gpu, &vectors(&points), &start, &settings, &mut Watch::none()).unwrap();
    let run = there.run(&mut Watch::none()).unwrap();
    assert!(there.is_done() && run.len() < 100);
    check_reports(&reports, &run);
    // What ran after the samples rested left them alone.
    let mut single = GpuWlop::new(gpu, &vectors(&points), &start, &settings, &mut Watch::none()).unwrap();
    (0..run.len()).for_each(|_| drop(single.iterate().unwrap()));
    assert!(single.is_done() && single.samples().unwrap() == there.samples().unwrap());
}

fn a_watch_can_end_it(gpu: &Gpu) {
    let (points, samples, _) = cloud();
    let start = WlopStart::Positions(&samples);
    let settings = settings(WlopVariant::Best, 0.4).iterations(30);
    let mut wlop = GpuWlop::new(gpu, &vectors(&points), &start, &settings, &mut Watch::none()).unwrap();
    let mut told = Vec::new();
    let mut tell = |progress: Progress| {
        told.push(progress.done);
        if progress.done == 0 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    };
    let ended = wlop.run(&mut Watch::new(&mut tell));
    assert!(matches!(ended, Err(Error::Interrupted { stage: "resampling", total: 30, .. })), "{ended:?}");
    assert_eq!(told, [0, 1]);
    assert!(!wlop.is_done() && wlop.samples().unwrap().positions != samples);
    let mut end = |_: Progress| ControlFlow::Break(());
    let made = GpuWlop::new(gpu, &vectors(&points), &start, &settings, &mut Watch::new(&mut end)).map(drop);
    assert!(matches!(made, Err(Error::Interrupted { stage: "weights of points", done: 0, .. })), "{made:?}");
}

fn degenerate_points(gpu: &Gpu) {
    let one = [Vec3::new(1.0, 2.0, 3.0)];
    let same = [one[0]; 40];
    for variant in WlopVariant::ALL {
        let settings = settings(variant, 0.5).iterations(3);
        let run = |points: &[Vec3], start: WlopStart<'_, f32>| {
            let mut wlop = GpuWlop::new(gpu, points, &start, &settings, &mut Watch::none()).unwrap();
            let reports = wlop.run(&mut Watch::none()).unwrap();
            (wlop.samples().unwrap(), reports)
        };
        let random = |count| WlopStart::Random { count, seed: 1 };
        let (samples, reports) = run(&one, random(1));
        assert!(samples.positions == [[1.0, 2.0, 3.0]] && reports[2].mean_move < 1e-6, "{variant}: {samples:?}");
        let (samples, _) = run(&same, random(5));
        assert!(samples.positions.iter().all(|p| Vec3::from_array(*p).distance(one[0]) < 1e-5), "{variant}");
        let (samples, reports) = run(&[], WlopStart::Positions(&[[1.0, 2.0, 3.0]]));
        assert_eq!((samples.positions[0], reports[0].unattracted), ([1.0, 2.0, 3.0], 1), "{variant}");
        let (samples, reports) = run(&same, random(0));
        assert!(samples.positions.is_empty() && reports.is_empty());
        let (samples, _) = run(&[], random(0));
        assert!(samples.positions.is_empty());
        let mut nobody = GpuWlop::new(gpu, &same, &random(0), &settings, &mut Watch::none()).unwrap();
        let numbers = [(); 2].map(|()| nobody.iterate().unwrap().iteration);
        assert_eq!(numbers, [1, 2], "{variant}");
    }
}

fn wrong_questions_are_errors(gpu: &Gpu) {
    let (points, ..) = cloud();
    let points = vectors(&points);
    let make = |start: WlopStart<'_, f32>, settings: WlopSettings| {
        GpuWlop::new(gpu, &points, &start, &settings, &mut Watch::none()).map(drop)
    };
    let random = WlopStart::Random { count: 30, seed: 1 };
    let beyond = WlopStart::Random { count: points.len() + 1, seed: 1 };
    for (start, settings) in [
        (beyond, WlopSettings::default()),
        (WlopStart::Indices(&[points.len() as u32]), WlopSettings::default()),
        (WlopStart::Indices(&[3, 3]), WlopSettings::default()),
        (random, settings(WlopVariant::Best, 0.0)),
        (random, settings(WlopVariant::Best, f64::NAN)),
        (random, settings(WlopVariant::Best, 1e30)),
        (random, WlopSettings { tolerance: -1.0, ..WlopSettings::default() }),
    ] {
        assert!(matches!(make(start, settings), Err(Error::InvalidSetting { .. })), "{start:?}, {settings:?}");
    }
    let nan = [Vec3::new(0.0, f32::NAN, 0.0)];
    let made = GpuWlop::new(
        gpu,
        &nan,
        &WlopStart::Positions(&[[0.0; 3]]),
        &settings(WlopVariant::Best, 1.0),
        &mut Watch::none(),
    );
    assert!(matches!(made.map(drop), Err(Error::NonFinite { .. })));
    // Radii in percent and of CGAL's spacing need a tree over the points on the host.
    for settings in [WlopSettings::new(WlopVariant::Cgal), WlopSettings::default().radius(Length::Percent(9.0))] {
        let made = GpuWlop::new(gpu, &points, &random, &settings, &mut Watch::none()).unwrap();
        let arrays: Vec<[f32; 3]> = points.iter().map(Vec3::to_array).collect();
        assert_eq!(made.radius(), Wlop::new(&tree(&arrays), &random, &settings, &mut Watch::none()).unwrap().radius());
    }
}

fn memory_may_run_out(gpu: &Gpu) {
    let gpu = crate::support::own_context(gpu);
    let points: Vec<Vec3> = torus(300, 0.002).points.iter().map(|p| Vec3::from_array(p.map(|x| x as f32))).collect();
    let start = WlopStart::Random { count: 40, seed: 2 };
    let settings = settings(WlopVariant::Best, 0.7).iterations(2);
    let work = || {
        let mut wlop = GpuWlop::new(&gpu, &points, &start, &settings, &mut Watch::none())?;
        wlop.run(&mut Watch::none())?;
        wlop.samples()
    };
    let expected = work().unwrap();
    refuse_each(&gpu, "resampling", work, |samples| *samples == expected);
}
