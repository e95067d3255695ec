//! Batches of queries where device memory is short: the same answer in parts.

use std::ops::Range;

use crate::{Error, Result};

/// Runs `work` on consecutive ranges that together are `0..n`, starting with all of it; where device memory runs out
/// the range is halved and tried again, but not below `smallest` elements. Returns the number of ranges.
///
/// # Errors
/// What `work` returns, `OutOfDeviceMemory` only for a range of at most `smallest` elements.
pub(in crate::query) fn halving(
    n: usize,
    smallest: usize,
    work: impl FnMut(Range<usize>) -> Result<()>,
) -> Result<u32> {
    halving_from(n, n, smallest, work)
}

/// As [`halving`], starting with ranges of at most `largest` elements.
///
/// # Errors
/// As [`halving`].
pub(in crate::query) fn halving_from(
    n: usize,
    largest: usize,
    smallest: usize,
    mut work: impl FnMut(Range<usize>) -> Result<()>,
) -> Result<u32> {
    let (mut start, mut size, mut batches) = (0, n.min(largest.max(1)), 0);
    while start < n {
        let range = start..n.min(start + size);
        match work(range.clone()) {
            Ok(()) => {
                start = range.end;
                batches += 1;
            }
            Err(Error::OutOfDeviceMemory { .. }) if range.len() > smallest => size = range.len().div_ceil(2),
            Err(error) => return Err(error),
        }
    }
    Ok(batches)
}

/// Cuts rows of these lengths into consecutive ranges of at most `capacity` entries, but at least one row.
pub(in crate::query) fn windows(lengths: &[u32], capacity: u64) -> Vec<Range<usize>> {
    let (mut ranges, mut first, mut entries) = (Vec::new(), 0, 0);
    for (i, &length) in lengths.iter().enumerate() {
        if i > first && entries + u64::from(length) > capacity {
            ranges.push(first..i);
            (first, entries) = (i, 0);
        }
        entries += u64::from(length);
    }
    if first < lengths.len() {
        ranges.push(first..lengths.len());
    }
    ranges
}

#[cfg(test)]
mod tests {
    use super::*;

    fn short_of_memory() -> Error {
        Error::OutOfDeviceMemory { what: "test".into(), needed: 2, available: 1 }
    }

    #[test]
    fn halving_covers_everything_once_in_order() {
        let mut done = vec![];
        let batches = halving(10_000, 256, |range| {
            if range.len() > 3000 {
                return Err(short_of_memory());
            }
            done.extend(range);
            Ok(())
        });
        assert_eq!(batches.unwrap(), 4);
        assert!(done.into_iter().eq(0..10_000));
    }

    #[test]
    fn ranges_begin_no_larger_than_is_asked() {
        let mut done = vec![];
        let batches = halving_from(10_000, 4000, 256, |range| {
            if range.len() > 3000 {
                return Err(short_of_memory());
            }
            done.push(range.len());
            Ok(())
        });
        assert_eq!((batches.unwrap(), done), (5, vec![2000; 5]));
        let mut done = vec![];
        halving_from(9000, 4000, 1, |range| {
            done.push(range);
            Ok(())
        })
        .unwrap();
        assert_eq!(done, [0..4000, 4000..8000, 8000..9000]);
    }

    #[test]
    fn halving_ends_where_nothing_fits() {
        assert!(matches!(halving(10_000, 1, |_| Err(short_of_memory())), Err(Error::OutOfDeviceMemory { .. })));
        assert_eq!(halving(0, 1, |_| Err(short_of_memory())).unwrap(), 0);
    }

    #[test]
    fn windows_respect_the_capacity_but_for_single_rows() {
        assert_eq!(windows(&[3, 3, 9, 1, 1], 6), [0..2, 2..3, 3..5]);
        assert_eq!(windows(&[], 6), []);
        assert_eq!(windows(&[7, 7], 6), [0..1, 1..2]);
    }
}
