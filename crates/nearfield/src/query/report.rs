//! What really ran: structure, search, device, kernels, and the time of every stage.

use std::time::Instant;

/// Which structure, search, device and kernels gave an answer, and how long each stage took.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// Structure: "brute-force", "uniform-grid" …
    pub structure: &'static str,
    /// Variant of the search, such as "packs" or "two-pass".
    pub search: &'static str,
    /// Device: "cpu (8 threads, avx2)" or the adapter's name.
    pub device: String,
    /// Kernels that ran, in order of first use: module paths on the GPU, function names on the CPU.
    pub kernels: Vec<String>,
    /// Times in order.
    pub stages: Vec<Stage>,
    /// In how many batches of queries the answer was made.
    pub batches: u32,
    /// What a user should know: a fallback, a software adapter.
    pub notes: Vec<String>,
    /// Why this structure, where an index chose it; `None` where the caller did.
    pub reason: Option<String>,
}

/// Time of one stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Stage {
    /// "build", "count", "scan" …
    pub name: &'static str,
    /// Milliseconds.
    pub milliseconds: f64,
    /// Whose clock.
    pub clock: Clock,
}

/// Where a stage was timed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clock {
    /// Wall clock of the host.
    Host,
    /// Timestamps of the device.
    Device,
}

impl From<&crate::structure::BuildStage> for Stage {
    fn from(stage: &crate::structure::BuildStage) -> Self {
        let clock = if stage.on_device { Clock::Device } else { Clock::Host };
        Self { name: stage.name, milliseconds: stage.milliseconds, clock }
    }
}

impl Stage {
    /// The time since `start`, by the host's clock.
    pub(crate) fn on_host(name: &'static str, start: Instant) -> Self {
        Self { name, milliseconds: start.elapsed().as_secs_f64() * 1e3, clock: Clock::Host }
    }

    /// A stage that the device has timed; `None` where it has no clock.
    #[cfg(feature = "gpu")]
    pub(crate) fn on_device(time: &crate::gpu::StageTime) -> Option<Self> {
        Some(Self { name: time.name, milliseconds: time.milliseconds?, clock: Clock::Device })
    }
}

impl Report {
    /// Adds the time since `start` as a host stage.
    pub(crate) fn host_stage(&mut self, name: &'static str, start: Instant) {
        self.stages.push(Stage::on_host(name, start));
    }

    /// Adds the times of stages from the `first` on to earlier ones of the same name and clock.
    #[cfg(feature = "gpu")]
    pub(crate) fn merge_stages(&mut self, first: usize) {
        for stage in self.stages.split_off(first) {
            match self.stages.iter_mut().find(|s| s.name == stage.name && s.clock == stage.clock) {
                Some(earlier) => earlier.milliseconds += stage.milliseconds,
                None => self.stages.push(stage),
            }
        }
    }

    /// Sum of the stages of that name on one clock, in milliseconds.
    pub fn milliseconds(&self, name: &str, clock: Clock) -> f64 {
        self.stages.iter().filter(|s| s.name == name && s.clock == clock).map(|s| s.milliseconds).sum()
    }

    /// Sum of all stages on one clock, in milliseconds.
    pub fn total_milliseconds(&self, clock: Clock) -> f64 {
        self.stages.iter().filter(|s| s.clock == clock).map(|s| s.milliseconds).sum()
    }
}
