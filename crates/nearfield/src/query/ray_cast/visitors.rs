//! What is done with the hits of a walk: one visitor a question.

use std::ops::ControlFlow;

use super::HitRecord;
use crate::geometry::{LocalHit, PreparedRay};
use crate::structure::HitVisitor;

/// Keeps the first hit.
pub(super) struct Closest {
    t_min: f32,
    t: f32,
    triangle: u32,
    weights: [f32; 2],
}

impl Closest {
    pub(super) fn new(ray: &PreparedRay) -> Self {
        Self { t_min: ray.t_min, t: ray.t_max, triangle: HitRecord::MISS, weights: [0.0; 2] }
    }

    pub(super) fn record(&self, ray: &PreparedRay) -> HitRecord {
        if self.triangle == HitRecord::MISS {
            return HitRecord::miss();
        }
        HitRecord { triangle: self.triangle, t: ray.caller_t(self.t), weights: self.weights }
    }
}

impl HitVisitor for Closest {
    fn limit(&self) -> f32 {
        self.t
    }

    fn offer(&mut self, hit: &LocalHit, _: f32) -> ControlFlow<()> {
        if hit.t >= self.t_min && hit.is_before(self.t, self.triangle) {
            (self.t, self.triangle, self.weights) = (hit.t, hit.triangle, hit.weights);
        }
        ControlFlow::Continue(())
    }
}

/// Stops at a hit.
pub(super) struct Any {
    t_min: f32,
    t_max: f32,
    pub(super) found: bool,
}

impl Any {
    pub(super) fn new(ray: &PreparedRay) -> Self {
        Self { t_min: ray.t_min, t_max: ray.t_max, found: false }
    }
}

impl HitVisitor for Any {
    fn limit(&self) -> f32 {
        self.t_max
    }

    fn offer(&mut self, hit: &LocalHit, _: f32) -> ControlFlow<()> {
        if (self.t_min..=self.t_max).contains(&hit.t) {
            self.found = true;
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    }
}

/// Counts all hits.
pub(super) struct Count {
    t_min: f32,
    t_max: f32,
    pub(super) count: u32,
}

impl Count {
    pub(super) fn new(ray: &PreparedRay) -> Self {
        Self { t_min: ray.t_min, t_max: ray.t_max, count: 0 }
    }
}

impl HitVisitor for Count {
    fn limit(&self) -> f32 {
        self.t_max
    }

    fn offer(&mut self, hit: &LocalHit, leave: f32) -> ControlFlow<()> {
        // A hit at `leave` or beyond comes again.
        if (self.t_min..=self.t_max).contains(&hit.t) && hit.t < leave {
            self.count += 1;
        }
        ControlFlow::Continue(())
    }
}

/// Gathers all hits.
pub(super) struct All<'a> {
    t_min: f32,
    t_max: f32,
    hits: &'a mut Vec<LocalHit>,
}

impl<'a> All<'a> {
    pub(super) fn new(ray: &PreparedRay, hits: &'a mut Vec<LocalHit>) -> Self {
        hits.clear();
        Self { t_min: ray.t_min, t_max: ray.t_max, hits }
    }
}

impl HitVisitor for All<'_> {
    fn limit(&self) -> f32 {
        self.t_max
    }

    fn offer(&mut self, hit: &LocalHit, leave: f32) -> ControlFlow<()> {
        if (self.t_min..=self.t_max).contains(&hit.t) && hit.t < leave {
            self.hits.push(*hit);
        }
        ControlFlow::Continue(())
    }
}
