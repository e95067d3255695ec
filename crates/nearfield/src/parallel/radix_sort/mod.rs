//! Stable sorting of (key, value) pairs by a range of key bits: counting sorts of one digit after another, the lowest
//! first (least significant digit radix sort). Keys are `u32` or `u64`, values `u32`.
//!
//! Only the bits asked for cost time, and of those only digits that are not the same in every key. On the CPU a digit
//! has up to 8 bits, and so it has on the GPU where subgroups can vote; elsewhere 4. Digits share the bits evenly.
//!
//! Source: Adinets2022 for the single-pass form on the GPU; the others scan digit counts of tiles (Blelloch1990).

mod cpu;
#[cfg(feature = "gpu")]
mod gpu;
mod key;

pub use cpu::{counting_sort, sort_pairs};
#[cfg(feature = "gpu")]
pub use gpu::{GpuRadixSort, RankMethod};
pub use key::SortKey;

use std::ops::Range;

use crate::{Error, Result};

/// Cuts a range of bits into digits of at most `widest` bits, the widths as even as possible: shift and width of each.
fn digits(bits: &Range<u32>, widest: u32) -> Vec<(u32, u32)> {
    let n_bits = bits.end.saturating_sub(bits.start);
    let n_digits = n_bits.div_ceil(widest);
    let mut shift = bits.start;
    (0..n_digits)
        .map(|digit| {
            let width = n_bits / n_digits + u32::from(digit < n_bits % n_digits);
            shift += width;
            (shift - width, width)
        })
        .collect()
}

fn check_bits<K: SortKey>(bits: &Range<u32>) -> Result<()> {
    if bits.start <= bits.end && bits.end <= K::BITS {
        return Ok(());
    }
    let expected = if K::BITS == u32::BITS { "a range within 0..32" } else { "a range within 0..64" };
    let setting = "bits";
    Err(Error::InvalidSetting { setting, found: format!("{bits:?}"), expected })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_tile_the_bits_evenly() {
        assert_eq!(digits(&(0..22), 8), [(0, 8), (8, 7), (15, 7)]);
        assert_eq!(digits(&(0..22), 11), [(0, 11), (11, 11)]);
        assert_eq!(digits(&(5..6), 8), [(5, 1)]);
        assert!(digits(&(7..7), 8).is_empty());
    }

    #[test]
    fn bits_outside_a_key_are_refused() {
        assert!(check_bits::<u32>(&(0..33)).is_err());
        assert!(check_bits::<u64>(&(0..65)).is_err());
        #[allow(clippy::reversed_empty_ranges, reason = "it must be refused")]
        let reversed = 5..4;
        assert!(check_bits::<u32>(&reversed).is_err());
        assert!(check_bits::<u32>(&(0..32)).is_ok());
        assert!(check_bits::<u64>(&(0..64)).is_ok());
    }
}
