//! Scenes of particles from TOML files. [`read_particle_scene`] documents the keys.

mod layout;
mod model;

use std::path::Path;

use glam::DVec3;

use super::lattice::{MOST_PARTICLES, fill_ball, fill_box, line_box, places_in};
use super::scene::positive;
use super::{Dimensions, ParticleModel, ParticleScene, Particles, TimeStep};
use crate::error::{FileError, Place};
use crate::io::with_path;
use crate::{Error, Result};
use layout::{SceneEntries, StepEntry};

const NAME: &str = "scene";
/// Where a file says nothing.
const GRAVITY: DVec3 = DVec3::new(0.0, -9.81, 0.0);

/// Reads a scene of particles from a TOML file.
///
/// # Keys
///
/// `domain`, `time_step` and `[model]` must be there; a key that is not in this table is an error, and so is one of another model. Lengths,
/// times and masses are in one set of units of the file's choice; the usual numbers are for metres, seconds and kilograms. Vectors have
/// three numbers, also in 2 dimensions, where z of all but the domain is 0.
///
/// | key | value | where it is missing |
/// | --- | --- | --- |
/// | `name` | a short name | the name of the file |
/// | `dimensions` | 2 or 3 | 3 |
/// | `domain` | `{ low = […], high = […] }`: the box that is simulated | an error |
/// | `periodic` | three times `true` or `false`: axes along which what leaves on one side comes back on the other | none |
/// | `gravity` | acceleration of all particles | `[0.0, -9.81, 0.0]` |
/// | `time_step` | a number for steps of one length, or `{ factor, least, most }` for steps by the model's rule | an error |
/// | **`[model]`** | | an error |
/// | `kind` | `"dem"`, `"pbf"`, `"wcsph"` or `"dfsph"` | an error |
/// | `spacing` | fluids: distance of neighbouring particles at rest | an error |
/// | `support` | fluids: distance beyond which they do not act | two spacings |
/// | `rest_density` | fluids | 1000 |
/// | `iterations`, `tolerance`, `relaxation`, `tensile_strength`, `tensile_distance`, `vorticity` | pbf: [`PbfSettings`](super::PbfSettings) | as there |
/// | `most_iterations`, `xsph` | pbf, dfsph | as there |
/// | `sound_speed` | wcsph | an error |
/// | `exponent`, `artificial_viscosity`, `density_diffusion` | wcsph: [`WcsphSettings`](super::WcsphSettings) | as there |
/// | `smoothing` | wcsph, dfsph: `"cubic-spline"` or `"wendland"` | as there |
/// | `viscosity` | wcsph, dfsph | 0 |
/// | `density_tolerance`, `divergence_tolerance` | dfsph: [`DfsphSettings`](super::DfsphSettings) | as there |
/// | `radii` | dem: a radius for each class | an error |
/// | `pair_rule` | dem: `"contact"`, `"symmetric"` or `"gather"` | contact |
/// | `spring`, `damping`, `shear`, `attraction`, `global_damping`, `wall_damping` | dem: [`DemSettings`](super::DemSettings) | those of Green2010 |
/// | `collider` | dem: `{ center = […], radius }` | none |
/// | **`[[box]]`**, **`[[ball]]`** | blocks of particles on a cubic lattice, any number | none |
/// | `low`, `high` | of a box: its corners | an error |
/// | `center`, `radius` | of a ball | an error |
/// | `spacing` | distance of neighbours | that of the fluid; two radii of the class |
/// | `velocity` | of all its particles | 0 |
/// | `class` | which of the `radii` | 0 |
/// | **`[[wall]]`** | `low`, `high`: one layer of particles around a box, for fluids | none |
///
/// ```
/// let text = r#"
/// domain = { low = [0.0, 0.0, 0.0], high = [2.0, 1.0, 1.0] }
/// time_step = 0.002
///
/// [model]
/// kind = "pbf"
/// spacing = 0.1
///
/// [[box]]
/// low = [0.0, 0.0, 0.0]
/// high = [0.5, 0.8, 1.0]
///
/// [[wall]]
/// low = [0.0, 0.0, 0.0]
/// high = [2.0, 1.0, 1.0]
/// "#;
/// let scene = nearfield::application::particles::parse_particle_scene(text)?;
/// assert_eq!(scene.particles.len(), 5 * 8 * 10);
/// # Ok::<(), nearfield::Error>(())
/// ```
///
/// # Errors
/// `Io` that names the file; `File` with the line of what is no TOML, unknown or of the wrong type, and for keys that do not go together; as
/// [`ParticleScene::validate`].
pub fn read_particle_scene(path: &Path) -> Result<ParticleScene> {
    let text = std::fs::read_to_string(path).map_err(|source| Error::Io { path: path.to_owned(), source })?;
    let stem = path.file_stem().map_or_else(|| NAME.to_owned(), |stem| stem.to_string_lossy().into_owned());
    parse(&text, &stem).map_err(|error| with_path(error, path))
}

/// As [`read_particle_scene`], from the text of a file. Its name is "scene" where the text has none.
///
/// # Errors
/// As [`read_particle_scene`].
pub fn parse_particle_scene(text: &str) -> Result<ParticleScene> {
    parse(text, NAME)
}

fn parse(text: &str, usual_name: &str) -> Result<ParticleScene> {
    let entries: SceneEntries = toml::from_str(text).map_err(|error| malformed(text, &error))?;
    let dimensions = match entries.dimensions {
        None | Some(3) => Dimensions::Three,
        Some(2) => Dimensions::Two,
        Some(other) => return Err(fault(format!("dimensions = {other}"), "2 or 3")),
    };
    let model = model::model(&entries.model)?;
    let time_step = match &entries.time_step {
        StepEntry::Fixed(step) => TimeStep::Fixed(*step),
        StepEntry::Cfl(cfl) => TimeStep::Cfl { factor: cfl.factor, least: cfl.least, most: cfl.most },
    };
    let mut scene = ParticleScene {
        name: entries.name.clone().unwrap_or_else(|| usual_name.to_owned()),
        dimensions,
        domain: [entries.domain.low.into(), entries.domain.high.into()],
        periodic: entries.periodic.unwrap_or_default(),
        gravity: entries.gravity.map_or(GRAVITY, DVec3::from_array),
        particles: Particles::default(),
        boundary: Vec::new(),
        model,
        time_step,
    };
    // Before lattices are made of them.
    scene.validate()?;
    scene.particles = particles(&entries, &scene)?;
    scene.boundary = boundary(&entries, &scene)?;
    scene.validate()?;
    Ok(scene)
}

/// The blocks of the file.
fn particles(entries: &SceneEntries, scene: &ParticleScene) -> Result<Particles> {
    let mut all = Particles::default();
    let mut add = |positions: Vec<DVec3>, velocity: [f64; 3], class: u8| {
        let mut block = Particles::at_rest(positions);
        block.velocities.fill(velocity.into());
        block.classes.fill(class);
        all.extend(block);
    };
    let dimensions = scene.dimensions;
    let mut so_far = 0.0;
    for entry in &entries.boxes {
        let spacing = spacing_of(scene, entry.spacing, entry.class)?;
        let (low, high) = (DVec3::from_array(entry.low), DVec3::from_array(entry.high));
        if !(low.is_finite() && high.is_finite() && low.cmple(high).all()) {
            return Err(fault(format!("a box from {low} to {high}"), "its low corner first, all numbers finite"));
        }
        so_far = allowed(so_far, high - low, spacing, dimensions)?;
        add(fill_box(low, high, spacing, dimensions), entry.velocity, entry.class);
    }
    for entry in &entries.balls {
        let spacing = spacing_of(scene, entry.spacing, entry.class)?;
        positive("radius of a ball of particles", entry.radius)?;
        if !DVec3::from_array(entry.center).is_finite() {
            return Err(fault(format!("center = {:?}", entry.center), "three finite numbers"));
        }
        so_far = allowed(so_far, DVec3::splat(2.0 * entry.radius), spacing, dimensions)?;
        add(fill_ball(entry.center.into(), entry.radius, spacing, dimensions), entry.velocity, entry.class);
    }
    Ok(all)
}

/// The walls of the file.
fn boundary(entries: &SceneEntries, scene: &ParticleScene) -> Result<Vec<DVec3>> {
    let Some(spacing) = scene.model.fluid().map(|fluid| fluid.spacing) else {
        if entries.walls.is_empty() {
            return Ok(Vec::new());
        }
        return Err(fault("a [[wall]] of a dem model".to_owned(), "none: the faces of the domain are walls"));
    };
    let mut all = Vec::new();
    for entry in &entries.walls {
        let (low, high) = (DVec3::from_array(entry.low), DVec3::from_array(entry.high));
        let flat = scene.dimensions == Dimensions::Two;
        let size = if flat { (high - low).with_z(1.0) } else { high - low };
        if !(size.is_finite() && size.min_element() > 0.0) {
            return Err(fault(format!("a [[wall]] from {low} to {high}"), "a box with a finite, positive size"));
        }
        // Its layer, with the corners.
        let cells = size / spacing + 2.0;
        let layer = if flat {
            2.0 * (cells.x + cells.y)
        } else {
            2.0 * (cells.x * cells.y + cells.y * cells.z + cells.z * cells.x)
        };
        within_most(layer)?;
        all.extend(line_box(low, high, spacing, scene.dimensions));
    }
    Ok(all)
}

/// The spacing of a block.
fn spacing_of(scene: &ParticleScene, own: Option<f64>, class: u8) -> Result<f64> {
    let usual = match &scene.model {
        ParticleModel::Dem(dem) => dem.radii.get(usize::from(class)).map(|radius| 2.0 * radius),
        model => model.fluid().map(|fluid| fluid.spacing).filter(|_| class == 0),
    };
    let usual = usual.ok_or_else(|| fault(format!("class = {class}"), "a class that has a radius"))?;
    let spacing = own.unwrap_or(usual);
    positive("spacing of a block", spacing)?;
    Ok(spacing)
}

/// Particles so far and those of a block of this size, where they are not too many.
fn allowed(so_far: f64, size: DVec3, spacing: f64, dimensions: Dimensions) -> Result<f64> {
    let count = so_far + places_in(size, spacing, dimensions);
    within_most(count)?;
    Ok(count)
}

fn within_most(count: f64) -> Result<()> {
    if count <= MOST_PARTICLES {
        return Ok(());
    }
    Err(fault(format!("{count} particles"), "fewer than 2^28 of them: a larger spacing or smaller blocks"))
}

fn fault(found: String, expected: &str) -> Error {
    FileError::new(NAME, Place::Whole, found, expected).into()
}

/// What the TOML reader says, with the line.
fn malformed(text: &str, error: &toml::de::Error) -> Error {
    let place = match error.span() {
        Some(span) => {
            let before = text.as_bytes().get(..span.start).unwrap_or_default();
            Place::Line(1 + before.iter().filter(|&&b| b == b'\n').count() as u64)
        }
        None => Place::Whole,
    };
    FileError::new(NAME, place, error.message().replace('\n', " "), "a scene of particles in TOML").into()
}
