//! Figure 20: grains of three radii, by searches and every rule for pairs, with small and large radii. The single grid has cells for the
//! largest radius, and for the smallest.

use nearfield::application::particles::{
    BuiltinOptions, PairRule, ParticleModel, ParticleScene, ParticleSearch, builtin_scene,
};
use nearfield::structure::RebuildPolicy;
use nearfield::{FixedRadius, GridSettings, NeighborSearch, UniformGrid, Vec3};

use super::case::{self, Case};
use super::original::{BySmallestRadius, FIGURE_20, FIGURE_20_PARTICLES};
use super::ways::{AT_R_MIN, Way, devices};
use crate::Result;
use crate::paper::lab::Lab;
use crate::paper::plotting;
use crate::paper::rows::{Row, Sheet};
use crate::plots::{Axes, Frame, Panel};

/// Searches that are compared; the paper has the first and the single grid.
const SEARCHES: [ParticleSearch; 5] = [
    ParticleSearch::Coherent(RebuildPolicy::DEFAULT),
    ParticleSearch::AabbTree(RebuildPolicy::DEFAULT),
    ParticleSearch::UNIFORM_GRID,
    AT_R_MIN,
    ParticleSearch::MultiLevelGrid,
];
/// Classes of the scene.
const CLASSES: [&str; 3] = ["radius 3 r", "radius 2 r", "radius r"];

/// Measures all radii and rules.
///
/// # Errors
/// A wrong answer; what a simulation does not refuse but fails at; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "figure-20")?;
    let mut cases = Vec::new();
    for rule in PairRule::ALL {
        for paper in &FIGURE_20 {
            cases.push(of_radius(lab, rule, paper.r_over_l)?);
        }
    }
    for case in &cases {
        for row in neighbors_by_class(lab, case)? {
            sheet.add(row)?;
        }
    }
    case::all(lab, &mut sheet, &cases, &SEARCHES, |case, way, row, timed| {
        let paper = original(case).filter(|_| case.setting == PairRule::Gather.name());
        let mut rows = vec![row.clone().paper(paper.and_then(|paper| paper.of(way.search)))];
        if way.search == ParticleSearch::UNIFORM_GRID {
            rows.extend(case.stages(lab, way, &row, timed)?);
        }
        Ok(rows)
    })?;
    add_spreads(lab, &mut sheet)?;
    plot(lab, sheet.rows())?;
    Ok(sheet.into_rows())
}

/// The scene with this rule for pairs and smallest radius by the diagonal.
///
/// # Errors
/// As [`builtin_scene`].
pub(crate) fn of_radius(lab: &Lab, rule: PairRule, r_over_l: f64) -> Result<Case> {
    let particles = Some(u32::try_from(lab.points(FIGURE_20_PARTICLES))?);
    let options =
        BuiltinOptions { particles, pair_rule: Some(rule), radius: Some(r_over_l), ..BuiltinOptions::default() };
    let scene = builtin_scene("paper-fig20", &options)?;
    let (paper_particles, setting) = (FIGURE_20_PARTICLES, rule.name().to_owned());
    Ok(Case { scene, paper_particles, setting, r_over_l, steps: case::paper_steps(lab) })
}

fn original(case: &Case) -> Option<&'static BySmallestRadius> {
    FIGURE_20.iter().find(|paper| paper.r_over_l == case.r_over_l)
}

/// Mean neighbours of each class at the start, by the grid on the CPU.
fn neighbors_by_class(lab: &Lab, case: &Case) -> Result<Vec<Row>> {
    let means = mean_neighbors(&case.scene)?;
    let blank = case.row(lab, false, String::new());
    let row = |(name, mean): (&&str, f64)| {
        let row = Row { method: (*name).to_owned(), mean_neighbors: Some(mean), runs: 1, ..blank.clone() };
        row.of("neighbours at the start", "neighbours")
            .value(mean)
            .note("pairs of the rule, each particle itself not counted")
    };
    Ok(CLASSES.iter().zip(means).map(row).collect())
}

/// Others that act on a particle of each class, on average.
///
/// # Errors
/// As the grid.
pub fn mean_neighbors(scene: &ParticleScene) -> Result<Vec<f64>> {
    let ParticleModel::Dem(dem) = &scene.model else { return Ok(Vec::new()) };
    let places: Vec<Vec3> = scene.particles.positions.iter().map(|p| p.as_vec3()).collect();
    let classes: Vec<usize> = scene.particles.classes.iter().map(|&class| class.into()).collect();
    let reach = |own: usize, other: usize| dem.pair_rule.reach(dem.radii[own], dem.radii[other]);
    let farthest = |own: usize| (0..dem.radii.len()).map(|other| reach(own, other)).fold(0.0, f64::max);
    let radii: Vec<f32> = classes.iter().map(|&class| (farthest(class) * 1.000_01) as f32).collect();
    let grid = UniformGrid::build(&places, &GridSettings::for_radius(dem.largest_reach() as f32))?;
    let rows = grid.list(&FixedRadius::each(&radii))?;
    let (mut sums, mut counts) = (vec![0.0; dem.radii.len()], vec![0.0; dem.radii.len()]);
    for (i, &own) in classes.iter().enumerate() {
        let at = scene.particles.positions[i];
        let acts = |&&j: &&u32| {
            let j = j as usize;
            j != i && scene.particles.positions[j].distance(at) < reach(own, classes[j])
        };
        sums[own] += rows.row(i).iter().filter(acts).count() as f64;
        counts[own] += 1.0;
    }
    Ok(sums.iter().zip(counts).map(|(sum, count): (&f64, f64)| sum / count.max(1.0)).collect())
}

/// By how many percent a search is faster at the radius that suits it best than at the one that suits it least.
fn add_spreads(lab: &Lab, sheet: &mut Sheet<'_>) -> Result<()> {
    let rows: Vec<Row> = sheet.rows().iter().filter(|row| row.unit == "steps/s").cloned().collect();
    for rule in PairRule::ALL {
        for &on_gpu in devices(lab) {
            for search in SEARCHES {
                let name = Way { search, on_gpu }.name();
                let of_method: Vec<&Row> =
                    rows.iter().filter(|row| row.method == name && row.setting == rule.name()).collect();
                let values: Vec<f64> = of_method.iter().filter_map(|row| row.value).collect();
                let (Some(first), true) = (of_method.first(), values.len() == FIGURE_20.len()) else { continue };
                let papers: Vec<f64> = of_method.iter().filter_map(|row| row.paper).collect();
                let row = Row { r_over_l: 0.0, ..first.of("spread over r", "%") };
                let paper = (papers.len() == FIGURE_20.len()).then(|| spread(&papers));
                sheet.add(row.value(spread(&values)).paper(paper).note("fastest by slowest, less one"))?;
            }
        }
    }
    Ok(())
}

fn spread(values: &[f64]) -> f64 {
    let (low, high) = values.iter().fold((f64::INFINITY, 0.0), |(low, high), &v| (f64::min(low, v), f64::max(high, v)));
    100.0 * (high / low - 1.0)
}

fn plot(lab: &Lab, rows: &[Row]) -> Result<()> {
    let panel = |rule: PairRule| {
        let own = rows.iter().filter(|row| row.unit == "steps/s" && row.setting == rule.name());
        let mut series = plotting::by_method(own, |row| 100.0 * row.r_over_l);
        let color = |name: &str| series.iter().find(|line| line.name.starts_with(name)).map_or(7, |line| line.color);
        if rule == PairRule::Gather && !series.is_empty() {
            let published =
                |of: fn(&BySmallestRadius) -> f64| FIGURE_20.iter().map(|p| (100.0 * p.r_over_l, of(p))).collect();
            let papers = [
                plotting::published("coherent, paper", color("coherent,"), published(|paper| paper.coherent)),
                plotting::published("voxels, paper", color("uniform-grid,"), published(|paper| paper.voxels)),
            ];
            series.extend(papers);
        }
        Panel { title: rule.name().to_owned(), series }
    };
    let frame = Frame {
        title: format!("Figure 20: {} grains of three radii", rows.first().map_or(0, |row| row.points)),
        caption: lab.caption(),
        x_label: "smallest radius, % of the domain's diagonal".to_owned(),
        y_label: "steps a second".to_owned(),
        axes: Axes::Logarithmic,
        legend_right: true,
    };
    plotting::save(lab, "figure-20.svg", &frame, &PairRule::ALL.map(panel))
}
