//! Points that can be searched, out of points of which some may be NaN or infinite: those are left out of the search and told, and
//! all others keep their indices.

use std::borrow::Cow;

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::Scalar;
use crate::geometry::vector::Vector;
use crate::structure::aabb_tree::any_dimension;
use crate::{Error, Result};

/// Points that one thread looks at.
const TASK: usize = 1 << 14;

/// A point that may not be a place.
pub(super) trait Place: Copy + Send + Sync {
    /// Whether all coordinates are finite.
    fn is_place(&self) -> bool;
}

impl<T: Scalar> Place for Vector<T> {
    fn is_place(&self) -> bool {
        self.iter().all(|x| x.is_finite())
    }
}

impl Place for Vec3 {
    fn is_place(&self) -> bool {
        self.is_finite()
    }
}

/// The finite points of an array, and where they stood.
pub(super) struct FinitePoints<'a, P: Clone> {
    points: Cow<'a, [P]>,
    /// Index of each among all; `None` where all are finite.
    indices: Option<Vec<u32>>,
    total: usize,
}

impl<'a, P: Place> FinitePoints<'a, P> {
    /// Copies the finite points only where others stand among them.
    ///
    /// # Errors
    /// `TooMany`.
    pub(super) fn of(all: &'a [P]) -> Result<Self> {
        let (found, limit) = (all.len() as u64, u64::from(u32::MAX) - 1);
        if found > limit {
            let advice = "indices are 32 bits wide; work in parts";
            return Err(Error::TooMany { what: "points", found, limit, advice });
        }
        let total = all.len();
        if all.par_iter().with_min_len(TASK).all(P::is_place) {
            return Ok(Self { points: Cow::Borrowed(all), indices: None, total });
        }
        let indices: Vec<u32> = (0..total as u32).filter(|&i| all[i as usize].is_place()).collect();
        let points: Vec<P> = indices.iter().map(|&i| all[i as usize]).collect();
        Ok(Self { points: Cow::Owned(points), indices: Some(indices), total })
    }

    /// The finite points.
    pub(super) fn points(&self) -> &[P] {
        &self.points
    }

    /// Index among all of finite point `i`.
    pub(super) fn index(&self, i: u32) -> u32 {
        self.indices.as_ref().map_or(i, |indices| indices[i as usize])
    }

    /// Values of the finite points as values of all, with `absent` for the others.
    pub(super) fn spread<V: Copy>(&self, values: Vec<V>, absent: V) -> Vec<V> {
        let Some(indices) = &self.indices else { return values };
        let mut all = vec![absent; self.total];
        indices.iter().zip(values).for_each(|(&i, value)| all[i as usize] = value);
        all
    }

    /// Indices of the finite points, as indices of all, with `none` left as it is.
    pub(super) fn renamed(&self, mut indices: Vec<u32>, none: u32) -> Vec<u32> {
        if self.indices.is_some() {
            indices.iter_mut().filter(|i| **i != none).for_each(|i| *i = self.index(*i));
        }
        indices
    }

    /// Indices of the others, ascending.
    pub(super) fn invalid(&self) -> Vec<u32> {
        let Some(indices) = &self.indices else { return Vec::new() };
        let mut next = indices.iter().copied().peekable();
        (0..self.total as u32).filter(|&i| next.next_if_eq(&i).is_none()).collect()
    }
}

/// A length above 0 as a radius of searches in `T`.
///
/// # Errors
/// `InvalidSetting`.
pub(super) fn positive<T: Scalar>(setting: &'static str, length: f64) -> Result<T> {
    let radius = T::of(length);
    if length > 0.0 && radius > T::ZERO && any_dimension::radius(radius, None).is_ok() {
        return Ok(radius);
    }
    let expected = "a length above 0 whose square is a normal number of the coordinates' type";
    Err(Error::InvalidSetting { setting, found: length.to_string(), expected })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back_to_their_places() {
        let all = [[0.0f64; 3], [f64::NAN, 0.0, 0.0], [2.0; 3], [0.0, f64::INFINITY, 0.0]];
        let finite = FinitePoints::of(&all).unwrap();
        assert_eq!(finite.points(), [[0.0; 3], [2.0; 3]]);
        assert_eq!((finite.index(1), finite.invalid()), (2, vec![1, 3]));
        assert_eq!(finite.spread(vec![5, 6], -1), [5, -1, 6, -1]);
        assert_eq!(finite.renamed(vec![1, 9, 0], 9), [2, 9, 0]);
        let whole = FinitePoints::of(&all[..1]).unwrap();
        assert!(matches!(whole.points, Cow::Borrowed(_)) && whole.invalid().is_empty());
    }

    #[test]
    fn lengths_must_have_squares() {
        assert_eq!(positive::<f32>("radius", 0.5).unwrap(), 0.5);
        for length in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-30, 1e30] {
            assert!(matches!(positive::<f32>("eps", length), Err(Error::InvalidSetting { setting: "eps", .. })));
        }
        assert!(positive::<f64>("eps", 1e-30).is_ok());
    }
}
