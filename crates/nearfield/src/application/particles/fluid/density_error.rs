//! How much denser than at rest a fluid is.

/// Mean and largest compression of particles, given their densities in parts of that at rest; thinner ones count as 0.
pub(in crate::application::particles) fn density_error(fillings: impl Iterator<Item = f64>) -> [f64; 2] {
    let (mut count, mut sum, mut largest) = (0u64, 0.0, 0.0);
    for filling in fillings {
        let compression = (filling - 1.0).max(0.0);
        count += 1;
        sum += compression;
        largest = f64::max(largest, compression);
    }
    [sum / count.max(1) as f64, largest]
}
