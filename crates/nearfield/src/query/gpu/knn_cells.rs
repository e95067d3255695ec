//! The nearest points from a grid on the device: a ball as wide as the cells, and wider ones where that holds too few points.
//!
//! The grid's own points are searched in pairs first where that suits (`knn_pairs`); everything else, and what pairs leave, is
//! searched query by query (`knn_widening.wesl`). Source: the widening of shells of cells around a query is that of Bentley1980.
//! Differs: balls instead of shells, and their widths by what they hold.

use bytemuck::{Pod, Zeroable};

use super::knn::{NearestOnDevice, Rows};
use super::knn_boxes::{MOST_PLACES, size_features};
use super::knn_packs::LeftQueries;
use super::knn_pairs::NearestInPairs;
use super::loops::{self, VisitorRounds};
use super::visit::QueryBuffers;
use crate::Result;
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, Commands, Kernel, Workgroups};
use crate::parallel::reduce;
use crate::query::knn::EVERYWHERE;
use crate::query::{FixedRadius, Knn, Queries};
use crate::structure::{Effort, GpuStructure, GpuUniformGrid};

/// Invocations of a workgroup of the kernel.
const WORKGROUP: u32 = 64;

/// What balls are searched for.
const VISITOR: &str = "package::query::nearest_run";

/// Its loop rounds.
const ROUNDS: VisitorRounds = VisitorRounds { each: 0, finish: MOST_PLACES as u64 };

/// Smallest radius of a ball, unless a smaller one is asked for: its square is a normal number.
const SMALLEST: f32 = 1e-18;

/// Balls that double from the smallest to one that reaches everything, and a few more.
const MOST_BALLS: u32 = 128;

/// Bits of [`CellsRun::scans`], as in knn_cells.wesl: for the last ball, for balls that touch more rows of cells than are worth looking up, and
/// for the last ball of a query that asks for the nearest however far they are.
const LAST_IS_ALL: u32 = 1;
const WIDE_IS_ALL: u32 = 2;
const EVERYWHERE_IS_ALL: u32 = 4;

/// Devices that end long loops scan only where so many scans fit their rounds.
const FEWEST_SCANS: u64 = 8;

/// `CellsRun` in knn_cells.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct CellsRun {
    /// Number of queries.
    pub count: u32,
    /// The caller's index that has slot 0.
    pub first_id: u32,
    /// 1 to leave out the query itself.
    pub exclude_self: u32,
    /// 1 where each query has its own radius.
    pub own_radius: u32,
    /// The radius where all have one.
    pub radius: f32,
    /// Places of a row, at least 1.
    pub k: u32,
    /// Radius of the first balls, at most the largest radius of a query.
    pub reach: f32,
    /// Most balls of a query before the last one.
    pub balls: u32,
    /// When all points are tested instead of a ball: a bit for the last one, for those that touch many rows of cells, and for the last one of a
    /// query without a limit.
    pub scans: u32,
    /// First place of this run.
    pub first: u32,
    /// Most words that are kept of a pair.
    pub capacity: u32,
    /// No ball is searched with a smaller radius, unless it is asked for.
    pub smallest: f32,
}

/// Rows that are to be filled.
pub(super) struct InCells<'a> {
    pub(super) grid: &'a GpuUniformGrid,
    pub(super) within: &'a FixedRadius<'a>,
    pub(super) queries: &'a QueryBuffers,
    /// Places of a row, at least 1.
    pub(super) places: u32,
    rows: &'a Rows,
    balls: Balls,
}

impl InCells<'_> {
    /// Radius of the first balls.
    pub(super) fn reach(&self) -> f32 {
        reach(self.grid, self.within)
    }

    /// What kernels are asked in the first run, without pairs.
    pub(super) fn run(&self) -> CellsRun {
        let (own_radius, radius) = self.within.radius.parameters();
        CellsRun {
            count: self.queries.len() as u32,
            first_id: self.queries.first_id(),
            exclude_self: u32::from(self.within.exclude_self),
            own_radius,
            radius,
            k: self.places,
            reach: self.reach(),
            balls: self.balls.before_last,
            scans: self.balls.scans,
            first: 0,
            capacity: 0,
            smallest: SMALLEST,
        }
    }

    /// Conditions of kernels that fill the places of rows from `first` on.
    pub(super) fn features(&self, first: u32) -> Vec<(&'static str, bool)> {
        let mut features = vec![("fours", self.places.is_multiple_of(4))];
        features.extend(size_features((self.places - first).min(MOST_PLACES)));
        features
    }

    /// The rows, as kernels have them bound beside everything else.
    pub(super) fn row_binds(&self) -> [Bind; 2] {
        [(&self.rows.ids).into(), (&self.rows.dist2).into()]
    }

    /// Records balls that widen around all queries, or around those that pairs left, for the places of rows from `first` on.
    fn record(&self, commands: &mut Commands, first: u32, left: Option<&LeftQueries>) -> Result<()> {
        let gpu = self.grid.gpu();
        let run: Buffer<CellsRun> = gpu.uniform("nearest run", &CellsRun { first, ..self.run() })?;
        let mut accesses = vec![Access::Uniform, Access::Read, Access::Read];
        let mut binds: Vec<Bind> = vec![(&run).into(), self.queries.points().into(), self.queries.radii().into()];
        for (access, bind) in self.grid.bindings() {
            accesses.push(access);
            binds.push(bind);
        }
        if let Some(left) = left {
            accesses.extend([Access::Read; 2]);
            binds.extend(left.binds());
        }
        let mut features = self.grid.features();
        features.extend(["masks", "shared_queries", "all_points"].map(|name| (name, false)));
        features.extend([("listed", left.is_some()), ("short_loops", self.balls.short_loops)]);
        features.extend(self.features(first));
        let kernel = Kernel {
            visitor_bindings: &[Access::ReadWrite; 2],
            fills: &[("package::structure::visitor", Fill::Module(VISITOR))],
            features: &features,
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            ..Kernel::new(GpuUniformGrid::KERNEL, "widen_balls", &accesses, WORKGROUP)
        };
        let covering = Workgroups::Covering(self.queries.len() as u64);
        commands.dispatch_with_visitor(&gpu.prepare(&kernel)?, &binds, &self.row_binds(), covering);
        Ok(())
    }
}

impl NearestOnDevice for GpuUniformGrid {
    const NEAREST: &'static str = "nearest-cells";
    const KERNEL: &'static str = "package::query::knn_widening";

    fn record_nearest(
        &self,
        commands: &mut Commands,
        within: &FixedRadius<'_>,
        queries: &QueryBuffers,
        places: u32,
        rows: &Rows,
    ) -> Result<&'static [&'static str]> {
        let balls = Balls::of(self, within, places)?;
        let run = InCells { grid: self, within, queries, places, rows, balls };
        let Some(pairs) = NearestInPairs::suiting(&run)? else {
            for first in (0..places).step_by(MOST_PLACES as usize) {
                run.record(commands, first, None)?;
            }
            return Ok(&[]);
        };
        let left = pairs.record(commands, &run)?;
        commands.stage("widen");
        run.record(commands, 0, Some(&left))?;
        Ok(&NearestInPairs::KERNELS)
    }

    fn check_loops(&self, question: &Knn<'_>, places: usize) -> Result<()> {
        if places > 0 {
            Balls::of(self, &question.as_fixed_radius(), places as u32)?;
        }
        Ok(())
    }
}

/// Radius of the first balls: the reach of the cells, at most the largest that is asked for.
fn reach(grid: &GpuUniformGrid, within: &FixedRadius<'_>) -> f32 {
    grid.layout().reach().min(within.largest_radius())
}

/// How balls widen.
#[derive(Debug, Clone, Copy)]
struct Balls {
    /// Most balls of a query before the last one.
    before_last: u32,
    /// When all points are tested instead.
    scans: u32,
    short_loops: bool,
}

impl Balls {
    /// As ever where the device lets loops run; else as many balls as it has rounds for.
    ///
    /// # Errors
    /// `Unsupported` where the loops could be ended before the last ball is searched; `OutOfDeviceMemory`, `OutOfMemory`,
    /// `DeviceLost`.
    fn of(grid: &GpuUniformGrid, within: &FixedRadius<'_>, places: u32) -> Result<Self> {
        let (gpu, n, largest) = (grid.gpu(), GpuStructure::len(grid), within.largest_radius());
        let reaches_all = largest >= EVERYWHERE;
        let Some(limit) = gpu.limits().loop_rounds.filter(|_| within.len(n) > 0) else {
            let scans = WIDE_IS_ALL | if reaches_all { EVERYWHERE_IS_ALL } else { 0 };
            return Ok(Self { before_last: MOST_BALLS, scans, short_loops: false });
        };
        let queries = match within.queries {
            Queries::Points => None,
            Queries::Other(queries) => Some(reduce::bounds(queries)),
        };
        let rounds_of = |radius| -> Result<u64> {
            Ok(loops::rounds(grid.most_effort(radius, queries.as_ref())?, ROUNDS).saturating_add(1))
        };
        let all = loops::rounds(Effort { candidates: n as u64, rounds: 0 }, ROUNDS) + 1;
        let walk = if reaches_all { all } else { rounds_of(largest)? };
        let mut scans = if all <= walk { LAST_IS_ALL } else { 0 };
        // Of invocations in step some may be at their last ball, and others at one that is wide, whenever others go on.
        let mut last = walk.min(all);
        if FEWEST_SCANS * all <= u64::from(limit) {
            scans |= WIDE_IS_ALL;
            last += all;
        }
        let Some(mut left) = u64::from(limit).checked_sub(last) else {
            return Err(loops::too_long_for_nearest(grid, places as usize, limit, "use the CPU or fewer points"));
        };
        // No ball is wider than this: the first one may come widened from pairs, and later ones at most double.
        let mut before_last = 0;
        let mut radius = 2.0 * reach(grid, within).max(SMALLEST);
        while before_last < MOST_BALLS && radius < 2.0 * largest {
            let rounds = rounds_of(radius.min(largest))?.saturating_add(last);
            let Some(rest) = left.checked_sub(rounds) else { break };
            (left, radius, before_last) = (rest, 2.0 * radius, before_last + 1);
        }
        Ok(Self { before_last, scans, short_loops: ROUNDS.suits_short_loops() })
    }
}
