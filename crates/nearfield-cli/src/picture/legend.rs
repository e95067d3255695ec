//! Title lines and the colour bar.

use super::{Image, Scene, text};
use crate::colormap::{green_to_red, viridis, water};
use crate::report::{grouped, short};

const INK: [u8; 3] = [228, 232, 238];
const FAINT: [u8; 3] = [150, 158, 170];
/// Width and longest height of the bar in pixels.
const BAR: [usize; 2] = [18, 420];

/// Height of a swatch with the space below it.
const SWATCH_LINE: usize = 26;

/// The colour bar: what its colours mean.
#[derive(Debug, Clone)]
pub(crate) struct Bar {
    /// What is shown, such as "neighbours".
    pub(crate) label: String,
    /// The values of its ends.
    pub(crate) scale: Scale,
}

/// What one colour stands for.
#[derive(Debug, Clone)]
pub(crate) struct Swatch {
    /// A few words.
    pub(crate) label: String,
    /// The colour; `None` for a line of text.
    pub(crate) color: Option<[u8; 3]>,
}

/// A range of values that colours are stretched over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Scale {
    low: f32,
    high: f32,
    /// Whether values lie below or above the range.
    clipped: [bool; 2],
    /// Whether equal ratios rather than equal differences look equally far apart.
    logarithmic: bool,
    /// Whether values are whole numbers from 0 on, and not positive lengths.
    whole: bool,
    colors: Colors,
}

/// What the ends of a scale look like.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Colors {
    /// Equal steps of the value look equally large: dark violet to yellow.
    #[default]
    Perceptual,
    /// Accel's: green to red.
    GreenRed,
    /// Of fluids by speed: deep blue at rest to white spray.
    Water,
}

/// Part of the values at each end that shares the colour of the end.
const TAIL: f64 = 0.01;
/// A range whose middle value lies below this part of it is shown by ratios.
const SKEWED: f32 = 0.2;
/// Colours of the scales that are made from values.
const COLORS: Colors = Colors::Perceptual;

impl Scale {
    /// A scale over the bulk of the values, so that a few extreme ones do not make the rest look alike.
    pub(crate) fn of(values: &[u32]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_unstable();
        let (Some(&min), Some(&max)) = (sorted.first(), sorted.last()) else {
            return Self { low: 0.0, high: 0.0, clipped: [false; 2], logarithmic: false, whole: true, colors: COLORS };
        };
        let tail = (sorted.len() as f64 * TAIL) as usize;
        let (mut low, mut high) = (sorted[tail], sorted[sorted.len() - 1 - tail]);
        // Clipping that gains little is not worth the doubt, nor is a bulk of one value.
        if f64::from(high - low) > 0.8 * f64::from(max - min) || low == high {
            (low, high) = (min, max);
        }
        let middle = sorted[sorted.len() / 2];
        let logarithmic = ((middle - low) as f32) < SKEWED * (high - low) as f32;
        Self {
            low: low as f32,
            high: high as f32,
            clipped: [min < low, max > high],
            logarithmic,
            whole: true,
            colors: COLORS,
        }
    }

    /// As [`Scale::of`], over lengths; infinite ones do not count.
    pub(crate) fn of_lengths(values: &[f32]) -> Self {
        let mut sorted: Vec<f32> = values.iter().copied().filter(|value| value.is_finite()).collect();
        sorted.sort_unstable_by(f32::total_cmp);
        let (Some(&min), Some(&max)) = (sorted.first(), sorted.last()) else {
            return Self { low: 0.0, high: 0.0, clipped: [false; 2], logarithmic: false, whole: false, colors: COLORS };
        };
        let tail = (sorted.len() as f64 * TAIL) as usize;
        let (mut low, mut high) = (sorted[tail], sorted[sorted.len() - 1 - tail]);
        if high - low > 0.8 * (max - min) || low == high {
            (low, high) = (min, max);
        }
        let middle = sorted[sorted.len() / 2];
        let logarithmic = low > 0.0 && middle - low < SKEWED * (high - low);
        Self { low, high, clipped: [min < low, max > high], logarithmic, whole: false, colors: COLORS }
    }

    /// A scale from nothing to `max`, in equal steps.
    pub(crate) fn up_to(max: u32, colors: Colors) -> Self {
        Self { low: 0.0, high: max as f32, clipped: [false; 2], logarithmic: false, whole: true, colors }
    }

    /// A scale between two values, in equal steps; values outside have the colours of the ends.
    pub(crate) fn between(low: f32, high: f32, colors: Colors) -> Self {
        Self { low, high, clipped: [false; 2], logarithmic: false, whole: false, colors }
    }

    /// Colour of a number.
    pub(crate) fn color(&self, value: u32) -> [u8; 3] {
        self.color_of(value as f32)
    }

    /// Colour of a length.
    pub(crate) fn color_of(&self, value: f32) -> [u8; 3] {
        let alone = if self.colors == Colors::GreenRed { 0.0 } else { 0.5 };
        self.color_at(if self.high > self.low { self.place(value) } else { alone })
    }

    /// Colour of a place on the bar, 0 … 1; the darkest part of the perceptual one would not stand out from the background.
    fn color_at(&self, place: f32) -> [u8; 3] {
        match self.colors {
            Colors::Perceptual => viridis(0.16 + 0.84 * place.clamp(0.0, 1.0)),
            Colors::GreenRed => green_to_red(place),
            Colors::Water => water(place),
        }
    }

    /// What is added before the logarithm: one, so that the count 0 has one; lengths are positive.
    fn shift(&self) -> f32 {
        if self.whole { 1.0 } else { 0.0 }
    }

    /// Where a value stands on the bar, 0 … 1 for the range.
    fn place(&self, value: f32) -> f32 {
        let level = |v: f32| if self.logarithmic { (v.max(self.low) + self.shift()).ln() } else { v };
        (level(value) - level(self.low)) / (level(self.high) - level(self.low))
    }

    /// The value at a place of the bar.
    fn value(&self, place: f32) -> f32 {
        if self.logarithmic {
            let ratio = (self.high + self.shift()) / (self.low + self.shift());
            return (self.low + self.shift()) * ratio.powf(place) - self.shift();
        }
        self.low + place * (self.high - self.low)
    }
}

pub(super) fn draw(image: &mut Image, scene: &Scene<'_>) {
    let width = image.width.saturating_sub(60);
    let big = if text::size(&scene.title, 3)[0] <= width { 3 } else { 2 };
    text::draw(image, 30, 20, &text::fitted(&scene.title, big, width), big, INK);
    text::draw(image, 30, 26 + 9 * big, &text::fitted(&scene.subtitle, 2, width), 2, FAINT);
    if let Some(bar) = &scene.bar {
        draw_bar(image, bar);
    }
    draw_swatches(image, &scene.swatches);
}

fn draw_swatches(image: &mut Image, swatches: &[Swatch]) {
    let room = image.height.saturating_sub(SWATCH_LINE + 76 + 20) / SWATCH_LINE;
    let (left, top) = (
        image.width.saturating_sub(166),
        (image.height + 60).saturating_sub(room.min(swatches.len()) * SWATCH_LINE) / 2,
    );
    for (line, swatch) in swatches.iter().take(room).enumerate() {
        let y = top + line * SWATCH_LINE;
        let Some(color) = swatch.color else {
            text::draw(image, left, y, &text::fitted(&swatch.label, 2, 160), 2, FAINT);
            continue;
        };
        for i in 0..18 * 16 {
            image.blend((left + i % 18) as i64, (y + i / 18) as i64, color, 1.0);
        }
        text::draw(image, left + 26, y, &text::fitted(&swatch.label, 2, 136), 2, INK);
    }
}

fn draw_bar(image: &mut Image, bar: &Bar) {
    let height = BAR[1].min(image.height.saturating_sub(160));
    let (left, top) = (image.width.saturating_sub(136), (image.height + 60 - height) / 2);
    text::draw(image, left, top - 30, &text::fitted(&bar.label, 2, 136), 2, FAINT);
    for y in 0..height {
        let color = bar.scale.color_at(1.0 - y as f32 / (height - 1) as f32);
        for x in 0..BAR[0] {
            image.blend((left + x) as i64, (top + y) as i64, color, 1.0);
        }
    }
    for (t, label) in ticks(&bar.scale) {
        let y = top + ((1.0 - t) * (height - 1) as f32).round() as usize;
        for x in 0..6 {
            image.blend((left + BAR[0] + x) as i64, y as i64, INK, 1.0);
        }
        text::draw(image, left + BAR[0] + 10, y - 7, &label, 2, INK);
    }
}

/// Places on the bar, 0 … 1, and what to write there.
fn ticks(scale: &Scale) -> Vec<(f32, String)> {
    let range = scale.high - scale.low;
    let written = |value: f32| if scale.whole { written_whole(value) } else { short(value, 3) };
    if range <= 0.0 {
        return vec![(0.5, written(scale.low))];
    }
    let steps = if scale.whole && range < 4.0 { range as usize } else { 4 };
    let value = |i: usize| scale.value(i as f32 / steps as f32);
    let mut values: Vec<f32> = (0..=steps).map(|i| if scale.whole { value(i).round() } else { value(i) }).collect();
    values.dedup();
    let last = values.len() - 1;
    let tick = |(i, &value): (usize, &f32)| {
        let mark = match i {
            0 if scale.clipped[0] => "<=",
            i if i == last && scale.clipped[1] => ">=",
            _ => "",
        };
        (scale.place(value), format!("{mark}{}", written(value)))
    };
    values.iter().enumerate().map(tick).collect()
}

/// A whole number that fits beside the bar.
fn written_whole(value: f32) -> String {
    if value < 1e6 { grouped(value as u64) } else { format!("{:.2}M", value / 1e6) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_extreme_values_do_not_stretch_the_scale() {
        let mut values: Vec<u32> = (0..1000).map(|i| 10 + i % 20).collect();
        values.push(100_000);
        let scale = Scale::of(&values);
        let (clipped, colors) = ([false, true], Colors::Perceptual);
        assert_eq!(scale, Scale { low: 10.0, high: 29.0, clipped, logarithmic: false, whole: true, colors });
        assert_eq!(ticks(&scale).last().unwrap().1, ">=29");
        assert_eq!(scale.color(100_000), scale.color(29));
    }

    #[test]
    fn all_values_alike_have_one_tick() {
        let scale = Scale::of(&[7; 30]);
        assert_eq!(ticks(&scale), [(0.5, "7".to_owned())]);
        assert_eq!(ticks(&Scale::of(&[])).len(), 1);
    }

    #[test]
    fn skewed_values_are_shown_by_ratios() {
        let values: Vec<u32> = (0..100).map(|i| if i < 90 { i % 4 } else { 255 }).collect();
        let scale = Scale::of(&values);
        // 1 + value runs over 1, 4, 16, 64, 256: equal ratios, equal steps.
        let labels: Vec<(f32, String)> = ticks(&scale);
        let expected = [(0.0, 0), (0.25, 3), (0.5, 15), (0.75, 63), (1.0, 255)];
        for ((t, label), (place, value)) in labels.iter().zip(expected) {
            assert!((t - place).abs() < 1e-3 && *label == value.to_string(), "{labels:?}");
        }
    }

    #[test]
    fn lengths_have_ticks_between_whole_numbers_and_leave_out_infinite_ones() {
        let labels = |values: &[f32]| -> Vec<String> {
            ticks(&Scale::of_lengths(values)).into_iter().map(|tick| tick.1).collect()
        };
        assert_eq!(labels(&[0.5, f32::INFINITY, 0.25, 0.75]), ["0.25", "0.375", "0.5", "0.625", "0.75"]);
        assert_eq!(labels(&[0.125; 7]), ["0.125"]);
        assert_eq!(labels(&[f32::INFINITY]), ["0"]);
        // Most of them near 0.01 and some at 1: equal ratios, equal steps.
        let skewed: Vec<f32> = (0..100).map(|i| if i < 90 { 0.01 } else { 1.0 }).collect();
        assert_eq!(labels(&skewed), ["0.01", "0.0316", "0.1", "0.316", "1"]);
    }

    #[test]
    fn a_scale_from_nothing_is_not_cut_and_names_its_end() {
        let scale = Scale::up_to(59_616, Colors::GreenRed);
        let labels: Vec<String> = ticks(&scale).into_iter().map(|t| t.1).collect();
        assert_eq!(labels, ["0", "14,904", "29,808", "44,712", "59,616"]);
        assert_eq!((scale.color(0), scale.color(59_616)), ([0, 255, 0], [255, 0, 0]));
        // Nothing anywhere is the colour of nothing.
        assert_eq!(Scale::up_to(0, Colors::GreenRed).color(0), [0, 255, 0]);
    }

    #[test]
    fn small_ranges_have_whole_ticks() {
        let labels: Vec<String> = ticks(&Scale::of(&[1, 2, 3])).into_iter().map(|t| t.1).collect();
        assert_eq!(labels, ["1", "2", "3"]);
    }
}
