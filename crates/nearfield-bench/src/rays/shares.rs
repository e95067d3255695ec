//! How the time divides into build, copy to the device and traversal, as Accel's last two graphs.

use std::path::Path;

use nearfield::KdTreeSettings;

use super::check::Expected;
use super::method::{self, Method, Scene};
use super::rows::Row;
use super::shots::{self, Question};
use super::{Lab, meshes, published};
use crate::Result;
use crate::plots::{self, Axes, Bar, Frame};
use crate::provenance::COMMIT;

/// Side of Accel's pictures.
const SIDE: usize = 750;

/// Measures Accel's trees and ours over its largest mesh.
///
/// # Errors
/// What a build or a cast returns; an answer that is wrong.
pub fn measure(lab: &mut Lab) -> Result<()> {
    let named = lab.source.mesh(meshes::ACCEL[meshes::ACCEL.len() - 1])?;
    let rays = shots::primary(&named.mesh, lab.side(SIDE));
    let accels = published::ACCEL_BUILDS.map(|(leaf, _)| KdTreeSettings::spatial_median(leaf));
    let mut expected = None;
    for (number, settings) in accels.into_iter().chain([lab.tree]).enumerate() {
        let scene = Scene::new(&named.mesh, &settings)?;
        let expected = match &expected {
            Some(expected) => expected,
            None => expected.insert(Expected::of(&scene.triangles, &rays, Question::Closest)?),
        };
        let is_last = number == accels.len();
        let methods = [Method::CpuRopes, Method::GpuRopes];
        let methods = methods.into_iter().chain([Method::CpuBvh, Method::GpuBvh].into_iter().filter(|_| is_last));
        for method in methods {
            let Some(built) = scene.build(method, lab.gpu())? else { continue };
            let is_tree = matches!(method, Method::CpuRopes | Method::GpuRopes);
            let accel = published::ACCEL_BUILDS.get(number).filter(|_| is_tree);
            let row = Row {
                part: "shares",
                mesh: named.name.clone(),
                triangles: named.triangles(),
                method: method.name().to_owned(),
                how: if is_tree { method::tree_name(&settings) } else { String::new() },
                device: lab.device(method),
                shots: "primary".to_owned(),
                rays: rays.len(),
                build: Some(built.build),
                upload: built.upload,
                sample: expected.sample(),
                note: accel.map_or_else(String::new, |a| format!("Accel's build of 29,808 triangles: {} ms", a.1)),
                ..Row::default()
            };
            match method::cast(&built.search, &rays, Question::Closest, expected, lab.effort(method)) {
                Ok(cast) => {
                    let tests = Some(method::triangle_tests(&built.search, &rays)?);
                    lab.add(Row { cast: Some(cast), tests, ..row });
                }
                Err(error) => {
                    let note = super::unsupported(error)?;
                    lab.add(Row { note, ..row });
                }
            }
        }
    }
    Ok(())
}

/// A bar a tree: shares of build, copy and one cast.
///
/// # Errors
/// A file that cannot be written.
pub fn plot(lab: &Lab, path: &Path, on_gpu: bool) -> Result<()> {
    let is_side = |row: &&Row| row.part == "shares" && row.method.starts_with(if on_gpu { "GPU" } else { "CPU" });
    let bar = |row: &Row| {
        let cast = row.cast.as_ref()?;
        let mut parts = vec![("build on the CPU".to_owned(), row.build?)];
        parts.extend(row.upload.map(|upload| ("copy to the device".to_owned(), upload)));
        parts.push(("traversal".to_owned(), cast.milliseconds()));
        let label = if row.how.is_empty() { row.method.clone() } else { row.how.replace(", ", ",\n") };
        Some(Bar { label, parts })
    };
    let bars: Vec<Bar> = lab.rows.iter().filter(is_side).filter_map(bar).collect();
    if bars.is_empty() {
        return Ok(());
    }
    let device = if on_gpu { &lab.machine.name } else { &lab.machine.host };
    let side = lab.side(SIDE);
    let frame = Frame {
        title: format!("Build and {side} × {side} primary rays, {}", if on_gpu { "GPU" } else { "CPU" }),
        caption: vec![
            device.clone(),
            format!("Nearfield commit {COMMIT}. kd-trees by how they are cut; all are built on the CPU."),
        ],
        x_label: String::new(),
        y_label: "share of the time, %".to_owned(),
        axes: Axes::Linear,
        legend_right: true,
    };
    plots::shares(path, &frame, &bars)
}
