//! Colours for values: a scale from dark violet to yellow, and distinct colours for cells.

/// The viridis scale of Matplotlib (van der Walt and Smith 2015), as a sextic fit to its published table: within 0.015
/// of it everywhere. `t` in 0 … 1.
pub(crate) fn viridis(t: f32) -> [u8; 3] {
    const FIT: [[f32; 3]; 7] = [
        [0.277_727_3, 0.005_407_345, 0.334_099_8],
        [0.105_093_04, 1.404_613_5, 1.384_590_1],
        [-0.330_861_83, 0.214_847_56, 0.095_095_16],
        [-4.634_230_5, -5.799_101, -19.332_441],
        [6.228_27, 14.179_933, 56.690_55],
        [4.776_385, -13.745_146, -65.353_035],
        [-5.435_456, 4.645_852_6, 26.312_435],
    ];
    let t = t.clamp(0.0, 1.0);
    [0, 1, 2].map(|c| {
        let value = FIT.iter().rev().fold(0.0, |sum, row| sum * t + row[c]);
        (value.clamp(0.0, 1.0) * 255.0).round() as u8
    })
}

/// Accel's scale: green for nothing, red for the most. `t` in 0 … 1.
pub(crate) fn green_to_red(t: f32) -> [u8; 3] {
    let red = (t.clamp(0.0, 1.0) * 255.0).round() as u8;
    [red, 255 - red, 0]
}

/// A scale for fluids: deep blue over light blue to white. `t` in 0 … 1.
pub(crate) fn water(t: f32) -> [u8; 3] {
    const STOPS: [[f32; 3]; 5] =
        [[22.0, 70.0, 160.0], [32.0, 112.0, 205.0], [68.0, 164.0, 232.0], [150.0, 212.0, 246.0], [250.0, 253.0, 255.0]];
    let place = t.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let below = (place as usize).min(STOPS.len() - 2);
    let part = place - below as f32;
    [0, 1, 2].map(|c| (STOPS[below][c] * (1.0 - part) + STOPS[below + 1][c] * part).round() as u8)
}

/// A bright colour of its own for every number.
pub(crate) fn distinct(number: u64) -> [u8; 3] {
    // The finaliser of SplitMix64: neighbouring numbers get unrelated hues.
    let mut h = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    h ^= h >> 31;
    let part = |shift: u32| ((h >> shift) & 0xffff) as f32 / 65536.0;
    hsv(part(0), 0.45 + 0.45 * part(16), 0.75 + 0.25 * part(32))
}

/// Colours that are easy to tell apart on a dark background: neighbours in the list are far apart in hue.
const FEW: [[u8; 3]; 12] = [
    [78, 141, 214],
    [255, 157, 60],
    [89, 190, 97],
    [232, 96, 98],
    [176, 137, 219],
    [240, 214, 84],
    [102, 206, 205],
    [240, 140, 196],
    [176, 132, 104],
    [178, 222, 124],
    [200, 204, 212],
    [120, 108, 190],
];

/// The colour of one thing among a few: far apart for the first twelve, then as [`distinct`].
pub(crate) fn category(number: u32) -> [u8; 3] {
    FEW.get(number as usize).copied().unwrap_or_else(|| distinct(number.into()))
}

/// Hue, saturation and value, each 0 … 1.
fn hsv(hue: f32, saturation: f32, value: f32) -> [u8; 3] {
    [5.0, 3.0, 1.0].map(|n: f32| {
        let k = (n + hue * 6.0) % 6.0;
        let channel = value - value * saturation * k.min(4.0 - k).clamp(0.0, 1.0);
        (channel * 255.0).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn viridis_passes_through_its_published_colors() {
        // Rows 0, 64, 128, 191 and 255 of the published table, in 8 bits.
        let table = [
            (0.0, [68, 1, 84]),
            (64.0 / 255.0, [59, 82, 139]),
            (128.0 / 255.0, [33, 145, 140]),
            (191.0 / 255.0, [93, 201, 99]),
            (1.0, [253, 231, 37]),
        ];
        for (t, expected) in table {
            let found = viridis(t);
            for c in 0..3 {
                assert!(found[c].abs_diff(expected[c]) <= 6, "{t}: {found:?}, expected {expected:?}");
            }
        }
    }

    #[test]
    fn accels_scale_goes_from_green_to_red() {
        assert_eq!([0.0, 0.2, 1.0, 7.0].map(green_to_red), [[0, 255, 0], [51, 204, 0], [255, 0, 0], [255, 0, 0]]);
    }

    #[test]
    fn the_first_categories_are_far_apart() {
        let apart = |a: [u8; 3], b: [u8; 3]| (0..3).map(|c| u32::from(a[c].abs_diff(b[c]))).sum::<u32>();
        for a in 0..12 {
            for b in 0..a {
                assert!(apart(category(a), category(b)) > 60, "{a} and {b}");
            }
        }
    }

    #[test]
    fn pure_hues_are_the_corners_of_the_color_cube() {
        assert_eq!(hsv(0.0, 1.0, 1.0), [255, 0, 0]);
        assert_eq!(hsv(1.0 / 3.0, 1.0, 1.0), [0, 255, 0]);
        assert_eq!(hsv(2.0 / 3.0, 1.0, 1.0), [0, 0, 255]);
        assert_eq!(hsv(0.5, 0.0, 1.0), [255, 255, 255]);
    }
}
