//! Answers that stay on the device.

use super::answers::{add_stages, record_counts, record_row_lengths};
use super::loops::{self, VisitorRounds};
use super::visit::{self, QueryBuffers, VisitorCode};
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, Commands, Kernel, Workgroups};
use crate::parallel::reduce::GpuReduce;
use crate::parallel::scan::GpuScan;
use crate::query::coherent::{EXTRACT, Extracted};
use crate::query::{FixedRadius, Report, RowOrder};
use crate::structure::GpuStructure;
use crate::{Error, Result};

/// Invocations of a workgroup that sorts rows.
const WORKGROUP: u32 = 64;

/// Neighbours of every query as compressed sparse rows, on the device.
#[derive(Debug)]
pub struct GpuNeighbors {
    /// `[q + 1]` monotone offsets in query order.
    pub offsets: Buffer<u32>,
    /// `[nnz]` indices into the points as the caller gave them.
    pub indices: Buffer<u32>,
    /// `[nnz]` squared distances, where asked for or needed for the order.
    pub dist2: Option<Buffer<f32>>,
    /// What ran.
    pub report: Report,
}

/// Rows as start and length on the device, in the order in which they were finished.
#[derive(Debug)]
pub struct GpuNeighborRows {
    /// `[q]` place of each query's row in `indices`.
    pub starts: Buffer<u32>,
    /// `[q]` length of each query's row.
    pub lengths: Buffer<u32>,
    /// `[nnz]` indices into the points as the caller gave them.
    pub indices: Buffer<u32>,
    /// What ran.
    pub report: Report,
}

pub(super) fn fill(distances: bool) -> VisitorCode<'static> {
    VisitorCode {
        source: Fill::Module("package::query::fill"),
        features: if distances { &[("distances", true)] } else { &[("distances", false)] },
        accesses: if distances {
            &[Access::Read, Access::ReadWrite, Access::ReadWrite]
        } else {
            &[Access::Read, Access::ReadWrite]
        },
        rounds: VisitorRounds::default(),
        combines: false,
    }
}

/// Whether the rows need distances on the device: for the answer, or to order them.
pub(super) fn needs_distances(question: &FixedRadius<'_>) -> bool {
    question.distances || question.order != RowOrder::Unspecified
}

/// Indices and squared distances of rows, where their offsets say.
pub(super) struct Rows {
    pub(super) indices: Buffer<u32>,
    pub(super) dist2: Option<Buffer<f32>>,
}

/// Records filling rows whose offsets are known, and bringing them into `order`, which is the question's or none.
pub(super) fn record_fill<S: GpuStructure>(
    commands: &mut Commands,
    structure: &S,
    question: &FixedRadius<'_>,
    order: RowOrder,
    queries: &QueryBuffers,
    (offsets, total): (&Buffer<u32>, usize),
) -> Result<Rows> {
    let gpu = structure.gpu();
    let distances = needs_distances(question);
    let indices = gpu.buffer("neighbour indices", total)?;
    let dist2 = distances.then(|| gpu.buffer("neighbour distances", total)).transpose()?;
    let mut binds: Vec<Bind> = vec![offsets.into(), (&indices).into()];
    binds.extend(dist2.as_ref().map(Bind::from));
    commands.stage("fill");
    visit::record(commands, structure, question, queries, &fill(distances), &binds)?;
    if let (Some(dist2), true) = (&dist2, order != RowOrder::Unspecified) {
        commands.stage("sort rows");
        let by_index = order == RowOrder::Index;
        let n_rows = gpu.uniform("row sort parameters", &[queries.len() as u32, 0, 0, 0])?;
        let kernel = Kernel {
            visitor_bindings: &[Access::ReadWrite, Access::ReadWrite],
            features: &[("by_index", by_index)],
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            ..Kernel::new("package::query::sort_rows", "sort_rows", &[Access::Uniform, Access::Read], WORKGROUP)
        };
        commands.dispatch_with_visitor(
            &gpu.prepare(&kernel)?,
            &[(&n_rows).into(), offsets.into()],
            &[(&indices).into(), dist2.into()],
            Workgroups::Covering(queries.len() as u64),
        );
    }
    Ok(Rows { indices, dist2 })
}

/// Fixed-radius search that leaves its answers on the device. Implemented for every GPU structure.
pub trait SearchOnDevice: GpuStructure {
    /// Number of neighbours of every query: `[q]` in query order.
    ///
    /// # Errors
    /// See [`FixedRadius::validate`]; `OutOfDeviceMemory`, `DeviceLost`.
    fn count_on_device(&self, question: &FixedRadius<'_>) -> Result<(Buffer<u32>, Report)>
    where
        Self: Sized,
    {
        question.validate(self.len())?;
        let queries = QueryBuffers::in_search_order(self, question)?;
        let counts = self.gpu().buffer("neighbour counts", question.len(self.len()))?;
        let mut report = visit::report(self, "thread-a-query", &["package::query::count"]);
        queries.add_stages_to(&mut report);
        let mut commands = self.gpu().commands("count neighbours");
        commands.stage("query");
        let pairs = record_counts(&mut commands, self, question, &queries, &counts)?;
        add_stages(&mut report, &commands.run()?);
        if let Some(pairs) = pairs {
            pairs.name_in(&mut report);
        }
        Ok((counts, report))
    }

    /// Neighbours of every query, in query order, with rows ordered as the question says.
    ///
    /// # Errors
    /// See [`FixedRadius::validate`]; `OutOfDeviceMemory` with the size where the list does not fit one binding;
    /// `Unsupported` with `max_neighbors`, which only the host's list has, and for ordered rows on a software renderer
    /// that are too long to be sorted there.
    fn list_on_device(&self, question: &FixedRadius<'_>) -> Result<GpuNeighbors>
    where
        Self: Sized,
    {
        question.validate(self.len())?;
        if question.max_neighbors.is_some() {
            return Err(Error::Unsupported {
                what: "max_neighbors with a list that stays on the device".into(),
                advice: "use `list`, or a visitor that keeps the nearest",
            });
        }
        list_on_device(self, question, |size| {
            if loops::can_sort(self.gpu(), size.longest_row) {
                return Ok(question.order);
            }
            let (longest, gpu) = (size.longest_row, self.gpu().name());
            Err(Error::Unsupported {
                what: format!("sorting a row of {longest} neighbours on {gpu}, which ends long loops,"),
                advice: "use `list`, which sorts on the host, leave the rows unsorted or use a smaller radius",
            })
        })
    }

    /// Neighbours of every query as rows of start and length, in no particular order: for those who need no offsets.
    /// The place of a row may differ from run to run; its contents do not.
    ///
    /// The question's order, cap and distances do not matter.
    ///
    /// # Errors
    /// As [`SearchOnDevice::list_on_device`]; `Unsupported` for structures without masks (brute force), and where the
    /// masks of all queries, 128 bytes each or 192 on the AABB-tree, do not fit one binding.
    fn list_rows_on_device(&self, question: &FixedRadius<'_>) -> Result<GpuNeighborRows>
    where
        Self: Sized,
    {
        question.validate(self.len())?;
        let plain = FixedRadius { distances: false, order: RowOrder::Unspecified, max_neighbors: None, ..*question };
        if self.coherent_tree().is_some() {
            return rows_of_list(self, &plain);
        }
        match super::row_masks::applies(self, &plain) {
            Some(ids) => super::row_masks::rows_on_device(self, ids, &plain),
            None => Err(Error::Unsupported {
                what: format!("rows in completion order from {} for {} queries", Self::NAME, plain.len(self.len())),
                advice: "use `list_on_device`, or fewer queries",
            }),
        }
    }
}

impl<S: GpuStructure> SearchOnDevice for S {}

/// A list whose rows are told by start and length.
fn rows_of_list<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<GpuNeighborRows> {
    let gpu = structure.gpu();
    let list = list_on_device(structure, question, |_| Ok(RowOrder::Unspecified))?;
    let n = list.offsets.len() - 1;
    let (starts, lengths) = (gpu.buffer("row starts", n)?, gpu.buffer("row lengths", n)?);
    let kernel = Kernel {
        constants: &[("WORKGROUP", f64::from(WORKGROUP))],
        ..Kernel::new(
            "package::query::split_offsets",
            "split_offsets",
            &[Access::Uniform, Access::Read, Access::ReadWrite, Access::ReadWrite],
            WORKGROUP,
        )
    };
    let n_rows = gpu.uniform("number of rows", &[n as u32, 0, 0, 0])?;
    let binds = [(&n_rows).into(), (&list.offsets).into(), (&starts).into(), (&lengths).into()];
    let mut commands = gpu.commands("starts and lengths of rows");
    commands.dispatch(&gpu.prepare(&kernel)?, &binds, Workgroups::Covering(n as u64));
    commands.submit()?;
    Ok(GpuNeighborRows { starts, lengths, indices: list.indices, report: list.report })
}

/// The report of a list by two passes, with the sort of its rows where the device orders them.
pub(super) fn report_two_passes<S: GpuStructure>(structure: &S, order: RowOrder) -> Report {
    let mut report = visit::report(structure, "two-pass", &["package::query::count", "package::query::fill"]);
    if order != RowOrder::Unspecified {
        report.kernels.push("package::query::sort_rows".to_owned());
    }
    report
}

/// Size of a list that is about to be filled.
#[derive(Debug, Clone, Copy)]
pub(super) struct ListSize {
    pub(super) entries: u64,
    /// 0 where it does not matter: rows stay unordered, or the device sorts rows of any length.
    pub(super) longest_row: u32,
}

/// By masks where they apply and fit beside the list, else by two passes: count and scan, then fill. `accept` sees the size before memory is taken for the entries, and says
/// which order the device gives the rows: that of the question, or none.
pub(super) fn list_on_device<S: GpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    mut accept: impl FnMut(ListSize) -> Result<RowOrder>,
) -> Result<GpuNeighbors> {
    if let Some(ids) = super::row_masks::applies(structure, question)
        && let Some(list) = super::row_masks::list_on_device(structure, ids, question, &mut accept)?
    {
        return Ok(list);
    }
    let gpu = structure.gpu();
    let n = question.len(structure.len());
    let queries = QueryBuffers::in_search_order(structure, question)?;
    let plain = !question.distances && question.order == RowOrder::Unspecified;
    if let Some(candidates) = queries.candidates().filter(|found| plain && found.can_extract()) {
        let size = |entries| ListSize { entries, longest_row: 0 };
        match candidates.extract(gpu, |entries| accept(size(entries)).map(drop)) {
            // Matches take 16 bytes until they are sorted; rows that are filled take 4.
            Err(Error::OutOfDeviceMemory { .. }) => {}
            extracted => {
                let Extracted { offsets, indices, stages } = extracted?;
                let mut report = visit::report(structure, "coherent", &[]);
                report.kernels.push(EXTRACT.to_owned());
                queries.add_stages_to(&mut report);
                add_stages(&mut report, &stages);
                return Ok(GpuNeighbors { offsets, indices, dist2: None, report });
            }
        }
    }
    let counts = gpu.buffer("neighbour counts", n)?;
    let offsets = gpu.buffer("row offsets", n + 1)?;
    let sum: Buffer<u64> = gpu.buffer("number of entries", 1)?;
    let needs_longest = gpu.limits().loop_rounds.is_some() && question.order != RowOrder::Unspecified;
    let longest: Option<Buffer<u32>> = needs_longest.then(|| gpu.buffer("longest row", 1)).transpose()?;
    let mut commands = gpu.commands("count neighbours");
    commands.stage("count");
    record_row_lengths(&mut commands, structure, question, &queries, &counts)?;
    commands.stage("scan");
    GpuScan::new(gpu, n)?.record(&mut commands, &counts, &offsets, n)?;
    let reduce = GpuReduce::new(gpu)?;
    reduce.record_sum(&mut commands, &counts, n, &sum)?;
    if let Some(longest) = &longest {
        reduce.record_largest(&mut commands, &counts, n, longest)?;
    }
    let sum = commands.read_back(&sum)?;
    let longest = longest.map(|longest| commands.read_back(&longest)).transpose()?;
    let times = commands.run()?;
    let total = sum.values()?[0];
    let longest_row = longest.map(|longest| longest.values()).transpose()?.map_or(0, |longest| longest[0]);
    let order = accept(ListSize { entries: total, longest_row })?;
    let mut report = report_two_passes(structure, order);
    queries.add_stages_to(&mut report);
    add_stages(&mut report, &times);
    let available = gpu.limits().binding_bytes;
    if total * 4 > available {
        return Err(Error::OutOfDeviceMemory { what: "neighbour indices".into(), needed: total * 4, available });
    }
    let mut commands = gpu.commands("fill rows");
    let rows = record_fill(&mut commands, structure, question, order, &queries, (&offsets, total as usize))?;
    add_stages(&mut report, &commands.run()?);
    Ok(GpuNeighbors { offsets, indices: rows.indices, dist2: rows.dist2, report })
}
