//! Locally optimal projection on the CPU: samples side by side, in the order of their tree.

use std::borrow::Cow;
use std::ops::Range;
use std::time::Instant;

use rayon::prelude::*;

use super::pairs::{Block, PairWeight};
use super::report::Sums;
use super::samples::Around;
use super::start::{self, sample_spacing};
use super::variant::{Density, Formula};
use super::{WlopReport, WlopSamples, WlopSettings, WlopStart};
use crate::Result;
use crate::application::Watch;
use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};
use crate::query::Stage;
use crate::structure::{AabbTreeN, AabbTreeNSettings};

/// Samples of a task, and points of one.
const TASK: usize = 32;
/// Points after which a caller is told and may end it.
const TOLD: usize = 1 << 13;

/// Samples on their way onto the surface of a cloud.
///
/// ```
/// use nearfield::application::{Watch, Wlop, WlopSettings, WlopStart, WlopVariant};
/// use nearfield::geometry::generate::{CloudKind, cloud};
/// use nearfield::{AabbTreeN, AabbTreeNSettings};
///
/// let noisy: Vec<[f32; 3]> = cloud(CloudKind::Shell, 4000, 1).points.iter().map(|p| p.to_array()).collect();
/// let tree = AabbTreeN::build(&noisy, &AabbTreeNSettings::default())?;
/// let settings = WlopSettings::new(WlopVariant::Best).iterations(20);
/// let start = WlopStart::Random { count: 300, seed: 7 };
/// let mut wlop = Wlop::new(&tree, &start, &settings, &mut Watch::none())?;
/// for report in wlop.run(&mut Watch::none())? {
///     println!("{}: moved by {} on average", report.iteration, report.mean_move);
/// }
/// let samples = wlop.samples();
/// assert_eq!((samples.positions.len(), samples.unattracted()), (300, 0));
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Wlop<'a, T> {
    settings: WlopSettings,
    formula: Formula,
    radius: T,
    /// Mean distance of the nearest samples as they began.
    spacing: f64,
    inputs: &'a AabbTreeN<T, 3>,
    /// v of the points, in the order of their tree.
    input_weights: Option<Vec<T>>,
    tree: AabbTreeN<T, 3>,
    positions: Vec<Vector<T>>,
    around: Vec<Around>,
    iterations: u32,
    rests: bool,
}

/// Where a sample goes, and what was around it.
struct Outcome<T> {
    position: Vector<T>,
    around: Around,
}

impl<'a, T: Scalar> Wlop<'a, T> {
    /// Samples that begin at some of the points of `tree` or elsewhere; computes the weights of the points.
    ///
    /// # Errors
    /// `InvalidSetting` for a setting, a radius that cannot be searched or that refers to samples or points without a spacing or a
    /// size, more samples than points, and indices beyond them; `NonFinite`, `CoordinateBeyond`, `TooMany` for samples of the caller's;
    /// `Interrupted` where the watch ends it.
    pub fn new(
        tree: &'a AabbTreeN<T, 3>,
        start: &WlopStart<'_, T>,
        settings: &WlopSettings,
        watch: &mut Watch<'_>,
    ) -> Result<Self> {
        settings.validate()?;
        let points = tree.ordered_points();
        let mut places = vec![0; points.len()];
        points.ids().iter().enumerate().for_each(|(place, &id)| places[id as usize] = place);
        let positions = start.positions(points.len(), |index| points.position(places[index]))?;
        drop(places);
        let samples = AabbTreeN::build(&positions, &AabbTreeNSettings::default())?;
        let radius = match positions.is_empty() {
            // Nothing is searched.
            true => T::ONE,
            false => start::radius(settings, || Ok(Cow::Borrowed(tree)), &samples)?,
        };
        let formula = Formula::new(settings.variant, settings.weigh_inputs, radius.to_f64());
        let input_weights = match formula.inputs.filter(|_| !positions.is_empty()) {
            Some(density) => Some(input_weights(tree, &density, radius, watch)?),
            None => None,
        };
        Ok(Self {
            settings: *settings,
            formula,
            radius,
            spacing: sample_spacing(&samples),
            inputs: tree,
            input_weights,
            tree: samples,
            around: vec![Around::default(); positions.len()],
            positions,
            iterations: 0,
            rests: false,
        })
    }

    /// Moves every sample once.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateBeyond` where a sample has left what can be searched; the samples are then as they were.
    pub fn iterate(&mut self) -> Result<WlopReport> {
        let start = Instant::now();
        let weights = densities(&self.tree, &self.formula.samples, self.radius, 0..self.positions.len());
        let mut stages = vec![Stage::on_host("sample weights", start)];
        let moves_start = Instant::now();
        let mover = Mover::new(self, &weights);
        let places = 0..self.positions.len();
        let outcomes: Vec<Outcome<T>> =
            places.into_par_iter().with_min_len(TASK).map(|place| mover.outcome(place)).collect();
        stages.push(Stage::on_host("moves", moves_start));
        let refit_start = Instant::now();
        let mut moved = vec![[T::ZERO; 3]; outcomes.len()];
        let ids = self.tree.ordered_points().ids();
        ids.iter().zip(&outcomes).for_each(|(&id, outcome)| moved[id as usize] = outcome.position);
        let (mut sums, mut around) = (Sums::default(), vec![Around::default(); outcomes.len()]);
        for (&id, outcome) in ids.iter().zip(&outcomes) {
            let way = vector::norm(vector::subtract(outcome.position, self.positions[id as usize])).to_f64();
            sums.moves += way;
            sums.largest = sums.largest.max(way);
            sums.inputs += f64::from(outcome.around.inputs);
            sums.samples += f64::from(outcome.around.samples);
            sums.unattracted += u64::from(!outcome.around.is_attracted);
            around[id as usize] = outcome.around;
        }
        self.tree.refit(&moved)?;
        (self.positions, self.around) = (moved, around);
        stages.push(Stage::on_host("refit", refit_start));
        self.iterations += 1;
        let n = self.positions.len();
        let report = sums.report(self.iterations, n, stages, start.elapsed().as_secs_f64() * 1e3);
        self.rests = report.mean_move < self.settings.tolerance * self.spacing;
        Ok(report)
    }

    /// Whether the samples rest, have made all iterations, or are none.
    pub fn is_done(&self) -> bool {
        self.rests || self.iterations >= self.settings.iterations || self.positions.is_empty()
    }

    /// Iterates until all is done.
    ///
    /// # Errors
    /// `Interrupted` where the watch ends it; the samples are then where their last move led. As [`Wlop::iterate`].
    pub fn run(&mut self, watch: &mut Watch<'_>) -> Result<Vec<WlopReport>> {
        let mut reports = Vec::new();
        while !self.is_done() {
            watch.report("resampling", self.iterations.into(), self.settings.iterations.into())?;
            reports.push(self.iterate()?);
        }
        Ok(reports)
    }

    /// `[s]` where the samples are now.
    pub fn positions(&self) -> &[Vector<T>] {
        &self.positions
    }

    /// The samples as they are now; no flags before the first iteration.
    pub fn samples(&self) -> WlopSamples<T> {
        if self.iterations == 0 {
            let flags = vec![Default::default(); self.positions.len()];
            return WlopSamples { positions: self.positions.clone(), flags };
        }
        let least = (self.settings.least_attraction, self.formula.least_samples);
        WlopSamples::new(self.positions.clone(), &self.around, least.0, least.1)
    }

    /// The radius in the unit of the points.
    pub fn radius(&self) -> T {
        self.radius
    }
}

/// What is the same for all samples of an iteration.
struct Mover<'a, T> {
    wlop: &'a Wlop<'a, T>,
    /// w of the samples, in the order of their tree.
    weights: &'a [T],
    attraction: PairWeight<T>,
    repulsion: PairWeight<T>,
    reach: T,
    /// Squared distances below which points and samples do not count.
    skips2: [T; 2],
    /// Squared distance below which a point is where the sample is.
    at_sample2: T,
    mu: T,
}

impl<'a, T: Scalar> Mover<'a, T> {
    fn new(wlop: &'a Wlop<'a, T>, weights: &'a [T]) -> Self {
        let Formula { attraction, repulsion, first_power, .. } = wlop.formula;
        let power = if wlop.iterations == 0 { first_power } else { attraction.power };
        Self {
            wlop,
            weights,
            attraction: PairWeight::new(&attraction, power, wlop.radius),
            repulsion: PairWeight::new(&repulsion, repulsion.power, wlop.radius),
            reach: T::of(attraction.reach) * wlop.radius,
            skips2: [attraction.skip2(), repulsion.skip2()],
            at_sample2: T::of(attraction.least_y) * wlop.radius * wlop.radius,
            mu: T::of(wlop.settings.mu),
        }
    }

    fn outcome(&self, place: usize) -> Outcome<T> {
        let at = self.wlop.tree.ordered_points().position(place);
        let (pull, weight, mut around) = self.pull(&at);
        let (push, n_samples) = self.push(&at, place);
        around.samples = n_samples;
        around.is_attracted = weight > T::ZERO && weight >= T::of(self.wlop.formula.attraction.least_weight);
        let mut position = at;
        if around.is_attracted {
            position = vector::add_scaled(position, pull, T::ONE / weight);
        }
        if around.is_attracted || self.wlop.formula.drifts {
            position = vector::add_scaled(position, push, self.mu);
        }
        Outcome { position, around }
    }

    /// Σ weight · (point − sample) and Σ weight over the points around a sample.
    fn pull(&self, at: &Vector<T>) -> (Vector<T>, T, Around) {
        let points = self.wlop.inputs.ordered_points();
        let (mut pull, mut sum, mut crowd, mut inputs) = ([T::ZERO; 3], T::ZERO, T::ZERO, 0);
        let mut add = |place: usize, theta: T, mut weight: T| {
            crowd += theta;
            if let Some(weights) = &self.wlop.input_weights {
                weight = weight * weights[place];
            }
            pull = vector::add_scaled(pull, vector::subtract(points.position(place), *at), weight);
            sum += weight;
        };
        let (mut block, mut at_sample) = (Block::new(), T::ZERO);
        self.wlop.inputs.for_each_place_within(at, self.reach, |place, dist2| {
            inputs += 1;
            if dist2 < self.skips2[0] {
                return;
            }
            if dist2 < self.at_sample2 {
                at_sample += T::ONE;
            }
            if block.add(place, dist2) {
                block.weigh(&self.attraction, &mut add);
            }
        });
        block.weigh(&self.attraction, &mut add);
        // Each point where the sample stands has added 1, but for rounding.
        let crowd = (crowd - at_sample).larger(T::ZERO).to_f64();
        (pull, sum, Around { crowd, inputs, ..Around::default() })
    }

    /// The mean of (sample − other) over the other samples, by their weights, and how many there are. Those at the sample's place are
    /// counted but push nowhere.
    fn push(&self, at: &Vector<T>, own: usize) -> (Vector<T>, u32) {
        let points = self.wlop.tree.ordered_points();
        let (mut push, mut sum, mut samples) = ([T::ZERO; 3], T::ZERO, 0);
        let mut add = |place: usize, _: T, weight: T| {
            let weight = weight * self.weights[place];
            push = vector::add_scaled(push, vector::subtract(*at, points.position(place)), weight);
            sum += weight;
        };
        let mut block = Block::new();
        self.wlop.tree.for_each_place_within(at, self.wlop.radius, |place, dist2| {
            if place == own {
                return;
            }
            samples += 1;
            if dist2 >= self.skips2[1] && block.add(place, dist2) {
                block.weigh(&self.repulsion, &mut add);
            }
        });
        block.weigh(&self.repulsion, &mut add);
        let least = T::of(self.wlop.formula.repulsion.least_weight);
        match sum > T::ZERO && sum >= least && samples >= self.wlop.formula.least_samples {
            true => (vector::scale(push, T::ONE / sum), samples),
            false => ([T::ZERO; 3], samples),
        }
    }
}

/// v of all points of a tree, in its order.
///
/// # Errors
/// `Interrupted` where the watch ends it.
fn input_weights<T: Scalar>(
    tree: &AabbTreeN<T, 3>,
    density: &Density,
    radius: T,
    watch: &mut Watch<'_>,
) -> Result<Vec<T>> {
    let n = tree.len();
    let mut weights = Vec::with_capacity(n);
    for first in (0..n).step_by(TOLD) {
        watch.report("weights of points", first as u64, n as u64)?;
        weights.extend(densities(tree, density, radius, first..n.min(first + TOLD)));
    }
    watch.report("weights of points", n as u64, n as u64)?;
    Ok(weights)
}

/// Weights of points at places of a tree by how crowded they are.
fn densities<T: Scalar>(tree: &AabbTreeN<T, 3>, density: &Density, radius: T, places: Range<usize>) -> Vec<T> {
    let points = tree.ordered_points();
    let (reach, skip2) = (T::of(density.reach) * radius, T::of(density.skip2));
    let falloff = T::of(-density.falloff) / (radius * radius);
    let weight = |own: usize| {
        let (mut sum, mut block) = (T::of(density.own), Block::new());
        tree.for_each_place_within(&points.position(own), reach, |place, dist2| {
            if place != own && dist2 >= skip2 && block.add(place, dist2) {
                block.add_to(&mut sum, falloff);
            }
        });
        block.add_to(&mut sum, falloff);
        density.result.of(sum)
    };
    places.into_par_iter().with_min_len(TASK).map(weight).collect()
}
