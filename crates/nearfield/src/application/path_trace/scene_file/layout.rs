//! The keys of a scene file. A key that is not known is an error.

use glam::DVec3;
use serde::Deserialize;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneEntries {
    #[serde(default)]
    pub(super) room: bool,
    pub(super) camera: Option<CameraEntry>,
    #[serde(default)]
    pub(super) mesh: Vec<MeshEntry>,
    #[serde(default)]
    pub(super) material: Vec<MaterialEntry>,
    #[serde(default)]
    pub(super) light: Vec<LightEntry>,
    pub(super) environment: Option<EnvironmentEntry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraEntry {
    pub(super) position: Option<[f64; 3]>,
    pub(super) target: Option<[f64; 3]>,
    pub(super) direction: Option<[f64; 3]>,
    pub(super) up: Option<[f64; 3]>,
    pub(super) fov: Option<f32>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MeshEntry {
    pub(super) file: String,
    pub(super) material: Option<String>,
    #[serde(default)]
    pub(super) scale: Scale,
    #[serde(default)]
    pub(super) rotate: [f64; 3],
    #[serde(default)]
    pub(super) translate: [f64; 3],
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(untagged)]
pub(super) enum Scale {
    All(f64),
    Each([f64; 3]),
}

impl Default for Scale {
    fn default() -> Self {
        Self::All(1.0)
    }
}

impl Scale {
    pub(super) fn factors(self) -> DVec3 {
        match self {
            Self::All(factor) => DVec3::splat(factor),
            Self::Each(factors) => DVec3::from_array(factors),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Kind {
    Lambert,
    Mirror,
    Dielectric,
    Ggx,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MaterialEntry {
    pub(super) name: String,
    pub(super) kind: Kind,
    pub(super) color: Option<[f32; 3]>,
    pub(super) metallic: Option<f32>,
    pub(super) roughness: Option<f32>,
    pub(super) ior: Option<f32>,
    #[serde(default)]
    pub(super) emission: [f32; 3],
    #[serde(default)]
    pub(super) two_sided: bool,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LightEntry {
    pub(super) position: [f64; 3],
    pub(super) intensity: [f32; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EnvironmentEntry {
    pub(super) radiance: [f32; 3],
}
