//! The stage between the hits of a path's ray and its next ray: light found, light asked for, direction picked. Twin of
//! `shade.wesl`.
//!
//! Light that a scattered ray meets and light that was sampled are two estimates of the same; each is weighted by the
//! power heuristic (Veach1997), so that together they count once.

use glam::Vec3;

use super::bsdf::{evaluate, sample};
use super::generate::{PAIRS_A_DEPTH, PathParameters, PathState, pair_seed};
use super::light::{choice_of, environment, sample_light};
use super::sampling::{frame, largest, pair, power_weight, unit, unit_pair};
use super::tables::SceneTables;
use crate::geometry::Ray;
use crate::query::HitRecord;

/// What shading gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shaded {
    /// The path on its next ray, or ended.
    pub(super) path: PathState,
    /// Light that the ray met.
    pub(super) found: Vec3,
    /// Light that arrives where nothing is hit along `shadow`; zero where there is nothing to ask.
    pub(super) asked: Vec3,
    /// From the surface to the light.
    pub(super) shadow: Ray,
}

/// Shades what the ray of a path hit, or missed.
pub(super) fn shade(tables: &SceneTables, parameters: &PathParameters, path: &PathState, hit: &HitRecord) -> Shaded {
    let ended = PathState { throughput: Vec3::ZERO, ..*path };
    let mut shaded = Shaded { path: ended, found: Vec3::ZERO, asked: Vec3::ZERO, shadow: path.ray() };
    if !hit.is_hit() {
        let (radiance, density) = environment(&tables.lights, path.direction);
        shaded.found = path.throughput * radiance * found_weight(parameters, path, density);
        return shaded;
    }
    let triangle = &tables.triangles[hit.triangle as usize];
    let material = &tables.materials[triangle.material as usize];
    let away = -path.direction;
    let cosine = away.dot(triangle.normal);
    let is_front = cosine > 0.0;
    // Seen edge on a surface gives nothing.
    if is_front || (material.two_sided != 0 && cosine < 0.0) {
        let density = triangle.light_density * hit.t * hit.t / cosine.abs();
        shaded.found = path.throughput * material.emission * found_weight(parameters, path, density);
    }
    if parameters.depth >= parameters.most_depth {
        return shaded;
    }

    // The frame of the surface, on the side that the ray came from.
    let normal = if is_front { triangle.normal } else { -triangle.normal };
    let [tangent, bitangent] = frame(normal);
    let wo = Vec3::new(away.dot(tangent), away.dot(bitangent), away.dot(normal));
    let mut here = *material;
    if !is_front {
        here.ior = 1.0 / here.ior;
    }
    let place = triangle.at(hit.weights);
    let clear = normal * tables.clearance(place);
    let first = 1 + PAIRS_A_DEPTH * parameters.depth;
    let seed = |i: u32| pair_seed(parameters, path.slot, first + i);
    let [kind, scatterer] = unit_pair(seed(0), parameters.sample);
    let [choice, roulette] = pair(seed(1), parameters.sample);

    if parameters.next_event == 1 && !here.is_specular() {
        let from = place + clear;
        let light = sample_light(tables, from, kind, choice_of(choice), unit_pair(seed(2), parameters.sample));
        let wi = Vec3::new(light.direction.dot(tangent), light.direction.dot(bitangent), light.direction.dot(normal));
        let scatter = evaluate(&here, wo, wi);
        // A point light is met by no scattered ray.
        let weight = if light.density > 0.0 { power_weight(light.density, scatter.density) } else { 1.0 };
        shaded.asked = path.throughput * scatter.value * light.radiance * weight;
        shaded.shadow = if light.far {
            Ray::new(from, light.direction)
        } else {
            Ray { t_max: 1.0, ..Ray::new(from, light.place - from) }
        };
    }

    let sampled = sample(&here, wo, scatterer, unit_pair(seed(3), parameters.sample));
    let wi = sampled.direction;
    let mut next = PathState {
        origin: if wi.z < 0.0 { place - clear } else { place + clear },
        slot: path.slot,
        direction: (tangent * wi.x + bitangent * wi.y + normal * wi.z).normalize(),
        density: sampled.density,
        throughput: path.throughput * sampled.weight,
        eta_scale: path.eta_scale * sampled.eta_scale,
    };
    if parameters.depth >= parameters.roulette_depth {
        // Radiance in glass is larger by the square of its index, which does not make a path worth less.
        let survives = (largest(next.throughput) * next.eta_scale).min(1.0);
        if unit(roulette) >= survives {
            return shaded;
        }
        next.throughput /= survives;
    }
    shaded.path = next;
    shaded
}

/// The weight of light that a ray met, which a light sample picks with `density`.
fn found_weight(parameters: &PathParameters, path: &PathState, density: f32) -> f32 {
    if parameters.next_event == 0 || path.density == 0.0 { 1.0 } else { power_weight(path.density, density) }
}
