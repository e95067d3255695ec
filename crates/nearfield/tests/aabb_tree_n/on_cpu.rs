//! Every search of the tree on the CPU against brute force in the same type, to the bit.

use nearfield::geometry::Scalar;
use nearfield::{
    AabbTreeN, AabbTreeNSettings, Error, FixedRadiusN, KnnN, NearestN, NeighborsN, QueriesN, RadiusN, RowOrder,
    SearchWork, TreeSearch,
};

use crate::cases::{SEED, cases, radius_for};
use crate::reference::{by_distance, within};
use crate::support::Random;

const BUCKETS: [u32; 3] = [1, 7, 20];

fn rows<T: Scalar>(list: &NeighborsN<T>) -> Vec<Vec<(u32, T)>> {
    let row = |i| list.row(i).iter().copied().zip(list.row_dist2(i).iter().copied()).collect();
    (0..list.len()).map(row).collect()
}

fn nearest_rows<T: Scalar>(nearest: &NearestN<T>) -> Vec<Vec<(u32, T)>> {
    let row = |i| nearest.row(i).iter().copied().zip(nearest.row_dist2(i).iter().copied()).collect();
    (0..nearest.len()).map(row).collect()
}

/// Checks count, list and nearest of all searches, and the kNN searches, for one question.
fn check<T: Scalar, const D: usize>(
    name: &str,
    tree: &mut AabbTreeN<T, D>,
    points: &[[T; D]],
    question: FixedRadiusN<'_, T, D>,
) {
    let queries = match question.queries {
        QueriesN::Points => points,
        QueriesN::Other(queries) => queries,
    };
    let radius = |i: usize| match question.radius {
        RadiusN::One(radius) => radius,
        RadiusN::Each(radii) => radii[i],
    };
    let expected = within(points, queries, radius, question.exclude_self);
    let lengths: Vec<u32> = expected.iter().map(|row| row.len() as u32).collect();
    let ordered = question.order(RowOrder::Distance);
    for search in TreeSearch::ALL {
        tree.set_search(search);
        let list = tree.list(&ordered).unwrap();
        assert_eq!(rows(&list), expected, "{name}, {search:?}");
        assert_eq!(tree.count(&question).unwrap().as_slice(), lengths, "{name}, {search:?}");
        let mut unordered = rows(&tree.list(&question).unwrap());
        unordered.iter_mut().for_each(|row| row.sort_by(|a, b| a.1.compare(b.1).then(a.0.cmp(&b.0))));
        assert_eq!(unordered, expected, "{name}, {search:?}");
        check_work(name, search, &list.work, queries.len());
    }
    let nearest = nearest_rows(&tree.nearest(&question).unwrap());
    let first: Vec<_> = expected.iter().map(|row| row[..row.len().min(1)].to_vec()).collect();
    assert_eq!(nearest, first, "{name}");
    let FixedRadiusN { queries: asked, exclude_self, .. } = question;
    for k in [0, 1, 5, 130] {
        let knn = KnnN { k, queries: asked, within: None, exclude_self };
        let found = nearest_rows(&tree.knn(&knn).unwrap());
        for (i, query) in queries.iter().enumerate() {
            let mut row = by_distance(points, query, exclude_self.then_some(i));
            row.truncate(k as usize);
            assert_eq!(found[i], row, "{name}, k = {k}, query {i}");
        }
        let limited = nearest_rows(&tree.knn(&knn.within(question.radius)).unwrap());
        let kept: Vec<_> = expected.iter().map(|row| row[..row.len().min(k as usize)].to_vec()).collect();
        assert_eq!(limited, kept, "{name}, k = {k} within a radius");
    }
}

/// The counters show which search ran.
fn check_work(name: &str, search: TreeSearch, work: &SearchWork, n_queries: usize) {
    let n_queries = n_queries as u64;
    assert!(work.traversals <= n_queries, "{name}, {search:?}: {work:?}");
    let keeps = search == TreeSearch::Coherent && work.traversals > 0;
    assert_eq!(work.candidates > 0, keeps, "{name}, {search:?}: {work:?}");
}

pub(crate) fn answers_are_those_of_brute_force<T: Scalar, const D: usize>() {
    for case in cases::<T, D>(240) {
        for bucket in BUCKETS {
            let settings = AabbTreeNSettings::default().bucket_size(bucket);
            let mut tree = AabbTreeN::build(&case.points, &settings).unwrap();
            assert_eq!(tree.broken_invariant(), None, "{}", case.name);
            let plain = FixedRadiusN::new(case.radius);
            check(case.name, &mut tree, &case.points, plain);
            check(case.name, &mut tree, &case.points, plain.exclude_self());
            check(case.name, &mut tree, &case.points, plain.queries(&case.queries));
            // Radii that differ by a factor of 1000.
            let factor = |i: usize| T::of(10f64.powi((i % 4) as i32 - 3));
            let radii = |n: usize| (0..n).map(|i| case.radius * factor(i)).collect::<Vec<T>>();
            check(case.name, &mut tree, &case.points, FixedRadiusN::each(&radii(case.points.len())));
            let each = radii(case.queries.len());
            check(case.name, &mut tree, &case.points, FixedRadiusN::each(&each).queries(&case.queries));
        }
    }
}

/// Steps of a walk and then an explosion, points that jump, and all of them in one place.
pub(crate) fn trees_follow_moving_points<T: Scalar, const D: usize>() {
    let mut random = Random(SEED);
    let mut points = cases::<T, D>(240).swap_remove(5).points;
    let radius = radius_for(&points, 9);
    let mut tree = AabbTreeN::build(&points, &AabbTreeNSettings::default().bucket_size(7)).unwrap();
    for step in 0..24 {
        let range = radius.to_f64() * [0.001, 0.01, 0.1, 1.0, 30.0][step % 5];
        for (i, point) in points.iter_mut().enumerate() {
            let jumps = step % 7 == 3 && i % 10 == 0;
            let range = if jumps { 100.0 } else { range };
            *point = point.map(|x: T| x + T::of(range * (2.0 * f64::from(random.unit()) - 1.0)));
        }
        if step == 20 {
            points.fill([T::of(0.5); D]);
        }
        tree.refit(&points).unwrap();
        assert_eq!(tree.broken_invariant(), None, "step {step}");
        check(&format!("step {step}"), &mut tree, &points, FixedRadiusN::new(radius).exclude_self());
    }
}

pub(crate) fn searches_do_different_work<T: Scalar, const D: usize>() {
    let points = cases::<T, D>(240).swap_remove(5).points;
    let radius = radius_for(&points, 9);
    let mut tree = AabbTreeN::build(&points, &AabbTreeNSettings::default()).unwrap();
    let mut work = |search| {
        tree.set_search(search);
        let list = tree.list(&FixedRadiusN::new(radius)).unwrap();
        assert_eq!(list.report.search, search.name());
        list.work
    };
    let [primary, coherent, packed] = TreeSearch::ALL.map(&mut work);
    assert_eq!((primary.traversals, coherent.traversals), (240, 16));
    assert!(packed.traversals < coherent.traversals && packed.nodes < primary.nodes && coherent.nodes < primary.nodes);
    assert!((primary.candidates, packed.candidates) == (0, 0) && coherent.candidates > 0);
    assert!(coherent.tests >= packed.tests && packed.tests >= list_len(&points, radius));
}

fn list_len<T: Scalar, const D: usize>(points: &[[T; D]], radius: T) -> u64 {
    within(points, points, |_| radius, false).iter().map(|row| row.len() as u64).sum()
}

pub(crate) fn bad_input_is_an_error_with_numbers() {
    let settings = AabbTreeNSettings::default();
    let points = vec![[1.0f64, 2.0, 3.0, 4.0, 5.0]; 30];
    let with = |value: f64| {
        let mut points = points.clone();
        points[11][4] = value;
        points
    };
    assert!(matches!(
        AabbTreeN::build(&with(f64::NAN), &settings),
        Err(Error::NonFinite { what: "points", count: 1, first: 11 })
    ));
    assert!(matches!(
        AabbTreeN::build(&with(1e151), &settings),
        Err(Error::CoordinateBeyond { index: 11, axis: 4, .. })
    ));
    assert!(matches!(AabbTreeN::build(&[[2e18f32; 2]], &settings), Err(Error::CoordinateBeyond { .. })));
    assert!(matches!(AabbTreeN::build(&points, &settings.bucket_size(0)), Err(Error::InvalidSetting { .. })));
    let mut tree = AabbTreeN::build(&points, &settings).unwrap();
    let plain = FixedRadiusN::new(1.0);
    for radius in [-1.0, f64::NAN, f64::INFINITY, 1e-200] {
        assert!(matches!(tree.list(&FixedRadiusN::new(radius)), Err(Error::InvalidSetting { setting: "radius", .. })));
        assert!(tree.knn(&KnnN::new(3).within(RadiusN::One(radius))).is_err());
    }
    let each = [1.0; 29];
    let error = tree.count(&FixedRadiusN::each(&each)).unwrap_err();
    assert!(matches!(error, Error::LengthMismatch { found: 29, expected: 30, .. }), "{error}");
    let nan = with(f64::NAN);
    assert!(matches!(tree.nearest(&plain.queries(&nan)), Err(Error::NonFinite { what: "queries", first: 11, .. })));
    assert!(matches!(tree.count(&plain.queries(&points).exclude_self()), Err(Error::InvalidSetting { .. })));
    let error = tree.list(&plain.max_bytes(1000)).unwrap_err();
    assert!(matches!(error, Error::OutOfMemory { needed: 11_048, available: 1000, .. }), "{error}");
    let before = tree.boxes().to_vec();
    assert!(matches!(tree.refit(&nan), Err(Error::NonFinite { .. })));
    assert!(matches!(tree.refit(&points[1..]), Err(Error::LengthMismatch { found: 29, expected: 30, .. })));
    assert!(before == tree.boxes() && tree.broken_invariant().is_none());
}
