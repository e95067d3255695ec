//! What a partition costs: work, surface and exchange of each part, and one curve against the other.

use glam::Vec3;

use super::{Exchange, Partition, exchange, surface};
use crate::curve::Curve;
use crate::structure::{LinearOctree, OctreeSettings};
use crate::{Error, Result};

/// What a partition costs.
#[derive(Debug, Clone, PartialEq)]
pub struct PartitionReport {
    /// The curve.
    pub curve: Curve,
    /// `[p]` the parts.
    pub parts: Vec<PartReport>,
    /// Largest over mean work.
    pub imbalance: f64,
}

/// What one part costs.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PartReport {
    /// Points.
    pub points: u64,
    /// Work, as the partition counts it.
    pub work: f64,
    /// Leaves with a point of the part. A leaf that the partition cuts counts to several parts.
    pub leaves: u64,
    /// Those of them that share a face, an edge or a corner with a leaf that holds a point of another part, or hold one
    /// themselves.
    pub surface: u64,
    /// Points sent to other parts, once for each of them; `None` if no exchange was asked for.
    pub sent: Option<u64>,
    /// Points received from other parts.
    pub received: Option<u64>,
    /// Bytes sent.
    pub bytes: Option<u64>,
}

impl PartitionReport {
    /// The sum over all parts.
    pub fn total(&self) -> PartReport {
        let add = |a: Option<u64>, b: Option<u64>| Some(a? + b?);
        self.parts
            .iter()
            .copied()
            .reduce(|a, b| PartReport {
                points: a.points + b.points,
                work: a.work + b.work,
                leaves: a.leaves + b.leaves,
                surface: a.surface + b.surface,
                sent: add(a.sent, b.sent),
                received: add(a.received, b.received),
                bytes: add(a.bytes, b.bytes),
            })
            .unwrap_or_default()
    }
}

impl Partition {
    /// Points, leaves, surface and exchange of each part, for the points of a tree: usually the one that was split.
    ///
    /// - `exchange`: `None` leaves out what is sent, which takes the most time
    ///
    /// # Errors
    /// `InvalidRadius`; `Unsupported` for a tree in a periodic space.
    pub fn report(&self, tree: &LinearOctree, exchange: Option<&Exchange>) -> Result<PartitionReport> {
        if tree.settings().period.is_periodic() {
            let advice = "measure the parts on a tree without period; images across the border are not counted";
            return Err(Error::Unsupported { what: "the surface of parts in a periodic space".to_owned(), advice });
        }
        exchange.map(Exchange::validate).transpose()?;
        let owners = surface::Owners::new(tree, self);
        let (leaves, surface) = surface::count_leaves(tree, &owners, self.parts());
        let mut points = vec![0; self.parts() as usize];
        for &owner in &owners.of_points {
            points[owner as usize] += 1;
        }
        let moved = exchange.map(|e| exchange::count_sent(tree, &owners, self.parts(), e.radius));
        let part = |i: usize| PartReport {
            points: points[i],
            work: self.work()[i],
            leaves: leaves[i],
            surface: surface[i],
            sent: moved.as_ref().map(|(sent, _)| sent[i]),
            received: moved.as_ref().map(|(_, received)| received[i]),
            bytes: moved.as_ref().zip(exchange).map(|((sent, _), e)| sent[i] * u64::from(e.bytes_per_point)),
        };
        let parts = (0..self.parts() as usize).map(part).collect();
        Ok(PartitionReport { curve: self.curve(), parts, imbalance: self.imbalance() })
    }
}

/// The same points split along Morton's and along Hilbert's curve, leaves weighted by their points.
///
/// - `settings`: of the tree; its curve does not matter
///
/// # Errors
/// As [`LinearOctree::build`], [`Partition::of_tree`] and [`Partition::report`].
pub fn compare_curves(
    points: &[Vec3],
    settings: &OctreeSettings,
    parts: u32,
    exchange: Option<&Exchange>,
) -> Result<[PartitionReport; 2]> {
    let report = |curve| {
        let tree = LinearOctree::build(points, &settings.curve(curve))?;
        Partition::of_tree(&tree, parts)?.report(&tree, exchange)
    };
    Ok([report(Curve::Morton)?, report(Curve::Hilbert)?])
}
