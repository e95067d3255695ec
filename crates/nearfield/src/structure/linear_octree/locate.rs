//! The smallest node that holds a point, on the CPU and on the GPU.
//!
//! Source: Ajmera2008, "location of the cell containing the queried point". Differs: empty cells are no nodes, so a
//! point in one gets the node around it. Both sides start at the deepest level on which every cell has a node, where
//! the number of the node is the key itself.

use glam::Vec3;
use rayon::prelude::*;

use super::LinearOctree;
use super::layout::NONE;
use crate::curve::{MAX_LEVEL, Octant};

impl LinearOctree {
    /// The smallest node whose octant holds the point: a leaf, or the inner node whose child there has no points.
    /// `None` for points outside the domain or not finite, and without points.
    pub fn locate_at(&self, point: Vec3) -> Option<u32> {
        if self.nodes().is_empty() || !self.domain().contains(point) {
            return None;
        }
        Some(self.descend(self.domain().key_of(self.curve(), point), MAX_LEVEL))
    }

    /// As [`LinearOctree::locate_at`] for many points, [`NONE`] for no node.
    pub fn locate(&self, points: &[Vec3]) -> Vec<u32> {
        points.par_iter().with_min_len(1 << 10).map(|&point| self.locate_at(point).unwrap_or(NONE)).collect()
    }

    /// The node of an octant; `None` where the tree has none.
    pub fn node_of(&self, octant: Octant) -> Option<u32> {
        let deepest = self.deepest_around(octant)?;
        (self.nodes()[deepest as usize].octant == octant).then_some(deepest)
    }

    /// The smallest node that contains the octant; `None` without points.
    pub fn deepest_around(&self, octant: Octant) -> Option<u32> {
        (!self.nodes().is_empty()).then(|| self.descend(octant.first_key(), octant.level()))
    }

    /// The smallest node on the way to a key, at most that deep.
    fn descend(&self, key: u64, most_levels: u32) -> u32 {
        let nodes = self.nodes();
        let full = full_level(&self.nodes.level_starts).min(most_levels);
        let mut node = self.nodes.level_starts[full as usize] + (key >> (3 * (MAX_LEVEL - full))) as u32;
        for level in full..most_levels {
            let index = (key >> (3 * (MAX_LEVEL - 1 - level)) & 7) as u32;
            match nodes[node as usize].child(index) {
                Some(child) => node = child,
                None => break,
            }
        }
        node
    }
}

/// The deepest level that has all of its nodes; 0 without nodes.
fn full_level(level_starts: &[u32]) -> u32 {
    let full = |(level, w): (usize, &[u32])| u64::from(w[1] - w[0]) == 1 << (3 * level);
    (level_starts.windows(2).enumerate().take_while(|&level| full(level)).count() as u32).saturating_sub(1)
}

#[cfg(feature = "gpu")]
mod on_gpu {
    use glam::Vec3;

    use super::{NONE, full_level};
    use crate::Result;
    use crate::curve::Curve;
    use crate::gpu::{Access, Buffer, Kernel, Workgroups};
    use crate::structure::linear_octree::GpuLinearOctree;
    use crate::structure::on_gpu::upload_points;
    use crate::structure::{BuildStage, DevicePoint};

    const WORKGROUP: u32 = 256;

    impl GpuLinearOctree {
        /// As [`super::LinearOctree::locate`], with the same answers to the bit; only where a point lies less than
        /// 1.2e-38 outside a face may a device that flushes such differences to zero find it inside.
        ///
        /// # Errors
        /// `OutOfDeviceMemory`, `DeviceLost`.
        pub fn locate(&self, asked: &[Vec3]) -> Result<Vec<u32>> {
            let points = upload_points(&self.gpu, "points to locate", asked, 0)?;
            let (nodes, _) = self.locate_on_device(&points)?;
            let mut nodes = self.gpu.read(&nodes)?;
            // What a device makes of comparisons with NaN is its own business.
            nodes.iter_mut().zip(asked).filter(|(_, point)| !point.is_finite()).for_each(|(node, _)| *node = NONE);
            Ok(nodes)
        }

        /// The smallest node of every point `[n]`, [`super::NONE`] for points outside the domain, and the time it took.
        ///
        /// # Errors
        /// `OutOfDeviceMemory`, `DeviceLost`.
        pub fn locate_on_device(&self, points: &Buffer<DevicePoint>) -> Result<(Buffer<u32>, Vec<BuildStage>)> {
            use Access::{Read, ReadWrite, Uniform};
            let kernel = Kernel {
                features: &[("hilbert", self.curve() == Curve::Hilbert)],
                constants: &[("WORKGROUP", f64::from(WORKGROUP))],
                ..Kernel::new(
                    "package::structure::linear_octree::locate",
                    "locate",
                    &[Uniform, Uniform, Read, Read, ReadWrite],
                    WORKGROUP,
                )
            };
            let full = full_level(&self.level_starts);
            let first = self.level_starts[full as usize];
            let parameters = self.gpu.uniform("locate parameters", &[points.len() as u32, full, first, 0])?;
            let located = self.gpu.buffer("nodes of points", points.len())?;
            let mut commands = self.gpu.commands("locate points");
            commands.stage("locate").dispatch(
                &self.gpu.prepare(&kernel)?,
                &[
                    (&parameters).into(),
                    (&self.layout_buffer).into(),
                    (&self.nodes).into(),
                    points.into(),
                    (&located).into(),
                ],
                Workgroups::Covering(points.len() as u64),
            );
            let stages = commands.run()?.iter().filter_map(BuildStage::on_device).collect();
            Ok((located, stages))
        }
    }
}
