//! Accel's timings again: 750 × 750 primary rays against the number of triangles, for every structure.

use std::path::Path;

use super::check::Expected;
use super::method::{self, Method, Scene};
use super::rows::Row;
use super::shots::{self, Question};
use super::{Lab, published};
use crate::Result;
use crate::plots::{self, Axes, Frame, Look, Panel, Series};
use crate::provenance::COMMIT;

/// Side of Accel's pictures.
const SIDE: usize = 750;
/// A single cast may take this share of the budget.
const SHARE: f64 = 1.0 / 6.0;

/// Measures every structure on every mesh that the budget lets it.
///
/// # Errors
/// What a build or a cast returns; an answer that is wrong.
pub fn measure(lab: &mut Lab) -> Result<()> {
    // Seconds of a cast a triangle, of brute force on the mesh before.
    let mut a_triangle = [None; Method::ALL.len()];
    for named in lab.source.accel()? {
        let scene = Scene::new(&named.mesh, &lab.tree)?;
        let rays = shots::primary(&named.mesh, lab.side(SIDE));
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
            if method.is_brute() {
                let before = a_triangle[which].map(|seconds: f64| seconds * named.triangles() as f64);
                let part = if lab.machine.is_hardware_gpu() && method.on_gpu() { 8 } else { 64 };
                let first = || method::foreseen(&built.search, &rays, part);
                match before.map_or_else(first, Ok) {
                    Ok(seconds) if seconds > lab.left().min(SHARE * lab.budget) => {
                        row.note = format!("left out: a cast would take about {seconds:.0} s");
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
            } else if lab.left() <= 0.0 {
                row.note = "left out: the budget is spent".to_owned();
                lab.add(row);
                continue;
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
            if method.is_brute() && tests != (named.triangles() as f64, named.triangles() as u32) {
                return Err(format!("wrong answer: {} counts {tests:?} tests a ray", method.name()).into());
            }
            lab.add(Row { cast: Some(cast), tests: Some(tests), ..row });
        }
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
    let frame = Frame {
        title: format!("{side} × {side} primary rays against the number of triangles"),
        caption: vec![
            format!("GPU: {} ({})", lab.machine.name, lab.machine.driver),
            format!("CPU: {}", lab.machine.host),
            format!("Nearfield commit {COMMIT}. Medians; GPU by device timestamps, CPU by wall clock, all threads."),
            "Crosses: Accel's figures for 750 × 750 rays on its machine of 2014, GPU with allocation and upload."
                .to_owned(),
        ],
        x_label: "triangles".to_owned(),
        y_label: "milliseconds".to_owned(),
        axes: Axes::Logarithmic,
        legend_right: false,
    };
    plots::lines(path, &frame, &panels)
}
