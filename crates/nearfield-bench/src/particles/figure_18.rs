//! Figure 18: steps a second over the number of grains by every search, and by shifted sorts.

use nearfield::application::particles::ParticleSearch;

use super::case::{self, Case};
use super::original::FIGURE_18;
use super::shifted_sort;
use super::ways::{method, searches};
use crate::Result;
use crate::paper::lab::Lab;
use crate::paper::plotting;
use crate::paper::rows::{Row, Sheet};
use crate::plots::{Axes, Frame, Panel};

/// Measures all sizes.
///
/// # Errors
/// A wrong answer; what a simulation does not refuse but fails at; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "figure-18")?;
    let sizes = case::sizes(lab, &FIGURE_18.map(|row| row.particles));
    let cases: Vec<Case> = sizes.iter().map(|&n| of_size(lab, n)).collect::<Result<_>>()?;
    // Shifted sorts first: there are few rows of them, and the rows that follow share what is left of the budget.
    for case in &cases {
        let row = case.row(lab, lab.gpu().is_some(), method(shifted_sort::NAME, lab.gpu().is_some()));
        let paper = original(case).map(|row| row.shifted_sort);
        let seconds = 0.1 * lab.budget / cases.len() as f64;
        sheet.attempt(row.clone(), || Ok(vec![shifted_sort::measure(lab, case, row, seconds)?.paper(paper)]))?;
    }
    case::all(lab, &mut sheet, &cases, &searches(), |case, way, row, _| {
        Ok(vec![row.paper(original(case).and_then(|paper| paper.of(way.search)))])
    })?;
    add_ratios(lab, &mut sheet, &cases)?;
    plot(lab, sheet.rows())?;
    Ok(sheet.into_rows())
}

/// The scene for the paper's number of grains.
///
/// # Errors
/// As the built-in scenes.
pub fn of_size(lab: &Lab, paper_particles: usize) -> Result<Case> {
    let scene = case::scene("paper-fig18", lab.points(paper_particles))?;
    Ok(Case { scene, paper_particles, setting: String::new(), r_over_l: 0.0, steps: case::paper_steps(lab) })
}

fn original(case: &Case) -> Option<&'static super::original::ByParticles> {
    FIGURE_18.iter().find(|row| row.particles == case.paper_particles)
}

/// How many times as many steps the coherent search makes as others on the same device.
fn add_ratios(lab: &Lab, sheet: &mut Sheet<'_>, cases: &[Case]) -> Result<()> {
    let rows: Vec<Row> = sheet.rows().iter().filter(|row| row.value.is_some()).cloned().collect();
    for case in cases {
        for &on_gpu in super::ways::devices(lab) {
            let coherent = method("coherent", on_gpu);
            let here = || rows.iter().filter(|row| row.paper_points == case.paper_particles);
            let Some(own) = here().find(|row| row.method == coherent).and_then(|row| row.value) else { continue };
            let kind = method("", on_gpu);
            for row in here().filter(|row| row.method.ends_with(&kind) && row.method != coherent) {
                let name = row.method.trim_end_matches(&kind);
                let paper = original(case).and_then(|paper| match name {
                    shifted_sort::NAME => Some(paper.coherent / paper.shifted_sort),
                    _ if name == ParticleSearch::UNIFORM_GRID.name() => Some(paper.coherent / paper.voxels),
                    _ => None,
                });
                let ratio = row.value.map_or(0.0, |other| own / other);
                let note = "the coherent search's steps a second by this search's";
                sheet.add(row.of("gain of the coherent search", "times").value(ratio).paper(paper).note(note))?;
            }
        }
    }
    Ok(())
}

fn plot(lab: &Lab, rows: &[Row]) -> Result<()> {
    let rows = || rows.iter().filter(|row| row.unit == "steps/s");
    let mut series = plotting::by_method(rows(), |row| row.points as f64);
    let color = |name: &str| series.iter().find(|line| line.name.starts_with(name)).map_or(7, |line| line.color);
    let papers = [
        plotting::published(
            "coherent, paper",
            color("coherent"),
            FIGURE_18.map(|r| (r.particles as f64, r.coherent)).into(),
        ),
        plotting::published(
            "shifted sort, paper",
            color(shifted_sort::NAME),
            FIGURE_18.map(|r| (r.particles as f64, r.shifted_sort)).into(),
        ),
        plotting::published(
            "voxels, paper",
            color("uniform-grid"),
            FIGURE_18.map(|r| (r.particles as f64, r.voxels)).into(),
        ),
    ];
    if !series.is_empty() {
        series.extend(papers);
    }
    let frame = Frame {
        title: "Figure 18: steps a second of a run by search".to_owned(),
        caption: lab.caption(),
        x_label: "grains".to_owned(),
        y_label: "steps a second".to_owned(),
        axes: Axes::Logarithmic,
        legend_right: true,
    };
    plotting::save(lab, "figure-18.svg", &frame, &[Panel { title: String::new(), series }])
}
