//! Space-filling curves: keys that put cells of space in a line, and the algebra of octants on those keys.
//!
//! A curve visits the 2^(d·k) cells of a box that is halved k times along each of its d axes. The key of a cell is its
//! number on the curve; the first d·l bits of a key are the key of the cell's ancestor at level l, on both curves. So
//! points sorted by key are points in the order of an octree's leaves, at every level at once ([`Octant`]).
//!
//! [`Domain`] brings points to cells: one subtraction and one multiplication, the same bits on every device. [`order`]
//! puts points in the order of a curve, `GpuCurveOrder` does so on the GPU.
//!
//! `morton.wesl`, `hilbert.wesl`, `octant.wesl` and `domain.wesl` are the same functions for kernels; `cells.wesl` has those
//! that a kernel takes for either curve.
//!
//! Sources: Sagan1994 (curves), Ajmera2008 (Morton order, the octant relations on keys), Skilling2004 (Hilbert keys).

mod domain;
#[cfg(feature = "gpu")]
mod gpu_curve;
#[cfg(feature = "gpu")]
mod gpu_octants;
#[cfg(feature = "gpu")]
mod gpu_order;
pub mod hilbert;
pub mod morton;
mod octant;
mod order;

pub use domain::Domain;
#[cfg(feature = "gpu")]
pub use gpu_curve::{Cell, GpuCurve, Key};
#[cfg(feature = "gpu")]
pub use gpu_octants::GpuOctants;
#[cfg(feature = "gpu")]
pub use gpu_order::GpuCurveOrder;
pub use octant::Octant;
pub use order::{mean_jump, order, order_in, order_in_plane};

use std::str::FromStr;

use crate::{Error, Result};

/// Most levels of a 63-bit key in three dimensions: bits of a cell's coordinate.
pub const MAX_LEVEL: u32 = 21;

/// The order in which cells are visited.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Curve {
    /// Morton order, the z-curve: bits of the coordinates interleaved, x first. The cheapest key.
    #[default]
    Morton,
    /// Hilbert's curve: neighbours on the curve are neighbours in space. Shorter jumps, and on average smaller
    /// surfaces of parts.
    Hilbert,
}

impl Curve {
    /// Every curve.
    pub const ALL: [Self; 2] = [Self::Morton, Self::Hilbert];

    /// Its name: "morton" or "hilbert".
    pub fn name(self) -> &'static str {
        match self {
            Self::Morton => "morton",
            Self::Hilbert => "hilbert",
        }
    }

    /// The 63-bit key of a cell at [`MAX_LEVEL`].
    #[inline]
    pub fn encode(self, cell: [u32; 3]) -> u64 {
        match self {
            Self::Morton => morton::encode_3d_u64(cell),
            Self::Hilbert => hilbert::encode_3d_u64(cell),
        }
    }

    /// The cell of a 63-bit key.
    #[inline]
    pub fn decode(self, key: u64) -> [u32; 3] {
        match self {
            Self::Morton => morton::decode_3d_u64(key),
            Self::Hilbert => hilbert::decode_3d_u64(key),
        }
    }
}

impl std::fmt::Display for Curve {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Curve {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|curve| curve.name() == text).ok_or_else(|| Error::InvalidSetting {
            setting: "curve",
            found: text.into(),
            expected: "morton or hilbert",
        })
    }
}
