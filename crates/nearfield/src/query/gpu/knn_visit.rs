//! Visitors over the nearest points: the rows are found first, and a visitor goes through them as it would through what lies
//! within a radius.

use super::answers::{add_stages, in_batches};
use super::device_queries::VisitorModule;
use super::knn::{NearestOnDevice, find, report};
use super::visit::{QueryBuffers, restored_points};
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, Kernel, Workgroups};
use crate::query::{Knn, Report};
use crate::structure::{DevicePoint, GpuAabbTree, GpuStructure};
use crate::{Error, Result};

/// Invocations of a workgroup of the kernel.
const WORKGROUP: u32 = 64;
const KERNEL: &str = "package::query::visit_nearest";

/// Runs `visitor` on the nearest points of every query, nearest first, and waits for it. The radius that it sees is the
/// distance of the last.
///
/// Where memory is short, queries run in batches: `Query::id` is the query's index, `Query::slot` its place in the batch.
///
/// # Errors
/// As [`crate::query::KnnSearch::knn`]; `Unsupported` for trees with periodic axes, and where the device would end the loops.
pub(crate) fn visit_nearest(tree: &GpuAabbTree, question: &Knn<'_>, visitor: &VisitorModule<'_>) -> Result<Report> {
    let (gpu, within, places) = (tree.gpu(), question.as_fixed_radius(), question.places(GpuStructure::len(tree)));
    within.validate(GpuStructure::len(tree))?;
    check(tree, question, visitor, places)?;
    let points: Buffer<DevicePoint> = restored_points(tree, 0..GpuStructure::len(tree))?;
    let mut accesses = vec![Access::Uniform];
    accesses.extend([Access::Read; 3]);
    let visitor_accesses: Vec<Access> = visitor.bindings.iter().map(|(access, _)| *access).collect();
    let visitor_binds: Vec<Bind> = visitor.bindings.iter().map(|(_, bind)| bind.clone()).collect();
    let fills = [("package::structure::visitor", Fill::Module(visitor.module))];
    let pipeline = gpu.prepare(&Kernel {
        visitor_bindings: &visitor_accesses,
        fills: &fills,
        // An invocation answers each query alone.
        features: &[&[("shared_queries", false)], visitor.features].concat(),
        constants: &[("WORKGROUP", f64::from(WORKGROUP))],
        ..Kernel::new(KERNEL, "visit_nearest", &accesses, WORKGROUP)
    })?;
    let mut made = report(tree);
    made.kernels.push(format!("{KERNEL} with {}", visitor.module));
    in_batches(tree, &within, 1, &mut made, |queries: &QueryBuffers, report| {
        let rows = find(tree, &within, queries, places, report)?;
        let batch = gpu.uniform("batch of nearest", &[queries.len() as u32, queries.first_id(), places as u32, 0])?;
        let binds = [(&batch).into(), queries.points().into(), (&points).into(), (&rows.ids).into()];
        let mut commands = gpu.commands("visit nearest points");
        let covering = Workgroups::Covering(queries.len() as u64);
        commands.stage("visit").dispatch_with_visitor(&pipeline, &binds, &visitor_binds, covering);
        add_stages(report, &commands.run()?);
        Ok(())
    })?;
    Ok(made)
}

fn check(tree: &GpuAabbTree, question: &Knn<'_>, visitor: &VisitorModule<'_>, places: usize) -> Result<()> {
    tree.check_loops(question, places)?;
    if tree.settings().period.is_periodic() {
        return Err(Error::Unsupported {
            what: "visiting the nearest points of a tree with periodic axes".into(),
            advice: "build a tree without a period",
        });
    }
    let [each, finish] = visitor.rounds;
    let rounds = (places as u64).saturating_mul(1 + each).saturating_add(finish + 2);
    match tree.gpu().limits().loop_rounds {
        Some(limit) if rounds > u64::from(limit) => Err(Error::Unsupported {
            what: format!(
                "visiting {places} nearest points on {}, which ends the loops of a kernel after {limit} rounds,",
                tree.gpu().name()
            ),
            advice: "use the CPU or fewer points",
        }),
        _ => Ok(()),
    }
}
