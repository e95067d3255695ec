//! Hilbert keys: neighbours on the curve share a face. `hilbert.wesl` is the twin of this file.
//!
//! At each level the bits of a cell's coordinates are looked at in a frame: axes exchanged and mirrored. Read as a Gray
//! code they give the digit of the key, and they turn the frame for the level below. The frame of level 0 is that of
//! space, so a key's prefix is the ancestor's key at any number of levels, and a short key is the beginning of a long
//! one. The curve is that of Skilling2004; there all levels of one axis are turned at once, here one level after the
//! other.
//!
//! Few frames occur: tables hold the digits and the next frame for several levels at a time. They are made from
//! the plain definition when the library is compiled, 24 KB in three dimensions for each direction.

use super::morton;

/// Levels of one look-up: 9 bits of a key in three dimensions, 8 in two.
const LEVELS_3D: usize = 3;
const LEVELS_2D: usize = 4;
/// Frames that occur.
const FRAMES_3D: usize = 24;
const FRAMES_2D: usize = 4;

/// By frame and bits of a Morton key: bits of the Hilbert key, and above them the frame behind.
static ENCODE_3D: [[u16; 1 << (3 * LEVELS_3D)]; FRAMES_3D] = table(3, LEVELS_3D, false);
static ENCODE_2D: [[u16; 1 << (2 * LEVELS_2D)]; FRAMES_2D] = table(2, LEVELS_2D, false);
/// By frame and bits of a Hilbert key: bits of the Morton key, and above them the frame behind.
static DECODE_3D: [[u16; 1 << (3 * LEVELS_3D)]; FRAMES_3D] = table(3, LEVELS_3D, true);
static DECODE_2D: [[u16; 1 << (2 * LEVELS_2D)]; FRAMES_2D] = table(2, LEVELS_2D, true);

/// What stands at each place of a frame: an axis of space, and whether it runs backwards.
#[derive(Clone, Copy)]
struct Frame {
    axes: [usize; 3],
    mirrored: [bool; 3],
}

impl Frame {
    const OF_SPACE: Self = Self { axes: [0, 1, 2], mirrored: [false; 3] };

    /// Digit of the child with these bits of its coordinates, the first axis highest, and the child's frame.
    const fn step(mut self, dimensions: usize, bits: usize) -> (usize, Self) {
        let mut seen = [false; 3];
        let (mut digit, mut odd) = (0, false);
        let mut place = 0;
        while place < dimensions {
            let bit = bits >> (dimensions - 1 - self.axes[place]) & 1 == 1;
            seen[place] = bit != self.mirrored[place];
            odd ^= seen[place];
            digit = digit << 1 | odd as usize;
            place += 1;
        }
        place = 0;
        while place < dimensions {
            if seen[place] {
                self.mirrored[0] = !self.mirrored[0];
            } else {
                self.axes.swap(0, place);
                self.mirrored.swap(0, place);
            }
            place += 1;
        }
        self.mirrored[0] ^= odd;
        (digit, self)
    }

    const fn equals(&self, other: &Self) -> bool {
        let mut place = 0;
        while place < 3 {
            if self.axes[place] != other.axes[place] || self.mirrored[place] != other.mirrored[place] {
                return false;
            }
            place += 1;
        }
        true
    }
}

/// The digits of several levels in one look-up, from [`Frame::step`].
const fn table<const FRAMES: usize, const SIZE: usize>(
    dimensions: usize,
    levels: usize,
    inverse: bool,
) -> [[u16; SIZE]; FRAMES] {
    // Number every frame that occurs, in the order in which they are met: digit and next frame of each child.
    let mut frames = [Frame::OF_SPACE; FRAMES];
    let mut steps = [[(0, 0); 8]; FRAMES];
    let (mut n_frames, mut frame) = (1, 0);
    while frame < n_frames {
        let mut bits = 0;
        while bits < 1 << dimensions {
            let (digit, next) = frames[frame].step(dimensions, bits);
            let mut number = 0;
            while number < n_frames && !frames[number].equals(&next) {
                number += 1;
            }
            if number == n_frames {
                frames[number] = next;
                n_frames += 1;
            }
            steps[frame][bits] = (digit, number);
            bits += 1;
        }
        frame += 1;
    }
    assert!(n_frames == FRAMES);

    let mut table = [[0; SIZE]; FRAMES];
    frame = 0;
    while frame < FRAMES {
        let mut word = 0;
        while word < SIZE {
            let (mut key, mut behind) = (0, frame);
            let mut level = levels;
            while level > 0 {
                level -= 1;
                let (digit, next) = steps[behind][word >> (dimensions * level) & ((1 << dimensions) - 1)];
                key = key << dimensions | digit;
                behind = next;
            }
            let (from, to) = if inverse { (key, word) } else { (word, key) };
            table[frame][from] = (behind * SIZE + to) as u16;
            word += 1;
        }
        frame += 1;
    }
    table
}

/// Replaces the lowest `steps` groups of bits of a word, the highest first.
#[inline(always)]
fn follow<const SIZE: usize>(table: &[[u16; SIZE]], word: u64, steps: u32) -> u64 {
    let width = SIZE.ilog2();
    let (mut frame, mut out) = (0, 0);
    for step in (0..steps).rev() {
        let entry = table[frame][(word >> (width * step)) as usize % SIZE] as usize;
        out = out << width | (entry % SIZE) as u64;
        frame = entry / SIZE;
    }
    out
}

/// 30-bit key of a cell with 10 bits an axis; higher bits are ignored.
#[inline]
pub fn encode_3d_u32(cell: [u32; 3]) -> u32 {
    // Two levels more, to fill the last look-up.
    (follow(&ENCODE_3D, u64::from(morton::encode_3d_u32(cell)) << 6, 4) >> 6) as u32
}

/// The cell of a 30-bit key.
#[inline]
pub fn decode_3d_u32(key: u32) -> [u32; 3] {
    morton::decode_3d_u32((follow(&DECODE_3D, u64::from(key) << 6, 4) >> 6) as u32)
}

/// 63-bit key of a cell with 21 bits an axis; higher bits are ignored.
#[inline]
pub fn encode_3d_u64(cell: [u32; 3]) -> u64 {
    follow(&ENCODE_3D, morton::encode_3d_u64(cell), 7)
}

/// The cell of a 63-bit key.
#[inline]
pub fn decode_3d_u64(key: u64) -> [u32; 3] {
    morton::decode_3d_u64(follow(&DECODE_3D, key, 7))
}

/// 32-bit key of a cell with 16 bits an axis; higher bits are ignored.
#[inline]
pub fn encode_2d_u32(cell: [u32; 2]) -> u32 {
    follow(&ENCODE_2D, u64::from(morton::encode_2d_u32(cell)), 4) as u32
}

/// The cell of a 32-bit key.
#[inline]
pub fn decode_2d_u32(key: u32) -> [u32; 2] {
    morton::decode_2d_u32(follow(&DECODE_2D, u64::from(key), 4) as u32)
}

/// 62-bit key of a cell with 31 bits an axis; higher bits are ignored.
#[inline]
pub fn encode_2d_u64(cell: [u32; 2]) -> u64 {
    // One level more, to fill the last look-up.
    follow(&ENCODE_2D, morton::encode_2d_u64(cell) << 2, 8) >> 2
}

/// The cell of a 62-bit key.
#[inline]
pub fn decode_2d_u64(key: u64) -> [u32; 2] {
    morton::decode_2d_u64(follow(&DECODE_2D, key << 2, 8) >> 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Skilling2004 as published: all levels of one axis at once, for any number of axes and levels.
    fn skilling<const D: usize>(mut x: [u32; D], levels: u32) -> u64 {
        for level in (1..levels).rev() {
            let below = (1u32 << level) - 1;
            for i in 0..D {
                if x[i] >> level & 1 == 1 {
                    x[0] ^= below;
                } else {
                    let exchanged = (x[0] ^ x[i]) & below;
                    x[0] ^= exchanged;
                    x[i] ^= exchanged;
                }
            }
        }
        for i in 1..D {
            x[i] ^= x[i - 1];
        }
        let flipped =
            (1..levels).filter(|&level| x[D - 1] >> level & 1 == 1).fold(0, |t, level| t ^ ((1 << level) - 1));
        let bit = |level: u32, i: usize| u64::from((x[i] ^ flipped) >> level & 1);
        (0..levels).rev().flat_map(|level| (0..D).map(move |i| (level, i))).fold(0, |key, (l, i)| key << 1 | bit(l, i))
    }

    #[test]
    fn the_curve_is_that_of_skilling() {
        let mut v = 1u64;
        for _ in 0..10_000 {
            v = v.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let word = |shift: u32| (v >> shift) as u32;
            let cell = [word(0), word(21), word(42)].map(|c| c & 0x1f_ffff);
            assert_eq!(encode_3d_u64(cell), skilling(cell, 21), "{cell:?}");
            let cell = cell.map(|c| c & 0x3ff);
            assert_eq!(u64::from(encode_3d_u32(cell)), skilling(cell, 10), "{cell:?}");
            let cell = [word(1), word(32)].map(|c| c & 0x7fff_ffff);
            assert_eq!(encode_2d_u64(cell), skilling(cell, 31), "{cell:?}");
            let cell = cell.map(|c| c & 0xffff);
            assert_eq!(u64::from(encode_2d_u32(cell)), skilling(cell, 16), "{cell:?}");
        }
    }
}
