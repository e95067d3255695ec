//! What `auto` builds: the structure that its rule names for sets of every kind, with the answers of brute force; and the table of its losses.

use libtest_mimic::Trial;
use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield::{
    BruteForce, FixedRadius, Index, IndexSettings, Knn, KnnSearch, NeighborSearch, RowOrder, StructureChoice, Vec3,
};
use nearfield_bench::auto::{self, Arguments};
use nearfield_bench::check::{Expected, check_nearest};
use nearfield_bench::sets::Set;

use crate::folder::{Folder, choice, number};
use crate::support::{gpu_trial, trial};

const NEAREST: u32 = 8;
/// Points of which all pairs are tested for the nearest.
const FEW_FOR_NEAREST: usize = 128;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("auto picks by its rule on a GPU and answers as brute force", |gpu| {
            picks_are_those_of_the_rule(Some(gpu))
        }),
        trial("auto picks by its rule on the CPU and answers as brute force", || picks_are_those_of_the_rule(None)),
        gpu_trial("the table of what auto loses has every structure on a GPU", |gpu| table_is_complete(choice(gpu))),
        trial("the table of what auto loses has every structure on the CPU", || table_is_complete(DeviceChoice::Cpu)),
    ]
}

/// Few points, even points, a surface, and a dense ball in emptiness, with a radius.
fn cases() -> Vec<(&'static str, Vec<Vec3>, f32, StructureChoice)> {
    let of = |kind, n| cloud(kind, n, 7).points;
    // Half of the points in a ball as wide as the radius, the others spread over a cube a hundred times as wide: in the cell of a point
    // are far more than 32 times as many points as in a used cell.
    let mut uneven = of(CloudKind::Uniform, 4000);
    uneven.iter_mut().step_by(2).for_each(|p| *p *= 0.01);
    uneven.iter_mut().skip(1).step_by(2).for_each(|p| *p += Vec3::splat(0.02));
    vec![
        // 2¹⁴ pairs, for the nearest too; 2¹⁸ pairs and fewer, for a radius.
        ("very few", of(CloudKind::Uniform, FEW_FOR_NEAREST), 0.1, StructureChoice::BruteForce),
        ("few", of(CloudKind::Uniform, 512), 0.1, StructureChoice::BruteForce),
        ("one more", of(CloudKind::Uniform, 513), 0.1, StructureChoice::UniformGrid),
        ("uniform", of(CloudKind::Uniform, 4000), 0.1, StructureChoice::UniformGrid),
        ("shell", of(CloudKind::Shell, 4000), 0.2, StructureChoice::UniformGrid),
        ("uneven", uneven, 0.01, StructureChoice::AabbTree),
    ]
}

fn picks_are_those_of_the_rule(gpu: Option<&Gpu>) {
    let settings = IndexSettings { device: DeviceChoice::Cpu, ..IndexSettings::default() };
    let on_gpu = IndexSettings { device: DeviceChoice::Gpu, ..IndexSettings::default() };
    for (name, points, radius, expected) in cases() {
        let question = FixedRadius::new(radius).order(RowOrder::Index);
        let index = match gpu {
            Some(gpu) => Index::build_on(gpu, &points, &question, &on_gpu),
            None => Index::build(&points, &question, &settings),
        };
        let index = index.expect("an index");
        assert_eq!(index.structure(), expected.name(), "{name}: {:?}", index.reason());
        assert!(index.reason().is_some_and(|reason| reason.contains(expected.name())), "{name}");
        let brute = BruteForce::build(&points).expect("brute force");
        let (counts, list) = (index.count(&question).expect("counts"), index.list(&question).expect("a list"));
        // Devices round pairs at the radius otherwise.
        let expected_rows = Expected::of(&points, radius).expect("a reference");
        expected_rows.check_counts(counts.as_slice()).expect(name);
        expected_rows.check_list(list.offsets(), list.indices()).expect(name);
        if gpu.is_none() {
            assert_eq!(counts.as_slice(), brute.count(&question).expect("counts").as_slice(), "{name}");
            let right = brute.list(&question).expect("a list");
            assert_eq!((list.offsets(), list.indices()), (right.offsets(), right.indices()), "{name}");
        }

        let nearest = Knn::new(NEAREST);
        let index = match gpu {
            Some(gpu) => Index::build_on(gpu, &points, &nearest, &on_gpu),
            None => Index::build(&points, &nearest, &settings),
        };
        let index = index.expect("an index");
        let few = points.len() <= FEW_FOR_NEAREST;
        // Devices that end long loops get the octree, whose loops can be foreseen.
        let limited = gpu.is_some_and(|gpu| gpu.limits().loop_rounds.is_some());
        let expected = match (few, limited) {
            (true, _) => StructureChoice::BruteForce,
            (false, true) => StructureChoice::LinearOctree,
            (false, false) => StructureChoice::AabbTree,
        };
        assert_eq!(index.structure(), expected.name(), "{name}: {:?}", index.reason());
        let found = index.knn(&nearest).expect("rows");
        check_nearest(&points, NEAREST, found.indices()).expect(name);
        if gpu.is_none() {
            assert_eq!(found.indices(), brute.knn(&nearest).expect("rows").indices(), "{name}");
        }
    }
}

fn table_is_complete(device: DeviceChoice) {
    let folder = Folder::new(&format!("auto-{device}").replace(' ', "-"));
    let csv = folder.0.join("auto.csv");
    let sets: Vec<Set> = ["uniform-2k", "shell-2k", "clustered-2k"].map(|set| set.parse().expect("a set")).to_vec();
    auto::run(&Arguments { sets, device, runs: 1, csv: Some(csv.clone()) }).expect("the table is made");
    let mut reader = csv::Reader::from_path(&csv).expect("auto.csv");
    let header: Vec<String> = reader.headers().expect("a header").iter().map(str::to_owned).collect();
    let column = |name: &str| header.iter().position(|h| h == name).expect(name);
    let rows: Vec<csv::StringRecord> = reader.records().map(|r| r.expect("a record")).collect();
    assert_eq!(rows.len(), 3 * 3 * StructureChoice::ALL.len());
    for of_question in rows.chunks(StructureChoice::ALL.len()) {
        let time = |row: &csv::StringRecord| row[column("milliseconds")].parse::<f64>().ok();
        let best = of_question.iter().filter_map(time).fold(f64::INFINITY, f64::min);
        let picked: Vec<_> = of_question.iter().filter(|row| &row[column("is_picked")] == "true").collect();
        assert_eq!(picked.len(), 1, "{of_question:?}");
        let own = time(picked[0]).expect("the pick was measured");
        let loss = number(&picked[0][column("loss")]);
        assert!((loss - (own / best - 1.0)).abs() < 2e-3 * (1.0 + loss) && !picked[0][column("reason")].is_empty());
        for row in of_question {
            let missing = &row[column("question")] == "16 nearest" && &row[column("structure")] == "uniform-grid";
            assert!(time(row).is_some() || missing || !row[column("note")].is_empty(), "{row:?}");
        }
    }
}
