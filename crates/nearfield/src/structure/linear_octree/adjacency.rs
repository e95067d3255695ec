//! Leaves that touch each other: across faces, edges and corners.
//!
//! In whole cells of level 21: what overlaps a leaf's cells and one more on each side, and is not the leaf, touches it.
//! The kernels in `adjacency.wesl` are the twin of this file.

use rayon::prelude::*;

use super::walk::Step;
use super::{LinearOctree, OctreeNode};

/// How two leaves touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Contact {
    /// They share a part of a face.
    Face,
    /// They share a part of an edge, and no face.
    Edge,
    /// They share a corner alone.
    Corner,
}

/// The leaves that touch each leaf, as compressed sparse rows.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LeafNeighbors {
    /// `[n_leaves]` the leaves along the curve, by the number of their node.
    pub leaves: Vec<u32>,
    /// `[n_leaves + 1]` where the row of each leaf starts.
    pub offsets: Vec<u64>,
    /// Nodes of the touching leaves, along the curve within a row.
    pub nodes: Vec<u32>,
}

impl LeafNeighbors {
    /// The nodes that touch leaf number `leaf` along the curve.
    pub fn row(&self, leaf: usize) -> &[u32] {
        &self.nodes[self.offsets[leaf] as usize..self.offsets[leaf + 1] as usize]
    }
}

impl LinearOctree {
    /// The other leaves that share a face, an edge or a corner with this leaf, along the curve. Octants without points
    /// are no leaves; across the border of the domain there is nothing.
    ///
    /// # Panics
    /// If there is no node `leaf`.
    pub fn leaves_touching(&self, leaf: u32) -> Vec<u32> {
        let mut touching = vec![];
        self.any_leaf_touching(leaf, |other| {
            touching.push(other);
            false
        });
        touching
    }

    /// [`LinearOctree::leaves_touching`] for every leaf.
    pub fn leaf_neighbors(&self) -> LeafNeighbors {
        let leaves: Vec<u32> = self.leaves().collect();
        let rows: Vec<Vec<u32>> = leaves.par_iter().with_min_len(64).map(|&leaf| self.leaves_touching(leaf)).collect();
        let mut offsets = vec![0];
        offsets.extend(rows.iter().scan(0, |end, row| {
            *end += row.len() as u64;
            Some(*end)
        }));
        LeafNeighbors { leaves, offsets, nodes: rows.concat() }
    }

    /// How two nodes touch; `None` where they do not, or one contains the other.
    pub fn contact(&self, a: u32, b: u32) -> Option<Contact> {
        let (a, b) = (&self.nodes()[a as usize], &self.nodes()[b as usize]);
        let mut borders = 0;
        for axis in 0..3 {
            if a.low[axis] > b.high()[axis] + 1 || b.low[axis] > a.high()[axis] + 1 {
                return None;
            }
            borders += u32::from(a.low[axis] > b.high()[axis] || b.low[axis] > a.high()[axis]);
        }
        [None, Some(Contact::Face), Some(Contact::Edge), Some(Contact::Corner)][borders as usize]
    }

    /// Whether `test` holds for one of [`LinearOctree::leaves_touching`]; later ones are not tested.
    pub(crate) fn any_leaf_touching(&self, leaf: u32, mut test: impl FnMut(u32) -> bool) -> bool {
        let nodes = self.nodes();
        let (low, high) = (nodes[leaf as usize].low, nodes[leaf as usize].high());
        let (low, high) = (low.map(|c| c.saturating_sub(1)), high.map(|c| c + 1));
        let overlaps = |node: &OctreeNode| {
            let last = node.high();
            (0..3).all(|axis| node.low[axis] <= high[axis] && last[axis] >= low[axis])
        };
        let mut found = false;
        self.walk(|current, node| {
            if !overlaps(node) {
                return Step::Over;
            }
            found = node.is_leaf() && current != leaf && test(current);
            if found { Step::Stop } else { Step::Into }
        });
        found
    }
}

#[cfg(feature = "gpu")]
mod on_gpu {
    use super::LeafNeighbors;
    use crate::gpu::{Access, Buffer, Kernel, Workgroups};
    use crate::parallel::compact::GpuCompact;
    use crate::parallel::reduce::GpuReduce;
    use crate::parallel::scan::GpuScan;
    use crate::structure::linear_octree::GpuLinearOctree;
    use crate::{Error, Result};

    const WORKGROUP: u32 = 128;
    const MODULE: &str = "package::structure::linear_octree::adjacency";

    /// The leaves that touch each leaf, on the device.
    #[derive(Debug)]
    pub struct GpuLeafNeighbors {
        /// `[n_leaves]` the leaves along the curve, by the number of their node.
        pub leaves: Buffer<u32>,
        /// `[n_leaves + 1]` where the row of each leaf starts.
        pub offsets: Buffer<u32>,
        /// Nodes of the touching leaves, along the curve within a row.
        pub nodes: Buffer<u32>,
    }

    impl GpuLinearOctree {
        /// `[n_leaves]` the leaves along the curve.
        ///
        /// # Errors
        /// `OutOfDeviceMemory`, `DeviceLost`.
        pub fn leaves_on_device(&self) -> Result<Buffer<u32>> {
            use Access::{Read, ReadWrite, Uniform};
            let (gpu, n) = (&self.gpu, self.nodes.len());
            let flags = gpu.buffer("whether nodes in pre-order are leaves", n)?;
            let numbers: Buffer<u32> = gpu.buffer("leaves by number in pre-order", n)?;
            let count: Buffer<u32> = gpu.buffer("number of leaves", 1)?;
            let mut commands = gpu.commands("leaves");
            commands.dispatch(
                &gpu.prepare(&kernel("flag_leaves", &[Uniform, Read, Read, ReadWrite]))?,
                &[(&self.layout_buffer).into(), (&self.nodes).into(), (&self.pre_order).into(), (&flags).into()],
                Workgroups::Covering(n as u64),
            );
            GpuCompact::new(gpu, n)?.record(&mut commands, &flags, &numbers, &count, n)?;
            commands.submit()?;
            let n_leaves = gpu.read(&count)?[0] as usize;
            let leaves = gpu.buffer("leaves", n_leaves)?;
            let mut commands = gpu.commands("nodes of leaves");
            commands.dispatch(
                &gpu.prepare(&kernel("gather_leaves", &[Uniform, Read, Read, ReadWrite]))?,
                &[
                    (&gpu.uniform("leaf parameters", &[n_leaves as u32, 0, 0, 0])?).into(),
                    (&numbers).into(),
                    (&self.pre_order).into(),
                    (&leaves).into(),
                ],
                Workgroups::Covering(n_leaves as u64),
            );
            commands.submit()?;
            Ok(leaves)
        }

        /// As [`super::LinearOctree::leaf_neighbors`], with the same answer to the bit.
        ///
        /// # Errors
        /// As [`GpuLinearOctree::leaf_neighbors_on_device`].
        pub fn leaf_neighbors(&self) -> Result<LeafNeighbors> {
            let found = self.leaf_neighbors_on_device()?;
            Ok(LeafNeighbors {
                leaves: self.gpu.read(&found.leaves)?,
                offsets: self.gpu.read(&found.offsets)?.into_iter().map(u64::from).collect(),
                nodes: self.gpu.read(&found.nodes)?,
            })
        }

        /// The leaves that touch each leaf, left on the device.
        ///
        /// # Errors
        /// `Unsupported` on software renderers for trees of more than 60,000 nodes: they end the walk of a long loop;
        /// `OutOfDeviceMemory`, also where the rows do not fit one binding; `DeviceLost`.
        pub fn leaf_neighbors_on_device(&self) -> Result<GpuLeafNeighbors> {
            use Access::{Read, ReadWrite, Uniform};
            self.check_walk("walking to the leaves around each leaf")?;
            let gpu = &self.gpu;
            let leaves = self.leaves_on_device()?;
            let n = leaves.len();
            let counts: Buffer<u32> = gpu.buffer("leaves around leaves", n)?;
            let offsets: Buffer<u32> = gpu.buffer("rows of leaves", n + 1)?;
            let total: Buffer<u64> = gpu.buffer("number of contacts", 1)?;
            let parameters = gpu.uniform("leaf parameters", &[n as u32, 0, 0, 0])?;
            let covering = Workgroups::Covering(n as u64);
            let mut commands = gpu.commands("count leaves around leaves");
            let accesses = [Uniform, Uniform, Read, Read, ReadWrite, Read];
            commands.dispatch(
                &gpu.prepare(&kernel("count_touching", &accesses[..5]))?,
                &[
                    (&parameters).into(),
                    (&self.layout_buffer).into(),
                    (&self.nodes).into(),
                    (&leaves).into(),
                    (&counts).into(),
                ],
                covering.clone(),
            );
            GpuScan::new(gpu, n)?.record(&mut commands, &counts, &offsets, n)?;
            GpuReduce::new(gpu)?.record_sum(&mut commands, &counts, n, &total)?;
            commands.submit()?;
            let total = gpu.read(&total)?[0];
            let available = gpu.limits().binding_bytes;
            if 4 * total > available {
                return Err(Error::OutOfDeviceMemory {
                    what: "contacts of leaves".into(),
                    needed: 4 * total,
                    available,
                });
            }
            let nodes: Buffer<u32> = gpu.buffer("contacts of leaves", total as usize)?;
            let mut commands = gpu.commands("fill leaves around leaves");
            commands.dispatch(
                &gpu.prepare(&kernel("fill_touching", &accesses))?,
                &[
                    (&parameters).into(),
                    (&self.layout_buffer).into(),
                    (&self.nodes).into(),
                    (&leaves).into(),
                    (&nodes).into(),
                    (&offsets).into(),
                ],
                covering,
            );
            commands.submit()?;
            Ok(GpuLeafNeighbors { leaves, offsets, nodes })
        }

        /// Refuses walks that a device may end before they are done.
        pub(in crate::structure::linear_octree) fn check_walk(&self, what: &str) -> Result<()> {
            let Some(rounds) = self.gpu.limits().loop_rounds else { return Ok(()) };
            if self.nodes.len() <= rounds as usize {
                return Ok(());
            }
            let what = format!("{what} of {} nodes on {}, which ends long loops,", self.nodes.len(), self.gpu.name());
            Err(Error::Unsupported { what, advice: "use the CPU, or a coarser tree" })
        }
    }

    fn kernel<'a>(entry: &'a str, bindings: &'a [Access]) -> Kernel<'a> {
        const CONSTANTS: &[(&str, f64)] = &[("WORKGROUP", WORKGROUP as f64)];
        Kernel { constants: CONSTANTS, ..Kernel::new(MODULE, entry, bindings, WORKGROUP) }
    }
}

#[cfg(feature = "gpu")]
pub use on_gpu::GpuLeafNeighbors;
