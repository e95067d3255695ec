//! Colours as files have them, as bytes.

/// A channel in 0 … 1 as a byte; outside values are clamped, NaN is 0.
pub(crate) fn from_unit(value: f64) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}

/// A channel in 0 … 255 as a byte; outside values are clamped, NaN is 0.
pub(crate) fn from_byte_range(value: f64) -> u8 {
    value.clamp(0.0, 255.0).round() as u8
}

/// The colour channel a column name stands for: 0 red, 1 green, 2 blue, 3 alpha.
pub(crate) fn channel(name: &str) -> Option<usize> {
    let name = name.to_ascii_lowercase();
    let name = name.strip_prefix("diffuse_").unwrap_or(&name);
    match name {
        "red" | "r" => Some(0),
        "green" | "g" => Some(1),
        "blue" | "b" => Some(2),
        "alpha" | "a" => Some(3),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_survives_the_way_through_the_unit_range() {
        for byte in 0..=255u8 {
            assert_eq!(from_unit(f64::from(byte) / 255.0), byte);
            assert_eq!(from_byte_range(f64::from(byte)), byte);
        }
        assert_eq!([from_unit(f64::NAN), from_unit(7.0), from_byte_range(-1.0)], [0, 255, 0]);
    }
}
