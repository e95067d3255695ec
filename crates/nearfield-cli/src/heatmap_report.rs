//! What there is to say about a heat map: lines for people, one JSON object, and a table with one row a pixel.

use std::io::{self, Write};

use serde_json::{Map, Value, json};

use crate::heatmap::{Heatmap, Metric};
use crate::report::{grouped, shown_ms, stage_json, table};

/// How counts are spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Distribution {
    pub(crate) pixels: u64,
    pub(crate) min: u32,
    pub(crate) mean: f64,
    pub(crate) median: u32,
    /// The smallest count that 99 % of the pixels do not exceed.
    pub(crate) p99: u32,
    pub(crate) max: u32,
}

/// Counts of a metric over all pixels, and over those with any.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Summary {
    pub(crate) all: Distribution,
    pub(crate) touched: Option<Distribution>,
}

impl Distribution {
    /// Of counts in ascending order; `None` without any.
    fn of_sorted(counts: &[u32]) -> Option<Self> {
        let (&min, &max) = (counts.first()?, counts.last()?);
        let n = counts.len();
        // The smallest count with at least this share of the pixels at or below it.
        let at = |share: f64| counts[((share * n as f64).ceil() as usize).clamp(1, n) - 1];
        let sum: u64 = counts.iter().map(|&count| u64::from(count)).sum();
        Some(Self { pixels: n as u64, min, mean: sum as f64 / n as f64, median: at(0.5), p99: at(0.99), max })
    }

    fn json(&self) -> Value {
        json!({
            "pixels": self.pixels,
            "min": self.min,
            "mean": self.mean,
            "median": self.median,
            "p99": self.p99,
            "max": self.max,
        })
    }

    fn row(&self, name: &str) -> Vec<String> {
        let whole = |count: u32| grouped(count.into());
        vec![
            name.to_owned(),
            grouped(self.pixels),
            whole(self.min),
            format!("{:.2}", self.mean),
            whole(self.median),
            whole(self.p99),
            whole(self.max),
        ]
    }
}

impl Summary {
    /// Of the counts of all pixels, of which there is at least one.
    pub(crate) fn of(mut counts: Vec<u32>) -> Self {
        counts.sort_unstable();
        let first = counts.partition_point(|&count| count == 0);
        let nothing = Distribution { pixels: 0, min: 0, mean: 0.0, median: 0, p99: 0, max: 0 };
        Self {
            all: Distribution::of_sorted(&counts).unwrap_or(nothing),
            touched: Distribution::of_sorted(&counts[first..]),
        }
    }
}

/// Rays a second in millions.
fn mrays(rays: u64, milliseconds: f64) -> f64 {
    if milliseconds > 0.0 { rays as f64 * 1e-3 / milliseconds } else { 0.0 }
}

fn n_hits(map: &Heatmap) -> u64 {
    map.records.iter().filter(|record| record.is_hit()).count() as u64
}

/// The object that `--json` prints.
pub(crate) fn json(map: &Heatmap) -> Value {
    let rays = map.work.len() as u64;
    let named = |metric: Metric| metric.name().replace(' ', "_");
    let metrics: Map<String, Value> = Metric::ALL
        .into_iter()
        .map(|metric| {
            let Summary { all, touched } = &map.summaries[metric as usize];
            (named(metric), json!({ "all": all.json(), "touched": touched.as_ref().map(Distribution::json) }))
        })
        .collect();
    json!({
        "mesh": map.name,
        "triangles": map.triangles,
        "width": map.size.width,
        "height": map.size.height,
        "rays": rays,
        "hits": n_hits(map),
        "metric": named(map.metric),
        "metrics": metrics,
        "device": map.device,
        "structure": map.built.json(),
        "mrays_per_second": mrays(rays, map.times.query),
        "mrays_per_second_on_device": map.device_ms().map(|ms| mrays(rays, ms)),
        "cast_stages": map.stages.iter().map(stage_json).collect::<Vec<_>>(),
        "milliseconds": map.times.json(),
        "notes": map.notes,
    })
}

/// The lines for people.
pub(crate) fn lines(map: &Heatmap) -> String {
    let rays = map.work.len() as u64;
    let on_device =
        map.device_ms().map(|ms| format!("; {:.2} on the device's clock", mrays(rays, ms))).unwrap_or_default();
    let mut text = String::new();
    for (name, value) in [
        ("mesh", format!("{}, {} triangles", map.name, grouped(map.triangles))),
        ("rays", format!("{} ({} x {}), {} hit", grouped(rays), map.size.width, map.size.height, grouped(n_hits(map)))),
        ("device", map.device.clone()),
        ("structure", map.built.line()),
        ("time", map.times.line()),
        (
            "cast",
            format!(
                "{} with counting, {:.2} Mrays/s{on_device}",
                shown_ms(map.times.query),
                mrays(rays, map.times.query)
            ),
        ),
    ] {
        text += &format!("{name:<12}{value}\n");
    }
    for note in &map.notes {
        text += &format!("{:<12}{note}\n", "note");
    }
    let heading = [map.metric.name(), "pixels", "min", "mean", "median", "p99", "max"];
    let mut rows = vec![heading.map(str::to_owned).to_vec()];
    let Summary { all, touched } = &map.summaries[map.metric as usize];
    rows.push(all.row("all"));
    rows.extend(touched.as_ref().map(|touched| touched.row("touched")));
    text + "\n" + &table(&rows, &[1, 2, 3, 4, 5, 6])
}

/// One row a pixel.
pub(crate) fn write_csv(map: &Heatmap, w: &mut dyn Write) -> io::Result<()> {
    writeln!(w, "x,y,triangle,t,triangle_tests,node_visits,leaf_visits,rope_steps")?;
    let width = map.size.width as usize;
    for (i, (record, work)) in map.records.iter().zip(&map.work).enumerate() {
        write!(w, "{},{},", i % width, i / width)?;
        if record.is_hit() {
            write!(w, "{},{}", record.triangle, record.t)?;
        } else {
            write!(w, ",")?;
        }
        let [tests, nodes, leaves, ropes] = [work.triangle_tests, work.node_visits, work.leaf_visits, work.rope_steps];
        writeln!(w, ",{tests},{nodes},{leaves},{ropes}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_summed_up_with_and_without_zeros() {
        // 0 twice, then 1 to 98: 99 % of a hundred are the first 99.
        let summary = Summary::of((0..100u32).map(|i| i.saturating_sub(1)).rev().collect());
        let all = summary.all;
        assert_eq!((all.pixels, all.min, all.median, all.p99, all.max), (100, 0, 48, 97, 98));
        assert_eq!(all.mean, f64::from((1..=98).sum::<u32>()) / 100.0);
        let touched = summary.touched.unwrap();
        assert_eq!((touched.pixels, touched.min, touched.median, touched.max), (98, 1, 49, 98));
        assert_eq!(touched.mean, 49.5);
        assert_eq!(Summary::of(vec![0; 5]).touched, None);
    }
}
