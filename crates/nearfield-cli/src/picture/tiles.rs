//! Flat pictures of rectangles: the cells of a tree as a plane cuts them.

use rayon::prelude::*;

use super::{Image, OVERSAMPLING, Scene, frame, legend};
use crate::options::PictureSize;

const BACKGROUND: [u8; 3] = [18, 21, 27];
/// Outlines of what is filled and of what is not.
const LINES: [[u8; 3]; 2] = [[18, 21, 27], [58, 66, 80]];
/// Sides below this many pixels of the first drawing have no outline: it would be all that is seen.
const OUTLINED: i64 = 7;

/// A rectangle: right and up are positive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Tile {
    pub(crate) min: [f64; 2],
    pub(crate) max: [f64; 2],
    /// The colour inside; `None` draws only the outline.
    pub(crate) fill: Option<[u8; 3]>,
}

/// Draws tiles one over the other, with the title and the legend of a scene; `view` (minimum, maximum) fills the frame.
pub(crate) fn draw_tiles(tiles: &[Tile], view: [[f64; 2]; 2], scene: &Scene<'_>, size: PictureSize) -> Image {
    let (width, height) = ((size.width * OVERSAMPLING) as usize, (size.height * OVERSAMPLING) as usize);
    let frame = frame(scene, size, OVERSAMPLING as f32);
    let [min, max] = view;
    let per_unit = |pixels: f32, units: f64| if units > 0.0 { f64::from(pixels) / units } else { f64::INFINITY };
    let scale = per_unit(frame.width, max[0] - min[0]).min(per_unit(frame.height, max[1] - min[1]));
    let scale = if scale.is_finite() { scale } else { 1.0 };
    let center = [frame.left + 0.5 * frame.width, frame.top + 0.5 * frame.height].map(f64::from);
    let x = |x: f64| (center[0] + scale * (x - 0.5 * (min[0] + max[0]))).round();
    let y = |y: f64| (center[1] - scale * (y - 0.5 * (min[1] + max[1]))).round();
    // What the view does not reach for is cut at the frame.
    let within = |value: f64, start: f32, length: f32| value.clamp(start.into(), (start + length).into()) as i64;

    let mut canvas = Image { width, height, pixels: vec![BACKGROUND; width * height] };
    for tile in tiles {
        let [left, right] = [tile.min[0], tile.max[0]].map(|v| within(x(v), frame.left, frame.width));
        let [top, bottom] = [tile.max[1], tile.min[1]].map(|v| within(y(v), frame.top, frame.height));
        let (outside_x, outside_y) =
            (tile.max[0] < min[0] || tile.min[0] > max[0], tile.max[1] < min[1] || tile.min[1] > max[1]);
        if outside_x || outside_y {
            continue;
        }
        canvas.tile([left, top, right.max(left + 1), bottom.max(top + 1)], tile.fill);
    }
    let mut image = canvas.averaged(OVERSAMPLING as usize);
    legend::draw(&mut image, scene);
    image
}

impl Image {
    fn tile(&mut self, [left, top, right, bottom]: [i64; 4], fill: Option<[u8; 3]>) {
        let outlined = (right - left).min(bottom - top) >= OUTLINED;
        let line = LINES[usize::from(fill.is_none())];
        for y in top..bottom {
            for x in left..right {
                let at_edge = x == left || y == top || x == right - 1 || y == bottom - 1;
                match fill {
                    _ if at_edge && outlined => self.blend(x, y, line, 1.0),
                    Some(color) => self.blend(x, y, color, 1.0),
                    None => {}
                }
            }
        }
    }

    /// The means of squares of `factor` pixels.
    fn averaged(&self, factor: usize) -> Self {
        let (width, height) = (self.width / factor, self.height / factor);
        let mean = |i: usize| {
            let (row, column) = (i / width * factor, i % width * factor);
            let square =
                (0..factor * factor).map(|j| self.pixels[(row + j / factor) * self.width + column + j % factor]);
            let sum = square.fold([0; 3], |sum: [u32; 3], pixel| [0, 1, 2].map(|c| sum[c] + u32::from(pixel[c])));
            sum.map(|s| (s / (factor * factor) as u32) as u8)
        };
        Self { width, height, pixels: (0..width * height).into_par_iter().map(mean).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Up;
    use super::*;

    #[test]
    fn a_tile_covers_its_part_of_the_view() {
        let scene = Scene {
            points: &[],
            colors: &[],
            sizes: &[],
            focus: &[],
            up: Up::Z,
            title: String::new(),
            subtitle: String::new(),
            bar: None,
            swatches: vec![],
        };
        // The frame is 340 wide and 294 high: the view of 2 by 1 gets 340 by 170.
        let (red, view) = ([200, 40, 40], [[0.0, 0.0], [2.0, 1.0]]);
        let tile = Tile { min: [1.0, 0.0], max: [2.0, 1.0], fill: Some(red) };
        let far = Tile { min: [5.0, 0.0], max: [6.0, 1.0], fill: Some([255; 3]) };
        let image = draw_tiles(&[tile, far], view, &scene, PictureSize { width: 400, height: 400 });
        let n_red = image.pixels.iter().filter(|p| **p == red).count();
        assert!(n_red.abs_diff(170 * 170) < 4 * 170, "{n_red} pixels");
        let is_right_half = image.pixels.iter().enumerate().all(|(i, p)| *p != red || i % 400 >= 199);
        assert!(is_right_half && !image.pixels.contains(&[255; 3]));
        let nothing = draw_tiles(&[], [[0.0; 2]; 2], &scene, PictureSize { width: 200, height: 200 });
        assert_eq!(nothing.pixels.len(), 200 * 200);
    }
}
