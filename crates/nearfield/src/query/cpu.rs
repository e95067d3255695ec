//! Counts, the nearest neighbour and visits over any CPU structure; lists stand in `cpu_list`.

use std::ops::Range;
use std::time::Instant;

use super::cpu_list;
use super::visit::for_each_query;
use super::{Counts, FixedRadius, Nearest, Neighbor, NeighborSearch, Neighbors, Report, Stage};
use crate::Result;
use crate::geometry::row_simd::{self, Ball, Hits, Simd};
use crate::geometry::{Aabb, OrderedPoints};
use crate::structure::CpuStructure;

pub(super) fn device_name() -> String {
    format!("cpu ({} threads, {})", rayon::current_num_threads(), Simd::best().name())
}

pub(super) fn report<S: CpuStructure>(structure: &S, kernel: &str) -> Report {
    Report {
        structure: S::NAME,
        search: structure.search(),
        device: device_name(),
        kernels: vec![kernel.to_owned()],
        batches: 1,
        ..Report::default()
    }
}

impl<S: CpuStructure> NeighborSearch for S {
    fn structure(&self) -> &'static str {
        S::NAME
    }

    fn device(&self) -> String {
        device_name()
    }

    fn len(&self) -> usize {
        self.points().len()
    }

    fn memory_bytes(&self) -> u64 {
        CpuStructure::memory_bytes(self)
    }

    fn build_stages(&self) -> Vec<Stage> {
        CpuStructure::build_stages(self).iter().map(Stage::from).collect()
    }

    fn count(&self, question: &FixedRadius<'_>) -> Result<Counts> {
        question.validate(self.points().len())?;
        let start = Instant::now();
        let (simd, points) = (Simd::best(), self.points());
        let (tasks, mut visits) = for_each_query(self, question, Vec::with_capacity, |counts, query| {
            let count = row_simd::count(simd, points, query.spans, &query.ball);
            counts.push((query.id, count - u32::from(question.exclude_self)));
            true
        })?;
        let mut counts = vec![0; question.len(points.len())];
        for (id, count) in tasks.into_iter().flatten() {
            counts[id as usize] = count;
        }
        let mut report = report(self, "row_simd::count");
        visits.add_times(&mut report, start);
        Ok(Counts { counts, report })
    }

    fn list(&self, question: &FixedRadius<'_>) -> Result<Neighbors> {
        question.validate(self.points().len())?;
        cpu_list::list(self, question)
    }

    fn nearest(&self, question: &FixedRadius<'_>) -> Result<Nearest> {
        question.validate(self.points().len())?;
        let start = Instant::now();
        let (simd, points) = (Simd::best(), self.points());
        let (tasks, mut visits) = for_each_query(
            self,
            question,
            |n| (Vec::with_capacity(n), Hits::default()),
            |(found, hits), query| {
                hits.clear();
                row_simd::collect::<true>(simd, points, query.spans, &query.ball, hits);
                let nearest = hits
                    .iter()
                    .filter(|hit| !(question.exclude_self && hit.0 == query.id))
                    .min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
                found.push((query.id, nearest));
                true
            },
        )?;
        let n_queries = question.len(points.len());
        let (mut indices, mut dist2) = (vec![Nearest::NONE; n_queries], vec![f32::INFINITY; n_queries]);
        for (id, nearest) in tasks.into_iter().flat_map(|(found, _)| found) {
            if let Some((index, d2)) = nearest {
                indices[id as usize] = index;
                dist2[id as usize] = d2;
            }
        }
        let mut report = report(self, "row_simd::collect");
        visits.add_times(&mut report, start);
        Ok(Nearest { indices, dist2, report })
    }
}

/// Visits each neighbour with a closure that may stop early; no list is made.
///
/// Implemented for every CPU structure.
pub trait ForEachNeighbor: CpuStructure {
    /// Calls `visit(query, neighbor)` for every neighbour of every query, queries in parallel. `Break` ends the
    /// query's row, not the others. The order within a row is unspecified; the question's order, cap and distances
    /// do not matter.
    ///
    /// # Errors
    /// See [`FixedRadius::validate`].
    fn for_each(
        &self,
        question: &FixedRadius<'_>,
        visit: impl Fn(u32, Neighbor) -> std::ops::ControlFlow<()> + Sync,
    ) -> Result<()>
    where
        Self: Sized,
    {
        question.validate(self.points().len())?;
        for_each_query(
            self,
            question,
            |_| Hits::default(),
            |hits, query| {
                let own = question.exclude_self.then_some(query.id);
                visit_row(self.points(), query.spans, &query.ball, own, hits, |neighbor| visit(query.id, neighbor));
                true
            },
        )?;
        Ok(())
    }

    /// Calls `visit` for every point within `radius` of `center`, until it returns `Break`.
    ///
    /// # Errors
    /// `InvalidRadius`, `NonFinite`, `CoordinateTooLarge`.
    fn for_each_at(
        &self,
        center: glam::Vec3,
        radius: f32,
        visit: impl FnMut(Neighbor) -> std::ops::ControlFlow<()>,
    ) -> Result<()>
    where
        Self: Sized,
    {
        FixedRadius::new(radius).queries(&[center]).validate(self.points().len())?;
        let mut spans = Vec::new();
        self.spans_near(&Aabb::new(center, center), radius, &mut spans);
        let ball = Ball { center, radius2: radius * radius, period: self.period() };
        visit_row(self.points(), &spans, &ball, None, &mut Hits::default(), visit);
        Ok(())
    }
}

impl<S: CpuStructure> ForEachNeighbor for S {}

/// Candidates tested between two looks at whether the visitor wants more.
const VISIT_STEP: usize = 256;

fn visit_row(
    points: &OrderedPoints,
    spans: &[Range<usize>],
    ball: &Ball,
    own: Option<u32>,
    hits: &mut Hits,
    mut visit: impl FnMut(Neighbor) -> std::ops::ControlFlow<()>,
) {
    let simd = Simd::best();
    for span in spans {
        for start in span.clone().step_by(VISIT_STEP) {
            hits.clear();
            let step = start..span.end.min(start + VISIT_STEP);
            row_simd::collect::<true>(simd, points, std::slice::from_ref(&step), ball, hits);
            for (index, dist2) in hits.iter() {
                if own != Some(index) && visit(Neighbor { index, dist2 }).is_break() {
                    return;
                }
            }
        }
    }
}
