//! The methods that are compared, each behind the same trait: move, list, find the nearest.
//!
//! A method is a file with a function that makes it, and a line in [`ALL`].

pub mod aabb_tree;
pub mod kd_tree;
pub mod linear_octree;
pub mod lsh;
pub mod on_cpu;
pub mod on_gpu;
pub mod shifted_sort;
pub mod uniform_grid;

use nearfield::gpu::{Buffer, Gpu};
use nearfield::query::Stage;
use nearfield::structure::DevicePoint;
use nearfield::{GpuNeighbors, Nearest, Neighbors, Vec3};

use super::lab::Lab;
use crate::Result;
use crate::baselines::shifted_sort::ShiftedRows;
use crate::baselines::{KnnRows, RangeRows};
use crate::check::Expected;
use crate::device::device_points;

/// Points that are asked about, on both sides.
pub struct Positions {
    /// On the host.
    pub host: Vec<Vec3>,
    /// On the GPU, where there is one.
    pub device: Option<Buffer<DevicePoint>>,
}

impl Positions {
    /// Uploads them and waits until they are there, so that the copy is in no time that is measured.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn new(gpu: Option<&Gpu>, host: Vec<Vec3>) -> Result<Self> {
        let device = gpu.map(|gpu| gpu.upload("points that move", &device_points(&host))).transpose()?;
        if let (Some(gpu), Some(device)) = (gpu, &device) {
            gpu.read_range(device, 0..1)?;
        }
        Ok(Self { host, device })
    }

    /// Those on the GPU.
    pub(super) fn on_device(&self) -> &Buffer<DevicePoint> {
        self.device.as_ref().expect("methods of the GPU should be made where there is one")
    }
}

/// What a method is made for.
pub struct Start<'a> {
    /// The GPU; `None` only for methods of the CPU.
    pub gpu: Option<&'a Gpu>,
    /// The first positions.
    pub at: &'a Positions,
    /// The radius of the questions.
    pub radius: f32,
    /// Neighbours of a point within it.
    pub mean_neighbors: f64,
}

impl Start<'_> {
    /// The GPU of a method that needs one.
    pub(super) fn gpu(&self) -> &Gpu {
        self.gpu.expect("methods of the GPU should be made where there is one")
    }
}

/// What an update did.
pub struct Update {
    /// Its stages.
    pub stages: Vec<Stage>,
    /// Whether the structure was built anew.
    pub rebuilt: bool,
}

/// Lists as a method leaves them.
pub enum Found {
    /// On the device.
    OnDevice(GpuNeighbors),
    /// On the host.
    OnHost(Neighbors),
    /// Lists of a baseline on the host.
    Baseline {
        /// The lists.
        rows: RangeRows,
        /// Stages of the query.
        stages: Vec<Stage>,
        /// Whether none may be missing.
        is_exact: bool,
    },
    /// Rows of the nearest on the device, of which those within the radius are the answer.
    NearestRows {
        /// Places of a row.
        k: usize,
        /// Indices and squared distances.
        rows: ShiftedRows,
        /// The radius.
        radius: f32,
    },
}

impl Found {
    /// Stages of the query.
    pub fn stages(&self) -> &[Stage] {
        match self {
            Self::OnDevice(list) => &list.report.stages,
            Self::OnHost(list) => &list.report.stages,
            Self::Baseline { stages, .. } => stages,
            Self::NearestRows { rows, .. } => &rows.stages,
        }
    }

    /// Bytes of the answer.
    pub fn bytes(&self) -> u64 {
        match self {
            Self::OnDevice(list) => list.offsets.bytes() + list.indices.bytes(),
            Self::OnHost(list) => (size_of_val(list.offsets()) + size_of_val(list.indices())) as u64,
            Self::Baseline { rows, .. } => (size_of_val(&rows.offsets[..]) + size_of_val(&rows.ids[..])) as u64,
            Self::NearestRows { rows, .. } => rows.ids.bytes() + rows.dist2.bytes(),
        }
    }

    /// Checks the lists: those of an exact method in full, of another that they hold neighbours only.
    ///
    /// # Errors
    /// The first thing that is wrong; `DeviceLost`.
    pub fn check(&self, gpu: Option<&Gpu>, expected: &Expected) -> Result<Judged> {
        let gpu = || gpu.ok_or("lists on a device need the device to be checked");
        let exact = || Ok(Judged { recall: None, note: "every count checked, 100 rows by brute force" });
        let approximate = |recall| Ok(Judged { recall: Some(recall), note: "recall of 100 rows by brute force" });
        match self {
            Self::OnDevice(list) => {
                let offsets: Vec<u64> = gpu()?.read(&list.offsets)?.into_iter().map(u64::from).collect();
                expected.check_list(&offsets, &gpu()?.read(&list.indices)?)?;
                exact()
            }
            Self::OnHost(list) => {
                expected.check_list(list.offsets(), list.indices())?;
                exact()
            }
            Self::Baseline { rows, is_exact: true, .. } => {
                expected.check_list(&rows.offsets, &rows.ids)?;
                exact()
            }
            Self::Baseline { rows, .. } => approximate(expected.recall(&rows.offsets, &rows.ids)?),
            Self::NearestRows { k, rows, radius } => {
                let rows = KnnRows::new(*k, gpu()?.read(&rows.ids)?, gpu()?.read(&rows.dist2)?).within(*radius);
                approximate(expected.recall(&rows.offsets, &rows.ids)?)
            }
        }
    }
}

/// The nearest points of some places.
pub struct NearestFound {
    /// `[q]` indices; `u32::MAX` where there is none.
    pub indices: Vec<u32>,
    /// Stages of the query.
    pub stages: Vec<Stage>,
    /// Whether each must be the true one.
    pub is_exact: bool,
}

impl From<Nearest> for NearestFound {
    fn from(nearest: Nearest) -> Self {
        let stages = nearest.report.stages.clone();
        Self { indices: nearest.indices().to_vec(), stages, is_exact: true }
    }
}

/// Of the nearest of each place those within the radius.
fn nearest_within(ids: &[u32], dist2: &[f32], radius: f32) -> Vec<u32> {
    let within = |(&id, &d2): (&u32, &f32)| if d2 <= radius * radius { id } else { u32::MAX };
    ids.iter().zip(dist2).map(within).collect()
}

/// What a check found.
pub struct Judged {
    /// Of a method that may miss neighbours.
    pub recall: Option<f64>,
    /// How it was checked.
    pub note: &'static str,
}

/// A structure that follows moving points and answers; times are those of its calls, the device having finished.
pub trait Method {
    /// Brings the structure to these positions.
    ///
    /// # Errors
    /// What the structure returns.
    fn update(&mut self, at: &Positions) -> Result<Update>;

    /// Neighbours of every point, itself included.
    ///
    /// # Errors
    /// What the structure returns.
    fn list(&mut self, radius: f32) -> Result<Found>;

    /// Neighbours of other places.
    ///
    /// # Errors
    /// What the structure returns; `Unsupported` where the method is not asked for it.
    fn list_around(&mut self, _queries: &Positions, _radius: f32) -> Result<Found> {
        let what = "a search around other places by this baseline".to_owned();
        Err(nearfield::Error::Unsupported { what, advice: "it is measured by the lists of its own points" }.into())
    }

    /// The nearest point of other places, within the radius.
    ///
    /// # Errors
    /// As [`Method::list_around`].
    fn nearest_around(&mut self, _queries: &Positions, _radius: f32) -> Result<NearestFound> {
        let what = "a search for the nearest of other places by this baseline".to_owned();
        Err(nearfield::Error::Unsupported { what, advice: "it is measured by its lists" }.into())
    }

    /// The nearest other point of every point within the radius.
    ///
    /// # Errors
    /// What the structure returns; `Unsupported` where the method is not asked for it.
    fn nearest(&mut self, _radius: f32) -> Result<Nearest> {
        let what = "a search for the nearest point by this baseline".to_owned();
        Err(nearfield::Error::Unsupported { what, advice: "it is measured by its lists" }.into())
    }

    /// Bytes that the structure holds, points included.
    fn memory_bytes(&self) -> u64;
}

/// A method by name.
pub struct Plug {
    /// Name in rows and legends.
    pub name: &'static str,
    /// Whether the GPU does the work.
    pub on_gpu: bool,
    /// Number of its colour in plots.
    pub color: usize,
    /// Makes it with its structure built for the first positions.
    pub make: fn(&Start<'_>) -> Result<Box<dyn Method>>,
}

/// Every method; the paper's own first.
pub const ALL: &[Plug] = &[
    aabb_tree::COHERENT,
    aabb_tree::PRIMARY,
    aabb_tree::PACKED,
    aabb_tree::PACKED_NEVER,
    aabb_tree::PACKED_REBUILT,
    uniform_grid::ON_GPU,
    linear_octree::ON_GPU,
    shifted_sort::ON_GPU,
    lsh::ON_GPU,
    aabb_tree::ON_CPU,
    uniform_grid::ON_CPU,
    kd_tree::ON_CPU,
];

/// The methods that this machine can run.
pub fn possible(lab: &Lab) -> impl Iterator<Item = &'static Plug> {
    let has_gpu = lab.gpu().is_some();
    ALL.iter().filter(move |plug| has_gpu || !plug.on_gpu)
}
