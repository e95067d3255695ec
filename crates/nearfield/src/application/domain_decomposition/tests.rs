//! Partitions against what their points say, surface and exchange against every pair.

use std::collections::BTreeSet;

use glam::Vec3;

use super::{Exchange, MAX_PARTS, Partition, PartitionReport, compare_curves};
use crate::Error;
use crate::curve::{Curve, Domain};
use crate::geometry::distance::dist2;
use crate::geometry::generate::{CloudKind, cloud};
use crate::geometry::{Aabb, Period};
use crate::structure::{LinearOctree, OctreeSettings};

const SEED: u64 = 20_261_125;
const PARTS: [u32; 6] = [1, 2, 3, 7, 8, 31];

/// Named sets of points.
fn sets() -> Vec<(String, Vec<Vec3>)> {
    let mut sets = vec![
        ("no points".to_owned(), vec![]),
        ("one point".to_owned(), vec![Vec3::new(3.0, -1.0, 7.0)]),
        ("all equal".to_owned(), vec![Vec3::ONE; 50]),
        ("two values".to_owned(), (0..90).map(|i| Vec3::splat((i % 2) as f32)).collect()),
        ("line".to_owned(), (0..200).map(|i| Vec3::new(i as f32, 0.0, 0.0)).collect()),
        // Leaves at level 21 beside each other: their parents are as small as what lies around a leaf.
        ("neighbouring cells".to_owned(), (0..60).map(|i| Vec3::splat((i % 30) as f32 / (1 << 21) as f32)).collect()),
    ];
    sets[5].1.push(Vec3::ONE);
    for kind in [CloudKind::Uniform, CloudKind::Clustered, CloudKind::Shell] {
        sets.extend([20, 700].map(|n| (format!("{kind:?} {n}"), cloud(kind, n, SEED).points)));
    }
    sets
}

fn tree(points: &[Vec3], curve: Curve, capacity: u32) -> LinearOctree {
    LinearOctree::build(points, &OctreeSettings::default().curve(curve).leaf_capacity(capacity)).unwrap()
}

/// Every partition of every set, with its tree and the largest work that cannot be cut.
fn each_partition(mut check: impl FnMut(&str, &[Vec3], &LinearOctree, &Partition, f64)) {
    for (name, points) in sets() {
        for curve in Curve::ALL {
            let tree = tree(&points, curve, 8);
            let leaves = tree.leaves().map(|leaf| tree.nodes()[leaf as usize].n_points());
            let largest_leaf = f64::from(leaves.max().unwrap_or(0));
            let same_cell = |p: Vec3| {
                let cell = tree.domain().cell_of(p);
                points.iter().filter(|q| tree.domain().cell_of(**q) == cell).count()
            };
            let largest_cell = points.iter().map(|&p| same_cell(p)).max().unwrap_or(0) as f64;
            for parts in PARTS {
                let case = format!("{name}, {curve}, {parts} parts");
                let of_points = Partition::of_points(&points, parts, curve, tree.domain()).unwrap();
                check(&format!("{case} of points"), &points, &tree, &of_points, largest_cell);
                let of_tree = Partition::of_tree(&tree, parts).unwrap();
                check(&format!("{case} of leaves"), &points, &tree, &of_tree, largest_leaf);
            }
        }
    }
}

#[test]
fn parts_tile_the_keys_and_own_the_points_in_their_range() {
    each_partition(|case, points, tree, partition, _| {
        let mut end = 0;
        for part in 0..partition.parts() {
            let range = partition.range_of(part);
            assert_eq!(range.start, end, "{case}: start of part {part}");
            assert!(range.start <= range.end, "{case}: {range:?}");
            end = range.end;
        }
        assert_eq!(end, 1 << 63, "{case}");
        let mut counts = vec![0.0; partition.parts() as usize];
        for (&point, owner) in points.iter().zip(partition.owners(points)) {
            let key = tree.domain().key_of(partition.curve(), point);
            assert!(partition.range_of(owner).contains(&key), "{case}: {point} in part {owner}");
            assert_eq!(partition.owner(point), owner, "{case}");
            counts[owner as usize] += 1.0;
        }
        assert_eq!(partition.work(), counts, "{case}");
        for part in (0..partition.parts()).filter(|_| !points.is_empty()) {
            let is_empty = counts[part as usize] == 0.0;
            assert_eq!(partition.range_of(part).is_empty(), is_empty, "{case}: part {part}");
        }
    });
}

#[test]
fn work_is_even_up_to_what_cannot_be_cut() {
    each_partition(|case, points, _, partition, largest| {
        let share = points.len() as f64 / f64::from(partition.parts());
        for (part, work) in partition.work().iter().enumerate() {
            // The share is rounded once, and so is each cut: far less than a point.
            assert!((work - share).abs() <= largest + 1e-9, "{case}: part {part} has {work} of {share}");
        }
    });
}

#[test]
fn leaves_of_any_weight_are_split_evenly() {
    let points = cloud(CloudKind::Clustered, 3000, SEED).points;
    for curve in Curve::ALL {
        let tree = tree(&points, curve, 5);
        let n = tree.leaves().count();
        for round in 0..4u64 {
            // Thousandths: sums of them are rounded, by less than 1e-9 here. The last round has some heavy leaves.
            let weight =
                |i: u64| (i * 7919 % 1009) as f64 * 1e-3 * if round == 3 && i.is_multiple_of(97) { 50.0 } else { 1.0 };
            let weights: Vec<f64> = (0..n as u64).map(|i| weight(i + round)).collect();
            let (total, largest) = (weights.iter().sum::<f64>(), weights.iter().fold(0.0, |a: f64, &b| a.max(b)));
            for parts in PARTS {
                let partition = Partition::of_leaves(&tree, &weights, parts).unwrap();
                let mut work = vec![0.0; parts as usize];
                for (leaf, weight) in tree.leaves().zip(&weights) {
                    let octant = tree.nodes()[leaf as usize].octant;
                    let owner = partition.owner_of_key(octant.first_key());
                    assert_eq!(partition.owner_of_key(octant.last_key()), owner, "{curve}, {parts}: a leaf is cut");
                    work[owner as usize] += weight;
                }
                for (own, told) in work.iter().zip(partition.work()) {
                    assert!((own - told).abs() < 1e-9, "{curve}, {parts}: {own} {told}");
                    assert!((own - total / f64::from(parts)).abs() <= largest + 1e-9, "{curve}, {parts}: {own}");
                }
                let most = work.iter().fold(0.0, |a: f64, &b| a.max(b));
                assert!((partition.imbalance() - most * f64::from(parts) / total).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn leaves_without_work_count_alike() {
    let tree = tree(&cloud(CloudKind::Uniform, 500, SEED).points, Curve::Morton, 4);
    let n = tree.leaves().count();
    let partition = Partition::of_leaves(&tree, &vec![0.0; n], 2).unwrap();
    let owner = |leaf: u32| partition.owner_of_key(tree.nodes()[leaf as usize].octant.first_key());
    let first = tree.leaves().filter(|&leaf| owner(leaf) == 0).count();
    assert!(first.abs_diff(n - first) <= 1, "{first} of {n}");
    assert_eq!((partition.work(), partition.imbalance()), (&[0.0, 0.0][..], 1.0));
}

#[test]
fn points_that_were_not_there_have_an_owner() {
    let points = cloud(CloudKind::Shell, 500, SEED).points;
    for curve in Curve::ALL {
        let tree = tree(&points, curve, 8);
        let partition = Partition::of_tree(&tree, 7).unwrap();
        let (low, edge) = (tree.domain().origin(), tree.domain().edge());
        for probe in cloud(CloudKind::Uniform, 2000, SEED).points {
            // Half of them outside: those live where the nearest place inside does.
            let probe = low + edge * (2.0 * probe - 0.5);
            let inside = probe.clamp(low, low + edge);
            assert!(partition.owner(probe) < 7);
            assert_eq!(partition.owner(probe), partition.owner(inside), "{curve}: {probe}");
        }
        assert!(partition.owner(Vec3::splat(-1e18)) < 7 && partition.owner(Vec3::splat(1e18)) < 7);
    }
}

#[test]
fn wrong_input_is_an_error_with_numbers() {
    let points = cloud(CloudKind::Uniform, 100, SEED).points;
    let tree = tree(&points, Curve::Morton, 8);
    let n = tree.leaves().count();
    for parts in [0, MAX_PARTS + 1] {
        let error = Partition::of_tree(&tree, parts).unwrap_err().to_string();
        assert!(error.contains(&format!("parts = {parts}")), "{error}");
        assert!(Partition::of_points(&points, parts, Curve::Morton, tree.domain()).is_err());
    }
    assert_eq!(Partition::of_tree(&tree, MAX_PARTS).unwrap().parts(), MAX_PARTS);
    let error = Partition::of_leaves(&tree, &vec![1.0; n + 1], 2).unwrap_err();
    assert!(matches!(error, Error::LengthMismatch { found, expected, .. } if found == expected + 1), "{error}");
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        let mut weights = vec![1.0; n];
        weights[3] = bad;
        let error = Partition::of_leaves(&tree, &weights, 2).unwrap_err().to_string();
        assert!(error.contains(&format!("{bad} at leaf 3")), "{error}");
    }
    assert!(Partition::of_leaves(&tree, &vec![f64::MAX; n], 2).is_err());
    let with_nan = [Vec3::ZERO, Vec3::NAN];
    let error = Partition::of_points(&with_nan, 2, Curve::Hilbert, tree.domain()).unwrap_err();
    assert!(matches!(error, Error::NonFinite { first: 1, .. }), "{error}");
    let partition = Partition::of_tree(&tree, 2).unwrap();
    for radius in [-1.0, f32::NAN] {
        let error = partition.report(&tree, Some(&Exchange::new(radius))).unwrap_err();
        assert!(matches!(error, Error::InvalidRadius { .. }), "{error}");
    }
    let periodic = OctreeSettings::default().periodic(Period::new(Vec3::ONE).unwrap());
    let tree = LinearOctree::build(&points, &periodic).unwrap();
    assert!(matches!(partition.report(&tree, None), Err(Error::Unsupported { .. })));
}

/// Leaves and surface leaves of each part, by every pair of leaves.
fn plain_surface(tree: &LinearOctree, owners: &[u32], parts: u32) -> [Vec<u64>; 2] {
    let leaves: Vec<u32> = tree.leaves().collect();
    let parts_in = |leaf: u32| -> BTreeSet<u32> {
        tree.ordered_points().ids()[tree.nodes()[leaf as usize].points()].iter().map(|&i| owners[i as usize]).collect()
    };
    let touches = |a: u32, b: u32| {
        let (a, b) = (&tree.nodes()[a as usize], &tree.nodes()[b as usize]);
        (0..3).all(|axis| a.low[axis] <= b.high()[axis] + 1 && b.low[axis] <= a.high()[axis] + 1)
    };
    let (mut all, mut outer) = (vec![0; parts as usize], vec![0; parts as usize]);
    for &leaf in &leaves {
        for part in parts_in(leaf) {
            all[part as usize] += 1;
            let foreign = |&other: &u32| touches(leaf, other) && parts_in(other).iter().any(|&other| other != part);
            outer[part as usize] += u64::from(leaves.iter().any(foreign));
        }
    }
    [all, outer]
}

/// Points that each part sends and receives, by every pair of points.
fn plain_exchange(points: &[Vec3], owners: &[u32], parts: u32, radius: f32) -> [Vec<u64>; 2] {
    let (mut sent, mut received) = (vec![0; parts as usize], vec![0; parts as usize]);
    for (&point, &own) in points.iter().zip(owners) {
        let near =
            points.iter().zip(owners).filter(|&(&other, &part)| part != own && dist2(point, other) <= radius * radius);
        for part in near.map(|(_, &part)| part).collect::<BTreeSet<u32>>() {
            sent[own as usize] += 1;
            received[part as usize] += 1;
        }
    }
    [sent, received]
}

fn assert_report(report: &PartitionReport, surface: &[Vec<u64>; 2], moved: &[Vec<u64>; 2], case: &str) {
    for (i, part) in report.parts.iter().enumerate() {
        assert_eq!((part.leaves, part.surface), (surface[0][i], surface[1][i]), "{case}: surface of part {i}");
        let expected = (Some(moved[0][i]), Some(moved[1][i]), Some(16 * moved[0][i]));
        assert_eq!((part.sent, part.received, part.bytes), expected, "{case}: exchange of part {i}");
    }
}

#[test]
fn surface_and_exchange_are_those_of_all_pairs() {
    each_partition(|case, points, tree, partition, _| {
        let owners = partition.owners(points);
        let surface = plain_surface(tree, &owners, partition.parts());
        let diagonal = Aabb::of_points(points).diagonal().max(0.0);
        for radius in
            [0.0, 0.02 * diagonal, 0.25 * diagonal, 2.0 * diagonal].map(|r| if r.is_finite() { r } else { 1.0 })
        {
            let case = format!("{case}, radius {radius}");
            let report = partition.report(tree, Some(&Exchange::new(radius))).unwrap();
            assert_report(&report, &surface, &plain_exchange(points, &owners, partition.parts(), radius), &case);
            let total = report.total();
            assert_eq!((total.points, total.work), (points.len() as u64, points.len() as f64), "{case}");
            assert_eq!(total.sent, total.received, "{case}");
        }
        let without = partition.report(tree, None).unwrap();
        assert!(without.parts.iter().all(|part| part.sent.is_none() && part.bytes.is_none()), "{case}");
    });
}

#[test]
fn a_point_at_exactly_the_radius_is_sent() {
    // One part for each side of x = 0.5; the two nearest points are 0.25 apart.
    let points = [Vec3::ZERO, Vec3::new(0.375, 0.0, 0.0), Vec3::new(0.625, 0.0, 0.0), Vec3::X];
    let tree = tree(&points, Curve::Morton, 1);
    let partition = Partition::of_tree(&tree, 2).unwrap();
    assert_eq!(partition.owners(&points), [0, 0, 1, 1]);
    let sent = |radius: f32| partition.report(&tree, Some(&Exchange::new(radius))).unwrap().total().sent.unwrap();
    assert_eq!([sent(0.25f32.next_down()), sent(0.25), sent(1.0)], [0, 2, 4]);
}

#[test]
fn planted_differences_are_found() {
    let points = cloud(CloudKind::Uniform, 300, SEED).points;
    let tree = tree(&points, Curve::Hilbert, 8);
    let partition = Partition::of_tree(&tree, 3).unwrap();
    let owners = partition.owners(&points);
    let (surface, moved) = (plain_surface(&tree, &owners, 3), plain_exchange(&points, &owners, 3, 0.1));
    let report = partition.report(&tree, Some(&Exchange::new(0.1))).unwrap();
    assert_report(&report, &surface, &moved, "untouched");
    let planted: [fn(&mut PartitionReport); 4] = [
        |report| report.parts[1].surface -= 1,
        |report| report.parts[0].leaves += 1,
        |report| report.parts[2].sent = report.parts[2].sent.map(|n| n + 1),
        |report| report.parts[2].bytes = None,
    ];
    for (i, plant) in planted.into_iter().enumerate() {
        let mut wrong = report.clone();
        plant(&mut wrong);
        let found = std::panic::catch_unwind(|| assert_report(&wrong, &surface, &moved, "planted"));
        assert!(found.is_err(), "difference {i} was not found");
    }
}

#[test]
fn touching_leaves_are_those_of_all_pairs() {
    for (name, points) in sets() {
        for curve in Curve::ALL {
            let tree = tree(&points, curve, 2);
            let leaves: Vec<u32> = tree.leaves().collect();
            for &leaf in &leaves {
                let (low, high) = (tree.nodes()[leaf as usize].low, tree.nodes()[leaf as usize].high());
                let touches = |&&other: &&u32| {
                    let other = &tree.nodes()[other as usize];
                    (0..3).all(|axis| other.low[axis] <= high[axis] + 1 && low[axis] <= other.high()[axis] + 1)
                };
                let expected: Vec<u32> = leaves.iter().filter(|&&o| o != leaf).filter(touches).copied().collect();
                assert_eq!(tree.leaves_touching(leaf), expected, "{name}, {curve}: leaf {leaf}");
            }
        }
    }
}

#[test]
fn hilberts_parts_touch_less_and_exchange_less_on_average() {
    let points = cloud(CloudKind::Uniform, 20_000, SEED).points;
    let exchange = Exchange::new(0.03);
    let (mut surface, mut sent) = ([0, 0], [0, 0]);
    // Not for every number: eighths of a cube are the same cubes on both curves, and sixths happen to be alike.
    for parts in 2..=24 {
        let reports = compare_curves(&points, &OctreeSettings::default(), parts, Some(&exchange)).unwrap();
        assert_eq!(reports.each_ref().map(|report| report.curve), Curve::ALL);
        for (i, total) in reports.iter().map(PartitionReport::total).enumerate() {
            surface[i] += total.surface;
            sent[i] += total.sent.unwrap();
        }
    }
    println!("Morton, Hilbert: surface {surface:?}, sent {sent:?}");
    assert!(surface[1] < surface[0] && sent[1] < sent[0], "surface {surface:?}, sent {sent:?}");
}

#[test]
fn octants_of_a_cube_of_cells_have_the_surface_of_cubes() {
    // 8 x 8 x 8 cells with a point in each, 8 parts: each a cube of 4 x 4 x 4 cells, of which 3 x 3 x 3 touch nothing else.
    let points: Vec<Vec3> =
        (0..512).map(|i| Vec3::new((i % 8) as f32, (i / 8 % 8) as f32, (i / 64) as f32) + 0.5).collect();
    let domain = Domain::new(Vec3::ZERO, 8.0).unwrap();
    let settings = OctreeSettings::uniform(3).domain(domain);
    let exchange = Exchange::new(1.0);
    for report in compare_curves(&points, &settings, 8, Some(&exchange)).unwrap() {
        assert_eq!(report.imbalance, 1.0);
        for part in &report.parts {
            assert_eq!((part.points, part.leaves, part.surface), (64, 64, 64 - 27), "{}", report.curve);
            // Three faces of 16 points, each to one other part.
            assert_eq!((part.sent, part.received, part.bytes), (Some(48), Some(48), Some(768)), "{}", report.curve);
        }
    }
}
