//! One array made of rows that threads fill in any order.

#![allow(unsafe_code, reason = "that rows which threads fill are disjoint is not to be seen by the compiler")]

use std::marker::PhantomData;
use std::ops::Range;

use bytemuck::Zeroable;

use crate::{Result, host_memory};

/// An array of zeros whose rows are filled by any thread.
///
/// Invariants: 1. `offsets` ascends and ends at the length of `values`; 2. nothing but rows that were given out refers to the
/// elements of `values`.
pub(crate) struct RowsToFill<'a, T> {
    offsets: &'a [u64],
    first: *mut T,
    values: Vec<T>,
    rows: PhantomData<&'a mut [T]>,
}

// SAFETY: through a shared reference only rows can be had, each by one caller at a time, so elements go to other threads as if
// they were sent there.
unsafe impl<T: Send> Sync for RowsToFill<'_, T> {}

/// Where a row stands.
#[derive(Debug)]
pub(crate) struct RowPlace(Range<usize>);

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
        let mut values = host_memory::zeroed(what, offsets.last().copied().unwrap_or(0) as usize)?;
        Ok(Self { offsets, first: values.as_mut_ptr(), values, rows: PhantomData })
    }

    /// The row at this place of an array of these offsets.
    ///
    /// # Safety
    /// Nobody has the row of this place, and the place is of the same offsets.
    #[allow(clippy::mut_from_ref, reason = "the caller gives every row out once at a time")]
    #[inline]
    pub(crate) unsafe fn row(&self, place: &RowPlace) -> &mut [T] {
        debug_assert!(place.0.end <= self.values.len());
        // SAFETY: the range lies within the elements and no other row has a part of it (invariant 1; the place is of these
        // offsets); nobody else has this row.
        unsafe { std::slice::from_raw_parts_mut(self.first.add(place.0.start), place.0.len()) }
    }

    /// Where the row of this number stands.
    ///
    /// # Panics
    /// If there is no such row.
    #[inline]
    pub(crate) fn place(&self, row: usize) -> RowPlace {
        RowPlace(self.offsets[row] as usize..self.offsets[row + 1] as usize)
    }

    /// The array; rows that nobody filled are zero.
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
        (0..lengths.len()).into_par_iter().rev().for_each(|number| {
            // SAFETY: every number comes once.
            unsafe { rows.row(&rows.place(number)) }.fill(number as u32);
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
    #[should_panic(expected = "should ascend")]
    fn descending_offsets_are_refused() {
        let _ = RowsToFill::<u32>::new("test", &[0, 5, 3, 8]);
    }
}
