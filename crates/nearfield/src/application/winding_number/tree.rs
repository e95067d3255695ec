//! The elements in the order of an AABB-tree, and the expansion of each of its nodes, computed in `f64`.

use rayon::prelude::*;

use super::expansion::{Moments, Symmetric2, symmetric2};
use crate::Result;
use crate::geometry::Scalar;
use crate::geometry::vector::{Vector, add, add_scaled, cross, norm, scale, subtract};
use crate::structure::aabb_tree::TreeShape;
use crate::structure::{AabbTreeN, AabbTreeNSettings};

/// Elements of a leaf at most.
pub(super) const LEAF: u32 = 8;
/// Nodes of a task.
const TASK: usize = 64;

/// A node whose expansion counts beyond some distance from its centre.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node<T> {
    pub(super) center: Vector<T>,
    /// Squared distance beyond which the expansion is good enough.
    pub(super) reach2: T,
    pub(super) moments: Moments<T>,
}

/// What lies in the leaves, in the unit of the tree.
#[derive(Debug, Clone)]
pub(super) enum Elements<T> {
    /// Place, and normal · area / 4π.
    Dipoles(Vec<[Vector<T>; 2]>),
    /// Corners.
    Triangles(Vec<[Vector<T>; 3]>),
}

/// The unit of a tree: coordinates minus a centre, times a factor that brings them near 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Unit {
    pub(super) center: Vector<f64>,
    pub(super) scale: f64,
}

impl Unit {
    pub(super) fn around(points: &[Vector<f64>]) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for point in points {
            (0..3).for_each(|axis| low[axis] = low[axis].min(point[axis]));
            (0..3).for_each(|axis| high[axis] = high[axis].max(point[axis]));
        }
        let half = norm(subtract(high, low)) / 2.0;
        let usable = half > 0.0 && half.is_finite();
        let center = if points.is_empty() { [0.0; 3] } else { scale(add(low, high), 0.5) };
        Self { center, scale: if usable { 1.0 / half } else { 1.0 } }
    }

    pub(super) fn of(&self, point: Vector<f64>) -> Vector<f64> {
        scale(subtract(point, self.center), self.scale)
    }
}

/// An element as the nodes see it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Element {
    place: Vector<f64>,
    moment: Vector<f64>,
    /// Second moment over its area about its place.
    spread: Symmetric2<f64>,
    /// Distance of its farthest point from its place.
    radius: f64,
}

impl Element {
    pub(super) fn dipole(place: Vector<f64>, moment: Vector<f64>) -> Self {
        Self { place, moment, spread: [0.0; 6], radius: 0.0 }
    }

    pub(super) fn triangle(corners: [Vector<f64>; 3]) -> Self {
        let [a, b, c] = corners;
        let place = scale(add(add(a, b), c), 1.0 / 3.0);
        let moment = scale(cross(subtract(b, a), subtract(c, a)), 0.5 / (4.0 * std::f64::consts::PI));
        let offsets = corners.map(|corner| subtract(corner, place));
        let mut spread = [0.0; 6];
        for offset in offsets {
            let square = symmetric2(offset, offset);
            spread.iter_mut().zip(square).for_each(|(sum, x)| *sum += x / 12.0);
        }
        let radius = offsets.map(norm).into_iter().fold(0.0, f64::max);
        Self { place, moment, spread, radius }
    }
}

/// A node while the tree is built; its centre is weighted by area.
#[derive(Debug, Clone, Copy)]
struct Cluster {
    center: Vector<f64>,
    weight: f64,
    moments: Moments<f64>,
}

impl Cluster {
    fn of_elements(elements: impl Iterator<Item = Element> + Clone) -> Self {
        let weighted = |(sum, total): (Vector<f64>, f64), element: Element| {
            let weight = norm(element.moment);
            (add_scaled(sum, element.place, weight), total + weight)
        };
        let (sum, weight) = elements.clone().fold(([0.0; 3], 0.0), weighted);
        let center = if weight > 0.0 {
            scale(sum, 1.0 / weight)
        } else {
            // Nothing here adds to the field.
            elements.clone().next().map_or([0.0; 3], |element| element.place)
        };
        let mut cluster = Self { center, weight, moments: Moments::ZERO };
        for element in elements {
            let offset = subtract(element.place, center);
            cluster.moments = cluster.moments.added(&Moments::of_element(offset, element.moment, element.spread));
        }
        cluster
    }

    fn of_children(children: [&Self; 2]) -> Self {
        let [a, b] = children;
        let weight = a.weight + b.weight;
        let share = if weight > 0.0 { b.weight / weight } else { 0.5 };
        let center = add_scaled(a.center, subtract(b.center, a.center), share);
        let offsets = children.map(|child| subtract(child.center, center));
        let moments = a.moments.moved(offsets[0]).added(&b.moments.moved(offsets[1]));
        Self { center, weight, moments }
    }
}

/// The order of the elements and the nodes over them.
pub(super) struct Tree<T> {
    pub(super) shape: TreeShape,
    /// `[n]` the element at each place of the order.
    pub(super) order: Vec<u32>,
    pub(super) nodes: Vec<Node<T>>,
}

impl<T: Scalar> Tree<T> {
    /// Over elements in the unit of the tree; expansions count beyond `beta` radii.
    ///
    /// # Errors
    /// `TooMany` (2³² − 1 elements or more).
    pub(super) fn build(elements: &[Element], beta: f64) -> Result<Self> {
        let places: Vec<Vector<f64>> = elements.iter().map(|element| element.place).collect();
        let boxes = AabbTreeN::build(&places, &AabbTreeNSettings::default().bucket_size(LEAF))?;
        let (shape, order) = (boxes.shape(), boxes.ordered_points().ids().to_vec());
        let mut clusters: Vec<Option<Cluster>> = vec![None; shape.n_nodes()];
        for level in (0..=shape.depth()).rev() {
            let nodes = shape.level(level);
            let (upper, lower) = clusters.split_at_mut(nodes.end);
            let below =
                |node: usize| lower[node - nodes.end].as_ref().expect("children should be there before their parent");
            upper[nodes.clone()].par_iter_mut().with_min_len(TASK).zip(nodes.clone()).for_each(|(cluster, node)| {
                *cluster = Some(if shape.is_leaf(node) {
                    Cluster::of_elements(order[shape.points(node)].iter().map(|&id| elements[id as usize]))
                } else {
                    Cluster::of_children([below(2 * node + 1), below(2 * node + 2)])
                });
            });
        }
        let radii = radii(&shape, &order, elements, &clusters);
        let finished = clusters.iter().flatten().zip(radii).map(|(cluster, radius)| {
            let reach = beta * radius;
            Node {
                center: cluster.center.map(T::of),
                reach2: T::of(reach * reach),
                moments: Moments {
                    first: cluster.moments.first.map(T::of),
                    second: cluster.moments.second.map(T::of),
                    third: cluster.moments.third.map(T::of),
                },
            }
        });
        let nodes = finished.collect();
        Ok(Self { shape, order, nodes })
    }
}

/// The radius of each node around all of its elements.
fn radii(shape: &TreeShape, order: &[u32], elements: &[Element], clusters: &[Option<Cluster>]) -> Vec<f64> {
    let radius = |(node, cluster): (usize, &Option<Cluster>)| {
        let center = cluster.as_ref().map_or([0.0; 3], |cluster| cluster.center);
        let farthest = |&id: &u32| {
            let element = &elements[id as usize];
            norm(subtract(element.place, center)) + element.radius
        };
        order[shape.points(node)].iter().map(farthest).fold(0.0, f64::max)
    };
    clusters.par_iter().enumerate().with_min_len(TASK).map(radius).collect()
}
