//! Accel's timings again: 750 × 750 primary rays against the number of triangles, for every structure.

use std::path::Path;

use super::check::Expected;
use nearfield::Ray;

use super::method::{self, Built, Method, Scene};
use super::rows::{Row, digits};
use super::shots::{self, Question};
use super::{Lab, published};
use crate::Result;
use crate::measure::Effort;
use crate::plots::{self, Axes, Frame, Look, Panel, Series};
use crate::provenance::COMMIT;

/// Side of Accel's pictures.
const SIDE: usize = 750;
/// A single cast may take this share of the budget.
const SHARE: f64 = 1.0 / 6.0;
/// Where all rays would take longer, rows of the picture are cast for this part of that time.
const ESTIMATE: f64 = 0.25;
/// Rows of the picture at least.
const FEWEST_ROWS: usize = 4;

/// Measures every structure on every mesh that the budget lets it.
///
/// # Errors
/// What a build or a cast returns; an answer that is wrong.
pub fn measure(lab: &mut Lab) -> Result<()> {
    // Seconds of a cast a triangle, of brute force on the mesh before.
    let mut a_triangle = [None; Method::ALL.len()];
    for named in lab.source.accel()? {
        let scene = Scene::new(&named.mesh, &lab.tree)?;
        let side = lab.side(SIDE);
        let rays = shots::primary(&named.mesh, side);
        let expected = Expected::of(&scene.triangles, &rays, Question::Closest)?;
        for (which, method) in Method::ALL.into_iter().enumerate() {
            let Some(built) = scene.build(method, lab.gpu())? else { continue };
            let is_tree = matches!(method, Method::CpuStack | Method::CpuRopes | Method::GpuRopes);
            let mut row = Row {
                part: "triangles",
                mesh: named.name.clone(),
                triangles: named.triangles(),
                method: method.name().to_owned(),
                how: if is_tree { method::tree_name(&lab.tree) } else { String::new() },
                device: lab.device(method),
                shots: "primary".to_owned(),
                rays: rays.len(),
                build: Some(built.build),
                upload: built.upload,
                sample: expected.sample(),
                accel: (rays.len() == published::RAYS)
                    .then(|| published::accel_at(method, named.triangles()))
                    .flatten(),
                target: match (method, named.triangles()) {
                    (Method::GpuRopes, 953_856) => "≤ 1 ms".to_owned(),
                    _ => String::new(),
                },
                ..Row::default()
            };
            if lab.left() <= 0.0 {
                row.note = "left out: the budget is spent".to_owned();
                lab.add(row);
                continue;
            }
            if method.is_brute() {
                let before = a_triangle[which].map(|seconds: f64| seconds * named.triangles() as f64);
                let part = if lab.machine.is_hardware_gpu() && method.on_gpu() { 8 } else { 64 };
                let first = || method::foreseen(&built.search, &rays, part);
                match before.map_or_else(first, Ok) {
                    Ok(seconds) if seconds > lab.left().min(SHARE * lab.budget) => {
                        let rows = (lab.left().min(SHARE * lab.budget) * ESTIMATE / seconds * side as f64) as usize;
                        let row = estimated(lab, &scene, &built, &rays, rows, row)?;
                        let seconds = row.cast.as_ref().map(|cast| cast.host.median * 1e-3);
                        a_triangle[which] = seconds.map(|seconds| seconds / named.triangles() as f64);
                        lab.add(row);
                        continue;
                    }
                    Ok(_) => {}
                    Err(error) => {
                        row.note = super::unsupported(error)?;
                        lab.add(row);
                        continue;
                    }
                }
            }
            let cast = method::cast(&built.search, &rays, Question::Closest, &expected, lab.effort(method));
            let cast = match cast {
                Ok(cast) => cast,
                Err(error) => {
                    row.note = super::unsupported(error)?;
                    lab.add(row);
                    continue;
                }
            };
            a_triangle[which] = Some(cast.host.median * 1e-3 / named.triangles() as f64);
            // Brute force tests the same of every ray.
            let sample = expected.sampled_rays();
            let tests = method::triangle_tests(&built.search, if method.is_brute() { &sample } else { &rays })?;
            if method.is_brute() {
                check_tests(method.name(), tests, named.triangles())?;
            }
            lab.add(Row { cast: Some(cast), tests: Some(tests), ..row });
        }
    }
    Ok(())
}

/// Brute force by some rows of the picture, its times scaled to all of them.
fn estimated(lab: &Lab, scene: &Scene, built: &Built, rays: &[Ray], rows: usize, row: Row) -> Result<Row> {
    let side = lab.side(SIDE);
    let rows = rows.clamp(FEWEST_ROWS, side);
    let some = shots::sampled_rows(rays, side, rows);
    let expected = Expected::of(&scene.triangles, &some, Question::Closest)?;
    let once = Effort { warm_up: 0.0, runs: 1, seconds: 0.0 };
    let cast = match method::cast(&built.search, &some, Question::Closest, &expected, once) {
        Ok(cast) => cast,
        Err(error) => return Ok(Row { note: super::unsupported(error)?, ..row }),
    };
    let tests = method::triangle_tests(&built.search, &expected.sampled_rays())?;
    check_tests(&row.method, tests, row.triangles)?;
    let note = format!(
        "estimate: {} rays, {rows} of {side} rows of the picture, took {} ms; times are scaled to all of them",
        some.len(),
        digits(cast.milliseconds())
    );
    Ok(Row {
        cast: Some(cast.scaled(rays.len() as f64 / some.len() as f64)),
        tests: Some(tests),
        sample: expected.sample(),
        estimated_from: Some(some.len()),
        note,
        ..row
    })
}

/// Brute force must test every triangle once.
fn check_tests(method: &str, tests: (f64, u32), triangles: usize) -> Result<()> {
    if tests != (triangles as f64, triangles as u32) {
        return Err(format!("wrong answer: {method} counts {tests:?} tests a ray, expected {triangles}").into());
    }
    Ok(())
}

/// All structures in one panel as Accel's first graph, and the fast ones again.
///
/// # Errors
/// A file that cannot be written.
pub fn plot(lab: &Lab, path: &Path) -> Result<()> {
    let line = |color: usize, method: Method| {
        let rows = lab.rows.iter().filter(|row| row.part == "triangles" && row.method == method.name());
        let point = |row: &Row| Some((row.triangles as f64, row.cast.as_ref()?.milliseconds()));
        Series { name: method.name().to_owned(), color, points: rows.filter_map(point).collect(), look: Look::Line }
    };
    let cross = |color: usize, method: Method| Series {
        name: format!("{}, Accel", method.name()),
        color,
        points: published::accel(method),
        look: Look::Published,
    };
    let panel = |title: &str, methods: &[Method]| {
        let color = |method: &Method| Method::ALL.iter().position(|m| m == method).unwrap_or(0);
        let ours = methods.iter().map(|m| line(color(m), *m));
        let theirs = methods.iter().map(|m| cross(color(m), *m));
        Panel { title: title.to_owned(), series: ours.chain(theirs).filter(|s| !s.points.is_empty()).collect() }
    };
    let fast = [Method::CpuStack, Method::CpuRopes, Method::CpuBvh, Method::GpuRopes, Method::GpuBvh];
    let panels = [panel("all structures", &Method::ALL), panel("trees and hierarchies", &fast)];
    let side = lab.side(SIDE);
    let mut frame = Frame {
        title: format!("{side} × {side} primary rays against the number of triangles"),
        caption: vec![
            format!("GPU: {} ({})", lab.machine.name, lab.machine.driver),
            format!("CPU: {}", lab.machine.host),
            format!("Nearfield commit {COMMIT}. Medians; GPU by device timestamps, CPU by wall clock, all threads."),
            estimates(lab),
            "Crosses: Accel's figures for 750 × 750 rays on its machine of 2014, GPU with allocation and upload."
                .to_owned(),
        ],
        x_label: "triangles".to_owned(),
        y_label: "milliseconds".to_owned(),
        axes: Axes::Logarithmic,
        legend_right: false,
    };
    frame.caption.retain(|line| !line.is_empty());
    plots::lines(path, &frame, &panels)
}

/// Which points of the plot are estimates, in words; empty where none is.
fn estimates(lab: &Lab) -> String {
    let rows = lab.rows.iter().filter(|row| row.part == "triangles" && row.estimated_from.is_some());
    let points: Vec<String> = rows.map(|row| format!("{} at {}", row.method, row.triangles)).collect();
    if points.is_empty() {
        String::new()
    } else {
        format!("Estimated from some rows of the picture: {}.", points.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::Arguments;

    #[test]
    fn an_estimate_casts_whole_rows_and_says_so() {
        let arguments = Arguments {
            device: nearfield::DeviceChoice::Cpu,
            scale: 0.01,
            budget: 1e6,
            data: None,
            parts: vec![],
            repeat: Some(1),
            full: false,
            embree: None,
            output: "unused".into(),
        };
        let mut lab = Lab::open(&arguments).expect("the CPU");
        let side = lab.side(SIDE);
        let named = lab.source.mesh(("icosphere", 32_000)).expect("an icosphere");
        let scene = Scene::new(&named.mesh, &lab.tree).expect("a scene");
        let rays = shots::primary(&named.mesh, side);
        let built = scene.build(Method::CpuBrute, None).expect("a list").expect("the CPU");
        let row = Row {
            part: "triangles",
            method: Method::CpuBrute.name().to_owned(),
            triangles: named.triangles(),
            rays: rays.len(),
            ..Row::default()
        };
        let wrong = Row { triangles: named.triangles() + 1, ..row.clone() };
        assert!(estimated(&lab, &scene, &built, &rays, 5, wrong).unwrap_err().to_string().starts_with("wrong answer"));
        assert_eq!(estimates(&lab), "");
        for (wanted, rows) in [(0, FEWEST_ROWS), (5, 5), (1000, side)] {
            let found = estimated(&lab, &scene, &built, &rays, wanted, row.clone()).expect("an estimate");
            assert_eq!(found.estimated_from, Some(rows * side));
            let cast = found.cast.as_ref().expect("times");
            let measured: f64 = {
                let (_, after) = found.note.split_once(" took ").expect("the time");
                after.split_once(" ms").expect("milliseconds").0.parse().expect("a number")
            };
            let scaled = measured * side as f64 / rows as f64;
            assert!((cast.host.median / scaled - 1.0).abs() < 0.02, "{} and {scaled}", cast.host.median);
            let told = format!("estimate: {} rays, {rows} of {side} rows of the picture, ", rows * side);
            assert!(found.note.starts_with(&told), "{}", found.note);
            assert_eq!(found.tests, Some((named.triangles() as f64, named.triangles() as u32)));
            lab.add(found);
        }
        assert!(estimates(&lab).starts_with("Estimated from some rows of the picture: CPU brute force at "));
    }
}
