//! The picture of a heat map: a pixel a ray, in the colour of its work.

use crate::heatmap::Heatmap;
use crate::picture::{self, Bar, Colors, Image, Scale, Scene, Up};
use crate::report::grouped;

/// Draws the metric that was asked for, from 0 to its largest value.
pub(crate) fn draw(map: &Heatmap, colors: Colors) -> Image {
    let values = map.values(map.metric);
    let all = &map.summaries[map.metric as usize].all;
    let scale = Scale::up_to(all.max, colors);
    let raster: Vec<[u8; 3]> = values.map(|value| scale.color(value)).collect();
    let touched = match &map.summaries[map.metric as usize].touched {
        Some(touched) => format!(", mean {:.1} where there are any", touched.mean),
        None => String::new(),
    };
    let scene = Scene {
        points: &[],
        colors: &[],
        sizes: &[],
        focus: &[],
        up: Up::Y,
        title: format!("{}: {}", map.name, map.built.plan.describe()),
        subtitle: format!("{} a pixel: at most {}{touched}", map.metric.name(), grouped(all.max.into())),
        bar: Some(Bar { label: map.metric.short().to_owned(), scale }),
        swatches: vec![],
    };
    picture::draw_raster(&raster, &scene, map.size)
}
