//! `nearfield-bench small`: wall clock of a call where points are few, so that waiting for the device takes longer than its work.
//!
//! Rows are lists of all points' neighbours, every point asking its own set, with about 49 neighbours: by a plan that keeps its memory
//! ([`GpuListPlan`]), and by a grid that is built anew. Each on the device, with points that are there, and from host memory into host memory. A list on
//! the device counts until the host knows that it is done. Every answer is checked.

use std::time::Instant;

use nearfield::geometry::generate::CloudKind;
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield::parallel::reduce;
use nearfield::structure::{EntryOrder, GridBuilder};
use nearfield::{FixedRadius, GpuListPlan, GpuUniformGrid, GridSettings, NeighborSearch, SearchOnDevice, Vec3};

use crate::Result;
use crate::check::Expected;
use crate::device::device_points;
use crate::measure::Timing;
use crate::provenance::{COMMIT, Device, Machine};
use crate::sets::Set;

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// auto, gpu, gpu:N or part of a device name
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,

    /// Numbers of points
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [1024, 8192, 65_536])]
    pub points: Vec<usize>,

    /// Timed calls of a row, after a tenth as many that are not
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub calls: usize,
}

/// No further call of a row is begun after so many seconds.
const SECONDS: f64 = 10.0;

/// Prints a table.
///
/// # Errors
/// Of the library; no GPU; a wrong answer.
pub fn run(arguments: &Arguments) -> Result<()> {
    let machine = Machine::open(&arguments.device)?;
    let Device::Gpu(gpu) = &machine.device else {
        return Err("small calls are measured on a GPU: calls of the CPU wait for nothing".into());
    };
    println!("{} ({}), host {}, commit {COMMIT}", machine.name, machine.driver, machine.host);
    println!();
    println!("| points | mean neighbours | list | median, ms | fastest, ms | calls |");
    println!("| --- | --- | --- | --- | --- | --- |");
    for &n in &arguments.points {
        let set = Set { kind: CloudKind::Uniform, n };
        let (points, radius) = (set.points(), set.radius());
        let expected = Expected::of(&points, radius)?;
        let case = Case { gpu, points: &points, radius, expected: &expected, calls: arguments.calls.max(1) };
        if n <= GpuListPlan::MOST_POINTS {
            case.by_plan()?;
        }
        case.by_grid()?;
    }
    Ok(())
}

struct Case<'a> {
    gpu: &'a Gpu,
    points: &'a [Vec3],
    radius: f32,
    expected: &'a Expected,
    calls: usize,
}

impl Case<'_> {
    fn by_plan(&self) -> Result<()> {
        let mut plan = GpuListPlan::new(self.gpu, self.points.len(), &FixedRadius::new(self.radius))?;
        self.gpu.write(plan.points(), 0, &device_points(self.points))?;
        self.time("plan, points and list on the device", || {
            plan.list_on_device()?;
            Ok(())
        })?;
        let list = plan.list_on_device()?;
        self.check(&self.gpu.read(&list.offsets)?, &self.gpu.read(&list.indices)?)?;
        self.time("plan, points in and list out", || {
            plan.list(self.points)?;
            Ok(())
        })?;
        let list = plan.list(self.points)?;
        self.expected.check_list(list.offsets(), list.indices())
    }

    fn by_grid(&self) -> Result<()> {
        let (settings, question) = (GridSettings::for_radius(self.radius), FixedRadius::new(self.radius));
        let (n, bounds) = (self.points.len(), reduce::bounds(self.points));
        let input = self.gpu.upload("points", &device_points(self.points))?;
        let mut builder = GridBuilder::with_order(self.gpu, n, &bounds, &settings, EntryOrder::Any)?;
        let mut list = None;
        self.time("grid built anew, points and list on the device", || {
            list = Some(builder.build(&input)?.list_on_device(&question)?);
            Ok(())
        })?;
        if let Some(list) = list {
            self.check(&self.gpu.read(&list.offsets)?, &self.gpu.read(&list.indices)?)?;
        }
        let mut list = None;
        self.time("grid built anew, points in and list out", || {
            list = Some(GpuUniformGrid::build(self.gpu, self.points, &settings)?.list(&question)?);
            Ok(())
        })?;
        list.map_or(Ok(()), |list| self.expected.check_list(list.offsets(), list.indices()))
    }

    fn check(&self, offsets: &[u32], indices: &[u32]) -> Result<()> {
        let offsets: Vec<u64> = offsets.iter().map(|&offset| u64::from(offset)).collect();
        self.expected.check_list(&offsets, indices)
    }

    /// Prints the time of a call.
    fn time(&self, what: &str, mut call: impl FnMut() -> Result<()>) -> Result<()> {
        for _ in 0..self.calls.div_ceil(10) {
            call()?;
        }
        let (begin, mut times) = (Instant::now(), Vec::new());
        while times.len() < self.calls && (times.is_empty() || begin.elapsed().as_secs_f64() < SECONDS) {
            let start = Instant::now();
            call()?;
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        let Timing { median, fastest } = Timing::of(&times);
        println!(
            "| {} | {:.1} | {what} | {median:.3} | {fastest:.3} | {} |",
            self.points.len(),
            self.expected.mean(),
            times.len()
        );
        Ok(())
    }
}
