//! The speed table: primary rays, bounces, shadow rays and all hits on the Stanford bunny, and the build of a large tree.

use nearfield::{HitRecord, KdTreeSettings, Ray};

use super::check::{Answer, Expected};
use super::meshes::{Named, Source};
use super::method::{self, Method, Scene};
use super::rows::Row;
use super::shots::{self, Question, Shots};
use super::{Lab, meshes, published};
use crate::Result;

/// Side of the picture.
pub(crate) const SIDE: usize = 1024;

/// The Stanford bunny with its rays.
pub(crate) struct Bunny {
    pub(crate) named: Named,
    pub(crate) scene: Scene,
    /// One through every pixel.
    pub(crate) primary: Vec<Ray>,
    /// One off every hit of those.
    pub(crate) bounces: Vec<Ray>,
    /// One from every hit to a lamp.
    pub(crate) shadows: Vec<Ray>,
}

impl Bunny {
    /// In a picture with so many pixels a side.
    pub(crate) fn new(source: &Source, tree: &KdTreeSettings, side: usize) -> Result<Self> {
        let named = source.mesh(meshes::STANFORD)?;
        let scene = Scene::new(&named.mesh, tree)?;
        let primary = shots::primary(&named.mesh, side);
        let hits: Vec<HitRecord> = {
            let expected = Expected::of(&scene.triangles, &primary, Question::Closest)?;
            let Answer::Closest(hits) = expected.answer() else { unreachable!("closest hits were asked") };
            hits.clone()
        };
        let (triangles, space) = (scene.triangles.as_slice(), scene.triangles.space());
        let bounces = shots::bounces(&primary, &hits, triangles, space.reach);
        let shadows = shots::shadows(&primary, &hits, triangles, &nearfield::Aabb::new(space.min, space.max));
        Ok(Self { named, scene, primary, bounces, shadows })
    }
}

/// Measures everything.
///
/// # Errors
/// What a build or a cast returns; an answer that is wrong.
pub fn measure(lab: &mut Lab) -> Result<()> {
    let Bunny { named, scene, primary, bounces, shadows } = Bunny::new(&lab.source, &lab.tree, lab.side(SIDE))?;
    let sets = [
        Shots { name: "primary", question: Question::Closest, rays: primary.clone() },
        Shots { name: "diffuse bounces", question: Question::Closest, rays: bounces },
        Shots { name: "shadow rays (any)", question: Question::Any, rays: shadows },
        Shots { name: "all hits", question: Question::All, rays: primary },
    ];
    let methods = [Method::CpuRopes, Method::CpuBvh, Method::GpuRopes, Method::GpuBvh];
    let built = methods.map(|method| scene.build(method, lab.gpu()));
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    for set in &sets {
        if set.rays.is_empty() {
            return Err(format!("there are no rays of the set {:?}: the picture is too small", set.name).into());
        }
        let expected = Expected::of(&scene.triangles, &set.rays, set.question)?;
        for (method, built) in methods.into_iter().zip(&built) {
            let built = match built {
                Ok(Some(built)) => built,
                Ok(None) => continue,
                Err(error) => return Err(error.to_string().into()),
            };
            for threads in [None, Some(1)] {
                let is_tree = matches!(method, Method::CpuRopes | Method::GpuRopes);
                let row = Row {
                    part: "speed",
                    mesh: named.name.clone(),
                    triangles: named.triangles(),
                    method: format!("{}{}", method.name(), if threads.is_some() { ", one thread" } else { "" }),
                    how: if is_tree { method::tree_name(&lab.tree) } else { String::new() },
                    device: lab.device(method),
                    shots: set.name.to_owned(),
                    rays: set.rays.len(),
                    build: Some(built.build),
                    upload: built.upload,
                    sample: expected.sample(),
                    target: published::target(method, set.name, set.question).to_owned(),
                    ..Row::default()
                };
                if lab.left() <= 0.0 {
                    lab.add(Row { note: "left out: the budget is spent".to_owned(), ..row });
                    continue;
                }
                let effort = lab.effort(method);
                let run = || method::cast(&built.search, &set.rays, set.question, &expected, effort);
                let cast = match threads {
                    None => run(),
                    Some(_) if method.on_gpu() => break,
                    Some(_) => one.install(run),
                };
                let row = match cast {
                    Ok(cast) => {
                        let asked = set.question == Question::Closest && threads.is_none();
                        let tests = asked.then(|| method::triangle_tests(&built.search, &set.rays)).transpose()?;
                        Row { cast: Some(cast), tests, ..row }
                    }
                    Err(error) => Row { note: super::unsupported(error)?, ..row },
                };
                lab.add(row);
            }
        }
    }
    build_of_a_million(lab)
}

/// The kd-tree and the hierarchy over about a million triangles, with a sample of rays checked.
fn build_of_a_million(lab: &mut Lab) -> Result<()> {
    let named = lab.source.million()?;
    let row = Row {
        part: "build",
        mesh: named.name.clone(),
        triangles: named.triangles(),
        device: lab.machine.host.clone(),
        shots: "primary".to_owned(),
        ..Row::default()
    };
    let rays = shots::primary(&named.mesh, 16);
    let scene = Scene::new(&named.mesh, &lab.tree)?;
    let expected = Expected::of(&scene.triangles, &rays, Question::Closest)?;
    for method in [Method::CpuRopes, Method::CpuBvh] {
        let Some(built) = scene.build(method, None)? else { continue };
        expected.check_exactly(&Answer::Closest(built.search.as_search().closest_hits(&rays)?.records().to_vec()))?;
        let is_tree = method == Method::CpuRopes;
        let stats = scene.tree().stats();
        lab.add(Row {
            method: if is_tree { format!("CPU {}", method::KD_TREE) } else { method.name().to_owned() },
            how: if is_tree { method::tree_name(&lab.tree) } else { String::new() },
            build: Some(built.build),
            sample: expected.sample(),
            target: if is_tree { "≤ 8000 ms on two cores".to_owned() } else { String::new() },
            note: match is_tree {
                true => format!(
                    "{} nodes, {:.0} MB, SAH cost {:.1}",
                    stats.nodes,
                    stats.bytes as f64 * 1e-6,
                    stats.sah_cost
                ),
                false => format!("{:.0} MB", built.search.as_search().memory_bytes() as f64 * 1e-6),
            },
            ..row.clone()
        });
    }
    Ok(())
}
