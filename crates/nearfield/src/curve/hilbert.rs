//! Hilbert keys: neighbours on the curve share a face. `hilbert.wesl` is the twin of this file.

/// 63-bit key of a cell with 21 bits an axis (Skilling2004).
pub fn encode_3d_u64(cell: [u32; 3]) -> u64 {
    const BITS: u32 = 21;
    let mut x = cell.map(|v| v & 0x1f_ffff);
    let mut q = 1u32 << (BITS - 1);
    while q > 1 {
        let p = q - 1;
        for i in 0..3 {
            if x[i] & q != 0 {
                x[0] ^= p;
            } else {
                let t = (x[0] ^ x[i]) & p;
                x[0] ^= t;
                x[i] ^= t;
            }
        }
        q >>= 1;
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    let mut t = 0;
    let mut q = 1u32 << (BITS - 1);
    while q > 1 {
        if x[2] & q != 0 {
            t ^= q - 1;
        }
        q >>= 1;
    }
    super::morton::encode_3d_u64(x.map(|v| v ^ t))
}

/// The cell of a 63-bit key (Skilling2004).
pub fn decode_3d_u64(key: u64) -> [u32; 3] {
    let mut x = super::morton::decode_3d_u64(key);
    let t = x[2] >> 1;
    x[2] ^= x[1];
    x[1] ^= x[0];
    x[0] ^= t;
    let mut q = 2u32;
    while q != 1 << 21 {
        let p = q - 1;
        for i in (0..3).rev() {
            if x[i] & q != 0 {
                x[0] ^= p;
            } else {
                let t = (x[0] ^ x[i]) & p;
                x[0] ^= t;
                x[i] ^= t;
            }
        }
        q <<= 1;
    }
    x
}
