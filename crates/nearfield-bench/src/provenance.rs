//! Where a figure comes from: device, driver, host and commit. No dates: the commit tells the order.

use nearfield::gpu::{AdapterKind, DeviceChoice, Gpu};
use nearfield::{BruteForce, NeighborSearch};

use crate::{Result, clocks};

/// The commit this program was built from.
pub const COMMIT: &str = env!("NEARFIELD_BENCH_COMMIT");

/// The device that is measured.
#[derive(Clone)]
pub enum Device {
    /// All threads of the host.
    Cpu,
    /// An open GPU.
    Gpu(Gpu),
}

/// A device with its names.
#[derive(Clone)]
pub struct Machine {
    /// The device.
    pub device: Device,
    /// "cpu (2 threads, avx512)", or the adapter's name.
    pub name: String,
    /// API and driver; "none" on the CPU.
    pub driver: String,
    /// Model and number of threads of the host's processor.
    pub host: String,
}

impl Machine {
    /// Opens the device that `choice` means.
    ///
    /// # Errors
    /// As [`DeviceChoice::resolve`] and [`Gpu::open_adapter`].
    pub fn open(choice: &DeviceChoice) -> Result<Self> {
        let host = format!("{}, {} threads", processor(), rayon::current_num_threads());
        Ok(match choice.resolve()? {
            Some(adapter) => {
                let device = Device::Gpu(Gpu::open_adapter(&adapter)?);
                clocks::raise_those_of(&adapter)?;
                Self { device, name: adapter.name, driver: adapter.driver, host }
            }
            None => {
                let name = BruteForce::build(&[])?.device();
                Self { device: Device::Cpu, name, driver: "none".to_owned(), host }
            }
        })
    }

    /// A context of its own on the same adapter.
    ///
    /// # Errors
    /// `NoDevice` where there is none any more, or the machine is a CPU.
    pub fn reopen(&self) -> Result<Gpu> {
        let adapter = nearfield::gpu::adapters().into_iter().find(|a| a.name == self.name && a.driver == self.driver);
        let gone = || nearfield::Error::NoDevice { asked: self.name.clone(), found: Vec::new() };
        Ok(Gpu::open_adapter(&adapter.ok_or_else(gone)?)?)
    }

    /// Whether the device is a GPU in hardware.
    pub fn is_hardware_gpu(&self) -> bool {
        matches!(&self.device, Device::Gpu(gpu) if gpu.kind() != AdapterKind::Software)
    }
}

/// The processor's model as the system gives it.
pub fn processor() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name"));
    match model {
        Some(model) => model.trim_start_matches([' ', '\t', ':']).trim().to_owned(),
        None => std::env::consts::ARCH.to_owned(),
    }
}
