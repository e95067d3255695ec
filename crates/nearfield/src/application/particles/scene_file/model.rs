//! The model of a scene file, from its table of keys.

use glam::DVec3;

use super::super::{Collider, DemSettings, DfsphSettings, Fluid, ParticleModel, PbfSettings, WcsphSettings};
use super::fault;
use super::layout::{Kind, ModelEntry};
use crate::Result;

/// Kinds that have a key.
const FLUIDS: &[Kind] = &[Kind::Pbf, Kind::Wcsph, Kind::Dfsph];
const SMOOTHED: &[Kind] = &[Kind::Wcsph, Kind::Dfsph];

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Dem => "dem",
            Self::Pbf => "pbf",
            Self::Wcsph => "wcsph",
            Self::Dfsph => "dfsph",
        }
    }
}

/// The model, with its usual settings where the file says nothing.
pub(super) fn model(entry: &ModelEntry) -> Result<ParticleModel> {
    check_keys(entry)?;
    Ok(match entry.kind {
        Kind::Dem => ParticleModel::Dem(dem(entry)?),
        Kind::Pbf => {
            let usual = PbfSettings::new(fluid(entry)?);
            let iterations = entry.iterations.unwrap_or(usual.iterations);
            ParticleModel::Pbf(PbfSettings {
                iterations,
                most_iterations: entry.most_iterations.unwrap_or(usual.most_iterations.max(iterations)),
                tolerance: entry.tolerance.unwrap_or(usual.tolerance),
                relaxation: entry.relaxation.unwrap_or(usual.relaxation),
                tensile_strength: entry.tensile_strength.unwrap_or(usual.tensile_strength),
                tensile_distance: entry.tensile_distance.unwrap_or(usual.tensile_distance),
                vorticity: entry.vorticity.unwrap_or(usual.vorticity),
                xsph: entry.xsph.unwrap_or(usual.xsph),
                ..usual
            })
        }
        Kind::Wcsph => {
            let sound_speed = needed(entry.kind, "sound_speed", entry.sound_speed)?;
            let usual = WcsphSettings::new(fluid(entry)?, sound_speed);
            ParticleModel::Wcsph(WcsphSettings {
                smoothing: entry.smoothing.unwrap_or(usual.smoothing),
                exponent: entry.exponent.unwrap_or(usual.exponent),
                artificial_viscosity: entry.artificial_viscosity.unwrap_or(usual.artificial_viscosity),
                viscosity: entry.viscosity.unwrap_or(usual.viscosity),
                density_diffusion: entry.density_diffusion.unwrap_or(usual.density_diffusion),
                ..usual
            })
        }
        Kind::Dfsph => {
            let usual = DfsphSettings::new(fluid(entry)?);
            ParticleModel::Dfsph(DfsphSettings {
                smoothing: entry.smoothing.unwrap_or(usual.smoothing),
                density_tolerance: entry.density_tolerance.unwrap_or(usual.density_tolerance),
                divergence_tolerance: entry.divergence_tolerance.unwrap_or(usual.divergence_tolerance),
                most_iterations: entry.most_iterations.unwrap_or(usual.most_iterations),
                viscosity: entry.viscosity.unwrap_or(usual.viscosity),
                xsph: entry.xsph.unwrap_or(usual.xsph),
                ..usual
            })
        }
    })
}

fn fluid(entry: &ModelEntry) -> Result<Fluid> {
    let spacing = needed(entry.kind, "spacing", entry.spacing)?;
    let usual = Fluid::water(spacing);
    Ok(Fluid {
        support: entry.support.unwrap_or(usual.support),
        rest_density: entry.rest_density.unwrap_or(usual.rest_density),
        ..usual
    })
}

fn dem(entry: &ModelEntry) -> Result<DemSettings> {
    let radii = needed(entry.kind, "radii", entry.radii.clone())?;
    let usual = DemSettings::green(1.0);
    let collider = entry.collider.map(|ball| Collider { center: DVec3::from_array(ball.center), radius: ball.radius });
    Ok(DemSettings {
        radii,
        pair_rule: entry.pair_rule.unwrap_or(usual.pair_rule),
        spring: entry.spring.unwrap_or(usual.spring),
        damping: entry.damping.unwrap_or(usual.damping),
        shear: entry.shear.unwrap_or(usual.shear),
        attraction: entry.attraction.unwrap_or(usual.attraction),
        global_damping: entry.global_damping.unwrap_or(usual.global_damping),
        wall_damping: entry.wall_damping.unwrap_or(usual.wall_damping),
        collider,
    })
}

fn needed<T>(kind: Kind, key: &str, value: Option<T>) -> Result<T> {
    value.ok_or_else(|| fault(format!("no {key} of a {} model", kind.name()), "one in [model]"))
}

/// Refuses keys of another kind of model.
fn check_keys(entry: &ModelEntry) -> Result<()> {
    use Kind::{Dem, Dfsph, Pbf, Wcsph};
    let keys: [(&str, bool, &[Kind]); 28] = [
        ("spacing", entry.spacing.is_some(), FLUIDS),
        ("support", entry.support.is_some(), FLUIDS),
        ("rest_density", entry.rest_density.is_some(), FLUIDS),
        ("iterations", entry.iterations.is_some(), &[Pbf]),
        ("most_iterations", entry.most_iterations.is_some(), &[Pbf, Dfsph]),
        ("tolerance", entry.tolerance.is_some(), &[Pbf]),
        ("relaxation", entry.relaxation.is_some(), &[Pbf]),
        ("tensile_strength", entry.tensile_strength.is_some(), &[Pbf]),
        ("tensile_distance", entry.tensile_distance.is_some(), &[Pbf]),
        ("vorticity", entry.vorticity.is_some(), &[Pbf]),
        ("xsph", entry.xsph.is_some(), &[Pbf, Dfsph]),
        ("smoothing", entry.smoothing.is_some(), SMOOTHED),
        ("sound_speed", entry.sound_speed.is_some(), &[Wcsph]),
        ("exponent", entry.exponent.is_some(), &[Wcsph]),
        ("artificial_viscosity", entry.artificial_viscosity.is_some(), &[Wcsph]),
        ("viscosity", entry.viscosity.is_some(), SMOOTHED),
        ("density_diffusion", entry.density_diffusion.is_some(), &[Wcsph]),
        ("density_tolerance", entry.density_tolerance.is_some(), &[Dfsph]),
        ("divergence_tolerance", entry.divergence_tolerance.is_some(), &[Dfsph]),
        ("radii", entry.radii.is_some(), &[Dem]),
        ("pair_rule", entry.pair_rule.is_some(), &[Dem]),
        ("spring", entry.spring.is_some(), &[Dem]),
        ("damping", entry.damping.is_some(), &[Dem]),
        ("shear", entry.shear.is_some(), &[Dem]),
        ("attraction", entry.attraction.is_some(), &[Dem]),
        ("global_damping", entry.global_damping.is_some(), &[Dem]),
        ("wall_damping", entry.wall_damping.is_some(), &[Dem]),
        ("collider", entry.collider.is_some(), &[Dem]),
    ];
    match keys.iter().find(|(_, is_set, kinds)| *is_set && !kinds.contains(&entry.kind)) {
        Some((key, _, kinds)) => {
            let kinds: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
            Err(fault(
                format!("{key} of a {} model", entry.kind.name()),
                &format!("it with kind {}", kinds.join(" or ")),
            ))
        }
        None => Ok(()),
    }
}
