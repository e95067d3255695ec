//! The answers to rays.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use crate::geometry::{PreparedTriangle, Ray};
use crate::query::Report;
use crate::structure::PreparedTriangles;
use crate::{Error, Result};

/// A hit in 16 bytes, the same on CPU and GPU.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct HitRecord {
    /// The caller's index of the triangle; [`HitRecord::MISS`] or [`HitRecord::INVALID`] where there is none.
    pub triangle: u32,
    /// In lengths of the ray's direction; infinite where there is no hit.
    pub t: f32,
    /// Weights of the second and third corner; that of the first is 1 − u − v.
    pub weights: [f32; 2],
}

impl HitRecord {
    /// Index that stands for "nothing was hit".
    pub const MISS: u32 = u32::MAX;
    /// Index that stands for "this ray cannot be cast".
    pub const INVALID: u32 = u32::MAX - 1;
    /// Index that stands for "the device ends loops before this ray was through": only in buffers on software devices,
    /// an error everywhere else.
    pub const ABANDONED: u32 = u32::MAX - 2;

    /// Nothing was hit.
    pub const fn miss() -> Self {
        Self { triangle: Self::MISS, t: f32::INFINITY, weights: [0.0; 2] }
    }

    /// The ray cannot be cast.
    pub const fn invalid() -> Self {
        Self { triangle: Self::INVALID, ..Self::miss() }
    }

    /// Whether a triangle was hit.
    pub const fn is_hit(&self) -> bool {
        self.triangle < Self::ABANDONED
    }
}

/// A hit in full.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayHit {
    /// The caller's index of the triangle.
    pub triangle: u32,
    /// In lengths of the ray's direction, from its origin.
    pub t: f32,
    /// Weights of the triangle's three corners; they sum up to 1.
    pub barycentrics: [f32; 3],
    /// The weighted corners, relative to the mesh's origin: on the triangle, more exact than `ray.at(t)`.
    pub position: Vec3,
    /// Unit normal of the triangle, towards the side from which its corners run counter-clockwise.
    pub normal: Vec3,
}

impl RayHit {
    /// A record with the place that it names.
    pub fn new(record: &HitRecord, triangle: &PreparedTriangle) -> Self {
        let [u, v] = record.weights;
        let barycentrics = [(1.0 - u - v).max(0.0), u, v];
        let [a, b, c] = triangle.callers_corners();
        Self {
            triangle: record.triangle,
            t: record.t,
            barycentrics,
            position: barycentrics[0] * a + u * b + v * c,
            normal: triangle.normal(),
        }
    }
}

/// Checks a single ray.
pub(super) fn check(ray: &Ray) -> Result<()> {
    ray.fault().map_or(Ok(()), |fault| Err(Error::InvalidRay { index: None, reason: fault.reason() }))
}

/// The first hit of each of many rays.
#[derive(Debug, Clone)]
pub struct Hits {
    pub(crate) records: Vec<HitRecord>,
    pub(crate) triangles: Arc<PreparedTriangles>,
    /// What ran.
    pub report: Report,
}

impl Hits {
    /// Number of rays.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Whether there is no ray.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// `[rays]` triangle, t and weights, as they come from the device.
    pub fn records(&self) -> &[HitRecord] {
        &self.records
    }

    /// What ray `i` hits first; `None` where it hits nothing or cannot be cast.
    ///
    /// # Panics
    /// If `i` is not below [`Hits::len`].
    pub fn hit(&self, i: usize) -> Option<RayHit> {
        let record = &self.records[i];
        record.is_hit().then(|| RayHit::new(record, &self.triangles.as_slice()[record.triangle as usize]))
    }

    /// Whether ray `i` could not be cast: a NaN, or no direction.
    ///
    /// # Panics
    /// If `i` is not below [`Hits::len`].
    pub fn is_invalid(&self, i: usize) -> bool {
        self.records[i].triangle == HitRecord::INVALID
    }

    /// How many rays hit something.
    pub fn n_hits(&self) -> usize {
        self.records.iter().filter(|record| record.is_hit()).count()
    }
}

/// Whether each of many rays hits anything.
#[derive(Debug, Clone, PartialEq)]
pub struct Occlusion {
    /// 0 for a miss, 1 for a hit, 2 for a ray that cannot be cast.
    pub(crate) states: Vec<u32>,
    /// What ran.
    pub report: Report,
}

impl Occlusion {
    /// Number of rays.
    pub fn len(&self) -> usize {
        self.states.len()
    }

    /// Whether there is no ray.
    pub fn is_empty(&self) -> bool {
        self.states.is_empty()
    }

    /// Whether ray `i` hits anything.
    ///
    /// # Panics
    /// If `i` is not below [`Occlusion::len`].
    pub fn is_hit(&self, i: usize) -> bool {
        self.states[i] == 1
    }

    /// Whether ray `i` could not be cast.
    ///
    /// # Panics
    /// If `i` is not below [`Occlusion::len`].
    pub fn is_invalid(&self, i: usize) -> bool {
        self.states[i] == 2
    }

    /// `[rays]` 0 for a miss, 1 for a hit, 2 for a ray that cannot be cast.
    pub fn as_slice(&self) -> &[u32] {
        &self.states
    }
}

/// How many hits each of many rays has.
#[derive(Debug, Clone, PartialEq)]
pub struct HitCounts {
    pub(crate) counts: Vec<u32>,
    /// What ran.
    pub report: Report,
}

impl HitCounts {
    /// `[rays]`; 0 for a ray that cannot be cast.
    pub fn as_slice(&self) -> &[u32] {
        &self.counts
    }
}

/// All hits of each of many rays, as compressed sparse rows in the order of the rays.
#[derive(Debug, Clone)]
pub struct HitLists {
    pub(crate) offsets: Vec<u64>,
    pub(crate) records: Vec<HitRecord>,
    pub(crate) triangles: Arc<PreparedTriangles>,
    /// What ran.
    pub report: Report,
}

impl HitLists {
    /// Number of rays.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Whether there is no ray.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// `[rays + 1]` where the hits of each ray begin.
    pub fn offsets(&self) -> &[u64] {
        &self.offsets
    }

    /// `[hits]` row after row.
    pub fn records(&self) -> &[HitRecord] {
        &self.records
    }

    /// Hits of ray `i`, ascending by t, ties by lowest triangle; none for a ray that cannot be cast.
    ///
    /// # Panics
    /// If `i` is not below [`HitLists::len`].
    pub fn row(&self, i: usize) -> &[HitRecord] {
        &self.records[self.offsets[i] as usize..self.offsets[i + 1] as usize]
    }

    /// Hits of ray `i` in full.
    ///
    /// # Panics
    /// If `i` is not below [`HitLists::len`].
    pub fn hits_of(&self, i: usize) -> impl Iterator<Item = RayHit> + '_ {
        let triangles = self.triangles.as_slice();
        self.row(i).iter().map(move |record| RayHit::new(record, &triangles[record.triangle as usize]))
    }
}
