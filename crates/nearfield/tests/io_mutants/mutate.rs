//! Damage to files: flipped bits, extreme integers and numbers, cuts and splices, half of them near the start.

/// How far the part of a file reaches that headers are in.
const HEAD: usize = 400;

const INTEGERS_32: [u32; 8] = [0, 1, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 0xffff_fffe, 0x0100_0000, 0x7f80_0000];
const INTEGERS_64: [u64; 6] = [0, u64::MAX, i64::MAX as u64, 1 << 32, 1 << 40, 0x7ff0_0000_0000_0000];
const TOKENS: [&str; 12] = [
    "4294967295",
    "18446744073709551615",
    "18446744073709551616",
    "-1",
    "0",
    "nan",
    "inf",
    "1e999",
    "-1e999",
    "1e-999",
    "abc",
    "",
];

/// A small random generator (SplitMix64): the same numbers on every machine.
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(0x5eed))
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number below `n`; 0 where `n` is 0.
    fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }
}

/// A copy of `seed` with 1 to 3 damages.
pub(crate) fn mutant(seed: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..=random.below(3) {
        damage(&mut bytes, random);
    }
    bytes
}

fn damage(bytes: &mut Vec<u8>, random: &mut Random) {
    let reach = if random.below(2) == 0 { bytes.len().min(HEAD) } else { bytes.len() };
    let at = random.below(reach);
    match random.below(10) {
        0..3 => {
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << random.below(8);
            }
        }
        3 | 4 => overwrite(bytes, at, &INTEGERS_32[random.below(INTEGERS_32.len())].to_le_bytes()),
        5 => overwrite(bytes, at, &INTEGERS_64[random.below(INTEGERS_64.len())].to_le_bytes()),
        6 | 7 => replace_number(bytes, at, TOKENS[random.below(TOKENS.len())]),
        8 => bytes.truncate(random.below(bytes.len() + 1)),
        _ => {
            let (from, to) = (random.below(bytes.len() + 1), random.below(bytes.len() + 1));
            let end = (from + random.below(64)).min(bytes.len());
            let piece = bytes[from..end].to_vec();
            bytes.splice(to..to, piece);
        }
    }
}

fn overwrite(bytes: &mut [u8], at: usize, value: &[u8]) {
    for (byte, new) in bytes.iter_mut().skip(at).zip(value) {
        *byte = *new;
    }
}

/// Puts `token` in place of the next run of digits.
fn replace_number(bytes: &mut Vec<u8>, at: usize, token: &str) {
    let digit = |b: &u8| b.is_ascii_digit();
    if let Some(start) = bytes.iter().skip(at).position(digit).map(|i| at + i) {
        let length = bytes[start..].iter().take_while(|b| digit(b)).count();
        bytes.splice(start..start + length, token.bytes());
    }
}
