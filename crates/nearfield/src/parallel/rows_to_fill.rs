//! One array made of rows that threads fill in any order.

#![allow(unsafe_code, reason = "that rows which threads fill are disjoint is not to be seen by the compiler")]

use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;

use bytemuck::Zeroable;

use crate::{Error, Result, host_memory};

/// An array of zeros whose rows are taken by their number, each once, and filled by any thread.
///
/// Invariants: 1. `offsets` ascends and ends at the length of `values`; 2. nothing but rows that were taken refers to the
/// elements of `values`; 3. a row whose flag is set was taken.
pub(crate) struct RowsToFill<'a, T> {
    offsets: &'a [u64],
    taken: Vec<AtomicBool>,
    first: *mut T,
    values: Vec<T>,
}

// SAFETY: through a shared reference only rows can be had, each by one caller (invariant 3), so elements go to other threads as if
// they were sent there.
unsafe impl<T: Send> Sync for RowsToFill<'_, T> {}

impl<'a, T: Zeroable> RowsToFill<'a, T> {
    /// Rows where row i stands at `offsets[i]..offsets[i + 1]`.
    ///
    /// # Errors
    /// `OutOfMemory`, which says `what` the array is.
    ///
    /// # Panics
    /// If the offsets descend.
    pub(crate) fn new(what: &'static str, offsets: &'a [u64]) -> Result<Self> {
        assert!(offsets.is_sorted(), "offsets of rows should ascend");
        let n_values = offsets.last().copied().unwrap_or(0);
        // What fits an address fits for all offsets, which are not larger.
        let len = usize::try_from(n_values).map_err(|_| Error::OutOfMemory {
            what,
            needed: n_values.saturating_mul(size_of::<T>() as u64),
            available: usize::MAX as u64,
        })?;
        let mut values = host_memory::zeroed(what, len)?;
        let taken = (1..offsets.len()).map(|_| AtomicBool::new(false)).collect();
        Ok(Self { offsets, taken, first: values.as_mut_ptr(), values })
    }

    /// The rows of these numbers. In random order each is a cache miss, and these do not wait for each other: so many at once.
    ///
    /// # Panics
    /// If there is no such row, or one was taken before.
    #[allow(clippy::mut_from_ref, reason = "every row is given out once")]
    pub(crate) fn take(&self, rows: &[u32]) -> Vec<&mut [T]> {
        for &row in rows {
            assert!(!self.taken[row as usize].swap(true, Relaxed), "row {row} should be taken once");
        }
        let slice = |&row: &u32| {
            let (begin, end) = (self.offsets[row as usize] as usize, self.offsets[row as usize + 1] as usize);
            // SAFETY: the range lies within the elements, and no other row has a part of it (invariant 1); nobody else took this row,
            // as the swap above tells (invariant 3).
            unsafe { std::slice::from_raw_parts_mut(self.first.add(begin), end - begin) }
        };
        rows.iter().map(slice).collect()
    }

    /// The array; rows that nobody took are zero.
    pub(crate) fn finish(self) -> Vec<T> {
        self.values
    }
}

#[cfg(test)]
mod tests {
    use rayon::prelude::*;

    use super::*;

    #[test]
    fn rows_filled_by_threads_in_any_order_stand_in_order() {
        let lengths: Vec<u32> = (0..10_000).map(|i| i * 7 % 5).collect();
        let offsets = crate::parallel::scan::exclusive_u64(&lengths);
        let rows = RowsToFill::<u32>::new("test", &offsets).unwrap();
        (0..lengths.len() as u32).into_par_iter().rev().for_each(|number| {
            for row in rows.take(&[number]) {
                row.fill(number);
            }
        });
        let expected: Vec<u32> =
            lengths.iter().enumerate().flat_map(|(row, &n)| std::iter::repeat_n(row as u32, n as usize)).collect();
        assert_eq!(rows.finish(), expected);
    }

    #[test]
    fn no_rows_are_an_empty_array() {
        assert!(RowsToFill::<u32>::new("test", &[]).unwrap().finish().is_empty());
        assert!(RowsToFill::<u32>::new("test", &[0]).unwrap().finish().is_empty());
    }

    #[test]
    #[should_panic(expected = "taken once")]
    fn a_row_is_given_out_once() {
        let rows = RowsToFill::<u32>::new("test", &[0, 2, 3]).unwrap();
        assert_eq!(rows.take(&[1, 0]).iter().map(|row| row.len()).collect::<Vec<_>>(), [1, 2]);
        rows.take(&[0]);
    }

    #[test]
    #[should_panic(expected = "should ascend")]
    fn descending_offsets_are_refused() {
        let _ = RowsToFill::<u32>::new("test", &[0, 5, 3, 8]);
    }
}
