//! Where light comes from: triangles that emit, points, and the environment. Twin of `light.wesl`.
//!
//! A light sample picks a kind of light (those that a scene has, equally often), then one of that kind by its power,
//! then a place on it. Shares are whole numbers of 2⁻²⁴, so that the density that a sample is divided by is exactly
//! that with which it was picked; what rounds to a share of zero is found by scattered rays alone, which then count in full.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::material::{LIGHT, is_radiance};
use super::sampling::{cos_sin, luminance, triangle_weights, turns_of};
use super::tables::SceneTables;
use crate::geometry::validate;
use crate::{Error, Result};

/// A light without an extent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointLight {
    /// Relative to the origin of the mesh.
    pub position: Vec3,
    /// Radiant intensity: what arrives at distance d is `intensity` / d².
    pub intensity: Vec3,
}

/// Light from infinitely far away.
#[derive(Debug, Clone, PartialEq)]
pub enum Environment {
    /// The same radiance from everywhere; zero for none.
    Constant(Vec3),
    /// A picture of all directions.
    Image(EnvironmentImage),
}

/// Radiance from all directions as rows of equal angles: the first row lies around +y, and columns go from +x towards
/// +z. A texel has one radiance.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvironmentImage {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `[height × width]` radiance, row after row.
    pub texels: Vec<Vec3>,
}

/// Most texels of an environment: shares are whole numbers of 2⁻²⁴.
const MOST_TEXELS: u64 = 1 << 24;

impl Environment {
    /// No light.
    pub const NONE: Self = Self::Constant(Vec3::ZERO);

    pub(super) fn check(&self) -> Result<()> {
        let fault = |found: String, expected| Err(Error::InvalidSetting { setting: "environment", found, expected });
        match self {
            Self::Constant(radiance) if !is_radiance(*radiance) => fault(radiance.to_string(), LIGHT),
            Self::Constant(_) => Ok(()),
            Self::Image(image) => {
                let texels = u64::from(image.width) * u64::from(image.height);
                if texels == 0 || texels > MOST_TEXELS {
                    let found = format!("{} × {} texels", image.width, image.height);
                    return fault(found, "an image of 1 to 16,777,216 texels");
                }
                if image.texels.len() as u64 != texels {
                    let found = image.texels.len() as u64;
                    return Err(Error::LengthMismatch { what: "texels of the environment", found, expected: texels });
                }
                match image.texels.iter().position(|&texel| !is_radiance(texel)) {
                    Some(i) => fault(format!("{} of texel {i}", image.texels[i]), LIGHT),
                    None => Ok(()),
                }
            }
        }
    }
}

impl PointLight {
    pub(super) fn check(&self, index: usize) -> Result<()> {
        if !self.position.abs().cmple(Vec3::splat(validate::MAX_COORDINATE)).all() {
            let found = format!("{} of light {index}", self.position);
            let expected = "finite coordinates within ±1e18";
            return Err(Error::InvalidSetting { setting: "position", found, expected });
        }
        if !is_radiance(self.intensity) {
            let found = format!("{} of light {index}", self.intensity);
            return Err(Error::InvalidSetting { setting: "intensity", found, expected: LIGHT });
        }
        Ok(())
    }
}

/// A point light as the stages read it: 32 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct PointRecord {
    pub(super) position: Vec3,
    pub(super) padding_0: u32,
    pub(super) intensity: Vec3,
    pub(super) padding_1: u32,
}

/// All lights as the stages read them.
#[derive(Debug, Clone, Default)]
pub(super) struct LightTables {
    /// Triangles that emit, and the summed shares before each of them.
    pub(super) emitters: Vec<u32>,
    pub(super) emitter_sums: Vec<u32>,
    pub(super) points: Vec<PointRecord>,
    pub(super) point_sums: Vec<u32>,
    /// Radiance of every texel, and the density with which its directions are picked.
    pub(super) texels: Vec<[f32; 4]>,
    pub(super) texel_sums: Vec<u32>,
    /// `[rows + 1]` cosine to +y of the upper edge of each row.
    pub(super) row_cosines: Vec<f32>,
    pub(super) columns: u32,
    /// How often an emitter is picked, and an environment.
    pub(super) emitter_share: f32,
    pub(super) environment_share: f32,
}

const WHOLE: u32 = 1 << 24;

/// Sums of shares in 2⁻²⁴ `[weights + 1]`; empty where nothing weighs anything.
fn summed_shares(weights: &[f64]) -> Vec<u32> {
    let total: f64 = weights.iter().sum();
    if total <= 0.0 {
        return vec![];
    }
    let mut sum = 0.0;
    let mut sums = vec![0];
    for weight in weights {
        sum += weight;
        sums.push(((sum / total * f64::from(WHOLE)).round() as u32).min(WHOLE));
    }
    *sums.last_mut().expect("sums should begin with a zero") = WHOLE;
    sums
}

/// The share of element `i`.
fn share(sums: &[u32], i: usize) -> f32 {
    (sums[i + 1] - sums[i]) as f32 * (1.0 / WHOLE as f32)
}

impl LightTables {
    /// `emitters`: triangle and power of each. Gives also the share of each emitter that one light sample picks it with.
    pub(super) fn new(emitters: &[(u32, f64)], points: &[PointLight], environment: &Environment) -> (Self, Vec<f32>) {
        let brightness = |color: Vec3| f64::from(luminance(color));
        let record =
            |p: &PointLight| PointRecord { position: p.position, intensity: p.intensity, ..PointRecord::zeroed() };
        let mut tables = Self {
            emitters: emitters.iter().map(|(triangle, _)| *triangle).collect(),
            emitter_sums: summed_shares(&emitters.iter().map(|(_, power)| *power).collect::<Vec<_>>()),
            points: points.iter().map(record).collect(),
            point_sums: summed_shares(&points.iter().map(|p| brightness(p.intensity)).collect::<Vec<_>>()),
            ..Self::default()
        };
        let constant;
        let image = match environment {
            Environment::Image(image) => image,
            Environment::Constant(radiance) => {
                constant = EnvironmentImage { width: 1, height: 1, texels: vec![*radiance] };
                &constant
            }
        };
        let (width, height) = (image.width as usize, image.height as usize);
        let edge = |row: usize| libm::cos(std::f64::consts::PI * row as f64 / height as f64);
        tables.columns = image.width;
        tables.row_cosines = (0..=height).map(|row| edge(row) as f32).collect();
        let solid_angle = |row: usize| std::f64::consts::TAU / width as f64 * (edge(row) - edge(row + 1));
        let weights: Vec<f64> =
            image.texels.iter().enumerate().map(|(i, &texel)| brightness(texel) * solid_angle(i / width)).collect();
        tables.texel_sums = summed_shares(&weights);

        let kinds = [&tables.emitter_sums, &tables.texel_sums, &tables.point_sums];
        let one = 1.0 / kinds.iter().filter(|sums| !sums.is_empty()).count().max(1) as f32;
        tables.emitter_share = if tables.emitter_sums.is_empty() { 0.0 } else { one };
        tables.environment_share = if tables.texel_sums.is_empty() { 0.0 } else { one };
        let texel = |(i, texel): (usize, &Vec3)| {
            let picked = if tables.texel_sums.is_empty() { 0.0 } else { one * share(&tables.texel_sums, i) };
            [texel.x, texel.y, texel.z, (f64::from(picked) / solid_angle(i / width)) as f32]
        };
        tables.texels = image.texels.iter().enumerate().map(texel).collect();
        let emitter_shares = (0..emitters.len())
            .map(|i| if tables.emitter_sums.is_empty() { 0.0 } else { one * share(&tables.emitter_sums, i) })
            .collect();
        (tables, emitter_shares)
    }
}

/// The last element whose sum is not above `number`.
fn picked(sums: &[u32], number: u32) -> usize {
    let (mut low, mut high) = (0, sums.len() as u32 - 1);
    while high - low > 1 {
        let middle = (low + high) / 2;
        if sums[middle as usize] <= number {
            low = middle;
        } else {
            high = middle;
        }
    }
    low as usize
}

/// Light that may arrive at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LightSample {
    /// Unit direction towards it.
    pub(super) direction: Vec3,
    /// Radiance over density; zero where nothing can arrive.
    pub(super) radiance: Vec3,
    /// Density per solid angle; zero for a point light.
    pub(super) density: f32,
    /// Where it is, outside of its surface; not used where `far`.
    pub(super) place: Vec3,
    /// Whether it comes from the environment.
    pub(super) far: bool,
}

/// Picks light that may arrive at `from`. `kind` in [0, 1), `choice` of 24 bits.
pub(super) fn sample_light(tables: &SceneTables, from: Vec3, kind: f32, choice: u32, u: [f32; 2]) -> LightSample {
    let lights = &tables.lights;
    let none = LightSample { direction: Vec3::Z, radiance: Vec3::ZERO, density: 0.0, place: Vec3::ZERO, far: false };
    if kind < lights.emitter_share {
        let triangle = &tables.triangles[lights.emitters[picked(&lights.emitter_sums, choice)] as usize];
        let material = &tables.materials[triangle.material as usize];
        let place = triangle.at(triangle_weights(u));
        let to = place - from;
        let distance2 = to.dot(to);
        if distance2 <= 0.0 {
            return none;
        }
        let direction = to / distance2.sqrt();
        let cosine = -direction.dot(triangle.normal);
        if cosine == 0.0 || (cosine < 0.0 && material.two_sided == 0) {
            return none;
        }
        let density = triangle.light_density * distance2 / cosine.abs();
        let side = if cosine < 0.0 { -1.0 } else { 1.0 };
        return LightSample {
            direction,
            radiance: material.emission / density,
            density,
            place: place + triangle.normal * (side * tables.clearance(place)),
            far: false,
        };
    }
    if kind < lights.emitter_share + lights.environment_share {
        let i = picked(&lights.texel_sums, choice);
        let (row, column) = (i as u32 / lights.columns, i as u32 % lights.columns);
        let upper = lights.row_cosines[row as usize];
        let lower = lights.row_cosines[row as usize + 1];
        let y = upper + (lower - upper) * u[0];
        let sine = (1.0 - y * y).max(0.0).sqrt();
        let [c, s] = cos_sin((column as f32 + u[1]) / lights.columns as f32);
        let [r, g, b, density] = lights.texels[i];
        let direction = Vec3::new(sine * c, y, sine * s);
        return LightSample { direction, radiance: Vec3::new(r, g, b) / density, density, far: true, ..none };
    }
    if lights.point_sums.is_empty() {
        return none;
    }
    let i = picked(&lights.point_sums, choice);
    let light = &lights.points[i];
    let to = light.position - from;
    let distance2 = to.dot(to);
    if distance2 <= 0.0 {
        return none;
    }
    let often = (1.0 - lights.emitter_share - lights.environment_share) * share(&lights.point_sums, i);
    LightSample {
        direction: to / distance2.sqrt(),
        radiance: light.intensity / (distance2 * often),
        place: light.position,
        ..none
    }
}

/// What comes from the environment along a unit direction: radiance, and the density with which [`sample_light`] picks it.
pub(super) fn environment(lights: &LightTables, direction: Vec3) -> (Vec3, f32) {
    let rows = lights.row_cosines.len() as u32 - 1;
    // The last row whose upper edge is not below the direction.
    let (mut low, mut high) = (0, rows);
    while high - low > 1 {
        let middle = (low + high) / 2;
        if lights.row_cosines[middle as usize] >= direction.y {
            low = middle;
        } else {
            high = middle;
        }
    }
    let column = (turns_of(direction.x, direction.z) * lights.columns as f32) as u32;
    let [r, g, b, density] = lights.texels[(low * lights.columns + column.min(lights.columns - 1)) as usize];
    (Vec3::new(r, g, b), density)
}

/// A choice of 24 bits out of 32.
pub(super) fn choice_of(bits: u32) -> u32 {
    bits >> 8
}

#[cfg(test)]
mod tests {
    use super::super::sampling::{pair, unit_pair};
    use super::*;

    #[test]
    fn shares_add_up_and_are_picked_as_often_as_they_say() {
        let weights = [1.0, 0.0, 3.0, 1e-12, 4.0];
        let sums = summed_shares(&weights);
        assert_eq!(sums.len(), 6);
        let total: f32 = (0..5).map(|i| share(&sums, i)).sum();
        assert_eq!(total, 1.0);
        assert_eq!([share(&sums, 0), share(&sums, 1), share(&sums, 2)], [0.125, 0.0, 0.375]);
        for (number, expected) in [(0, 0), (WHOLE / 8 - 1, 0), (WHOLE / 8, 2), (WHOLE / 2, 4), (WHOLE - 1, 4)] {
            assert_eq!(picked(&sums, number), expected, "{number}");
        }
        assert!(summed_shares(&[0.0, 0.0]).is_empty() && summed_shares(&[]).is_empty());
    }

    #[test]
    fn directions_picked_in_the_environment_are_found_in_it_with_the_same_density_which_integrates_to_one() {
        let (width, height) = (8, 5);
        let texels: Vec<Vec3> = (0..width * height).map(|i| Vec3::splat(((i * 7) % 11) as f32)).collect();
        let image = EnvironmentImage { width, height, texels };
        let (lights, _) = LightTables::new(&[], &[], &Environment::Image(image));
        assert_eq!(lights.environment_share, 1.0);
        let total: f64 = (0..(width * height) as usize)
            .map(|i| {
                let row = i / width as usize;
                let angle = std::f64::consts::TAU / f64::from(width)
                    * f64::from(lights.row_cosines[row] - lights.row_cosines[row + 1]);
                f64::from(lights.texels[i][3]) * angle
            })
            .sum();
        assert!((total - 1.0).abs() < 1e-5, "{total}");
        let tables = SceneTables { lights, ..SceneTables::default() };
        let mut differ = 0;
        for i in 0..4000 {
            let choice = choice_of(pair(1, i)[0]);
            let sample = sample_light(&tables, Vec3::ZERO, 0.5, choice, unit_pair(2, i));
            let (_, density) = environment(&tables.lights, sample.direction);
            differ += u32::from(density != sample.density);
            assert!((sample.direction.length() - 1.0).abs() < 1e-6);
        }
        // Only directions within rounding of the edge of a texel may fall into its neighbour.
        assert!(differ <= 2, "{differ}");
    }
}
