//! The picture of `nearfield sdf`: a slice through a field, with lines of equal distance.

use std::str::FromStr;

use nearfield::DVec3;
use nearfield::geometry::DistanceGrid;

use crate::options::PictureSize;
use crate::picture::{Image, Scene, Swatch, Up, draw_raster};

/// An axis of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Axis(usize);

impl FromStr for Axis {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = ["x", "y", "z"].iter().position(|&name| name == text);
        found.map(Self).ok_or_else(|| "expected x, y or z".to_owned())
    }
}

/// Lines of equal distance on each side of the surface.
const LINES: f32 = 4.0;
/// Half the width of the line at 0, and of the others, in pixels.
const SURFACE_LINE: f32 = 1.5;
const OTHER_LINE: f32 = 0.6;

const INSIDE: [[f32; 3]; 2] = [[222.0, 235.0, 247.0], [33.0, 102.0, 172.0]];
const OUTSIDE: [[f32; 3]; 2] = [[253.0, 233.0, 217.0], [217.0, 95.0, 14.0]];
const UNDEFINED: [u8; 3] = [236, 236, 236];
const BLACK: [u8; 3] = [20, 20, 20];

/// A slice across an axis.
pub(crate) struct Slice<'a> {
    field: &'a DistanceGrid,
    across: usize,
    /// Coordinate along that axis, relative to the origin of the grid.
    at: f64,
}

impl<'a> Slice<'a> {
    /// At a place from 0 to 1 along an axis, that of the shortest side where there is none.
    pub(crate) fn new(field: &'a DistanceGrid, axis: Option<Axis>, place: f64) -> Self {
        let cells = field.grid().cells();
        let shortest = (0..3).min_by_key(|&axis| cells[axis]).unwrap_or(2);
        let across = axis.map_or(shortest, |Axis(axis)| axis);
        let low = f64::from(field.grid().corner()[across]);
        let at = low + place * f64::from(field.grid().spacing()) * f64::from(cells[across]);
        Self { field, across, at }
    }

    /// The axes of the picture: to the right and upwards.
    fn axes(&self) -> [usize; 2] {
        [[1, 2], [0, 2], [0, 1]][self.across]
    }
}

/// The largest raster with the shape of the slice in this size, and the length of a pixel.
fn raster_size(slice: &Slice<'_>, size: PictureSize) -> (PictureSize, f64) {
    let cells = slice.field.grid().cells();
    let extent = slice.axes().map(|axis| f64::from(cells[axis]) * f64::from(slice.field.grid().spacing()));
    let pixel = (extent[0] / f64::from(size.width)).max(extent[1] / f64::from(size.height));
    let side = |extent: f64| ((extent / pixel).round() as u32).max(2);
    (PictureSize { width: side(extent[0]), height: side(extent[1]) }, pixel)
}

/// Draws the slice.
pub(crate) fn draw(slice: &Slice<'_>, name: &str, size: PictureSize) -> Image {
    let (size, pixel) = raster_size(slice, size);
    let grid = slice.field.grid();
    let defined = slice.field.values().iter().filter(|value| !value.is_nan());
    let farthest = defined.fold(0.0f32, |most, value| most.max(value.abs())).max(f32::MIN_POSITIVE);
    let step = step_of(farthest);
    let mut raster = Vec::with_capacity(size.width as usize * size.height as usize);
    for row in 0..size.height {
        for column in 0..size.width {
            let mut position = DVec3::ZERO;
            let [right, up] = slice.axes();
            position[slice.across] = slice.at;
            position[right] = f64::from(grid.corner()[right]) + pixel * (f64::from(column) + 0.5);
            position[up] = f64::from(grid.corner()[up]) + pixel * (f64::from(size.height - 1 - row) + 0.5);
            raster.push(color(slice.field.sample_at(position) as f32, farthest, step, pixel as f32));
        }
    }
    let [right, up] = slice.axes().map(|axis| ["x", "y", "z"][axis]);
    let world = grid.origin()[slice.across] + slice.at;
    let swatch = |label: String, color: [u8; 3]| Swatch { label, color: Some(color) };
    let scene = Scene {
        points: &[],
        colors: &[],
        sizes: &[],
        focus: &[],
        up: Up::Y,
        title: format!("signed distance of {name}"),
        subtitle: format!("{} = {world:.6}, {right} to the right, {up} upwards", ["x", "y", "z"][slice.across]),
        bar: None,
        swatches: vec![
            swatch("inside".to_owned(), mixed(INSIDE, 0.7)),
            swatch("surface".to_owned(), BLACK),
            swatch("outside".to_owned(), mixed(OUTSIDE, 0.7)),
            swatch("undefined".to_owned(), UNDEFINED),
            Swatch { label: format!("a line each {step}"), color: None },
        ],
    };
    draw_raster(&raster, &scene, size)
}

/// A round number of which about four go into a length.
fn step_of(length: f32) -> f32 {
    let rough = length / LINES;
    let power = 10f32.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 5.0].into_iter().rfind(|factor| factor * power <= rough).unwrap_or(1.0);
    factor * power
}

fn mixed([near, far]: [[f32; 3]; 2], t: f32) -> [u8; 3] {
    [0, 1, 2].map(|i| (near[i] + (far[i] - near[i]) * t.clamp(0.0, 1.0)).round() as u8)
}

fn color(value: f32, farthest: f32, step: f32, pixel: f32) -> [u8; 3] {
    if value.is_nan() {
        return UNDEFINED;
    }
    if value.abs() <= SURFACE_LINE * pixel {
        return BLACK;
    }
    let shade = mixed(if value < 0.0 { INSIDE } else { OUTSIDE }, value.abs() / farthest);
    let from_line = (value / step - (value / step).round()).abs() * step;
    if from_line <= OTHER_LINE * pixel && value.abs() > 0.5 * step {
        shade.map(|c| (f32::from(c) * 0.6) as u8)
    } else {
        shade
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_round() {
        for (length, step) in [(4.0, 1.0), (9.0, 2.0), (0.03, 0.005), (100.0, 20.0)] {
            assert!((step_of(length) / step - 1.0).abs() < 1e-5, "{length}: {}", step_of(length));
        }
    }

    #[test]
    fn colors_tell_sides_lines_and_nothing() {
        assert_eq!(color(f32::NAN, 1.0, 0.25, 0.001), UNDEFINED);
        assert_eq!(color(0.001, 1.0, 0.25, 0.001), BLACK);
        let [inside, outside] = [-0.1, 0.1].map(|value| color(value, 1.0, 0.25, 0.001));
        assert!(inside[2] > inside[0] && outside[0] > outside[2]);
        let line = color(0.25, 1.0, 0.25, 0.001);
        assert!(line[0] < color(0.26, 1.0, 0.25, 0.001)[0]);
    }
}
