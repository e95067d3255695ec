//! The picture of an order: the path from point to point.

use glam::Vec3;
use nearfield::curve::MAX_LEVEL;
use nearfield::{Aabb, Curve, Domain};

use crate::options::PictureSize;
use crate::picture::{self, Bar, Image, Path, Scale, Scene, Square, Up};
use crate::report::grouped;
use crate::report::{DIGITS, short};

/// Most points that get numbers, as in the poster (Ajmera2008).
const NUMBERED: usize = 500;
/// Most points whose path can be told from a filled area.
const DRAWN_AS_PATH: usize = 20_000;
/// Most halvings of the plane that are shown.
const HALVINGS: u32 = 8;

/// What was sorted.
pub(crate) struct Sorted<'a> {
    /// Name of the file.
    pub(crate) name: String,
    pub(crate) curve: Curve,
    pub(crate) domain: Domain,
    /// In the order of the curve.
    pub(crate) points: &'a [Vec3],
    /// Mean distance to the next point before and after.
    pub(crate) jumps: [f64; 2],
    pub(crate) up: Option<Up>,
}

/// The axes of the plane that the points lie in, where it stands across another axis.
pub(crate) fn plane(points: &[Vec3]) -> Option<[usize; 2]> {
    let extent = Aabb::of_points(points).extent();
    (extent.min_element() == 0.0).then(|| seen_axes(extent))
}

/// Draws the order: few points with their numbers and the squares that part them, more as a path, many by colour alone.
pub(crate) fn draw(sorted: &Sorted<'_>, size: PictureSize) -> Image {
    let n = sorted.points.len();
    let places: Vec<u32> = (0..n as u32).collect();
    let scale = Scale::of(&places);
    let colors: Vec<[u8; 3]> = places.iter().map(|&place| scale.color(place)).collect();
    let extent = Aabb::of_points(sorted.points).extent();
    let title = format!("{}: {} points along the {} curve", sorted.name, grouped(n as u64), sorted.curve);
    let jumps = sorted.jumps.map(|jump| short(jump as f32, DIGITS));
    let mut scene = Scene {
        swatches: Vec::new(),
        points: sorted.points,
        colors: &colors,
        sizes: &[],
        focus: &[],
        up: sorted.up.unwrap_or_else(|| picture::likely_up(extent, false)),
        title,
        subtitle: format!("mean jump {} before, {} after", jumps[0], jumps[1]),
        bar: Some(Bar { label: "place".to_owned(), scale }),
    };
    if n > DRAWN_AS_PATH {
        return picture::draw(&scene, size);
    }
    let [x, y] = seen_axes(extent);
    let flat: Vec<Vec3> = sorted.points.iter().map(|p| Vec3::new(p[x], p[y], 0.0)).collect();
    scene.points = &flat;
    let numbered = n <= NUMBERED;
    let squares = if numbered { squares(sorted, [x, y]) } else { vec![] };
    if numbered {
        // The numbers say what the bar would.
        scene.bar = None;
    }
    picture::draw_path(&scene, &Path { squares: &squares, numbered }, size)
}

/// The axes to the right and up, as seen along the smallest extent.
fn seen_axes(extent: Vec3) -> [usize; 2] {
    match extent.min_element() {
        least if least == extent.z => [0, 1],
        least if least == extent.y => [0, 2],
        _ => [1, 2],
    }
}

/// The domain as seen, halved along both axes until no square holds two points.
fn squares(sorted: &Sorted<'_>, axes: [usize; 2]) -> Vec<Square> {
    let cells: Vec<[u32; 2]> = sorted.points.iter().map(|&p| axes.map(|axis| sorted.domain.cell_of(p)[axis])).collect();
    let mut squares = vec![];
    part(&cells, [0, 0], 0, &mut |corner, level| {
        let unit = sorted.domain.edge() / (1u32 << MAX_LEVEL) as f32;
        let at = |i: usize| sorted.domain.origin()[axes[i]] + corner[i] as f32 * unit;
        squares.push(Square { corner: [at(0), at(1)], side: sorted.domain.edge() / (1u32 << level) as f32 });
    });
    squares
}

fn part(cells: &[[u32; 2]], corner: [u32; 2], level: u32, put: &mut impl FnMut([u32; 2], u32)) {
    put(corner, level);
    let several = cells.iter().any(|cell| cell != &cells[0]);
    if level == HALVINGS || !several {
        return;
    }
    let half = 1 << (MAX_LEVEL - level - 1);
    for quarter in 0..4 {
        let corner = [corner[0] + half * (quarter & 1), corner[1] + half * (quarter >> 1)];
        let holds = |cell: &&[u32; 2]| (0..2).all(|i| (corner[i]..corner[i] + half).contains(&cell[i]));
        let inside: Vec<[u32; 2]> = cells.iter().filter(holds).copied().collect();
        part(&inside, corner, level + 1, put);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_view_is_along_the_smallest_extent() {
        assert_eq!(seen_axes(Vec3::new(3.0, 2.0, 0.0)), [0, 1]);
        assert_eq!(seen_axes(Vec3::new(3.0, 0.0, 2.0)), [0, 2]);
        assert_eq!(seen_axes(Vec3::new(0.0, 3.0, 2.0)), [1, 2]);
        assert_eq!(plane(&[Vec3::ONE, Vec3::new(1.0, 5.0, 2.0)]), Some([1, 2]));
        assert_eq!(plane(&[Vec3::ONE, Vec3::new(1.5, 5.0, 2.0)]), None);
    }

    #[test]
    fn squares_part_the_points() {
        // In opposite corners, and a third beside the second: one halving, then another of one quarter.
        let points = [Vec3::ZERO, Vec3::new(4.0, 4.0, 0.0), Vec3::new(2.5, 2.5, 0.0)];
        let domain = Domain::new(Vec3::ZERO, 4.0).unwrap();
        let (name, curve) = (String::new(), Curve::Morton);
        let sorted = Sorted { name, curve, domain, points: &points, jumps: [0.0; 2], up: None };
        let squares = squares(&sorted, [0, 1]);
        let of_side = |side: f32| squares.iter().filter(|s| s.side == side).count();
        assert_eq!((squares.len(), of_side(4.0), of_side(2.0), of_side(1.0)), (9, 1, 4, 4));
        assert!(squares.contains(&Square { corner: [3.0, 2.0], side: 1.0 }), "{squares:?}");
    }
}
