//! What a material of an MTL file is taken for. The format says how to draw, not what a thing is made of; so:
//!
//! - opacity below 1, or illumination model 4, 6, 7 or 9: clear glass of index `Ni`, 1.5 where that is not above 1;
//! - else black `Kd` and a `Ks` that is not: a mirror by `illum` 3, 5 or 8 or an exponent of 1000 or more, else a metal of that colour;
//! - else `Ks` other than black, by a model of 2 or more or none: a coat over a base of `Kd`; how strong `Ks` is does not matter;
//! - else matte.
//!
//! Roughness comes from the exponent by α² = 2 / (`Ns` + 2). `Ke` shines from both sides, as such files wind their faces either
//! way. Colours are cut to 0 … 1.

use glam::Vec3;

use super::{Material, Surface};
use crate::io::MtlMaterial;

pub(super) fn material(mtl: &MtlMaterial) -> Material {
    let share = |color: Vec3| color.clamp(Vec3::ZERO, Vec3::ONE);
    let (diffuse, specular) = (share(mtl.diffuse), share(mtl.specular));
    let model = mtl.model;
    let exponent = mtl.shininess.unwrap_or(10.0).max(0.0);
    let roughness = (2.0 / (exponent + 2.0)).sqrt().sqrt();
    let surface = if mtl.opacity < 1.0 || matches!(model, Some(4 | 6 | 7 | 9)) {
        let ior = mtl.ior.filter(|ior| *ior > 1.0).unwrap_or(1.5).min(10.0);
        Surface::Dielectric { ior, tint: Vec3::ONE }
    } else if diffuse == Vec3::ZERO && specular != Vec3::ZERO {
        if matches!(model, Some(3 | 5 | 8)) || exponent >= 1000.0 {
            Surface::Mirror { reflectance: specular }
        } else {
            Surface::Ggx { color: specular, metallic: 1.0, roughness }
        }
    } else if specular != Vec3::ZERO && model.is_none_or(|model| model >= 2) {
        Surface::Ggx { color: diffuse, metallic: 0.0, roughness }
    } else {
        Surface::Lambert { albedo: diffuse }
    };
    Material { surface, emission: mtl.emission.max(Vec3::ZERO), two_sided: true }
}
