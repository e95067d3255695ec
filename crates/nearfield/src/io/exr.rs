//! OpenEXR: one uncompressed picture of 32-bit floats, row by row, with the channels B, G, R.
//!
//! Layout: the magic number, the version, attributes (name, type, size, value), a zero; the byte offset of each row;
//! then each row as its number, its size and its channels one after the other. All numbers are little-endian.

use std::io::{self, Write};

use glam::Vec3;

use crate::{Error, Result};

/// Writes linear radiance `[height × width]`, row by row from the upper left, every bit kept.
///
/// # Errors
/// `LengthMismatch` where the pixels are not width · height; `InvalidSetting` for a side of no pixels or one beyond 2³¹ − 1.
/// An error of the writer is an `Io` without a path.
pub fn write_exr(width: u32, height: u32, pixels: &[Vec3], w: &mut dyn Write) -> Result<()> {
    let sides = 1..=i32::MAX as u32;
    if !sides.contains(&width) || !sides.contains(&height) {
        let found = format!("{width} × {height}");
        return Err(Error::InvalidSetting { setting: "picture size", found, expected: "sides from 1 to 2147483647" });
    }
    let (found, expected) = (pixels.len() as u64, u64::from(width) * u64::from(height));
    if found != expected {
        return Err(Error::LengthMismatch { what: "pixels of the picture", found, expected });
    }
    write(width, height, pixels, w).map_err(|source| Error::Io { path: "EXR".into(), source })
}

/// Bytes before the pixels of a row: its number and its size.
const ROW_HEAD: u64 = 8;

fn write(width: u32, height: u32, pixels: &[Vec3], w: &mut dyn Write) -> io::Result<()> {
    let head = header(width, height);
    w.write_all(&head)?;
    let row_bytes = 12 * u64::from(width);
    let first = head.len() as u64 + 8 * u64::from(height);
    for row in 0..u64::from(height) {
        w.write_all(&(first + row * (ROW_HEAD + row_bytes)).to_le_bytes())?;
    }
    let mut bytes = Vec::with_capacity(row_bytes as usize);
    for (y, row) in pixels.chunks_exact(width as usize).enumerate() {
        bytes.clear();
        for channel in [2, 1, 0] {
            bytes.extend(row.iter().flat_map(|pixel| pixel[channel].to_le_bytes()));
        }
        w.write_all(&(y as u32).to_le_bytes())?;
        w.write_all(&(row_bytes as u32).to_le_bytes())?;
        w.write_all(&bytes)?;
    }
    Ok(())
}

fn header(width: u32, height: u32) -> Vec<u8> {
    let mut head = vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
    let mut attribute = |name: &str, kind: &str, value: &[u8]| {
        for text in [name, kind] {
            head.extend_from_slice(text.as_bytes());
            head.push(0);
        }
        head.extend_from_slice(&(value.len() as u32).to_le_bytes());
        head.extend_from_slice(value);
    };
    let words = |values: &[u32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    // Each channel: name, type (2 is a 32-bit float), linear or not, sampling along x and y.
    let mut channels: Vec<u8> =
        b"BGR".iter().flat_map(|&name| [vec![name, 0], words(&[2, 0, 1, 1])].concat()).collect();
    channels.push(0);
    let window = words(&[0, 0, width - 1, height - 1]);
    attribute("channels", "chlist", &channels);
    attribute("compression", "compression", &[0]);
    attribute("dataWindow", "box2i", &window);
    attribute("displayWindow", "box2i", &window);
    attribute("lineOrder", "lineOrder", &[0]);
    attribute("pixelAspectRatio", "float", &1f32.to_le_bytes());
    attribute("screenWindowCenter", "v2f", &[0; 8]);
    attribute("screenWindowWidth", "float", &1f32.to_le_bytes());
    head.push(0);
    head
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_reader_finds_every_bit() {
        let (width, height) = (5, 3);
        let value = |i: u32| [0.0, 1e-30, 0.1, 1e9, 12.5][i as usize % 5] * (1.0 + i as f32);
        let pixels: Vec<Vec3> = (0..width * height).map(|i| Vec3::new(value(i), value(i + 1), value(i + 2))).collect();
        let mut bytes = vec![];
        write_exr(width, height, &pixels, &mut bytes).unwrap();
        use exr::prelude::*;
        let read = read()
            .no_deep_data()
            .largest_resolution_level()
            .rgba_channels(
                |size, _| vec![glam::Vec3::ZERO; size.area()],
                |read: &mut Vec<glam::Vec3>, at, (r, g, b, _): (f32, f32, f32, f32)| {
                    read[at.y() * 5 + at.x()] = glam::Vec3::new(r, g, b);
                },
            )
            .first_valid_layer()
            .all_attributes()
            .from_buffered(std::io::Cursor::new(bytes))
            .unwrap();
        assert_eq!(read.layer_data.size, exr::math::Vec2(5, 3));
        assert_eq!(read.layer_data.channel_data.pixels, pixels);
    }

    #[test]
    fn pictures_that_do_not_fit_are_refused() {
        assert!(matches!(write_exr(2, 2, &[Vec3::ONE; 3], &mut vec![]), Err(Error::LengthMismatch { found: 3, .. })));
        assert!(write_exr(0, 2, &[], &mut vec![]).unwrap_err().to_string().contains("0 × 2"));
    }
}
