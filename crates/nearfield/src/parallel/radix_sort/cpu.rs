//! The radix sort and the counting sort on the CPU.
//!
//! Threads scatter into shared arrays of relaxed atomics: plain stores on every processor, and safe, as no two threads
//! ever get the same place.

use std::ops::Range;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicU32, AtomicU64};

use rayon::prelude::*;

use super::{check_bits, digits};
use crate::parallel::chunk_len;
use crate::{Error, Result};

/// Bits of a digit: 2,048 streams of output still fit into the second-level cache.
const WIDEST_DIGIT: u32 = 11;
/// Below this length a comparison sort is faster.
const SMALLEST_RADIX_SORT: usize = 1024;
/// Chunks below this length cost more to hand out than to sort.
const SMALLEST_CHUNK: usize = 16_384;

/// Sorts pairs in place: ascending by the bits `bits` of the key, pairs with equal bits in their former order.
///
/// Digits that are the same in every key cost one look at the keys and no move.
///
/// # Errors
/// `LengthMismatch` if there is not one value a key, `InvalidSetting` for bits beyond 32.
pub fn sort_pairs(keys: &mut Vec<u32>, values: &mut Vec<u32>, bits: Range<u32>) -> Result<()> {
    check_bits(&bits)?;
    if keys.len() != values.len() {
        let (found, expected) = (values.len() as u64, keys.len() as u64);
        return Err(Error::LengthMismatch { what: "values to sort", found, expected });
    }
    if keys.len() < SMALLEST_RADIX_SORT {
        sort_few_pairs(keys, values, &bits);
        return Ok(());
    }
    let passes: Vec<_> =
        digits(&bits, WIDEST_DIGIT).into_iter().filter(|digit| varies(keys, digit_of(*digit))).collect();
    let Some((&last, others)) = passes.split_last() else { return Ok(()) };
    let n = keys.len();
    let chunk = chunk_len(n, SMALLEST_CHUNK);

    // Between passes a pair is one 64-bit word, key above value: one store moves it.
    let mut packed: Option<Vec<AtomicU64>> = None;
    for &digit in others {
        let key_digit = digit_of(digit);
        let (target, n_digits) = (zeroed_pairs(n), 1 << digit.1);
        match &packed {
            None => {
                let of_pair = |i: usize| key_digit(keys[i]);
                scatter(n, chunk, n_digits, of_pair, |i, place| {
                    target[place].store(u64::from(keys[i]) << 32 | u64::from(values[i]), Relaxed);
                });
            }
            Some(pairs) => {
                let of_pair = |i: usize| key_digit((pairs[i].load(Relaxed) >> 32) as u32);
                scatter(n, chunk, n_digits, of_pair, |i, place| {
                    target[place].store(pairs[i].load(Relaxed), Relaxed);
                });
            }
        }
        packed = Some(target);
    }
    let (sorted_keys, sorted_values) = (zeroed_words(n), zeroed_words(n));
    let (key_digit, n_digits) = (digit_of(last), 1 << last.1);
    match &packed {
        None => {
            let of_pair = |i: usize| key_digit(keys[i]);
            scatter(n, chunk, n_digits, of_pair, |i, place| {
                sorted_keys[place].store(keys[i], Relaxed);
                sorted_values[place].store(values[i], Relaxed);
            });
        }
        Some(pairs) => {
            let of_pair = |i: usize| key_digit((pairs[i].load(Relaxed) >> 32) as u32);
            scatter(n, chunk, n_digits, of_pair, |i, place| {
                let pair = pairs[i].load(Relaxed);
                sorted_keys[place].store((pair >> 32) as u32, Relaxed);
                sorted_values[place].store(pair as u32, Relaxed);
            });
        }
    }
    *keys = plain_words(sorted_keys);
    *values = plain_words(sorted_values);
    Ok(())
}

/// Groups the indices of `keys` by key, for keys below a small `n_keys` (up to some thousands).
///
/// Returns the start of each group `[n_keys + 1]` and the indices `[n]`, ascending within a group.
///
/// # Errors
/// `TooMany` for a key that is not below `n_keys`, and beyond 2³² - 1 keys.
pub fn counting_sort(keys: &[u32], n_keys: usize) -> Result<(Vec<u32>, Vec<u32>)> {
    let advice = "keys must be below the number of keys, and fewer than 2^32";
    if let Some(&key) = keys.par_iter().find_first(|&&key| key as usize >= n_keys) {
        let (found, limit) = (u64::from(key), (n_keys as u64).saturating_sub(1));
        return Err(Error::TooMany { what: "key to group by", found, limit, advice });
    }
    let limit = u64::from(u32::MAX);
    if keys.len() as u64 > limit {
        return Err(Error::TooMany { what: "keys to group", found: keys.len() as u64, limit, advice });
    }
    let order = zeroed_words(keys.len());
    // Every chunk counts all keys: chunks much shorter than that would spend their time on counters.
    let chunk = chunk_len(keys.len(), SMALLEST_CHUNK.max(4 * n_keys));
    let mut offsets = scatter(
        keys.len(),
        chunk,
        n_keys,
        |i| keys[i] as usize,
        |i, place| {
            order[place].store(i as u32, Relaxed);
        },
    );
    offsets.push(keys.len() as u32);
    Ok((offsets, plain_words(order)))
}

/// The stable counting sort of `n` elements: calls `put` with every element and its place, chunks in parallel.
/// Returns the first place of each digit.
fn scatter(
    n: usize,
    chunk: usize,
    n_digits: usize,
    digit: impl Fn(usize) -> usize + Sync,
    put: impl Fn(usize, usize) + Sync,
) -> Vec<u32> {
    let chunks: Vec<Range<usize>> = (0..n).step_by(chunk).map(|start| start..n.min(start + chunk)).collect();
    let mut counts: Vec<Vec<u32>> = chunks
        .par_iter()
        .map(|range| {
            let mut counts = vec![0; n_digits];
            range.clone().for_each(|i| counts[digit(i)] += 1);
            counts
        })
        .collect();
    let mut starts = Vec::with_capacity(n_digits);
    let mut place = 0;
    for d in 0..n_digits {
        starts.push(place);
        for counts in &mut counts {
            place += std::mem::replace(&mut counts[d], place);
        }
    }
    chunks.par_iter().zip(counts.par_iter_mut()).for_each(|(range, next)| {
        for i in range.clone() {
            let next = &mut next[digit(i)];
            put(i, *next as usize);
            *next += 1;
        }
    });
    starts
}

fn sort_few_pairs(keys: &mut [u32], values: &mut [u32], bits: &Range<u32>) {
    let n_bits = bits.end - bits.start;
    let mask = (1u64 << n_bits) - 1;
    let mut pairs: Vec<(u32, u32)> = keys.iter().copied().zip(values.iter().copied()).collect();
    pairs.sort_by_key(|&(key, _)| (u64::from(key) >> bits.start) & mask);
    for ((key, value), pair) in keys.iter_mut().zip(values).zip(pairs) {
        (*key, *value) = pair;
    }
}

fn digit_of((shift, width): (u32, u32)) -> impl Fn(u32) -> usize + Sync + Copy {
    let mask = (1u32 << width) - 1;
    move |key| ((key >> shift) & mask) as usize
}

fn varies(keys: &[u32], digit: impl Fn(u32) -> usize + Sync) -> bool {
    keys.first().is_some_and(|&first| keys.par_iter().any(|&key| digit(key) != digit(first)))
}

fn zeroed_pairs(n: usize) -> Vec<AtomicU64> {
    std::iter::repeat_with(|| AtomicU64::new(0)).take(n).collect()
}

fn zeroed_words(n: usize) -> Vec<AtomicU32> {
    std::iter::repeat_with(|| AtomicU32::new(0)).take(n).collect()
}

fn plain_words(words: Vec<AtomicU32>) -> Vec<u32> {
    words.into_iter().map(AtomicU32::into_inner).collect()
}
