//! What all integration tests share: one GPU for the process, GPU tests that are skipped and counted where there is
//! none, and reproducible random numbers.
//!
//! - `NEARFIELD_TEST_DEVICE`: the device as on the command line; default `gpu`, which takes software adapters too
//! - `NEARFIELD_REQUIRE_GPU=1`: without that device, GPU tests fail instead of being skipped
//! - `NEARFIELD_LONG=1`: large cases on software adapters too

#![allow(dead_code, reason = "no test uses all of it")]

use std::path::PathBuf;
use std::sync::OnceLock;

use libtest_mimic::{Failed, Trial};
use nearfield::gpu::{AdapterKind, DeviceChoice, Gpu, adapters};
use nearfield::{Error, Result as NearfieldResult};

/// The device of this process, opened at first use; why there is none otherwise.
pub(crate) fn gpu() -> Result<&'static Gpu, &'static str> {
    static DEVICE: OnceLock<Result<Gpu, String>> = OnceLock::new();
    let device = DEVICE.get_or_init(|| {
        let asked = std::env::var("NEARFIELD_TEST_DEVICE").unwrap_or_else(|_| "gpu".to_owned());
        let opened = asked.parse::<DeviceChoice>().and_then(|choice| Gpu::open(&choice));
        match opened {
            Ok(Some(gpu)) => {
                eprintln!("GPU tests run on {} ({:?})", gpu.name(), gpu.kind());
                Ok(gpu)
            }
            Ok(None) => Err(format!("device {asked:?} is the CPU")),
            Err(error) => Err(error.to_string()),
        }
    });
    if let Err(reason) = device {
        static SAID: OnceLock<()> = OnceLock::new();
        SAID.get_or_init(|| eprintln!("GPU tests are skipped: {reason}"));
    }
    device.as_ref().map_err(String::as_str)
}

/// A test that needs the GPU: counted as ignored where there is none, or failed with `NEARFIELD_REQUIRE_GPU=1`.
pub(crate) fn gpu_trial(name: impl Into<String>, test: impl FnOnce(&Gpu) + Send + 'static) -> Trial {
    let required = std::env::var_os("NEARFIELD_REQUIRE_GPU").is_some_and(|v| v == "1");
    let skipped = gpu().is_err() && !required;
    let body = move || -> Result<(), Failed> {
        test(gpu()?);
        Ok(())
    };
    Trial::test(name, body).with_ignored_flag(skipped)
}

/// Trials of several subjects, each with its subject before its name.
pub(crate) fn named<const N: usize>(by_subject: [(&str, Vec<Trial>); N]) -> Vec<Trial> {
    let with_kind = |(subject, trials): (&str, Vec<Trial>)| {
        let kind = format!("{subject}, gpu");
        trials.into_iter().map(move |trial| trial.with_kind(kind.clone())).collect::<Vec<_>>()
    };
    by_subject.into_iter().flat_map(with_kind).collect()
}

/// A test that runs everywhere.
pub(crate) fn trial(name: impl Into<String>, test: impl FnOnce() + Send + 'static) -> Trial {
    let body = move || -> Result<(), Failed> {
        test();
        Ok(())
    };
    Trial::test(name, body)
}

/// Whether cases that take a software adapter minutes are to run.
pub(crate) fn long_cases(gpu: &Gpu) -> bool {
    gpu.kind() != AdapterKind::Software || is_long()
}

/// Whether cases that take minutes are asked for on any device.
pub(crate) fn is_long() -> bool {
    std::env::var_os("NEARFIELD_LONG").is_some_and(|v| v == "1")
}

/// The folder of real data: `NEARFIELD_DATA`, or `../shared/data` beside the repository.
pub(crate) fn data_folder() -> PathBuf {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    std::env::var_os("NEARFIELD_DATA").map_or_else(beside, PathBuf::from)
}

/// A file of the real data; `None` where it is not there.
pub(crate) fn data_file(name: &str) -> Option<PathBuf> {
    Some(data_folder().join(name)).filter(|path| path.is_file())
}

/// Reproducible random numbers (SplitMix64).
pub(crate) struct Random(pub(crate) u64);

impl Random {
    /// The next 64 bits.
    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// The next u32.
    pub(crate) fn word(&mut self) -> u32 {
        (self.bits() >> 32) as u32
    }

    /// The next number below `n`.
    pub(crate) fn below(&mut self, n: u32) -> u32 {
        ((u64::from(self.word()) * u64::from(n)) >> 32) as u32
    }

    /// The next number from 0 to below 1.
    pub(crate) fn unit(&mut self) -> f32 {
        (self.word() >> 8) as f32 / (1u32 << 24) as f32
    }
}

/// A context of the test's own on the adapter of `gpu`.
pub(crate) fn own_context(gpu: &Gpu) -> Gpu {
    let adapter = adapters().into_iter().find(|a| a.name == gpu.name());
    Gpu::open_adapter(&adapter.expect("the adapter of an open device should be listed")).unwrap()
}

/// Runs `work` with every one of its allocations refused in turn: it gives the right answer or `OutOfDeviceMemory`, and
/// keeps no memory.
pub(crate) fn refuse_each<T>(
    gpu: &Gpu,
    case: &str,
    work: impl Fn() -> NearfieldResult<T>,
    right: impl Fn(&T) -> bool,
) -> u32 {
    let used = gpu.memory_used();
    for n in 0.. {
        gpu.refuse_allocation(Some(n));
        let result = work();
        let not_reached = gpu.refuse_allocation(None);
        match &result {
            Ok(answer) => assert!(right(answer), "{case}, allocation {n}"),
            Err(Error::OutOfDeviceMemory { available: 0, .. }) => assert!(!not_reached, "{case}, allocation {n}"),
            Err(error) => panic!("{case}, allocation {n} refused: {error}"),
        }
        drop(result);
        assert_eq!(gpu.memory_used(), used, "{case}, allocation {n}: bytes left");
        if not_reached {
            return n;
        }
    }
    unreachable!("there should be an end to allocations")
}

/// Counts a part of a test as skipped: its name goes to the file that `NEARFIELD_SKIPPED` names.
pub(crate) fn count_as_skipped(name: &str) {
    use std::io::Write;
    if let Some(path) = std::env::var_os("NEARFIELD_SKIPPED") {
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path).expect("the file should open");
        writeln!(file, "{name}").expect("the file should take a line");
    }
}
