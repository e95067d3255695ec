//! How materials scatter, in the frame of the surface: +z is the normal on the side of the viewer. Twin of `bsdf.wesl`.
//!
//! Light comes in along `wi` and leaves along `wo`; both point away from the surface. A value is the share of radiance
//! scattered per solid angle, times the cosine of `wi`. Densities are per solid angle.
//!
//! - Lambert: albedo / π.
//! - GGX: the distribution of Walter2007 with the height-correlated masking of Heitz2014, Schlick1994's Fresnel factor,
//!   sampled by its visible normals (Heitz2018) through spherical caps (Dupuy2023). A coat lies over a matte base that gets
//!   what the coat lets through on the way in and out, so that nothing ever scatters more than comes in. Light between microfacets is
//!   left out, as usual: rough metals lose some.
//! - Mirror and dielectric: single directions, by `sample` alone.

use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;

use super::material::{DIELECTRIC, LAMBERT, MIRROR, MaterialRecord};
use super::sampling::{cos_sin, cosine_hemisphere, largest};

/// A value and the density with which [`sample`] picks the direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scatter {
    pub(super) value: Vec3,
    pub(super) density: f32,
}

const NOTHING: Scatter = Scatter { value: Vec3::ZERO, density: 0.0 };

/// A direction picked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sampled {
    pub(super) direction: Vec3,
    /// Value over density.
    pub(super) weight: Vec3,
    /// Zero for a single direction, and where nothing was picked.
    pub(super) density: f32,
    /// What the square of the refractive index was multiplied by.
    pub(super) eta_scale: f32,
}

/// How much goes from `wi` to `wo`; nothing for mirrors and dielectrics.
pub(super) fn evaluate(material: &MaterialRecord, wo: Vec3, wi: Vec3) -> Scatter {
    if wo.z <= 0.0 || wi.z <= 0.0 || material.is_specular() {
        return NOTHING;
    }
    if material.kind == LAMBERT {
        let density = wi.z * FRAC_1_PI;
        return Scatter { value: material.color * density, density };
    }
    let alpha = material.alpha;
    let normal = half_vector(wo, wi);
    let f0 = reflectance_ahead(material);
    let share = coat_share(material, wo.z);
    // The coat.
    let d = distribution(normal, alpha);
    let (masked_o, masked_i) = (lambda(wo, alpha), lambda(wi, alpha));
    let visible = d / (4.0 * wo.z * (1.0 + masked_o));
    let coat = schlick(f0, wo.dot(normal)) * (d / (4.0 * wo.z * (1.0 + masked_o + masked_i)));
    // The base.
    let through = (Vec3::ONE - schlick(f0, wo.z)) * (Vec3::ONE - schlick(f0, wi.z));
    let cosine = wi.z * FRAC_1_PI;
    let base = base_color(material) * through * cosine;
    Scatter { value: coat + base, density: share * visible + (1.0 - share) * cosine }
}

/// Picks a direction. `choice` in [0, 1) picks what scatters, `u` the direction.
pub(super) fn sample(material: &MaterialRecord, wo: Vec3, choice: f32, u: [f32; 2]) -> Sampled {
    let none = Sampled { direction: Vec3::Z, weight: Vec3::ZERO, density: 0.0, eta_scale: 1.0 };
    if wo.z <= 0.0 {
        return none;
    }
    let mirrored = Vec3::new(-wo.x, -wo.y, wo.z);
    if material.kind == LAMBERT {
        let direction = cosine_hemisphere(u);
        return Sampled { direction, weight: material.color, density: direction.z * FRAC_1_PI, ..none };
    }
    if material.kind == MIRROR {
        return Sampled { direction: mirrored, weight: material.color, ..none };
    }
    if material.kind == DIELECTRIC {
        let (reflected, cosine) = fresnel(wo.z, material.ior);
        if choice < reflected {
            return Sampled { direction: mirrored, weight: material.color, ..none };
        }
        let eta = material.ior;
        let direction = Vec3::new(-wo.x / eta, -wo.y / eta, -cosine);
        // Radiance grows with the square of the index of the medium that it enters.
        return Sampled { direction, weight: material.color / (eta * eta), density: 0.0, eta_scale: eta * eta };
    }
    let direction = if choice < coat_share(material, wo.z) {
        let normal = visible_normal(wo, material.alpha, u);
        2.0 * wo.dot(normal) * normal - wo
    } else {
        cosine_hemisphere(u)
    };
    let scatter = evaluate(material, wo, direction);
    if scatter.density <= 0.0 {
        return none;
    }
    Sampled { direction, weight: scatter.value / scatter.density, density: scatter.density, eta_scale: 1.0 }
}

fn half_vector(wo: Vec3, wi: Vec3) -> Vec3 {
    // Both have a positive z: the sum is never zero.
    (wo + wi).normalize()
}

/// Reflectance straight ahead: 4 % for a coat, the colour for a metal.
fn reflectance_ahead(material: &MaterialRecord) -> Vec3 {
    Vec3::splat(0.04 * (1.0 - material.metallic)) + material.color * material.metallic
}

fn base_color(material: &MaterialRecord) -> Vec3 {
    material.color * (1.0 - material.metallic)
}

/// How often the coat is picked, by what coat and base give at this angle.
fn coat_share(material: &MaterialRecord, cosine: f32) -> f32 {
    let coat = largest(schlick(reflectance_ahead(material), cosine));
    let base = largest(base_color(material)) * (1.0 - coat);
    if base <= 0.0 { 1.0 } else { (coat / (coat + base)).clamp(0.1, 0.9) }
}

fn schlick(f0: Vec3, cosine: f32) -> Vec3 {
    let x = (1.0 - cosine).clamp(0.0, 1.0);
    let x2 = x * x;
    f0 + (Vec3::ONE - f0) * (x2 * x2 * x)
}

/// Density of microfacet normals, by the tangent so that narrow distributions keep their digits.
fn distribution(normal: Vec3, alpha: f32) -> f32 {
    let cos2 = normal.z * normal.z;
    let tan2 = (normal.x * normal.x + normal.y * normal.y) / cos2;
    let width = 1.0 + tan2 / (alpha * alpha);
    1.0 / (PI * alpha * alpha * cos2 * cos2 * width * width)
}

fn lambda(w: Vec3, alpha: f32) -> f32 {
    let tan2 = (w.x * w.x + w.y * w.y) / (w.z * w.z);
    0.5 * ((1.0 + alpha * alpha * tan2).sqrt() - 1.0)
}

/// A normal as often as it is seen from `wo`.
fn visible_normal(wo: Vec3, alpha: f32, u: [f32; 2]) -> Vec3 {
    let stretched = Vec3::new(wo.x * alpha, wo.y * alpha, wo.z).normalize();
    let [c, s] = cos_sin(u[0]);
    let z = (1.0 - u[1]) * (1.0 + stretched.z) - stretched.z;
    let sine = (1.0 - z * z).max(0.0).sqrt();
    let half = Vec3::new(sine * c, sine * s, z) + stretched;
    Vec3::new(half.x * alpha, half.y * alpha, half.z).normalize()
}

/// Reflected share at a smooth surface, and the cosine on the other side (zero where all is reflected). `eta`: index
/// on the other side over that on this one.
pub(super) fn fresnel(cosine: f32, eta: f32) -> (f32, f32) {
    let sin2 = (1.0 - cosine * cosine) / (eta * eta);
    if sin2 >= 1.0 {
        return (1.0, 0.0);
    }
    let other = (1.0 - sin2).sqrt();
    let parallel = (eta * cosine - other) / (eta * cosine + other);
    let across = (cosine - eta * other) / (cosine + eta * other);
    (0.5 * (parallel * parallel + across * across), other)
}

#[cfg(test)]
mod tests {
    use super::super::material::{Material, Surface};
    use super::super::sampling::unit_pair;
    use super::*;

    fn record(surface: Surface) -> MaterialRecord {
        MaterialRecord::from(&Material::new(surface))
    }

    fn ggx(color: Vec3, metallic: f32, roughness: f32) -> MaterialRecord {
        record(Surface::Ggx { color, metallic, roughness })
    }

    fn direction_at(cosine: f32) -> Vec3 {
        Vec3::new((1.0 - cosine * cosine).sqrt() * 0.6, -(1.0 - cosine * cosine).sqrt() * 0.8, cosine)
    }

    /// ∫ over the hemisphere by the midpoint rule: value of the first channel, and density.
    fn integral(material: &MaterialRecord, wo: Vec3) -> (f64, f64) {
        let (n_z, n_turns) = (2000, 400);
        let (mut value, mut density) = (0.0, 0.0);
        for i in 0..n_z {
            for j in 0..n_turns {
                let z = (i as f32 + 0.5) / n_z as f32;
                let angle = std::f32::consts::TAU * (j as f32 + 0.5) / n_turns as f32;
                let sine = (1.0 - z * z).sqrt();
                let scatter = evaluate(material, wo, Vec3::new(sine * angle.cos(), sine * angle.sin(), z));
                value += f64::from(scatter.value.x);
                density += f64::from(scatter.density);
            }
        }
        let cell = std::f64::consts::TAU / f64::from(n_z * n_turns);
        (value * cell, density * cell)
    }

    #[test]
    fn sampled_weights_have_the_mean_of_the_integral_and_no_material_gives_more_than_it_gets() {
        for (metallic, roughness) in [(1.0, 0.4), (1.0, 1.0), (0.0, 0.3), (0.0, 1.0), (0.5, 0.6)] {
            let material = ggx(Vec3::ONE, metallic, roughness);
            for cosine in [1.0, 0.7, 0.3, 0.1] {
                let wo = direction_at(cosine);
                let (value, density) = integral(&material, wo);
                assert!(value < 1.0 + 2e-3, "metallic {metallic}, roughness {roughness}, {cosine}: {value}");
                assert!(density < 1.0 + 2e-3, "{density}");
                let n = 1 << 14;
                let mut mean = 0.0;
                let mut kept = 0.0;
                for i in 0..n {
                    let [choice, _] = unit_pair(1, i);
                    let sampled = sample(&material, wo, choice, unit_pair(2, i));
                    mean += f64::from(sampled.weight.x) / f64::from(n);
                    kept += f64::from(sampled.density > 0.0) / f64::from(n);
                }
                // Weights stay below 2, so 4σ of 16,384 independent samples are below 0.02.
                assert!((mean - value).abs() < 0.02, "metallic {metallic}, roughness {roughness}: {mean} {value}");
                assert!((kept - density).abs() < 0.02, "{kept} {density}");
            }
        }
    }

    #[test]
    fn scattering_is_reciprocal() {
        let material = ggx(Vec3::new(0.8, 0.5, 0.2), 0.3, 0.5);
        for i in 0..200 {
            let (a, b) = (cosine_hemisphere(unit_pair(5, i)), cosine_hemisphere(unit_pair(6, i)));
            let there = evaluate(&material, a, b).value / b.z;
            let back = evaluate(&material, b, a).value / a.z;
            assert!((there - back).length() < 1e-5 * (1.0 + there.length()), "{there} {back}");
        }
    }

    #[test]
    fn fresnel_at_the_angles_that_are_known() {
        // (1 − n)² / (1 + n)² straight ahead; nothing of the parallel part at Brewster's angle; all beyond the critical.
        assert!((fresnel(1.0, 1.5).0 - 0.04).abs() < 1e-7);
        let brewster = 1.5f32.atan().cos();
        let across = (brewster - 1.5 * fresnel(brewster, 1.5).1) / (brewster + 1.5 * fresnel(brewster, 1.5).1);
        assert!((fresnel(brewster, 1.5).0 - 0.5 * across * across).abs() < 1e-6);
        assert_eq!(fresnel(0.5, 1.0 / 1.5), (1.0, 0.0));
        assert!(fresnel(0.3, 1.0).0 < 1e-12);
    }

    #[test]
    fn refraction_follows_snell() {
        let glass = record(Surface::Dielectric { ior: 1.5, tint: Vec3::ONE });
        let wo = direction_at(0.5);
        let sampled = sample(&glass, wo, 0.999, [0.5, 0.5]);
        let sine = sampled.direction.truncate().length();
        assert!((1.5 * sine - wo.truncate().length()).abs() < 1e-6 && sampled.direction.z < 0.0);
        assert!((sampled.direction.length() - 1.0).abs() < 1e-6);
    }
}
