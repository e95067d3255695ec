//! Brute force on the CPU.

use std::ops::Range;
use std::time::Instant;

use glam::Vec3;

use super::PACK;
use crate::Result;
use crate::geometry::{Aabb, OrderedPoints, Period, validate};
use crate::structure::{BuildStage, CpuStructure, Packed};

/// All points as they came, on the CPU.
#[derive(Debug, Clone)]
pub struct BruteForce {
    points: OrderedPoints,
    period: Period,
    packs: Vec<u32>,
    stages: Vec<BuildStage>,
}

impl BruteForce {
    /// Copies the points.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`; `TooMany` for 2³² − 1 points or more.
    pub fn build(points: &[Vec3]) -> Result<Self> {
        Self::build_periodic(points, Period::NONE)
    }

    /// Copies the points of a periodic domain.
    ///
    /// # Errors
    /// As [`BruteForce::build`].
    pub fn build_periodic(points: &[Vec3], period: Period) -> Result<Self> {
        let start = Instant::now();
        validate::points(points)?;
        let order: Vec<u32> = (0..points.len() as u32).collect();
        let points = OrderedPoints::gather(points, &order);
        let packs = runs(points.len());
        Ok(Self { points, period, packs, stages: vec![BuildStage::on_host("copy", start)] })
    }
}

fn runs(n: usize) -> Vec<u32> {
    (0..n).step_by(PACK).chain([n]).map(|i| i as u32).collect()
}

impl CpuStructure for BruteForce {
    const NAME: &'static str = "brute-force";

    fn search(&self) -> &'static str {
        "all-pairs"
    }

    fn points(&self) -> &OrderedPoints {
        &self.points
    }

    fn period(&self) -> Period {
        self.period
    }

    fn packs(&self) -> &[u32] {
        &self.packs
    }

    fn pack_queries(&self, queries: &[Vec3]) -> Result<Packed> {
        Ok(Packed { order: (0..queries.len() as u32).collect(), packs: runs(queries.len()) })
    }

    fn spans_near(&self, _: &Aabb, _: f32, spans: &mut Vec<Range<usize>>) {
        spans.push(0..self.points.len());
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        self.points.memory_bytes() + 4 * self.packs.len() as u64
    }
}
