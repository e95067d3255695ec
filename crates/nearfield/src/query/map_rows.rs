//! A value for every query made of its row of neighbours, without a list of all rows.

use super::visit::for_each_query;
use super::{FixedRadius, RowOrder};
use crate::Result;
use crate::geometry::row_simd::{self, Hits, Simd};
use crate::structure::CpuStructure;

/// Computes a value from each row of neighbours; a row lives only while it is looked at.
///
/// Implemented for every CPU structure.
pub trait MapRows: CpuStructure {
    /// Calls `map(query, row)` once for every query, queries in parallel; returns what it made, `[q]` in the order of the queries.
    ///
    /// - `row`: indices of the neighbours; ascending with [`RowOrder::Index`], else in the order in which they were found. Its cap and
    ///   distances do not matter.
    ///
    /// ```
    /// use nearfield::query::MapRows;
    /// use nearfield::{FixedRadius, GridSettings, UniformGrid, Vec3};
    ///
    /// let points = [0.0, 1.0, 3.0].map(Vec3::splat);
    /// let grid = UniformGrid::build(&points, &GridSettings::for_radius(2.0))?;
    /// let means = grid.map_rows(&FixedRadius::new(2.0), |_, row| {
    ///     row.iter().map(|&i| points[i as usize].x).sum::<f32>() / row.len() as f32
    /// })?;
    /// assert_eq!(means, [0.5, 0.5, 3.0]);
    /// # Ok::<(), nearfield::Error>(())
    /// ```
    ///
    /// # Errors
    /// See [`FixedRadius::validate`].
    fn map_rows<T: Clone + Default + Send>(
        &self,
        question: &FixedRadius<'_>,
        map: impl Fn(u32, &[u32]) -> T + Sync,
    ) -> Result<Vec<T>>
    where
        Self: Sized,
    {
        question.validate(self.points().len())?;
        let (simd, points) = (Simd::best(), self.points());
        let start = |n| (Vec::with_capacity(n), Hits::default());
        let (tasks, _) = for_each_query(self, question, start, |(values, hits): &mut (Vec<_>, _), query| {
            hits.clear();
            row_simd::collect::<false>(simd, points, query.spans, &query.ball, hits);
            if question.exclude_self {
                hits.leave_out(query.id);
            }
            if question.order == RowOrder::Index {
                hits.ids.sort_unstable();
            }
            values.push((query.id, map(query.id, &hits.ids)));
            true
        })?;
        let mut in_order = vec![T::default(); question.len(points.len())];
        for (id, value) in tasks.into_iter().flat_map(|(values, _)| values) {
            in_order[id as usize] = value;
        }
        Ok(in_order)
    }
}

impl<S: CpuStructure> MapRows for S {}
