//! Table 1: time and memory of a query over the radius, 300 k points; all points within it, and the nearest only.

use nearfield::{Nearest, Vec3};
use rayon::prelude::*;

use super::lab::{Lab, Spot};
use super::measured::device_milliseconds;
use super::methods::{self, Found, Method, Plug, Positions, Start};
use super::original::{ByRadius, TABLE_1, TABLE_1_POINTS};
use super::plotting;
use super::rows::{Row, Sheet, refusal};
use crate::Result;
use crate::check::Expected;
use crate::measure::{Measured, repeat};
use crate::plots::{Axes, Frame, Panel};

const QUANTITIES: [(&str, &str); 4] = [
    ("all points: query", "ms"),
    ("all points: memory", "MB"),
    ("nearest only: query", "ms"),
    ("nearest only: memory", "MB"),
];

/// Measures every row of the table with every method.
///
/// # Errors
/// What a method returns; a wrong answer; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "table-1")?;
    let spot = Spot::new(lab, TABLE_1_POINTS);
    for original in &TABLE_1 {
        let radius = spot.length(original.r_over_l);
        let mut expected = None;
        for plug in methods::possible(lab) {
            let blank = spot.row(lab.device(plug.on_gpu), "", original.r_over_l, plug.name);
            sheet.attempt(Row { quantity: "all queries", ..blank.clone() }, || {
                let expected = match &expected {
                    Some(expected) => expected,
                    None => expected.insert(Expected::of(&spot.points, radius)?),
                };
                rows_of(lab, plug, (&spot.points, radius), original, (&blank, expected))
            })?;
        }
    }
    plot(lab, sheet.rows())?;
    Ok(sheet.into_rows())
}

fn rows_of(
    lab: &Lab,
    plug: &Plug,
    (points, radius): (&[Vec3], f32),
    original: &ByRadius,
    (blank, expected): (&Row, &Expected),
) -> Result<Vec<Row>> {
    let gpu = lab.gpu().filter(|_| plug.on_gpu);
    let at = Positions::new(gpu, points.to_vec())?;
    let mut method = (plug.make)(&Start { gpu, at: &at, radius, mean_neighbors: expected.mean() })?;
    // The memory of a query is what stands at its highest: structure, answer and scratch.
    let peak = |method: &mut dyn Method, before: u64, answer: u64| match gpu {
        Some(gpu) => gpu.take_memory_peak().saturating_sub(before) + method.memory_bytes(),
        None => method.memory_bytes() + answer,
    };
    let settle = || gpu.map_or(0, |gpu| (gpu.take_memory_peak(), gpu.memory_used()).1);
    let paper_is = plug.name.contains("coherent");
    let paper = |value: f64| paper_is.then_some(value);

    let before = settle();
    let (found, listed) = repeat(lab.effort(), || {
        let found = method.list(radius)?;
        let stages = found.stages().to_vec();
        Ok((found, stages))
    })?;
    let list_bytes = peak(&mut *method, before, found.bytes());
    let judged = found.check(gpu, expected)?;
    drop::<Found>(found);
    let before = settle();
    let asked = repeat(lab.effort(), || {
        let nearest = method.nearest(radius)?;
        let stages = nearest.report.stages.clone();
        Ok((nearest, stages))
    });

    let [(all, ms), (all_memory, mb), (only, _), (only_memory, _)] = QUANTITIES;
    let blank = Row { mean_neighbors: Some(expected.mean()), ..blank.clone() };
    let time = |quantity, measured: &Measured, paper_seconds: f64| Row {
        device_milliseconds: device_milliseconds(&measured.stages),
        runs: measured.runs,
        ..blank.of(quantity, ms).value(measured.wall.median).paper(paper(1e3 * paper_seconds))
    };
    let memory = |quantity, bytes: u64, paper_mb| Row {
        runs: 1,
        ..blank.of(quantity, mb).value(bytes as f64 * 1e-6).paper(paper(paper_mb)).note("structure, answer and scratch")
    };
    let mut rows = vec![
        Row { recall: judged.recall, ..time(all, &listed, original.seconds[0]) }.note(judged.note),
        memory(all_memory, list_bytes, original.megabytes[0]),
    ];
    match asked {
        Ok((nearest, asked)) => {
            let bytes = peak(&mut *method, before, 8 * nearest.len() as u64);
            check_nearest(points, radius, &nearest)?;
            rows.push(time(only, &asked, original.seconds[1]).note("100 queries checked by brute force"));
            rows.push(memory(only_memory, bytes, original.megabytes[1]));
        }
        Err(error) => {
            let reason = refusal(&error).ok_or(error)?;
            rows.push(blank.of(only, ms).note(format!("missing: {reason}")));
        }
    }
    Ok(rows)
}

/// Checks the nearest other point of 100 queries by a plain loop in f64.
///
/// # Errors
/// The first query whose answer is wrong.
pub(super) fn check_nearest(points: &[Vec3], radius: f32, nearest: &Nearest) -> Result<()> {
    // Twice what rounding can change of d², which five operations of f32 make.
    const SLACK: f64 = 2.0 * 7.0 / (1u64 << 24) as f64;
    if nearest.len() != points.len() {
        return Err(format!("wrong answer: {} nearest, expected {}", nearest.len(), points.len()).into());
    }
    let step = points.len().div_ceil(100).max(1);
    (0..points.len()).into_par_iter().step_by(step).try_for_each(|query| {
        let dist2 = |i: usize| points[i].as_dvec3().distance_squared(points[query].as_dvec3());
        let least = (0..points.len()).filter(|&i| i != query).map(dist2).fold(f64::INFINITY, f64::min);
        let limit = f64::from(radius) * f64::from(radius);
        let is_right = match nearest.get(query) {
            None => least > limit * (1.0 - SLACK),
            Some(found) if found.index as usize == query || found.index as usize >= points.len() => false,
            Some(found) => {
                let its = dist2(found.index as usize);
                its <= least * (1.0 + SLACK) && its <= limit * (1.0 + SLACK)
            }
        };
        if is_right {
            return Ok(());
        }
        let found = nearest.get(query);
        Err(format!("wrong answer: the nearest of query {query} is {found:?}, expected one at {}", least.sqrt()).into())
    })
}

fn plot(lab: &Lab, rows: &[Row]) -> Result<()> {
    let x = |row: &Row| row.r_over_l;
    let panel = |(quantity, unit): (&'static str, &str)| {
        let own = || rows.iter().filter(|row| row.quantity == quantity);
        let mut series = plotting::by_method(own(), x);
        let paper = |r: &ByRadius| match quantity {
            "all points: query" => 1e3 * r.seconds[0],
            "all points: memory" => r.megabytes[0],
            "nearest only: query" => 1e3 * r.seconds[1],
            _ => r.megabytes[1],
        };
        series.push(plotting::published("paper", 0, TABLE_1.iter().map(|r| (r.r_over_l, paper(r))).collect()));
        Panel { title: format!("{quantity}, {unit}"), series }
    };
    let points = rows.first().map_or(0, |row| row.points);
    let frame = Frame {
        title: format!("Table 1: {points} points, over the radius"),
        caption: lab.caption(),
        x_label: "r / L of the paper".to_owned(),
        y_label: "ms or MB".to_owned(),
        axes: Axes::Logarithmic,
        legend_right: false,
    };
    plotting::save(lab, "table-1.svg", &frame, &QUANTITIES.map(panel))
}

#[cfg(test)]
mod tests {
    use nearfield::{BruteForce, FixedRadius, NeighborSearch};

    use super::*;

    #[test]
    fn a_nearest_of_another_radius_or_other_points_is_caught() {
        let points: Vec<Vec3> =
            (0..90).map(|i| Vec3::new((i * i % 97) as f32, i as f32, (i * 7 % 13) as f32)).collect();
        let ask = |points: &[Vec3], radius| {
            let tree = BruteForce::build(points).expect("points");
            tree.nearest(&FixedRadius::new(radius).exclude_self()).expect("nearest")
        };
        check_nearest(&points, 9.0, &ask(&points, 9.0)).expect("a right answer");
        assert!(check_nearest(&points, 9.0, &ask(&points, 1.0)).is_err(), "too small a radius misses some");
        assert!(check_nearest(&points, 1.0, &ask(&points, 9.0)).is_err(), "too large a radius finds too many");
        let mut others = points.clone();
        others.reverse();
        assert!(check_nearest(&points, 9.0, &ask(&others, 9.0)).is_err());
    }
}
