//! Balls of known radii in a box, seen from a place that depends on the box alone, so that pictures of a motion make a film.

use nearfield::Vec3;
use rayon::prelude::*;

use super::camera::{Camera, Projected};
use super::splat::{Layers, SMALLEST};
use super::{Frame, Image, OVERSAMPLING, Scene, frame, legend, shade};
use crate::options::PictureSize;

/// Edges of the box, and how strongly they cover what is behind them.
const EDGE: ([u8; 3], f32) = ([168, 178, 194], 0.55);
/// The floor.
const FLOOR: ([u8; 3], f32) = ([120, 140, 170], 0.14);

/// Where the balls are.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Space {
    /// Lower and upper corner; y is up.
    pub(crate) corners: [Vec3; 2],
    /// Whether it is the plane z = 0, which is seen from its front.
    pub(crate) is_flat: bool,
}

impl Space {
    /// Its corners, x fastest, then y.
    fn all_corners(&self) -> [Vec3; 8] {
        let [low, high] = self.corners;
        let size = if self.is_flat { (high - low).with_z(0.0) } else { high - low };
        let low = if self.is_flat { low.with_z(0.0) } else { low };
        std::array::from_fn(|i| low + size * Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32))
    }
}

/// Draws the points of a scene as balls, by index of the point.
///
/// - `radii`: `[n]` in the unit of the points
pub(crate) fn draw_balls(scene: &Scene<'_>, radii: &[f32], space: &Space, size: PictureSize) -> Image {
    let (width, height) = ((size.width * OVERSAMPLING) as usize, (size.height * OVERSAMPLING) as usize);
    let frame = frame(scene, size, OVERSAMPLING as f32);
    let corners = space.all_corners();
    let camera = if space.is_flat { Camera::front(&corners, frame) } else { Camera::fitted(&corners, scene.up, frame) };
    let layers = layers(scene, radii, &camera, frame, [width, height]);
    let mut image = shade::shaded(&layers, scene.colors, OVERSAMPLING as usize);
    let mut around = Around { image: &mut image, layers: &layers, camera: &camera };
    if !space.is_flat {
        around.floor([corners[0], corners[1], corners[5], corners[4]]);
    }
    for (i, &start) in corners.iter().enumerate() {
        for axis in (0..3).filter(|axis| i >> axis & 1 == 0 && !(space.is_flat && (*axis == 2 || i >= 4))) {
            around.edge(start, corners[i | 1 << axis]);
        }
    }
    legend::draw(&mut image, scene);
    image
}

/// What is seen at each pixel, drawn band by band.
fn layers(scene: &Scene<'_>, radii: &[f32], camera: &Camera, frame: Frame, [width, height]: [usize; 2]) -> Layers {
    let mut layers = Layers::empty(width, height);
    let seen: Vec<Option<Projected>> = scene.points.par_iter().map(|&point| camera.project(point)).collect();
    for ((i, at), &radius) in (0u32..).zip(&seen).zip(radii) {
        let Some(at) = at.filter(|at| at.y >= frame.top - 40.0) else { continue };
        let radius = (camera.pixels(radius.into()) * at.zoom).max(SMALLEST);
        layers.ball(i, at, radius);
    }
    layers
}

/// The box around the balls.
struct Around<'a> {
    image: &'a mut Image,
    layers: &'a Layers,
    camera: &'a Camera,
}

impl Around<'_> {
    /// A line where nothing stands in front of it.
    fn edge(&mut self, from: Vec3, to: Vec3) {
        let (Some(start), Some(end)) = (self.camera.project(from), self.camera.project(to)) else { return };
        let factor = OVERSAMPLING as f32;
        let place = |at: Projected| [at.x / factor - 0.5, at.y / factor - 0.5];
        let (first, last) = (place(start), place(end));
        let is_steep = (last[1] - first[1]).abs() > (last[0] - first[0]).abs();
        // Along the picture's side that the line follows, one pixel after the other; across it two share the line.
        let [along, across] = if is_steep { [1, 0] } else { [0, 1] };
        let length = last[along] - first[along];
        let (low, high) = (first[along].min(last[along]).ceil() as i64, first[along].max(last[along]).floor() as i64);
        for pixel in low..=high {
            let part = if length == 0.0 { 0.0 } else { (pixel as f32 - first[along]) / length };
            // Equal steps on the picture are none in space, where what is nearer is larger.
            let in_space = part * end.zoom / ((1.0 - part) * start.zoom + part * end.zoom);
            let Some(at) = self.camera.project(from.lerp(to, in_space)) else { continue };
            if !self.is_free(at.x, at.y, at.depth) {
                continue;
            }
            let side = first[across] + part * (last[across] - first[across]);
            let share = side - side.floor();
            for (side, share) in [(side.floor(), 1.0 - share), (side.floor() + 1.0, share)] {
                let (x, y) = if is_steep { (side as i64, pixel) } else { (pixel, side as i64) };
                self.image.blend(x, y, EDGE.0, EDGE.1 * share);
            }
        }
    }

    /// A convex area where nothing is drawn.
    fn floor(&mut self, corners: [Vec3; 4]) {
        let factor = OVERSAMPLING as f32;
        let projected = corners.map(|corner| self.camera.project(corner));
        let [Some(a), Some(b), Some(c), Some(d)] = projected else { return };
        let places = [a, b, c, d].map(|at| [at.x / factor, at.y / factor]);
        let side = |i: usize, x: f32, y: f32| {
            let ([x0, y0], [x1, y1]) = (places[i], places[(i + 1) % 4]);
            (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
        };
        for y in 0..self.image.height {
            for x in 0..self.image.width {
                let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
                let is_left = |i: usize| side(i, px, py) > 0.0;
                let is_inside = (1..4).all(|i| is_left(i) == is_left(0));
                if is_inside && self.is_free(px * factor, py * factor, f32::MAX) {
                    self.image.blend(x as i64, y as i64, FLOOR.0, FLOOR.1);
                }
            }
        }
    }

    /// Whether no ball is nearer than this depth, at a place of the larger drawing.
    fn is_free(&self, x: f32, y: f32, depth: f32) -> bool {
        let (x, y) = (x as usize, y as usize);
        x < self.layers.width && y < self.layers.height && self.layers.depth[y * self.layers.width + x] > depth
    }
}

#[cfg(test)]
mod tests {
    use super::super::Up;
    use super::*;

    fn drawn(points: &[Vec3], radius: f32, is_flat: bool) -> Image {
        let colors = vec![[255, 0, 0]; points.len()];
        let scene = Scene {
            points,
            colors: &colors,
            sizes: &[],
            focus: &[],
            up: Up::Y,
            title: String::new(),
            subtitle: String::new(),
            bar: None,
            swatches: vec![],
        };
        let space = Space { corners: [Vec3::ZERO, Vec3::ONE], is_flat };
        draw_balls(&scene, &vec![radius; points.len()], &space, PictureSize { width: 400, height: 400 })
    }

    #[test]
    fn discs_have_the_areas_of_their_radii() {
        let empty = drawn(&[], 0.1, true);
        let area = |radius: f32| {
            let image = drawn(&[Vec3::new(0.5, 0.5, 0.0)], radius, true);
            image.pixels.iter().zip(&empty.pixels).filter(|(a, b)| a != b).count() as f32
        };
        let [small, large, whole] = [0.1, 0.2, 0.5].map(area);
        // The rim of a disc of some 25 pixels is known to half a pixel: 4 % of its area.
        assert!((large / small / 4.0 - 1.0).abs() < 0.06, "{small} and {large} pixels");
        // One that touches all sides of the square has a quarter of pi of its pixels; the square has a third of the picture or more.
        assert!((whole / small / 25.0 - 1.0).abs() < 0.08, "{small} and {whole} pixels");
        assert!(whole > std::f32::consts::FRAC_PI_4 * 400.0 * 400.0 / 3.0, "{whole} pixels");
    }

    #[test]
    fn the_view_does_not_depend_on_the_balls() {
        let empty = drawn(&[], 0.1, false);
        let far = drawn(&[Vec3::splat(0.1)], 0.001, false);
        let changed = empty.pixels.iter().zip(&far.pixels).filter(|(a, b)| a != b).count();
        assert!((1..60).contains(&changed), "{changed} pixels differ");
    }

    #[test]
    fn balls_without_a_place_on_the_picture_are_left_out() {
        let image = drawn(&[Vec3::splat(f32::NAN), Vec3::splat(1e30), Vec3::splat(-1e30)], 0.1, false);
        assert_eq!(image.pixels.len(), 400 * 400);
    }
}
