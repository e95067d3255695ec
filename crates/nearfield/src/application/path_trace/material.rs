//! What surfaces are made of, as callers say it and as the stages read it. Twin of `material.wesl`.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use crate::{Error, Result};

/// How a surface scatters light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Surface {
    /// Matte: the same brightness from everywhere, on both sides. Reflects the share `albedo` (red, green, blue; 0 … 1).
    Lambert {
        /// Share of light reflected.
        albedo: Vec3,
    },
    /// A perfect mirror on both sides.
    Mirror {
        /// Share of light reflected, 0 … 1.
        reflectance: Vec3,
    },
    /// Clear glass or water: reflects and refracts by Fresnel's equations. The medium lies behind the triangle, seen
    /// from where its corners run counter-clockwise.
    Dielectric {
        /// Index of refraction behind the surface over that before it, 0.1 … 10.
        ior: f32,
        /// Share of light kept at each crossing or reflection, 0 … 1; white for clear glass.
        tint: Vec3,
    },
    /// Microfacets with the distribution GGX (Walter2007) on both sides: a metal, a glossy coat over a matte base, or a blend of them.
    Ggx {
        /// Colour of the metal, or of the matte base, 0 … 1.
        color: Vec3,
        /// 0 for a coat over a base, 1 for a metal, blends between.
        metallic: f32,
        /// Roughness 0 … 1; its square is the width of the distribution, never below 1e-3.
        roughness: f32,
    },
}

/// A surface and the light that it gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// How it scatters.
    pub surface: Surface,
    /// Radiance given, the same in all directions; zero for none.
    pub emission: Vec3,
    /// Whether it gives light from both sides, or only from where its corners run counter-clockwise.
    pub two_sided: bool,
}

impl Material {
    /// A surface without light of its own.
    pub const fn new(surface: Surface) -> Self {
        Self { surface, emission: Vec3::ZERO, two_sided: false }
    }

    /// A matte surface.
    pub const fn lambert(albedo: Vec3) -> Self {
        Self::new(Surface::Lambert { albedo })
    }

    /// The same surface, giving light from its front.
    pub const fn emitting(self, emission: Vec3) -> Self {
        Self { emission, ..self }
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// `InvalidSetting` that names material `index` and what is wrong with it.
    pub fn check(&self, index: usize) -> Result<()> {
        let share = |color: Vec3| color.cmpge(Vec3::ZERO).all() && color.cmple(Vec3::ONE).all();
        let unit = |value: f32| (0.0..=1.0).contains(&value);
        let fault = |setting: &'static str, found: String, expected: &'static str| {
            Err(Error::InvalidSetting { setting, found: format!("{found} of material {index}"), expected })
        };
        const SHARE: &str = "red, green and blue from 0 to 1";
        match self.surface {
            Surface::Lambert { albedo } if !share(albedo) => return fault("albedo", albedo.to_string(), SHARE),
            Surface::Mirror { reflectance } if !share(reflectance) => {
                return fault("reflectance", reflectance.to_string(), SHARE);
            }
            Surface::Dielectric { tint, .. } if !share(tint) => return fault("tint", tint.to_string(), SHARE),
            Surface::Dielectric { ior, .. } if !(0.1..=10.0).contains(&ior) => {
                return fault("index of refraction", ior.to_string(), "a number from 0.1 to 10, such as 1.5 for glass");
            }
            Surface::Ggx { color, .. } if !share(color) => return fault("color", color.to_string(), SHARE),
            Surface::Ggx { metallic, .. } if !unit(metallic) => {
                return fault("metallic", metallic.to_string(), "a number from 0 to 1");
            }
            Surface::Ggx { roughness, .. } if !unit(roughness) => {
                return fault("roughness", roughness.to_string(), "a number from 0 to 1");
            }
            _ => {}
        }
        if !is_radiance(self.emission) {
            return fault("emission", self.emission.to_string(), LIGHT);
        }
        Ok(())
    }
}

/// What a radiance must be, in words.
pub(super) const LIGHT: &str = "red, green and blue from 0 to 1e9";

/// Whether a colour is an amount of light.
pub(super) fn is_radiance(color: Vec3) -> bool {
    color.cmpge(Vec3::ZERO).all() && color.cmple(Vec3::splat(1e9)).all()
}

pub(super) const LAMBERT: u32 = 0;
pub(super) const MIRROR: u32 = 1;
pub(super) const DIELECTRIC: u32 = 2;
pub(super) const GGX: u32 = 3;

/// Least width of the GGX distribution.
pub(super) const LEAST_ALPHA: f32 = 1e-3;

/// A material as the stages read it: 48 bytes, the same on CPU and GPU.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct MaterialRecord {
    pub(super) color: Vec3,
    /// `LAMBERT`, `MIRROR`, `DIELECTRIC` or `GGX`.
    pub(super) kind: u32,
    pub(super) emission: Vec3,
    /// 1 where it gives light from both sides.
    pub(super) two_sided: u32,
    pub(super) ior: f32,
    pub(super) metallic: f32,
    /// Width of the GGX distribution.
    pub(super) alpha: f32,
    pub(super) padding: u32,
}

impl From<&Material> for MaterialRecord {
    fn from(material: &Material) -> Self {
        let (kind, color, ior, metallic, roughness) = match material.surface {
            Surface::Lambert { albedo } => (LAMBERT, albedo, 1.0, 0.0, 1.0),
            Surface::Mirror { reflectance } => (MIRROR, reflectance, 1.0, 0.0, 0.0),
            Surface::Dielectric { ior, tint } => (DIELECTRIC, tint, ior, 0.0, 0.0),
            Surface::Ggx { color, metallic, roughness } => (GGX, color, 1.5, metallic, roughness),
        };
        Self {
            color,
            kind,
            emission: material.emission,
            two_sided: u32::from(material.two_sided),
            ior,
            metallic,
            alpha: (roughness * roughness).max(LEAST_ALPHA),
            padding: 0,
        }
    }
}

impl MaterialRecord {
    /// Whether it scatters into single directions only, which no light sample can meet.
    pub(super) fn is_specular(&self) -> bool {
        self.kind == MIRROR || self.kind == DIELECTRIC
    }
}
