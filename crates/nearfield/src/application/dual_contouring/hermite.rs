//! Hermite data: where the surface crosses an edge of the grid and how it is turned there.

use super::node_values::NodeValues;
use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};
use crate::query::NearestFew;
use crate::structure::AabbTreeN;
use crate::{Error, Result};

/// An edge of the grid from a node to the next along an axis, with the surface between its ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridEdge<T> {
    /// Indices of the first node.
    pub node: [u32; 3],
    /// 0, 1, 2 for x, y, z.
    pub axis: usize,
    /// Values of both ends, less the level of the surface; one is negative, one is not.
    pub values: [T; 2],
    /// Positions of both ends relative to the grid's origin.
    pub ends: [Vector<T>; 2],
}

impl<T: Scalar> GridEdge<T> {
    /// Where a straight line through the values is 0, from 0 to 1 along the edge.
    pub fn linear(&self) -> T {
        let [a, b] = self.values;
        (a / (a - b)).larger(T::ZERO).smaller(T::ONE)
    }

    /// The position at a place from 0 to 1 along the edge.
    pub fn position(&self, place: T) -> Vector<T> {
        let mut position = self.ends[0];
        position[self.axis] += (self.ends[1][self.axis] - self.ends[0][self.axis]) * place;
        position
    }

    /// The direction of the edge that leads outwards.
    pub fn outwards(&self) -> Vector<T> {
        let mut direction = [T::ZERO; 3];
        direction[self.axis] = if self.values[0] < T::ZERO { T::ONE } else { -T::ONE };
        direction
    }

    /// A vector at length 1; [`GridEdge::outwards`] where it has no direction.
    fn unit(&self, v: Vector<T>) -> Vector<T> {
        vector::normalized(v).unwrap_or_else(|| self.outwards())
    }
}

/// A place on an edge and the normal of the surface there.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Crossing<T> {
    /// From 0 to 1 along the edge.
    pub place: T,
    /// Of length 1, outwards.
    pub normal: Vector<T>,
}

/// Where a surface crosses edges and how it is turned there.
pub trait HermiteData<T>: Sync {
    /// The crossing of an edge whose values have different signs.
    fn crossing(&self, edge: &GridEdge<T>) -> Crossing<T>;
}

/// From the values alone: the place by linear interpolation, the normal as the gradient there.
///
/// The gradient is that of central differences at the ends of the edge where it is about as long as that of a distance field
/// (1), and else, as at a crease, that of the one of the four cells around the edge where it is closest to that.
#[derive(Debug, Clone, Copy)]
pub struct FieldHermite<'a, T> {
    values: NodeValues<'a, T>,
}

/// Differences of central gradients from length 1 up to which they are taken.
const SMOOTH: f64 = 0.02;

impl<'a, T: Scalar> FieldHermite<'a, T> {
    /// From these values.
    pub fn new(values: &NodeValues<'a, T>) -> Self {
        Self { values: *values }
    }

    /// Differences to the neighbours of a node along an axis, backward and forward; each stands for the other where that
    /// is undefined, and both are 0 without any.
    fn differences(&self, node: [u32; 3], axis: usize, value: T) -> [T; 2] {
        let (mut before, mut after) = (node, node);
        before[axis] = node[axis].wrapping_sub(1);
        after[axis] = node[axis].saturating_add(1);
        let back = value - self.values.value(before);
        let forth = self.values.value(after) - value;
        match (back.is_finite(), forth.is_finite()) {
            (true, true) => [back, forth],
            (true, false) => [back; 2],
            (false, true) => [forth; 2],
            (false, false) => [T::ZERO; 2],
        }
    }
}

impl<T: Scalar> HermiteData<T> for FieldHermite<'_, T> {
    fn crossing(&self, edge: &GridEdge<T>) -> Crossing<T> {
        let place = edge.linear();
        let axis = edge.axis;
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut last = edge.node;
        last[axis] += 1;
        let mixed = |towards: usize| {
            let first = self.differences(edge.node, towards, edge.values[0]);
            let second = self.differences(last, towards, edge.values[1]);
            [0, 1].map(|side| first[side] + (second[side] - first[side]) * place)
        };
        let (along_u, along_v) = (mixed(u), mixed(v));
        let along = edge.values[1] - edge.values[0];
        let gradient = |du: T, dv: T| {
            let mut gradient = [T::ZERO; 3];
            (gradient[axis], gradient[u], gradient[v]) = (along, du, dv);
            gradient
        };
        let width = T::of(f64::from(self.values.grid().spacing()));
        let off = |g: &Vector<T>| (vector::norm(*g) / width - T::ONE).abs();
        let half = T::of(0.5);
        let mut best = gradient((along_u[0] + along_u[1]) * half, (along_v[0] + along_v[1]) * half);
        if off(&best) > T::of(SMOOTH) {
            for sides in 0..4 {
                let one_sided = gradient(along_u[sides & 1], along_v[sides >> 1]);
                if off(&one_sided) < off(&best) {
                    best = one_sided;
                }
            }
        }
        Crossing { place, normal: edge.unit(best) }
    }
}

/// From a function and its gradient: the place by secant steps between the ends. For fields that are known exactly.
pub struct FunctionHermite<F, G> {
    /// The value at a position relative to the grid's origin, less the level: the same function as the grid's values.
    pub value: F,
    /// Its gradient; only the direction counts.
    pub gradient: G,
}

/// Most secant steps after linear interpolation: two or three end on smooth functions, one with a kink may take more.
const SECANT_STEPS: usize = 16;

impl<T, F, G> HermiteData<T> for FunctionHermite<F, G>
where
    T: Scalar,
    F: Fn(Vector<T>) -> T + Sync,
    G: Fn(Vector<T>) -> Vector<T> + Sync,
{
    fn crossing(&self, edge: &GridEdge<T>) -> Crossing<T> {
        let (mut places, mut values) = ([T::ZERO, T::ONE], edge.values);
        let (mut place, mut replaced) = (edge.linear(), None);
        for _ in 0..SECANT_STEPS {
            let value = (self.value)(edge.position(place));
            if !value.is_finite() || value == T::ZERO {
                break;
            }
            // The crossing stays between the ends; an end that stays a second time counts half, so that both move.
            let end = usize::from((value < T::ZERO) != (edge.values[0] < T::ZERO));
            if replaced == Some(end) {
                values[1 - end] = values[1 - end] * T::of(0.5);
            }
            (places[end], values[end], replaced) = (place, value, Some(end));
            let next = places[0] + (places[1] - places[0]) * (values[0] / (values[0] - values[1]));
            let step = next - place;
            if !(step.abs() > T::EPSILON) {
                break;
            }
            place = next.larger(T::ZERO).smaller(T::ONE);
        }
        Crossing { place, normal: edge.unit((self.gradient)(edge.position(place))) }
    }
}

/// From oriented points: the place by linear interpolation, the normal that of the nearest point (Xing2017, §5.2).
#[derive(Debug, Clone, Copy)]
pub struct PointsHermite<'a, T: Scalar> {
    points: &'a AabbTreeN<T, 3>,
    normals: &'a [Vector<T>],
}

impl<'a, T: Scalar> PointsHermite<'a, T> {
    /// From points relative to the grid's origin and their normals, in the order the tree was built from.
    ///
    /// # Errors
    /// `LengthMismatch` unless there is a normal for each point; `TooMany` without points, where `limit` is 0.
    pub fn new(points: &'a AabbTreeN<T, 3>, normals: &'a [Vector<T>]) -> Result<Self> {
        let (found, expected) = (normals.len() as u64, points.len() as u64);
        if found != expected || expected == 0 {
            return Err(Error::LengthMismatch { what: "the normals of points", found, expected: expected.max(1) });
        }
        Ok(Self { points, normals })
    }
}

impl<T: Scalar> HermiteData<T> for PointsHermite<'_, T> {
    fn crossing(&self, edge: &GridEdge<T>) -> Crossing<T> {
        let place = edge.linear();
        let mut few = NearestFew::new(1);
        self.points.nearest_few(&edge.position(place), T::of(f64::INFINITY), &mut few);
        let normal = few.found().first().map_or([T::ZERO; 3], |&(_, index)| self.normals[index as usize]);
        Crossing { place, normal: edge.unit(normal) }
    }
}
