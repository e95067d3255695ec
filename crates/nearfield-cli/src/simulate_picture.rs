//! A frame of a simulation: its particles as balls in the box of the scene, from the same place in every frame.

use nearfield::Vec3;
use nearfield::application::particles::{Dimensions, ParticleModel, ParticleScene, Particles, Simulate};
use rayon::prelude::*;

use crate::colormap;
use crate::exit::Failure;
use crate::options::PictureSize;
use crate::picture::{Bar, Colors, Image, Scale, Scene, Space, Swatch, Up, draw_balls};
use crate::report::{grouped, short};

/// What colours mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum ColorBy {
    Speed,
    Density,
    Class,
}

/// The ball that does not move.
const COLLIDER: [u8; 3] = [196, 202, 212];
/// Part of the speed after a fall from the top that is the end of the scale: few particles become faster.
const FAST: f64 = 0.9;
/// Densities at the ends of the scale, in parts of that at rest.
const DENSITIES: [f64; 2] = [0.9, 1.1];
/// Balls of a fluid are a little larger than their spacing, so that a body of it has no holes.
const FLUID: f64 = 0.56;

/// How all frames of a simulation look.
pub(crate) struct Look {
    color: ColorBy,
    scale: Scale,
    space: Space,
    size: PictureSize,
    /// By class.
    radii: Vec<f32>,
    /// Of a fluid; 0 of grains.
    rest_density: f32,
}

impl Look {
    pub(crate) fn of(scene: &ParticleScene, color: Option<ColorBy>, size: PictureSize) -> Result<Self, Failure> {
        let fluid = scene.model.fluid();
        let rest_density = fluid.map(|fluid| fluid.rest_density);
        let radii: Vec<f32> = match &scene.model {
            ParticleModel::Dem(dem) => dem.radii.iter().map(|&radius| radius as f32).collect(),
            _ => fluid.iter().map(|fluid| (FLUID * fluid.spacing) as f32).collect(),
        };
        let usual = if radii.len() > 1 { ColorBy::Class } else { ColorBy::Speed };
        let color = color.unwrap_or(usual);
        let scale = match (color, rest_density) {
            (ColorBy::Density, None) => {
                let what = format!("--color density: a {} scene has no densities", scene.model.name());
                return Err(Failure::Usage(what));
            }
            (ColorBy::Density, Some(rest)) => {
                let [low, high] = DENSITIES.map(|part| (part * rest) as f32);
                Scale::between(low, high, Colors::Perceptual)
            }
            (_, Some(_)) => Scale::between(0.0, fast(scene) as f32, Colors::Water),
            (_, None) => Scale::between(0.0, fast(scene) as f32, Colors::Perceptual),
        };
        let corners = scene.domain.map(|corner| corner.as_vec3());
        let space = Space { corners, is_flat: scene.dimensions == Dimensions::Two };
        let rest_density = rest_density.unwrap_or_default() as f32;
        Ok(Self { color, scale, space, size, radii, rest_density })
    }

    /// The particles as they are now.
    pub(crate) fn draw(&self, simulation: &dyn Simulate, particles: &Particles) -> Image {
        let scene = simulation.scene();
        let n = particles.len();
        let mut points: Vec<Vec3> = particles.positions.par_iter().map(|position| position.as_vec3()).collect();
        let mut colors: Vec<[u8; 3]> = (0..n).into_par_iter().map(|i| self.color_of(particles, i)).collect();
        let radius = |&class: &u8| self.radii.get(usize::from(class)).copied().unwrap_or(0.0);
        let mut radii: Vec<f32> = particles.classes.iter().map(radius).collect();
        if let ParticleModel::Dem(dem) = &scene.model
            && let Some(ball) = &dem.collider
        {
            points.push(ball.center.as_vec3());
            colors.push(COLLIDER);
            radii.push(ball.radius as f32);
        }
        let bar = |label: &str| Some(Bar { label: label.to_owned(), scale: self.scale });
        let (bar, swatches) = match self.color {
            ColorBy::Speed => (bar("speed"), vec![]),
            ColorBy::Density => (bar("density"), vec![]),
            ColorBy::Class => (None, self.classes()),
        };
        let drawn = Scene {
            points: &points,
            colors: &colors,
            sizes: &[],
            focus: &[],
            up: Up::Y,
            title: format!("{}   t = {:.3}", scene.name, simulation.time()),
            subtitle: format!(
                "{} particles, {}, step {}",
                grouped(n as u64),
                scene.model.name(),
                grouped(simulation.step())
            ),
            bar,
            swatches,
        };
        draw_balls(&drawn, &radii, &self.space, self.size)
    }

    fn color_of(&self, particles: &Particles, i: usize) -> [u8; 3] {
        match self.color {
            ColorBy::Speed => self.scale.color_of(particles.velocities[i].length() as f32),
            // Before the first step no density is known: that of rest.
            ColorBy::Density => {
                self.scale.color_of(particles.densities.get(i).map_or(self.rest_density, |&density| density as f32))
            }
            ColorBy::Class => colormap::category(particles.classes[i].into()),
        }
    }

    fn classes(&self) -> Vec<Swatch> {
        let radii = self.radii.iter().zip(0..);
        radii
            .map(|(&radius, class)| Swatch {
                label: format!("r {}", short(radius, 3)),
                color: Some(colormap::category(class)),
            })
            .collect()
    }
}

/// A speed that few particles pass: a part of that after a fall from the highest one to the lower end of the domain, or the highest at
/// the start.
fn fast(scene: &ParticleScene) -> f64 {
    let gravity = scene.gravity.length();
    let start = scene.particles.velocities.iter().map(|velocity| velocity.length()).fold(0.0, f64::max);
    let down = scene.gravity.normalize_or_zero();
    let depths = scene.particles.positions.iter().map(|position| position.dot(down));
    let highest = depths.fold(f64::INFINITY, f64::min);
    let [low, high] = scene.domain;
    let floor = (0..3).map(|axis| (low[axis] * down[axis]).max(high[axis] * down[axis])).sum::<f64>();
    let fall = (floor - highest).max(0.0);
    let speed = FAST * (2.0 * gravity * fall).sqrt();
    let speed = if speed.is_finite() { speed.max(start) } else { start };
    if speed > 0.0 { speed } else { 1.0 }
}
