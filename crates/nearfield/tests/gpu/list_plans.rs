//! Plans for lists of few points: every number of points around the sizes of words and workgroups, on the device and on the host, memory that grows and
//! that is short, and questions that they do not answer.

use libtest_mimic::Trial;
use nearfield::gpu::{Buffer, Gpu};
use nearfield::{Error, FixedRadius, GpuListPlan, Result, RowOrder, Vec3};

use crate::memory::refuse_each;
use crate::support::{gpu_trial, long_cases};
use crate::{RADIUS, lattice_points, own_context, rows_by_loop};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("plans_list_what_the_loop_finds", plans_list_what_the_loop_finds),
        gpu_trial("a_plan_follows_its_points_and_its_radius", a_plan_follows_its_points_and_its_radius),
        gpu_trial("memory_of_a_plan_grows_with_its_lists", memory_of_a_plan_grows_with_its_lists),
        gpu_trial("plans_are_sound_after_refused_memory", plans_are_sound_after_refused_memory),
        gpu_trial("plans_refuse_what_they_do_not_answer", plans_refuse_what_they_do_not_answer),
        gpu_trial("plans_of_a_lost_device_say_so", plans_of_a_lost_device_say_so),
    ]
}

type Rows = (Vec<u64>, Vec<u32>);

/// Offsets and indices by the loop, rows ascending.
fn expected(points: &[Vec3], radius: f32, exclude_self: bool) -> Rows {
    let (mut offsets, mut indices) = (vec![0], Vec::new());
    for (i, row) in rows_by_loop(points, points, radius).into_iter().enumerate() {
        indices.extend(row.into_iter().map(|(id, _)| id).filter(|&id| !(exclude_self && id == i as u32)));
        offsets.push(indices.len() as u64);
    }
    (offsets, indices)
}

/// The list of these points by the plan, on the device and on the host, which must be the same.
fn listed(gpu: &Gpu, plan: &mut GpuListPlan, points: &[Vec3]) -> Result<Rows> {
    let list = plan.list(points)?;
    let rows = (list.offsets().to_vec(), list.indices().to_vec());
    assert_eq!((list.report.structure, list.report.search), ("brute-force", "small-list"));
    let list = plan.list_on_device()?;
    let offsets: Vec<u64> = gpu.read(&list.offsets)?.into_iter().map(u64::from).collect();
    assert!((offsets, gpu.read(&list.indices)?) == rows, "the list on the device is that on the host");
    Ok(rows)
}

fn plans_list_what_the_loop_finds(gpu: &Gpu) {
    for n in [0, 1, 2, 31, 32, 33, 127, 128, 129, 255, 257, 1000, 2049] {
        let points = lattice_points(n);
        for question in [FixedRadius::new(RADIUS), FixedRadius::new(RADIUS).exclude_self().order(RowOrder::Index)] {
            let mut plan = GpuListPlan::new(gpu, n, &question).unwrap();
            let rows = listed(gpu, &mut plan, &points).unwrap();
            assert!(rows == expected(&points, RADIUS, question.exclude_self), "{n} points");
        }
    }
    // The most points, each with four near ones at most; a quarter of them on software, which takes a minute for all pairs.
    let width = if long_cases(gpu) { 128 } else { 64 };
    let n = width * width;
    assert!(n <= GpuListPlan::MOST_POINTS);
    let points: Vec<Vec3> = (0..n).map(|i| Vec3::new((i % width) as f32, (i / width) as f32, 0.0)).collect();
    let mut plan = GpuListPlan::new(gpu, n, &FixedRadius::new(1.0).exclude_self()).unwrap();
    let (offsets, indices) = listed(gpu, &mut plan, &points).unwrap();
    for i in 0..n {
        let row = &indices[offsets[i] as usize..offsets[i + 1] as usize];
        let (x, y) = (i % width, i / width);
        let near = [
            (y > 0).then(|| i - width),
            (x > 0).then(|| i - 1),
            (x < width - 1).then(|| i + 1),
            (y < width - 1).then(|| i + width),
        ];
        assert!(near.into_iter().flatten().eq(row.iter().map(|&id| id as usize)), "row {i}: {row:?}");
    }
}

fn a_plan_follows_its_points_and_its_radius(gpu: &Gpu) {
    let n = 700;
    let mut points = lattice_points(n);
    let mut plan = GpuListPlan::new(gpu, n, &FixedRadius::new(RADIUS)).unwrap();
    for round in 0..5 {
        for (i, p) in points.iter_mut().enumerate() {
            p[i % 3] += ((i * 7 + round) % 5) as f32 / 128.0;
        }
        assert!(listed(gpu, &mut plan, &points).unwrap() == expected(&points, RADIUS, false), "round {round}");
    }
    for radius in [0.0, RADIUS / 2.0, 2.0 * RADIUS, 10.0, RADIUS] {
        plan.set_radius(radius).unwrap();
        assert!(listed(gpu, &mut plan, &points).unwrap() == expected(&points, radius, false), "radius {radius}");
    }
    // Points that a caller writes on the device.
    let moved: Vec<[f32; 4]> = points.iter().rev().map(|p| [p.x, p.y, p.z, 7.0]).collect();
    gpu.write(plan.points(), 0, &moved).unwrap();
    let reversed: Vec<Vec3> = points.iter().rev().copied().collect();
    let list = plan.list_on_device().unwrap();
    assert_eq!(gpu.read(&list.indices).unwrap(), expected(&reversed, RADIUS, false).1);
}

fn memory_of_a_plan_grows_with_its_lists(gpu: &Gpu) {
    // All pairs, more than memory is taken for at first, then few again, beginning on each side.
    let n = 300;
    let (apart, together) = (lattice_points(n), vec![Vec3::ONE; n]);
    let all = (n * n) as u64;
    for device_first in [false, true] {
        let mut plan = GpuListPlan::new(gpu, n, &FixedRadius::new(RADIUS)).unwrap();
        assert!(listed(gpu, &mut plan, &apart).unwrap() == expected(&apart, RADIUS, false));
        if device_first {
            gpu.write(plan.points(), 0, &vec![[1.0; 4]; n]).unwrap();
            let list = plan.list_on_device().unwrap();
            assert_eq!((list.indices.len(), gpu.read(&list.offsets).unwrap()[n]), (n * n, (n * n) as u32));
        }
        let (offsets, indices) = listed(gpu, &mut plan, &together).unwrap();
        assert!(offsets.iter().enumerate().all(|(i, &offset)| offset == (i * n) as u64));
        assert!(indices.iter().enumerate().all(|(k, &index)| index as usize == k % n) && indices.len() as u64 == all);
        assert!(listed(gpu, &mut plan, &apart).unwrap() == expected(&apart, RADIUS, false), "few again");
    }
}

fn plans_are_sound_after_refused_memory(gpu: &Gpu) {
    let own = own_context(gpu);
    let (apart, together) = (lattice_points(300), vec![Vec3::ONE; 300]);
    let right = expected(&apart, RADIUS, false);
    let make = || {
        let mut plan = GpuListPlan::new(&own, 300, &FixedRadius::new(RADIUS))?;
        let first = plan.list(&apart)?.indices().to_vec();
        let many = plan.list(&together)?.indices().len();
        Ok((first, many))
    };
    let wrong = |(first, many): &(Vec<u32>, usize)| {
        (*first != right.1 || *many != 90_000).then(|| format!("{} and {many} neighbours", first.len()))
    };
    assert!(refuse_each(&own, "a plan", make, wrong) > 8);
    // A plan that could not grow lists on.
    let mut plan = GpuListPlan::new(&own, 300, &FixedRadius::new(RADIUS)).unwrap();
    for n in 0.. {
        plan.list(&apart).unwrap();
        own.refuse_allocation(Some(n));
        let grown = plan.list(&together).map(|list| list.indices().len());
        let not_reached = own.refuse_allocation(None);
        match grown {
            Ok(many) => assert_eq!(many, 90_000),
            Err(Error::OutOfDeviceMemory { .. }) => {
                assert!(listed(&own, &mut plan, &apart).unwrap() == right, "after allocation {n}");
                assert!(listed(&own, &mut plan, &together).unwrap().1.len() == 90_000, "after allocation {n}");
            }
            Err(other) => panic!("allocation {n}: {other}"),
        }
        if not_reached {
            break;
        }
        plan = GpuListPlan::new(&own, 300, &FixedRadius::new(RADIUS)).unwrap();
    }
}

fn plans_refuse_what_they_do_not_answer(gpu: &Gpu) {
    let points = lattice_points(50);
    let radii = vec![RADIUS; 50];
    let plain = FixedRadius::new(RADIUS);
    for question in [
        plain.queries(&points),
        FixedRadius::each(&radii),
        plain.max_neighbors(3),
        plain.distances(),
        plain.order(RowOrder::Distance),
        FixedRadius { max_bytes: Some(1 << 20), ..plain },
    ] {
        let made = GpuListPlan::new(gpu, 50, &question);
        assert!(matches!(made, Err(Error::Unsupported { .. })), "{question:?}");
    }
    assert!(matches!(GpuListPlan::new(gpu, 50, &FixedRadius::new(-1.0)), Err(Error::InvalidRadius { .. })));
    let too_many = GpuListPlan::new(gpu, GpuListPlan::MOST_POINTS + 1, &plain);
    assert!(matches!(too_many, Err(Error::TooMany { found: 16_385, limit: 16_384, .. })));
    let mut plan = GpuListPlan::new(gpu, 50, &plain).unwrap();
    assert!(matches!(plan.list(&points[1..]), Err(Error::LengthMismatch { found: 49, expected: 50, .. })));
    let mut wrong = points.clone();
    wrong[7].y = f32::NAN;
    assert!(matches!(plan.list(&wrong), Err(Error::NonFinite { first: 7, .. })));
    assert!(matches!(plan.set_radius(f32::INFINITY), Err(Error::InvalidRadius { .. })));
    assert!(listed(gpu, &mut plan, &points).unwrap() == expected(&points, RADIUS, false), "after the errors");
}

fn plans_of_a_lost_device_say_so(gpu: &Gpu) {
    let own = own_context(gpu);
    let points = lattice_points(50);
    let mut plan = GpuListPlan::new(&own, 50, &FixedRadius::new(RADIUS)).unwrap();
    plan.list(&points).unwrap();
    let words: Buffer<u32> = own.buffer("words", 1).unwrap();
    own.mark_lost("pulled out");
    assert!(matches!(plan.list(&points), Err(Error::DeviceLost { .. })));
    assert!(matches!(plan.list_on_device(), Err(Error::DeviceLost { .. })));
    assert!(matches!(plan.set_radius(1.0), Err(Error::DeviceLost { .. })));
    assert!(matches!(own.read(&words), Err(Error::DeviceLost { .. })));
}
