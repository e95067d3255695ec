//! The reference's periodic distance against the nearest of 27 images in f64.

use libtest_mimic::Trial;
use nearfield::Vec3;

use crate::cases;
use crate::compare::Verdict;
use crate::reference::{Problem, ulp};

/// A trial for every periodic case.
pub(crate) fn trials() -> Vec<Trial> {
    let periodic = cases::all().enumerate().filter(|(_, named)| named.name.starts_with("periodic"));
    periodic.map(|(number, named)| crate::trial(format!("images/{}", named.name), move || check(number))).collect()
}

fn check(number: usize) -> Verdict {
    let problem = crate::solved(number).own();
    if problem.period == Vec3::ZERO {
        return Err("the case is not periodic".into());
    }
    for row in &problem.truth {
        for point in 0..problem.points.len() as u32 {
            let radius = problem.radii[row.query as usize];
            let distance = nearest_of_27(problem, row.query, point);
            let inside = row.hits.binary_search_by_key(&point, |hit| hit.0).is_ok();
            let (a, b) = (problem.queries[row.query as usize], problem.points[point as usize]);
            // The f32 difference, its turns and its wrap are rounded, each to the size of the coordinates.
            let rounding = (0..3).map(|axis| 2.0 * ulp(a[axis].abs().max(b[axis].abs()))).sum::<f64>();
            let off = (distance - f64::from(radius)).abs();
            if inside != (distance <= f64::from(radius)) && off > 4.0 * ulp(radius) + rounding {
                return Err(format!("query {}, point {point}: inside {inside}, nearest image {distance:e}", row.query));
            }
        }
    }
    Ok(())
}

fn nearest_of_27(problem: &Problem<'_>, query: u32, point: u32) -> f64 {
    let difference = (problem.queries[query as usize].as_dvec3()) - problem.points[point as usize].as_dvec3();
    let length = problem.period.as_dvec3();
    let mut nearest = f64::INFINITY;
    for image in 0..27 {
        let shift = [image % 3, image / 3 % 3, image / 9].map(|s| f64::from(s) - 1.0);
        let axis = |k: usize| match length[k] {
            0.0 => difference[k],
            length => difference[k] - length * ((difference[k] / length).trunc() + shift[k]),
        };
        let [x, y, z] = [axis(0), axis(1), axis(2)];
        nearest = nearest.min((x * x + y * y + z * z).sqrt());
    }
    nearest
}
