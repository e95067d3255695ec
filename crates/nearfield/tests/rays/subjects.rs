//! Every structure on every device, on every mesh with every kind of ray.

use std::sync::Arc;

use libtest_mimic::Trial;
use nearfield::gpu::{AdapterKind, Gpu};
use nearfield::structure::PreparedTriangles;
use nearfield::{
    BruteForceMesh, BvhSettings, GpuBruteForceMesh, GpuKdTree, GpuTriangleBvh, HitRecord, KdTraversal, KdTree,
    KdTreeSettings, Ray, RaySearch, TriMesh, TriangleBvh,
};

use crate::inside::{is_closed, places_inside};
use crate::meshes::{self, Case};
use crate::rays::{self, KINDS};
use crate::reference::{Tally, compare, truths};
use crate::support::{data_file, gpu_trial, is_long, long_cases, trial};

const SEED: u64 = 20_261_124;
/// Rays of a kind into a mesh.
const RAYS: usize = 500;
/// Different rays of all kinds and meshes with `NEARFIELD_LONG=1` on the CPU, and on devices that are hardware.
const LONG_RAYS: usize = 10_000_000;
/// Rays that are compared at once.
const CHUNK: usize = 8_000;
/// Places inside a closed mesh, and rays from and to them.
const PLACES: usize = 24;

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

/// The largest share of a set's rays that may be in doubt. Sets that are not aimed at anything pass an outline by
/// chance. Half of those along axes go through a vertex. Rays at outlines can all be in doubt, and so can those from
/// surfaces and from planes of vertices, which a cube's faces are: their first hit is at the border of their range.
fn most_in_doubt(case: &Case, kind: &str) -> f64 {
    match kind {
        "along axes" => 0.6,
        "at vertices" | "at edges" | "along edges" | "from surfaces" | "from planes" => 1.0,
        _ => case.most_in_doubt,
    }
}

/// Asks all structures for the closest hits, counts and lists of rays; what the first one's comparison tallies.
fn check_rays(name: &str, case: &Case, rays: &[Ray], searches: &[(&'static str, Search)]) -> Tally {
    let truths = truths(&case.mesh, rays);
    let mut first: Option<(Answers, Tally)> = None;
    for (structure, search) in searches {
        let name = format!("{structure}, {name}");
        let answers = Answers::of(search.as_ref(), rays);
        answers.check_among_themselves(&name);
        let compared = compare(rays, &truths, &answers.closest, &answers.counts);
        let compared = compared.unwrap_or_else(|fault| panic!("{name}: {fault}"));
        match &first {
            Some((expected, _)) => assert_eq!(answers.difference(expected), None, "{name}"),
            None => first = Some((answers, compared)),
        }
    }
    first.expect("there should be a structure").1
}

/// All kinds of rays, `n` of each; `distinct` of all must differ.
fn check(case: &Case, n: usize, distinct: usize, seed: u64, searches: &[(&'static str, Search)]) {
    let (mut all, mut different) = (Tally::default(), 0);
    for (number, kind) in KINDS.iter().enumerate() {
        let rays = rays::rays(&case.mesh, kind, n, seed + number as u64);
        let name = format!("{}, {kind}", case.name);
        let mut tally = Tally::default();
        rays.chunks(CHUNK).for_each(|rays| tally.add(&check_rays(&name, case, rays, searches)));
        let share = tally.in_doubt as f64 / tally.rays as f64;
        eprintln!("{name}: {share:.4} in doubt, {} of {} hits with the wide tolerance", tally.wide, tally.hits);
        if n >= RAYS {
            assert!(share <= most_in_doubt(case, kind), "{name}: {tally:?}");
        }
        all.add(&tally);
        different += rays::distinct(&rays);
    }
    assert!(different >= distinct, "{}: {different} of {} rays differ, expected {distinct}", case.name, all.rays);
    eprintln!("{}: {all:?}, {different} of them different", case.name);
    if case.closed {
        no_ray_is_lost(case, 4 * n, seed, searches);
    }
}

/// From inside and at the inside of a closed mesh, through its vertices, edges and faces.
fn no_ray_is_lost(case: &Case, n: usize, seed: u64, searches: &[(&'static str, Search)]) {
    assert!(is_closed(&case.mesh), "{} should be closed", case.name);
    let places = places_inside(&case.mesh, PLACES, seed);
    assert!(!places.is_empty(), "{}: no place inside was found", case.name);
    let (rays, are_crossing): (Vec<Ray>, Vec<bool>) =
        rays::cannot_miss(&case.mesh, &places, n, seed).into_iter().unzip();
    for (name, search) in searches {
        let hits = search.closest_hits(&rays).unwrap();
        let is_lost = |&i: &usize| !hits.hit(i).is_some_and(|hit| !are_crossing[i] || hit.t <= 1.0);
        let lost = (0..rays.len()).find(is_lost);
        assert_eq!(lost.map(|i| (rays[i], hits.hit(i))), None, "{name}, {}: a ray was lost", case.name);
    }
}

fn check_on_cpu(case: &Case, n: usize, distinct: usize) {
    let triangles = PreparedTriangles::new(&case.mesh).unwrap();
    check(case, n, distinct, SEED, &on_cpu(&triangles));
}

fn check_on_gpu(gpu: &Gpu, case: &Case, n: usize) {
    let triangles = PreparedTriangles::new(&case.mesh).unwrap();
    check(case, n, 0, SEED ^ 0x6770_7500, &on_gpu(gpu, &triangles));
}

/// A mesh of the test data; `None`, counted and printed, where it is not there.
fn scan(file: &str) -> Option<TriMesh> {
    let path = data_file(file)?;
    Some(nearfield::io::read_mesh(&path, None).unwrap())
}

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = Vec::new();
    let cases = meshes::cases();
    // A few more than all must differ by, as some are the same by chance.
    // All but the mesh of points and lines, into which few rays differ, have the same share.
    let distinct = if is_long() { LONG_RAYS.div_ceil(cases.len() - 1) } else { 0 };
    let n = if is_long() { (distinct + distinct / 50).div_ceil(KINDS.len()) } else { RAYS };
    for case in cases {
        let name = case.name.replace(' ', "_");
        let case = Arc::new(case);
        let on_device = Arc::clone(&case);
        let distinct = if case.name == meshes::ONLY_DEGENERATE { 0 } else { distinct };
        trials.push(trial(format!("cpu::{name}"), move || check_on_cpu(&case, n, distinct)));
        trials.push(gpu_trial(format!("gpu::{name}"), move |gpu| {
            let n = if gpu.kind() == AdapterKind::Software { n.min(4 * RAYS) } else { n };
            check_on_gpu(gpu, &on_device, if long_cases(gpu) { n } else { n / 4 });
        }));
    }
    for &(name, file, closed) in meshes::SCANS {
        let missing = data_file(file).is_none();
        let case = move || Case { name: name.to_owned(), mesh: scan(file).unwrap(), closed, most_in_doubt: 1.0 };
        let n = if is_long() { 400 } else { 20 };
        let on_cpu = trial(format!("cpu::{}", name.replace(' ', "_")), move || check_on_cpu(&case(), n, 0));
        trials.push(on_cpu.with_ignored_flag(missing));
        if !missing {
            trials.push(gpu_trial(format!("gpu::{}", name.replace(' ', "_")), move |gpu| {
                check_on_gpu(gpu, &case(), if long_cases(gpu) { n } else { 4 });
            }));
        }
    }
    trials
}
