//! What smoothing computes from neighbours, made once more outside of the library: the foot of each point on the plane of its
//! neighbours, from lists on either device, and by a visitor on any structure of the GPU.
//!
//! It is `MlsMethod::Pss` of degree 0 by the fast form with the quartic weight, so that what comes out can be compared with the
//! library's own smoothing, and the time with lists with that without.

use std::sync::Arc;

use nearfield::geometry::symmetric_eigen::Symmetric;
use nearfield::gpu::shader::Fill;
use nearfield::gpu::{Access, Buffer, Gpu, Kernel, Pipeline, Workgroups};
use nearfield::structure::DevicePoint;
use nearfield::{FixedRadius, ForEachOnDevice, Vec3, Visitor};
use rayon::prelude::*;

use crate::Result;
use crate::paper::methods::Found;

const WORKGROUP: u32 = 64;
const PLANE: &str = "package::applications::plane";
const FROM_LISTS: &str = "package::applications::from_lists";
/// Points of a task.
const TASK: usize = 256;
/// The smallest ratio of the middle to the largest eigenvalue of neighbours that are not on a line, as in the library.
const LINE: f32 = 1e-6;

/// Sums over the neighbours of a point; offsets are in radii.
#[derive(Debug, Clone, Copy, Default)]
struct PlaneSums {
    count: u32,
    weight: f32,
    first: Vec3,
    second: Symmetric<f32>,
}

impl PlaneSums {
    fn add(&mut self, offset: Vec3) {
        let rest = (1.0 - offset.length_squared()).max(0.0);
        let weight = (rest * rest) * (rest * rest);
        self.count += 1;
        self.weight += weight;
        self.first += weight * offset;
        self.second.add_outer(offset.to_array(), weight);
    }

    /// The foot, from the point and in radii; 0 where there is no plane.
    fn foot(&self) -> Vec3 {
        if self.count < 3 || self.weight.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater) {
            return Vec3::ZERO;
        }
        let mean = self.first / self.weight;
        let mut covariance = Symmetric(self.second.0.map(|sum| sum / self.weight));
        covariance.add_outer(mean.to_array(), -1.0);
        let [xx, xy, xz, yy, yz, zz] = covariance.0;
        let sum = xx + yy + zz;
        let products = (xx * yy - xy * xy) + (yy * zz - yz * yz) + (zz * xx - xz * xz);
        if !(products >= LINE * sum * sum && sum > 0.0) {
            return Vec3::ZERO;
        }
        let normal = Vec3::from_array(covariance.eigen().vectors[0]);
        normal.dot(mean) * normal
    }
}

/// Every point to its foot, from lists on the host.
///
/// - `row`: indices of the neighbours of a point, itself among them
pub fn from_lists<'a>(points: &[Vec3], radius: f32, row: impl Fn(usize) -> &'a [u32] + Sync) -> Vec<Vec3> {
    let fit = |(i, &point): (usize, &Vec3)| {
        let mut sums = PlaneSums::default();
        for &id in row(i) {
            let offset = (points[id as usize] - point) / radius;
            if offset.length_squared() <= 1.0 {
                sums.add(offset);
            }
        }
        point + sums.foot() * radius
    };
    points.par_iter().enumerate().with_min_len(TASK).map(fit).collect()
}

/// The same on a device.
pub struct FromLists {
    gpu: Gpu,
    pipeline: Arc<Pipeline>,
    /// Stands where rows have no offsets.
    no_offsets: Buffer<u32>,
}

impl FromLists {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// `KernelRejected`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn new(gpu: &Gpu) -> Result<Self> {
        let (read, write) = (Access::Read, Access::ReadWrite);
        let accesses = [Access::Uniform, read, read, read, write];
        let kernel = Kernel {
            fills: &fills(),
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            ..Kernel::new(FROM_LISTS, "fit", &accesses, WORKGROUP)
        };
        // SAFETY: places of rows and indices of points are kept below the numbers in the parameters, which are those of the buffers;
        // offsets are read up to that of the last point, and every loop ends with a row.
        let pipeline = unsafe { gpu.pipeline_unchecked(&kernel)? };
        Ok(Self { gpu: gpu.clone(), pipeline, no_offsets: gpu.upload("no offsets", &[0u32])? })
    }

    /// Every point to its foot, left on the device.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`; lists that are not on the device.
    pub fn run(&self, points: &Buffer<DevicePoint>, lists: &Found, radius: f32) -> Result<Buffer<DevicePoint>> {
        let (places, offsets, indices) = match lists {
            Found::OnDevice(list) => (0, &list.offsets, &list.indices),
            Found::NearestRows { k, rows, .. } => (*k as u32, &self.no_offsets, &rows.ids),
            _ => return Err("a kernel over lists needs them on the device".into()),
        };
        let moved = self.gpu.buffer("points that have moved", points.len())?;
        let parameters = [points.len() as u32, places, radius.to_bits(), indices.len() as u32];
        let parameters = self.gpu.uniform("parameters of a fit", &parameters)?;
        let bindings = [(&parameters).into(), points.into(), offsets.into(), indices.into(), (&moved).into()];
        let mut commands = self.gpu.commands("fit from lists");
        commands.stage("fit").dispatch(&self.pipeline, &bindings, Workgroups::Covering(points.len() as u64));
        commands.run()?;
        Ok(moved)
    }
}

/// Every point of a structure to its foot, without lists, left on the device in the caller's order.
///
/// # Errors
/// As [`ForEachOnDevice::for_each_on_device`].
pub fn without_lists<S: ForEachOnDevice>(structure: &S, radius: f32) -> Result<Buffer<DevicePoint>> {
    let moved = structure.gpu().buffer("points that have moved", structure.len())?;
    let source = visitor();
    let bindings = [(Access::ReadWrite, (&moved).into())];
    structure.for_each_on_device(&FixedRadius::new(radius), &Visitor::new(&source, &bindings))?;
    Ok(moved)
}

fn visitor() -> String {
    let imports = "import package::structure::question::{Query, Neighbor};\n";
    format!("{imports}{}\n{}", include_str!("plane.wesl"), include_str!("without_lists.wesl"))
}

fn fills() -> [(&'static str, Fill<'static>); 2] {
    [(PLANE, Fill::Caller(include_str!("plane.wesl"))), (FROM_LISTS, Fill::Caller(include_str!("from_lists.wesl")))]
}

#[cfg(test)]
mod tests {
    use nearfield::application::{PlaneSearch, Support};
    use nearfield::geometry::generate::{CloudKind, cloud};
    use nearfield::gpu::shader::compose;
    use nearfield::gpu::wgpu::naga;
    use nearfield::{GridSettings, MlsMethod, MlsSettings, MlsSmoothing, NeighborSearch, UniformGrid};

    use super::*;

    #[test]
    fn feet_are_those_of_the_library() {
        let (points, radius) = (cloud(CloudKind::Shell, 3000, 1).points, 0.15);
        let lists = UniformGrid::build(&points, &GridSettings::for_radius(radius))
            .and_then(|grid| grid.list(&FixedRadius::new(radius)))
            .expect("lists");
        let moved = from_lists(&points, radius, |i| lists.row(i));
        let method = MlsMethod::Pss { degree: 0, plane: PlaneSearch::Fast };
        let arrays: Vec<[f32; 3]> = points.iter().map(|p| p.to_array()).collect();
        let mut smoothing =
            MlsSmoothing::new(&arrays, None, &Support::Radius(radius), &MlsSettings::new(method)).expect("points");
        smoothing.iterate().expect("an iteration");
        for (i, (ours, its)) in moved.iter().zip(smoothing.positions()).enumerate() {
            assert!(ours.distance(Vec3::from_array(*its)) < 1e-6, "point {i}: {ours} and {its:?}");
        }
        assert!(moved.iter().zip(&points).any(|(a, b)| a.distance(*b) > 1e-4), "something has moved");
    }

    #[test]
    fn the_kernel_composes_and_validates() {
        let wgsl = compose(FROM_LISTS, &fills(), &[], false).expect("a shader");
        let parsed = naga::front::wgsl::parse_str(&wgsl).map_err(|e| e.emit_to_string(&wgsl)).expect("a shader");
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
            .validate(&parsed)
            .map_err(|e| e.emit_to_string(&wgsl))
            .expect("a valid shader");
        assert_eq!(parsed.entry_points.len(), 1);
    }
}
