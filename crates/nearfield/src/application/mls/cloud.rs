//! The samples, as the fits of the CPU go through them, and what a fit gives.

use super::Weight;
use super::spread::{Sample, Spread};
use crate::application::PointFlags;
use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};
use crate::structure::AabbTreeN;

/// Samples with what belongs to them.
pub(super) struct Cloud<'a, T> {
    pub(super) tree: &'a AabbTreeN<T, 3>,
    /// `[n]` in the caller's order.
    pub(super) positions: &'a [Vector<T>],
    /// `[n]` of length 1, or 0 where a sample has none.
    pub(super) normals: Option<&'a [Vector<T>]>,
    /// `[n]` radii of the samples' own supports.
    pub(super) own_radii: Option<&'a [T]>,
    pub(super) weight: Weight,
}

/// A point on its way to the surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Query<T> {
    /// Where it began.
    pub(super) origin: Vector<T>,
    /// Where it is now.
    pub(super) at: Vector<T>,
    /// Its normal so far; 0 without.
    pub(super) normal: Vector<T>,
    /// Radius of the search.
    pub(super) radius: T,
    /// Radius that the bilateral weight falls over.
    pub(super) falloff: T,
}

/// The surface at a query.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fitted<T> {
    /// Where the query goes, and the normal there; `None` where there is no surface.
    pub(super) place: Option<(Vector<T>, Vector<T>)>,
    /// 1 / radius of the surface, where the method gives it.
    pub(super) curvature: T,
    pub(super) flags: PointFlags,
    pub(super) neighbors: u32,
    /// Distance to the mean of the neighbours, and mean radius of their supports.
    pub(super) mean_distance: T,
    pub(super) reach: T,
}

impl<T: Scalar> Fitted<T> {
    /// No surface.
    pub(super) fn none(flags: PointFlags, neighbors: u32) -> Self {
        let (curvature, reach) = (T::ZERO, T::ONE);
        Self { place: None, curvature, flags, neighbors, mean_distance: T::ZERO, reach }
    }

    /// A place on the surface, for a query whose samples are spread like this.
    pub(super) fn at(query: &Query<T>, spread: &Spread<T>, position: Vector<T>, normal: Vector<T>) -> Self {
        Self {
            place: Some((position, normal)),
            curvature: T::ZERO,
            flags: PointFlags::default(),
            neighbors: spread.count,
            mean_distance: vector::norm(spread.mean()) * query.radius,
            reach: spread.mean_reach() * query.radius,
        }
    }
}

impl<T: Scalar> Cloud<'_, T> {
    /// Calls `visit` for every sample whose support, or in whose support, `at` is, in the order of the tree.
    #[inline(always)]
    pub(super) fn for_each(&self, at: Vector<T>, radius: T, mut visit: impl FnMut(&Sample<T>)) {
        let inverse = T::ONE / radius;
        let inverse2 = inverse * inverse;
        self.tree.for_each_within(&at, radius, |index, dist2| {
            let index = index as usize;
            let offset = vector::scale(vector::subtract(self.positions[index], at), inverse);
            match self.own_radii {
                None => visit(&Sample { index, offset, y: (dist2 * inverse2).smaller(T::ONE), reach: T::ONE }),
                Some(radii) if dist2 <= radii[index] * radii[index] => {
                    let own = radii[index];
                    let y = (dist2 / (own * own)).smaller(T::ONE);
                    visit(&Sample { index, offset, y, reach: own * inverse });
                }
                Some(_) => {}
            }
        });
    }

    /// The same with the samples' normals, leaving out samples without one.
    #[inline(always)]
    pub(super) fn for_each_oriented(&self, at: Vector<T>, radius: T, mut visit: impl FnMut(&Sample<T>, Vector<T>)) {
        let normals = self.normals.expect("a method that needs normals should have been given them");
        self.for_each(at, radius, |sample| {
            let normal = normals[sample.index];
            if vector::norm2(normal) > T::ZERO {
                visit(sample, normal);
            }
        });
    }
}

/// The normal, or its opposite where that is nearer to `guide`.
pub(super) fn turned<T: Scalar>(normal: Vector<T>, guide: Vector<T>) -> Vector<T> {
    if vector::dot(normal, guide) < T::ZERO { vector::scale(normal, -T::ONE) } else { normal }
}
