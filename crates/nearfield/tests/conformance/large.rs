//! Clouds of up to a million points, some hundred of their rows compared: with `NEARFIELD_LONG=1`, and on hardware.

use libtest_mimic::Trial;
use nearfield::geometry::generate::{CloudKind, cloud, radius_for};
use nearfield::{FixedRadius, RowOrder, Vec3};

use crate::compare::{self, List, Verdict};
use crate::reference::Problem;
use crate::subjects::{Plan, SUBJECTS, Subject};

const CLOUDS: &[(&str, CloudKind, usize)] = &[
    ("uniform-1e6", CloudKind::Uniform, 1_000_000),
    ("shell-1e6", CloudKind::Shell, 1_000_000),
    ("clustered-1e5", CloudKind::Clustered, 100_000),
];

/// The grid on every device over every large cloud.
pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = vec![];
    for subject in SUBJECTS.iter().filter(|s| s.variant == "cells-like-the-radius" && s.takes_large_clouds()) {
        for &(name, kind, n) in CLOUDS {
            let name = format!("{}/{name}", subject.name());
            trials.push(crate::trial_on(subject, name, move || check(subject, kind, n)));
        }
    }
    trials
}

fn check(subject: &Subject, kind: CloudKind, n: usize) -> Verdict {
    let points = cloud(kind, n, 7).points;
    let radius = radius_for(kind, n).ok_or("the cloud should have a radius")?;
    let problem = Problem::solve(&points, &points, true, vec![radius; n], Vec3::ZERO);
    let in_words = |error: nearfield::Error| error.to_string();
    let plan = Plan { points: &points, radius, period: Default::default() };
    let built = subject.build(&plan).map_err(in_words)?;
    let rule = subject.rule(false);
    let counts = built.count(&FixedRadius::new(radius)).map_err(in_words)?;
    compare::counts(&problem, &FixedRadius::new(radius), counts.as_slice(), rule)?;
    for question in [FixedRadius::new(radius), FixedRadius::new(radius).order(RowOrder::Index).distances()] {
        let list = built.list(&question).map_err(in_words)?;
        let (offsets, indices) = (list.offsets(), list.indices());
        let list = List { offsets, indices, distances: list.distances(), cut: list.cut() };
        compare::list(&problem, &question, &list, rule)?;
        let same = offsets.windows(2).zip(counts.as_slice()).all(|(row, &count)| row[1] - row[0] == u64::from(count));
        if !same {
            return Err("the rows of the list are not as long as counted".into());
        }
    }
    Ok(())
}
