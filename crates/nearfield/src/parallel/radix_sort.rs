//! stand-in
/// stand-in
pub fn sort_pairs(keys: &mut Vec<u32>, values: &mut Vec<u32>, _bits: u32) {
    let mut pairs: Vec<u64> =
        keys.iter().zip(values.iter()).map(|(&k, &v)| u64::from(k) << 32 | u64::from(v)).collect();
    rayon::slice::ParallelSliceMut::par_sort_unstable(&mut pairs[..]);
    *keys = pairs.iter().map(|&p| (p >> 32) as u32).collect();
    *values = pairs.iter().map(|&p| p as u32).collect();
}
