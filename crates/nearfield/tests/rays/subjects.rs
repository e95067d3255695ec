//! Every structure on every device, on every mesh with every kind of ray.

use std::sync::Arc;

use libtest_mimic::Trial;
use nearfield::gpu::Gpu;
use nearfield::structure::PreparedTriangles;
use nearfield::{
    BruteForceMesh, BvhSettings, GpuBruteForceMesh, GpuKdTree, GpuTriangleBvh, HitRecord, KdTraversal, KdTree,
    KdTreeSettings, Ray, RaySearch, TriMesh, TriangleBvh,
};

use crate::meshes::{self, Case};
use crate::rays::{self, KINDS};
use crate::reference::{Tally, compare, truths};
use crate::support::{data_file, gpu_trial, is_long, long_cases, trial};

const SEED: u64 = 20_261_124;
/// Rays of a kind into a mesh.
const RAYS: usize = 500;
/// The same with `NEARFIELD_LONG=1`: 10⁷ in all over the subjects.
const LONG_RAYS: usize = 8_000;

type Search = Box<dyn RaySearch>;

/// The structures on the CPU; the first is what the others must equal to the bit.
fn on_cpu(triangles: &Arc<PreparedTriangles>) -> Vec<(&'static str, Search)> {
    let tree = KdTree::of(triangles.clone(), &KdTreeSettings::default()).unwrap();
    let kd_tree = |traversal| -> Search { Box::new(tree.clone().with_traversal(traversal)) };
    vec![
        ("brute-force", Box::new(BruteForceMesh::of(triangles.clone()))),
        ("bounding-box", Box::new(BruteForceMesh::of(triangles.clone()).within_box())),
        ("kd-tree, stack", kd_tree(KdTraversal::Stack)),
        ("kd-tree, ropes", kd_tree(KdTraversal::Ropes)),
        ("triangle-bvh", Box::new(TriangleBvh::of(triangles.clone(), &BvhSettings::default()).unwrap())),
    ]
}

/// The same on the device.
fn on_gpu(gpu: &Gpu, triangles: &Arc<PreparedTriangles>) -> Vec<(&'static str, Search)> {
    let brute = || GpuBruteForceMesh::of(gpu, triangles.clone()).unwrap();
    let tree = KdTree::of(triangles.clone(), &KdTreeSettings::default()).unwrap();
    let bvh = TriangleBvh::of(triangles.clone(), &BvhSettings::default()).unwrap();
    vec![
        ("brute-force", Box::new(brute())),
        ("bounding-box", Box::new(brute().within_box().unwrap())),
        ("kd-tree", Box::new(GpuKdTree::upload(gpu, &tree).unwrap())),
        ("triangle-bvh", Box::new(GpuTriangleBvh::upload(gpu, &bvh).unwrap())),
    ]
}

/// Everything that is asked of rays: they must be the same whatever the structure.
#[derive(Debug, PartialEq)]
struct Answers {
    closest: Vec<HitRecord>,
    any: Vec<u32>,
    counts: Vec<u32>,
    all: (Vec<u64>, Vec<HitRecord>),
}

impl Answers {
    fn of(search: &dyn RaySearch, rays: &[Ray]) -> Self {
        let all = search.all_hits(rays).unwrap();
        Self {
            closest: search.closest_hits(rays).unwrap().records().to_vec(),
            any: search.any_hits(rays).unwrap().as_slice().to_vec(),
            counts: search.count_hits(rays).unwrap().as_slice().to_vec(),
            all: (all.offsets().to_vec(), all.records().to_vec()),
        }
    }

    /// Whether the four answers agree with each other.
    fn check_among_themselves(&self, name: &str) {
        for (i, closest) in self.closest.iter().enumerate() {
            let row = &self.all.1[self.all.0[i] as usize..self.all.0[i + 1] as usize];
            assert_eq!(row.len(), self.counts[i] as usize, "{name}, ray {i}: the list and the count");
            assert_eq!(self.any[i] == 1, closest.is_hit(), "{name}, ray {i}: any and closest");
            assert_eq!(
                row.first().map(|hit| hit.t),
                closest.is_hit().then_some(closest.t),
                "{name}, ray {i}: the first"
            );
            let ascending = row.windows(2).all(|w| (w[0].t, w[0].triangle) < (w[1].t, w[1].triangle));
            assert!(ascending, "{name}, ray {i}: {row:?} should ascend, each triangle once");
        }
    }

    /// The first difference from what another structure answers.
    fn difference(&self, other: &Self) -> Option<String> {
        let at = |i: usize| format!("ray {i}: {:?} and {:?}", self.closest[i], other.closest[i]);
        if let Some(i) = (0..self.closest.len()).find(|&i| self.closest[i] != other.closest[i]) {
            return Some(format!("closest, {}", at(i)));
        }
        if let Some(i) = (0..self.counts.len()).find(|&i| self.counts[i] != other.counts[i]) {
            return Some(format!("count, {}: {} and {}", at(i), self.counts[i], other.counts[i]));
        }
        (self != other).then(|| "any or all differ".to_owned())
    }
}

fn check(case: &Case, n: usize, searches: &[(&'static str, Search)]) {
    let mut tally = Tally::default();
    for (number, kind) in KINDS.iter().enumerate() {
        let rays = rays::rays(&case.mesh, kind, n, SEED + number as u64);
        let truths = truths(&case.mesh, &rays);
        let mut first: Option<Answers> = None;
        for (name, search) in searches {
            let name = format!("{name}, {}, {kind}", case.name);
            let answers = Answers::of(search.as_ref(), &rays);
            answers.check_among_themselves(&name);
            let compared = compare(&rays, &truths, &answers.closest, &answers.counts);
            let compared = compared.unwrap_or_else(|fault| panic!("{name}: {fault}"));
            if let Some(expected) = &first {
                assert_eq!(answers.difference(expected), None, "{name}");
                continue;
            }
            tally.rays += compared.rays;
            tally.in_doubt += compared.in_doubt;
            if *kind == "random" && case.mesh.triangles.len() > 50 {
                assert!(compared.in_doubt * 20 <= compared.rays, "{name}: {compared:?} in doubt");
            }
            first = Some(answers);
        }
    }
    eprintln!("{}: {} rays, {} of them near an outline", case.name, tally.rays, tally.in_doubt);
    if case.closed {
        let rays = rays::from_inside(&case.mesh, 4 * n, SEED);
        for (name, search) in searches {
            let hits = search.closest_hits(&rays).unwrap();
            let lost = (0..rays.len()).find(|&i| hits.hit(i).is_none());
            assert_eq!(lost.map(|i| rays[i]), None, "{name}, {}: a ray was lost", case.name);
        }
    }
}

fn check_on_cpu(case: &Case, n: usize) {
    let triangles = PreparedTriangles::new(&case.mesh).unwrap();
    check(case, n, &on_cpu(&triangles));
}

fn check_on_gpu(gpu: &Gpu, case: &Case, n: usize) {
    let triangles = PreparedTriangles::new(&case.mesh).unwrap();
    check(case, n, &on_gpu(gpu, &triangles));
}

/// A mesh of the test data; `None`, counted and printed, where it is not there.
fn scan(file: &str) -> Option<TriMesh> {
    let path = data_file(file)?;
    Some(nearfield::io::read_mesh(&path, None).unwrap())
}

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = Vec::new();
    let n = if is_long() { LONG_RAYS } else { RAYS };
    for case in meshes::cases() {
        let name = case.name.replace(' ', "_");
        let (case, again) = (Arc::new(case), n);
        let on_device = Arc::clone(&case);
        trials.push(trial(format!("cpu::{name}"), move || check_on_cpu(&case, again)));
        trials.push(gpu_trial(format!("gpu::{name}"), move |gpu| {
            check_on_gpu(gpu, &on_device, if long_cases(gpu) { again } else { again / 4 });
        }));
    }
    for &(name, file) in meshes::SCANS {
        let missing = data_file(file).is_none();
        let case = move || Case { name: name.to_owned(), mesh: scan(file).unwrap(), closed: false };
        let n = if is_long() { 400 } else { 20 };
        let on_cpu = trial(format!("cpu::{}", name.replace(' ', "_")), move || check_on_cpu(&case(), n));
        trials.push(on_cpu.with_ignored_flag(missing));
        if !missing {
            trials.push(gpu_trial(format!("gpu::{}", name.replace(' ', "_")), move |gpu| {
                check_on_gpu(gpu, &case(), if long_cases(gpu) { n } else { 4 });
            }));
        }
    }
    trials
}
