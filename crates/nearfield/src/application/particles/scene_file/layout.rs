//! The keys of a scene file. A key that is not known is an error.

use std::fmt::Display;
use std::str::FromStr;

use serde::de::Error;
use serde::{Deserialize, Deserializer};

use super::super::{PairRule, SmoothingKernel};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneEntries {
    pub(super) name: Option<String>,
    pub(super) dimensions: Option<u32>,
    pub(super) domain: DomainEntry,
    pub(super) periodic: Option<[bool; 3]>,
    pub(super) gravity: Option<[f64; 3]>,
    pub(super) time_step: StepEntry,
    pub(super) model: ModelEntry,
    #[serde(default, rename = "box")]
    pub(super) boxes: Vec<BoxEntry>,
    #[serde(default, rename = "ball")]
    pub(super) balls: Vec<BallEntry>,
    #[serde(default, rename = "wall")]
    pub(super) walls: Vec<DomainEntry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DomainEntry {
    pub(super) low: [f64; 3],
    pub(super) high: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(untagged, expecting = "no number and no table with factor, least and most")]
pub(super) enum StepEntry {
    Fixed(f64),
    Cfl(CflEntry),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CflEntry {
    pub(super) factor: f64,
    pub(super) least: f64,
    pub(super) most: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Kind {
    Dem,
    Pbf,
    Wcsph,
    Dfsph,
}

/// The keys of all models together: which belong to which is checked where the model is made.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ModelEntry {
    pub(super) kind: Kind,
    pub(super) spacing: Option<f64>,
    pub(super) support: Option<f64>,
    pub(super) rest_density: Option<f64>,
    pub(super) iterations: Option<u32>,
    pub(super) most_iterations: Option<u32>,
    pub(super) tolerance: Option<f64>,
    pub(super) relaxation: Option<f64>,
    pub(super) tensile_strength: Option<f64>,
    pub(super) tensile_distance: Option<f64>,
    pub(super) vorticity: Option<f64>,
    pub(super) xsph: Option<f64>,
    #[serde(default, deserialize_with = "named")]
    pub(super) smoothing: Option<SmoothingKernel>,
    pub(super) sound_speed: Option<f64>,
    pub(super) exponent: Option<f64>,
    pub(super) artificial_viscosity: Option<f64>,
    pub(super) viscosity: Option<f64>,
    pub(super) density_diffusion: Option<f64>,
    pub(super) density_tolerance: Option<f64>,
    pub(super) divergence_tolerance: Option<f64>,
    pub(super) radii: Option<Vec<f64>>,
    #[serde(default, deserialize_with = "named")]
    pub(super) pair_rule: Option<PairRule>,
    pub(super) spring: Option<f64>,
    pub(super) damping: Option<f64>,
    pub(super) shear: Option<f64>,
    pub(super) attraction: Option<f64>,
    pub(super) global_damping: Option<f64>,
    pub(super) wall_damping: Option<f64>,
    pub(super) collider: Option<ColliderEntry>,
}

/// A choice by its name; the reader adds the line to what is said of a wrong one.
fn named<'de, D: Deserializer<'de>, T: FromStr<Err: Display>>(reader: D) -> Result<Option<T>, D::Error> {
    String::deserialize(reader)?.parse().map(Some).map_err(D::Error::custom)
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ColliderEntry {
    pub(super) center: [f64; 3],
    pub(super) radius: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BoxEntry {
    pub(super) low: [f64; 3],
    pub(super) high: [f64; 3],
    pub(super) spacing: Option<f64>,
    #[serde(default)]
    pub(super) velocity: [f64; 3],
    #[serde(default)]
    pub(super) class: u8,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BallEntry {
    pub(super) center: [f64; 3],
    pub(super) radius: f64,
    pub(super) spacing: Option<f64>,
    #[serde(default)]
    pub(super) velocity: [f64; 3],
    #[serde(default)]
    pub(super) class: u8,
}
