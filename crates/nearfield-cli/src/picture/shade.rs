//! Light from the depth alone, which makes raw scans readable: what lies behind its surroundings is darker (the idea of
//! eye-dome lighting, Boucheny2009), and slopes turned away from the light are darker.

use rayon::prelude::*;

use super::Image;
use super::splat::Layers;

/// Background at the top and at the bottom.
const BACKGROUND: [[f32; 3]; 2] = [[30.0, 35.0, 44.0], [13.0, 15.0, 19.0]];
/// Distances in pixels, and how much each says about the shade.
const RINGS: [(i64, f32); 3] = [(2, 0.2), (5, 0.3), (14, 0.5)];
/// Half the side of the square over which the depth is smoothed before slopes are taken.
const SMOOTHING: i64 = 4;

/// The picture, averaged over squares of `factor` pixels.
pub(super) fn shaded(layers: &Layers, colors: &[[u8; 3]], factor: usize) -> Image {
    let (width, height) = (layers.width / factor, layers.height / factor);
    let smooth = smoothed(layers);
    let mut pixels = vec![[0; 3]; width * height];
    pixels.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
        let background = background(row, height);
        for (column, out) in line.iter_mut().enumerate() {
            let mut sum = [0.0; 3];
            for y in row * factor..(row + 1) * factor {
                for x in column * factor..(column + 1) * factor {
                    let color = color_at(layers, &smooth, colors, x, y).unwrap_or(background);
                    sum = [0, 1, 2].map(|c| sum[c] + color[c]);
                }
            }
            *out = sum.map(|s| (s / (factor * factor) as f32).clamp(0.0, 255.0).round() as u8);
        }
    });
    Image { width, height, pixels }
}

/// The picture with nothing on it.
pub(super) fn empty(width: usize, height: usize) -> Image {
    let row = |row| std::iter::repeat_n(background(row, height).map(|c| c.round() as u8), width);
    Image { width, height, pixels: (0..height).flat_map(row).collect() }
}

fn background(row: usize, height: usize) -> [f32; 3] {
    let t = row as f32 / height as f32;
    [0, 1, 2].map(|c| BACKGROUND[0][c] * (1.0 - t) + BACKGROUND[1][c] * t)
}

fn color_at(layers: &Layers, smooth: &[f32], colors: &[[u8; 3]], x: usize, y: usize) -> Option<[f32; 3]> {
    let pixel = y * layers.width + x;
    let color = colors.get(layers.point[pixel] as usize)?;
    let own = f32::from(layers.light[pixel]) / 255.0;
    let light = occlusion(layers, x, y) * slope(layers, smooth, x, y) * own;
    Some(color.map(|c| f32::from(c) * light))
}

/// 1 in the open, towards 0 where the surroundings stand in front.
fn occlusion(layers: &Layers, x: usize, y: usize) -> f32 {
    let own = layers.depth[y * layers.width + x];
    let mut shade = 0.0;
    for (ring, weight) in RINGS {
        let mut sum = 0.0;
        for (dx, dy) in [(1, 0), (0, 1), (1, 1), (1, -1)] {
            let ahead = depth_at(layers, x as i64 + ring * dx, y as i64 + ring * dy, own);
            let behind = depth_at(layers, x as i64 - ring * dx, y as i64 - ring * dy, own);
            // Two opposite sides together: an even slope cancels out, a step or a valley does not.
            let reach = 3.0 * ring as f32;
            let closeness = (own - ahead).clamp(-reach, reach) + (own - behind).clamp(-reach, reach);
            sum += (closeness / reach).max(0.0);
        }
        shade += weight * sum / 4.0;
    }
    (-1.3 * shade).exp()
}

/// Depth at a pixel, `own` where nothing is seen: the background hides nothing.
fn depth_at(layers: &Layers, x: i64, y: i64, own: f32) -> f32 {
    if x < 0 || y < 0 || x >= layers.width as i64 || y >= layers.height as i64 {
        return own;
    }
    let depth = layers.depth[y as usize * layers.width + x as usize];
    if depth.is_finite() { depth } else { own }
}

/// Lambert's law on the smoothed depth, light from the upper left.
fn slope(layers: &Layers, smooth: &[f32], x: usize, y: usize) -> f32 {
    let own = smooth[y * layers.width + x];
    let at = |x: i64, y: i64| {
        let inside = x >= 0 && y >= 0 && x < layers.width as i64 && y < layers.height as i64;
        let depth = if inside { smooth[y as usize * layers.width + x as usize] } else { f32::INFINITY };
        // A jump is an edge, not a slope.
        if (depth - own).abs() < 12.0 * SMOOTHING as f32 { depth } else { own }
    };
    let (x, y, d) = (x as i64, y as i64, SMOOTHING);
    let gradient = [at(x + d, y) - at(x - d, y), at(x, y + d) - at(x, y - d)].map(|g| g / (2 * d) as f32);
    // Depth grows away from the eye: the surface faces (gx, gy, -1) on the picture, y down, z into it.
    let [gx, gy] = gradient;
    let length = (gx * gx + gy * gy + 1.0).sqrt();
    let facing = (-0.45 * gx - 0.55 * gy + 0.70) / length;
    0.5 + 0.75 * facing.max(0.0)
}

/// The depth averaged over small squares, leaving out the background; infinite where there is only background.
fn smoothed(layers: &Layers) -> Vec<f32> {
    let (width, height) = (layers.width, layers.height);
    let pass = |input: &[(f32, f32)], along_x: bool| -> Vec<(f32, f32)> {
        let mut out = vec![(0.0, 0.0); input.len()];
        out.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, line)| {
            for (x, sum) in line.iter_mut().enumerate() {
                for d in -SMOOTHING..=SMOOTHING {
                    let (x, y) = if along_x { (x as i64 + d, y as i64) } else { (x as i64, y as i64 + d) };
                    if x >= 0 && y >= 0 && x < width as i64 && y < height as i64 {
                        let (depth, weight) = input[y as usize * width + x as usize];
                        *sum = (sum.0 + depth, sum.1 + weight);
                    }
                }
            }
        });
        out
    };
    let start: Vec<(f32, f32)> =
        layers.depth.iter().map(|&d| if d.is_finite() { (d, 1.0) } else { (0.0, 0.0) }).collect();
    let sums = pass(&pass(&start, true), false);
    sums.into_iter().map(|(depth, weight)| if weight > 0.0 { depth / weight } else { f32::INFINITY }).collect()
}
