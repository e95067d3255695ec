//! Points in boxes on the device: one kernel counts, and writes the rows once the host has placed them.

use std::time::Instant;

use bytemuck::{Pod, Zeroable};

use super::answers::{FEW_QUERIES, add_stages};
use super::batch::{halving, windows};
use crate::curve::Domain;
use crate::geometry::Aabb;
use crate::gpu::{Access, Bind, Buffer, Kernel, StageTime, Workgroups};
use crate::query::{BoxSearch, Boxes, Counts, Neighbors, Report, boxes};
use crate::structure::{GpuLinearOctree, GpuStructure};
use crate::{Error, Result};

/// Invocations of a workgroup of the kernel.
const WORKGROUP: u32 = 64;

/// `DeviceBox` in boxes.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct DeviceBox {
    min_order: [u32; 3],
    padding_0: u32,
    max_order: [u32; 3],
    padding_1: u32,
    low_cell: [u32; 3],
    padding_2: u32,
    high_cell: [u32; 3],
    padding_3: u32,
}

/// A number that orders like the f32; both zeros are one.
fn order_of(value: f32) -> u32 {
    // Minus zero plus zero is zero.
    let bits = (value + 0.0).to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

impl DeviceBox {
    fn new(domain: &Domain, aabb: &Aabb) -> Self {
        Self {
            min_order: aabb.min.to_array().map(order_of),
            max_order: aabb.max.to_array().map(order_of),
            low_cell: domain.cell_of(aabb.min),
            high_cell: domain.cell_of(aabb.max),
            ..Zeroable::zeroed()
        }
    }
}

/// What the kernel does with the points inside.
enum Output<'a> {
    Counts(&'a Buffer<u32>),
    Rows { offsets: &'a Buffer<u32>, indices: &'a Buffer<u32> },
}

fn report(tree: &GpuLinearOctree) -> Report {
    Report {
        structure: <GpuLinearOctree as GpuStructure>::NAME,
        search: "thread-a-box",
        device: tree.gpu().name().to_owned(),
        kernels: vec!["package::query::boxes".to_owned()],
        batches: 1,
        ..Report::default()
    }
}

fn run(tree: &GpuLinearOctree, boxes: &[Aabb], stage: &'static str, output: &Output<'_>) -> Result<Vec<StageTime>> {
    use Access::{Read, ReadWrite, Uniform};
    let gpu = tree.gpu();
    let boxes: Vec<DeviceBox> = boxes.iter().map(|aabb| DeviceBox::new(tree.domain(), aabb)).collect();
    let fill = matches!(output, Output::Rows { .. });
    check_loops(tree, &boxes, fill)?;
    let parameters = gpu.uniform("box parameters", &[boxes.len() as u32, tree.nodes().len() as u32, 0, 0])?;
    let uploaded = gpu.upload("boxes", &boxes)?;
    let mut binds: Vec<Bind> =
        vec![(&parameters).into(), (&uploaded).into(), tree.points().into(), tree.nodes().into()];
    let accesses: &[Access] = match output {
        Output::Counts(counts) => {
            binds.push((*counts).into());
            &[Uniform, Read, Read, Read, ReadWrite]
        }
        Output::Rows { offsets, indices } => {
            binds.extend([(*offsets).into(), (*indices).into()]);
            &[Uniform, Read, Read, Read, Read, ReadWrite]
        }
    };
    let kernel = Kernel {
        features: &[("fill", fill)],
        constants: &[("WORKGROUP", f64::from(WORKGROUP))],
        ..Kernel::new("package::query::boxes", "find_in_boxes", accesses, WORKGROUP)
    };
    let mut commands = gpu.commands("points in boxes");
    commands.stage(stage).dispatch(&gpu.prepare(&kernel)?, &binds, Workgroups::Covering(boxes.len() as u64));
    commands.run()
}

/// Checks that the device does not end the kernel's loops before their work is done.
fn check_loops(tree: &GpuLinearOctree, boxes: &[DeviceBox], fill: bool) -> Result<()> {
    let Some(limit) = tree.gpu().limits().loop_rounds else { return Ok(()) };
    let cells: Vec<[[u32; 3]; 2]> = boxes.iter().map(|b| [b.low_cell, b.high_cell]).collect();
    // A round for each node and point, and the looks at the end.
    if tree.most_box_steps(&cells, fill)? + 2 <= u64::from(limit) {
        return Ok(());
    }
    let (n, gpu) = (tree.len(), tree.gpu().name());
    Err(Error::Unsupported {
        what: format!(
            "boxes with so many of {n} points on {gpu}, which ends the loops of a kernel after {limit} rounds,"
        ),
        advice: "use the CPU, smaller boxes or fewer points",
    })
}

fn count(tree: &GpuLinearOctree, boxes: &[Aabb], report: &mut Report) -> Result<Vec<u32>> {
    let mut counts = Vec::with_capacity(boxes.len());
    report.batches = halving(boxes.len(), FEW_QUERIES, |range| {
        let buffer = tree.gpu().buffer("points in boxes", range.len())?;
        let times = run(tree, &boxes[range], "count", &Output::Counts(&buffer))?;
        counts.extend(tree.gpu().read(&buffer)?);
        add_stages(report, &times);
        Ok(())
    })?;
    Ok(counts)
}

/// The rows of these boxes, whose lengths are `counts`, in the order of the tree.
fn fill(tree: &GpuLinearOctree, boxes: &[Aabb], counts: &[u32], report: &mut Report) -> Result<Vec<u32>> {
    let gpu = tree.gpu();
    let mut total = 0u64;
    let offsets: Vec<u32> = counts
        .iter()
        .map(|&count| {
            let offset = total as u32;
            total += u64::from(count);
            offset
        })
        .collect();
    let indices = gpu.buffer("indices of points in boxes", total as usize)?;
    let offsets = gpu.upload("row offsets", &offsets)?;
    let times = run(tree, boxes, "fill", &Output::Rows { offsets: &offsets, indices: &indices })?;
    let read = gpu.read(&indices)?;
    add_stages(report, &times);
    Ok(read)
}

impl BoxSearch for GpuLinearOctree {
    fn count_in_boxes(&self, question: &Boxes<'_>) -> Result<Counts> {
        question.validate()?;
        let (start, mut report) = (Instant::now(), report(self));
        let counts = count(self, question.boxes, &mut report)?;
        report.host_stage("total", start);
        Ok(Counts { counts, report })
    }

    fn list_in_boxes(&self, question: &Boxes<'_>) -> Result<Neighbors> {
        question.validate()?;
        let (start, mut report) = (Instant::now(), report(self));
        let counts = count(self, question.boxes, &mut report)?;
        let offsets = question.offsets(&counts)?;
        let mut indices = Vec::with_capacity(offsets[counts.len()] as usize);
        let mut batches = 0;
        for window in windows(&counts, self.gpu().limits().binding_bytes / 4) {
            batches += halving(window.len(), 1, |part| {
                let part = window.start + part.start..window.start + part.end;
                indices.extend(fill(self, &question.boxes[part.clone()], &counts[part], &mut report)?);
                Ok(())
            })?;
        }
        report.batches = report.batches.max(batches);
        let sort = Instant::now();
        boxes::sort_rows(&offsets, &mut indices);
        report.host_stage("sort rows on the host", sort);
        report.host_stage("total", start);
        Ok(Neighbors { offsets, indices, report, ..Neighbors::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_are_those_of_the_numbers() {
        let ascending = [f32::NEG_INFINITY, -1e18, -1.0, -1e-40, 0.0, 1e-45, 1e-40, 1.0, f32::INFINITY];
        assert!(ascending.map(order_of).is_sorted_by(|a, b| a < b));
        assert_eq!(order_of(-0.0), order_of(0.0));
    }
}
