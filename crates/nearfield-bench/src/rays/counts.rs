//! Accel's heat maps in numbers: how many triangles the ray of each pixel is tested against, over the three corners of
//! each quad that Accel read and over all of its mesh.
//!
//! Brute force must test every triangle for every pixel, and within the bounding box (Accel's second picture) where the ray
//! meets the box and nowhere else, which is computed here in f64. Trees cut in the middle as Accel's must have a largest
//! number within a factor of two of Accel's, which is of another view. A count that breaks this is an error.

use nearfield::gpu::Gpu;
use nearfield::structure::PreparedTriangles;
use nearfield::{
    Aabb, BruteForceMesh, GpuBruteForceMesh, GpuKdTree, HitRecord, KdTree, KdTreeSettings, Ray, RaySearch,
};
use std::sync::Arc;

use super::check::{Answer, Expected};
use super::meshes::Named;
use super::rows::{Row, digits};
use super::shots::{self, Question};
use super::{Lab, method, published};
use crate::Result;

/// Side of Accel's pictures.
const SIDE: usize = 750;
/// Brute force casts every so many-th row of the picture on the CPU, and on a software renderer.
const EVERY: [usize; 2] = [8, 64];
/// Triangle tests of one call of brute force, so that no desktop ends it.
const TESTS: usize = 1 << 31;
/// How far Accel's largest number of tests in a tree and ours may be apart.
const FACTOR: f64 = 2.0;
/// How near the outline of the box a ray may fall to either side, in longest sides of the mesh.
const OUTLINE: f64 = 1e-4;

/// What is walked.
#[derive(Debug, Clone, Copy)]
enum Subject {
    Brute,
    Box,
    Tree(KdTreeSettings),
}

impl Subject {
    /// Accel's three trees and ours, after brute force.
    fn all(ours: KdTreeSettings) -> Vec<Self> {
        let accels = published::ACCEL_TESTS.map(|(leaf, _)| Self::Tree(KdTreeSettings::spatial_median(leaf)));
        [Self::Brute, Self::Box].into_iter().chain(accels).chain([Self::Tree(ours)]).collect()
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Brute => "brute force",
            Self::Box => "brute force within the bounding box",
            Self::Tree(_) => "kd-tree, ropes",
        }
    }

    fn how(self) -> String {
        if let Self::Tree(settings) = self { method::tree_name(&settings) } else { String::new() }
    }

    /// Accel's largest number of tests.
    fn accel(self) -> Option<u32> {
        match self {
            Self::Brute | Self::Box => Some(published::ACCEL_CORNERS as u32),
            Self::Tree(settings) => {
                let is_median = settings.build == nearfield::KdBuild::SpatialMedian;
                let of_leaf = published::ACCEL_TESTS.into_iter().find(|accel| accel.0 == settings.leaf_limit);
                of_leaf.filter(|_| is_median).map(|accel| accel.1)
            }
        }
    }

    fn build(self, triangles: &Arc<PreparedTriangles>, gpu: Option<&Gpu>) -> Result<Box<dyn RaySearch>> {
        let triangles = triangles.clone();
        Ok(match (self, gpu) {
            (Self::Brute, None) => Box::new(BruteForceMesh::of(triangles)),
            (Self::Box, None) => Box::new(BruteForceMesh::of(triangles).within_box()),
            (Self::Tree(settings), None) => Box::new(KdTree::of(triangles, &settings)?),
            (Self::Brute, Some(gpu)) => Box::new(GpuBruteForceMesh::of(gpu, triangles)?),
            (Self::Box, Some(gpu)) => Box::new(GpuBruteForceMesh::of(gpu, triangles)?.within_box()?),
            (Self::Tree(settings), Some(gpu)) => Box::new(GpuKdTree::upload(gpu, &KdTree::of(triangles, &settings)?)?),
        })
    }
}

/// Counts on both meshes by every subject, on the CPU and on the GPU where there is one.
///
/// # Errors
/// What a build or a cast returns; a hit or a number of tests that is wrong.
pub fn measure(lab: &mut Lab) -> Result<()> {
    let corners = lab.source.three_corners()?;
    let whole = lab.source.mesh(super::meshes::ACCEL[super::meshes::ACCEL.len() - 1])?;
    for (named, is_accels) in [(corners, true), (whole, false)] {
        measure_mesh(lab, &named, is_accels)?;
    }
    Ok(())
}

/// The rays of a mesh with what they must hit.
struct Target<'a> {
    rays: &'a [Ray],
    expected: Expected<'a>,
    shots: String,
}

fn measure_mesh(lab: &mut Lab, named: &Named, is_accels: bool) -> Result<()> {
    let triangles = PreparedTriangles::new(&named.mesh)?;
    let side = lab.side(SIDE);
    let rays = shots::primary(&named.mesh, side);
    let parts = EVERY.map(|every| shots::sampled_rows(&rays, side, side.div_ceil(every)));
    let target = |rays, shots: String| -> Result<Target<'_>> {
        Ok(Target { rays, expected: Expected::of(&triangles, rays, Question::Closest)?, shots })
    };
    let rows = |part: &[Ray]| format!("primary, {} of {side} rows", part.len() / side);
    let whole = target(&rays, "primary".to_owned())?;
    let [on_cpu, in_software] = [target(&parts[0], rows(&parts[0]))?, target(&parts[1], rows(&parts[1]))?];
    // Accel's numbers are for its mesh and its size of picture.
    let is_comparable = is_accels && side == SIDE && named.triangles() == published::ACCEL_CORNERS;
    for subject in Subject::all(lab.tree) {
        for on_gpu in [false, true] {
            let Some(gpu) = lab.gpu().cloned().map(Some).or((!on_gpu).then_some(None)) else { continue };
            let gpu = gpu.filter(|_| on_gpu);
            let is_fast = matches!(subject, Subject::Tree(_)) || on_gpu && lab.machine.is_hardware_gpu();
            let target = match (is_fast || lab.full, on_gpu) {
                (true, _) => &whole,
                (false, false) => &on_cpu,
                (false, true) => &in_software,
            };
            let row = Row {
                part: "counts",
                mesh: named.name.clone(),
                triangles: named.triangles(),
                method: format!("{} {}", if on_gpu { "GPU" } else { "CPU" }, subject.name()),
                how: subject.how(),
                device: if on_gpu { lab.machine.name.clone() } else { lab.machine.host.clone() },
                shots: target.shots.clone(),
                rays: target.rays.len(),
                sample: target.expected.sample(),
                accel_tests: subject.accel().filter(|_| is_comparable),
                ..Row::default()
            };
            let row = if lab.left() <= 0.0 {
                Row { note: "left out: the budget is spent".to_owned(), ..row }
            } else {
                counted(subject, &triangles, gpu.as_ref(), target, row)?
            };
            lab.add(row);
        }
    }
    Ok(())
}

/// Casts the rays and checks hits and numbers of tests.
fn counted(
    subject: Subject,
    triangles: &Arc<PreparedTriangles>,
    gpu: Option<&Gpu>,
    target: &Target<'_>,
    row: Row,
) -> Result<Row> {
    let cast = subject.build(triangles, gpu).and_then(|search| cast(search.as_ref(), target.rays, triangles.len()));
    let (records, tests) = match cast {
        Ok(cast) => cast,
        Err(error) => return Ok(Row { note: super::unsupported(error)?, ..row }),
    };
    let answer = Answer::Closest(records);
    if gpu.is_some() {
        target.expected.check_rounded(&answer).map(drop)
    } else {
        target.expected.check_exactly(&answer)
    }?;
    let n = triangles.len();
    let sum: u64 = tests.iter().map(|&count| u64::from(count)).sum();
    let most = tests.iter().copied().max().unwrap_or(0);
    let touched = tests.iter().filter(|&&count| count > 0).count();
    let note = match subject {
        Subject::Brute => {
            check_brute(&tests, n)?;
            format!("{n} for every pixel")
        }
        Subject::Box => {
            let bounds = Aabb::new(triangles.space().min, triangles.space().max);
            check_box(target.rays, &tests, &bounds, n)?;
            format!("{n} for the {touched} pixels that meet the box, 0 for the other {}", tests.len() - touched)
        }
        Subject::Tree(_) => {
            if let Some(accel) = row.accel_tests {
                check_tree(most, accel)?;
            }
            format!("{} on average of the {touched} pixels with any", digits(sum as f64 / touched.max(1) as f64))
        }
    };
    Ok(Row { tests: Some((sum as f64 / tests.len().max(1) as f64, most)), note, ..row })
}

/// First hits and triangles tested `[rays]`, brute force in calls that no desktop ends.
fn cast(search: &dyn RaySearch, rays: &[Ray], triangles: usize) -> Result<(Vec<HitRecord>, Vec<u32>)> {
    let (mut records, mut tests) = (Vec::with_capacity(rays.len()), Vec::with_capacity(rays.len()));
    for part in rays.chunks((TESTS / triangles).max(1024)) {
        let (hits, work) = search.closest_hits_with_work(part)?;
        records.extend_from_slice(hits.records());
        tests.extend(work.iter().map(|work| work.triangle_tests));
    }
    Ok((records, tests))
}

/// Checks that every ray was tested against each of `n` triangles.
///
/// # Errors
/// The first ray that was not.
pub fn check_brute(tests: &[u32], n: usize) -> Result<()> {
    match tests.iter().position(|&count| count as usize != n) {
        Some(ray) => Err(format!("wrong answer: ray {ray} was tested against {}, expected {n}", tests[ray]).into()),
        None => Ok(()),
    }
}

/// Checks that rays that meet the box were tested against each of `n` triangles, and the others against none; those that
/// pass its outline narrowly may be of either kind.
///
/// # Errors
/// The first ray of which that is not true.
pub fn check_box(rays: &[Ray], tests: &[u32], bounds: &Aabb, n: usize) -> Result<()> {
    let off = OUTLINE * f64::from(bounds.extent().max_element());
    for (ray, (cast, &count)) in rays.iter().zip(tests).enumerate() {
        let right = match (meets(cast, bounds, -off), meets(cast, bounds, off)) {
            (true, _) => count as usize == n,
            (false, true) => count as usize == n || count == 0,
            (false, false) => count == 0,
        };
        if !right {
            let expected = "all of them where the ray meets the box, and none elsewhere";
            return Err(
                format!("wrong answer: ray {ray} was tested against {count} of {n}, expected {expected}").into()
            );
        }
    }
    Ok(())
}

/// Whether a ray meets a box that is wider by `off` on every side.
fn meets(ray: &Ray, bounds: &Aabb, off: f64) -> bool {
    let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let (to_min, to_max) =
        ((bounds.min.as_dvec3() - off - origin) / direction, (bounds.max.as_dvec3() + off - origin) / direction);
    to_min.min(to_max).max_element().max(0.0) <= to_min.max(to_max).min_element()
}

/// Checks the largest number of tests in a tree against Accel's.
///
/// # Errors
/// A number of another order.
pub fn check_tree(most: u32, accel: u32) -> Result<()> {
    let ratio = f64::from(most) / f64::from(accel);
    if (1.0 / FACTOR..=FACTOR).contains(&ratio) {
        return Ok(());
    }
    Err(format!("wrong answer: at most {most} tests a ray, more than a factor of {FACTOR} from Accel's {accel}").into())
}
