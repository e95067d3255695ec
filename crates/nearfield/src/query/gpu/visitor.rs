//! A caller's own WGSL on each neighbour: sums and minima without a list, early exit.

use super::answers::add_stages;
use super::device_queries::{self, DeviceQueries};
use super::loops::VisitorRounds;
use super::visit::{self, QueryBuffers, VisitorCode};
use crate::Result;
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Commands};
use crate::query::{FixedRadius, Report};
use crate::structure::GpuStructure;

/// A caller's code and buffers.
///
/// The source is a WGSL module with a `State` and three functions:
///
/// ```wgsl
/// import package::structure::question::{Query, Neighbor};
///
/// @group(1) @binding(0) var<storage, read_write> sums: array<f32>;
///
/// struct State { sum: f32 }
///
/// fn begin(query: Query) -> State { return State(0.0); }
///
/// fn visit(state: ptr<function, State>, query: Query, neighbor: Neighbor) -> bool {
///     (*state).sum += sqrt(neighbor.dist2);
///     return true; // false ends the row of this query
/// }
///
/// fn finish(state: ptr<function, State>, query: Query) { sums[query.slot] = (*state).sum; }
/// ```
///
/// Where queries are few, up to eight invocations may share each, if the module also has
///
/// ```wgsl
/// fn combine(state: ptr<function, State>, other: State) { (*state).sum += other.sum; }
/// ```
///
/// Each begins with a state of its own and visits some of the neighbours; `finish` runs once and gets all states combined, in no particular order
/// or grouping, so sums of floats depend on the number of queries and on the device. `begin` runs once for each invocation: it must not write, and
/// what it adds to a sum `combine` has to take off. `false` ends only the part of the invocation that gives it. 128 states stand in the
/// memory of a workgroup, of which devices have 16 KiB and more: one that does not fit is `Unsupported`.
///
/// `Query` has `position`, `radius`, `radius2`, `id` and `slot`, the place of the query's answer, which is its index;
/// `Neighbor` has `id`, `dist2` and `difference` (query minus neighbour, to the nearest image).
/// Bindings are `@group(1)`, numbered from 0. The module is compiled with run-time checks. Software renderers end the
/// loops of an invocation after some 65,000 rounds in all, without a word: there, avoid loops in `visit`.
#[derive(Debug, Clone, Copy)]
pub struct Visitor<'a> {
    /// The module.
    pub source: &'a str,
    /// Its bindings, in order.
    pub bindings: &'a [(Access, Bind)],
    /// Whether it also has `combine`, which adds to a state what another one has met.
    pub combines: bool,
}

impl<'a> Visitor<'a> {
    /// One without `combine`.
    pub fn new(source: &'a str, bindings: &'a [(Access, Bind)]) -> Self {
        Self { source, bindings, combines: false }
    }

    /// One with `combine`.
    pub fn combining(source: &'a str, bindings: &'a [(Access, Bind)]) -> Self {
        Self { source, bindings, combines: true }
    }

    /// What the query kernel is told of it; `accesses` are those of its bindings.
    pub(super) fn code<'b>(&'b self, accesses: &'b [Access]) -> VisitorCode<'b> {
        VisitorCode {
            source: Fill::Caller(self.source),
            features: &[],
            accesses,
            rounds: VisitorRounds::default(),
            combines: self.combines,
        }
    }
}

/// Runs visitors. Implemented for every GPU structure.
pub trait ForEachOnDevice: GpuStructure {
    /// Runs `visitor` on every neighbour of every query, one invocation a query or a few that share it, and waits for it.
    ///
    /// The question's order, cap and distances do not matter.
    ///
    /// # Errors
    /// See [`FixedRadius::validate`]; `KernelRejected` with the compiler's message; `OutOfDeviceMemory`, `DeviceLost`.
    fn for_each_on_device(&self, question: &FixedRadius<'_>, visitor: &Visitor<'_>) -> Result<Report>
    where
        Self: Sized,
    {
        question.validate(self.len())?;
        let accesses: Vec<Access> = visitor.bindings.iter().map(|(access, _)| *access).collect();
        let binds: Vec<Bind> = visitor.bindings.iter().map(|(_, bind)| bind.clone()).collect();
        let code = visitor.code(&accesses);
        let queries = QueryBuffers::in_search_order(self, question)?;
        let mut report = visit::report(self, "thread-a-query", &["the caller's visitor"]);
        queries.add_stages_to(&mut report);
        let mut commands = self.gpu().commands("run a visitor");
        commands.stage("query");
        visit::record(&mut commands, self, question, &queries, &code, &binds)?;
        add_stages(&mut report, &commands.run()?);
        Ok(report)
    }

    /// Records `visitor` over queries that are on the device; nothing runs before the commands are submitted. A coherent
    /// search of the AABB-tree finds its candidates before it returns, so the queries must have been written by then.
    ///
    /// # Errors
    /// `InvalidRadius`; `LengthMismatch` with fewer radii than queries; `KernelRejected` with the compiler's message;
    /// `Unsupported` where the device would end the kernel's loops; `OutOfDeviceMemory`, `DeviceLost`.
    fn record_for_each(&self, commands: &mut Commands, queries: &DeviceQueries<'_>, visitor: &Visitor<'_>) -> Result<()>
    where
        Self: Sized,
    {
        device_queries::record_caller(commands, self, queries, visitor)
    }
}

impl<S: GpuStructure> ForEachOnDevice for S {}
