//! A step of position-based fluids as the formulas are printed, over all pairs: what the library must give.

use nearfield::DVec3;
use nearfield::application::particles::{Dimensions, ParticleModel, ParticleScene, PbfSettings, TimeStep};

use std::f64::consts::PI;

/// Kernels as Macklin2013 prints them, and their twins of the plane.
pub(crate) struct Kernels {
    dimensions: Dimensions,
    h: f64,
}

impl Kernels {
    pub(crate) fn new(dimensions: Dimensions, h: f64) -> Self {
        Self { dimensions, h }
    }

    /// Poly6 at an offset.
    pub(crate) fn value(&self, offset: DVec3) -> f64 {
        let (h, r2) = (self.h, offset.length_squared());
        let factor = match self.dimensions {
            Dimensions::Two => 4.0 / (PI * h.powi(8)),
            Dimensions::Three => 315.0 / (64.0 * PI * h.powi(9)),
        };
        if r2 < h * h { factor * (h * h - r2).powi(3) } else { 0.0 }
    }

    /// The gradient of spiky by the particle that is `offset` away from the other.
    pub(crate) fn gradient(&self, offset: DVec3) -> DVec3 {
        let (h, r) = (self.h, offset.length());
        let factor = match self.dimensions {
            Dimensions::Two => -30.0 / (PI * h.powi(5)),
            Dimensions::Three => -45.0 / (PI * h.powi(6)),
        };
        if r < h && r > 0.0 { factor * (h - r).powi(2) * offset / r } else { DVec3::ZERO }
    }

    /// Poly6 summed over a layer of a lattice of this spacing whose middle is `height` beside a place.
    pub(crate) fn layer(&self, spacing: f64, height: f64) -> f64 {
        let reach = (self.h / spacing).ceil() as i32;
        let across = if self.dimensions == Dimensions::Two { 0 } else { reach };
        let at = |x: i32, z: i32| DVec3::new(f64::from(x) * spacing, height, f64::from(z) * spacing);
        (-reach..=reach).flat_map(|x| (-across..=across).map(move |z| at(x, z))).map(|offset| self.value(offset)).sum()
    }

    /// All offsets of a lattice within the support.
    pub(crate) fn lattice(&self, spacing: f64) -> Vec<DVec3> {
        let reach = (self.h / spacing).ceil() as i32;
        let across = if self.dimensions == Dimensions::Two { 0 } else { reach };
        let mut offsets = Vec::new();
        for x in -reach..=reach {
            for y in -reach..=reach {
                for z in -across..=across {
                    offsets.push(spacing * DVec3::new(x.into(), y.into(), z.into()));
                }
            }
        }
        offsets.retain(|offset| offset.length() < self.h);
        offsets
    }
}

/// Particles after a step.
pub(crate) struct Stepped {
    pub(crate) positions: Vec<DVec3>,
    pub(crate) velocities: Vec<DVec3>,
    pub(crate) densities: Vec<f64>,
}

/// One step of a scene from its start, with the fixed number of iterations.
pub(crate) fn step(scene: &ParticleScene) -> Stepped {
    let (ParticleModel::Pbf(settings), TimeStep::Fixed(dt)) = (&scene.model, scene.time_step) else {
        panic!("a fluid of this kind with a fixed step");
    };
    let PbfSettings { fluid, .. } = *settings;
    let kernels = Kernels::new(scene.dimensions, fluid.support);
    let n = scene.particles.len();
    let start = &scene.particles.positions;
    let lattice = kernels.lattice(fluid.spacing);
    let mass = fluid.rest_density / lattice.iter().map(|offset| kernels.value(*offset)).sum::<f64>();
    // A wall of one layer one spacing away counts as much as what the lattice has there.
    let layers = |count: i32| -> f64 {
        (1..=count).map(|layer| kernels.layer(fluid.spacing, f64::from(layer) * fluid.spacing)).sum()
    };
    let volume_at_rest = mass / fluid.rest_density;
    let wall = volume_at_rest * layers(9) / (layers(1) / kernels.layer(fluid.spacing, 0.0));
    let rest = |offset: &DVec3| (mass / fluid.rest_density * kernels.gradient(*offset)).length_squared();
    let squares_at_rest: f64 = lattice.iter().map(rest).sum();

    let mut velocities: Vec<DVec3> = scene.particles.velocities.iter().map(|v| *v + dt * scene.gravity).collect();
    let inside = |p: DVec3| {
        let mut kept = p;
        for axis in 0..scene.dimensions.number() as usize {
            let [low, high] = [scene.domain[0][axis], scene.domain[1][axis]];
            kept[axis] = p[axis].max(low + 0.5 * fluid.spacing).min(high - 0.5 * fluid.spacing);
        }
        kept
    };
    let mut positions: Vec<DVec3> = (0..n).map(|i| inside(start[i] + dt * velocities[i])).collect();
    positions.extend(&scene.boundary);
    let all = positions.len();
    let searched = positions.clone();
    let near = |i: usize, j: usize| i != j && searched[i].distance(searched[j]) < fluid.support;
    let boundary_mass = |b: usize| {
        let sum: f64 = (n..all).map(|other| kernels.value(searched[b] - searched[other])).sum();
        wall * fluid.rest_density / sum
    };
    let masses: Vec<f64> = (0..all).map(|i| if i < n { mass } else { boundary_mass(i) }).collect();
    let density = |positions: &[DVec3], i: usize| {
        let others = (0..all).filter(|&j| near(i, j));
        masses[i] * kernels.value(DVec3::ZERO)
            + others.map(|j| masses[j] * kernels.value(positions[i] - positions[j])).sum::<f64>()
    };
    for _ in 0..settings.iterations {
        let lambdas: Vec<f64> = (0..all)
            .map(|i| {
                if i >= n {
                    return 0.0;
                }
                let constraint = (density(&positions, i) / fluid.rest_density - 1.0).max(0.0);
                let (mut own, mut squares) = (DVec3::ZERO, 0.0);
                for j in (0..all).filter(|&j| near(i, j)) {
                    let gradient = masses[j] / fluid.rest_density * kernels.gradient(positions[i] - positions[j]);
                    own += gradient;
                    if j < n {
                        squares += gradient.length_squared();
                    }
                }
                -constraint / (squares + own.length_squared() + settings.relaxation * squares_at_rest)
            })
            .collect();
        let at_distance = kernels.value(DVec3::X * settings.tensile_distance * fluid.support);
        let way = |i: usize| -> DVec3 {
            let from = |j: usize| {
                let offset = positions[i] - positions[j];
                let tensile =
                    -settings.tensile_strength / squares_at_rest * (kernels.value(offset) / at_distance).powi(4);
                let weight = if j < n { lambdas[i] + lambdas[j] + tensile } else { lambdas[i] };
                masses[j] / fluid.rest_density * weight * kernels.gradient(offset)
            };
            (0..all).filter(|&j| near(i, j)).map(from).sum()
        };
        let ways: Vec<DVec3> = (0..n).map(way).collect();
        for (position, way) in positions.iter_mut().zip(ways) {
            *position = inside(*position + way);
        }
    }
    for i in 0..n {
        velocities[i] = (positions[i] - start[i]) / dt;
    }
    let densities: Vec<f64> = (0..n).map(|i| density(&positions, i)).collect();
    let others = |i: usize| (0..n).filter(move |&j| near(i, j));
    let volume = |j: usize| mass / densities[j];
    if settings.vorticity > 0.0 {
        let curl = |i: usize| -> DVec3 {
            let by = |j: usize| {
                let by_other = kernels.gradient(positions[j] - positions[i]);
                volume(j) * (velocities[j] - velocities[i]).cross(by_other)
            };
            others(i).map(by).sum()
        };
        let curls: Vec<DVec3> = (0..n).map(curl).collect();
        let push = |i: usize| {
            let by = |j: usize| {
                let change = curls[j].length() - curls[i].length();
                volume(j) * change * kernels.gradient(positions[i] - positions[j])
            };
            let growth: DVec3 = others(i).map(by).sum();
            // A thousandth of the vorticity a support is where the direction fades.
            let length = growth.length() + 1e-3 * curls[i].length() / fluid.support;
            if length > 0.0 { (growth / length).cross(curls[i]) } else { DVec3::ZERO }
        };
        let pushes: Vec<DVec3> = (0..n).map(push).collect();
        for (velocity, push) in velocities.iter_mut().zip(pushes) {
            *velocity += dt * settings.vorticity * push;
        }
    }
    let mean = |i: usize| -> DVec3 {
        let by = |j: usize| volume(j) * kernels.value(positions[i] - positions[j]) * (velocities[j] - velocities[i]);
        others(i).map(by).sum()
    };
    let means: Vec<DVec3> = (0..n).map(mean).collect();
    let velocities = velocities.iter().zip(means).map(|(velocity, mean)| *velocity + settings.xsph * mean).collect();
    positions.truncate(n);
    Stepped { positions, velocities, densities }
}
