//! Clouds whose squared distances are exact in f32 and f64: coordinates are multiples of 1/64, so that points stand at exactly the
//! radius, and every precision and device must agree.

use std::ops::ControlFlow;

use nearfield::application::{Progress, Watch};
use nearfield::{Error, Result, Scalar};

use crate::support::Random;

/// A step of the lattice.
pub(crate) const STEP: f64 = 1.0 / 64.0;

pub(crate) type Points = Vec<[f64; 3]>;

fn on_lattice(point: [f64; 3]) -> [f64; 3] {
    point.map(|x| (x / STEP).round() * STEP)
}

/// Points spread evenly over a box.
pub(crate) fn even(n: usize, size: f64, seed: u64) -> Points {
    let mut random = Random(seed);
    (0..n).map(|_| on_lattice([(); 3].map(|()| f64::from(random.unit()) * size))).collect()
}

/// Dense balls, with noise between them.
pub(crate) fn balls(n: usize, seed: u64) -> Points {
    let mut random = Random(seed);
    let mut unit = move || f64::from(random.unit());
    let centers: Points = (0..7).map(|_| [unit() * 6.0, unit() * 6.0, unit() * 6.0]).collect();
    let point = |i: usize| {
        let center = centers[i % centers.len()];
        if i % 10 == 9 {
            return on_lattice([unit() * 6.0, unit() * 6.0, unit() * 6.0]);
        }
        let around = |x: f64, spread: f64| x + (spread - 0.5) + 0.2 * (spread * 9.0).sin();
        on_lattice([around(center[0], unit()), around(center[1], unit()), around(center[2], unit())])
    };
    (0..n).map(point).collect()
}

/// A row whose indices fall along it: every point is joined to one with a larger index before it.
pub(crate) fn falling_row(n: usize) -> Points {
    (0..n).map(|i| [(n - i) as f64 * STEP, 0.0, 0.0]).collect()
}

/// A row in no order at all.
pub(crate) fn shuffled_row(n: usize, seed: u64) -> Points {
    let mut row = falling_row(n);
    let mut random = Random(seed);
    (1..n).for_each(|i| row.swap(i, random.below(i as u32 + 1) as usize));
    row
}

/// The clouds of most tests, by name.
pub(crate) fn clouds() -> Vec<(&'static str, Points)> {
    let mut twice = balls(400, 3);
    twice.extend_from_within(..);
    vec![
        ("nothing", vec![]),
        ("one point", vec![[1.0, 2.0, 3.0]]),
        ("one place", vec![[1.0, -2.0, 0.5]; 60]),
        ("even", even(900, 3.0, 1)),
        ("balls", balls(1200, 2)),
        ("twice", twice),
        ("falling row", falling_row(700)),
        ("shuffled row", shuffled_row(700, 4)),
        ("plane", even(900, 2.5, 5).into_iter().map(|[x, y, _]| [x, y, -1.0]).collect()),
    ]
}

/// The cloud with points that are no places among the others, and who is one.
pub(crate) fn with_invalid(points: &Points) -> (Points, Vec<usize>) {
    let (mut all, mut valid) = (Points::new(), Vec::new());
    for (i, &point) in points.iter().enumerate() {
        if i % 7 == 0 {
            all.push([[f64::NAN, 1.0, 1.0], [1.0, f64::INFINITY, 0.0], [0.0, 0.0, f64::NEG_INFINITY]][i / 7 % 3]);
        }
        valid.push(all.len());
        all.push(point);
    }
    (all, valid)
}

pub(crate) fn of<T: Scalar>(points: &Points) -> Vec<[T; 3]> {
    points.iter().map(|point| point.map(T::of)).collect()
}

pub(crate) fn dist2(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum()
}

/// Runs the work with one thread and with four: the answers must be equal.
pub(crate) fn same_for_any_threads<R: PartialEq + Send>(case: &str, work: impl Fn() -> R + Sync) {
    let run = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(&work);
    let alone = run(1);
    (0..3).for_each(|_| assert!(run(4) == alone, "{case} depends on the number of threads"));
}

/// More than the points between two reports of any of the tasks.
pub(crate) const ABOVE_BLOCK: usize = 1 << 13;

/// Work that is told to end at its first report, or at its second before all is done, must end there with `Interrupted`. Work on
/// [`ABOVE_BLOCK`] points or more must have a second one.
pub(crate) fn can_be_interrupted<R>(case: &str, work: impl Fn(&mut Watch<'_>) -> Result<R>) {
    for last in [1, 2] {
        let (mut unfinished, mut total, mut broken, mut told_after) = (0, 0, false, 0);
        let mut tell = |progress: Progress| {
            told_after += u32::from(broken);
            unfinished += u32::from(progress.done < progress.total);
            total = progress.total.max(total);
            if unfinished < last {
                return ControlFlow::Continue(());
            }
            broken = true;
            ControlFlow::Break(())
        };
        let ended = work(&mut Watch::new(&mut tell));
        let is_interrupted = matches!(ended, Err(Error::Interrupted { done, total, .. }) if done < total);
        assert!(is_interrupted == broken && told_after == 0, "{case} goes on after report {last}");
        assert!(broken || (last == 2 && total < ABOVE_BLOCK as u64), "{case}: {total} in one, without a report {last}");
    }
}

/// That the work is refused for this setting.
pub(crate) fn is_refused<R>(setting: &str, done: Result<R>) {
    match done {
        Err(Error::InvalidSetting { setting: found, .. }) => assert_eq!(found, setting),
        Err(other) => panic!("{setting}: {other}"),
        Ok(_) => panic!("{setting} should be refused"),
    }
}
