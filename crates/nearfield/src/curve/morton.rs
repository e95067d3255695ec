//! Morton keys: the bits of a cell's coordinates interleaved, the first dimension first. `morton.wesl` is the twin.
//!
//! Cell (3, 1, 2) = (11, 01, 10) at two levels has the key 1 0 1, 1 1 0 = 46 (Ajmera2008).

/// Spreads 10 bits to every third place.
#[inline(always)]
fn spread_10(v: u32) -> u32 {
    let mut v = v & 0x3ff;
    v = (v | v << 16) & 0x0300_00ff;
    v = (v | v << 8) & 0x0300_f00f;
    v = (v | v << 4) & 0x030c_30c3;
    (v | v << 2) & 0x0924_9249
}

#[inline(always)]
fn gather_10(v: u32) -> u32 {
    let mut v = v & 0x0924_9249;
    v = (v | v >> 2) & 0x030c_30c3;
    v = (v | v >> 4) & 0x0300_f00f;
    v = (v | v >> 8) & 0x0300_00ff;
    (v | v >> 16) & 0x3ff
}

/// Spreads 21 bits to every third place.
#[inline(always)]
fn spread_21(v: u32) -> u64 {
    let mut v = u64::from(v) & 0x1f_ffff;
    v = (v | v << 32) & 0x001f_0000_0000_ffff;
    v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}

#[inline(always)]
fn gather_21(v: u64) -> u32 {
    let mut v = v & 0x1249_2492_4924_9249;
    v = (v | v >> 2) & 0x10c3_0c30_c30c_30c3;
    v = (v | v >> 4) & 0x100f_00f0_0f00_f00f;
    v = (v | v >> 8) & 0x001f_0000_ff00_00ff;
    v = (v | v >> 16) & 0x001f_0000_0000_ffff;
    ((v | v >> 32) & 0x1f_ffff) as u32
}

/// Spreads 32 bits to every second place.
#[inline(always)]
fn spread_32(v: u32) -> u64 {
    let mut v = u64::from(v);
    v = (v | v << 16) & 0x0000_ffff_0000_ffff;
    v = (v | v << 8) & 0x00ff_00ff_00ff_00ff;
    v = (v | v << 4) & 0x0f0f_0f0f_0f0f_0f0f;
    v = (v | v << 2) & 0x3333_3333_3333_3333;
    (v | v << 1) & 0x5555_5555_5555_5555
}

#[inline(always)]
fn gather_32(v: u64) -> u32 {
    let mut v = v & 0x5555_5555_5555_5555;
    v = (v | v >> 1) & 0x3333_3333_3333_3333;
    v = (v | v >> 2) & 0x0f0f_0f0f_0f0f_0f0f;
    v = (v | v >> 4) & 0x00ff_00ff_00ff_00ff;
    v = (v | v >> 8) & 0x0000_ffff_0000_ffff;
    (v | v >> 16) as u32
}

/// 30-bit key of a cell with 10 bits an axis; higher bits are ignored.
#[inline(always)]
pub fn encode_3d_u32([x, y, z]: [u32; 3]) -> u32 {
    spread_10(x) << 2 | spread_10(y) << 1 | spread_10(z)
}

/// The cell of a 30-bit key.
#[inline(always)]
pub fn decode_3d_u32(key: u32) -> [u32; 3] {
    [gather_10(key >> 2), gather_10(key >> 1), gather_10(key)]
}

/// 63-bit key of a cell with 21 bits an axis; higher bits are ignored.
#[inline(always)]
pub fn encode_3d_u64([x, y, z]: [u32; 3]) -> u64 {
    spread_21(x) << 2 | spread_21(y) << 1 | spread_21(z)
}

/// The cell of a 63-bit key.
#[inline(always)]
pub fn decode_3d_u64(key: u64) -> [u32; 3] {
    [gather_21(key >> 2), gather_21(key >> 1), gather_21(key)]
}

/// 32-bit key of a cell with 16 bits an axis; higher bits are ignored.
#[inline(always)]
pub fn encode_2d_u32([x, y]: [u32; 2]) -> u32 {
    (spread_32(x & 0xffff) << 1 | spread_32(y & 0xffff)) as u32
}

/// The cell of a 32-bit key.
#[inline(always)]
pub fn decode_2d_u32(key: u32) -> [u32; 2] {
    [gather_32(u64::from(key) >> 1), gather_32(u64::from(key))]
}

/// 62-bit key of a cell with 31 bits an axis; higher bits are ignored.
#[inline(always)]
pub fn encode_2d_u64([x, y]: [u32; 2]) -> u64 {
    spread_32(x & 0x7fff_ffff) << 1 | spread_32(y & 0x7fff_ffff)
}

/// The cell of a 62-bit key.
#[inline(always)]
pub fn decode_2d_u64(key: u64) -> [u32; 2] {
    [gather_32(key >> 1), gather_32(key)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_posters_cell_has_the_posters_key() {
        assert_eq!(encode_3d_u32([3, 1, 2]), 46);
        assert_eq!(encode_3d_u64([3, 1, 2]), 46);
        assert_eq!(encode_2d_u32([3, 1]), 0b1011);
    }
}
