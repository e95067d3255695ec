//! Oriented samples of a surface in a tree, ready for distances, on the CPU in either precision.

use rayon::prelude::*;

use crate::geometry::Scalar;
use crate::geometry::vector::{Vector, normalized};
use crate::structure::{AabbTreeN, AabbTreeNSettings};
use crate::{Error, Result};

/// Neighbours that the spacing is measured by, on average.
const COUNTED: u64 = 12;
/// Samples that the spacing is measured at.
const MEASURED: usize = 1024;
/// Doublings of the radius until that many are met.
const DOUBLINGS: u32 = 64;

/// Oriented samples of a surface.
///
/// ```
/// use nearfield::application::{DistanceSettings, OrientedSamples, Watch, grid_around};
/// use nearfield::{Aabb, DVec3, Vec3};
///
/// // Eight samples of the plane z = 0, upwards.
/// let points: Vec<[f32; 3]> = (0..8u8).map(|i| [f32::from(i % 4), f32::from(i / 4), 0.0]).collect();
/// let samples = OrientedSamples::new(&points, &[[0.0, 0.0, 1.0]; 8])?;
/// let grid = grid_around(DVec3::ZERO, &Aabb::new(Vec3::ZERO, Vec3::new(3.0, 1.0, 0.0)), 13, 3.0)?;
/// let field = samples.distance_field(&grid, &DistanceSettings::default().band(3.0), &mut Watch::none())?;
/// assert_eq!(field.distances.sample(Vec3::new(1.0, 0.5, 0.25)), 0.25);
/// assert_eq!(field.distances.sample(Vec3::new(2.0, 1.0, -0.5)), -0.5);
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct OrientedSamples<T> {
    pub(super) tree: AabbTreeN<T, 3>,
    /// `[n]` by index: of length 1.
    pub(super) normals: Vec<Vector<T>>,
    pub(super) spacing: T,
}

impl<T: Scalar> OrientedSamples<T> {
    /// Puts the samples into a tree.
    ///
    /// - `points`: `[n]` positions
    /// - `normals`: `[n]` pointing outwards, of any length but 0
    ///
    /// # Errors
    /// `NoNormals` where there are none, or some have no direction; `LengthMismatch`; `NonFinite`; `CoordinateBeyond`;
    /// `TooMany`.
    pub fn new(points: &[Vector<T>], normals: &[Vector<T>]) -> Result<Self> {
        let normals = unit_normals(points.len(), normals)?;
        let tree = AabbTreeN::build(points, &AabbTreeNSettings::default())?;
        let at = places(points.len());
        let queries: Vec<Vector<T>> = at.map(|place| points[place]).collect();
        let diagonal = T::of(crate::application::diagonal(&tree));
        let spacing = measured_spacing(diagonal.to_f64(), queries.len(), |radius| {
            let mut met = 0;
            queries.iter().for_each(|query| tree.for_each_within(query, T::of(radius), |_, _| met += 1));
            Ok(met)
        })?;
        Ok(Self { tree, normals, spacing: T::of(spacing) })
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.tree.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.tree.is_empty()
    }

    /// The tree over the samples.
    pub fn tree(&self) -> &AabbTreeN<T, 3> {
        &self.tree
    }

    /// The root of the area that a sample stands for on average: the edge of a square grid of samples. 0 where all are at
    /// one place.
    pub fn spacing(&self) -> T {
        self.spacing
    }
}

/// The normals at length 1.
pub(super) fn unit_normals<T: Scalar>(n: usize, normals: &[Vector<T>]) -> Result<Vec<Vector<T>>> {
    check_normals::<T, Vector<T>>(n, normals)?;
    let none = [T::ZERO; 3];
    Ok(normals.par_iter().with_min_len(1 << 12).map(|&normal| unit_normal(normal).unwrap_or(none)).collect())
}

/// A normal at length 1; `None` where it has no direction. In the wider type: squares of short normals would vanish.
pub(super) fn unit_normal<T: Scalar>(normal: Vector<T>) -> Option<Vector<T>> {
    let unit = normalized(normal.map(T::to_f64)).map(|unit| unit.map(T::of));
    unit.filter(|unit| *unit != [T::ZERO; 3])
}

/// Checks that each of `n` samples has a normal with a direction.
///
/// # Errors
/// `NoNormals`, `LengthMismatch`.
pub(super) fn check_normals<T: Scalar, N>(n: usize, normals: &[N]) -> Result<()>
where
    N: Copy + Into<Vector<T>> + Sync,
{
    if normals.is_empty() && n > 0 {
        return Err(Error::NoNormals { points: n as u64, without: n as u64, first: 0 });
    }
    if normals.len() != n {
        let (found, expected) = (normals.len() as u64, n as u64);
        return Err(Error::LengthMismatch { what: "the normals", found, expected });
    }
    let is_without = |normal: &N| unit_normal((*normal).into()).is_none();
    let without = normals.par_iter().with_min_len(1 << 12).filter(|normal| is_without(normal)).count() as u64;
    if without > 0 {
        let first = normals.iter().position(is_without).unwrap_or(0) as u64;
        return Err(Error::NoNormals { points: n as u64, without, first });
    }
    Ok(())
}

/// Places of samples, evenly among `n`.
pub(super) fn places(n: usize) -> impl Iterator<Item = usize> {
    let measured = n.min(MEASURED);
    (0..measured).map(move |i| (i as u64 * n as u64 / measured as u64) as usize)
}

/// The spacing by the number of samples that are met in balls of a growing radius around `measured` of them: π r² holds
/// that many squares.
///
/// # Errors
/// Those of `count`.
pub(super) fn measured_spacing(
    diagonal: f64,
    measured: usize,
    mut count: impl FnMut(f64) -> Result<u64>,
) -> Result<f64> {
    if measured == 0 || diagonal <= 0.0 {
        return Ok(0.0);
    }
    let mut radius = diagonal / f64::from(1u32 << 12);
    for _ in 0..DOUBLINGS {
        let met = count(radius)?.saturating_sub(measured as u64);
        let enough = COUNTED * measured as u64;
        if met >= enough || radius >= diagonal {
            let each = met as f64 / measured as f64;
            return Ok(if each > 0.0 { radius * (std::f64::consts::PI / each).sqrt() } else { 0.0 });
        }
        radius *= std::f64::consts::SQRT_2;
    }
    Ok(0.0)
}
