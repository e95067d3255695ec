//! Accel's path tracer again: a bunny of 5,000 triangles in a room, 800 × 800 pixels, ten scatterings; how many
//! iterations in two minutes, or how long 168 of them take, by ropes and by brute force.
//!
//! The first iteration by every structure must give the picture of the first structure on its device: on the CPU to the
//! bit, on a GPU but for few pixels, where rounding at edges sends a path another way.

use std::time::Instant;

use nearfield::application::{Film, GpuPathTracer, Material, PathSettings, PathTracer, Scene as Room};
use nearfield::{GpuBruteForceMesh, GpuKdTree, GpuTriangleBvh, Vec3};

use super::method::{self, Method, Scene};
use super::rows::{Row, digits};
use super::{Lab, meshes, published};
use crate::Result;

/// Side of Accel's picture.
const SIDE: usize = 800;
/// Scatterings of its paths.
const DEPTH: u32 = 10;
/// Seconds in which it counted iterations.
const SECONDS: f64 = 120.0;
/// A structure may take this share of what is left of the budget.
const SHARE: f64 = 1.0 / 6.0;
/// The largest share of pixels that may differ on a GPU.
const MOST_DIFFERING: f64 = 0.02;

/// Iterations that were made, the seconds they took, and the picture of the first.
struct Made {
    iterations: usize,
    seconds: f64,
    first: Vec<Vec3>,
    rays: u64,
}

/// How long passes are repeated.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Until {
    iterations: usize,
    seconds: f64,
}

impl Until {
    /// Two minutes in full; else as many iterations as Accel made in them, or as are wanted, within a share of the seconds
    /// that are left.
    fn of(full: bool, wanted: Option<usize>, left: f64) -> Self {
        if full {
            return Self { iterations: usize::MAX, seconds: SECONDS };
        }
        let iterations = wanted.unwrap_or(published::ITERATIONS[0]).max(1);
        Self { iterations, seconds: SECONDS.min(SHARE * left) }
    }
}

/// Repeats a pass until the iterations are made or the seconds are over.
fn iterate(until: Until, mut pass: impl FnMut() -> Result<()>) -> Result<(usize, f64)> {
    let begin = Instant::now();
    for iterations in 1.. {
        pass()?;
        let passed = begin.elapsed().as_secs_f64();
        if iterations == until.iterations || passed >= until.seconds {
            return Ok((iterations, passed));
        }
    }
    unreachable!("there are fewer iterations than numbers")
}

fn on_cpu(room: &Room, search: &dyn nearfield::RaySearch, side: u32, until: Until) -> Result<Made> {
    let settings = PathSettings { depth: DEPTH, ..PathSettings::default() };
    let mut tracer = PathTracer::new(room.clone(), search, settings)?;
    let mut film = Film::new(side, side)?;
    tracer.render_pass(&mut film)?;
    let first = film.sums().to_vec();
    let before = tracer.counters();
    let (iterations, seconds) = iterate(until, || Ok(tracer.render_pass(&mut film)?))?;
    let after = tracer.counters();
    let rays = after.rays + after.shadow_rays - before.rays - before.shadow_rays;
    Ok(Made { iterations, seconds, first, rays })
}

fn on_gpu<S: nearfield::structure::GpuRayStructure>(
    room: &Room,
    structure: &S,
    side: u32,
    until: Until,
) -> Result<Made> {
    let settings = PathSettings { depth: DEPTH, ..PathSettings::default() };
    let mut tracer = GpuPathTracer::new(room.clone(), structure, settings, side, side)?;
    tracer.render_pass()?;
    let first = tracer.film()?.sums().to_vec();
    let before = tracer.counters();
    let (iterations, seconds) = iterate(until, || Ok(tracer.render_pass()?))?;
    let after = tracer.counters();
    let rays = after.rays + after.shadow_rays - before.rays - before.shadow_rays;
    Ok(Made { iterations, seconds, first, rays })
}

/// Checks a first picture against that of the first structure of its device.
///
/// # Errors
/// Another picture.
pub fn check_picture(found: &[Vec3], expected: &[Vec3], on_gpu: bool) -> Result<()> {
    let differing = found.iter().zip(expected).filter(|(a, b)| a != b).count();
    let most = if on_gpu { (MOST_DIFFERING * expected.len() as f64).ceil() as usize } else { 0 };
    if found.len() != expected.len() || differing > most {
        let n = expected.len();
        return Err(format!("wrong answer: {differing} of {n} pixels differ from the first structure's").into());
    }
    if !found.iter().any(|sum| sum.max_element() > 0.0) || found.iter().any(|sum| !sum.is_finite()) {
        return Err("wrong answer: a picture that is black or not finite".into());
    }
    Ok(())
}

/// Measures ropes, hierarchy and brute force on CPU and GPU.
///
/// # Errors
/// What a build or a pass returns; a picture that is wrong.
pub fn measure(lab: &mut Lab) -> Result<()> {
    let named = lab.source.mesh(meshes::ACCEL[1])?;
    let room = Room::room_around(named.mesh, Material::default())?;
    let scene = Scene::new(&room.mesh, &lab.tree)?;
    let side = lab.side(SIDE);
    let mut firsts: [Option<Vec<Vec3>>; 2] = [None, None];
    let order =
        [Method::GpuRopes, Method::GpuBvh, Method::GpuBrute, Method::CpuRopes, Method::CpuBvh, Method::CpuBrute];
    for method in order {
        let until = Until::of(lab.full, lab.repeat, lab.left());
        let Some(made) = make(lab, &room, &scene, method, (side as u32, until))? else { continue };
        let is_tree = matches!(method, Method::CpuRopes | Method::GpuRopes);
        let row = Row {
            part: "paths",
            mesh: format!("{} in a room", named.name),
            triangles: room.mesh.triangles.len(),
            method: method.name().to_owned(),
            how: if is_tree { method::tree_name(&lab.tree) } else { String::new() },
            device: lab.device(method),
            target: if method == Method::GpuRopes { "168 in ≤ 2 s".to_owned() } else { String::new() },
            ..Row::default()
        };
        let made = match made {
            Ok(made) => made,
            Err(note) => {
                lab.add(Row { note, ..row });
                continue;
            }
        };
        let first = &mut firsts[usize::from(method.on_gpu())];
        match first {
            Some(expected) => check_picture(&made.first, expected, method.on_gpu())?,
            None => {
                check_picture(&made.first, &made.first, method.on_gpu())?;
                *first = Some(made.first.clone());
            }
        }
        lab.add(Row { note: sentence(&made, method, side), ..row });
    }
    if let [Some(cpu), Some(gpu)] = &firsts {
        let mean = |sums: &[Vec3]| sums.iter().map(|s| s.as_dvec3().element_sum()).sum::<f64>() / sums.len() as f64;
        let (cpu, gpu) = (mean(cpu), mean(gpu));
        if (cpu - gpu).abs() > MOST_DIFFERING * cpu {
            return Err(format!("wrong answer: the GPU's picture has a mean of {gpu}, the CPU's of {cpu}").into());
        }
    }
    Ok(())
}

/// What was made, in words: measured numbers, and what follows from them where fewer were made.
fn sentence(made: &Made, method: Method, side: usize) -> String {
    let [by_ropes, by_brute] = published::ITERATIONS;
    let each = made.seconds / made.iterations as f64;
    let of_accel = if method.is_brute() { by_brute } else { by_ropes };
    let follows = if made.seconds >= SECONDS {
        // The last one ended after them.
        format!(", {} of them within two minutes", made.iterations - usize::from(made.seconds > SECONDS))
    } else if made.iterations >= by_ropes {
        format!(", so {:.0} in two minutes", SECONDS / each)
    } else {
        format!(", so {:.1} in two minutes and {} s for {by_ropes}", SECONDS / each, digits(by_ropes as f64 * each))
    };
    let rays = match made.rays {
        0 => String::new(),
        rays => format!("; {} Mrays/s", digits(rays as f64 * 1e-6 / made.seconds)),
    };
    // Its figures are for its own picture.
    let accel = if side == SIDE { format!("; Accel's GPU: {of_accel} in two minutes") } else { String::new() };
    format!("{} iterations of {side} × {side} in {} s{follows}{rays}{accel}", made.iterations, digits(made.seconds))
}

/// Builds the structure and iterates; `None` where there is no GPU, the reason where the device does not do it.
fn make(
    lab: &Lab,
    room: &Room,
    scene: &Scene,
    method: Method,
    (side, until): (u32, Until),
) -> Result<Option<std::result::Result<Made, String>>> {
    let made = match (method, lab.gpu()) {
        (Method::GpuRopes, Some(gpu)) => on_gpu(room, &GpuKdTree::upload(gpu, scene.tree())?, side, until),
        (Method::GpuBvh, Some(gpu)) => {
            let bvh = GpuTriangleBvh::of(gpu, scene.triangles.clone(), &nearfield::BvhSettings::default())?;
            on_gpu(room, &bvh, side, until)
        }
        (Method::GpuBrute, Some(gpu)) => {
            on_gpu(room, &GpuBruteForceMesh::of(gpu, scene.triangles.clone())?, side, until)
        }
        (method, None) if method.on_gpu() => return Ok(None),
        _ => {
            let Some(built) = scene.build(method, None)? else { return Ok(None) };
            on_cpu(room, built.search.as_search(), side, until)
        }
    };
    match made {
        Ok(made) => Ok(Some(Ok(made))),
        Err(error) => Ok(Some(Err(super::unsupported(error)?))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_minutes_are_run_in_full_or_reckoned_from_fewer_iterations() {
        let in_full = Until { iterations: usize::MAX, seconds: SECONDS };
        assert_eq!(Until::of(true, None, f64::INFINITY), in_full);
        assert_eq!(Until::of(false, None, 60.0), Until { iterations: 168, seconds: 10.0 });
        assert_eq!(Until::of(false, Some(0), 1e9), Until { iterations: 1, seconds: SECONDS });
        let made = |iterations, seconds| Made { iterations, seconds, first: vec![], rays: 0 };
        let told = |made: &Made| sentence(made, Method::CpuRopes, SIDE);
        let whole = told(&made(301, 120.25));
        assert!(whole.starts_with("301 iterations of 800 × 800 in 120 s, 300 of them within two minutes"), "{whole}");
        assert!(told(&made(168, 60.0)).contains("so 336 in two minutes"));
        assert!(told(&made(12, 60.0)).contains("so 24.0 in two minutes and 840 s for 168"));
    }
}
