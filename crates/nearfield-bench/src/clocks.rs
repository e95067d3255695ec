//! Raising the clocks of a card before something is timed on it.
//!
//! An idle card lowers its clocks. Runs of a short kernel with pauses of the host between them do not raise them, and would be timed at a
//! fraction of the card's speed; so before each measurement the card sorts without a pause. It does so through a device of its own, so that
//! memory that is measured stays as it is.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use nearfield::Result;
use nearfield::gpu::{Adapter, AdapterKind, Gpu};
use nearfield::parallel::radix_sort::GpuRadixSort;

use crate::primitives::SortCase;

/// The card whose clocks are raised; none until one is named.
static CARD: Mutex<Option<Load>> = Mutex::new(None);

/// How long the card is kept busy.
const TIME: Duration = Duration::from_millis(300);
/// Pairs of a sort, which then takes some 0.2 ms.
const PAIRS: usize = 1 << 22;
/// Sorts of a submission.
const TOGETHER: u32 = 64;

/// Work that keeps a card busy.
struct Load {
    gpu: Gpu,
    plan: GpuRadixSort<u32>,
    case: SortCase<u32>,
}

/// From now on [`raise`] is for this card. Renderers on the CPU have no clocks of their own: for them nothing is done.
///
/// # Errors
/// As [`Gpu::open_adapter`] and [`GpuRadixSort::new`].
pub fn raise_those_of(adapter: &Adapter) -> Result<()> {
    if adapter.kind == AdapterKind::Software {
        return Ok(());
    }
    let gpu = Gpu::open_adapter(adapter)?;
    let load = Load { plan: GpuRadixSort::new(&gpu, PAIRS)?, case: SortCase::new(&gpu, PAIRS)?, gpu };
    *CARD.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(load);
    Ok(())
}

/// Keeps the card busy for some tenths of a second, and leaves its answer unchecked.
///
/// # Errors
/// Of the device.
pub fn raise() -> Result<()> {
    let card = CARD.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let Some(load) = &*card else { return Ok(()) };
    let start = Instant::now();
    while start.elapsed() < TIME {
        let mut commands = load.gpu.commands("raise clocks");
        load.case.record(&load.plan, &mut commands, &(0..u32::BITS))?;
        commands.submit_repeated(TOGETHER)?;
        load.case.wait(&load.gpu)?;
    }
    Ok(())
}
