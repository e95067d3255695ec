//! Work on the device that was chosen; only `auto` falls back to the CPU, and says so.

use nearfield::gpu::{AdapterKind, DeviceChoice};
use nearfield::{Error, Gpu};

/// Runs `work` on the GPU that was chosen; `None` where the CPU is to do it: it was chosen, or `auto` found no GPU or one
/// that failed. What a user should know of that becomes a note.
///
/// # Errors
/// `NoDevice` and what `work` returns, but where `auto` goes on without the device.
pub(crate) fn on_gpu<T>(
    device: &DeviceChoice,
    notes: &mut Vec<String>,
    work: impl FnOnce(&Gpu) -> nearfield::Result<T>,
) -> nearfield::Result<Option<T>> {
    let auto = *device == DeviceChoice::Auto;
    let gave_up = |device: &str, error: &Error| format!("{device} could not be used ({error}); the CPU did the work");
    let gpu = match Gpu::open(device) {
        Ok(Some(gpu)) => gpu,
        Ok(None) => {
            if auto {
                notes.push("no hardware GPU was found; the CPU did the work".to_owned());
            }
            return Ok(None);
        }
        Err(error) if auto => {
            notes.push(gave_up("the GPU", &error));
            return Ok(None);
        }
        Err(error) => return Err(error),
    };
    if gpu.kind() == AdapterKind::Software {
        notes.push(format!("{} is a software renderer: the CPU in disguise, and slower", gpu.name()));
    }
    match work(&gpu) {
        // What only the device cannot do, the CPU can.
        Err(error) if auto && (error.is_device_fault() || matches!(error, Error::Unsupported { .. })) => {
            notes.push(gave_up(gpu.name(), &error));
            Ok(None)
        }
        done => done.map(Some),
    }
}
