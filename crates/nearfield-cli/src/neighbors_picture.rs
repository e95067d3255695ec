//! The picture of a search: points coloured by count, by cell, or around one query.

use std::path::Path;

use nearfield::io::Format;
use nearfield::structure::GridSettings;
use nearfield::structure::uniform_grid::GridLayout;
use nearfield::{Aabb, Vec3};

use crate::colormap;
use crate::neighbors::{Color, Found};
use crate::options::PictureSize;
use crate::picture::{self, Bar, Image, Scale, Scene, Up};
use crate::report::{DIGITS, grouped, short};

const GREEN: [u8; 3] = [70, 235, 90];
const BLUE: [u8; 3] = [70, 140, 255];
const GREY: [u8; 3] = [120, 124, 130];
/// The view around one query reaches this many radii.
const VIEW: f32 = 5.0;
/// Size of the balls there: separate ones are easier to count.
const BALL: f32 = 0.7;

/// The direction that is most likely up.
pub(crate) fn guess_up(found: &Found<'_>, path: &Path, format: Option<Format>) -> Up {
    let format = format.or_else(|| Format::from_path(path).ok());
    let modelling = matches!(format, Some(Format::Obj | Format::Ply));
    picture::likely_up(Aabb::of_points(found.points).extent(), modelling)
}

/// Draws what was found.
pub(crate) fn draw(found: &Found<'_>, color: Color, up: Up, size: PictureSize) -> Image {
    let mut points = found.points.to_vec();
    let mut scene = Scene {
        points: &[],
        colors: &[],
        sizes: &[],
        focus: &[],
        up,
        title: format!("{}: {} points, {}", found.name, grouped(found.points.len() as u64), found.asked),
        subtitle: counts_line(found),
        bar: None,
        swatches: vec![],
    };
    let (mut focus, mut sizes) = (vec![], vec![]);
    let mut colors: Vec<[u8; 3]> = match color {
        Color::Count => {
            let scale = Scale::of(found.counts);
            scene.bar = Some(Bar { label: "neighbours".to_owned(), scale });
            let counts = found.counts.iter().map(|&count| scale.color(count));
            match found.queries {
                None => counts.collect(),
                Some(_) => vec![GREY; points.len()].into_iter().chain(counts).collect(),
            }
        }
        Color::Distance => {
            let (k, kth) = found.kth.unwrap_or((0, &[]));
            let scale = Scale::of_lengths(kth);
            let none = kth.iter().filter(|distance| distance.is_infinite()).count();
            scene.bar = Some(Bar { label: "distance".to_owned(), scale });
            scene.subtitle = distance_line(k, kth, none);
            let distances = kth.iter().map(|&d| if d.is_finite() { scale.color_of(d) } else { GREY });
            match found.queries {
                None => distances.collect(),
                Some(_) => vec![GREY; points.len()].into_iter().chain(distances).collect(),
            }
        }
        Color::Cell => {
            let settings = GridSettings { refine_x: 1, ..GridSettings::for_radius(found.cell) };
            let bounds = Aabb::of_points(found.points);
            let layout = GridLayout::new(points.len() as u32, &bounds, &settings.periodic(found.period));
            scene.subtitle = format!(
                "every grid cell has its own colour; {} x {} x {} cells as wide as the {}radius",
                layout.cells[0],
                layout.cells[1],
                layout.cells[2],
                if found.varied { "largest " } else { "" }
            );
            points.iter().map(|&p| cell_color(layout.cell_of(p))).collect()
        }
        Color::NeighborsOf(query) => {
            let mut colors = vec![GREY; points.len()];
            let (row, reach) = &found.shown_row;
            for &i in row {
                colors[i as usize] = BLUE;
            }
            let center = found.queries.map_or_else(|| points[query], |queries| queries[query]);
            scene.subtitle = format!("query {query} (green) has {} neighbours (blue)", row.len());
            if found.queries.is_none() {
                colors[query] = GREEN;
                sizes = vec![BALL; points.len()];
                sizes[query] = 1.6 * BALL;
            }
            let reach = VIEW * reach;
            focus = points.iter().copied().filter(|p| p.distance(center) <= reach).collect();
            // What lies farther away would only stand between the eye and the query.
            for (point, color) in points.iter_mut().zip(&colors) {
                if *color == GREY && point.distance(center) > 2.0 * reach {
                    *point = Vec3::NAN;
                }
            }
            colors
        }
    };
    // Other queries are drawn as points of their own, larger than the rest.
    if let Some(queries) = found.queries {
        let shown: &[Vec3] = match color {
            Color::Count | Color::Distance => queries,
            Color::Cell => &[],
            Color::NeighborsOf(query) => {
                colors.push(GREEN);
                &queries[query..=query]
            }
        };
        sizes = vec![1.0; points.len()];
        sizes.resize(points.len() + shown.len(), 2.0);
        points.extend_from_slice(shown);
    }
    (scene.points, scene.colors, scene.sizes, scene.focus) = (&points, &colors, &sizes, &focus);
    picture::draw(&scene, size)
}

fn distance_line(k: u32, kth: &[f32], none: usize) -> String {
    let mut finite: Vec<f32> = kth.iter().copied().filter(|distance| distance.is_finite()).collect();
    finite.sort_unstable_by(f32::total_cmp);
    let (Some(&low), Some(&high)) = (finite.first(), finite.last()) else {
        return format!("no query has {k} neighbours");
    };
    let fewer = if none > 0 { format!(", {} have fewer (grey)", grouped(none as u64)) } else { String::new() };
    let middle = finite[finite.len() / 2];
    format!(
        "distance of neighbour {k}: median {}, min {}, max {}{fewer}",
        short(middle, DIGITS),
        short(low, DIGITS),
        short(high, DIGITS)
    )
}

fn counts_line(found: &Found<'_>) -> String {
    let summary = &found.summary;
    let who = match found.queries {
        Some(queries) => format!("{} queries, ", grouped(queries.len() as u64)),
        None => String::new(),
    };
    format!("{who}neighbours mean {:.1}, min {}, max {}", summary.mean, summary.min, grouped(summary.max.into()))
}

fn cell_color([x, y, z]: [u32; 3]) -> [u8; 3] {
    colormap::distinct(u64::from(x) << 42 ^ u64::from(y) << 21 ^ u64::from(z))
}
