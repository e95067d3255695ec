//! Lengths as users think of them: in the unit of the points, in percent of their size, or in multiples of their spacing.

use std::fmt;
use std::str::FromStr;

use rayon::prelude::*;

use crate::geometry::Scalar;
use crate::query::NearestFew;
use crate::structure::AabbTreeN;
use crate::{Error, Result};

/// Nearest points that are looked at for one at another place.
const FEW: usize = 8;
/// Points of a task.
const TASK: usize = 256;

/// A length that may depend on the points it is used for.
///
/// As text: `0.25`, `2%`, `4x`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Length {
    /// In the unit of the coordinates.
    Absolute(f64),
    /// In percent of the diagonal of the points' bounding box.
    Percent(f64),
    /// In multiples of the points' spacing; see [`spacing`].
    Spacings(f64),
}

impl Length {
    /// The length in the unit of the coordinates.
    ///
    /// - `tree`: over the points that percent and spacings refer to
    ///
    /// # Errors
    /// `InvalidSetting` where the length is not a finite number above 0, or refers to points that have no size or no spacing.
    pub fn resolve<T: Scalar>(&self, setting: &'static str, tree: &AabbTreeN<T, 3>) -> Result<f64> {
        let length = match *self {
            Self::Absolute(length) => length,
            Self::Percent(percent) => percent / 100.0 * diagonal(tree),
            Self::Spacings(times) => times * spacing(tree).unwrap_or(0.0),
        };
        if length > 0.0 && length.is_finite() {
            return Ok(length);
        }
        let found = format!("{self} of {} points, {length} in their unit", tree.len());
        Err(Error::InvalidSetting { setting, found, expected: "a length above 0 of points at more than one place" })
    }
}

impl fmt::Display for Length {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absolute(length) => write!(f, "{length}"),
            Self::Percent(percent) => write!(f, "{percent}%"),
            Self::Spacings(times) => write!(f, "{times}x"),
        }
    }
}

impl FromStr for Length {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (number, unit): (&str, fn(f64) -> Self) = match text.strip_suffix(['%', 'x']) {
            Some(number) if text.ends_with('%') => (number, Self::Percent),
            Some(number) => (number, Self::Spacings),
            None => (text, Self::Absolute),
        };
        match number.trim().parse() {
            Ok(value) if f64::is_finite(value) => Ok(unit(value)),
            _ => Err(format!(
                "`{text}` is no length: give a number, a percentage like 2%, or a multiple of the spacing like 4x"
            )),
        }
    }
}

/// Length of the diagonal of the box around the points; 0 without points.
pub fn diagonal<T: Scalar>(tree: &AabbTreeN<T, 3>) -> f64 {
    tree.boxes().first().filter(|_| !tree.is_empty()).map_or(0.0, |root| {
        let side = |axis: usize| root.max[axis].to_f64() - root.min[axis].to_f64();
        (0..3).map(|axis| side(axis).powi(2)).sum::<f64>().sqrt()
    })
}

/// The mean distance from a point to the nearest at another place, among its eight nearest; points with none there are left
/// out. `None` where all are.
pub fn spacing<T: Scalar>(tree: &AabbTreeN<T, 3>) -> Option<f64> {
    let points = tree.ordered_points();
    let places: Vec<usize> = (0..points.len()).collect();
    let sums: Vec<(f64, u64)> = places
        .par_chunks(TASK)
        .map_init(
            || NearestFew::new(FEW),
            |few, places| {
                let nearest = places.iter().filter_map(|&place| {
                    tree.nearest_few(&points.position(place), T::of(f64::INFINITY), few);
                    few.found().iter().map(|hit| hit.0.to_f64()).find(|&dist2| dist2 > 0.0)
                });
                nearest.fold((0.0, 0), |(sum, n), dist2| (sum + dist2.sqrt(), n + 1))
            },
        )
        .collect();
    let (sum, n) = sums.iter().fold((0.0, 0), |(sum, n), part| (sum + part.0, n + part.1));
    (n > 0).then(|| sum / n as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::AabbTreeNSettings;

    fn tree(points: &[[f64; 3]]) -> AabbTreeN<f64, 3> {
        AabbTreeN::build(points, &AabbTreeNSettings::default()).unwrap()
    }

    #[test]
    fn lengths_are_read_and_written() {
        for (text, length) in
            [("0.25", Length::Absolute(0.25)), ("2%", Length::Percent(2.0)), ("4.5x", Length::Spacings(4.5))]
        {
            assert_eq!(text.parse(), Ok(length));
            assert_eq!(length.to_string(), text);
        }
        for text in ["", "x", "%", "far", "nan", "infx", "4xx"] {
            assert!(text.parse::<Length>().is_err_and(|message| message.contains(text)), "{text}");
        }
    }

    #[test]
    fn lengths_follow_the_points() {
        // A row with a spacing of 0.5 and every point twice.
        let points: Vec<[f64; 3]> = (0..400u32).map(|i| [f64::from(i / 2) * 0.5, 0.0, 0.0]).collect();
        let tree = tree(&points);
        assert_eq!(Length::Spacings(3.0).resolve("radius", &tree).unwrap(), 1.5);
        assert_eq!(Length::Percent(50.0).resolve("radius", &tree).unwrap(), 49.75);
        assert_eq!(Length::Absolute(7.0).resolve("radius", &tree).unwrap(), 7.0);
    }

    #[test]
    fn points_without_size_have_no_relative_lengths() {
        for points in [vec![], vec![[1.0, 2.0, 3.0]], vec![[1.0, 2.0, 3.0]; 40]] {
            let tree = tree(&points);
            for length in [Length::Percent(1.0), Length::Spacings(1.0), Length::Absolute(0.0), Length::Absolute(-1.0)] {
                assert!(matches!(length.resolve("radius", &tree), Err(Error::InvalidSetting { .. })), "{length}");
            }
        }
    }
}
