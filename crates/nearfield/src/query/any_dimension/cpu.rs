//! Fixed-radius questions to a tree on the CPU: tasks of packs in parallel, each pack by the tree's search.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use rayon::prelude::*;

use super::query_set::QuerySet;
use super::rows::{self, Hits, TaskRows};
use super::{CountsN, FixedRadiusN, NeighborsN, SearchWork, coherent, packed, primary};
use crate::Result;
use crate::geometry::Scalar;
use crate::query::Report;
use crate::structure::{AabbTreeN, TreeSearch};

/// Queries of a task: enough to hide the cost of handing it out, few enough to balance uneven rows.
const TASK_QUERIES: usize = 512;

impl<T: Scalar, const D: usize> AabbTreeN<T, D> {
    /// Number of neighbours of every query.
    ///
    /// # Errors
    /// See [`FixedRadiusN::validate`].
    pub fn count(&self, question: &FixedRadiusN<'_, T, D>) -> Result<CountsN> {
        question.validate(self.len())?;
        let start = Instant::now();
        let (tasks, work) = find(self, question, false)?;
        let counts = rows::lengths(&tasks, question.queries.len(self.len()));
        let mut report = report(self.settings().search.name());
        report.host_stage("query", start);
        Ok(CountsN { counts, work, report })
    }

    /// Neighbours of every query, whichever search the tree is set to.
    ///
    /// # Errors
    /// See [`FixedRadiusN::validate`]; `OutOfMemory` where the answer would pass the question's limit or the memory of the
    /// host.
    pub fn list(&self, question: &FixedRadiusN<'_, T, D>) -> Result<NeighborsN<T>> {
        question.validate(self.len())?;
        let start = Instant::now();
        let (tasks, work) = find(self, question, true)?;
        let mut report = report(self.settings().search.name());
        report.host_stage("query", start);
        let start = Instant::now();
        let mut neighbors = rows::assemble(&tasks, question.queries.len(self.len()))?;
        rows::order_rows(&mut neighbors, question.order);
        report.host_stage("assemble", start);
        (neighbors.work, neighbors.report) = (work, report);
        Ok(neighbors)
    }
}

/// The rows of all tasks, or only their lengths.
fn find<T: Scalar, const D: usize>(
    tree: &AabbTreeN<T, D>,
    question: &FixedRadiusN<'_, T, D>,
    keeps: bool,
) -> Result<(Vec<TaskRows<T>>, SearchWork)> {
    let set = QuerySet::new(tree, question.queries, question.radius);
    let n_queries = question.queries.len(tree.len());
    let limit = if keeps { rows::entry_limit(question, n_queries) } else { u64::MAX };
    let entries = AtomicU64::new(0);
    let run = |task: std::ops::Range<usize>| {
        let (mut made, mut found) = (TaskRows::default(), Hits::new(keeps));
        let (mut candidates, mut asked) = (Vec::new(), Vec::new());
        for pack in &set.packs[task] {
            found.begin_pack(pack.places.len());
            match tree.settings().search {
                TreeSearch::Primary => primary::search(tree, question, &set.points, pack, &mut found),
                TreeSearch::Coherent => {
                    coherent::search(tree, question, &set.points, pack, (&mut candidates, &mut found));
                }
                TreeSearch::Packed => packed::search(tree, question, &set.points, pack, (&mut asked, &mut found)),
            }
            let before = made.len();
            made.finish_pack(&set.points.ids()[pack.places.clone()], &found);
            let added = (made.len() - before) as u64;
            if entries.fetch_add(added, Ordering::Relaxed) + added > limit {
                return None;
            }
        }
        Some((made, found.work))
    };
    let made: Option<Vec<_>> = set.tasks(TASK_QUERIES).into_par_iter().map(run).collect();
    let Some(made) = made else {
        // Tasks stop where the limit is passed; the error says how much would be needed.
        let counted = tree.count(question)?;
        let entries = counted.counts.iter().map(|&count| u64::from(count)).sum();
        return Err(rows::too_large(question, n_queries, entries));
    };
    let mut work = set.work();
    made.iter().for_each(|(_, done)| work += *done);
    Ok((made.into_iter().map(|(rows, _)| rows).collect(), work))
}

/// A report that names the search and the threads.
pub(super) fn report(search: &'static str) -> Report {
    Report {
        structure: "aabb-tree-n",
        search,
        device: format!("cpu ({} threads)", rayon::current_num_threads()),
        kernels: vec![format!("any_dimension::{search}")],
        batches: 1,
        ..Report::default()
    }
}
