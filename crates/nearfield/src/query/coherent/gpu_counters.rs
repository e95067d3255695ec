//! Counters of searches on the device: the kernels count rounds, subgroups tell which lanes run in step.

use super::back_traverse::{Asking, Candidates, kernel};
use super::counters::{PhaseLanes, SearchCounters};
use super::primary::{self, Asked};
use crate::Result;
use crate::gpu::{Access, Buffer, Gpu, Workgroups};
use crate::query::{FixedRadius, Queries};
use crate::structure::{GpuAabbTree, GpuStructure};

/// Lanes that count as running in step where the device does not tell.
const IN_STEP: usize = 32;

/// The lanes of a kernel whose invocation i worked `rounds[i]` rounds.
fn lanes_of(gpu: &Gpu, name: &'static str, rounds: &Buffer<u32>) -> Result<PhaseLanes> {
    use Access::{Read, ReadWrite, Uniform};
    if gpu.limits().subgroup.is_none() {
        return Ok(PhaseLanes::of_rounds(name, &gpu.read(rounds)?, IN_STEP));
    }
    let taken: Buffer<u32> = gpu.buffer("rounds taken", rounds.len())?;
    let count = gpu.uniform("number of invocations", &[rounds.len() as u32, 0, 0, 0])?;
    let module = "package::query::coherent::active_lanes";
    let active_lanes = kernel(gpu, (module, "active_lanes"), &[Uniform, Read, ReadWrite], &[])?;
    let mut commands = gpu.commands("active lanes");
    let binds = [(&count).into(), rounds.into(), (&taken).into()];
    commands.dispatch(&active_lanes, &binds, Workgroups::Covering(rounds.len() as u64));
    commands.submit()?;
    let sum = |values: Vec<u32>| values.into_iter().map(u64::from).sum();
    Ok(PhaseLanes { name, worked: sum(gpu.read(rounds)?), taken: sum(gpu.read(&taken)?) })
}

impl GpuAabbTree {
    /// Counts what a coherent search does for this question, whatever search is set.
    ///
    /// Lanes in step are those of the device's subgroups, or 32 side by side where it has no subgroup operations. A round of
    /// "pack" goes down a level of the tree (none where the points ask), of "traverse" looks at a node, of "extract" tests a
    /// query. The question's order, cap and distances do not matter.
    ///
    /// # Errors
    /// See [`FixedRadius::validate`]; `Unsupported` for trees too large for a device that ends long loops;
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn coherent_counters(&self, question: &FixedRadius<'_>) -> Result<SearchCounters> {
        question.validate(GpuStructure::len(self))?;
        let gpu = GpuStructure::gpu(self);
        let n = question.len(GpuStructure::len(self));
        let Asked { queries, radii, own } = Asked::upload(self, question)?;
        let asking = Asking { queries: &queries, radii: &radii, first_id: 0, own };
        let (found, visited) = Candidates::find_counted(self, question, asking, true)?;
        let mut counters = SearchCounters { queries: n as u64, candidates: found.total, ..SearchCounters::default() };
        let Some(visited) = visited else { return Ok(counters) };
        let in_step = gpu.limits().subgroup.map_or(IN_STEP, |(_, largest)| largest as usize);
        let down = match question.queries {
            Queries::Points => Vec::new(),
            Queries::Other(_) => vec![self.shape().depth(); n],
        };
        counters.phases.push(PhaseLanes::of_rounds("pack", &down, in_step));
        counters.traversals = visited.len() as u64;
        let traverse = lanes_of(gpu, "traverse", &visited)?;
        counters.nodes_visited = traverse.worked;
        counters.phases.push(traverse);
        let mut extract = PhaseLanes { name: "extract", worked: 0, taken: 0 };
        for window in &found.windows {
            let mut commands = gpu.commands("candidates of a window");
            found.record_window(&mut commands, window)?;
            commands.submit()?;
            let matches = found.count_matches(gpu, window, true)?;
            counters.neighbors += matches.total;
            if let Some(tests) = &matches.tests {
                let lanes = lanes_of(gpu, "extract", tests)?;
                extract.worked += lanes.worked;
                extract.taken += lanes.taken;
            }
        }
        counters.tests = extract.worked;
        counters.phases.push(extract);
        Ok(counters)
    }

    /// Counts what a search by one traversal a query does for this question, whatever search is set: its one phase is
    /// "search", a round of which goes down a level, looks at a node or tests eight points. With `invocations` the load is
    /// balanced, as in [`GpuAabbTree::count_primary`].
    ///
    /// # Errors
    /// As [`GpuAabbTree::coherent_counters`]; `Unsupported` also where a device that ends long loops would need more than
    /// one run.
    pub fn primary_counters(&self, question: &FixedRadius<'_>, invocations: Option<u32>) -> Result<SearchCounters> {
        question.validate(GpuStructure::len(self))?;
        let gpu = GpuStructure::gpu(self);
        let n = question.len(GpuStructure::len(self)) as u64;
        let mut counters = SearchCounters { queries: n, traversals: n, ..SearchCounters::default() };
        if n == 0 || GpuStructure::is_empty(self) {
            return Ok(counters);
        }
        let found = primary::run(self, question, &Asked::upload(self, question)?, invocations, true)?;
        let work = match &found.work {
            Some(work) => gpu.read(work)?,
            None => Vec::new(),
        };
        // Without balancing there are no more invocations than queries with work.
        let lanes = if invocations.is_some() { work.len() } else { n as usize };
        let work = &work[..lanes];
        let sum = |part: usize| work.iter().map(|w| u64::from(w[part])).sum();
        counters.nodes_visited = sum(1);
        counters.tests = sum(2);
        counters.neighbors = gpu.read(&found.counts)?.iter().map(|&c| u64::from(c)).sum();
        let rounds: Vec<u32> = work.iter().map(|w| w[0]).collect();
        counters.phases.push(lanes_of(gpu, "search", &gpu.upload("rounds of invocations", &rounds)?)?);
        Ok(counters)
    }
}
