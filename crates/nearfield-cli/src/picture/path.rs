//! A path through points of a plane, as lines coloured from point to point, with numbers where there are few.

use nearfield::Vec3;

use super::{Frame, Image, Scene, legend, shade, text};
use crate::options::PictureSize;

const INK: [u8; 3] = [228, 232, 238];
const SHADOW: [u8; 3] = [14, 16, 20];
const LINES: [u8; 3] = [92, 102, 118];
/// Most points that get numbers of the largest and of the middle size.
const FEW: usize = 60;
const SOME: usize = 200;
/// Directions from a point in which its number may stand, the best first.
const SIDES: [[f32; 2]; 8] =
    [[1.0, -1.0], [-1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [1.0, 0.0], [-1.0, 0.0], [0.0, -1.0], [0.0, 1.0]];

/// A square of the plane: lower left corner and side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Square {
    pub(crate) corner: [f32; 2],
    pub(crate) side: f32,
}

/// How the path is drawn.
pub(crate) struct Path<'a> {
    /// Squares whose borders are shown behind.
    pub(crate) squares: &'a [Square],
    /// Whether points are shown as discs with their number, counted from 1.
    pub(crate) numbered: bool,
}

/// Draws the path through the points of the scene in their order, seen along z with y up. Of the scene, sizes, focus
/// and up are not used.
pub(crate) fn draw_path(scene: &Scene<'_>, path: &Path<'_>, size: PictureSize) -> Image {
    let mut image = shade::empty(size.width as usize, size.height as usize);
    let (below, right) = (50.0, if scene.bar.is_some() { 190.0 } else { 60.0 });
    let frame = Frame {
        left: 60.0,
        top: 100.0,
        width: size.width as f32 - 60.0 - right,
        height: size.height as f32 - 100.0 - below,
    };
    let view = View::fitted(scene.points, path.squares, frame);
    for square in path.squares {
        draw_square(&mut image, &view, *square);
    }
    let places: Vec<[f32; 2]> = scene.points.iter().map(|p| view.place([p.x, p.y])).collect();
    let n = places.len();
    let width = if n <= FEW {
        4.0
    } else if path.numbered {
        2.5
    } else {
        1.3
    };
    let strength = if path.numbered { 0.9 } else { 0.75 };
    for i in 1..n {
        line(&mut image, places[i - 1], places[i], width, strength, scene.colors[i]);
    }
    if path.numbered {
        let radius = if n <= FEW { 7.0 } else { 4.0 };
        for (&place, &color) in places.iter().zip(scene.colors) {
            disc(&mut image, place, radius + 1.5, SHADOW);
            disc(&mut image, place, radius, color);
        }
        draw_numbers(&mut image, &places, radius);
    }
    legend::draw(&mut image, scene);
    image
}

/// Brings the plane to the picture.
struct View {
    center: [f32; 2],
    middle: [f32; 2],
    scale: f32,
}

impl View {
    /// Shows all squares, or all points where there is none.
    fn fitted(points: &[Vec3], squares: &[Square], frame: Frame) -> Self {
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        let mut hold = |p: [f32; 2]| {
            for axis in 0..2 {
                low[axis] = low[axis].min(p[axis]);
                high[axis] = high[axis].max(p[axis]);
            }
        };
        for square in squares {
            hold(square.corner);
            hold(square.corner.map(|c| c + square.side));
        }
        if squares.is_empty() {
            points.iter().for_each(|p| hold([p.x, p.y]));
        }
        let extent = [high[0] - low[0], high[1] - low[1]];
        let scale = (frame.width / extent[0]).min(frame.height / extent[1]);
        let known = low[0] <= high[0];
        Self {
            center: if known { [0, 1].map(|a| 0.5 * low[a] + 0.5 * high[a]) } else { [0.0; 2] },
            middle: [frame.left + 0.5 * frame.width, frame.top + 0.5 * frame.height],
            scale: if known && scale.is_finite() { scale } else { 1.0 },
        }
    }

    fn place(&self, point: [f32; 2]) -> [f32; 2] {
        let x = self.middle[0] + (point[0] - self.center[0]) * self.scale;
        let y = self.middle[1] - (point[1] - self.center[1]) * self.scale;
        [x, y]
    }
}

fn draw_square(image: &mut Image, view: &View, square: Square) {
    let [left, bottom] = view.place(square.corner);
    let [right, top] = view.place(square.corner.map(|c| c + square.side));
    let corners = [[left, bottom], [right, bottom], [right, top], [left, top]];
    for i in 0..4 {
        line(image, corners[i], corners[(i + 1) % 4], 1.0, 0.5, LINES);
    }
}

/// A line with round ends and soft borders.
fn line(image: &mut Image, from: [f32; 2], to: [f32; 2], width: f32, strength: f32, color: [u8; 3]) {
    let along = [to[0] - from[0], to[1] - from[1]];
    let len2 = along[0] * along[0] + along[1] * along[1];
    let reach = 0.5 * width + 1.0;
    let steep = along[1].abs() > along[0].abs();
    // By rows where it is steep and else by columns: only pixels near the line are looked at.
    let (major, minor) = if steep { (1, 0) } else { (0, 1) };
    let sides = [image.width as f32, image.height as f32];
    let low = (from[major].min(to[major]) - reach).max(0.0) as i64;
    let high = (from[major].max(to[major]) + reach).min(sides[major]) as i64;
    let slope = if along[major] == 0.0 { 0.0 } else { along[minor] / along[major] };
    for m in low..=high {
        let at = (m as f32 + 0.5).clamp(from[major].min(to[major]), from[major].max(to[major]));
        let center = from[minor] + (at - from[major]) * slope;
        let span = reach * (1.0 + slope.abs());
        for k in (center - span).floor() as i64..=(center + span).ceil() as i64 {
            let (x, y) = if steep { (k, m) } else { (m, k) };
            let p = [x as f32 + 0.5 - from[0], y as f32 + 0.5 - from[1]];
            let t = if len2 > 0.0 { ((p[0] * along[0] + p[1] * along[1]) / len2).clamp(0.0, 1.0) } else { 0.0 };
            let distance = (p[0] - t * along[0]).hypot(p[1] - t * along[1]);
            let cover = (0.5 * width + 0.5 - distance).clamp(0.0, 1.0);
            if cover > 0.0 {
                image.blend(x, y, color, strength * cover);
            }
        }
    }
}

fn disc(image: &mut Image, center: [f32; 2], radius: f32, color: [u8; 3]) {
    line(image, center, center, 2.0 * radius, 1.0, color);
}

/// Writes the numbers beside the points, where they cover least of what is drawn.
fn draw_numbers(image: &mut Image, places: &[[f32; 2]], radius: f32) {
    let magnification = if places.len() <= FEW {
        3
    } else if places.len() <= SOME {
        2
    } else {
        1
    };
    // What numbers must not cover: brighter than lines of the squares.
    let is_drawn = |pixel: &[u8; 3]| pixel.iter().map(|&c| u32::from(c)).sum::<u32>() > 200;
    let mut taken: Vec<bool> = image.pixels.iter().map(is_drawn).collect();
    for (number, place) in places.iter().enumerate() {
        let label = (number + 1).to_string();
        let [width, height] = text::size(&label, magnification).map(|side| side as f32);
        let corner = |[x, y]: [f32; 2]| {
            let gap = radius + 2.0;
            // On a diagonal the corner of the text comes near the point, else the middle of its side.
            let left = place[0] + x * (gap + 0.5 * width) - 0.5 * width;
            let top = place[1] + y * (gap + 0.5 * height) - 0.5 * height;
            [left, top]
        };
        let covered = |side: &[f32; 2]| {
            let [left, top] = corner(*side);
            let mut count = 0;
            for y in top as i64..(top + height) as i64 {
                for x in left as i64..(left + width) as i64 {
                    let inside = x >= 0 && y >= 0 && x < image.width as i64 && y < image.height as i64;
                    // Outside the picture nothing could be read.
                    count += if inside { usize::from(taken[y as usize * image.width + x as usize]) } else { 9 };
                }
            }
            count
        };
        let best = SIDES.iter().min_by_key(|side| covered(side)).unwrap_or(&SIDES[0]);
        let [left, top] = corner(*best).map(|c| c.max(0.0) as usize);
        for y in top..(top + height as usize).min(image.height) {
            for x in left..(left + width as usize).min(image.width) {
                taken[y * image.width + x] = true;
            }
        }
        for (dx, dy) in [(0, 1), (2, 1), (1, 0), (1, 2)] {
            let (x, y) = ((left + dx).saturating_sub(1), (top + dy).saturating_sub(1));
            text::draw(image, x, y, &label, magnification, SHADOW);
        }
        text::draw(image, left, top, &label, magnification, INK);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Up;
    use super::*;

    fn scene<'a>(points: &'a [Vec3], colors: &'a [[u8; 3]]) -> Scene<'a> {
        let (title, subtitle) = (String::new(), String::new());
        Scene { points, colors, sizes: &[], focus: &[], up: Up::Z, title, subtitle, bar: None, swatches: vec![] }
    }

    const SIZE: PictureSize = PictureSize { width: 320, height: 240 };

    #[test]
    fn a_line_is_as_wide_as_asked_and_stays_in_the_picture() {
        let mut image = Image { width: 60, height: 40, pixels: vec![[0; 3]; 2400] };
        line(&mut image, [10.0, 20.0], [50.0, 20.0], 4.0, 1.0, [200; 3]);
        let column = |x: usize| (0..40).filter(|y| image.pixels[y * 60 + x] == [200; 3]).count();
        assert_eq!((column(30), column(5), column(55)), (4, 0, 0));
        for (from, to) in [([-500.0, 7.0], [900.0, -80.0]), ([30.0, -10.0], [30.0, 90.0]), ([9.0; 2], [9.0; 2])] {
            line(&mut image, from, to, 3.0, 1.0, [100; 3]);
        }
    }

    #[test]
    fn nothing_one_point_and_equal_points_can_be_drawn() {
        let square = [Square { corner: [0.0; 2], side: 1.0 }];
        for points in [vec![], vec![Vec3::splat(7.0)], vec![Vec3::ONE; 70], vec![Vec3::splat(-1e18), Vec3::splat(1e18)]]
        {
            let colors = vec![[200; 3]; points.len()];
            for (squares, numbered) in [(&square[..], true), (&[], false), (&[], true)] {
                let image = draw_path(&scene(&points, &colors), &Path { squares, numbered }, SIZE);
                assert_eq!(image.pixels.len(), 320 * 240);
            }
        }
    }

    #[test]
    fn the_path_runs_from_point_to_point_with_y_up() {
        let (points, colors) = ([Vec3::ZERO, Vec3::X, Vec3::ONE], [[0; 3], [255, 0, 0], [0, 255, 0]]);
        let path = Path { squares: &[], numbered: false };
        let image = draw_path(&scene(&points, &colors), &path, SIZE);
        let of = |channel: usize| {
            let found = |p: &[u8; 3]| p[channel] > 150 && p[1 - channel] < 60;
            let places: Vec<usize> = (0..image.pixels.len()).filter(|&i| found(&image.pixels[i])).collect();
            let mean = |f: fn(usize) -> usize| places.iter().map(|&i| f(i)).sum::<usize>() / places.len();
            (mean(|i| i % 320), mean(|i| i / 320))
        };
        // Red along the bottom, green up the right side.
        let ((red_x, red_y), (green_x, green_y)) = (of(0), of(1));
        assert!(red_x < green_x && red_y > green_y, "{red_x} {red_y} {green_x} {green_y}");
    }
}
