//! The methods that are compared, each behind the same trait: move, list, find the nearest.
//!
//! A method is a file with a function that makes it, and a line in [`ALL`].

pub mod aabb_tree;
pub mod linear_octree;
pub mod on_cpu;
pub mod on_gpu;
pub mod uniform_grid;

use nearfield::gpu::{Buffer, Gpu};
use nearfield::query::Stage;
use nearfield::structure::DevicePoint;
use nearfield::{GpuNeighbors, Nearest, Neighbors, Vec3};

use super::lab::Lab;
use crate::check::Expected;
use crate::device::device_points;
use crate::Result;

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
}

impl Found {
    /// Stages of the query.
    pub fn stages(&self) -> &[Stage] {
        match self {
            Self::OnDevice(list) => &list.report.stages,
            Self::OnHost(list) => &list.report.stages,
        }
    }

    /// Bytes of the answer.
    pub fn bytes(&self) -> u64 {
        match self {
            Self::OnDevice(list) => list.offsets.bytes() + list.indices.bytes(),
            Self::OnHost(list) => (size_of_val(list.offsets()) + size_of_val(list.indices())) as u64,
        }
    }

    /// Checks the lists of an exact method, and returns their mean length.
    ///
    /// # Errors
    /// The first thing that is wrong; `DeviceLost`.
    pub fn check(&self, gpu: Option<&Gpu>, expected: &Expected) -> Result<Judged> {
        match (self, gpu) {
            (Self::OnDevice(list), Some(gpu)) => {
                let offsets: Vec<u64> = gpu.read(&list.offsets)?.into_iter().map(u64::from).collect();
                expected.check_list(&offsets, &gpu.read(&list.indices)?)?;
            }
            (Self::OnHost(list), _) => expected.check_list(list.offsets(), list.indices())?,
            (Self::OnDevice(_), None) => return Err("a list on a device needs the device to be checked".into()),
        }
        Ok(Judged { recall: None, note: "every count checked, 100 rows by brute force" })
    }
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

    /// The nearest other point of every point within the radius.
    ///
    /// # Errors
    /// What the structure returns; `Unsupported` where the method has no such search.
    fn nearest(&mut self, radius: f32) -> Result<Nearest>;

    /// Bytes that the structure holds, points included.
    fn memory_bytes(&self) -> u64;

    /// What should stand beside the times.
    fn note(&self) -> String {
        String::new()
    }
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

/// Every method.
pub const ALL: &[Plug] = &[
    aabb_tree::PACKED_REFIT,
    aabb_tree::PACKED_REBUILT,
    aabb_tree::PRIMARY_REFIT,
    uniform_grid::ON_GPU,
    linear_octree::ON_GPU,
    aabb_tree::ON_CPU,
    uniform_grid::ON_CPU,
];

/// The methods that this machine can run.
pub fn possible(lab: &Lab) -> impl Iterator<Item = &'static Plug> {
    let has_gpu = lab.gpu().is_some();
    ALL.iter().filter(move |plug| has_gpu || !plug.on_gpu)
}
