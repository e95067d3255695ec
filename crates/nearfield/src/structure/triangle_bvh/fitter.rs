//! The dispatches that fit the boxes of a hierarchy on the device to triangles whose corners have moved.

use std::sync::Arc;

use super::collapse::WIDTH;
use super::compress::{CompressedNode, Content};
use crate::Result;
use crate::geometry::PreparedTriangle;
use crate::gpu::{Access, Buffer, Gpu, Kernel, Pipeline, StageTime, Workgroups};
use crate::structure::PreparedTriangles;

/// Invocations of a workgroup.
const WORKGROUP: u32 = 64;

/// Kernels, and what follows from the shape of a tree, which a refit leaves as it is.
#[derive(Debug)]
pub(super) struct Fitter {
    follow_triangles: Arc<Pipeline>,
    fit_level: Arc<Pipeline>,
    /// `[nodes]` by level, the deepest first.
    by_level: Buffer<u32>,
    /// From the deepest level up: where its nodes stand in `by_level`, and how many there are.
    plans: Vec<(u32, Buffer<[u32; 4]>)>,
    n_triangles: Buffer<[u32; 4]>,
    /// `[2 nodes]` the corners of what is below each node, before they are rounded to steps.
    held: Buffer<[f32; 4]>,
}

impl Fitter {
    /// For a tree on the device, whose nodes are read back for it.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `OutOfMemory`, `DeviceLost`, `KernelRejected`.
    pub(super) fn new(gpu: &Gpu, nodes: &Buffer<CompressedNode>, n_triangles: usize) -> Result<Self> {
        use Access::{Read, ReadWrite, Uniform};
        let kernel = |module, entry, accesses: &[Access]| {
            let constants = &[("WORKGROUP", f64::from(WORKGROUP))];
            gpu.prepare(&Kernel { constants, ..Kernel::new(module, entry, accesses, WORKGROUP) })
        };
        let follow = ("package::structure::triangle_bvh::follow", "follow_triangles");
        let fit = ("package::structure::triangle_bvh::fit", "fit_level");
        let (by_level, ends) = by_level(&gpu.read(nodes)?);
        let mut plans = Vec::with_capacity(ends.len());
        let mut first = 0;
        for end in ends {
            plans.push((end - first, gpu.uniform("fit plan", &[first, end - first, 0, 0])?));
            first = end;
        }
        Ok(Self {
            follow_triangles: kernel(follow.0, follow.1, &[Uniform, Read, ReadWrite])?,
            fit_level: kernel(fit.0, fit.1, &[Uniform, Uniform, Read, Read, ReadWrite, ReadWrite])?,
            by_level: gpu.upload("nodes of a BVH by level", &by_level)?,
            plans,
            n_triangles: gpu.uniform("number of triangles", &[0, n_triangles as u32, 0, 0])?,
            held: gpu.buffer("boxes of a BVH", 2 * nodes.len())?,
        })
    }

    /// Copies moved triangles to the device and fits every box to them; the times of the stages there.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, before anything is changed; `DeviceLost`.
    pub(super) fn fit(
        &self,
        gpu: &Gpu,
        moved: &PreparedTriangles,
        nodes: &Buffer<CompressedNode>,
        in_order: &Buffer<PreparedTriangle>,
    ) -> Result<Vec<StageTime>> {
        let space = gpu.uniform("ray space", moved.space())?;
        let moved = gpu.upload("moved triangles", moved.as_slice())?;
        let mut commands = gpu.commands("fit a BVH");
        let binds = [(&self.n_triangles).into(), (&moved).into(), in_order.into()];
        let all = Workgroups::Covering(in_order.len() as u64);
        commands.stage("follow").dispatch(&self.follow_triangles, &binds, all);
        commands.stage("fit");
        for (count, plan) in &self.plans {
            let binds = [
                plan.into(),
                (&space).into(),
                (&self.by_level).into(),
                in_order.into(),
                nodes.into(),
                (&self.held).into(),
            ];
            commands.dispatch(&self.fit_level, &binds, Workgroups::Covering((*count).into()));
        }
        commands.run()
    }

    /// Bytes of device memory held.
    pub(super) fn memory_bytes(&self) -> u64 {
        let plans: u64 = self.plans.iter().map(|(_, plan)| plan.bytes()).sum();
        self.by_level.bytes() + self.held.bytes() + self.n_triangles.bytes() + plans
    }
}

/// The nodes by level, the deepest first, and where each level ends. Children stand behind their parents.
fn by_level(nodes: &[CompressedNode]) -> (Vec<u32>, Vec<u32>) {
    let mut levels = vec![0u32; nodes.len()];
    for (place, node) in nodes.iter().enumerate() {
        for slot in 0..WIDTH {
            if let Some(Content::Node(below)) = node.content(slot) {
                levels[below as usize] = levels[place] + 1;
            }
        }
    }
    let deepest = levels.iter().copied().max().unwrap_or(0);
    let mut order: Vec<u32> = (0..nodes.len() as u32).collect();
    order.sort_by_key(|&node| deepest - levels[node as usize]);
    let is_last = |i: &usize| i + 1 == order.len() || levels[order[*i] as usize] != levels[order[i + 1] as usize];
    let ends = (0..order.len()).filter(is_last).map(|i| i as u32 + 1).collect();
    (order, ends)
}
