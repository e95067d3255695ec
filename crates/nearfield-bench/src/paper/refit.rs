//! The paper's refit, a dispatch a level, over nodes that stand level by level or in random order: for figure 7 alone. The library's
//! own refit takes several levels a dispatch.

use std::sync::Arc;

use nearfield::gpu::shader::Fill;
use nearfield::gpu::{Access, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
use nearfield::structure::TreeShape;
use nearfield::structure::aabb_tree::NodeBox;
use nearfield::{AabbTree, Result};

const WORKGROUP: u32 = 128;
const MODULE: &str = "package::paper::refit";

/// A node: its level, the places of its children, and its points in the tree's order. Twin of `Node` in refit.wesl.
type Node = [u32; 5];
/// Twin of `Plan` in refit.wesl: level, depth, first and end of the nodes that are looked at.
type Plan = [u32; 4];

/// Where the nodes stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Placing {
    /// Level by level: a dispatch takes the nodes of its level.
    ByLevel,
    /// In random order: a dispatch picks the nodes of its level out of all.
    Shuffled,
}

/// A tree whose boxes are fitted level by level.
pub struct LevelRefit {
    gpu: Gpu,
    shape: TreeShape,
    pipeline: Arc<Pipeline>,
    nodes: Buffer<Node>,
    points: Buffer<[f32; 4]>,
    boxes: Buffer<[f32; 4]>,
    plans: Vec<(Buffer<Plan>, u32)>,
    place_of: Vec<u32>,
}

impl LevelRefit {
    /// The nodes of `tree` and its points on the device, placed as `placing` says.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `KernelRejected`.
    pub fn new(gpu: &Gpu, tree: &AabbTree, placing: Placing) -> Result<Self> {
        let shape = tree.shape();
        let place_of = match placing {
            Placing::ByLevel => (0..shape.n_nodes() as u32).collect(),
            Placing::Shuffled => shuffled(shape.n_nodes()),
        };
        let mut nodes: Vec<Node> = vec![[0; 5]; shape.n_nodes()];
        for node in 0..shape.n_nodes() {
            let level = (node + 1).ilog2();
            let child = |which: usize| if shape.is_leaf(node) { 0 } else { place_of[2 * node + which] };
            let points = shape.points(node);
            nodes[place_of[node] as usize] = [level, child(1), child(2), points.start as u32, points.end as u32];
        }
        let in_order = tree.ordered_points();
        let points: Vec<[f32; 4]> = (0..in_order.len()).map(|i| in_order.position(i).extend(0.0).to_array()).collect();
        let plan = |level: u32| {
            let range = match placing {
                Placing::ByLevel => shape.level(level),
                Placing::Shuffled => 0..shape.n_nodes(),
            };
            let plan = [level, shape.depth(), range.start as u32, range.end as u32];
            Ok((gpu.uniform("plan of a level", &plan)?, range.len() as u32))
        };
        let accesses = [Access::Uniform, Access::Read, Access::Read, Access::ReadWrite];
        let kernel = Kernel {
            fills: &[(MODULE, Fill::Caller(include_str!("refit.wesl")))],
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            ..Kernel::new(MODULE, "fit_level", &accesses, WORKGROUP)
        };
        Ok(Self {
            gpu: gpu.clone(),
            shape,
            // SAFETY: nodes, children and points that a plan reaches are those of the shape that the buffers were made of,
            // and the loop ends with a leaf's points.
            pipeline: unsafe { gpu.pipeline_unchecked(&kernel)? },
            nodes: gpu.upload("nodes of a level refit", &nodes)?,
            points: gpu.upload("points of a level refit", &points)?,
            boxes: gpu.buffer("boxes of a level refit", 2 * shape.n_nodes())?,
            plans: (0..=shape.depth()).rev().map(plan).collect::<Result<_>>()?,
            place_of,
        })
    }

    /// Records the refit from the leaves up.
    pub fn record(&self, commands: &mut Commands) {
        for (plan, n_nodes) in &self.plans {
            let bindings = [plan.into(), (&self.nodes).into(), (&self.points).into(), (&self.boxes).into()];
            commands.dispatch(&self.pipeline, &bindings, Workgroups::Covering(u64::from(*n_nodes)));
        }
    }

    /// The boxes in breadth-first order.
    ///
    /// # Errors
    /// `DeviceLost`, `OutOfDeviceMemory` for staging memory.
    pub fn boxes(&self) -> Result<Vec<NodeBox>> {
        let corners = self.gpu.read(&self.boxes)?;
        let corner = |at: usize| [corners[at][0], corners[at][1], corners[at][2]];
        let aabb = |&place: &u32| NodeBox { min: corner(2 * place as usize), max: corner(2 * place as usize + 1) };
        debug_assert_eq!(self.place_of.len(), self.shape.n_nodes());
        Ok(self.place_of.iter().map(aabb).collect())
    }
}

/// The numbers below `n` in random order, the same on every machine.
fn shuffled(n: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..n as u32).collect();
    let mut state = 7u64;
    for last in (1..n).rev() {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        order.swap(last, (state >> 33) as usize % (last + 1));
    }
    order
}

#[cfg(test)]
mod tests {
    use nearfield::gpu::shader::compose;
    use nearfield::gpu::wgpu::naga;

    use super::*;

    #[test]
    fn the_kernel_composes_and_validates() {
        let fills = [(MODULE, Fill::Caller(include_str!("refit.wesl")))];
        let wgsl = compose(MODULE, &fills, &[], false).expect("a shader");
        let parsed = naga::front::wgsl::parse_str(&wgsl).map_err(|e| e.emit_to_string(&wgsl)).expect("a shader");
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
            .validate(&parsed)
            .expect("a valid shader");
        assert_eq!(parsed.entry_points.len(), 1);
    }

    #[test]
    fn a_shuffle_holds_every_number_once_and_few_where_they_were() {
        let order = shuffled(5000);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted.iter().zip(0..).all(|(a, b)| *a == b));
        assert!(order.iter().zip(0..).filter(|(a, b)| **a == *b).count() < 20);
    }
}
