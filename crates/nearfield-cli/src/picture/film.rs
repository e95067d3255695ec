//! A film of pictures as an animated PNG, which browsers show: one palette for all, and of each picture only the rectangle that has changed.

use std::io::{self, Write};
use std::path::PathBuf;

use super::SOFTWARE;

/// Colours of the palette.
const COLORS: usize = 256;
/// Bits a channel by which colours are counted.
const BITS: u32 = 6;
/// Of so many pixels one is counted.
const SAMPLE: usize = 5;

/// What a film is made of.
#[derive(Debug, Clone)]
pub(crate) struct Film {
    /// Pictures of one size, as PNG with 8 bits for red, green and blue.
    pub(crate) pictures: Vec<PathBuf>,
    /// Linear factor by which they are made smaller; whole squares of so many pixels become one.
    pub(crate) shrink: u32,
    /// Pictures a second.
    pub(crate) rate: u16,
}

/// A picture of the film.
struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 3]>,
}

/// Writes the film, which is repeated without end.
///
/// # Errors
/// What reading a picture or `out` returns; `InvalidData` for a picture of another size or kind.
pub(crate) fn write_film(film: &Film, out: &mut dyn Write) -> io::Result<()> {
    let mut counts = vec![0u64; 1 << (3 * BITS)];
    let mut size = None;
    for path in &film.pictures {
        let picture = read(path, film.shrink)?;
        let own = (picture.width, picture.height);
        if *size.get_or_insert(own) != own {
            let what = format!("{}: the pictures of a film should be of one size", path.display());
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
        }
        picture.pixels.iter().step_by(SAMPLE).for_each(|&pixel| counts[bucket(pixel)] += 1);
    }
    let Some((width, height)) = size else { return Ok(()) };
    let palette = palette(&counts);
    let mut nearest = Nearest::new(&palette);

    let mut encoder = png::Encoder::new(out, width as u32, height as u32);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(palette.as_flattened().to_vec());
    encoder.set_compression(png::Compression::High);
    encoder.set_filter(png::Filter::NoFilter);
    encoder.set_animated(film.pictures.len() as u32, 0).map_err(io::Error::other)?;
    encoder.set_frame_delay(1, film.rate.max(1)).map_err(io::Error::other)?;
    encoder.set_blend_op(png::BlendOp::Source).map_err(io::Error::other)?;
    encoder.add_text_chunk("Software".to_owned(), SOFTWARE.to_owned()).map_err(io::Error::other)?;
    let mut writer = encoder.write_header().map_err(io::Error::other)?;
    let mut last: Vec<u8> = Vec::new();
    for path in &film.pictures {
        let picture = read(path, film.shrink)?;
        let indices: Vec<u8> = picture.pixels.iter().map(|&pixel| nearest.of(pixel)).collect();
        let [left, top, right, bottom] = changed(&last, &indices, width);
        if !last.is_empty() {
            writer.reset_frame_position().map_err(io::Error::other)?;
            writer.set_frame_dimension((right - left) as u32, (bottom - top) as u32).map_err(io::Error::other)?;
            writer.set_frame_position(left as u32, top as u32).map_err(io::Error::other)?;
        }
        let rows = indices.chunks_exact(width).take(bottom).skip(top);
        let part: Vec<u8> = rows.flat_map(|row| &row[left..right]).copied().collect();
        writer.write_image_data(&part).map_err(io::Error::other)?;
        last = indices;
    }
    writer.finish().map_err(io::Error::other)
}

/// Left, top, right and bottom of the smallest rectangle with all pixels that differ, one pixel at least; everything where there was no
/// picture before.
fn changed(last: &[u8], next: &[u8], width: usize) -> [usize; 4] {
    let height = next.len() / width;
    if last.is_empty() {
        return [0, 0, width, height];
    }
    let mut bounds = [width, height, 0, 0];
    for (i, _) in last.iter().zip(next).enumerate().filter(|(_, (a, b))| a != b) {
        let (x, y) = (i % width, i / width);
        bounds = [bounds[0].min(x), bounds[1].min(y), bounds[2].max(x + 1), bounds[3].max(y + 1)];
    }
    if bounds[2] == 0 { [0, 0, 1, 1] } else { bounds }
}

fn read(path: &std::path::Path, shrink: u32) -> io::Result<Picture> {
    let invalid = |what: String| io::Error::new(io::ErrorKind::InvalidData, format!("{}: {what}", path.display()));
    let file = io::BufReader::new(std::fs::File::open(path)?);
    let mut reader = png::Decoder::new(file).read_info().map_err(|error| invalid(error.to_string()))?;
    let mut bytes = vec![0; reader.output_buffer_size().unwrap_or(0)];
    let info = reader.next_frame(&mut bytes).map_err(|error| invalid(error.to_string()))?;
    if info.color_type != png::ColorType::Rgb || info.bit_depth != png::BitDepth::Eight {
        return Err(invalid("a picture of a film should have 8 bits for red, green and blue".to_owned()));
    }
    let (full, shrink) = (info.width as usize, shrink.max(1) as usize);
    let (width, height) = (full / shrink, info.height as usize / shrink);
    let average = |i: usize| {
        let (x, y) = (i % width * shrink, i / width * shrink);
        let squares = (0..shrink * shrink).map(|k| 3 * ((y + k / shrink) * full + x + k % shrink));
        let sums = squares.fold([0u32; 3], |sums, at| [0, 1, 2].map(|c| sums[c] + u32::from(bytes[at + c])));
        sums.map(|sum| (sum / (shrink * shrink) as u32) as u8)
    };
    Ok(Picture { width, height, pixels: (0..width * height).map(average).collect() })
}

/// Which of the colours that are told apart in counting it is.
fn bucket(color: [u8; 3]) -> usize {
    color.into_iter().fold(0, |key, channel| key << BITS | usize::from(channel >> (8 - BITS)))
}

/// The middle of a bucket.
fn color_of(bucket: usize) -> [u8; 3] {
    let mask = (1 << BITS) - 1;
    let channel = |shift: u32| ((bucket >> shift & mask) << (8 - BITS)) as u8 + (1 << (7 - BITS));
    [channel(2 * BITS), channel(BITS), channel(0)]
}

/// A palette by median cuts: the box of colours with the most weight along its longest side is halved until there are enough.
fn palette(counts: &[u64]) -> Vec<[u8; 3]> {
    // Rare colours should not vanish among thousands of pixels of the background: weight grows with the root of the count.
    let weight = |count: u64| (count as f64).sqrt();
    let used = counts.iter().enumerate().filter(|(_, count)| **count > 0);
    let mut boxes: Vec<Vec<([u8; 3], f64)>> =
        vec![used.map(|(bucket, &count)| (color_of(bucket), weight(count))).collect()];
    let side = |colors: &[([u8; 3], f64)], c: usize| {
        let (low, high) = colors.iter().fold((255, 0), |(l, h), (color, _)| (color[c].min(l), color[c].max(h)));
        f64::from(high.max(low) - low)
    };
    let longest =
        |colors: &[([u8; 3], f64)]| (0..3).max_by(|&a, &b| side(colors, a).total_cmp(&side(colors, b))).unwrap_or(0);
    let total = |colors: &[([u8; 3], f64)]| colors.iter().map(|(_, weight)| weight).sum::<f64>();
    let worth = |colors: &[([u8; 3], f64)]| side(colors, longest(colors)) * total(colors).sqrt();
    while boxes.len() < COLORS {
        let Some(widest) = (0..boxes.len()).max_by(|&a, &b| worth(&boxes[a]).total_cmp(&worth(&boxes[b]))) else {
            break;
        };
        if boxes[widest].len() < 2 {
            break;
        }
        let mut colors = boxes.swap_remove(widest);
        let axis = longest(&colors);
        colors.sort_by_key(|(color, _)| color[axis]);
        let (half, mut sum) = (0.5 * total(&colors), 0.0);
        let place = colors.iter().position(|(_, weight)| {
            sum += weight;
            sum >= half
        });
        let place = (place.unwrap_or(0) + 1).min(colors.len() - 1);
        let upper = colors.split_off(place);
        boxes.extend([colors, upper]);
    }
    let mean = |colors: &Vec<([u8; 3], f64)>| {
        let sums = colors
            .iter()
            .fold([0.0; 3], |sums, (color, weight)| [0, 1, 2].map(|c| sums[c] + weight * f64::from(color[c])));
        let total = total(colors);
        sums.map(|sum| (sum / total).round() as u8)
    };
    boxes.iter().filter(|colors| !colors.is_empty()).map(mean).collect()
}

/// The colour of the palette that is nearest, remembered by bucket.
struct Nearest<'a> {
    palette: &'a [[u8; 3]],
    known: Vec<Option<u8>>,
}

impl<'a> Nearest<'a> {
    fn new(palette: &'a [[u8; 3]]) -> Self {
        Self { palette, known: vec![None; 1 << (3 * BITS)] }
    }

    fn of(&mut self, pixel: [u8; 3]) -> u8 {
        let bucket = bucket(pixel);
        if let Some(index) = self.known[bucket] {
            return index;
        }
        let color = color_of(bucket);
        let distance =
            |other: &[u8; 3]| (0..3).map(|c| i32::from(color[c]).abs_diff(other[c].into()).pow(2)).sum::<u32>();
        let index = (0..self.palette.len()).min_by_key(|&i| distance(&self.palette[i])).unwrap_or(0) as u8;
        self.known[bucket] = Some(index);
        index
    }
}

#[cfg(test)]
mod tests {
    use super::super::Image;
    use super::*;

    /// Pictures of a white square that moves over grey.
    fn pictures(folder: &std::path::Path, n: usize) -> Vec<PathBuf> {
        std::fs::create_dir_all(folder).unwrap();
        let picture = |frame: usize| {
            let is_white = |i: usize| (frame * 10..frame * 10 + 8).contains(&(i % 80)) && (20..28).contains(&(i / 80));
            let pixels = (0..80 * 60).map(|i| if is_white(i) { [255; 3] } else { [40; 3] }).collect();
            let path = folder.join(format!("{frame}.png"));
            Image::of_pixels(80, 60, pixels).write_png(&mut std::fs::File::create(&path).unwrap()).unwrap();
            path
        };
        (0..n).map(picture).collect()
    }

    #[test]
    fn a_film_has_all_pictures_and_only_what_changes() {
        let folder = std::env::temp_dir().join(format!("nearfield-film-{}", std::process::id()));
        let film = Film { pictures: pictures(&folder, 5), shrink: 2, rate: 25 };
        let mut bytes = vec![];
        write_film(&film, &mut bytes).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        let mut reader = png::Decoder::new(io::Cursor::new(&bytes)).read_info().unwrap();
        assert_eq!(reader.info().animation_control.unwrap().num_frames, 5);
        assert_eq!((reader.info().width, reader.info().height), (40, 30));
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        let palette = reader.info().palette.clone().unwrap();
        let shown = |index: u8| palette[3 * usize::from(index)];
        // The square covers 4 × 4 pixels of the smaller picture.
        assert_eq!(pixels.iter().filter(|&&index| shown(index) > 200).count(), 16);
        for frame in 1..5 {
            let info = reader.next_frame(&mut pixels).unwrap();
            // From the left end of where it was to the right end of where it is.
            assert_eq!((info.width, info.height), (9, 4), "picture {frame}");
            let delay = reader.info().frame_control.unwrap();
            assert_eq!((delay.delay_num, delay.delay_den), (1, 25));
            assert_eq!((delay.x_offset, delay.y_offset), (5 * (frame - 1), 10));
        }
    }

    #[test]
    fn no_pictures_make_no_film_and_other_sizes_are_refused() {
        let mut bytes = vec![];
        write_film(&Film { pictures: vec![], shrink: 1, rate: 25 }, &mut bytes).unwrap();
        assert!(bytes.is_empty());
        let folder = std::env::temp_dir().join(format!("nearfield-film-sizes-{}", std::process::id()));
        let mut all = pictures(&folder, 1);
        let other = folder.join("other.png");
        Image::of_pixels(8, 8, vec![[0; 3]; 64]).write_png(&mut std::fs::File::create(&other).unwrap()).unwrap();
        all.push(other);
        let error = write_film(&Film { pictures: all, shrink: 1, rate: 25 }, &mut bytes).unwrap_err();
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(error.kind(), io::ErrorKind::InvalidData);
    }

    #[test]
    fn few_colours_are_kept_as_they_are_counted() {
        let mut counts = vec![0; 1 << (3 * BITS)];
        let colors = [[250, 3, 3], [3, 250, 3], [3, 3, 250]];
        colors.iter().for_each(|&color| counts[bucket(color)] += 1000);
        let mut found = palette(&counts);
        found.sort_unstable();
        let mut expected = colors.map(|color| color_of(bucket(color))).to_vec();
        expected.sort_unstable();
        assert_eq!(found, expected);
    }
}
