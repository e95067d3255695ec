//! Pictures of point clouds: a camera that fits itself, depth-tested splats, shading from the depth, and a legend.
//!
//! Everything is drawn at twice the size and averaged down, except the text.

mod balls;
mod camera;
mod film;
mod legend;
mod path;
mod raster;
mod shade;
mod splat;
mod text;
mod tiles;

use std::io::{self, Write};

use nearfield::Vec3;

use crate::options::PictureSize;

pub(crate) use balls::{Space, draw_balls};
pub(crate) use camera::{Camera, Up, likely_up};
pub(crate) use film::{Film, write_film};
pub(crate) use legend::{Bar, Colors, Scale, Swatch};
pub(crate) use path::{Path, Square, draw_path};
pub(crate) use raster::draw_raster;
pub(crate) use tiles::{Tile, draw_tiles};

/// Linear factor of the first drawing over the picture.
const OVERSAMPLING: u32 = 2;
/// Software named in the file, by which a picture of ours is known again.
const SOFTWARE: &str = "nearfield";

/// What to draw.
pub(crate) struct Scene<'a> {
    /// [n] positions.
    pub(crate) points: &'a [Vec3],
    /// [n] colours.
    pub(crate) colors: &'a [[u8; 3]],
    /// [n] how much larger than usual a point is drawn, or all alike where empty.
    pub(crate) sizes: &'a [f32],
    /// What the camera looks at: these points, or all where empty.
    pub(crate) focus: &'a [Vec3],
    /// The direction that is up.
    pub(crate) up: Up,
    /// First line.
    pub(crate) title: String,
    /// Second line.
    pub(crate) subtitle: String,
    /// The colour scale.
    pub(crate) bar: Option<Bar>,
    /// Colours that stand for things rather than values, in place of the scale.
    pub(crate) swatches: Vec<Swatch>,
}

/// Pixels, row by row from the top, red, green and blue.
pub(crate) struct Image {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 3]>,
}

/// A rectangle of a picture in pixels.
#[derive(Debug, Clone, Copy)]
struct Frame {
    left: f32,
    top: f32,
    width: f32,
    height: f32,
}

/// Draws the scene.
pub(crate) fn draw(scene: &Scene<'_>, size: PictureSize) -> Image {
    let (width, height) = ((size.width * OVERSAMPLING) as usize, (size.height * OVERSAMPLING) as usize);
    let unit = OVERSAMPLING as f32;
    let frame = frame(scene, size, unit);
    let focus = if scene.focus.is_empty() { scene.points } else { scene.focus };
    let camera = Camera::fitted(focus, scene.up, frame);
    // What the view does not reach for may show at the edges, but not under the text.
    let edge = 6.0 * unit;
    let [left, top] = [frame.left - edge, frame.top - edge].map(|side| side.max(0.0));
    let shown = Frame {
        left,
        top,
        width: frame.left + frame.width + edge.min(frame.left) - left,
        height: frame.top + frame.height + edge - top,
    };
    let layers = splat::draw(scene, &camera, shown, width, height);
    let mut image = shade::shaded(&layers, scene.colors, OVERSAMPLING as usize);
    legend::draw(&mut image, scene);
    image
}

/// The directions to the right and up on pictures of these points, and from them to the eye.
pub(crate) fn axes(points: &[Vec3], up: Up) -> [Vec3; 3] {
    Camera::fitted(points, up, Frame { left: 0.0, top: 0.0, width: 1.0, height: 1.0 }).axes()
}

/// Where the drawing goes: beside the legend and below the title. `unit` is the size of a pixel.
fn frame(scene: &Scene<'_>, size: PictureSize, unit: f32) -> Frame {
    let right = match (&scene.bar, scene.swatches.is_empty()) {
        (_, false) => 180.0,
        (Some(_), true) => 160.0,
        (None, true) => 30.0,
    };
    Frame {
        left: 30.0 * unit,
        top: 76.0 * unit,
        width: (size.width as f32 - 30.0 - right) * unit,
        height: (size.height as f32 - 76.0 - 30.0) * unit,
    }
}

impl Image {
    /// A picture of these pixels, row by row from the upper left.
    ///
    /// # Panics
    /// If they are not `width` times `height`.
    pub(crate) fn of_pixels(width: u32, height: u32, pixels: Vec<[u8; 3]>) -> Self {
        let (width, height) = (width as usize, height as usize);
        assert_eq!(pixels.len(), width * height, "a picture should have all of its pixels");
        Self { width, height, pixels }
    }

    /// Two pictures of one height, side by side.
    ///
    /// # Panics
    /// If they are not of one height.
    pub(crate) fn beside(left: &Self, right: &Self) -> Self {
        assert_eq!(left.height, right.height, "pictures side by side should be of one height");
        let row = |image: &Self, y: usize| image.pixels[y * image.width..(y + 1) * image.width].to_vec();
        let pixels = (0..left.height).flat_map(|y| [row(left, y), row(right, y)].concat()).collect();
        Self { width: left.width + right.width, height: left.height, pixels }
    }

    /// Paints one pixel over, `alpha` 0 … 1; outside the picture nothing happens.
    fn blend(&mut self, x: i64, y: i64, color: [u8; 3], alpha: f32) {
        if (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y) {
            let pixel = &mut self.pixels[y as usize * self.width + x as usize];
            for (old, new) in pixel.iter_mut().zip(color) {
                *old = (f32::from(*old) * (1.0 - alpha) + f32::from(new) * alpha).round() as u8;
            }
        }
    }

    /// Writes the picture as the smallest PNG that the encoder makes: rows filtered, or left as they are where a few
    /// colours repeat.
    pub(crate) fn write_png(&self, w: &mut dyn Write) -> io::Result<()> {
        let encoded = |filter| self.encoded(png::Compression::High, filter);
        let (filtered, plain) = rayon::join(|| encoded(png::Filter::Adaptive), || encoded(png::Filter::NoFilter));
        let (filtered, plain) = (filtered?, plain?);
        w.write_all(if plain.len() < filtered.len() { &plain } else { &filtered })
    }

    /// Writes the picture as PNG sooner, in a larger file: for one that is to be replaced.
    pub(crate) fn write_png_quickly(&self, w: &mut dyn Write) -> io::Result<()> {
        w.write_all(&self.encoded(png::Compression::Fast, png::Filter::Adaptive)?)
    }

    fn encoded(&self, compression: png::Compression, filter: png::Filter) -> io::Result<Vec<u8>> {
        let mut bytes = vec![];
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(compression);
        encoder.set_filter(filter);
        encoder.add_text_chunk("Software".to_owned(), SOFTWARE.to_owned()).map_err(io::Error::other)?;
        let mut writer = encoder.write_header().map_err(io::Error::other)?;
        writer.write_image_data(self.pixels.as_flattened()).map_err(io::Error::other)?;
        writer.finish().map_err(io::Error::other)?;
        Ok(bytes)
    }
}

/// Whether these are the first bytes of a picture that this program wrote.
pub(crate) fn is_ours(head: &[u8]) -> bool {
    let mark = [b"tEXtSoftware\0", SOFTWARE.as_bytes()].concat();
    head.starts_with(b"\x89PNG") && head.windows(mark.len()).any(|w| w == mark)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene<'a>(points: &'a [Vec3], colors: &'a [[u8; 3]]) -> Scene<'a> {
        Scene {
            points,
            colors,
            sizes: &[],
            focus: &[],
            up: Up::Z,
            title: "title".into(),
            subtitle: String::new(),
            bar: None,
            swatches: vec![],
        }
    }

    const SIZE: PictureSize = PictureSize { width: 320, height: 240 };

    #[test]
    fn nothing_equal_and_far_points_can_be_drawn() {
        for points in [vec![], vec![Vec3::splat(7.0)], vec![Vec3::ONE; 50], vec![Vec3::splat(-1e18), Vec3::splat(1e18)]]
        {
            let colors = vec![[200; 3]; points.len()];
            let image = draw(&scene(&points, &colors), SIZE);
            assert_eq!((image.width, image.height, image.pixels.len()), (320, 240, 320 * 240));
        }
    }

    #[test]
    fn our_own_pictures_are_known_again() {
        let mut bytes = vec![];
        draw(&scene(&[], &[]), SIZE).write_png(&mut bytes).unwrap();
        assert!(is_ours(&bytes));
        assert!(!is_ours(&bytes[1..]) && !is_ours(b"\x89PNG tEXtSoftware\0gimp"));
    }

    #[test]
    fn the_last_picture_is_no_larger_and_has_the_same_pixels() {
        let pixels = |bytes: &[u8]| {
            let mut reader = png::Decoder::new(io::Cursor::new(bytes)).read_info().unwrap();
            let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut pixels).unwrap();
            pixels
        };
        // Noise of two colours, which filters make worse, and a ramp, which they make better.
        let noise =
            |i: u32| -> [u8; 3] { if i.wrapping_mul(2_654_435_761) >> 31 == 0 { [200, 30, 90] } else { [10, 220, 7] } };
        let ramp = |i: u32| [(i % 300 / 2) as u8, (i / 300) as u8, (i % 300 / 2 + i / 300) as u8];
        for pixel in [&noise as &dyn Fn(u32) -> [u8; 3], &ramp] {
            let image = Image::of_pixels(300, 90, (0..300 * 90).map(pixel).collect());
            let (mut last, mut quick) = (vec![], vec![]);
            image.write_png(&mut last).unwrap();
            image.write_png_quickly(&mut quick).unwrap();
            let adaptive = image.encoded(png::Compression::High, png::Filter::Adaptive).unwrap();
            let plain = image.encoded(png::Compression::High, png::Filter::NoFilter).unwrap();
            assert_eq!(last.len(), adaptive.len().min(plain.len()));
            assert!(last.len() <= quick.len(), "{} and {} bytes", last.len(), quick.len());
            assert_eq!(pixels(&last), image.pixels.as_flattened());
            assert_eq!(pixels(&quick), image.pixels.as_flattened());
            assert!(is_ours(&last) && is_ours(&quick));
        }
    }
}
