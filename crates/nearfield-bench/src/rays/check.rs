//! What rays must hit, and the comparison that stops a measurement where they do not.
//!
//! Brute force on the CPU casts a sample of the rays; a hierarchy on the CPU casts all of them and must agree with it to
//! the bit. Every other structure on the CPU must then give the same bits for every ray. A device rounds otherwise:
//! there t may differ by a bound, and a triangle may be hit or not where the ray passes within the margin of
//! [`nearfield::geometry::RaySpace`] of its outline, computed in f64. Any other difference is an error.

use std::sync::Arc;

use nearfield::structure::PreparedTriangles;
use nearfield::{BruteForceMesh, BvhSettings, DVec3, HitRecord, Ray, RaySearch, TriangleBvh};
use rayon::prelude::*;

use super::shots::Question;
use crate::{Error, Result};

/// Rays that brute force casts.
const SAMPLE: usize = 256;
/// Most tests of brute force for a sample; larger meshes are sampled by fewer rays.
const SAMPLE_TESTS: usize = 400_000_000;
/// Relative part of how far t may be off on a device.
const T_SHARE: f64 = 1e-5;
/// The largest share of rays that may differ within the margin on a device.
const MOST_DIFFERING: f64 = 0.01;

/// What a structure answered.
#[derive(Debug, Clone)]
pub enum Answer {
    /// The first hit of each ray.
    Closest(Vec<HitRecord>),
    /// 0 or 1 for each ray.
    Any(Vec<u32>),
    /// Where the hits of each ray begin, and the hits.
    All(Vec<u64>, Vec<HitRecord>),
}

/// How the answers of another library compare with ours, in rays.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Comparison {
    /// The same triangle, t within rounding, or none for both.
    pub same: usize,
    /// Another answer that rounding at the outline of a triangle explains.
    pub within_rounding: usize,
    /// Another answer that it does not explain.
    pub beyond: usize,
    /// The first of these.
    pub first: Option<String>,
}

/// The right answer for some rays.
pub struct Expected<'a> {
    rays: &'a [Ray],
    triangles: Arc<PreparedTriangles>,
    bvh: TriangleBvh,
    answer: Answer,
    sample: Vec<usize>,
}

impl<'a> Expected<'a> {
    /// Casts all rays on the CPU, and a sample by brute force.
    ///
    /// # Errors
    /// What the casts return; brute force and hierarchy that do not agree.
    pub fn of(triangles: &Arc<PreparedTriangles>, rays: &'a [Ray], question: Question) -> Result<Self> {
        let bvh = TriangleBvh::of(triangles.clone(), &BvhSettings::default())?;
        let wanted = (SAMPLE_TESTS / triangles.len()).clamp(16, SAMPLE).min(rays.len());
        // Spread over all rays, not along a column of the picture.
        let sample: Vec<usize> = (0..wanted).map(|i| (i * rays.len() + rays.len() / 3) / wanted).collect();
        let sample: Vec<usize> = sample.into_iter().filter(|&i| i < rays.len()).collect();
        let expected = Self { rays, triangles: triangles.clone(), answer: ask(&bvh, rays, question)?, bvh, sample };
        expected.check_by_brute_force(question)?;
        Ok(expected)
    }

    fn check_by_brute_force(&self, question: Question) -> Result<()> {
        let sampled: Vec<Ray> = self.sample.iter().map(|&i| self.rays[i]).collect();
        let brute = ask(&BruteForceMesh::of(self.triangles.clone()), &sampled, question)?;
        for (place, &i) in self.sample.iter().enumerate() {
            let (right, found) = (self.row(&brute, place), self.row(&self.answer, i));
            if right != found {
                return Err(wrong(i, &format!("{found:?} by the hierarchy, {right:?} by brute force")));
            }
        }
        Ok(())
    }

    /// Number of rays that brute force cast.
    pub fn sample(&self) -> usize {
        self.sample.len()
    }

    /// The rays that brute force cast.
    pub fn sampled_rays(&self) -> Vec<Ray> {
        self.sample.iter().map(|&i| self.rays[i]).collect()
    }

    /// The right answer.
    pub fn answer(&self) -> &Answer {
        &self.answer
    }

    /// The answer to a ray as a row of records.
    fn row(&self, answer: &Answer, i: usize) -> Vec<HitRecord> {
        match answer {
            Answer::Closest(records) => records[i..=i].iter().copied().filter(HitRecord::is_hit).collect(),
            Answer::Any(states) => vec![HitRecord { triangle: states[i], t: 0.0, weights: [0.0; 2] }],
            Answer::All(offsets, records) => records[offsets[i] as usize..offsets[i + 1] as usize].to_vec(),
        }
    }

    /// Checks the answer of a structure on the CPU, to the bit.
    ///
    /// # Errors
    /// A wrong answer.
    pub fn check_exactly(&self, found: &Answer) -> Result<()> {
        self.check_shape(found)?;
        let differs = |&i: &usize| self.row(found, i) != self.row(&self.answer, i);
        match (0..self.rays.len()).into_par_iter().find_first(differs) {
            Some(i) => Err(wrong(i, &format!("{:?}, expected {:?}", self.row(found, i), self.row(&self.answer, i)))),
            None => Ok(()),
        }
    }

    /// Checks the answer of a device; returns how many rays have another one, with the outline of a triangle within the
    /// margin.
    ///
    /// # Errors
    /// A wrong answer.
    pub fn check_rounded(&self, found: &Answer) -> Result<usize> {
        self.check_shape(found)?;
        let judged = (0..self.rays.len()).into_par_iter().map(|i| self.judge(found, i).map(usize::from));
        let differing = judged.try_reduce(|| 0, |a, b| Ok(a + b))?;
        let most = (MOST_DIFFERING * self.rays.len() as f64).ceil() as usize;
        if differing > most {
            let n = self.rays.len();
            return Err(format!(
                "wrong answer: {differing} of {n} rays differ from the CPU's, more than rounding explains"
            )
            .into());
        }
        Ok(differing)
    }

    /// Compares the answer of another library with this one, by the rule for devices.
    ///
    /// # Errors
    /// An answer of another length, or to another question.
    pub fn compare(&self, found: &Answer) -> Result<Comparison> {
        self.check_shape(found)?;
        let judge = |i: usize| match self.judge(found, i) {
            Ok(false) => Comparison { same: 1, ..Comparison::default() },
            Ok(true) => Comparison { within_rounding: 1, ..Comparison::default() },
            Err(error) => Comparison { beyond: 1, first: Some(error.to_string()), ..Comparison::default() },
        };
        let sum = |a: Comparison, b: Comparison| Comparison {
            same: a.same + b.same,
            within_rounding: a.within_rounding + b.within_rounding,
            beyond: a.beyond + b.beyond,
            first: a.first.or(b.first),
        };
        Ok((0..self.rays.len()).into_par_iter().map(judge).reduce(Comparison::default, sum))
    }

    fn check_shape(&self, found: &Answer) -> Result<()> {
        let (n, wanted) = match (found, &self.answer) {
            (Answer::Closest(a), Answer::Closest(b)) => (a.len(), b.len()),
            (Answer::Any(a), Answer::Any(b)) => (a.len(), b.len()),
            (Answer::All(a, hits), Answer::All(b, _)) => {
                let in_order = a.windows(2).all(|w| w[0] <= w[1]) && a.first() == Some(&0);
                if !in_order || a.last() != Some(&(hits.len() as u64)) {
                    return Err("wrong answer: offsets do not ascend from 0 to the number of hits".into());
                }
                (a.len(), b.len())
            }
            _ => return Err("wrong answer: to another question".into()),
        };
        if n == wanted { Ok(()) } else { Err(format!("wrong answer: {n} rows, expected {wanted}").into()) }
    }

    /// Whether the device's answer to ray `i` is another one than the CPU's, but right within rounding.
    fn judge(&self, found: &Answer, i: usize) -> Result<bool> {
        let ray = &self.rays[i];
        match (found, &self.answer) {
            (Answer::Closest(found), Answer::Closest(right)) => self.judge_closest(i, &found[i], &right[i]),
            (Answer::Any(found), Answer::Any(right)) => {
                if found[i] == right[i] {
                    return Ok(false);
                }
                let excused = match found[i] {
                    0 => self.bvh.all_hits_of(ray)?.iter().all(|hit| self.in_doubt(ray, hit.triangle)),
                    1 => (0..self.triangles.len() as u32).any(|triangle| self.in_doubt(ray, triangle)),
                    _ => false,
                };
                if excused { Ok(true) } else { Err(wrong(i, &format!("state {}, expected {}", found[i], right[i]))) }
            }
            _ => self.judge_all(i, &self.row(found, i), &self.row(&self.answer, i)),
        }
    }

    fn judge_closest(&self, i: usize, found: &HitRecord, right: &HitRecord) -> Result<bool> {
        let ray = &self.rays[i];
        let fail = || Err(wrong(i, &format!("{found:?}, expected {right:?}")));
        if found.triangle == right.triangle {
            let agrees = !found.is_hit() || self.t_agrees(ray, found, f64::from(right.t));
            return if agrees { Ok(false) } else { fail() };
        }
        if found.triangle == HitRecord::INVALID || found.is_hit() && found.triangle as usize >= self.triangles.len() {
            return fail();
        }
        let all = self.bvh.all_hits_of(ray)?;
        if found.is_hit() {
            let is_real = match all.iter().find(|hit| hit.triangle == found.triangle) {
                Some(hit) => self.t_agrees(ray, found, f64::from(hit.t)),
                None => self.in_doubt(ray, found.triangle),
            };
            if !is_real {
                return fail();
            }
        }
        // What comes before must be in doubt.
        let before = |t: f32| !found.is_hit() || t < found.t && !self.t_agrees(ray, found, f64::from(t));
        let excused = all.iter().filter(|hit| before(hit.t)).all(|hit| self.in_doubt(ray, hit.triangle));
        if excused { Ok(true) } else { fail() }
    }

    fn judge_all(&self, i: usize, found: &[HitRecord], right: &[HitRecord]) -> Result<bool> {
        let ray = &self.rays[i];
        let fail = |why: &str| Err(wrong(i, &format!("{why}: {found:?}, expected {right:?}")));
        if found.windows(2).any(|w| w[0].t > w[1].t || w[0].triangle == w[1].triangle) {
            return fail("not in order");
        }
        if found.iter().any(|hit| hit.triangle as usize >= self.triangles.len()) {
            return fail("no such triangle");
        }
        let mut differs = false;
        for hit in found {
            match right.iter().find(|r| r.triangle == hit.triangle) {
                Some(r) if self.t_agrees(ray, hit, f64::from(r.t)) => {}
                None if self.in_doubt(ray, hit.triangle) => differs = true,
                _ => return fail("a wrong hit"),
            }
        }
        for hit in right {
            if found.iter().all(|f| f.triangle != hit.triangle) {
                if !self.in_doubt(ray, hit.triangle) {
                    return fail("a missing hit");
                }
                differs = true;
            }
        }
        Ok(differs)
    }

    fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles.as_slice()[triangle as usize].callers_corners().map(|corner| corner.as_dvec3())
    }

    /// How far a ray's point may be off sideways.
    fn bound(&self, ray: &Ray) -> f64 {
        let space = self.triangles.space();
        let largest = ray.origin.abs().max(space.min.abs()).max(space.max.abs()).max_element();
        f64::from(space.margin) + f64::from(largest) / f64::from(1 << 22)
    }

    fn t_agrees(&self, ray: &Ray, found: &HitRecord, t: f64) -> bool {
        let [a, b, c] = self.corners(found.triangle);
        let (normal, direction) = ((b - a).cross(c - a), ray.direction.as_dvec3());
        let cosine = (normal.dot(direction) / normal.length()).abs() / direction.length();
        let off = T_SHARE * t.abs() + self.bound(ray) / (cosine * direction.length());
        // NaN, of triangles without an area, is no agreement.
        (f64::from(found.t) - t).abs() <= off
    }

    /// Whether the ray passes the outline of the triangle within the bound, or the triangle an end of the ray.
    fn in_doubt(&self, ray: &Ray, triangle: u32) -> bool {
        let bound = self.bound(ray);
        let corners = self.corners(triangle);
        let (origin, length) = (ray.origin.as_dvec3(), ray.direction.as_dvec3().length());
        let z = ray.direction.as_dvec3() / length;
        let (x, y) = z.any_orthonormal_pair();
        let local = corners.map(|corner| corner - origin);
        let flat = local.map(|corner| (corner.dot(x), corner.dot(y)));
        let nearest = (0..3).map(|i| to_segment(flat[i], flat[(i + 1) % 3])).fold(f64::INFINITY, f64::min);
        if nearest <= bound {
            return true;
        }
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let t = normal.dot(local[0]) / normal.dot(z) / length;
        let off = T_SHARE * t.abs() + bound * normal.length() / (normal.dot(z).abs() * length);
        let is_inside = {
            let side = |i: usize| flat[i].0 * flat[(i + 1) % 3].1 - flat[i].1 * flat[(i + 1) % 3].0;
            let sides = [side(0), side(1), side(2)];
            sides.iter().all(|&s| s >= 0.0) || sides.iter().all(|&s| s <= 0.0)
        };
        is_inside && [ray.t_min, ray.t_max].iter().any(|&end| (f64::from(end) - t).abs() <= off)
    }
}

/// Distance from the origin to a segment of the plane.
fn to_segment(a: (f64, f64), b: (f64, f64)) -> f64 {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let length2 = dx * dx + dy * dy;
    let share = if length2 > 0.0 { (-(a.0 * dx + a.1 * dy) / length2).clamp(0.0, 1.0) } else { 0.0 };
    (a.0 + share * dx).hypot(a.1 + share * dy)
}

fn wrong(ray: usize, what: &str) -> Error {
    format!("wrong answer: ray {ray} has {what}").into()
}

/// Asks a question of all rays.
///
/// # Errors
/// What the search returns.
pub fn ask(search: &(impl RaySearch + ?Sized), rays: &[Ray], question: Question) -> Result<Answer> {
    Ok(match question {
        Question::Closest => Answer::Closest(search.closest_hits(rays)?.records().to_vec()),
        Question::Any => Answer::Any(search.any_hits(rays)?.as_slice().to_vec()),
        Question::All => {
            let lists = search.all_hits(rays)?;
            Answer::All(lists.offsets().to_vec(), lists.records().to_vec())
        }
    })
}
