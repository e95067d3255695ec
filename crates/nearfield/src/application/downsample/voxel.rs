//! One point for each occupied cell of a regular grid.

use rayon::prelude::*;

use crate::application::Watch;
use crate::application::finite_points::FinitePoints;
use crate::geometry::Scalar;
use crate::geometry::vector::Vector;
use crate::parallel::{compact, radix_sort};
use crate::structure::aabb_tree::any_dimension;
use crate::{Error, Result};

/// Most bits of a cell along an axis: the keys of three axes have 63.
const MOST_BITS: u32 = 21;
/// Points of a task.
const TASK: usize = 1 << 12;

/// Where a cell begins.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum VoxelOrigin {
    /// At the smallest coordinates of the points.
    #[default]
    Corner,
    /// Half a cell below them, as in Open3D.
    BelowCorner,
    /// At this place: by 0 cells begin at multiples of their size, as in PCL and small_gicp, and those of clouds in one frame fit
    /// together.
    At([f64; 3]),
}

/// The point for a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum VoxelPoint {
    /// The mean of the points in it.
    #[default]
    Centroid,
    /// The one nearest to their mean; of equals the one with the smallest index.
    Nearest,
    /// The one with the smallest index.
    First,
}

/// What the cells are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VoxelSettings {
    /// Edge of a cell, in the unit of the points, above 0.
    pub size: f64,
    /// Where a cell begins.
    pub origin: VoxelOrigin,
    /// The point for a cell.
    pub point: VoxelPoint,
}

impl VoxelSettings {
    /// Centroids of cells from the corner of the points on.
    pub fn new(size: f64) -> Self {
        Self { size, origin: VoxelOrigin::Corner, point: VoxelPoint::Centroid }
    }

    /// Checks size and origin.
    ///
    /// # Errors
    /// `InvalidSetting`.
    pub(super) fn validate(&self) -> Result<()> {
        if !(self.size > 0.0 && self.size.is_finite()) {
            let found = self.size.to_string();
            return Err(Error::InvalidSetting {
                setting: "size of a voxel",
                found,
                expected: "a finite length above 0",
            });
        }
        if let VoxelOrigin::At(place) = self.origin
            && !place.iter().all(|x| x.is_finite())
        {
            let found = format!("{place:?}");
            return Err(Error::InvalidSetting { setting: "origin of voxels", found, expected: "finite coordinates" });
        }
        Ok(())
    }
}

/// Occupied cells, in the order of the smallest index in each.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Voxels<T> {
    /// `[m]` a point a cell.
    pub points: Vec<Vector<T>>,
    /// `[m]` the index of the point that stands for the cell: the one asked for, by centroids the nearest to it.
    pub representatives: Vec<u32>,
    /// `[m]` points in each cell.
    pub counts: Vec<u32>,
    /// `[n]` the cell of each point: its place in the other arrays; [`Voxels::NONE`] of invalid points.
    pub cells: Vec<u32>,
    /// Indices of the points with a NaN or infinite coordinate, ascending.
    pub invalid: Vec<u32>,
}

impl<T> Voxels<T> {
    /// The cell of a point that is no place.
    pub const NONE: u32 = u32::MAX;
}

/// One point for each occupied cell.
///
/// ```
/// use nearfield::application::{VoxelSettings, Watch, voxel_downsample};
///
/// let points = [[0.0f64, 0.0, 0.0], [2.5, 0.0, 0.0], [0.5, 0.5, 0.0]];
/// let voxels = voxel_downsample(&points, &VoxelSettings::new(1.0), &mut Watch::none())?;
/// assert_eq!(voxels.points, [[0.25, 0.25, 0.0], [2.5, 0.0, 0.0]]);
/// assert_eq!((voxels.representatives, voxels.cells), (vec![0, 1], vec![0, 1, 0]));
/// # Ok::<(), nearfield::Error>(())
/// ```
///
/// Cells are ⌊(p − origin) / size⌋ in f64, and means are sums in f64 by ascending index.
///
/// # Errors
/// `InvalidSetting` for a size that is not above 0, or so small that there are more than 2²¹ cells along an axis;
/// `CoordinateBeyond`, `TooMany` for the points; `Interrupted`.
pub fn voxel_downsample<T: Scalar>(
    points: &[Vector<T>],
    settings: &VoxelSettings,
    watch: &mut Watch<'_>,
) -> Result<Voxels<T>> {
    settings.validate()?;
    let finite = FinitePoints::of(points)?;
    let points = finite.points();
    any_dimension::coordinates("points", points)?;
    if points.is_empty() {
        let cells = finite.spread(Vec::new(), Voxels::<T>::NONE);
        return Ok(Voxels { cells, invalid: finite.invalid(), ..Voxels::default() });
    }
    watch.report("cells", 0, 3)?;
    let lattice = Lattice::around(points, settings)?;
    let mut keys: Vec<u64> = points.par_iter().with_min_len(TASK).map(|point| lattice.key(point)).collect();
    let mut ids: Vec<u32> = (0..points.len() as u32).collect();
    watch.report("cells", 1, 3)?;
    radix_sort::sort_pairs(&mut keys, &mut ids, 0..lattice.bits.iter().sum())?;
    watch.report("cells", 2, 3)?;
    let starts = compact::indices_where(keys.len(), |i| i == 0 || keys[i] != keys[i - 1])?;
    drop(keys);
    // The sort is stable: ids of a cell ascend.
    let mut rows: Vec<&[u32]> = (0..starts.len())
        .map(|row| &ids[starts[row] as usize..starts.get(row + 1).map_or(ids.len(), |&end| end as usize)])
        .collect();
    rows.par_sort_unstable_by_key(|row| row[0]);
    let found: Vec<(Vector<T>, u32)> =
        rows.par_iter().with_min_len(TASK / 8).map(|row| of_cell(points, row, settings.point)).collect();
    let mut cells = vec![0; points.len()];
    for (cell, row) in rows.iter().enumerate() {
        row.iter().for_each(|&id| cells[id as usize] = cell as u32);
    }
    watch.report("cells", 3, 3)?;
    let (taken, representatives): (Vec<_>, Vec<u32>) = found.into_iter().unzip();
    Ok(Voxels {
        points: taken,
        representatives: finite.renamed(representatives, u32::MAX),
        counts: rows.iter().map(|row| row.len() as u32).collect(),
        cells: finite.spread(cells, Voxels::<T>::NONE),
        invalid: finite.invalid(),
    })
}

/// The point for a cell, and which one stands for it.
fn of_cell<T: Scalar>(points: &[Vector<T>], ids: &[u32], point: VoxelPoint) -> (Vector<T>, u32) {
    let at = |id: u32| points[id as usize].map(T::to_f64);
    if point == VoxelPoint::First || ids.len() == 1 {
        return (points[ids[0] as usize], ids[0]);
    }
    let mut mean = [0.0; 3];
    ids.iter().for_each(|&id| (0..3).for_each(|axis| mean[axis] += at(id)[axis]));
    mean = mean.map(|sum| sum / ids.len() as f64);
    let dist2 = |id: u32| any_dimension::dist2(&at(id), &mean);
    let nearest = ids.iter().copied().fold(ids[0], |best, id| if dist2(id) < dist2(best) { id } else { best });
    match point {
        VoxelPoint::Centroid => (mean.map(T::of), nearest),
        _ => (points[nearest as usize], nearest),
    }
}

/// Cells as numbers.
pub(super) struct Lattice {
    origin: [f64; 3],
    size: f64,
    /// Number of the lowest cell.
    lowest: [f64; 3],
    /// Bits of the numbers along each axis, from the lowest cell on.
    pub(super) bits: [u32; 3],
}

impl Lattice {
    /// # Errors
    /// `InvalidSetting` where there are too many cells.
    pub(super) fn around<T: Scalar>(points: &[Vector<T>], settings: &VoxelSettings) -> Result<Self> {
        let empty = ([T::LARGEST; 3], [T::SMALLEST; 3]);
        let grown = |a: (Vector<T>, Vector<T>), b: (Vector<T>, Vector<T>)| {
            let smaller = std::array::from_fn(|axis| a.0[axis].smaller(b.0[axis]));
            (smaller, std::array::from_fn(|axis| a.1[axis].larger(b.1[axis])))
        };
        let bounds = points.par_iter().with_min_len(TASK).map(|&p| (p, p)).reduce(|| empty, grown);
        let (min, max) = (bounds.0.map(T::to_f64), bounds.1.map(T::to_f64));
        let size = settings.size;
        let origin = match settings.origin {
            VoxelOrigin::Corner => min,
            VoxelOrigin::BelowCorner => min.map(|low| low - 0.5 * size),
            VoxelOrigin::At(place) => place,
        };
        let cell = |corner: [f64; 3], axis: usize| ((corner[axis] - origin[axis]) / size).floor();
        let lowest = std::array::from_fn(|axis| cell(min, axis));
        let mut bits = [0; 3];
        for (axis, bits) in bits.iter_mut().enumerate() {
            let cells = cell(max, axis) - lowest[axis] + 1.0;
            if !(cells <= f64::from(1u32 << MOST_BITS)) {
                return Err(Error::InvalidSetting {
                    setting: "size of a voxel",
                    found: format!("{size}, {cells} cells along {}", ['x', 'y', 'z'][axis]),
                    expected: "a size with at most 2,097,152 cells along each axis; use a larger one, or work in parts",
                });
            }
            *bits = u64::BITS - (cells as u64 - 1).leading_zeros();
        }
        Ok(Self { origin, size, lowest, bits })
    }

    pub(super) fn key<T: Scalar>(&self, point: &Vector<T>) -> u64 {
        let number =
            |axis: usize| (((point[axis].to_f64() - self.origin[axis]) / self.size).floor() - self.lowest[axis]) as u64;
        number(0) | number(1) << self.bits[0] | number(2) << (self.bits[0] + self.bits[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_have_as_many_bits_as_there_are_cells() {
        let points = [[0.0f64; 3], [7.9, 8.0, 0.5]];
        let lattice = Lattice::around(&points, &VoxelSettings::new(1.0)).unwrap();
        assert_eq!(lattice.bits, [3, 4, 0]);
        assert_eq!((lattice.key(&points[0]), lattice.key(&points[1])), (0, 7 | 8 << 3));
        let settings = VoxelSettings { origin: VoxelOrigin::At([0.0; 3]), ..VoxelSettings::new(1.0) };
        let lattice = Lattice::around(&[[-0.5f64, -3.0, 2.0], [0.5, 0.0, 2.0]], &settings).unwrap();
        assert_eq!((lattice.lowest, lattice.bits), ([-1.0, -3.0, 2.0], [1, 2, 0]));
    }

    #[test]
    fn the_largest_grid_has_sixty_three_bits() {
        let far = f64::from((1u32 << 21) - 1) + 0.5;
        let points = [[0.0f64; 3], [far; 3]];
        let lattice = Lattice::around(&points, &VoxelSettings::new(1.0)).unwrap();
        assert_eq!((lattice.bits, lattice.key(&points[1])), ([21; 3], (1 << 63) - 1));
        let error = Lattice::around(&[[0.0f64; 3], [far + 0.5; 3]], &VoxelSettings::new(1.0)).err().unwrap();
        assert!(matches!(error, Error::InvalidSetting { .. }) && error.to_string().contains("2097153 cells along x"));
    }
}
