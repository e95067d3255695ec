//! What there is to say about an octree, as lines for people and as one JSON object for programs.

use nearfield::application::{PartReport, PartitionReport};
use nearfield::{DVec3, OctreeNode, Vec3};
use serde_json::{Map, Value, json};

use crate::octree::{Octree, Split};
use crate::report::{grouped, rounded, shortest, shown_ms, size, stage_json, table};

/// Parts that are listed one by one for people.
const LISTED_PARTS: usize = 64;

/// Nodes and leaves of a level.
struct Level {
    nodes: usize,
    leaves: usize,
}

fn levels(octree: &Octree) -> Vec<Level> {
    let tree = &octree.tree;
    let leaves = |range: &std::ops::Range<usize>| tree.nodes()[range.clone()].iter().filter(|n| n.is_leaf()).count();
    let ranges = (0..tree.n_levels() as u32).map(|level| tree.level(level));
    ranges.map(|range| Level { nodes: range.len(), leaves: leaves(&range) }).collect()
}

/// Number of leaves, and mean and largest number of points in one.
fn leaf_points(octree: &Octree) -> (u64, f64, u32) {
    let points = octree.tree.nodes().iter().filter(|node| node.is_leaf()).map(OctreeNode::n_points);
    let (mut n, mut max) = (0, 0);
    for points in points {
        (n, max) = (n + 1, max.max(points));
    }
    (n, octree.cloud.len() as f64 / (n as f64).max(1.0), max)
}

/// Where a place lies.
struct Located<'a> {
    place: DVec3,
    node: Option<(u32, &'a OctreeNode)>,
    part: Option<u32>,
}

fn located(octree: &Octree) -> Vec<Located<'_>> {
    let find = |&place: &DVec3| {
        let point: Vec3 = (place - octree.cloud.origin).as_vec3();
        let node = octree.tree.locate_at(point).map(|node| (node, &octree.tree.nodes()[node as usize]));
        Located { place, node, part: octree.split.as_ref().map(|split| split.partition.owner(point)) }
    };
    octree.located.iter().map(find).collect()
}

/// The object that `--json` prints.
pub(crate) fn json(octree: &Octree) -> Value {
    let tree = &octree.tree;
    let (levels, (leaves, mean, max)) = (levels(octree), leaf_points(octree));
    let domain_min = octree.cloud.origin + tree.domain().origin().as_dvec3();
    let milliseconds: Map<String, Value> =
        octree.times.iter().map(|&(name, ms)| (name.to_owned(), rounded(ms))).collect();
    let stages: Vec<Value> = octree.stages.iter().map(stage_json).collect();
    json!({
        "points": octree.cloud.len(),
        "source": octree.source,
        "curve": tree.curve().name(),
        "leaf_capacity": tree.settings().leaf_capacity,
        "max_depth": tree.settings().max_level,
        "domain_min": domain_min.to_array(),
        "domain_edge": shortest(tree.domain().edge()),
        "depth": tree.n_levels().saturating_sub(1),
        "nodes": tree.nodes().len(),
        "leaves": leaves,
        "nodes_by_level": levels.iter().map(|level| level.nodes).collect::<Vec<_>>(),
        "leaves_by_level": levels.iter().map(|level| level.leaves).collect::<Vec<_>>(),
        "leaf_points_mean": mean,
        "leaf_points_max": max,
        "located": located(octree).iter().map(|found| located_json(octree, found)).collect::<Vec<_>>(),
        "partition": octree.split.as_ref().map(split_json),
        "structure": "linear-octree",
        "device": octree.device,
        "memory_bytes": octree.memory_bytes,
        "milliseconds": milliseconds,
        "build_stages": stages,
        "notes": octree.notes,
    })
}

/// Keys have more bits than a number in JSON keeps.
fn hex(key: u64) -> String {
    format!("{key:#x}")
}

fn located_json(octree: &Octree, found: &Located<'_>) -> Value {
    let node = found.node.map(|(index, node)| {
        json!({
            "index": index,
            "octant": hex(node.octant.bits()),
            "level": node.level,
            "key": hex(node.octant.key()),
            "cell": node.octant.cell(octree.tree.curve()),
            "points": node.n_points(),
            "is_leaf": node.is_leaf(),
        })
    });
    json!({ "place": found.place.to_array(), "node": node, "part": found.part })
}

fn split_json(split: &Split) -> Value {
    let part = |(i, part): (usize, &PartReport)| {
        let Value::Object(mut fields) = part_json(part) else { return Value::Null };
        fields.insert("part".to_owned(), json!(i));
        Value::Object(fields)
    };
    let [morton, hilbert] = split.both().map(|report| {
        let Value::Object(mut fields) = part_json(&report.total()) else { return Value::Null };
        fields.insert("imbalance".to_owned(), json!(report.imbalance));
        Value::Object(fields)
    });
    json!({
        "parts": split.partition.parts(),
        "splitters": split.partition.splitters().iter().copied().map(hex).collect::<Vec<_>>(),
        "imbalance": split.report.imbalance,
        "radius": split.exchange.map(|exchange| shortest(exchange.radius)),
        "bytes_per_point": split.exchange.map(|exchange| exchange.bytes_per_point),
        "by_part": split.report.parts.iter().enumerate().map(part).collect::<Vec<_>>(),
        "totals": { "morton": morton, "hilbert": hilbert },
    })
}

fn part_json(part: &PartReport) -> Value {
    json!({
        "points": part.points,
        "work": part.work,
        "leaves": part.leaves,
        "surface": part.surface,
        "sent": part.sent,
        "received": part.received,
        "bytes": part.bytes,
    })
}

/// The lines for people.
pub(crate) fn lines(octree: &Octree) -> String {
    let tree = &octree.tree;
    let (leaves, mean, max) = leaf_points(octree);
    let min = octree.cloud.origin + tree.domain().origin().as_dvec3();
    let times: Vec<String> = octree
        .times
        .iter()
        .filter(|(_, ms)| *ms > 0.0)
        .map(|&(name, ms)| format!("{} {}", name.replace('_', " "), shown_ms(ms)))
        .collect();
    let stages: Vec<String> =
        octree.stages.iter().map(|stage| format!("{} {}", stage.name, shown_ms(stage.milliseconds))).collect();
    let settings = tree.settings();
    let rows = [
        (
            "points",
            format!(
                "{}{}",
                grouped(octree.cloud.len() as u64),
                if octree.source == "points" { "" } else { ", the centroids of triangles" }
            ),
        ),
        ("curve", tree.curve().name().to_owned()),
        ("domain", format!("a cube of edge {} at {} {} {}", tree.domain().edge(), min.x, min.y, min.z)),
        (
            "tree",
            format!(
                "{} nodes, {} leaves, depth {}; leaves of up to {} points, depth up to {}",
                grouped(tree.nodes().len() as u64),
                grouped(leaves),
                tree.n_levels().saturating_sub(1),
                settings.leaf_capacity,
                settings.max_level,
            ),
        ),
        ("leaves", format!("mean {mean:.2}, max {} points", grouped(max.into()))),
        ("device", octree.device.clone()),
        ("structure", format!("linear-octree, {}", size(octree.memory_bytes))),
        ("time", times.join(", ")),
        ("build", stages.join(", ")),
    ];
    let mut text: String = rows.iter().map(|(name, value)| format!("{name:<12}{value}\n")).collect();
    for note in &octree.notes {
        text += &format!("{:<12}{note}\n", "note");
    }
    for found in located(octree) {
        text += &format!("{:<12}{}\n", "located", located_line(octree, &found));
    }
    text += &format!("\n{}", level_table(octree));
    if let Some(split) = &octree.split {
        text += &format!("\n{}\n{}", part_table(split), curve_table(split));
    }
    text
}

fn located_line(octree: &Octree, found: &Located<'_>) -> String {
    let DVec3 { x, y, z } = found.place;
    let part = found.part.map_or(String::new(), |part| format!(", part {part}"));
    let Some((index, node)) = found.node else {
        return format!("{x} {y} {z}: outside the domain{part}");
    };
    let [i, j, k] = node.octant.cell(octree.tree.curve());
    let kind = if node.is_leaf() { "leaf" } else { "nothing there; smallest node around it is" };
    let (points, level, key) = (grouped(node.n_points().into()), node.level, node.octant.key());
    format!("{x} {y} {z}: {kind} {index} at level {level}, cell {i} {j} {k}, key {key:#o}, {points} points{part}")
}

fn level_table(octree: &Octree) -> String {
    let mut rows = vec![["level", "nodes", "leaves"].map(str::to_owned).to_vec()];
    for (i, level) in levels(octree).iter().enumerate() {
        rows.push(vec![i.to_string(), grouped(level.nodes as u64), grouped(level.leaves as u64)]);
    }
    table(&rows, &[0, 1, 2])
}

const COLUMNS: [&str; 6] = ["points", "leaves", "surface", "sent", "received", "bytes"];

/// The columns of a part, without those that were not asked for.
fn cells(part: &PartReport) -> Vec<String> {
    let mut cells = [part.points, part.leaves, part.surface].map(grouped).to_vec();
    cells.extend([part.sent, part.received].into_iter().flatten().map(grouped));
    cells.extend(part.bytes.map(size));
    cells
}

fn heading(first: &str, split: &Split) -> Vec<String> {
    let n = if split.exchange.is_some() { COLUMNS.len() } else { 3 };
    std::iter::once(first).chain(COLUMNS[..n].iter().copied()).map(str::to_owned).collect()
}

fn part_table(split: &Split) -> String {
    let parts = &split.report.parts;
    let mut rows = vec![heading("part", split)];
    for (i, part) in parts.iter().take(LISTED_PARTS).enumerate() {
        rows.push([vec![i.to_string()], cells(part)].concat());
    }
    let more = match parts.len().saturating_sub(LISTED_PARTS) {
        0 => String::new(),
        n => format!("… and {} parts more; --json has all\n", grouped(n as u64)),
    };
    table(&rows, &[0, 1, 2, 3, 4, 5, 6]) + &more
}

/// The sums along either curve.
fn curve_table(split: &Split) -> String {
    let mut rows = vec![heading("curve", split)];
    rows[0].push("largest / mean".to_owned());
    for report in split.both() {
        rows.push(curve_row(report));
    }
    let radius = match split.exchange {
        Some(exchange) => {
            format!(
                "sent: points within {} of a point of another part, {} bytes each\n",
                exchange.radius, exchange.bytes_per_point
            )
        }
        None => String::new(),
    };
    table(&rows, &[1, 2, 3, 4, 5, 6, 7]) + &radius
}

fn curve_row(report: &PartitionReport) -> Vec<String> {
    [vec![report.curve.name().to_owned()], cells(&report.total()), vec![format!("{:.4}", report.imbalance)]].concat()
}
