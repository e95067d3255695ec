//! Keys of cells and cells of keys.

use libtest_mimic::Trial;
use nearfield::curve::{Cell, GpuCurve, Key, hilbert, morton};
use nearfield::{Curve, Error, Gpu};

use crate::support::{Random, gpu_trial, trial};
use crate::{LENGTHS, assert_same};

const SEED: u64 = 20_261_124;
/// Random cells of each test.
const CELLS: usize = 20_000;
/// What stands in every output before a kernel runs.
const POISON: u32 = 0xdead_beef;

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = vec![
        trial("morton_keys_equal_the_loop_over_bits", morton_keys_equal_the_loop_over_bits),
        trial("decoding_undoes_encoding", decoding_undoes_encoding),
        trial("bits_beyond_the_key_are_ignored", bits_beyond_the_key_are_ignored),
        trial("a_prefix_of_a_key_is_the_key_of_the_ancestor", a_prefix_of_a_key_is_the_key_of_the_ancestor),
        trial("a_short_key_is_the_beginning_of_the_long_one", a_short_key_is_the_beginning_of_the_long_one),
        trial("the_curves_visit_every_cell_once", the_curves_visit_every_cell_once),
        trial("neighbors_on_the_hilbert_curve_share_a_face", neighbors_on_the_hilbert_curve_share_a_face),
    ];
    for curve in Curve::ALL {
        trials
            .push(gpu_trial(format!("gpu_keys_equal_the_cpu_{curve}"), move |gpu| gpu_keys_equal_the_cpu(gpu, curve)));
    }
    trials.push(gpu_trial("gpu_keys_leave_what_stands_behind", gpu_keys_leave_what_stands_behind));
    trials.push(gpu_trial("gpu_keys_refuse_what_does_not_fit", gpu_keys_refuse_what_does_not_fit));
    trials
}

/// Bits of the coordinates one after the other, the first dimension first.
fn interleaved<const D: usize>(cell: [u32; D], bits: u32) -> u64 {
    let mut key = 0;
    for level in (0..bits).rev() {
        for coordinate in cell {
            key = key << 1 | u64::from(coordinate >> level & 1);
        }
    }
    key
}

/// Cells with that many bits an axis: all corners of the domain and of its middle, then random ones of every size.
fn cells<const D: usize>(bits: u32, n: usize) -> Vec<[u32; D]> {
    let last = (1u32 << bits) - 1;
    let extremes = [0, 1, last / 2, last / 2 + 1, last - 1, last];
    let n_extremes = extremes.len().pow(D as u32);
    let mut random = Random(SEED);
    (0..n_extremes.max(n))
        .map(|i| {
            if i < n_extremes {
                return std::array::from_fn(|axis| extremes[i / extremes.len().pow(axis as u32) % extremes.len()]);
            }
            let size = random.below(bits + 1);
            std::array::from_fn(|_| random.word() & ((1 << size) - 1))
        })
        .take(n)
        .collect()
}

/// Every cell of a small number of levels.
fn all_cells<const D: usize>(levels: u32) -> impl Iterator<Item = [u32; D]> {
    (0..1u32 << (levels * D as u32))
        .map(move |i| std::array::from_fn(|axis| i >> (levels * axis as u32) & ((1 << levels) - 1)))
}

fn morton_keys_equal_the_loop_over_bits() {
    assert_eq!(interleaved([3, 1, 2], 2), 46, "the poster's example");
    for cell in all_cells::<3>(4).chain(cells(10, CELLS)) {
        assert_eq!(u64::from(morton::encode_3d_u32(cell)), interleaved(cell, 10), "{cell:?}");
    }
    for cell in all_cells::<3>(4).chain(cells(21, CELLS)) {
        assert_eq!(morton::encode_3d_u64(cell), interleaved(cell, 21), "{cell:?}");
    }
    for cell in all_cells::<2>(6).chain(cells(16, CELLS)) {
        assert_eq!(u64::from(morton::encode_2d_u32(cell)), interleaved(cell, 16), "{cell:?}");
    }
    for cell in all_cells::<2>(6).chain(cells(31, CELLS)) {
        assert_eq!(morton::encode_2d_u64(cell), interleaved(cell, 31), "{cell:?}");
    }
}

fn decoding_undoes_encoding() {
    for cell in all_cells::<3>(4).chain(cells(10, CELLS)) {
        assert_eq!(morton::decode_3d_u32(morton::encode_3d_u32(cell)), cell);
        assert_eq!(hilbert::decode_3d_u32(hilbert::encode_3d_u32(cell)), cell);
    }
    for cell in all_cells::<3>(4).chain(cells(21, CELLS)) {
        for curve in Curve::ALL {
            assert_eq!(curve.decode(curve.encode(cell)), cell, "{curve}");
        }
    }
    for cell in all_cells::<2>(6).chain(cells(16, CELLS)) {
        assert_eq!(morton::decode_2d_u32(morton::encode_2d_u32(cell)), cell);
        assert_eq!(hilbert::decode_2d_u32(hilbert::encode_2d_u32(cell)), cell);
    }
    for cell in all_cells::<2>(6).chain(cells(31, CELLS)) {
        assert_eq!(morton::decode_2d_u64(morton::encode_2d_u64(cell)), cell);
        assert_eq!(hilbert::decode_2d_u64(hilbert::encode_2d_u64(cell)), cell);
    }
}

fn bits_beyond_the_key_are_ignored() {
    let mut random = Random(SEED);
    for _ in 0..CELLS {
        let wild: [u32; 3] = std::array::from_fn(|_| random.word());
        let flat = [wild[0], wild[1]];
        for curve in Curve::ALL {
            assert_eq!(curve.encode(wild), curve.encode(wild.map(|c| c & 0x1f_ffff)), "{curve}");
        }
        assert_eq!(morton::encode_3d_u32(wild), morton::encode_3d_u32(wild.map(|c| c & 0x3ff)));
        assert_eq!(hilbert::encode_3d_u32(wild), hilbert::encode_3d_u32(wild.map(|c| c & 0x3ff)));
        assert_eq!(morton::encode_2d_u32(flat), morton::encode_2d_u32(flat.map(|c| c & 0xffff)));
        assert_eq!(hilbert::encode_2d_u32(flat), hilbert::encode_2d_u32(flat.map(|c| c & 0xffff)));
        assert_eq!(morton::encode_2d_u64(flat), morton::encode_2d_u64(flat.map(|c| c & 0x7fff_ffff)));
        assert_eq!(hilbert::encode_2d_u64(flat), hilbert::encode_2d_u64(flat.map(|c| c & 0x7fff_ffff)));
    }
}

fn a_prefix_of_a_key_is_the_key_of_the_ancestor() {
    let mut random = Random(SEED);
    for cell in cells::<3>(21, CELLS) {
        let below = random.below(22);
        let ancestor = cell.map(|c| c >> below << below);
        for curve in Curve::ALL {
            assert_eq!(curve.encode(cell) >> (3 * below), curve.encode(ancestor) >> (3 * below), "{curve} {cell:?}");
        }
    }
    for cell in cells::<2>(31, CELLS) {
        let below = random.below(32);
        let ancestor = cell.map(|c| c >> below << below);
        for encode in [morton::encode_2d_u64, hilbert::encode_2d_u64] {
            assert_eq!(encode(cell) >> (2 * below), encode(ancestor) >> (2 * below), "{cell:?}");
        }
    }
}

fn a_short_key_is_the_beginning_of_the_long_one() {
    for cell in cells::<3>(21, CELLS) {
        let coarse = cell.map(|c| c >> 11);
        assert_eq!(u64::from(morton::encode_3d_u32(coarse)), Curve::Morton.encode(cell) >> 33, "{cell:?}");
        assert_eq!(u64::from(hilbert::encode_3d_u32(coarse)), Curve::Hilbert.encode(cell) >> 33, "{cell:?}");
    }
    for cell in cells::<2>(31, CELLS) {
        let coarse = cell.map(|c| c >> 15);
        assert_eq!(u64::from(morton::encode_2d_u32(coarse)), morton::encode_2d_u64(cell) >> 30, "{cell:?}");
        assert_eq!(u64::from(hilbert::encode_2d_u32(coarse)), hilbert::encode_2d_u64(cell) >> 30, "{cell:?}");
    }
}

fn the_curves_visit_every_cell_once() {
    for levels in 1..=5 {
        let shift = 21 - levels;
        for curve in Curve::ALL {
            let mut keys: Vec<u64> =
                all_cells::<3>(levels).map(|cell| curve.encode(cell.map(|c| c << shift)) >> (3 * shift)).collect();
            keys.sort_unstable();
            assert!(keys.iter().copied().eq(0..1 << (3 * levels)), "{curve} at {levels} levels");
        }
    }
    for levels in 1..=8 {
        let shift = 31 - levels;
        for encode in [morton::encode_2d_u64, hilbert::encode_2d_u64] {
            let mut keys: Vec<u64> =
                all_cells::<2>(levels).map(|cell| encode(cell.map(|c| c << shift)) >> (2 * shift)).collect();
            keys.sort_unstable();
            assert!(keys.iter().copied().eq(0..1 << (2 * levels)), "{levels} levels");
        }
    }
}

fn steps<const D: usize>(a: [u32; D], b: [u32; D]) -> u32 {
    (0..D).map(|axis| a[axis].abs_diff(b[axis])).sum()
}

fn neighbors_on_the_hilbert_curve_share_a_face() {
    for levels in 1..=6 {
        let shift = 21 - levels;
        let at = |key: u64| hilbert::decode_3d_u64(key << (3 * shift)).map(|c| c >> shift);
        for key in 1..1 << (3 * levels) {
            assert_eq!(steps(at(key - 1), at(key)), 1, "key {key} at {levels} levels");
        }
    }
    for levels in 1..=9 {
        let shift = 31 - levels;
        let at = |key: u64| hilbert::decode_2d_u64(key << (2 * shift)).map(|c| c >> shift);
        for key in 1..1 << (2 * levels) {
            assert_eq!(steps(at(key - 1), at(key)), 1, "key {key} at {levels} levels");
        }
    }
    // Also far down, across the borders of every size.
    let mut random = Random(SEED);
    for _ in 0..CELLS {
        let border = 1 << random.below(63);
        let key = (random.bits() >> 1 | border) & !(border - 1);
        assert_eq!(steps(hilbert::decode_3d_u64(key - 1), hilbert::decode_3d_u64(key)), 1, "{key:#o}");
        let key = key >> 1 | 1;
        assert_eq!(steps(hilbert::decode_2d_u64(key - 1), hilbert::decode_2d_u64(key)), 1, "{key:#x}");
    }
}

/// Encodes on both sides, and decodes what the CPU encoded.
fn compare<C, K>(plan: &GpuCurve, cells: &[C], encode: impl Fn(C) -> K, case: &str)
where
    C: Cell + PartialEq + std::fmt::Debug,
    K: Key + PartialEq + std::fmt::Debug,
{
    let keys: Vec<K> = cells.iter().map(|&cell| encode(cell)).collect();
    assert_same(&plan.encode::<C, K>(cells).unwrap(), &keys, &format!("keys {case}"));
    assert_same(&plan.decode::<C, K>(&keys).unwrap(), cells, &format!("cells {case}"));
}

fn gpu_keys_equal_the_cpu(gpu: &Gpu, curve: Curve) {
    let plan = GpuCurve::new(gpu, curve);
    let is_morton = curve == Curve::Morton;
    for n in LENGTHS.into_iter().chain([CELLS]) {
        let case = |what: &str| format!("{what}, {n} of them");
        let encode = if is_morton { morton::encode_3d_u32 } else { hilbert::encode_3d_u32 };
        compare(&plan, &cells::<3>(10, n), encode, &case("in 3-D of 30 bits"));
        compare(&plan, &cells::<3>(21, n), |cell| curve.encode(cell), &case("in 3-D of 63 bits"));
        let encode = if is_morton { morton::encode_2d_u32 } else { hilbert::encode_2d_u32 };
        compare(&plan, &cells::<2>(16, n), encode, &case("in 2-D of 32 bits"));
        let encode = if is_morton { morton::encode_2d_u64 } else { hilbert::encode_2d_u64 };
        compare(&plan, &cells::<2>(31, n), encode, &case("in 2-D of 62 bits"));
    }
    // Higher bits than a key has.
    let mut random = Random(SEED);
    let wild: Vec<[u32; 3]> = (0..CELLS).map(|_| std::array::from_fn(|_| random.word())).collect();
    let expected: Vec<u64> = wild.iter().map(|&cell| curve.encode(cell)).collect();
    assert_same(&plan.encode::<_, u64>(&wild).unwrap(), &expected, "keys of cells outside");
}

fn gpu_keys_leave_what_stands_behind(gpu: &Gpu) {
    let plan = GpuCurve::new(gpu, Curve::Hilbert);
    let cells = gpu.upload("cells", &cells::<3>(10, 700)).unwrap();
    let keys = gpu.upload("poisoned keys", &[POISON; 700]).unwrap();
    let mut commands = gpu.commands("keys");
    plan.record_encode(&mut commands, &cells, &keys, 300).unwrap();
    commands.submit().unwrap();
    let keys = gpu.read(&keys).unwrap();
    assert!(keys[..300].iter().all(|&key| key >> 30 == 0) && keys[300..].iter().all(|&key| key == POISON));
}

fn gpu_keys_refuse_what_does_not_fit(gpu: &Gpu) {
    let plan = GpuCurve::new(gpu, Curve::Morton);
    let cells = gpu.buffer::<[u32; 3]>("cells", 10).unwrap();
    let keys = gpu.buffer::<u64>("keys", 9).unwrap();
    let mut commands = gpu.commands("keys");
    let found = plan.record_encode(&mut commands, &cells, &keys, 10);
    assert!(matches!(found, Err(Error::LengthMismatch { found: 9, expected: 10, .. })), "{found:?}");
    let found = plan.record_decode(&mut commands, &keys, &cells, 10);
    assert!(matches!(found, Err(Error::LengthMismatch { found: 9, expected: 10, .. })), "{found:?}");
    assert!(plan.record_encode(&mut commands, &cells, &keys, 9).is_ok());
}
