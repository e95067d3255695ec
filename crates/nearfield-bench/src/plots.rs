//! Plots of the experiments as SVG: lines over one or more panels, and bars of shares.

use std::path::Path;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{Ranged, ValueFormatter};
use plotters::prelude::*;

use crate::{Error, Result};

/// Colours that people with any colour vision tell apart (after Okabe and Ito); then grey, black, brown, indigo and olive.
const COLORS: [RGBColor; 12] = [
    RGBColor(213, 94, 0),
    RGBColor(0, 114, 178),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(136, 34, 85),
    RGBColor(130, 130, 130),
    RGBColor(0, 0, 0),
    RGBColor(120, 94, 40),
    RGBColor(51, 34, 136),
    RGBColor(153, 153, 51),
];
const FONT: &str = "sans-serif";
const MARGIN: u32 = 14;
const CAPTION_LINE: i32 = 17;
/// Panels with more lines than this share a legend beside them, which covers nothing.
const MOST_LINES_WITH_LEGEND: usize = 6;
/// Width of that legend.
const LEGEND_WIDTH: u32 = 270;

/// A line with marks.
#[derive(Debug, Clone)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Number of its colour, the same in every plot.
    pub color: usize,
    /// Ascending in x; positive along logarithmic axes.
    pub points: Vec<(f64, f64)>,
    /// How it is drawn.
    pub look: Look,
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// A line with dots at its points: what was measured.
    Line,
    /// Dots alone: measured points in no order.
    Dots,
    /// Crosses alone: the figures of a publication.
    Published,
}

/// Which axes are logarithmic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axes {
    /// None; both begin at zero.
    Linear,
    /// Both.
    Logarithmic,
    /// y alone.
    LogarithmicY,
}

/// Some lines over one pair of axes.
#[derive(Debug, Clone)]
pub struct Panel {
    /// What is special to this panel.
    pub title: String,
    /// The lines.
    pub series: Vec<Series>,
}

/// What stands around the panels of a plot.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Headline.
    pub title: String,
    /// Device, commit and what else a reader needs, a line each.
    pub caption: Vec<String>,
    /// Label of the x axes with its unit.
    pub x_label: String,
    /// Label of the y axes with its unit.
    pub y_label: String,
    /// Which axes are logarithmic.
    pub axes: Axes,
    /// Whether the legend of lines stands on the right, for curves that fall.
    pub legend_right: bool,
}

/// A bar of parts that are drawn as shares of their sum.
#[derive(Debug, Clone)]
pub struct Bar {
    /// Name below the bar.
    pub label: String,
    /// Parts from the bottom, with their milliseconds.
    pub parts: Vec<(String, f64)>,
}

/// Draws panels side by side, two a row.
///
/// # Errors
/// A file that cannot be written.
pub fn lines(path: &Path, frame: &Frame, panels: &[Panel]) -> Result<()> {
    let columns = if panels.len() > 1 { 2 } else { 1 };
    let rows = panels.len().div_ceil(columns).max(1);
    let (width, height) = if columns == 1 { (840, 560) } else { (1120, 430 * rows as u32 + 110) };
    let has_strip = panels.iter().any(|panel| panel.series.len() > MOST_LINES_WITH_LEGEND);
    let root = SVGBackend::new(path, (width + if has_strip { LEGEND_WIDTH } else { 0 }, height)).into_drawing_area();
    let mut body = draw_frame(&root, frame)?;
    if has_strip {
        let (charts, strip) = body.split_horizontally(width);
        draw_legend(&strip, panels)?;
        body = charts;
    }
    for (panel, area) in panels.iter().zip(body.split_evenly((rows, columns))) {
        let Some((x, y)) = ranges(panel, frame.axes) else {
            continue;
        };
        let mut chart = ChartBuilder::on(&area);
        chart.margin(MARGIN).x_label_area_size(46).y_label_area_size(74);
        if !panel.title.is_empty() {
            chart.caption(&panel.title, (FONT, 16).into_font());
        }
        match frame.axes {
            Axes::Linear => {
                let mut chart = chart.build_cartesian_2d(x.0..x.1, y.0..y.1).map_err(failed)?;
                draw_lines(&mut chart, frame, panel, !has_strip)?;
            }
            Axes::Logarithmic => {
                let (x, y) = ((x.0..x.1).log_scale(), (y.0..y.1).log_scale());
                draw_lines(&mut chart.build_cartesian_2d(x, y).map_err(failed)?, frame, panel, !has_strip)?;
            }
            Axes::LogarithmicY => {
                let mut chart = chart.build_cartesian_2d(x.0..x.1, (y.0..y.1).log_scale()).map_err(failed)?;
                draw_lines(&mut chart, frame, panel, !has_strip)?;
            }
        }
    }
    root.present().map_err(failed)
}

/// Draws bars of shares, each with the sum above it and a percentage in every part that has room for one.
///
/// # Errors
/// A file that cannot be written.
pub fn shares(path: &Path, frame: &Frame, bars: &[Bar]) -> Result<()> {
    let root = SVGBackend::new(path, (210 * bars.len().max(2) as u32 + 250, 580)).into_drawing_area();
    let body = draw_frame(&root, frame)?;
    // The bar with the most parts gives the order.
    let mut in_order: Vec<&Bar> = bars.iter().collect();
    in_order.sort_by_key(|bar| std::cmp::Reverse(bar.parts.len()));
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in in_order.iter().flat_map(|b| &b.parts) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    // The legend stands in the free room right of the bars.
    let right = bars.len() as f64 + 0.8;
    let mut chart = ChartBuilder::on(&body)
        .margin(MARGIN)
        .x_label_area_size(46)
        .y_label_area_size(64)
        .build_cartesian_2d(0.0..right, 0.0..108.0)
        .map_err(failed)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .disable_x_axis()
        .light_line_style(TRANSPARENT)
        .y_desc(&frame.y_label)
        .y_label_formatter(&|share| if *share > 100.5 { String::new() } else { format!("{share:.0}") })
        .label_style((FONT, 13))
        .axis_desc_style((FONT, 15))
        .draw()
        .map_err(failed)?;
    for (number, name) in names.iter().enumerate() {
        let color = COLORS[number % COLORS.len()];
        let mut boxes = Vec::new();
        let mut labels = Vec::new();
        for (place, bar) in bars.iter().enumerate() {
            let sum: f64 = bar.parts.iter().map(|p| p.1).sum();
            let mut bottom = 0.0;
            for (part, milliseconds) in &bar.parts {
                let share = 100.0 * milliseconds / sum.max(f64::MIN_POSITIVE);
                if part == name {
                    let corners = [(place as f64 + 0.15, bottom), (place as f64 + 0.85, bottom + share)];
                    boxes.push(Rectangle::new(corners, color.filled()));
                    if share >= 4.0 {
                        let at = (place as f64 + 0.5, bottom + 0.5 * share);
                        labels.push(Text::new(format!("{share:.0} %"), at, centered(13, &WHITE)));
                    }
                }
                bottom += share;
            }
        }
        let series = chart.draw_series(boxes).map_err(failed)?;
        series.label(*name).legend(move |(x, y)| Rectangle::new([(x, y - 6), (x + 14, y + 6)], color.filled()));
        chart.draw_series(labels).map_err(failed)?;
    }
    let sums = bars.iter().enumerate().map(|(place, bar)| {
        let sum: f64 = bar.parts.iter().map(|p| p.1).sum();
        Text::new(format!("{} ms", short(sum)), (place as f64 + 0.5, 103.0), centered(14, &BLACK))
    });
    chart.draw_series(sums).map_err(failed)?;
    for (place, bar) in bars.iter().enumerate() {
        let (x, y) = chart.plotting_area().map_coordinate(&(place as f64 + 0.5, 0.0));
        for (line, text) in bar.label.lines().enumerate() {
            let at = (x, y + 14 + CAPTION_LINE * line as i32);
            root.draw(&Text::new(text.to_owned(), at, centered(14, &BLACK))).map_err(failed)?;
        }
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .border_style(BLACK.mix(0.3))
        .background_style(WHITE)
        .label_font((FONT, 14))
        .draw()
        .map_err(failed)?;
    root.present().map_err(failed)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Fills the background, writes headline and caption, and returns the area between them.
fn draw_frame<'a>(root: &Area<'a>, frame: &Frame) -> Result<Area<'a>> {
    root.fill(&WHITE).map_err(failed)?;
    let body = root.margin(10, 0, 0, 0).titled(&frame.title, (FONT, 21)).map_err(failed)?;
    let (_, height) = root.dim_in_pixel();
    let caption_height = CAPTION_LINE * frame.caption.len() as i32 + 8;
    for (line, text) in frame.caption.iter().enumerate() {
        let y = height as i32 - caption_height + CAPTION_LINE * line as i32;
        let style = (FONT, 13).into_font().color(&RGBColor(80, 80, 80));
        root.draw(&Text::new(text.clone(), (MARGIN as i32, y), style)).map_err(failed)?;
    }
    let (_, body_height) = body.dim_in_pixel();
    Ok(body.split_vertically(body_height as i32 - caption_height).0)
}

fn draw_lines<'a, 'b: 'a, X, Y>(
    chart: &mut ChartContext<'a, SVGBackend<'b>, Cartesian2d<X, Y>>,
    frame: &Frame,
    panel: &Panel,
    with_legend: bool,
) -> Result<()>
where
    X: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .x_desc(&frame.x_label)
        .y_desc(&frame.y_label)
        .x_label_formatter(&|x| tick(*x, frame.axes == Axes::Logarithmic))
        .y_label_formatter(&|y| tick(*y, frame.axes != Axes::Linear))
        .label_style((FONT, 13))
        .axis_desc_style((FONT, 15))
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.13))
        .draw()
        .map_err(failed)?;
    for series in &panel.series {
        let color = COLORS[series.color % COLORS.len()];
        let points = series.points.iter().copied();
        match series.look {
            Look::Line => {
                let line = LineSeries::new(points, color.stroke_width(2)).point_size(3);
                let drawn = chart.draw_series(line).map_err(failed)?;
                let stroke = color.stroke_width(3);
                drawn.label(&series.name).legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], stroke));
            }
            Look::Dots => {
                let dots = points.map(|at| Circle::new(at, 3, color.mix(0.6).filled()));
                let drawn = chart.draw_series(dots).map_err(failed)?;
                drawn.label(&series.name).legend(move |(x, y)| Circle::new((x + 9, y), 4, color.filled()));
            }
            Look::Published => {
                let crosses = points.map(|at| Cross::new(at, 6, color.stroke_width(2)));
                let drawn = chart.draw_series(crosses).map_err(failed)?;
                let stroke = color.stroke_width(2);
                drawn.label(&series.name).legend(move |(x, y)| Cross::new((x + 9, y), 6, stroke));
            }
        }
    }
    if !with_legend {
        return Ok(());
    }
    let legend = match frame.legend_right {
        true => SeriesLabelPosition::UpperRight,
        false => SeriesLabelPosition::UpperLeft,
    };
    chart
        .configure_series_labels()
        .position(legend)
        .border_style(BLACK.mix(0.3))
        .background_style(WHITE.mix(0.85))
        .label_font((FONT, 13))
        .draw()
        .map_err(failed)
}

/// Writes the names of all series of the panels below each other, each once.
fn draw_legend(strip: &Area<'_>, panels: &[Panel]) -> Result<()> {
    let mut names: Vec<&str> = Vec::new();
    for series in panels.iter().flat_map(|panel| &panel.series) {
        if names.contains(&series.name.as_str()) || series.points.is_empty() {
            continue;
        }
        let (y, color) = (40 + 22 * names.len() as i32, COLORS[series.color % COLORS.len()]);
        let stroke = color.stroke_width(3);
        match series.look {
            Look::Line => strip.draw(&PathElement::new([(6, y), (26, y)], stroke)),
            Look::Dots => strip.draw(&Circle::new((16, y), 4, color.filled())),
            Look::Published => strip.draw(&Cross::new((16, y), 6, color.stroke_width(2))),
        }
        .map_err(failed)?;
        strip.draw(&Text::new(series.name.clone(), (34, y - 6), (FONT, 13).into_font())).map_err(failed)?;
        names.push(&series.name);
    }
    Ok(())
}

/// Ranges of x and y that hold every point, with a little room; `None` where there is no point.
fn ranges(panel: &Panel, axes: Axes) -> Option<((f64, f64), (f64, f64))> {
    let points = || panel.series.iter().flat_map(|s| &s.points);
    let hull = |values: &mut dyn Iterator<Item = f64>| {
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
    };
    let (x, y) = (hull(&mut points().map(|p| p.0)), hull(&mut points().map(|p| p.1)));
    if x.0 > x.1 {
        return None;
    }
    // Room for a legend above the lines.
    let has_legend = panel.series.len() <= MOST_LINES_WITH_LEGEND;
    let (log_y, linear_y) = ((y.0 / 1.5, y.1 * if has_legend { 4.0 } else { 1.5 }), (0.0, y.1 * 1.45));
    Some(match axes {
        Axes::Linear => ((0.0, x.1 * 1.03), linear_y),
        Axes::Logarithmic => ((x.0 / 1.15, x.1 * 1.15), log_y),
        Axes::LogarithmicY => ((x.0 - 0.03 * (x.1 - x.0), x.1 + 0.03 * (x.1 - x.0)), log_y),
    })
}

fn centered(size: u32, color: &RGBColor) -> TextStyle<'static> {
    use plotters::style::text_anchor::{HPos, Pos, VPos};
    (FONT, size).into_font().color(color).pos(Pos::new(HPos::Center, VPos::Center))
}

/// Label of a tick; on logarithmic axes only 1, 2 and 5 times a power of ten have one.
fn tick(value: f64, logarithmic: bool) -> String {
    let mantissa = value / 10f64.powf(value.max(f64::MIN_POSITIVE).log10().floor());
    let labelled = [1.0, 2.0, 5.0, 10.0].iter().any(|m| (mantissa - m).abs() < 1e-6);
    if logarithmic && !labelled { String::new() } else { short(value) }
}

/// A number with at most three digits and a unit prefix.
pub fn short(value: f64) -> String {
    let (scaled, prefix) = match value.abs() {
        v if v >= 0.9995e9 => (value * 1e-9, "G"),
        v if v >= 0.9995e6 => (value * 1e-6, "M"),
        v if v >= 0.9995e3 => (value * 1e-3, "k"),
        _ => (value, ""),
    };
    let places = match scaled.abs() {
        0.0 => 0,
        v if v >= 99.5 => 0,
        v if v >= 9.95 => 1,
        v if v >= 0.995 => 2,
        v => (2.0 - v.log10().floor()).clamp(0.0, 6.0) as usize,
    };
    let text = format!("{scaled:.places$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text}{prefix}")
}

fn failed(error: impl std::fmt::Display) -> Error {
    format!("plot: {error}").into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithmic_axes_label_few_ticks() {
        let labelled: Vec<String> =
            (1..=20).map(|i| tick(f64::from(i) * 0.1, true)).filter(|text| !text.is_empty()).collect();
        assert_eq!(labelled, ["0.1", "0.2", "0.5", "1", "2"]);
        assert_eq!(tick(0.3, false), "0.3");
    }

    #[test]
    fn numbers_are_short() {
        let cases = [
            (0.0, "0"),
            (0.02, "0.02"),
            (0.00123, "0.00123"),
            (1.0, "1"),
            (12.34, "12.3"),
            (999.9, "1k"),
            (1500.0, "1.5k"),
            (100_000.0, "100k"),
            (2.5e6, "2.5M"),
        ];
        for (value, text) in cases {
            assert_eq!(short(value), text, "{value}");
        }
    }
}
