//! The algebra of octants: against sets of cells and strings of digits, and bit for bit the same on the GPU.

use std::collections::BTreeMap;

use libtest_mimic::Trial;
use nearfield::curve::{GpuOctants, MAX_LEVEL};
use nearfield::gpu::shader::Fill;
use nearfield::gpu::{Access, Kernel, Workgroups};
use nearfield::{Curve, Domain, Error, Gpu, Octant, Vec3};

use crate::support::{Random, gpu_trial, trial};
use crate::{LENGTHS, assert_same};

const SEED: u64 = 20_261_126;
/// Random pairs of each test.
const PAIRS: usize = 20_000;
const ROOT_MODULE: &str = "package::curve::octant_functions";
const FUNCTIONS: &str = include_str!("octant_functions.wesl");

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = vec![
        trial("octants_without_meaning_have_no_bits", octants_without_meaning_have_no_bits),
        trial("random_deep_octants_equal_strings_of_digits", random_deep_octants_equal_strings_of_digits),
        trial("octants_stand_in_preorder", octants_stand_in_preorder),
    ];
    for curve in Curve::ALL {
        let name = |what: &str| format!("{what}_{curve}");
        trials.push(trial(name("small_octants_equal_sets_of_cells"), move || small_octants_equal_sets_of_cells(curve)));
        trials.push(trial(name("neighbors_are_one_cell_away"), move || neighbors_are_one_cell_away(curve)));
        trials.push(trial(name("bounds_hold_the_points_inside"), move || bounds_hold_the_points_inside(curve)));
        trials.push(gpu_trial(name("gpu_octant_functions_equal_the_cpu"), move |gpu| {
            functions_equal_the_cpu(gpu, curve)
        }));
        trials.push(gpu_trial(name("gpu_neighbors_equal_the_cpu"), move |gpu| gpu_neighbors_equal_the_cpu(gpu, curve)));
    }
    trials.push(gpu_trial("gpu_relations_of_pairs_equal_the_cpu", gpu_relations_of_pairs_equal_the_cpu));
    trials.push(gpu_trial("gpu_relations_refuse_what_does_not_fit", gpu_relations_refuse_what_does_not_fit));
    trials
}

// ---- small octants as sets of cells ----

/// Cells of level 2, a bit each.
type Cells = u64;

/// All octants of levels 0 to 2 and the cells in each, by their place in space alone.
fn small_octants(curve: Curve) -> Vec<(Octant, u32, Cells)> {
    let mut all = vec![];
    for level in 0..=2 {
        for number in 0..1u32 << (3 * level) {
            let cell = [0, 1, 2].map(|axis| number >> (level * axis) & ((1 << level) - 1));
            let mut inside = 0;
            for i in 0..64u32 {
                let fine = [i & 3, i >> 2 & 3, i >> 4];
                if fine.map(|c| c >> (2 - level)) == cell {
                    inside |= 1 << i;
                }
            }
            all.push((Octant::of_cell(curve, cell, level).unwrap(), level, inside));
        }
    }
    all
}

fn is_inside(inner: Cells, outer: Cells) -> bool {
    inner & !outer == 0
}

fn small_octants_equal_sets_of_cells(curve: Curve) {
    let all = small_octants(curve);
    assert_eq!(all.len(), 1 + 8 + 64);
    let of_level = |level: u32| {
        let mut octants: Vec<Octant> = all.iter().filter(|o| o.1 == level).map(|o| o.0).collect();
        octants.sort();
        octants
    };
    for &(a, level, cells) in &all {
        assert_eq!(a.level(), level);
        // Ancestors: what holds all cells of `a`, one at each level.
        for wanted in 0..=2 {
            let around = all.iter().find(|o| o.1 == wanted && is_inside(cells, o.2)).map(|o| o.0);
            assert_eq!(a.ancestor(wanted), around, "{a:?} at {wanted}");
            let mut inside: Vec<Octant> =
                all.iter().filter(|o| o.1 == wanted && is_inside(o.2, cells)).map(|o| o.0).collect();
            inside.sort();
            assert_eq!(a.first_descendant(wanted), inside.first().copied(), "{a:?} at {wanted}");
            assert_eq!(a.last_descendant(wanted), inside.last().copied(), "{a:?} at {wanted}");
            if wanted == level + 1 {
                let children: Vec<Octant> = (0..8).map(|i| a.child(i).unwrap()).collect();
                assert_eq!(children, inside);
                for (i, child) in (0..).zip(&children) {
                    assert_eq!((child.child_index(), child.parent()), (i, Some(a)));
                    assert!((0..8).all(|j| child.sibling(j) == Some(children[j as usize])));
                }
            }
        }
        let row = of_level(level);
        let place = row.iter().position(|&o| o == a).unwrap();
        assert_eq!(a.next(), row.get(place + 1).copied());
        assert_eq!(a.previous(), place.checked_sub(1).map(|before| row[before]));

        for &(b, _, others) in &all {
            assert_eq!(a.contains(b), is_inside(others, cells), "{a:?} {b:?}");
            assert_eq!(a.is_disjoint(b), others & cells == 0, "{a:?} {b:?}");
            let holding = all.iter().filter(|o| is_inside(cells | others, o.2));
            let smallest = holding.min_by_key(|o| o.2.count_ones()).map(|o| o.0);
            assert_eq!(Some(a.common_ancestor(b)), smallest, "{a:?} {b:?}");
            let towards = all.iter().find(|o| o.1 == level + 1 && is_inside(o.2, cells) && is_inside(others, o.2));
            assert_eq!(a.child_towards(b), towards.map(|o| o.0), "{a:?} {b:?}");
        }
    }
    assert_eq!((Octant::ROOT.parent(), Octant::ROOT.sibling(3), Octant::ROOT.child_index()), (None, None, 0));
}

fn octants_without_meaning_have_no_bits() {
    let named = (0..4096u64).filter(|&bits| Octant::from_bits(bits).is_some()).count();
    assert_eq!(named, 1 + 8 + 64 + 512);
    assert_eq!(Octant::from_bits(0), None);
    let deepest = Octant::from_bits(u64::MAX).unwrap();
    assert_eq!((deepest.level(), deepest.key(), deepest.next()), (MAX_LEVEL, (1 << 63) - 1, None));
    assert_eq!((deepest.child(0), deepest.first_descendant(MAX_LEVEL + 1)), (None, None));
    assert_eq!(Octant::ROOT.child(8), None);
    for curve in Curve::ALL {
        assert_eq!(Octant::of_cell(curve, [4, 0, 0], 2), None);
        assert_eq!(Octant::of_cell(curve, [0; 3], MAX_LEVEL + 1), None);
    }
}

// ---- deep octants as strings of digits ----

/// Pairs of octants that share a part of their digits: of random levels, the extremes among them.
fn pairs(n: usize, seed: u64) -> Vec<[Octant; 2]> {
    let mut random = Random(seed);
    (0..n)
        .map(|i| {
            let key = [random.bits() >> 1, 0, (1 << 63) - 1][if i % 7 == 0 { random.below(3) as usize } else { 0 }];
            let shared = random.below(64);
            let other = key ^ (random.bits() >> 1).checked_shr(shared).unwrap_or(0);
            let level =
                |random: &mut Random| [random.below(22), 0, MAX_LEVEL][(random.below(9) as usize).saturating_sub(6)];
            let (a, b) = (level(&mut random), level(&mut random));
            [Octant::of_key(key, a), Octant::of_key(other, b)]
        })
        .collect()
}

/// Octal digits of the key: one a level.
fn digits(octant: Octant) -> Vec<u8> {
    (0..octant.level()).rev().map(|place| (octant.key() >> (3 * place) & 7) as u8).collect()
}

fn of_digits(digits: &[u8]) -> Octant {
    Octant::from_bits(digits.iter().fold(1, |bits, &digit| bits << 3 | u64::from(digit))).unwrap()
}

fn random_deep_octants_equal_strings_of_digits() {
    let mut related = BTreeMap::from([("contained", 0), ("disjoint", 0), ("equal", 0)]);
    for [a, b] in pairs(PAIRS, SEED) {
        let (in_a, in_b) = (digits(a), digits(b));
        let case = format!("{a:?} {b:?}, seed {SEED}");
        assert_eq!(of_digits(&in_a), a, "{case}");
        let common = in_a.iter().zip(&in_b).take_while(|(x, y)| x == y).count();
        assert_eq!(digits(a.common_ancestor(b)), in_a[..common], "{case}");
        assert_eq!(a.contains(b), in_b.starts_with(&in_a), "{case}");
        let disjoint = !in_b.starts_with(&in_a) && !in_a.starts_with(&in_b);
        assert_eq!(a.is_disjoint(b), disjoint, "{case}");
        let towards = (in_b.starts_with(&in_a) && in_b != in_a).then(|| of_digits(&in_b[..=in_a.len()]));
        assert_eq!(a.child_towards(b), towards, "{case}");
        for level in 0..=MAX_LEVEL {
            let (wanted, rest) = (level as usize, (level as usize).saturating_sub(in_a.len()));
            let above = (wanted <= in_a.len()).then(|| of_digits(&in_a[..wanted]));
            assert_eq!(a.ancestor(level), above, "{case}");
            let below =
                |digit: u8| (wanted >= in_a.len()).then(|| of_digits(&[&in_a[..], &vec![digit; rest]].concat()));
            assert_eq!(a.first_descendant(level), below(0), "{case}");
            assert_eq!(a.last_descendant(level), below(7), "{case}");
        }
        assert_eq!(a.first_key(), a.first_descendant(MAX_LEVEL).unwrap().key(), "{case}");
        assert_eq!(a.last_key(), a.last_descendant(MAX_LEVEL).unwrap().key(), "{case}");
        assert_eq!(a.parent(), a.level().checked_sub(1).and_then(|level| a.ancestor(level)), "{case}");
        assert_eq!(
            a.next().map(Octant::key),
            a.key().checked_add(1).filter(|key| key >> (3 * a.level()) == 0),
            "{case}"
        );
        assert_eq!(a.previous().map(Octant::key), a.key().checked_sub(1), "{case}");
        assert_eq!(a.child_index(), in_a.last().copied().unwrap_or(0).into(), "{case}");
        *related.get_mut("contained").unwrap() += u32::from(a.contains(b) && a != b);
        *related.get_mut("disjoint").unwrap() += u32::from(disjoint);
        *related.get_mut("equal").unwrap() += u32::from(a == b);
    }
    assert!(related.values().all(|&count| count > 100), "{related:?}");
}

fn octants_stand_in_preorder() {
    for [a, b] in pairs(PAIRS, SEED) {
        assert_eq!(a.cmp(&b), digits(a).cmp(&digits(b)), "{a:?} {b:?}");
    }
}

// ---- places ----

fn neighbors_are_one_cell_away(curve: Curve) {
    for [a, _] in pairs(PAIRS / 10, SEED) {
        let (cell, last) = (a.cell(curve).map(i64::from), (1i64 << a.level()) - 1);
        assert_eq!(Octant::of_cell(curve, a.cell(curve), a.level()), Some(a));
        for direction in directions() {
            let moved = [0, 1, 2].map(|axis| cell[axis] + i64::from(direction[axis]));
            let inside = moved.iter().all(|c| (0..=last).contains(c));
            let found = a.neighbor(curve, direction);
            assert_eq!(found.map(|o| (o.level(), o.cell(curve).map(i64::from))), inside.then(|| (a.level(), moved)));
        }
    }
}

fn directions() -> impl Iterator<Item = [i32; 3]> {
    (0..27).map(|i| [i / 9 - 1, i / 3 % 3 - 1, i % 3 - 1])
}

fn bounds_hold_the_points_inside(curve: Curve) {
    let mut random = Random(SEED);
    let domain = Domain::new(Vec3::new(-3.3, 100.7, 0.0), 7.7).unwrap();
    for _ in 0..PAIRS {
        let offset = Vec3::new(random.unit(), random.unit(), random.unit()) * domain.edge();
        let point = domain.origin() + offset;
        let octant = Octant::of_key(domain.key_of(curve, point), random.below(MAX_LEVEL + 1));
        let bounds = octant.bounds(curve, &domain);
        assert!(bounds.contains(point), "{point} in {octant:?}");
        let [low, high] = octant.cell_range(curve);
        let cell = domain.cell_of(point);
        assert!((0..3).all(|axis| (low[axis]..=high[axis]).contains(&cell[axis])), "{octant:?}");
        // Not much larger than the octant.
        let side = domain.edge() / (1u32 << octant.level()) as f32;
        assert!(bounds.extent().max_element() <= side + 4e-6 * (domain.edge() + 110.0), "{octant:?}");
    }
}

// ---- the GPU ----

/// The results of every function for a pair, as octant_functions.wesl writes them.
fn results(curve: Curve, [a, b]: [Octant; 2]) -> Vec<u32> {
    fn wide(words: &mut Vec<u32>, bits: u64) {
        words.extend([bits as u32, (bits >> 32) as u32]);
    }
    let bits = |octant: Option<Octant>| octant.map_or(0, Octant::bits);
    let mut words = vec![a.level()];
    wide(&mut words, a.first_key());
    wide(&mut words, a.last_key());
    words.extend([u32::from(a.contains(b)), u32::from(a.is_disjoint(b))]);
    wide(&mut words, bits(a.child_towards(b)));
    wide(&mut words, a.common_ancestor(b).bits());
    wide(&mut words, bits(a.parent()));
    words.push(a.child_index());
    wide(&mut words, bits(a.next()));
    wide(&mut words, bits(a.previous()));
    wide(&mut words, Octant::of_key(b.first_key(), a.level()).bits());
    for level in 0..=MAX_LEVEL + 1 {
        wide(&mut words, bits(a.ancestor(level)));
        wide(&mut words, bits(a.first_descendant(level)));
        wide(&mut words, bits(a.last_descendant(level)));
    }
    for index in 0..=8 {
        wide(&mut words, bits(a.child(index)));
        wide(&mut words, bits(a.sibling(index)));
    }
    let [low, high] = a.cell_range(curve);
    words.extend([a.cell(curve), low, high].concat());
    wide(&mut words, b.first_key());
    for direction in directions() {
        wide(&mut words, bits(a.neighbor(curve, direction)));
    }
    words
}

fn functions_equal_the_cpu(gpu: &Gpu, curve: Curve) {
    let mut cases = pairs(3000, SEED);
    let small = small_octants(curve);
    cases.extend(small.iter().zip(small.iter().rev()).map(|(a, b)| [a.0, b.0]));
    let expected: Vec<Vec<u32>> = cases.iter().map(|&pair| results(curve, pair)).collect();
    let row = expected[0].len();
    let kernel = gpu
        .pipeline(&Kernel {
            fills: &[(ROOT_MODULE, Fill::Caller(FUNCTIONS))],
            features: &[("hilbert", curve == Curve::Hilbert)],
            ..Kernel::new(ROOT_MODULE, "call_all", &[Access::Read, Access::ReadWrite], 64)
        })
        .unwrap();
    let input = gpu.upload("pairs", &cases).unwrap();
    let output = gpu.upload("results", &vec![0xdead_beef_u32; row * cases.len()]).unwrap();
    let mut commands = gpu.commands("octant functions");
    commands.dispatch(&kernel, &[(&input).into(), (&output).into()], Workgroups::Covering(cases.len() as u64));
    commands.submit().unwrap();
    let found = gpu.read(&output).unwrap();
    for ((pair, expected), found) in cases.iter().zip(&expected).zip(found.chunks_exact(row)) {
        assert_same(found, expected, &format!("functions of {pair:?}, seed {SEED}"));
    }
}

fn gpu_relations_of_pairs_equal_the_cpu(gpu: &Gpu) {
    let plan = GpuOctants::new(gpu).unwrap();
    for n in LENGTHS.into_iter().chain([PAIRS]) {
        let pairs = pairs(n, SEED);
        let [first, second] = [0, 1].map(|side| pairs.iter().map(|pair| pair[side]).collect::<Vec<_>>());
        let case = format!("{n} pairs, seed {SEED}");
        let expected: Vec<Octant> = pairs.iter().map(|[a, b]| a.common_ancestor(*b)).collect();
        assert_same(&plan.common_ancestors(&first, &second).unwrap(), &expected, &case);
        let expected: Vec<Option<Octant>> = pairs.iter().map(|[a, b]| a.child_towards(*b)).collect();
        assert_same(&plan.children_towards(&first, &second).unwrap(), &expected, &case);
        let expected: Vec<bool> = pairs.iter().map(|[a, b]| a.contains(*b)).collect();
        assert_same(&plan.contains(&first, &second).unwrap(), &expected, &case);
    }
}

fn gpu_neighbors_equal_the_cpu(gpu: &Gpu, curve: Curve) {
    let plan = GpuOctants::new(gpu).unwrap();
    let octants: Vec<Octant> = pairs(2000, SEED).into_iter().flatten().collect();
    for direction in directions() {
        let expected: Vec<Option<Octant>> = octants.iter().map(|o| o.neighbor(curve, direction)).collect();
        assert_same(&plan.neighbors(curve, &octants, direction).unwrap(), &expected, &format!("{direction:?}"));
    }
}

fn gpu_relations_refuse_what_does_not_fit(gpu: &Gpu) {
    let plan = GpuOctants::new(gpu).unwrap();
    let found = plan.contains(&[Octant::ROOT; 3], &[Octant::ROOT; 2]);
    assert!(matches!(found, Err(Error::LengthMismatch { found: 2, expected: 3, .. })), "{found:?}");
    let octants = gpu.upload("octants", &[Octant::ROOT; 700]).unwrap();
    let ancestors = gpu.upload("poisoned ancestors", &[Octant::ROOT.child(5).unwrap(); 700]).unwrap();
    let mut commands = gpu.commands("common ancestors");
    assert!(plan.record_common_ancestors(&mut commands, &octants, &octants, &ancestors, 701).is_err());
    plan.record_common_ancestors(&mut commands, &octants, &octants, &ancestors, 300).unwrap();
    commands.submit().unwrap();
    let found = gpu.read(&ancestors).unwrap();
    assert!(found[..300].iter().all(|&o| o == Octant::ROOT));
    assert!(found[300..].iter().all(|&o| o == Octant::ROOT.child(5).unwrap()), "what stands behind is left alone");
}
