//! Times of keys along the curves and of relations between octants: on the GPU by device timestamps, on the CPU by the
//! clock. Every result is checked in the same run.

use std::hint::black_box;
use std::time::Instant;

use nearfield::curve::{GpuCurve, GpuOctants, MAX_LEVEL, order};
use nearfield::gpu::{DeviceElement, Gpu};
use nearfield::parallel::reduce;
use nearfield::{Curve, Domain, Octant, Result, Vec3};
use rayon::prelude::*;

use crate::primitives::{check, clocked, median, report, timed, words};

/// Points whose keys are made.
const POINTS: [usize; 3] = [2_000_000, 10_000_000, 100_000_000];
/// Pairs of octants.
const PAIRS: [usize; 2] = [10_000_000, 100_000_000];

/// Prints the times of keys and of relations on the device; the median of 20 runs.
///
/// # Errors
/// What the device refuses; the first wrong result as `Device`.
pub fn run(gpu: &Gpu) -> Result<()> {
    println!("keys and octants on {}, median of 20 runs, microseconds on the device", gpu.name());
    for n in POINTS {
        if fits::<[f32; 4]>(gpu, n) {
            time_keys(gpu, n)?;
        }
    }
    for n in PAIRS {
        if fits::<Octant>(gpu, n) {
            time_relations(gpu, n)?;
        }
    }
    Ok(())
}

/// Prints the times of keys, orders and relations on the CPU; the median of 20 runs.
///
/// # Errors
/// Never with right code: what sorting refuses.
pub fn run_on_cpu() -> Result<()> {
    println!("keys and octants on the CPU, {} threads, median of 20 runs, microseconds", rayon::current_num_threads());
    let n = POINTS[0];
    let (points, domain) = (points(n), domain());
    let points: Vec<Vec3> = points.iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect();
    let cells: Vec<[u32; 3]> = points.iter().map(|&p| domain.cell_of(p)).collect();
    for curve in Curve::ALL {
        let keys: Vec<u64> = cells.iter().map(|&cell| curve.encode(cell)).collect();
        let encode = || cells.iter().fold(0, |sum: u64, &cell| sum.wrapping_add(curve.encode(cell)));
        report(&format!("encode {curve}, one thread"), n, median(|| clocked(|| keep(encode())))?);
        let decode = || {
            keys.iter().fold(0, |sum, &key| sum ^ curve.decode(key).iter().fold(0u32, |all, c| all.rotate_left(7) ^ c))
        };
        report(&format!("decode {curve}, one thread"), n, median(|| clocked(|| keep(decode())))?);
        let round = keys.par_iter().map(|&key| curve.decode(key)).collect::<Vec<_>>();
        check("decode", round.as_flattened(), cells.as_flattened())?;
        let mut sorted = vec![];
        let time = median(|| {
            let start = Instant::now();
            sorted = order(&points, curve)?;
            Ok(start.elapsed().as_secs_f64() * 1e6)
        })?;
        let mut expected: Vec<u32> = (0..n as u32).collect();
        let domain = Domain::of_bounds(&reduce::bounds(&points));
        expected.sort_by_cached_key(|&i| domain.key_of(curve, points[i as usize]));
        check("order", &sorted, &expected)?;
        report(&format!("order {curve}"), n, time);
    }
    let n = PAIRS[0];
    let (first, second) = (octants(n, 0), octants(n, 1));
    let ancestors = || first.iter().zip(&second).fold(0, |sum, (a, b)| sum ^ a.common_ancestor(*b).bits());
    report("common ancestor, one thread", n, median(|| clocked(|| keep(ancestors())))?);
    Ok(())
}

/// Keeps the work that led to a result.
fn keep<T>(result: T) {
    black_box(result);
}

fn fits<T>(gpu: &Gpu, n: usize) -> bool {
    let fits = (n * size_of::<T>()) as u64 <= gpu.limits().binding_bytes;
    if !fits {
        println!("{n} elements do not fit into a binding of this device");
    }
    fits
}

fn time_keys(gpu: &Gpu, n: usize) -> Result<()> {
    let (points, domain) = (points(n), domain());
    let input = gpu.upload("points", &points)?;
    for curve in Curve::ALL {
        let plan = GpuCurve::new(gpu, curve);
        let (wide, narrow) = (gpu.buffer::<u64>("63-bit keys", n)?, gpu.buffer::<u32>("30-bit keys", n)?);
        let time = median(|| timed(gpu, |commands| plan.record_point_keys(commands, &domain, &input, &wide, n)))?;
        let key = |p: &[f32; 4]| domain.key_of(curve, Vec3::new(p[0], p[1], p[2]));
        let expected: Vec<u64> = points.par_iter().map(key).collect();
        check("63-bit keys", &gpu.read(&wide)?, &expected)?;
        report(&format!("{curve} keys, 63 bits"), n, time);
        let time = median(|| timed(gpu, |commands| plan.record_point_keys(commands, &domain, &input, &narrow, n)))?;
        let expected: Vec<u32> = expected.par_iter().map(|key| (key >> 33) as u32).collect();
        check("30-bit keys", &gpu.read(&narrow)?, &expected)?;
        report(&format!("{curve} keys, 30 bits"), n, time);
    }
    Ok(())
}

fn time_relations(gpu: &Gpu, n: usize) -> Result<()> {
    let plan = GpuOctants::new(gpu)?;
    let (first, second) = (octants(n, 0), octants(n, 1));
    let (a, b) = (gpu.upload("first octants", &first)?, gpu.upload("second octants", &second)?);

    let ancestors = gpu.buffer("common ancestors", n)?;
    let time = median(|| timed(gpu, |commands| plan.record_common_ancestors(commands, &a, &b, &ancestors, n)))?;
    check_pairs(gpu, "common ancestors", &ancestors, &first, &second, |a, b| a.common_ancestor(b))?;
    report("common ancestors", n, time);
    drop(ancestors);

    let children = gpu.buffer("children towards", n)?;
    let time = median(|| timed(gpu, |commands| plan.record_children_towards(commands, &a, &b, &children, n)))?;
    let child = |a: Octant, b: Octant| a.child_towards(b).map_or(0, Octant::bits);
    check_pairs(gpu, "children towards", &children, &first, &second, child)?;
    report("children towards", n, time);
    drop(children);

    let flags = gpu.buffer("containments", n)?;
    let time = median(|| timed(gpu, |commands| plan.record_contains(commands, &a, &b, &flags, n)))?;
    check_pairs(gpu, "containments", &flags, &first, &second, |a, b| u32::from(a.contains(b)))?;
    report("containments", n, time);
    Ok(())
}

fn check_pairs<T: DeviceElement + PartialEq + Send + Sync>(
    gpu: &Gpu,
    what: &str,
    found: &nearfield::gpu::Buffer<T>,
    first: &[Octant],
    second: &[Octant],
    expected: impl Fn(Octant, Octant) -> T + Sync,
) -> Result<()> {
    let expected: Vec<T> = first.par_iter().zip(second).map(|(&a, &b)| expected(a, b)).collect();
    check(what, &gpu.read(found)?, &expected)
}

fn domain() -> Domain {
    Domain::new(Vec3::ZERO, 1.0).expect("the unit cube should be a domain")
}

/// Uniform in the unit cube.
fn points(n: usize) -> Vec<[f32; 4]> {
    let words = words(3 * n);
    let unit = |word: u32| (word >> 8) as f32 / (1u32 << 24) as f32;
    words.chunks_exact(3).map(|w| [unit(w[0]), unit(w[1]), unit(w[2]), 0.0]).collect()
}

/// Octants of random levels. Those of both sides share a random part of their keys, so that every answer occurs.
fn octants(n: usize, side: usize) -> Vec<Octant> {
    let words = words(5 * n);
    let octant = |w: &[u32]| {
        let shared = u64::from(w[0]) << 31 | u64::from(w[1] >> 1);
        let other = u64::from(w[2]) << 31 >> (w[3] % 64);
        let key = if side == 0 { shared } else { shared ^ other };
        Octant::of_key(key, (w[4] >> (8 * side)) % (MAX_LEVEL + 1))
    };
    words.par_chunks_exact(5).map(octant).collect()
}
