//! The experiments on simulations at a small scale: every search, column and value of the papers is there, plots are drawn, rows without
//! time say so, and planted wrong answers are found.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;

use libtest_mimic::{Arguments, Trial};
use nearfield::DVec3;
use nearfield::application::particles::{
    BuiltinOptions, Measures, PairRule, ParticleModel, ParticleScene, ParticleSearch, Particles, builtin_scene,
};
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield_bench::paper::lab::Lab;
use nearfield_bench::paper::rows::COLUMNS;
use nearfield_bench::particles::check::{Reference, close, same, sane};
use nearfield_bench::particles::figure_20::mean_neighbors;
use nearfield_bench::particles::green::bytes_a_step;
use nearfield_bench::particles::timing::Timed;
use nearfield_bench::particles::ways::{AT_R_MIN, Way, searches};
use nearfield_bench::particles::{self, case, conservation};
use nearfield_bench::provenance::COMMIT;

#[path = "../../nearfield/tests/support/mod.rs"]
mod support;
use support::{gpu_trial, trial};

const SCALE: f64 = 0.002;
const SEARCHES: [&str; 7] =
    ["coherent", "primary", "aabb-tree", "uniform-grid", "multi-level-grid", "verlet", "brute-force"];

fn main() {
    let tests: Vec<Trial> = vec![
        gpu_trial("simulations are measured by every search on both devices", |gpu| {
            experiments_are_complete(DeviceChoice::Name(gpu.name().to_owned()), Some(gpu));
        }),
        trial("without a GPU simulations are measured by every search of the CPU", || {
            experiments_are_complete(DeviceChoice::Cpu, None);
        }),
        trial("a spent budget leaves rows without values and no error", spent_budget),
        trial("settings that mean nothing are refused", bad_settings),
        trial("a planted particle elsewhere is found", planted_particles),
        trial("planted energies, centres and neighbours are found", planted_measures),
        trial("a reference of another scene is no reference", planted_reference),
        trial("mean neighbours of classes are those of a loop", neighbors_by_class),
        trial("cells of the smallest radius are as large as its reach", cells_at_r_min),
        trial("bytes of a step are those that are written down", bytes_of_a_step),
        trial("two clouds start apart from walls with momenta that cancel but for the spin", clouds),
    ];
    libtest_mimic::run(&Arguments::from_args(), tests).exit();
}

/// A folder of this process that is removed in the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("nearfield-bench-particles-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).expect("a temporary folder");
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn arguments(device: DeviceChoice, folder: &Folder, budget: f64) -> particles::Arguments {
    particles::Arguments { device, scale: SCALE, only: Vec::new(), budget, output: folder.0.clone() }
}

type Row = BTreeMap<String, String>;

fn rows(folder: &Folder, experiment: &str) -> Vec<Row> {
    let mut reader = csv::Reader::from_path(folder.0.join(format!("{experiment}.csv"))).expect(experiment);
    let header: Vec<String> = reader.headers().expect(experiment).iter().map(str::to_owned).collect();
    assert_eq!(header, COLUMNS, "{experiment}");
    let rows: Vec<Row> = reader
        .records()
        .map(|record| header.iter().cloned().zip(record.expect(experiment).iter().map(str::to_owned)).collect())
        .collect();
    assert!(!rows.is_empty(), "{experiment}");
    for row in &rows {
        assert_eq!((&*row["experiment"], &*row["commit"]), (experiment, COMMIT), "{row:?}");
        assert!(!row["method"].is_empty() && !row["quantity"].is_empty() && !row["device"].is_empty(), "{row:?}");
        if row["value"].is_empty() {
            assert!(row["note"].starts_with("missing: "), "{row:?}");
            continue;
        }
        assert!(number(row, "value").is_finite() && number(row, "mean_neighbors") >= 0.0, "{row:?}");
        assert!(number(row, "runs") >= 1.0 && !row["note"].is_empty(), "{row:?}");
    }
    rows
}

fn number(row: &Row, column: &str) -> f64 {
    row[column].parse().unwrap_or_else(|_| panic!("{column} should be a number: {row:?}"))
}

/// The methods that have a value of a quantity.
fn measured<'a>(rows: &'a [Row], quantity: &str) -> BTreeSet<&'a str> {
    let rows = rows.iter().filter(|row| row["quantity"] == quantity && !row["value"].is_empty());
    rows.map(|row| &*row["method"]).collect()
}

fn experiments_are_complete(device: DeviceChoice, gpu: Option<&Gpu>) {
    let folder = Folder::new(if gpu.is_some() { "gpu" } else { "cpu" });
    // A budget that leaves nothing out, and ends each run after a few of its steps.
    particles::run(&arguments(device, &folder, 1e4)).expect("the experiments run");
    let devices: &[&str] = if gpu.is_some() { &["GPU", "CPU"] } else { &["CPU"] };
    let of_all = |names: &[&str]| -> BTreeSet<String> {
        devices.iter().flat_map(|device| names.iter().map(move |name| format!("{name}, {device}"))).collect()
    };
    let is = |found: BTreeSet<&str>, expected: BTreeSet<String>| {
        assert_eq!(found, expected.iter().map(String::as_str).collect::<BTreeSet<_>>());
    };

    let figure_18 = rows(&folder, "figure-18");
    let mut expected = of_all(&SEARCHES);
    expected.extend(gpu.map(|_| "shifted sort, GPU".to_owned()));
    is(measured(&figure_18, "steps a second"), expected);
    let paper = |row: &&Row| row["method"].starts_with("coherent") && row["quantity"] == "steps a second";
    assert_eq!(number(figure_18.iter().find(paper).expect("a row"), "paper_value"), 13.84, "of 250 k grains");
    for row in figure_18.iter().filter(|row| row["unit"] == "steps/s" && !row["value"].is_empty()) {
        assert!(row["method"].starts_with("shifted") || row["note"].contains("to the bit"), "{row:?}");
        assert!(number(row, "mean_neighbors") > 0.1, "grains of a bed touch: {row:?}");
    }
    let gains = measured(&figure_18, "gain of the coherent search");
    assert!(gains.contains("uniform-grid, CPU") && !gains.contains("coherent, CPU"), "{gains:?}");

    let figure_19 = rows(&folder, "figure-19");
    is(measured(&figure_19, "a step, median"), of_all(&["coherent", "uniform-grid", "verlet"]));
    is(measured(&figure_19, "rebuilds"), of_all(&["coherent", "verlet"]));
    let steps = fs::read_to_string(folder.0.join("figure-19-steps.csv")).expect("the file of all steps");
    let moments = if gpu.is_some() { 8 } else { 0 };
    assert_eq!(steps.lines().count(), 1 + 3 * devices.len() * 10 + moments, "a header, and ten steps of each");
    let column = |name: &str| steps.lines().next().and_then(|head| head.split(',').position(|column| column == name));
    let (step, search) = (column("milliseconds").expect("a column"), column("search_milliseconds").expect("a column"));
    for line in csv::Reader::from_reader(steps.as_bytes()).records() {
        let line = line.expect("a line");
        // Of ten steps all are sampled; shifted sorts make none.
        assert_eq!(line[step].is_empty(), line[3].starts_with("shifted sort"), "{line:?}");
        assert!(line[search].parse::<f64>().is_ok_and(|milliseconds| milliseconds > 0.0), "{line:?}");
    }
    let mut expected = of_all(&["coherent", "uniform-grid", "verlet"]);
    expected.extend(gpu.map(|_| "shifted sort, GPU".to_owned()));
    is(measured(&figure_19, "a search alone, median"), expected);
    let plot = fs::read_to_string(folder.0.join("figure-19.svg")).expect("the plot");
    assert!(plot.contains("coherent, CPU, search alone"));
    assert_eq!(plot.contains("shifted sort, GPU, search alone"), gpu.is_some());

    let figure_20 = rows(&folder, "figure-20");
    let names = ["coherent", "aabb-tree", "uniform-grid", "uniform-grid at r_min", "multi-level-grid"];
    is(measured(&figure_20, "steps a second"), of_all(&names));
    is(measured(&figure_20, "spread over r"), of_all(&names));
    let papers: BTreeSet<&str> = figure_20
        .iter()
        .filter(|row| {
            row["method"].starts_with("uniform-grid,") && row["setting"] == "gather" && row["unit"] == "steps/s"
        })
        .map(|row| &*row["paper_value"])
        .collect();
    assert_eq!(papers, ["0.400000", "21.000000", "4.000000"].into());
    for rule in PairRule::ALL {
        assert!(
            figure_20.iter().filter(|row| row["setting"] == rule.name()).count() >= 3 * (5 * devices.len() + 3),
            "{}",
            rule.name()
        );
    }

    let green = rows(&folder, "green");
    is(measured(&green, "steps a second"), of_all(&["uniform-grid", "verlet", "coherent", "aabb-tree"]));
    assert_eq!(measured(&green, "bandwidth of that").len(), usize::from(gpu.is_some()));
    let conservation = rows(&folder, "conservation");
    is(measured(&conservation, "drift of the momentum"), of_all(&SEARCHES));
    let fluids = rows(&folder, "fluids");
    for model in ["pbf", "wcsph", "dfsph"] {
        assert!(fluids.iter().any(|row| row["setting"] == format!("dam-break, {model}")), "{model}");
    }

    let summary = fs::read_to_string(folder.0.join("summary.md")).expect("summary.md");
    for experiment in ["figure-18", "figure-19", "figure-20", "green", "conservation", "fluids"] {
        assert!(summary.contains(&format!("## {experiment}")), "{experiment} is in the summary");
    }
    for figure in ["figure-18", "figure-19", "figure-20"] {
        let svg = fs::read_to_string(folder.0.join(format!("{figure}.svg"))).expect(figure);
        assert!(svg.contains(COMMIT) && summary.contains(&format!("({figure}.svg)")), "{figure}");
    }
}

fn spent_budget() {
    let folder = Folder::new("budget");
    particles::run(&arguments(DeviceChoice::Cpu, &folder, 0.0)).expect("a spent budget is no error");
    for experiment in ["figure-18", "figure-19", "green", "conservation", "fluids"] {
        let rows = rows(&folder, experiment);
        let says = |row: &Row| row["value"].is_empty() && row["note"].contains("budget");
        assert!(rows.iter().all(says), "{experiment}");
    }
    let timed = |row: &Row| row["quantity"] != "neighbours at the start";
    assert!(rows(&folder, "figure-20").iter().filter(|row| timed(row)).all(|row| row["value"].is_empty()));
}

fn bad_settings() {
    let folder = Folder::new("refused");
    let right = arguments(DeviceChoice::Cpu, &folder, 0.0);
    for (wrong, said) in [
        (particles::Arguments { scale: 0.0, ..right.clone() }, "--scale 0"),
        (particles::Arguments { budget: f64::NAN, ..right.clone() }, "--budget NaN"),
    ] {
        let error = particles::run(&wrong).expect_err(said).to_string();
        assert!(error.contains(said), "{error}");
    }
}

fn planted_particles() {
    let right = Particles::at_rest(vec![DVec3::ZERO, DVec3::ONE, DVec3::X]);
    same(&right, &right).expect("the same");
    let mut wrong = right.clone();
    wrong.positions[1].y = 1.0 + f64::EPSILON;
    assert!(same(&wrong, &right).expect_err("one place").to_string().contains("particle 1"));
    let mut wrong = right.clone();
    wrong.velocities[2].z = 1e-300;
    assert!(same(&wrong, &right).is_err());
    let mut wrong = right.clone();
    wrong.classes[0] = 1;
    assert!(same(&wrong, &right).is_err());
    assert!(same(&Particles::default(), &right).is_err());
}

fn planted_measures() {
    let scene = box_of_grains(50);
    let end = Measures { kinetic_energy: 1.0, potential_energy: 2.0, ..Measures::default() };
    sane(&end).expect("numbers");
    assert!(sane(&Measures { kinetic_energy: f64::NAN, ..end }).is_err());
    assert!(sane(&Measures { momentum: DVec3::INFINITY, ..end }).is_err());
    assert!(sane(&Measures { outside: 1, ..end }).is_err());
    let (steps, seconds, mean_neighbors, rebuilds, iterations, density_error) = (10, 1.0, 3.0, 0, 0.0, 0.0);
    let particles = scene.particles.clone();
    let right = Timed { steps, seconds, mean_neighbors, rebuilds, iterations, density_error, end, particles };
    close(&scene, &right, &right).expect("the same");
    let with = |end: Measures| Timed { end, ..right.clone() };
    // The domain has a side of 2: a centre may be elsewhere by 0.01.
    close(&scene, &with(Measures { mean_position: DVec3::new(0.0, 0.009, 0.0), ..end }), &right).expect("close");
    let wrong = [
        with(Measures { mean_position: DVec3::new(0.0, 0.011, 0.0), ..end }),
        with(Measures { kinetic_energy: 2.1, ..end }),
        with(Measures { kinetic_energy: 0.4, ..end }),
        Timed { mean_neighbors: 2.8, ..right.clone() },
    ];
    for wrong in wrong {
        assert!(close(&scene, &wrong, &right).is_err(), "{wrong:?}");
        close(&scene, &Timed { steps: 9, ..wrong }, &right).expect("other steps are not compared");
    }
}

fn cells_at_r_min() {
    let ParticleSearch::UniformGrid { cell } = AT_R_MIN else { panic!("{AT_R_MIN} is no grid") };
    for rule in PairRule::ALL {
        let options = BuiltinOptions { particles: Some(2000), pair_rule: Some(rule), ..BuiltinOptions::default() };
        let scene = builtin_scene("paper-fig20", &options).expect("a scene");
        let ParticleModel::Dem(dem) = &scene.model else { panic!("grains") };
        let smallest = dem.radii.iter().copied().fold(f64::INFINITY, f64::min);
        let least = rule.reach(smallest, smallest);
        assert!((cell * dem.largest_reach() / least - 1.0).abs() < 1e-12, "{}: {least}", rule.name());
    }
}

fn planted_reference() {
    let folder = Folder::new("reference");
    let lab = Lab::new(&DeviceChoice::Cpu, 1.0, 1.0, &folder.0).expect("a folder");
    let (scene, mut other) = (box_of_grains(300), box_of_grains(300));
    let reference = Reference::of(&lab, &scene, false).expect("a reference");
    // Two that touch are pushed harder.
    let ParticleModel::Dem(dem) = &mut other.model else { panic!("grains") };
    dem.spring *= 1.001;
    for search in searches() {
        let way = Way { search, on_gpu: false };
        reference.check(&lab, &scene, way).expect("the same scene");
        let error = reference.check(&lab, &other, way).expect_err("another scene").to_string();
        assert!(error.contains("wrong answer"), "{error}");
    }
}

fn neighbors_by_class() {
    for rule in PairRule::ALL {
        let options = BuiltinOptions {
            particles: Some(900),
            pair_rule: Some(rule),
            radius: Some(0.01),
            ..BuiltinOptions::default()
        };
        let scene = builtin_scene("paper-fig20", &options).expect("a scene");
        let ParticleModel::Dem(dem) = &scene.model else { panic!("grains") };
        let Particles { positions, classes, .. } = &scene.particles;
        let acts = |i: usize, j: usize| {
            let [own, other] = [i, j].map(|k| dem.radii[usize::from(classes[k])]);
            let reach = match rule {
                PairRule::Contact => own + other,
                PairRule::Symmetric => own.max(other),
                PairRule::Gather => own,
            };
            i != j && positions[i].distance(positions[j]) < reach
        };
        let found = mean_neighbors(&scene).expect("counts");
        for (class, found) in found.into_iter().enumerate() {
            let members: Vec<usize> = (0..positions.len()).filter(|&i| usize::from(classes[i]) == class).collect();
            let pairs: usize = members.iter().map(|&i| (0..positions.len()).filter(|&j| acts(i, j)).count()).sum();
            let expected = pairs as f64 / members.len() as f64;
            assert!((found - expected).abs() < 1e-9, "{}, class {class}: {found}, expected {expected}", rule.name());
        }
    }
}

/// Of 262,144 grains. 16,384 have 64³ = 2¹⁸ cells of their diameter; of grains 16 times as many there are 2²² cells, which the grid limits to
/// 8 entries a grain, 2²¹: three passes of 8 bits.
fn bytes_of_a_step() {
    let scene = case::scene("dem-box", 1 << 18).expect("a scene");
    let grain = 64 + 24 + 3 * 16 + 36 + 52 + 36;
    assert_eq!(bytes_a_step(&scene), f64::from(grain << 18));
}

fn clouds() {
    let scene = conservation::scene(2000, 0.5);
    scene.validate().expect("a scene");
    let measures = Measures::of(&scene, &scene.particles);
    let lengths: f64 = scene.particles.velocities.iter().map(|v| v.length()).sum();
    // Uniform places are off the middle by some hundredths on average, and the spin is a fifth of the speed.
    assert!(measures.momentum.length() < 0.02 * lengths, "{measures:?}");
    assert!(measures.min.min_element() > -1.0 && measures.max.max_element() < 1.0, "{measures:?}");
}

fn box_of_grains(particles: usize) -> ParticleScene {
    case::scene("dem-box", particles).expect("a scene")
}
