//! Points become small balls on a depth buffer, as large as their density on the picture asks for.

use super::camera::{Camera, Projected};
use super::{Frame, Scene};

/// Sides of the squares, in pixels, by which the covered area is estimated: the first that holds enough points.
const SQUARES: [usize; 3] = [12, 24, 48];
const ENOUGH: usize = 2;
/// Radius over the mean spacing: closed surfaces show two layers at once, and gaps let the back shine through.
const COVER: f32 = 1.3;
/// Radii in pixels of the first drawing.
pub(super) const SMALLEST: f32 = 1.1;
const LARGEST: f32 = 30.0;
/// From this radius on a ball is shaded by itself.
const ROUND: f32 = 4.0;

/// What is seen at each pixel.
pub(super) struct Layers {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Depth in pixels, infinite where nothing is seen.
    pub(super) depth: Vec<f32>,
    /// The point seen.
    pub(super) point: Vec<u32>,
    /// Light on the ball itself, 255 for full.
    pub(super) light: Vec<u8>,
}

/// Draws the points whose centers lie in `frame`.
pub(super) fn draw(scene: &Scene<'_>, camera: &Camera, frame: Frame, width: usize, height: usize) -> Layers {
    let mut layers = Layers::empty(width, height);
    let inside = |p: &Projected| {
        let (x, y) = (p.x - frame.left, p.y - frame.top);
        x >= 0.0 && y >= 0.0 && x < frame.width && y < frame.height
    };
    let seen: Vec<(u32, Projected)> = (0u32..)
        .zip(scene.points)
        .filter_map(|(i, &p)| camera.project(p).filter(inside).map(|seen| (i, seen)))
        .collect();
    let radius = radius(&seen, width, height);
    for &(i, at) in &seen {
        let size = scene.sizes.get(i as usize).copied().unwrap_or(1.0);
        layers.ball(i, at, (radius * size * at.zoom).clamp(SMALLEST, 2.0 * LARGEST));
    }
    layers
}

/// The radius at which the points about cover what they are spread over.
fn radius(seen: &[(u32, Projected)], width: usize, height: usize) -> f32 {
    let mut area = 0;
    for square in SQUARES {
        let (columns, rows) = (width.div_ceil(square), height.div_ceil(square));
        let mut occupied = vec![false; columns * rows];
        for (_, at) in seen {
            occupied[at.y as usize / square * columns + at.x as usize / square] = true;
        }
        let n_occupied = occupied.iter().filter(|&&o| o).count();
        area = n_occupied * square * square;
        if seen.len() >= ENOUGH * n_occupied {
            break;
        }
    }
    (COVER * (area as f32 / seen.len().max(1) as f32).sqrt()).clamp(SMALLEST, LARGEST)
}

impl Layers {
    /// Nothing is seen anywhere.
    pub(super) fn empty(width: usize, height: usize) -> Self {
        let n_pixels = width * height;
        Self {
            width,
            height,
            depth: vec![f32::INFINITY; n_pixels],
            point: vec![u32::MAX; n_pixels],
            light: vec![255; n_pixels],
        }
    }

    /// Draws a ball where it is nearer than what is there; of two equally near the first stays.
    pub(super) fn ball(&mut self, point: u32, at: Projected, radius: f32) {
        let (r2, reach) = (radius * radius, radius.ceil());
        let span = |c: f32, end: usize| (c - reach).max(0.0) as usize..((c + reach + 1.0) as usize).min(end);
        for y in span(at.y, self.height) {
            let dy = y as f32 + 0.5 - at.y;
            for x in span(at.x, self.width) {
                let dx = x as f32 + 0.5 - at.x;
                let d2 = dx * dx + dy * dy;
                if d2 > r2 {
                    continue;
                }
                let bulge = (r2 - d2).sqrt();
                let pixel = y * self.width + x;
                let depth = at.depth - bulge;
                if depth < self.depth[pixel] {
                    self.depth[pixel] = depth;
                    self.point[pixel] = point;
                    if radius > ROUND {
                        // Light from the upper left, behind the viewer.
                        let facing = (-0.4 * dx - 0.5 * dy + 0.77 * bulge) / radius;
                        self.light[pixel] = (255.0 * (0.35 + 0.65 * facing.max(0.0)).min(1.0)) as u8;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::camera::Up;
    use super::*;
    use nearfield::Vec3;

    #[test]
    fn the_nearer_point_hides_the_farther_one_in_either_order() {
        let frame = Frame { left: 0.0, top: 0.0, width: 100.0, height: 100.0 };
        let corners = [Vec3::ZERO, Vec3::ONE, Vec3::X, Vec3::Y, Vec3::Z];
        let camera = Camera::fitted(&corners, Up::Z, frame);
        let center = Vec3::splat(0.5);
        let nearer = center + 0.25 * camera.toward_eye();
        for (points, front) in [([nearer, center], 0), ([center, nearer], 1)] {
            let title = String::new();
            let scene = Scene {
                points: &points,
                colors: &[[0; 3]; 2],
                sizes: &[],
                focus: &[],
                up: Up::Z,
                subtitle: title.clone(),
                title,
                bar: None,
                swatches: vec![],
            };
            let layers = draw(&scene, &camera, frame, 100, 100);
            let at = camera.project(center).unwrap();
            assert_eq!(layers.point[at.y as usize * 100 + at.x as usize], front);
        }
    }
}
