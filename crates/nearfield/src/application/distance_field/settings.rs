//! What is asked of a distance field.

use std::fmt;
use std::str::FromStr;

use crate::geometry::RegularGrid;
use crate::{Error, Result};

/// What is made of the samples near a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DistanceMode {
    /// The distance of the nearest sample, with the sign of its normal (Xing2017).
    Nearest,
    /// The distance from the plane of the nearest sample (Hoppe1992).
    #[default]
    Plane,
    /// The weighted mean of the distances from the planes around the nearest sample (Kolluri2005).
    Imls,
    /// The distance from the sphere fitted to the samples around the nearest (Guennebaud2007).
    Apss,
}

impl DistanceMode {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Nearest, Self::Plane, Self::Imls, Self::Apss];

    /// As on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nearest => "nearest",
            Self::Plane => "plane",
            Self::Imls => "imls",
            Self::Apss => "apss",
        }
    }
}

/// Which side of the surface a place is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SignRule {
    /// By the normals of the samples that the distance comes from.
    Normal,
    /// By the winding number: inside where it passes ½.
    WindingNumber,
    /// By the angle-weighted normal of the nearest face, edge or corner (Baerentzen2005): exact for closed meshes.
    Pseudonormal,
}

impl SignRule {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Normal, Self::WindingNumber, Self::Pseudonormal];

    /// As on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::WindingNumber => "winding-number",
            Self::Pseudonormal => "pseudonormal",
        }
    }
}

macro_rules! by_name {
    ($type:ident) => {
        impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(self.name())
            }
        }

        impl FromStr for $type {
            type Err = String;

            fn from_str(text: &str) -> std::result::Result<Self, String> {
                let names = || Self::ALL.map(Self::name).join(", ");
                let found = Self::ALL.into_iter().find(|one| one.name() == text);
                found.ok_or_else(|| format!("`{text}` is none of {}", names()))
            }
        }
    };
}

by_name!(DistanceMode);
by_name!(SignRule);

/// How distances are computed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DistanceSettings {
    /// What is made of samples; without meaning for triangles, whose distance is exact.
    pub mode: DistanceMode,
    /// The rule of the sign. `None` takes normals for samples, pseudonormals for closed meshes and winding numbers for others.
    pub sign: Option<SignRule>,
    /// Distance up to which nodes have a value, in grid widths: 4 for a narrow band, infinite for all nodes.
    pub band: f64,
    /// σ of the weights of *imls* and *apss*, in spacings of the samples (the root of the area that one stands for).
    pub smoothing: f64,
    /// The most memory the field may take; without, what the host has.
    pub max_bytes: Option<u64>,
}

impl Default for DistanceSettings {
    /// Planes in a band of four grid widths.
    fn default() -> Self {
        Self { mode: DistanceMode::Plane, sign: None, band: 4.0, smoothing: 1.0, max_bytes: None }
    }
}

impl DistanceSettings {
    /// With this mode.
    pub fn mode(mut self, mode: DistanceMode) -> Self {
        self.mode = mode;
        self
    }

    /// With this rule of the sign.
    pub fn sign(mut self, sign: SignRule) -> Self {
        self.sign = Some(sign);
        self
    }

    /// With a band of so many grid widths.
    pub fn band(mut self, widths: f64) -> Self {
        self.band = widths;
        self
    }

    /// With this σ, in spacings.
    pub fn smoothing(mut self, spacings: f64) -> Self {
        self.smoothing = spacings;
        self
    }

    /// With at most so much memory for the field.
    pub fn max_bytes(mut self, bytes: u64) -> Self {
        self.max_bytes = Some(bytes);
        self
    }

    /// The largest distance of a node with a value; infinite for an infinite band.
    pub fn radius(&self, grid: &RegularGrid) -> f64 {
        self.band * f64::from(grid.spacing())
    }

    /// Checks the numbers, and that a field over this grid fits into memory.
    ///
    /// # Errors
    /// `InvalidSetting`, `OutOfMemory`.
    pub fn validate(&self, grid: &RegularGrid) -> Result<()> {
        let refused =
            |setting, found: f64, expected| Err(Error::InvalidSetting { setting, found: found.to_string(), expected });
        if !(self.band > 0.0) {
            return refused("band", self.band, "a number of grid widths above 0, which may be infinite");
        }
        if !(self.smoothing >= 0.05 && self.smoothing <= 100.0) {
            return refused("smoothing", self.smoothing, "0.05 to 100 spacings of the samples");
        }
        let needed = grid.n_nodes() as u64 * (size_of::<f32>() + size_of::<u32>()) as u64;
        let available = self.max_bytes.unwrap_or(u64::MAX).min(crate::query::available_memory());
        if needed > available {
            return Err(Error::OutOfMemory { what: "a distance field", needed, available });
        }
        Ok(())
    }
}
