//! The picture of an octree: the points of its parts, or the cells that a plane cuts.

use nearfield::curve::MAX_LEVEL;
use nearfield::{Aabb, Octant, Vec3};

use crate::colormap;
use crate::octree::{Octree, Split};
use crate::options::PictureSize;
use crate::picture::{self, Bar, Image, Scale, Scene, Swatch, Tile, Up};
use crate::report::grouped;

/// Parts that the legend lists.
const LISTED_PARTS: usize = 24;

/// Draws the parts, where there are any, else a slice of the cells.
pub(crate) fn draw(octree: &Octree, up: Up, size: PictureSize) -> Image {
    match &octree.split {
        Some(split) => draw_parts(octree, split, up, size),
        None => draw_slice(octree, size),
    }
}

fn scene(title: String, subtitle: String, up: Up) -> Scene<'static> {
    Scene { points: &[], colors: &[], sizes: &[], focus: &[], up, title, subtitle, bar: None, swatches: vec![] }
}

fn draw_parts(octree: &Octree, split: &Split, up: Up, size: PictureSize) -> Image {
    let points = &octree.cloud.points;
    let colors: Vec<[u8; 3]> = split.partition.owners(points).into_iter().map(colormap::category).collect();
    let n_parts = split.partition.parts();
    let total = split.report.total();
    let title = format!("{}: {} {} in {n_parts} parts", octree.name, grouped(points.len() as u64), octree.source);
    let subtitle = format!(
        "{} curve, largest part {:.4} of the mean, {} of {} leaves touch another part",
        octree.tree.curve(),
        split.report.imbalance,
        grouped(total.surface),
        grouped(total.leaves)
    );
    let mut scene = scene(title, subtitle, up);
    let line = |label: String, color| Swatch { label, color };
    scene.swatches.push(line("part: points".to_owned(), None));
    for (i, part) in split.report.parts.iter().take(LISTED_PARTS).enumerate() {
        scene.swatches.push(line(format!("{i}: {}", few_digits(part.points)), Some(colormap::category(i as u32))));
    }
    if let Some(more) = (n_parts as usize).checked_sub(LISTED_PARTS).filter(|&more| more > 0) {
        scene.swatches.push(line(format!("{more} more"), None));
    }
    picture::draw(&Scene { points, colors: &colors, ..scene }, size)
}

/// A number that fits into the legend.
fn few_digits(number: u64) -> String {
    match number {
        0..1_000_000 => grouped(number),
        1_000_000..1_000_000_000 => format!("{:.2}M", number as f64 / 1e6),
        _ => format!("{:.2}G", number as f64 / 1e9),
    }
}

/// The plane of a slice: across `axis`, in the cells at level 21 with this coordinate there.
#[derive(Debug, Clone, Copy)]
struct Plane {
    axis: usize,
    cell: u32,
}

impl Plane {
    /// Through the middle point along the axis on which the points spread least.
    fn through(octree: &Octree) -> Self {
        let points = &octree.cloud.points;
        let extent = Aabb::of_points(points).extent();
        let axis = (0..3).rev().min_by(|&a, &b| extent[a].total_cmp(&extent[b])).unwrap_or(2);
        let mut along: Vec<f32> = points.iter().map(|p| p[axis]).collect();
        along.sort_unstable_by(f32::total_cmp);
        let middle = along.get(along.len() / 2).copied().unwrap_or(0.0);
        let mut point = Vec3::ZERO;
        point[axis] = middle;
        Self { axis, cell: octree.tree.domain().cell_of(point)[axis] }
    }

    /// The axes to the right and up.
    fn sides(self) -> [usize; 2] {
        [[1, 2], [0, 2], [0, 1]][self.axis]
    }

    /// The square that an octant has on the plane, in the unit of the points; `None` if it is not cut.
    fn cut(self, octree: &Octree, octant: Octant) -> Option<[[f64; 2]; 2]> {
        let [low, high] = octant.cell_range(octree.tree.curve());
        if !(low[self.axis]..=high[self.axis]).contains(&self.cell) {
            return None;
        }
        let domain = octree.tree.domain();
        let cell_size = f64::from(domain.edge()) / f64::from(1u32 << MAX_LEVEL);
        let corner = |cell: [u32; 3], side: u32| {
            self.sides().map(|a| f64::from(domain.origin()[a]) + f64::from(cell[a] + side) * cell_size)
        };
        Some([corner(low, 0), corner(high, 1)])
    }
}

fn draw_slice(octree: &Octree, size: PictureSize) -> Image {
    let (tree, plane) = (&octree.tree, Plane::through(octree));
    let mut leaves = vec![];
    let mut tiles = vec![];
    let mut outline = |octant: Octant| {
        if let Some([min, max]) = plane.cut(octree, octant) {
            tiles.push(Tile { min, max, fill: None });
        }
    };
    for node in tree.nodes() {
        if node.is_leaf() {
            leaves.extend(plane.cut(octree, node.octant).map(|square| (square, node.n_points())));
        } else {
            // Children without points are cells too: they are seen as empty ones.
            (0..8).filter_map(|i| node.octant.child(i)).for_each(&mut outline);
        }
    }
    let scale = Scale::of(&leaves.iter().map(|(_, points)| *points).collect::<Vec<u32>>());
    let filled = |&([min, max], points): &([[f64; 2]; 2], u32)| Tile { min, max, fill: Some(scale.color(points)) };
    tiles.extend(leaves.iter().map(filled));

    let bounds = octree.cloud.bounds();
    let [right, above] = plane.sides();
    let view = match bounds.is_empty() {
        true => [[0.0; 2], [1.0; 2]],
        false => [bounds.min, bounds.max].map(|corner| [right, above].map(|axis| f64::from(corner[axis]))),
    };
    let domain = tree.domain();
    let offset = (f64::from(plane.cell) + 0.5) * f64::from(domain.edge()) / f64::from(1u32 << MAX_LEVEL);
    let at = octree.cloud.origin[plane.axis] + f64::from(domain.origin()[plane.axis]) + offset;
    let name = ["x", "y", "z"][plane.axis];
    let points = grouped(octree.cloud.len() as u64);
    let title = format!("{}: octree over {points} {}", octree.name, octree.source);
    let subtitle = format!(
        "slice at {name} = {}: {} of {} leaves, coloured by their points",
        at as f32,
        grouped(leaves.len() as u64),
        grouped(tree.leaves().count() as u64)
    );
    let mut scene = scene(title, subtitle, Up::Z);
    scene.bar = Some(Bar { label: "points".to_owned(), scale });
    picture::draw_tiles(&tiles, view, &scene, size)
}
