//! The radix sort and the counting sort on the CPU.
//!
//! Threads scatter into shared arrays of relaxed atomics: plain stores on every processor, and safe, as no two threads
//! ever get the same place.
//!
//! Why not a crate: 5 M pairs took 110 ms by u32 and 259 ms by u64 keys here, 41 and 140 ms with rdst 0.20, and 267 and
//! 361 ms with rayon's stable sort (two cores shared with other work, one run, best of 15). rdst promises no stable order,
//! takes whole keys and no range of bits, and wants pairs in one array.

use std::ops::Range;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicU32, AtomicU64};

use rayon::prelude::*;

use super::{SortKey, check_bits, digits};
use crate::parallel::chunk_len;
use crate::{Error, Result};

/// Bits of a digit. With 11 bits there are fewer passes, but 5 M pairs took 1.2 times as long on two cores.
const WIDEST_DIGIT: u32 = 8;
/// Below this length a comparison sort is faster.
const SMALLEST_RADIX_SORT: usize = 1024;
/// Chunks below this length cost more to hand out than to sort.
const SMALLEST_CHUNK: usize = 16_384;

/// Sorts pairs in place: ascending by the bits `bits` of the key, pairs with equal bits in their former order.
///
/// Digits that are the same in every key cost one look at the keys and no move.
///
/// # Errors
/// `LengthMismatch` if there is not one value a key, `InvalidSetting` for bits beyond those of the key,
/// `TooMany` beyond 2³² - 1 pairs.
pub fn sort_pairs<K: SortKey>(keys: &mut Vec<K>, values: &mut Vec<u32>, bits: Range<u32>) -> Result<()> {
    check_bits::<K>(&bits)?;
    if keys.len() != values.len() {
        let (found, expected) = (values.len() as u64, keys.len() as u64);
        return Err(Error::LengthMismatch { what: "values to sort", found, expected });
    }
    let (found, limit) = (keys.len() as u64, u64::from(u32::MAX));
    if found > limit {
        return Err(Error::TooMany { what: "pairs to sort", found, limit, advice: "sort in parts" });
    }
    if keys.len() < SMALLEST_RADIX_SORT {
        sort_few_pairs(keys, values, &bits);
        return Ok(());
    }
    let passes: Vec<_> = digits(&bits, WIDEST_DIGIT).into_iter().filter(|digit| varies(keys, *digit)).collect();
    let n = keys.len();
    // The pairs go from the caller's memory to other memory and back: fresh memory costs its page faults.
    let sorted = match passes.len() {
        0 => return Ok(()),
        1 => {
            let target = Apart::zeroed(n);
            move_pairs(n, passes[0], &(&keys[..], &values[..]), &target);
            target
        }
        n_passes => {
            let own = Apart::<K> { keys: shared(keys), values: shared(values) };
            let other = K::Between::zeroed(n);
            let (round_trip, others) = passes.split_at(if n_passes % 2 == 1 { 3 } else { 2 });
            move_pairs(n, round_trip[0], &own, &other);
            if let [_, second, third] = *round_trip {
                let third_place = K::Between::zeroed(n);
                move_pairs(n, second, &other, &third_place);
                move_pairs(n, third, &third_place, &own);
            } else {
                move_pairs(n, round_trip[1], &other, &own);
            }
            for pair in others.chunks_exact(2) {
                move_pairs(n, pair[0], &own, &other);
                move_pairs(n, pair[1], &other, &own);
            }
            own
        }
    };
    *keys = plain(sorted.keys);
    *values = plain(sorted.values);
    Ok(())
}

/// One pass: the stable counting sort by one digit.
fn move_pairs<K: CpuKey>(n: usize, digit: (u32, u32), from: &impl PairSource<K>, to: &impl PairTarget<K>) {
    scatter(
        n,
        chunk_len(n, SMALLEST_CHUNK),
        1 << digit.1,
        |i| from.key(i).digit(digit),
        |i, place| to.put(place, from.pair(i)),
    );
}

/// What the CPU sort does with a key.
pub(super) trait CpuKey: Copy + Send + Sync {
    /// A word that threads share.
    type Shared: Shared<Word = Self>;
    /// The pairs between two passes.
    type Between: PairSource<Self> + PairTarget<Self>;

    fn wide(self) -> u64;

    /// The `width` bits from bit `shift` on.
    fn digit(self, (shift, width): (u32, u32)) -> usize {
        ((self.wide() >> shift) & ((1 << width) - 1)) as usize
    }
}

impl CpuKey for u32 {
    type Shared = AtomicU32;
    type Between = Packed;

    #[inline]
    fn wide(self) -> u64 {
        u64::from(self)
    }
}

impl CpuKey for u64 {
    type Shared = AtomicU64;
    type Between = Apart<Self>;

    #[inline]
    fn wide(self) -> u64 {
        self
    }
}

/// Where pairs come from.
pub(super) trait PairSource<K>: Sync {
    fn key(&self, i: usize) -> K;
    fn pair(&self, i: usize) -> (K, u32);
}

/// Where pairs go to.
pub(super) trait PairTarget<K>: Sync {
    fn zeroed(n: usize) -> Self;
    fn put(&self, place: usize, pair: (K, u32));
}

impl<K: Copy + Sync> PairSource<K> for (&[K], &[u32]) {
    #[inline]
    fn key(&self, i: usize) -> K {
        self.0[i]
    }

    #[inline]
    fn pair(&self, i: usize) -> (K, u32) {
        (self.0[i], self.1[i])
    }
}

/// Pairs of words, key above value: one store moves a pair.
pub(super) struct Packed(Vec<AtomicU64>);

impl PairSource<u32> for Packed {
    #[inline]
    fn key(&self, i: usize) -> u32 {
        (self.0[i].load(Relaxed) >> 32) as u32
    }

    #[inline]
    fn pair(&self, i: usize) -> (u32, u32) {
        let pair = self.0[i].load(Relaxed);
        ((pair >> 32) as u32, pair as u32)
    }
}

impl PairTarget<u32> for Packed {
    fn zeroed(n: usize) -> Self {
        Self(zeroed(n))
    }

    #[inline]
    fn put(&self, place: usize, (key, value): (u32, u32)) {
        self.0[place].store(u64::from(key) << 32 | u64::from(value), Relaxed);
    }
}

/// Keys and values in an array each.
pub(super) struct Apart<K: CpuKey> {
    keys: Vec<K::Shared>,
    values: Vec<AtomicU32>,
}

impl<K: CpuKey> PairSource<K> for Apart<K> {
    #[inline]
    fn key(&self, i: usize) -> K {
        self.keys[i].load()
    }

    #[inline]
    fn pair(&self, i: usize) -> (K, u32) {
        (self.keys[i].load(), Shared::load(&self.values[i]))
    }
}

impl<K: CpuKey> PairTarget<K> for Apart<K> {
    fn zeroed(n: usize) -> Self {
        Self { keys: zeroed(n), values: zeroed(n) }
    }

    #[inline]
    fn put(&self, place: usize, (key, value): (K, u32)) {
        self.keys[place].store(key);
        Shared::store(&self.values[place], value);
    }
}

/// A relaxed atomic.
pub(super) trait Shared: Default + Send + Sync {
    type Word: Send;
    fn load(&self) -> Self::Word;
    fn store(&self, word: Self::Word);
    fn of_word(word: Self::Word) -> Self;
    fn into_word(self) -> Self::Word;
}

macro_rules! shared {
    ($atomic:ty, $word:ty) => {
        impl Shared for $atomic {
            type Word = $word;

            #[inline]
            fn load(&self) -> $word {
                self.load(Relaxed)
            }

            #[inline]
            fn store(&self, word: $word) {
                self.store(word, Relaxed);
            }

            #[inline]
            fn of_word(word: $word) -> Self {
                Self::new(word)
            }

            #[inline]
            fn into_word(self) -> $word {
                self.into_inner()
            }
        }
    };
}

shared!(AtomicU32, u32);
shared!(AtomicU64, u64);

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
    let order: Vec<AtomicU32> = zeroed(keys.len());
    // Every chunk counts all keys: chunks much shorter than that would spend their time on counters.
    let chunk = chunk_len(keys.len(), SMALLEST_CHUNK.max(4 * n_keys));
    let mut offsets = scatter(
        keys.len(),
        chunk,
        n_keys,
        |i| keys[i] as usize,
        |i, place| {
            Shared::store(&order[place], i as u32);
        },
    );
    offsets.push(keys.len() as u32);
    Ok((offsets, plain(order)))
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

fn sort_few_pairs<K: CpuKey>(keys: &mut [K], values: &mut [u32], bits: &Range<u32>) {
    let mut pairs: Vec<(K, u32)> = keys.iter().copied().zip(values.iter().copied()).collect();
    let mask = u64::MAX.checked_shr(u64::BITS - (bits.end - bits.start)).unwrap_or(0);
    pairs.sort_by_key(|&(key, _)| key.wide().checked_shr(bits.start).unwrap_or(0) & mask);
    for ((key, value), pair) in keys.iter_mut().zip(values).zip(pairs) {
        (*key, *value) = pair;
    }
}

fn varies<K: CpuKey>(keys: &[K], digit: (u32, u32)) -> bool {
    keys.first().is_some_and(|&first| keys.par_iter().any(|&key| key.digit(digit) != first.digit(digit)))
}

/// All threads share the first touch of the pages.
fn zeroed<S: Shared>(n: usize) -> Vec<S> {
    (0..n).into_par_iter().with_min_len(SMALLEST_CHUNK).map(|_| S::default()).collect()
}

/// The same memory as words that threads share.
fn shared<S: Shared>(words: &mut Vec<S::Word>) -> Vec<S> {
    std::mem::take(words).into_iter().map(S::of_word).collect()
}

fn plain<S: Shared>(words: Vec<S>) -> Vec<S::Word> {
    words.into_iter().map(S::into_word).collect()
}
