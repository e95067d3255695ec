//! What is swept for a pack of queries, and what the kernels know of it. `sweep.wesl` is the twin of this file.

#[cfg(feature = "gpu")]
use bytemuck::{Pod, Zeroable};

use crate::geometry::Aabb;

/// Queries and the window of packs at hand, in the bytes of a uniform.
#[cfg(feature = "gpu")]
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Sweep {
    /// Number of queries.
    pub n_queries: u32,
    /// The caller's index that has slot 0.
    pub first_id: u32,
    /// Bit 0: each query has its own radius; bit 1: the query itself is left out.
    pub flags: u32,
    /// The radius where all have one.
    pub radius: f32,
    /// Number of packs of all windows.
    pub n_packs: u32,
    /// First pack of this window.
    pub first_pack: u32,
    /// End of the packs of this window.
    pub end_pack: u32,
    /// Candidates of this window.
    pub n_candidates: u32,
}

/// The box and the radius that are swept for queries within `queries`, the largest of whose radii is `radius`, and
/// whose leaf has the box `leaf`: definitions 2a and 2b of Xing2017.
///
/// Departure: where a query lies farther than `radius` from its leaf, on any axis, a sweep of the leaf by twice the radius
/// could miss neighbours. What is swept then is the box of the pack's queries, by the radius.
pub(super) fn swept(leaf: &Aabb, queries: &Aabb, radius: f32) -> (Aabb, f32) {
    if queries.min.cmpge(leaf.min).all() && queries.max.cmple(leaf.max).all() {
        return (*leaf, radius);
    }
    let outside = (leaf.min - queries.min).max(queries.max - leaf.max);
    if outside.max_element() <= radius { (*leaf, 2.0 * radius) } else { (*queries, radius) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn a_pack_inside_its_leaf_sweeps_the_radius_and_one_that_touches_it_twice_the_radius() {
        let leaf = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let at = |low: f32, high: f32| Aabb::new(Vec3::splat(low), Vec3::splat(high));
        assert_eq!(swept(&leaf, &at(0.0, 1.0), 0.25), (leaf, 0.25));
        assert_eq!(swept(&leaf, &at(-0.25, 0.5), 0.25), (leaf, 0.5));
        assert_eq!(swept(&leaf, &at(0.5, 1.25), 0.25), (leaf, 0.5));
        // Beyond the radius the leaf says nothing of where neighbours are.
        assert_eq!(swept(&leaf, &at(1.5, 1.75), 0.25), (at(1.5, 1.75), 0.25));
    }
}
