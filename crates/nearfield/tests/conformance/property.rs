//! Random clouds, radii, cells, bounds, periods and questions against the reference. A failure prints its seed; run
//! that one again with `NEARFIELD_SEED=…`.

use libtest_mimic::Trial;
use nearfield::geometry::Period;
use nearfield::{Aabb, FixedRadius, GridSettings, NeighborSearch, RowOrder, UniformGrid, Vec3};

use crate::compare::{self, List, Rule, Verdict};
use crate::random::Random;
use crate::reference::Problem;

/// Cases on the CPU, and on a device.
const CASES: u64 = 300;
#[cfg(feature = "gpu")]
const CASES_ON_GPU: u64 = 60;
/// Cases of one trial.
const BATCH: u64 = 30;

/// A random world: points, queries, settings and radii.
#[derive(Debug)]
struct World {
    points: Vec<Vec3>,
    queries: Option<Vec<Vec3>>,
    settings: GridSettings,
    period: Vec3,
    radii: Vec<f32>,
    one_radius: bool,
    exclude_self: bool,
    order: RowOrder,
    distances: bool,
    cap: Option<u32>,
}

/// The trials, some cases each.
pub(crate) fn trials() -> Vec<Trial> {
    if let Some(seed) = std::env::var("NEARFIELD_SEED").ok().and_then(|seed| seed.parse().ok()) {
        return vec![crate::trial(format!("random/cpu/seed-{seed}"), move || check_seed(seed, on_cpu, Rule::Exact))];
    }
    let mut trials = vec![];
    for first in (0..CASES).step_by(BATCH as usize) {
        let name = format!("random/cpu/seeds-from-{first}");
        trials.push(crate::trial(name, move || check_seeds(first, on_cpu, Rule::Exact)));
    }
    #[cfg(feature = "gpu")]
    for first in (0..CASES_ON_GPU).step_by(BATCH as usize) {
        let name = format!("random/gpu/seeds-from-{first}");
        trials.push(crate::gpu_trial(name, move || check_seeds(first, on_gpu, Rule::Device)));
    }
    trials
}

type Build = fn(&World) -> nearfield::Result<Box<dyn NeighborSearch>>;

fn on_cpu(world: &World) -> nearfield::Result<Box<dyn NeighborSearch>> {
    let grid = UniformGrid::build(&world.points, &world.settings)?;
    assert_eq!(grid.broken_invariant(), None);
    Ok(Box::new(grid))
}

#[cfg(feature = "gpu")]
fn on_gpu(world: &World) -> nearfield::Result<Box<dyn NeighborSearch>> {
    let device = crate::subjects::device();
    Ok(Box::new(nearfield::GpuUniformGrid::build(device, &world.points, &world.settings)?))
}

fn check_seeds(first: u64, build: Build, rule: Rule) -> Verdict {
    (first..first + BATCH).try_for_each(|seed| check_seed(seed, build, rule))
}

fn check_seed(seed: u64, build: Build, rule: Rule) -> Verdict {
    let world = World::random(seed);
    check(&world, build, rule).map_err(|difference| {
        let n = world.points.len();
        format!("seed {seed}: {difference} ({n} points, {:?}, radii {:?} …)", world.settings, &world.radii.first())
    })
}

fn check(world: &World, build: Build, rule: Rule) -> Verdict {
    let queries = world.queries.as_deref().unwrap_or(&world.points);
    let own = world.queries.is_none();
    let problem = Problem::solve(&world.points, queries, own, world.radii.clone(), world.period);
    let mut question = match world.one_radius {
        true => FixedRadius::new(world.radii.first().copied().unwrap_or(0.5)),
        false => FixedRadius::each(&world.radii),
    };
    if let Some(queries) = &world.queries {
        question = question.queries(queries);
    }
    question.exclude_self = world.exclude_self;
    question.order = world.order;
    question.distances = world.distances;
    let in_words = |error: nearfield::Error| error.to_string();
    let built = build(world).map_err(in_words)?;
    let counts = built.count(&question).map_err(in_words)?;
    compare::counts(&problem, &question, counts.as_slice(), rule)?;
    let nearest = built.nearest(&question).map_err(in_words)?;
    let nearest: Vec<_> = (0..nearest.len()).map(|i| nearest.get(i)).collect();
    compare::nearest(&problem, &question, &nearest, rule)?;
    question.max_neighbors = world.cap;
    let list = built.list(&question).map_err(in_words)?;
    let (offsets, indices) = (list.offsets(), list.indices());
    compare::list(&problem, &question, &List { offsets, indices, distances: list.distances(), cut: list.cut() }, rule)
}

impl World {
    fn random(seed: u64) -> Self {
        let mut random = Random::new(seed.wrapping_mul(0x2545_f491_4f6c_dd1d) ^ 0x5eed);
        let n = [0, 1, 2, 5, 33, 100, 300, 700][random.below(8)];
        let scale = 10f32.powi(random.below(13) as i32 - 6);
        let stretch = [Vec3::ONE, Vec3::new(100.0, 1.0, 1.0), Vec3::new(1.0, 1.0, 0.0), Vec3::new(0.0, 0.01, 10.0)];
        let stretch = stretch[random.below(4)] * scale;
        let offset = (random.point() - Vec3::splat(0.5)) * scale * [0.0, 2.0, 300.0][random.below(3)];
        let clustered = random.below(3) == 0;
        let mut period = Vec3::ZERO;
        if random.below(3) == 0 {
            for axis in 0..3 {
                if random.below(2) == 0 {
                    period[axis] = scale * random.between(0.5, 2.0);
                }
            }
        }
        let outside = random.below(3) == 0;
        let radius = scale * [0.0, 0.01, 0.05, 0.1, 0.3, 1.0, 30.0][random.below(7)];
        let mut point = |points: &[Vec3]| {
            let mut p = random.point() * stretch + offset;
            if clustered && !points.is_empty() && random.below(8) > 0 {
                p = points[random.below(points.len())] + (random.point() - Vec3::splat(0.5)) * stretch * 0.02;
            }
            if !points.is_empty() && random.below(12) == 0 {
                p = points[random.below(points.len())];
            }
            if outside {
                p += period * (random.below(7) as f32 - 3.0);
            }
            p
        };
        let mut points: Vec<Vec3> = vec![];
        for _ in 0..n {
            points.push(point(&points));
        }
        let mut others = vec![];
        for _ in 0..50 {
            others.push(point(&points));
        }
        let queries = (random.below(3) == 0).then_some(others);
        let n_queries = queries.as_ref().map_or(n, Vec::len);
        let one_radius = random.below(3) > 0;
        let radii = (0..n_queries).map(|_| if one_radius { radius } else { radius * random.between(0.01, 3.0) });
        let radii = radii.map(crate::questions::usable).collect();
        let cell_size = radius * [0.0, 0.1, 0.5, 1.0, 1.0, 3.0, 50.0][random.below(7)];
        let refine_x = 1 + random.below(8) as u32;
        let inner = Aabb::new(offset, offset + stretch * 0.3);
        let bounds = (random.below(4) == 0).then_some(inner);
        let orders = [RowOrder::Unspecified, RowOrder::Index, RowOrder::Distance];
        let settings = GridSettings {
            cell_size,
            refine_x,
            bounds,
            period: Period::new(period).expect("a random period should be sound"),
        };
        Self {
            exclude_self: queries.is_none() && random.below(2) == 0,
            order: orders[random.below(3)],
            distances: random.below(2) == 0,
            cap: (random.below(3) == 0).then(|| [0, 1, 2, 8, 40][random.below(5)]),
            points,
            queries,
            settings,
            period,
            radii,
            one_radius,
        }
    }
}
