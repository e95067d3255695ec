//! Steps a second of simulations by the uniform grid, from the start of their scenes.

use nearfield::application::particles::{FluidModel, PairRule, ParticleSearch};

use super::bench::Bench;
use super::row::{Figure, Outcome};
use crate::Result;
use crate::particles::case::{Case, Shared};
use crate::particles::fluids::{self, PARTICLES};
use crate::particles::original::FIGURE_20;
use crate::particles::ways::Way;
use crate::particles::{figure_20, green};

/// Seconds of a row of which some half are timed; the rest are checks.
const SECONDS: f64 = 6.0;
/// Grains of the row.
const GRAINS: usize = 1_000_000;
const BY_GRID: Way = Way { search: ParticleSearch::UNIFORM_GRID, on_gpu: true };

/// Grains of the CUDA sample; before and after the run some steps must be to the bit where another search leads.
pub(super) fn dem(bench: &mut Bench) -> Result<Outcome> {
    let workshop = bench.workshop()?;
    let case = green::of_size(&workshop.lab, GRAINS)?;
    let figure = grains(bench, &case, "")?;
    Ok(Outcome { mean_neighbors: figure.1, figures: vec![figure.0] })
}

/// Grains of three radii with the rule gather, by all three smallest radii; the target is for each.
pub(super) fn three_radii(bench: &mut Bench) -> Result<Outcome> {
    let workshop = bench.workshop()?;
    let mut figures = Vec::new();
    for paper in &FIGURE_20 {
        let case = figure_20::of_radius(&workshop.lab, PairRule::Gather, paper.r_over_l)?;
        let (figure, neighbors) = grains(bench, &case, &format!("gather, r = {} %", 100.0 * paper.r_over_l))?;
        let mean = neighbors.map_or(String::new(), |mean| format!("{mean:.1} neighbours on average; "));
        let note = format!("{mean}{}", figure.note);
        figures.push(figure.note(note));
    }
    Ok(Outcome::without_neighbors(figures))
}

fn grains(bench: &mut Bench, case: &Case, way: &str) -> Result<(Figure, Option<f64>)> {
    let workshop = bench.workshop()?;
    let (row, timed) = case.time(&workshop.lab, BY_GRID, SECONDS, &mut Shared::default())?;
    let figure = Figure::rate(way, timed.rate(), timed.steps as usize).note(row.note);
    Ok((figure, row.mean_neighbors))
}

/// A dam break by a model of fluids, which must stay as dense as at rest and inside.
pub(super) fn fluid(bench: &mut Bench, model: FluidModel) -> Result<Outcome> {
    let workshop = bench.workshop()?;
    let case = fluids::of_model(&workshop.lab, "dam-break", model, PARTICLES)?;
    let row = case.row(&workshop.lab, true, BY_GRID.name());
    let (row, timed) = fluids::run(&workshop.lab, &case, BY_GRID, SECONDS, row)?;
    let figure = Figure::rate("", timed.rate(), timed.steps as usize);
    let note = format!("{} particles; {}", case.scene.particles.len(), row.note);
    Ok(Outcome::of(timed.mean_neighbors, vec![figure.note(note)]))
}
