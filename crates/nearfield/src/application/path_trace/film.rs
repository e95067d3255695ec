//! The picture while samples come in: `accumulate`, the last stage, adds to it. Its twin on the device is `accumulate.wesl`.

use glam::Vec3;

use crate::{Error, Result};

/// Sums of radiance and how many samples a pixel they are of.
#[derive(Debug, Clone, PartialEq)]
pub struct Film {
    width: u32,
    height: u32,
    pub(super) sums: Vec<Vec3>,
    pub(super) samples: u32,
    pub(super) dropped: u64,
}

/// Most pixels of a picture.
const MOST_PIXELS: u64 = 1 << 28;

impl Film {
    /// A black picture without samples.
    ///
    /// # Errors
    /// `InvalidSetting` for a side of no pixels or more than 2²⁸ pixels; `OutOfMemory`.
    pub fn new(width: u32, height: u32) -> Result<Self> {
        let pixels = Self::pixels(width, height)?;
        let mut sums = Vec::new();
        let needed = (pixels * size_of::<Vec3>()) as u64;
        let refused = |_| Error::OutOfMemory { what: "the picture", needed, available: 0 };
        sums.try_reserve_exact(pixels).map_err(refused)?;
        sums.resize(pixels, Vec3::ZERO);
        Ok(Self { width, height, sums, samples: 0, dropped: 0 })
    }

    /// Number of pixels.
    ///
    /// # Errors
    /// `InvalidSetting` as [`Film::new`].
    pub(super) fn pixels(width: u32, height: u32) -> Result<usize> {
        let pixels = u64::from(width) * u64::from(height);
        if pixels == 0 || pixels > MOST_PIXELS {
            return Err(Error::InvalidSetting {
                setting: "picture size",
                found: format!("{width} × {height}"),
                expected: "sides of one pixel or more, and at most 268,435,456 pixels",
            });
        }
        Ok(pixels as usize)
    }

    /// Columns.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Samples that each pixel has: the number of the next one.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// Samples left out because a sum of theirs was not finite; zero unless lights are close to 1e9.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// `[height × width]` sums of the samples, row by row from the upper left.
    pub fn sums(&self) -> &[Vec3] {
        &self.sums
    }

    /// `[height × width]` mean radiance; black without samples.
    pub fn radiance(&self) -> Vec<Vec3> {
        let share = 1.0 / self.samples.max(1) as f32;
        self.sums.iter().map(|&sum| sum * share).collect()
    }

    /// `[height × width]` red, green and blue for the screen: radiance times `exposure`, cut at 1, by the curve of sRGB.
    pub fn srgb(&self, exposure: f32) -> Vec<[u8; 3]> {
        let share = exposure / self.samples.max(1) as f32;
        self.sums.iter().map(|&sum| (sum * share).to_array().map(srgb_byte)).collect()
    }

    /// Adds one sample to every pixel.
    pub(super) fn accumulate(&mut self, radiance: &[Vec3]) {
        self.samples += 1;
        for (sum, &sample) in self.sums.iter_mut().zip(radiance) {
            if sample.is_finite() {
                *sum += sample;
            } else {
                self.dropped += 1;
            }
        }
    }
}

/// A linear value as sRGB, 0 … 255 (IEC 61966-2-1).
fn srgb_byte(linear: f32) -> u8 {
    let v = linear.clamp(0.0, 1.0);
    let curved = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * libm::powf(v, 1.0 / 2.4) - 0.055 };
    (255.0 * curved + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_srgb_curve_at_values_that_are_known() {
        for (linear, byte) in [(0.0, 0), (0.5, 188), (0.214_041_14, 127), (1.0, 255), (7.0, 255), (f32::NAN, 0)] {
            assert!(srgb_byte(linear).abs_diff(byte) <= u8::from(byte == 127), "{linear}: {}", srgb_byte(linear));
        }
    }

    #[test]
    fn samples_that_are_not_finite_are_counted_and_left_out() {
        let mut film = Film::new(2, 1).unwrap();
        film.accumulate(&[Vec3::ONE, Vec3::NAN]);
        assert_eq!((film.radiance(), film.dropped()), (vec![Vec3::ONE, Vec3::ZERO], 1));
    }

    #[test]
    fn pictures_without_pixels_are_refused() {
        for (width, height) in [(0, 5), (5, 0), (1 << 20, 1 << 20)] {
            let message = Film::new(width, height).unwrap_err().to_string();
            assert!(message.contains(&format!("{width} × {height}")), "{message}");
        }
    }
}
