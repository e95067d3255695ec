//! Claims about single answers that the tables of cases and questions do not reach: errors with their numbers, totals
//! beyond 32 bits, the same bytes from run to run, and the faults of Accel.

use libtest_mimic::Trial;
use nearfield::query::Neighbors;
use nearfield::{Aabb, Boxes, Error, FixedRadius, Knn, RowOrder, Vec3};

use crate::compare::Verdict;
use crate::random::Random;
use crate::subjects::{Device, Plan, SUBJECTS, Subject};

/// A claim about every subject, and the check of it.
type Claim = (&'static str, fn(&Subject) -> Verdict);

const CLAIMS: &[Claim] = &[
    ("invalid-points-are-counted-and-placed", invalid_points),
    ("points-beyond-1e18-are-refused-with-axis-and-value", far_points),
    ("invalid-queries-are-counted-and-placed", invalid_queries),
    ("radii-outside-the-domain-are-refused", bad_radii),
    ("the-wrong-number-of-radii-is-refused", wrong_radii),
    ("self-cannot-be-left-out-of-other-queries", exclude_self_of_others),
    ("46341-equal-points-are-counted", |subject| equal_points(subject, 46_341, 2_147_488_281)),
    ("65537-equal-points-are-counted-and-their-list-refused", |subject| equal_points(subject, 65_537, 4_295_098_369)),
    ("three-runs-give-the-same-bytes", same_bytes),
    ("rows-of-6000-are-sorted", long_rows_sorted),
    ("accel/negative-coordinates-give-the-lists-of-positive-ones", negative_like_positive),
    ("accel/the-first-particle-is-met-once", first_particle_once),
    ("accel/a-row-of-all-4096-is-not-cut", long_rows_whole),
];

/// Claims that take a software device long and say little more than others there: for hardware, or `NEARFIELD_LONG=1`.
const FOR_HARDWARE: &[&str] = &["46341-equal-points-are-counted"];

/// Claims about the questions that not every structure answers.
const CLAIMS_WITHOUT_RADIUS: &[Claim] =
    &[("the-nearest-are-refused-with-numbers", refused_nearest), ("boxes-are-refused-with-numbers", refused_boxes)];

/// Every claim on one build of every structure on every device, and those on the machine.
pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = vec![];
    for subject in SUBJECTS.iter().filter(|s| ["plain", "cells-like-the-radius"].contains(&s.variant)) {
        for (name, check) in CLAIMS {
            let is_left_out = FOR_HARDWARE.contains(name) && !subject.asks_everything();
            let trial = crate::trial_on(subject, format!("{}/{name}", subject.name()), move || check(subject));
            trials.push(if is_left_out { trial.with_ignored_flag(true) } else { trial });
        }
    }
    for subject in SUBJECTS.iter().filter(|s| ["plain", "leaves-of-32"].contains(&s.variant)) {
        for (name, check) in CLAIMS_WITHOUT_RADIUS {
            trials.push(crate::trial_on(subject, format!("{}/{name}", subject.name()), move || check(subject)));
        }
    }
    trials.push(crate::trial("cpu/sorted-lists-have-the-same-bytes-from-every-build".into(), same_bytes_from_all));
    for subject in SUBJECTS.iter().filter(|s| s.device == Device::Cpu) {
        let name = format!("{}/one-two-and-four-threads-give-the-same-bytes", subject.name());
        trials.push(crate::trial(name, move || same_bytes_on_any_threads(subject)));
    }
    trials
}

fn plan(points: &[Vec3], radius: f32) -> Plan<'_> {
    Plan { points, radius, period: Default::default() }
}

fn expect(holds: bool, otherwise: impl FnOnce() -> String) -> Verdict {
    if holds { Ok(()) } else { Err(otherwise()) }
}

fn refused_nearest(subject: &Subject) -> Verdict {
    let points = cloud(100);
    let built = subject.build(&plan(&points, 0.5)).map_err(in_words)?;
    let bad = [Vec3::ZERO, Vec3::new(0.0, f32::NAN, 0.0)];
    let far = [Vec3::ZERO, Vec3::ZERO, Vec3::splat(2e18)];
    let mut radii = [0.5; 100];
    radii[7] = -1.0;
    let refused: [(Knn<'_>, fn(&Error) -> bool); 8] = [
        (Knn::new(3).queries(&bad), |e| matches!(e, Error::NonFinite { what: "queries", count: 1, first: 1 })),
        (Knn::new(3).queries(&far), |e| matches!(e, Error::CoordinateTooLarge { index: 2, axis: 'x', .. })),
        (Knn::new(3).queries(&points).exclude_self(), |e| matches!(e, Error::InvalidSetting { .. })),
        (Knn::new(3).within(f32::NAN), |e| matches!(e, Error::InvalidRadius { index: None, .. })),
        (Knn::new(3).within_each(&radii), |e| matches!(e, Error::InvalidRadius { index: Some(7), .. })),
        (Knn::new(3).within_each(&radii[..3]), |e| matches!(e, Error::LengthMismatch { found: 3, expected: 100, .. })),
        (Knn::new(3).max_bytes(2399), |e| matches!(e, Error::OutOfMemory { needed: 2400, available: 2399, .. })),
        (Knn::new(u32::MAX).max_bytes(1 << 30), |e| matches!(e, Error::OutOfMemory { needed: 3_435_973_836_000, .. })),
    ];
    for (number, (question, is_right)) in refused.into_iter().enumerate() {
        match built.knn(&question) {
            Some(Err(error)) => expect(is_right(&error), || format!("question {number}: {error}"))?,
            Some(Ok(_)) => return Err(format!("question {number} was answered")),
            None => {}
        }
    }
    let fits = built.knn(&Knn::new(3).max_bytes(2400)).is_none_or(|answer| answer.is_ok());
    expect(fits, || "2400 bytes are enough for 100 rows of 3".into())
}

fn refused_boxes(subject: &Subject) -> Verdict {
    let points = cloud(100);
    let built = subject.build(&plan(&points, 0.5)).map_err(in_words)?;
    let nan = Aabb::new(Vec3::ZERO, Vec3::new(1.0, f32::NAN, 1.0));
    let all = Aabb::new(Vec3::NEG_INFINITY, Vec3::INFINITY);
    let with_nan = [all, nan];
    match built.in_boxes(&Boxes::new(&with_nan)) {
        None => return Ok(()),
        Some(Ok(_)) => return Err("a box with NaN was answered".into()),
        Some(Err(error)) => {
            let placed = matches!(&error, Error::InvalidSetting { found, .. } if found.contains("box 1"));
            expect(placed, || error.to_string())?;
        }
    }
    let everything = [all; 3];
    let needed = 4 * 300 + 8 * 4;
    match built.in_boxes(&Boxes::new(&everything).max_bytes(needed - 1)) {
        Some(Err(Error::OutOfMemory { needed: 1232, available: 1231, .. })) => {}
        other => return Err(format!("a list of {needed} bytes: {:?}", other.map(|answer| answer.is_ok()))),
    }
    let fits = built.in_boxes(&Boxes::new(&everything).max_bytes(needed)).is_some_and(|answer| answer.is_ok());
    expect(fits, || format!("{needed} bytes are enough"))
}

fn in_words(error: Error) -> String {
    error.to_string()
}

fn cloud(n: usize) -> Vec<Vec3> {
    let mut random = Random::new(0xc1a1);
    (0..n).map(|_| random.point()).collect()
}

fn invalid_points(subject: &Subject) -> Verdict {
    for (bad, axis) in [(f32::NAN, 0), (f32::INFINITY, 1), (f32::NEG_INFINITY, 2)] {
        let mut points = cloud(500);
        for i in [77, 123, 499] {
            points[i][axis] = bad;
        }
        let outcome = subject.build(&plan(&points, 0.1)).map(|_| ());
        let right = matches!(outcome, Err(Error::NonFinite { what: "points", count: 3, first: 77 }));
        expect(right, || format!("{bad} on axis {axis}: {outcome:?}"))?;
    }
    Ok(())
}

fn far_points(subject: &Subject) -> Verdict {
    let mut points = cloud(100);
    points[42].y = -1.5e18;
    let outcome = subject.build(&plan(&points, 0.1)).map(|_| ());
    let right =
        matches!(outcome, Err(Error::CoordinateTooLarge { index: 42, axis: 'y', value, .. }) if value < -1.4e18);
    expect(right, || format!("{outcome:?}"))
}

fn invalid_queries(subject: &Subject) -> Verdict {
    let points = cloud(100);
    let built = subject.build(&plan(&points, 0.1)).map_err(in_words)?;
    let mut queries = cloud(20);
    queries[5].z = f32::NAN;
    queries[19].x = f32::INFINITY;
    let question = FixedRadius::new(0.1).queries(&queries);
    let right = |error: Option<&Error>| matches!(error, Some(Error::NonFinite { what: "queries", count: 2, first: 5 }));
    expect(right(built.count(&question).err().as_ref()), || "count takes them".into())?;
    expect(right(built.list(&question).err().as_ref()), || "list takes them".into())?;
    expect(right(built.nearest(&question).err().as_ref()), || "nearest takes them".into())
}

fn bad_radii(subject: &Subject) -> Verdict {
    let points = cloud(4);
    let built = subject.build(&plan(&points, 0.1)).map_err(in_words)?;
    for bad in [-1.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-20, 1e-45, 2e19] {
        let outcome = built.list(&FixedRadius::new(bad)).map(|_| ());
        let right = matches!(outcome, Err(Error::InvalidRadius { index: None, .. }));
        expect(right, || format!("radius {bad:e}: {outcome:?}"))?;
        let outcome = built.count(&FixedRadius::each(&[0.1, 0.0, bad, bad])).map(|_| ());
        let right = matches!(outcome, Err(Error::InvalidRadius { index: Some(2), .. }));
        expect(right, || format!("radius {bad:e} of query 2: {outcome:?}"))?;
    }
    Ok(())
}

fn wrong_radii(subject: &Subject) -> Verdict {
    let points = cloud(10);
    let built = subject.build(&plan(&points, 0.1)).map_err(in_words)?;
    let outcome = built.list(&FixedRadius::each(&[0.1; 9])).map(|_| ());
    expect(matches!(outcome, Err(Error::LengthMismatch { found: 9, expected: 10, .. })), || format!("{outcome:?}"))
}

fn exclude_self_of_others(subject: &Subject) -> Verdict {
    let points = cloud(10);
    let built = subject.build(&plan(&points, 0.1)).map_err(in_words)?;
    let outcome = built.count(&FixedRadius::new(0.1).queries(&points).exclude_self()).map(|_| ());
    expect(matches!(outcome, Err(Error::InvalidSetting { .. })), || format!("{outcome:?}"))
}

/// `n` equal points have n² pairs: more than 2³¹ or 2³², counted exactly and not listed where memory is limited.
fn equal_points(subject: &Subject, n: usize, pairs: u64) -> Verdict {
    let points = vec![Vec3::new(0.5, -3.0, 8.0); n];
    let built = subject.build(&plan(&points, 0.25)).map_err(in_words)?;
    let counts = built.count(&FixedRadius::new(0.25)).map_err(in_words)?;
    let wrong = counts.as_slice().iter().find(|&&c| c as usize != n);
    expect(wrong.is_none(), || format!("a row of {n} is counted as {wrong:?}"))?;
    expect(counts.summary().total == pairs, || format!("{} pairs, expected {pairs}", counts.summary().total))?;
    let limit = 32 << 20;
    let outcome = built.list(&FixedRadius::new(0.25).max_bytes(limit)).map(|_| ());
    // 4 bytes an index, 8 an offset.
    let expected = 4 * pairs + 8 * (n as u64 + 1);
    match outcome {
        Err(Error::OutOfMemory { needed, available, .. }) => expect(needed == expected && available <= limit, || {
            format!("{needed} of {available} bytes, not {expected}")
        }),
        other => Err(format!("the list is not refused: {other:?}")),
    }
}

/// An answer in bytes: offsets, indices and distances.
fn bytes(list: &Neighbors) -> Vec<u8> {
    let mut bytes = bytemuck::cast_slice::<u64, u8>(list.offsets()).to_vec();
    bytes.extend_from_slice(bytemuck::cast_slice(list.indices()));
    bytes.extend_from_slice(bytemuck::cast_slice(list.distances().unwrap_or_default()));
    bytes
}

fn build_and_list(subject: &Subject, points: &[Vec3], order: RowOrder) -> Result<Vec<u8>, String> {
    let built = subject.build(&plan(points, 0.1)).map_err(in_words)?;
    let question = FixedRadius::new(0.1).order(order).distances();
    Ok(bytes(&built.list(&question).map_err(in_words)?))
}

const ORDERS: [RowOrder; 3] = [RowOrder::Unspecified, RowOrder::Index, RowOrder::Distance];

fn same_bytes(subject: &Subject) -> Verdict {
    let points = cloud(5000);
    for order in ORDERS {
        let first = build_and_list(subject, &points, order)?;
        for run in 2..=3 {
            let again = build_and_list(subject, &points, order)?;
            expect(again == first, || format!("{order:?}: run {run} differs from run 1"))?;
        }
    }
    Ok(())
}

fn same_bytes_from_all() -> Verdict {
    let points = cloud(5000);
    let mut cpu = SUBJECTS.iter().filter(|s| s.device == Device::Cpu);
    let first = cpu.next().ok_or("there should be a structure on the CPU")?;
    for order in [RowOrder::Index, RowOrder::Distance] {
        let expected = build_and_list(first, &points, order)?;
        for subject in cpu.clone() {
            let made = build_and_list(subject, &points, order)?;
            expect(made == expected, || format!("{order:?}: {} differs from {}", subject.name(), first.name()))?;
        }
    }
    Ok(())
}

fn same_bytes_on_any_threads(subject: &Subject) -> Verdict {
    let points = cloud(10_000);
    for order in ORDERS {
        let mut first: Option<Vec<u8>> = None;
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(|e| e.to_string())?;
            let made = pool.install(|| build_and_list(subject, &points, order))?;
            match &first {
                Some(first) => expect(made == *first, || format!("{order:?}: {threads} threads differ from 1"))?,
                None => first = Some(made),
            }
        }
    }
    Ok(())
}

/// Accel's hash grid lost particles with negative coordinates: a cloud moved by whole numbers keeps its lists.
fn negative_like_positive(subject: &Subject) -> Verdict {
    // Multiples of 1/1024 below 8: every sum and difference is exact.
    let whole = |p: Vec3| (p * 8192.0).floor() / 1024.0;
    let positive: Vec<Vec3> = cloud(1500).into_iter().map(whole).collect();
    let question = FixedRadius::new(0.75).order(RowOrder::Index);
    let lists = |shift: Vec3| -> Result<Neighbors, String> {
        let points: Vec<Vec3> = positive.iter().map(|&p| p + shift).collect();
        subject.build(&plan(&points, 0.75)).and_then(|built| built.list(&question)).map_err(in_words)
    };
    let expected = lists(Vec3::ZERO)?;
    expect(expected.summary().mean > 2.0, || "the cloud should have neighbours".into())?;
    for shift in [Vec3::splat(-4.0), Vec3::splat(-512.0), Vec3::new(-8.0, 3.0, -4.0)] {
        let moved = lists(shift)?;
        let same = (moved.offsets(), moved.indices()) == (expected.offsets(), expected.indices());
        expect(same, || format!("moved by {shift} the lists differ"))?;
    }
    Ok(())
}

/// Accel met particle 0 once more for every empty cell.
fn first_particle_once(subject: &Subject) -> Verdict {
    let points = [Vec3::ZERO, Vec3::new(0.25, 0.0, 0.0), Vec3::new(40.0, 7.0, -3.0)];
    let built = subject.build(&plan(&points, 0.5)).map_err(in_words)?;
    let list = built.list(&FixedRadius::new(0.5).order(RowOrder::Index)).map_err(in_words)?;
    let rows = (list.row(0), list.row(1), list.row(2));
    expect(rows == (&[0, 1][..], &[0, 1][..], &[2][..]), || format!("{rows:?}"))?;
    let counts = built.count(&FixedRadius::new(0.5)).map_err(in_words)?;
    expect(counts.as_slice() == [2, 2, 1], || format!("{:?}", counts.as_slice()))
}

/// Two rows of everything, sorted: long loops for one invocation of a device.
fn long_rows_sorted(subject: &Subject) -> Verdict {
    let points = cloud(6000);
    let built = subject.build(&plan(&points, 2.0)).map_err(in_words)?;
    let queries = [Vec3::splat(0.5), Vec3::ZERO];
    for order in [RowOrder::Index, RowOrder::Distance] {
        let question = FixedRadius::new(2.0).queries(&queries).order(order).distances();
        for cap in [None, Some(5000)] {
            let question = FixedRadius { max_neighbors: cap, ..question };
            let list = built.list(&question).map_err(in_words)?;
            for query in 0..2 {
                let (row, distances) = (list.row(query), list.row_distances(query).unwrap_or_default());
                let ascending = match order {
                    RowOrder::Index => row.is_sorted_by(|a, b| a < b),
                    _ => distances.is_sorted(),
                };
                let length = cap.unwrap_or(6000) as usize;
                expect(row.len() == length, || format!("{order:?}: a row of {length} has {}", row.len()))?;
                expect(ascending, || format!("{order:?}, cap {cap:?}: row {query} is not sorted"))?;
            }
        }
    }
    Ok(())
}

/// Accel cut every list at a fixed length and said nothing.
fn long_rows_whole(subject: &Subject) -> Verdict {
    let points = cloud(4096);
    let built = subject.build(&plan(&points, 2.0)).map_err(in_words)?;
    let queries = [Vec3::splat(0.5), Vec3::ZERO];
    let list = built.list(&FixedRadius::new(2.0).queries(&queries).order(RowOrder::Index)).map_err(in_words)?;
    expect(list.offsets() == [0, 4096, 8192] && list.cut().is_empty(), || format!("{:?}", list.offsets()))?;
    expect(list.indices().iter().enumerate().all(|(i, &index)| index == i as u32 % 4096), || {
        "an index is missing".into()
    })?;
    let capped = built.list(&FixedRadius::new(2.0).queries(&queries).max_neighbors(100)).map_err(in_words)?;
    let missing: Vec<(u32, u32)> = capped.cut().iter().map(|cut| (cut.query, cut.missing)).collect();
    expect(missing == [(0, 3996), (1, 3996)], || format!("the cut is reported as {missing:?}"))
}
