//! Finding a device: what adapters there are, and choosing one by word, number or name.

use std::str::FromStr;

use crate::{Error, Result};

/// What `--device` says.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum DeviceChoice {
    /// The best hardware GPU, or the CPU where there is none; never a software adapter.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// The best GPU; a software adapter where there is no other.
    Gpu,
    /// The GPU of that number in [`adapters`].
    Number(usize),
    /// The first GPU whose name contains this text, ignoring case.
    Name(String),
}

impl FromStr for DeviceChoice {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        Ok(match text {
            "auto" => Self::Auto,
            "cpu" => Self::Cpu,
            "gpu" => Self::Gpu,
            "" => {
                return Err(Error::InvalidSetting {
                    setting: "device",
                    found: "nothing".into(),
                    expected: "auto, cpu, gpu, gpu:N or part of a device name",
                });
            }
            _ => match text.strip_prefix("gpu:") {
                Some(number) => Self::Number(number.parse().map_err(|_| Error::InvalidSetting {
                    setting: "device",
                    found: text.into(),
                    expected: "gpu:N with N the number that `nearfield devices` prints",
                })?),
                None => Self::Name(text.into()),
            },
        })
    }
}

impl std::fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Cpu => f.write_str("cpu"),
            Self::Gpu => f.write_str("gpu"),
            Self::Number(n) => write!(f, "gpu:{n}"),
            Self::Name(name) => f.write_str(name),
        }
    }
}

/// What an adapter is, best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum AdapterKind {
    /// A card of its own.
    Discrete,
    /// Part of the processor.
    Integrated,
    /// Lent by a hypervisor.
    Virtual,
    /// Unknown to the driver.
    Other,
    /// A renderer on the CPU, such as llvmpipe.
    Software,
}

/// A GPU that can be opened.
#[derive(Debug, Clone)]
pub struct Adapter {
    /// Name as the driver gives it.
    pub name: String,
    /// What it is.
    pub kind: AdapterKind,
    /// API and driver, such as "Vulkan, NVIDIA 580.95".
    pub driver: String,
    pub(super) handle: wgpu::Adapter,
}

/// All GPUs found, hardware first; empty where there is none or no driver loader.
pub fn adapters() -> Vec<Adapter> {
    let backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends,
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let mut found: Vec<Adapter> =
        pollster::block_on(instance.enumerate_adapters(backends)).into_iter().map(Adapter::from).collect();
    found.sort_by_key(|a| a.kind);
    found
}

impl From<wgpu::Adapter> for Adapter {
    fn from(handle: wgpu::Adapter) -> Self {
        let info = handle.get_info();
        let kind = match info.device_type {
            wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
            wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
            wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
            wgpu::DeviceType::Cpu => AdapterKind::Software,
            wgpu::DeviceType::Other => AdapterKind::Other,
        };
        let driver = format!("{:?}, {} {}", info.backend, info.driver, info.driver_info);
        Self { name: info.name, kind, driver: driver.trim_end().to_owned(), handle }
    }
}

impl DeviceChoice {
    /// The adapter this choice means; `None` for the CPU.
    ///
    /// # Errors
    /// `NoDevice` with the names there are, where a GPU was asked for and none fits. `Auto` never fails.
    pub fn resolve(&self) -> Result<Option<Adapter>> {
        if *self == Self::Cpu {
            return Ok(None);
        }
        self.pick(adapters())
    }

    fn pick(&self, mut found: Vec<Adapter>) -> Result<Option<Adapter>> {
        let position = match self {
            Self::Cpu => return Ok(None),
            Self::Auto => match found.iter().position(|a| a.kind != AdapterKind::Software) {
                Some(hardware) => Some(hardware),
                None => return Ok(None),
            },
            Self::Gpu => (!found.is_empty()).then_some(0),
            Self::Number(n) => (*n < found.len()).then_some(*n),
            Self::Name(name) => {
                let name = name.to_lowercase();
                found.iter().position(|a| a.name.to_lowercase().contains(&name))
            }
        };
        match position {
            Some(i) => Ok(Some(found.swap_remove(i))),
            None => {
                Err(Error::NoDevice { asked: self.to_string(), found: found.into_iter().map(|a| a.name).collect() })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_are_read_and_printed_alike() {
        for text in ["auto", "cpu", "gpu", "gpu:3", "llvmpipe"] {
            assert_eq!(text.parse::<DeviceChoice>().unwrap().to_string(), text);
        }
        assert!("gpu:x".parse::<DeviceChoice>().is_err());
        assert!("".parse::<DeviceChoice>().is_err());
    }

    #[test]
    fn only_auto_falls_back_to_the_cpu() {
        assert!(DeviceChoice::Auto.pick(vec![]).unwrap().is_none());
        for choice in [DeviceChoice::Gpu, DeviceChoice::Number(0), DeviceChoice::Name("x".into())] {
            assert!(matches!(choice.pick(vec![]), Err(Error::NoDevice { .. })), "{choice}");
        }
    }
}
