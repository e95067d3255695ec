//! The experiments on rays at a small scale: every structure, set of rays and column is there, plots are drawn, and a
//! wrong answer stops a measurement, on the CPU by its bits and on a device beyond rounding.

use std::collections::BTreeSet;
use std::fs;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;

use libtest_mimic::{Arguments, Trial};
use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::geometry::{LocalHit, PreparedRay};
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield::structure::{BuildStage, CountRayWork, HitVisitor, PreparedTriangles, RayStructure};
use nearfield::{Aabb, BruteForceMesh, HitRecord, Ray, RaySearch, Vec3};
use nearfield_bench::measure::Effort;
use nearfield_bench::provenance::COMMIT;
use nearfield_bench::rays::check::{Answer, Expected, ask};
use nearfield_bench::rays::counts::{check_box, check_brute, check_tree};
use nearfield_bench::rays::meshes::Source;
use nearfield_bench::rays::method::{self, Method, Search};
use nearfield_bench::rays::paths::check_picture;
use nearfield_bench::rays::rows::COLUMNS;
use nearfield_bench::rays::shots::{self, Question};
use nearfield_bench::rays::{self, Part};

#[path = "../../nearfield/tests/support/mod.rs"]
mod support;
use support::{gpu_trial, trial};

const SCALE: f64 = 0.002;
const QUESTIONS: [Question; 3] = [Question::Closest, Question::Any, Question::All];

fn main() {
    let tests: Vec<Trial> = vec![
        gpu_trial("the experiments have every structure on both devices", |gpu| {
            experiments_are_complete(DeviceChoice::Name(gpu.name().to_owned()), Some(gpu));
        }),
        trial("without a GPU the experiments have the structures of the CPU", || {
            experiments_are_complete(DeviceChoice::Cpu, None);
        }),
        trial("a spent budget leaves rows out and says so", a_spent_budget_is_said),
        trial("a planted wrong number of tests is found", planted_counts_are_found),
        trial("three corners of quads are every second triangle", three_corners_of_quads),
        trial("a structure that loses hits is stopped", a_structure_that_loses_hits_is_stopped),
        trial("a planted wrong answer is found", planted_answers_are_found),
        trial("a planted wrong picture is found", planted_pictures_are_found),
        trial("settings that mean nothing are refused", bad_settings_are_refused),
    ];
    libtest_mimic::run(&Arguments::from_args(), tests).exit();
}

/// A folder of this process that is removed in the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("nearfield-bench-rays-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).expect("a temporary folder");
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn arguments(device: DeviceChoice, folder: &Folder) -> rays::Arguments {
    rays::Arguments {
        device,
        scale: SCALE,
        // A budget that leaves nothing out.
        budget: 1e6,
        data: None,
        parts: vec![Part::Counts, Part::Triangles, Part::Shares, Part::Speed, Part::Paths],
        repeat: Some(1),
        full: false,
        embree: None,
        output: folder.0.clone(),
    }
}

/// The records of rays.csv, each value by its column.
fn records(folder: &Folder) -> Vec<csv::StringRecord> {
    let mut reader = csv::Reader::from_path(folder.0.join("rays.csv")).expect("rays.csv");
    assert_eq!(reader.headers().expect("a header").iter().collect::<Vec<_>>(), COLUMNS);
    reader.records().map(|record| record.expect("a record")).collect()
}

fn column(name: &str) -> usize {
    COLUMNS.iter().position(|c| *c == name).expect(name)
}

fn number(record: &csv::StringRecord, name: &str) -> f64 {
    record[column(name)].parse().unwrap_or_else(|_| panic!("{name} should be a number: {record:?}"))
}

fn experiments_are_complete(device: DeviceChoice, gpu: Option<&Gpu>) {
    let folder = Folder::new(if gpu.is_some() { "gpu" } else { "cpu" });
    rays::run(&arguments(device, &folder)).expect("the experiments run");
    let records = records(&folder);
    let of_part = |part: &str| records.iter().filter(move |r| &r[0] == part).collect::<Vec<_>>();
    let methods: Vec<Method> = Method::ALL.into_iter().filter(|m| gpu.is_some() || !m.on_gpu()).collect();

    let triangles = of_part("triangles");
    let sizes: BTreeSet<&str> = triangles.iter().map(|r| &r[column("triangles")]).collect();
    assert!(sizes.len() >= 3, "{sizes:?}");
    assert_eq!(triangles.len(), 5 * methods.len());
    for method in &methods {
        let rows: Vec<_> = triangles.iter().filter(|r| &r[column("structure")] == method.name()).collect();
        assert_eq!(rows.len(), 5, "{method:?}");
        for row in rows {
            assert!(number(row, "mrays_per_s") > 0.0 && number(row, "cast_host_ms") > 0.0, "{row:?}");
            assert!(number(row, "build_ms") > 0.0 && number(row, "rays_against_brute_force") >= 16.0, "{row:?}");
            let (mean, most) = (number(row, "mean_tests"), number(row, "max_tests"));
            let n = number(row, "triangles");
            assert!(mean <= most && most <= n, "{row:?}");
            assert_eq!(method.is_brute(), mean == n, "{row:?}");
            assert_eq!(method.on_gpu(), !row[column("upload_ms")].is_empty(), "{row:?}");
            assert_eq!(method.on_gpu(), !row[column("round_trip_ms")].is_empty(), "{row:?}");
            let has_clock = gpu.is_some_and(|gpu| gpu.limits().timestamp_period.is_some());
            assert_eq!(method.on_gpu() && has_clock, !row[column("cast_device_ms")].is_empty(), "{row:?}");
            assert_eq!(&row[column("commit")], COMMIT);
            assert!(row[column("accel_ms")].is_empty(), "Accel's figures are for its own meshes and rays: {row:?}");
        }
    }

    let counts = of_part("counts");
    assert_eq!(counts.len(), 2 * 6 * if gpu.is_some() { 2 } else { 1 });
    let corners = counts.iter().filter(|r| r[column("mesh")].ends_with("three corners of each quad")).count();
    assert_eq!(2 * corners, counts.len());
    for row in &counts {
        let (mean, most, n) = (number(row, "mean_tests"), number(row, "max_tests"), number(row, "triangles"));
        let name = &row[column("structure")];
        assert_eq!(name.ends_with("brute force"), mean == n, "{row:?}");
        // A tree with leaves of 2000 is one leaf here, entered where its box is hit.
        assert!(most <= n && (most == n || !name.contains("brute force")), "{row:?}");
        assert_eq!(name.contains("bounding box"), row[column("note")].contains("pixels that meet the box"), "{row:?}");
        assert_eq!(row[column("rays")], row[column("rays_cast")], "{row:?}");
        assert!(row[column("accel_max_tests")].is_empty(), "Accel's numbers are for its own mesh: {row:?}");
    }

    let how: BTreeSet<&str> = of_part("shares").iter().map(|r| &r[column("how")]).collect();
    for wanted in ["spatial median, leaves of 20", "spatial median, leaves of 2000", "binned SAH"] {
        assert!(how.contains(wanted), "{how:?}");
    }

    let found: BTreeSet<(&str, &str)> =
        of_part("speed").iter().map(|r| (&r[column("shots")], &r[column("structure")])).collect();
    let mut expected = BTreeSet::new();
    for set in ["primary", "diffuse bounces", "shadow rays (any)", "all hits"] {
        let on_cpu = ["CPU kd-tree, ropes", "CPU kd-tree, ropes, one thread", "CPU BVH", "CPU BVH, one thread"];
        expected.extend(on_cpu.map(|name| (set, name)));
        if gpu.is_some() {
            expected.extend(["GPU kd-tree, ropes", "GPU BVH"].map(|name| (set, name)));
        }
    }
    assert_eq!(found, expected);
    assert!(of_part("speed").iter().all(|r| number(r, "mrays_per_s") > 0.0));
    assert_eq!(of_part("build").len(), 2);

    let paths = of_part("paths");
    assert_eq!(paths.len(), methods.len() - 1, "all structures but the walk with a stack");
    for row in paths {
        assert!(row[column("note")].starts_with("1 iterations of 36 × 36 in "), "{row:?}");
    }

    let side = ["triangles.svg", "shares-cpu.svg"];
    for plot in side.into_iter().chain(gpu.map(|_| "shares-gpu.svg")) {
        let svg = fs::read_to_string(folder.0.join(plot)).expect(plot);
        assert!(svg.contains(COMMIT), "{plot} names the commit");
    }
    let svg = fs::read_to_string(folder.0.join("triangles.svg")).expect("triangles.svg");
    assert!(methods.iter().all(|m| svg.contains(m.name())) && svg.contains("CPU kd-tree, stack, Accel"));
}

fn a_spent_budget_is_said() {
    let folder = Folder::new("budget");
    let mut arguments = arguments(DeviceChoice::Cpu, &folder);
    arguments.budget = 1e-6;
    arguments.parts = vec![Part::Triangles];
    rays::run(&arguments).expect("a spent budget is no error");
    let records = records(&folder);
    assert_eq!(records.len(), 5 * 4);
    for record in &records {
        assert!(record[column("note")].starts_with("left out: "), "{record:?}");
        assert!(record[column("mrays_per_s")].is_empty(), "{record:?}");
    }
}

fn planted_counts_are_found() {
    check_brute(&[12; 9], 12).expect("all of them");
    assert!(check_brute(&[12, 12, 11], 12).unwrap_err().to_string().contains("ray 2"));
    let bounds = Aabb::new(Vec3::ZERO, Vec3::ONE);
    let down = |x: f32| Ray::new(Vec3::new(x, 0.5, 5.0), Vec3::new(0.0, 0.0, -2.0));
    let behind = Ray::new(Vec3::new(0.5, 0.5, -5.0), Vec3::new(0.0, 0.0, -1.0));
    let rays = [down(0.5), down(1.5), down(1.000_01), behind];
    for right in [[12, 0, 12, 0], [12, 0, 0, 0]] {
        check_box(&rays, &right, &bounds, 12).expect("the box only");
    }
    for (wrong, ray) in
        [([0, 0, 0, 0], 0), ([11, 0, 0, 0], 0), ([12, 12, 0, 0], 1), ([12, 0, 5, 0], 2), ([12, 0, 0, 12], 3)]
    {
        let error = check_box(&rays, &wrong, &bounds, 12).unwrap_err().to_string();
        assert!(error.contains(&format!("wrong answer: ray {ray} ")), "{error}");
    }
    check_tree(1666, 1666).and(check_tree(900, 1666)).and(check_tree(3300, 1666)).expect("of the same order");
    assert!(check_tree(800, 1666).is_err() && check_tree(3400, 1666).is_err());
}

fn three_corners_of_quads() {
    let folder = Folder::new("corners");
    let file = |text: &str| fs::write(folder.0.join("accel-bunny-b.obj"), text).expect("a file");
    file("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nf 1 2 3 4\nf 1 2 6 5\n");
    let source = Source::new(Some(&folder.0), 1.0);
    let whole = source.mesh(("accel-bunny-b.obj", 59_616)).expect("a mesh").mesh;
    let three = source.three_corners().expect("a mesh");
    assert_eq!(three.mesh.triangles, [[0, 1, 2], [0, 1, 5]]);
    assert!(whole.triangles.iter().step_by(2).eq(&three.mesh.triangles), "the first half of each quad");
    assert_eq!(three.name, "accel-bunny-b, three corners of each quad");
    file("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nf 1 2 3\n");
    assert!(source.three_corners().unwrap_err().to_string().contains("not all faces are quads"));
    let made = Source::new(Some(&folder.0), 0.01);
    let half = made.three_corners().expect("a mesh").mesh.triangles.len();
    assert_eq!(2 * half, made.mesh(("accel-bunny-b.obj", 59_616)).expect("a mesh").mesh.triangles.len());
}

fn bad_settings_are_refused() {
    let folder = Folder::new("settings");
    for (scale, budget) in [(0.0, 1.0), (f64::NAN, 1.0), (1.0, -1.0)] {
        let arguments = rays::Arguments { scale, budget, ..arguments(DeviceChoice::Cpu, &folder) };
        let error = rays::run(&arguments).unwrap_err().to_string();
        assert!(error.contains("expected a number above 0"), "{error}");
    }
}

fn planted_pictures_are_found() {
    let right: Vec<Vec3> = (0..200).map(|i| Vec3::splat(i as f32)).collect();
    let with = |n: usize| right.iter().enumerate().map(|(i, &v)| if i < n { v + 1.0 } else { v }).collect::<Vec<_>>();
    for (found, cpu, gpu) in [(with(0), true, true), (with(1), false, true), (with(5), false, false)] {
        assert_eq!(check_picture(&found, &right, false).is_ok(), cpu);
        assert_eq!(check_picture(&found, &right, true).is_ok(), gpu);
    }
    let black = vec![Vec3::ZERO; 200];
    assert!(check_picture(&black, &black, true).is_err(), "a black picture");
    assert!(check_picture(&right[1..], &right, true).is_err(), "a pixel too few");
}

/// Brute force that does not test the last third of the triangles.
struct Forgetful(BruteForceMesh);

/// Hands over the hits of some triangles alone.
struct Known<'a, V>(&'a mut V, u32);

impl<V: HitVisitor> HitVisitor for Known<'_, V> {
    fn limit(&self) -> f32 {
        self.0.limit()
    }

    fn offer(&mut self, hit: &LocalHit, leave: f32) -> ControlFlow<()> {
        if hit.triangle < self.1 { self.0.offer(hit, leave) } else { ControlFlow::Continue(()) }
    }
}

impl RayStructure for Forgetful {
    const NAME: &'static str = "forgetful";

    fn search(&self) -> &'static str {
        "some-triangles"
    }

    fn triangles(&self) -> &Arc<PreparedTriangles> {
        self.0.triangles()
    }

    fn walk<V: HitVisitor, W: CountRayWork>(&self, ray: &PreparedRay, visitor: &mut V, work: &mut W) {
        let known = self.triangles().len() as u32 * 2 / 3;
        self.0.walk(ray, &mut Known(visitor, known), work);
    }

    fn build_stages(&self) -> &[BuildStage] {
        RayStructure::build_stages(&self.0)
    }

    fn memory_bytes(&self) -> u64 {
        RayStructure::memory_bytes(&self.0)
    }
}

fn torus() -> (Arc<PreparedTriangles>, Vec<Ray>) {
    let mesh = mesh(MeshKind::Torus, 400, 0);
    (PreparedTriangles::new(&mesh).expect("a mesh"), shots::primary(&mesh, 40))
}

fn a_structure_that_loses_hits_is_stopped() {
    let (triangles, rays) = torus();
    let effort = Effort { warm_up: 0.0, runs: 1, seconds: 1.0 };
    for question in QUESTIONS {
        let expected = Expected::of(&triangles, &rays, question).expect("brute force and hierarchy agree");
        let right = Search::Cpu(Box::new(BruteForceMesh::of(triangles.clone())));
        method::cast(&right, &rays, question, &expected, effort).expect("brute force is right");
        let wrong = Search::Cpu(Box::new(Forgetful(BruteForceMesh::of(triangles.clone()))));
        let error = method::cast(&wrong, &rays, question, &expected, effort).expect_err("hits are missing");
        assert!(error.to_string().starts_with("wrong answer: ray "), "{error}");
    }
}

fn planted_answers_are_found() {
    let (triangles, rays) = torus();
    let brute = BruteForceMesh::of(triangles.clone());
    let expected = |question| Expected::of(&triangles, &rays, question).expect("a reference");
    let (closest, any, all) = (expected(Question::Closest), expected(Question::Any), expected(Question::All));
    for (question, expected) in QUESTIONS.into_iter().zip([&closest, &any, &all]) {
        let answer = ask(&brute, &rays, question).expect("an answer");
        expected.check_exactly(&answer).expect("the right answer");
        assert_eq!(expected.check_rounded(&answer).expect("the right answer"), 0);
    }
    let refused = |expected: &Expected, what: &str, answer: Answer| {
        for error in [expected.check_exactly(&answer).unwrap_err(), expected.check_rounded(&answer).unwrap_err()] {
            assert!(error.to_string().starts_with("wrong answer: "), "{what}: {error}");
        }
    };
    let hits = brute.closest_hits(&rays).expect("hits").records().to_vec();
    // In the middle of a triangle, so that no rounding excuses another answer.
    let inside =
        |hit: &HitRecord| hit.is_hit() && (0.2..0.4).contains(&hit.weights[0]) && (0.2..0.4).contains(&hit.weights[1]);
    let i = hits.iter().position(inside).expect("a ray that hits a triangle in its middle");
    let miss = hits.iter().position(|hit| !hit.is_hit()).expect("a ray that misses");
    let with = |at: usize, record: HitRecord| {
        let mut changed = hits.clone();
        changed[at] = record;
        Answer::Closest(changed)
    };
    refused(&closest, "a lost hit", with(i, HitRecord::miss()));
    refused(&closest, "an invalid ray", with(i, HitRecord::invalid()));
    refused(&closest, "another t", with(i, HitRecord { t: hits[i].t * 1.01, ..hits[i] }));
    refused(&closest, "another triangle", with(i, HitRecord { triangle: (hits[i].triangle + 200) % 400, ..hits[i] }));
    refused(&closest, "no triangle", with(i, HitRecord { triangle: 1 << 20, ..hits[i] }));
    refused(&closest, "a hit of nothing", with(miss, hits[i]));
    refused(&closest, "a ray too few", Answer::Closest(hits[1..].to_vec()));
    refused(&closest, "another question", Answer::Any(vec![0; rays.len()]));
    // A second hit in place of the first.
    let lists = brute.all_hits(&rays).expect("lists");
    let deep = (0..rays.len()).find(|&i| lists.row(i).len() > 1 && inside(&lists.row(i)[0])).expect("two hits");
    refused(&closest, "the second hit", with(deep, lists.row(deep)[1]));

    let states = brute.any_hits(&rays).expect("states").as_slice().to_vec();
    for at in [i, miss] {
        let mut changed = states.clone();
        changed[at] ^= 1;
        refused(&any, "another state", Answer::Any(changed));
    }

    let (offsets, records) = (lists.offsets().to_vec(), lists.records().to_vec());
    let begin = offsets[deep] as usize;
    let mut swapped = records.clone();
    swapped.swap(begin, begin + 1);
    refused(&all, "another order", Answer::All(offsets.clone(), swapped));
    let mut fewer = records.clone();
    fewer.remove(begin);
    let shorter = offsets.iter().enumerate().map(|(i, &o)| o - u64::from(i > deep)).collect();
    refused(&all, "a hit too few", Answer::All(shorter, fewer.clone()));
    refused(&all, "offsets that do not end at the hits", Answer::All(offsets, fewer));
}
