//! How a surface is contoured.

use crate::{Error, Result};

/// What vertices may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum VertexMode {
    /// Vertices that make triangles flip or intersect are moved into their cells; the others stay where the planes meet.
    #[default]
    Untangled,
    /// Vertices stay where the planes of their crossings meet, wherever that is: features are exact where normals are, and
    /// triangles may intersect where they are not.
    Features,
}

impl VertexMode {
    /// Name in summaries.
    pub fn name(self) -> &'static str {
        match self {
            Self::Untangled => "untangled",
            Self::Features => "features",
        }
    }
}

/// Settings of dual contouring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContourSettings {
    /// Eigenvalues up to this part of the largest are dropped: 0.1 for normals with noise, 1e-3 for exact ones.
    pub threshold: f64,
    /// What vertices may do.
    pub mode: VertexMode,
}

impl Default for ContourSettings {
    fn default() -> Self {
        Self { threshold: 0.1, mode: VertexMode::Untangled }
    }
}

impl ContourSettings {
    /// For fields whose crossings and normals are exact: corners and creases as they are.
    pub fn features() -> Self {
        Self { threshold: 1e-3, mode: VertexMode::Features }
    }

    pub(super) fn check(&self) -> Result<()> {
        if self.threshold >= 0.0 && self.threshold < 1.0 {
            return Ok(());
        }
        let (setting, found) = ("eigenvalue threshold", self.threshold.to_string());
        Err(Error::InvalidSetting { setting, found, expected: "a number from 0 to below 1" })
    }
}
