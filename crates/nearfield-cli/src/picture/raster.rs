//! A raster of colours, pixel for pixel, with title and legend around it.

use super::{Image, Scene, legend, shade};
use crate::options::PictureSize;

/// Pixels left of, above, right of and below the raster.
const MARGINS: [usize; 4] = [30, 76, 160, 30];

/// The raster `[height × width]`, row by row from the upper left, with the title and the colour bar of a scene. Of the
/// scene, nothing else is used.
///
/// # Panics
/// If the raster is not of this size.
pub(crate) fn draw_raster(raster: &[[u8; 3]], scene: &Scene<'_>, size: PictureSize) -> Image {
    let (width, height) = (size.width as usize, size.height as usize);
    assert_eq!(raster.len(), width * height, "a raster should have all of its pixels");
    let [left, above, right, below] = MARGINS;
    let mut image = shade::empty(left + width + right, above + height + below);
    for (y, row) in raster.chunks_exact(width).enumerate() {
        let start = (above + y) * image.width + left;
        image.pixels[start..start + width].copy_from_slice(row);
    }
    legend::draw(&mut image, scene);
    image
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::{Bar, Colors, Scale, Up};

    #[test]
    fn every_pixel_of_the_raster_stays_as_it_is() {
        let size = PictureSize { width: 200, height: 210 };
        let raster: Vec<[u8; 3]> = (0..200 * 210).map(|i| [i as u8, (i / 200) as u8, 7]).collect();
        let scene = Scene {
            points: &[],
            colors: &[],
            sizes: &[],
            focus: &[],
            up: Up::Y,
            title: "a title".to_owned(),
            subtitle: "and more".to_owned(),
            bar: Some(Bar { label: "tests".to_owned(), scale: Scale::up_to(9, Colors::GreenRed) }),
            swatches: vec![],
        };
        let image = draw_raster(&raster, &scene, size);
        assert_eq!((image.width, image.height), (390, 316));
        for (i, &color) in raster.iter().enumerate() {
            assert_eq!(image.pixels[(76 + i / 200) * 390 + 30 + i % 200], color, "pixel {i}");
        }
        // The bar beside it goes up to red.
        assert!(image.pixels.iter().any(|&pixel| pixel == [255, 0, 0]));
    }
}
