//! Lists of few points again and again: a plan that owns its memory and its recorded work, so that a list is one submission and one wait.
//!
//! With a structure a list takes a build, a count that is waited for, memory and a fill. For few points the waiting takes longer than the work: here all
//! pairs are tested, memory is that of the list before, and only where it does not suffice the work is run again. Cost: n² tests and n² / 8 bytes.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::on_device::GpuNeighbors;
use crate::geometry::validate;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, ReadBack, Recorded, Workgroups};
use crate::query::{FixedRadius, Neighbors, Queries, Radius, Report, RowOrder};
use crate::structure::{DevicePoint, device_point};
use crate::{Error, Result};

/// Invocations of a workgroup that finds neighbours, and points of one that writes rows: as in small_list.wesl.
const FIND_WORKGROUP: u32 = 128;
const WRITE_POINTS: u32 = 32;
/// Invocations of a workgroup that writes rows.
const WRITE_WORKGROUP: u32 = 256;
/// Neighbours a point that memory is taken for before the first list.
const FIRST_NEIGHBORS: usize = 64;
/// Invocations that are wanted at the same time: windows of candidates are as short as that asks for.
const INVOCATIONS: usize = 1 << 17;

/// `SmallList` in small_list.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct SmallList {
    /// Number of points.
    pub n_points: u32,
    /// Words of masks of a window of candidates.
    pub window_words: u32,
    /// Elements that the list has memory for.
    pub capacity: u32,
    /// 1 to leave out the point itself.
    pub exclude_self: u32,
    /// Squared radius.
    pub radius2: f32,
    /// Unused.
    pub padding_0: u32,
    /// Unused.
    pub padding_1: u32,
    /// Unused.
    pub padding_2: u32,
}

/// A plan for lists of up to 16,384 points: each point's neighbours among all, within one radius.
///
/// Rows are in the order of the points and ascending by index, which is a point's place. A list is one submission: its memory is kept from list to
/// list, and grows where a list does not fit. For more points, periods, other queries or radii of their own build a structure, as
/// [`crate::structure::GridBuilder`] does.
///
/// ```no_run
/// use nearfield::gpu::{DeviceChoice, Gpu};
/// use nearfield::{FixedRadius, GpuListPlan, Vec3};
///
/// let gpu = Gpu::open(&DeviceChoice::Gpu)?.expect("a GPU was asked for");
/// let mut points = vec![Vec3::ZERO; 8192];
/// let mut plan = GpuListPlan::new(&gpu, points.len(), &FixedRadius::new(0.1))?;
/// for _ in 0..100 {
///     points[0].x += 0.01;
///     let list = plan.list(&points)?;
///     println!("{} neighbours", list.indices().len());
/// }
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug)]
pub struct GpuListPlan {
    gpu: Gpu,
    parameters: SmallList,
    parameter_buffer: Buffer<SmallList>,
    points: Buffer<DevicePoint>,
    counts: Buffer<u32>,
    masks: Buffer<u32>,
    total: Buffer<u32>,
    /// The list on the device, with memory for as many neighbours as `parameters` say.
    offsets: Buffer<u32>,
    indices: Buffer<u32>,
    on_device: Option<Work>,
    to_host: Option<HostWork>,
    device_list: GpuNeighbors,
    host_list: Neighbors,
    host_offsets: Vec<u32>,
}

/// Recorded work and the number of neighbours that comes with it.
#[derive(Debug)]
struct Work {
    recorded: Recorded,
    total: ReadBack<u32>,
}

/// The same with the list itself.
#[derive(Debug)]
struct HostWork {
    work: Work,
    offsets: ReadBack<u32>,
    indices: ReadBack<u32>,
}

impl GpuListPlan {
    /// Most points of a plan: their masks take 32 MiB.
    pub const MOST_POINTS: usize = 1 << 14;

    /// A plan for lists of so many points as answer this question.
    ///
    /// # Errors
    /// `TooMany` above [`GpuListPlan::MOST_POINTS`]; `Unsupported` for other queries, radii of their own, a limit of neighbours or bytes, distances or an order by distance;
    /// `InvalidRadius`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn new(gpu: &Gpu, n_points: usize, question: &FixedRadius<'_>) -> Result<Self> {
        if n_points > Self::MOST_POINTS {
            let (found, limit) = (n_points as u64, Self::MOST_POINTS as u64);
            let advice = "build a grid of them and ask it for the list";
            return Err(Error::TooMany { what: "points of a plan for lists", found, limit, advice });
        }
        let radius = radius_of(question)?;
        let n_words = n_points.div_ceil(32);
        // Few candidates a window where points are few: all multiprocessors should have work.
        let windows = (INVOCATIONS / n_points.max(1)).clamp(1, n_words.max(1));
        let parameters = SmallList {
            n_points: n_points as u32,
            window_words: n_words.div_ceil(windows).max(1) as u32,
            capacity: (FIRST_NEIGHBORS * n_points).min(n_points * n_points) as u32,
            exclude_self: u32::from(question.exclude_self),
            radius2: radius * radius,
            padding_0: 0,
            padding_1: 0,
            padding_2: 0,
        };
        let offsets = gpu.upload("row offsets", &vec![0; n_points + 1])?;
        let indices: Buffer<u32> = gpu.buffer("neighbour indices", parameters.capacity as usize)?;
        let report = Report {
            structure: "brute-force",
            search: "small-list",
            device: gpu.name().to_owned(),
            kernels: ["find_neighbors", "write_rows"].map(|entry| format!("{MODULE}::{entry}")).to_vec(),
            batches: 1,
            ..Report::default()
        };
        let host_list = Neighbors { offsets: vec![0; n_points + 1], report: report.clone(), ..Neighbors::default() };
        let device_list = GpuNeighbors { offsets: offsets.clone(), indices: indices.first(0), dist2: None, report };
        Ok(Self {
            parameter_buffer: gpu.uniform("parameters of small lists", &parameters)?,
            points: gpu.upload("points", &vec![[0.0; 4]; n_points])?,
            counts: gpu.buffer("neighbour counts", n_points)?,
            masks: gpu.buffer("neighbour masks", n_points * n_words)?,
            total: gpu.buffer("number of entries", 1)?,
            offsets,
            indices,
            on_device: None,
            to_host: None,
            device_list,
            host_list,
            host_offsets: vec![0; n_points + 1],
            parameters,
            gpu: gpu.clone(),
        })
    }

    /// The points of the next list: xyz, the fourth value is not used. A caller's own kernels or copies may write to it; coordinates must be finite and
    /// within ±1e18.
    pub fn points(&self) -> &Buffer<DevicePoint> {
        &self.points
    }

    /// Makes later lists reach as far as this.
    ///
    /// # Errors
    /// `InvalidRadius`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn set_radius(&mut self, radius: f32) -> Result<()> {
        validate::radius(radius, None)?;
        self.set_parameters(SmallList { radius2: radius * radius, ..self.parameters })
    }

    /// The list of the points in [`GpuListPlan::points`], on the device. Its memory is that of the next list too.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` where it does not fit one binding or the device, `DeviceLost`.
    pub fn list_on_device(&mut self) -> Result<&GpuNeighbors> {
        let total = match self.parameters.n_points {
            0 => 0,
            _ => loop {
                if self.on_device.is_none() {
                    self.on_device = Some(self.record(|_| Ok(()))?.0);
                }
                // Work that failed is recorded anew, in case that its bindings could not be made.
                let ran = self.on_device.as_ref().expect("work should be recorded").run();
                let total = ran.inspect_err(|_| self.on_device = None)?;
                if self.holds(total)? {
                    break total;
                }
            },
        };
        self.device_list.offsets = self.offsets.clone();
        self.device_list.indices = self.indices.first(total as usize);
        Ok(&self.device_list)
    }

    /// The list of these points, on the host.
    ///
    /// # Errors
    /// `LengthMismatch` for another number of points, `NonFinite`, `CoordinateTooLarge`; `OutOfDeviceMemory`, `DeviceLost`.
    pub fn list(&mut self, points: &[Vec3]) -> Result<&Neighbors> {
        if points.len() != self.points.len() {
            let (found, expected) = (points.len() as u64, self.points.len() as u64);
            return Err(Error::LengthMismatch { what: "points of a plan for lists", found, expected });
        }
        validate::points(points)?;
        if points.is_empty() {
            return Ok(&self.host_list);
        }
        self.gpu.write_with(&self.points, device_point(points, 0))?;
        let total = loop {
            if self.to_host.is_none() {
                let (offsets, indices) = (self.offsets.clone(), self.indices.clone());
                let read = |commands: &mut Commands| Ok((commands.read_back(&offsets)?, commands.read_back(&indices)?));
                let (work, (offsets, indices)) = self.record(read)?;
                self.to_host = Some(HostWork { work, offsets, indices });
            }
            let ran = self.to_host.as_ref().expect("work should be recorded").work.run();
            let total = ran.inspect_err(|_| self.to_host = None)?;
            if self.holds(total)? {
                break total;
            }
        };
        let HostWork { offsets, indices, .. } = self.to_host.as_ref().expect("work should be recorded");
        offsets.take_into(&mut self.host_offsets)?;
        for (to, &from) in self.host_list.offsets.iter_mut().zip(&self.host_offsets) {
            *to = u64::from(from);
        }
        self.host_list.indices.resize(total as usize, 0);
        indices.take_into(&mut self.host_list.indices)?;
        Ok(&self.host_list)
    }

    /// Records the list, and with `more` what else is to come with it.
    fn record<T>(&self, more: impl FnOnce(&mut Commands) -> Result<T>) -> Result<(Work, T)> {
        let bindings: [Bind; 7] = [
            (&self.parameter_buffer).into(),
            (&self.points).into(),
            (&self.counts).into(),
            (&self.masks).into(),
            (&self.offsets).into(),
            (&self.indices).into(),
            (&self.total).into(),
        ];
        let n_words = self.parameters.n_points.div_ceil(32);
        let windows = n_words.div_ceil(self.parameters.window_words);
        let found = Workgroups::Count(windows * self.parameters.n_points.div_ceil(FIND_WORKGROUP));
        let written = Workgroups::Count(self.parameters.n_points.div_ceil(WRITE_POINTS));
        let mut commands = self.gpu.commands("small list");
        commands.clear(&self.counts);
        commands.dispatch(&self.gpu.prepare(&kernel("find_neighbors", FIND_WORKGROUP))?, &bindings, found);
        commands.dispatch(&self.gpu.prepare(&kernel("write_rows", WRITE_WORKGROUP))?, &bindings, written);
        let total = commands.read_back(&self.total)?;
        let more = more(&mut commands)?;
        Ok((Work { recorded: commands.record()?, total }, more))
    }

    /// Whether the memory holds a list of so many neighbours; if not, it does afterwards.
    fn holds(&mut self, total: u32) -> Result<bool> {
        if total <= self.parameters.capacity {
            return Ok(true);
        }
        // A quarter more, for points that go on to gather.
        let (most, n) = (self.gpu.limits().binding_bytes / 4, u64::from(self.parameters.n_points));
        let mut capacity = (u64::from(total) + u64::from(total) / 4).min(n * n).min(most.max(u64::from(total)));
        // The old memory makes way first; work that names it is recorded anew. Kernels never believe in memory that is not there.
        self.set_parameters(SmallList { capacity: 0, ..self.parameters })?;
        (self.on_device, self.to_host) = (None, None);
        self.indices = self.gpu.buffer("neighbour indices", 0)?;
        self.device_list.indices = self.indices.clone();
        self.indices = match self.gpu.buffer("neighbour indices", capacity as usize) {
            Err(Error::OutOfDeviceMemory { .. }) => {
                capacity = u64::from(total);
                self.gpu.buffer("neighbour indices", total as usize)?
            }
            made => made?,
        };
        self.set_parameters(SmallList { capacity: capacity as u32, ..self.parameters })?;
        Ok(false)
    }

    fn set_parameters(&mut self, parameters: SmallList) -> Result<()> {
        self.gpu.write(&self.parameter_buffer, 0, &[parameters])?;
        self.parameters = parameters;
        Ok(())
    }
}

impl Work {
    /// Runs it, and returns the number of neighbours.
    fn run(&self) -> Result<u32> {
        self.recorded.submit()?;
        let mut total = [0];
        self.total.take_into(&mut total)?;
        Ok(total[0])
    }
}

const MODULE: &str = "package::query::small_list";

fn kernel(entry: &'static str, workgroup: u32) -> Kernel<'static> {
    const BINDINGS: &[Access] = &[
        Access::Uniform,
        Access::Read,
        Access::ReadWrite,
        Access::ReadWrite,
        Access::ReadWrite,
        Access::ReadWrite,
        Access::ReadWrite,
    ];
    Kernel::new(MODULE, entry, BINDINGS, workgroup)
}

/// The radius of a question that a plan answers.
fn radius_of(question: &FixedRadius<'_>) -> Result<f32> {
    let plain = matches!(question.queries, Queries::Points)
        && question.max_neighbors.is_none()
        && !question.distances
        && question.max_bytes.is_none()
        && question.order != RowOrder::Distance;
    match question.radius {
        Radius::One(radius) if plain => {
            validate::radius(radius, None)?;
            Ok(radius)
        }
        _ => Err(Error::Unsupported {
            what: "other queries, radii of their own, limits, distances and an order by distance in a plan for lists"
                .into(),
            advice: "build a structure and ask it",
        }),
    }
}
