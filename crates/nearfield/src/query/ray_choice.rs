//! Which structure to build for rays, by name or by what was measured.
//!
//! [`RayTask`] says what rays are to be cast; [`RayTask::choose`] compares what brute force and the hierarchy of boxes
//! would take for them, build included, by the figures in BENCHMARKS.md, section *Rays*. With n triangles, r rays between
//! two moves of the mesh and m moves:
//!
//! - brute force: (m + 1) r n tests;
//! - the hierarchy: n triangles built once and fitted m times, and (m + 1) r rays.
//!
//! So brute force wins for some 35 rays a thread on the CPU, whatever the mesh, and for tens of thousands on a GPU, where
//! tests are cheap and the build is as dear; and for any number of rays into a dozen triangles. The kd-tree is never the fastest: where its ropes cast rays sooner, on meshes of
//! up to 5,000 triangles on a GPU, they win 0.03 ns a ray, its build takes seven times as long, and it would take some
//! 3 · 10⁸ rays to win that back. It has no refit either. It is chosen where ropes themselves are wanted.

use std::str::FromStr;

use crate::gpu::AdapterKind;
use crate::{Error, Result};

/// Which structure to build over triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RayStructureChoice {
    /// What is fastest for the task; [`RayIndex::reason`](super::RayIndex::reason) says why.
    #[default]
    Auto,
    /// [`BruteForceMesh`](crate::BruteForceMesh).
    BruteForce,
    /// [`KdTree`](crate::KdTree), walked by its ropes.
    KdTree,
    /// [`TriangleBvh`](crate::TriangleBvh).
    TriangleBvh,
}

impl RayStructureChoice {
    /// Every structure there is, without `Auto`.
    pub const ALL: [Self; 3] = [Self::BruteForce, Self::KdTree, Self::TriangleBvh];

    /// The structure's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::BruteForce => "brute-force",
            Self::KdTree => "kd-tree",
            Self::TriangleBvh => "triangle-bvh",
        }
    }
}

impl FromStr for RayStructureChoice {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        std::iter::once(Self::Auto).chain(Self::ALL).find(|c| c.name() == text).ok_or_else(|| Error::InvalidSetting {
            setting: "structure",
            found: text.into(),
            expected: "auto, brute-force, kd-tree or triangle-bvh",
        })
    }
}

/// What is asked of each ray.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RayQuery {
    /// Its first hit.
    #[default]
    Closest,
    /// Whether there is a hit.
    Any,
    /// How many hits there are.
    Count,
    /// All of them, in order.
    All,
}

/// The rays that a structure is built for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RayTask {
    /// Rays that are cast before the mesh moves again; where it never does, in all.
    pub rays: u64,
    /// What is asked of most of them.
    pub query: RayQuery,
    /// How often the vertices move after the build.
    pub moves: u64,
    /// Whether the structure must have ropes: for a kernel of one's own that follows them, or to count their steps.
    pub ropes: bool,
}

impl RayTask {
    /// The closest hits of that many rays into a mesh that stays.
    pub const fn new(rays: u64) -> Self {
        Self { rays, query: RayQuery::Closest, moves: 0, ropes: false }
    }

    /// Sets what is asked of each ray.
    pub const fn asking(mut self, query: RayQuery) -> Self {
        self.query = query;
        self
    }

    /// Sets how often the mesh moves after the build.
    pub const fn moving(mut self, times: u64) -> Self {
        self.moves = times;
        self
    }

    /// Asks for a structure with ropes.
    pub const fn with_ropes(mut self) -> Self {
        self.ropes = true;
        self
    }

    /// The structure that takes the least time for these rays into a mesh of so many triangles, build included, and why,
    /// in one sentence with the figures. `device` is the GPU's kind, `None` for the CPU.
    ///
    /// ```
    /// use nearfield::{RayStructureChoice, RayTask};
    ///
    /// let (structure, reason) = RayTask::new(1_000_000).choose(70_000, None);
    /// assert_eq!(structure, RayStructureChoice::TriangleBvh);
    /// assert!(reason.starts_with("auto chose triangle-bvh: "));
    /// ```
    pub fn choose(&self, triangles: usize, device: Option<AdapterKind>) -> (RayStructureChoice, String) {
        let (structure, why) = self.choose_by(&Costs::of(device), triangles, device == Some(AdapterKind::Software));
        (structure, format!("auto chose {}: {why}", structure.name()))
    }

    fn choose_by(&self, costs: &Costs, triangles: usize, on_software: bool) -> (RayStructureChoice, String) {
        if self.ropes {
            return (RayStructureChoice::KdTree, "only the kd-tree has ropes".to_owned());
        }
        if on_software && triangles > MOST_ON_SOFTWARE {
            let why = format!("a software renderer ends the loop over {triangles} triangles");
            return (RayStructureChoice::TriangleBvh, why);
        }
        let (brute, tree) = (costs.brute_force(self, triangles), costs.hierarchy(self, triangles));
        let structure = if brute <= tree { RayStructureChoice::BruteForce } else { RayStructureChoice::TriangleBvh };
        let moving = if self.moves > 0 { format!(" after each of {} moves", self.moves) } else { String::new() };
        let why = format!(
            "{} rays into {triangles} triangles{moving} take about {} by brute force and {} by the hierarchy with its build",
            self.rays,
            duration(brute),
            duration(tree)
        );
        (structure, why)
    }
}

/// Triangles that a software renderer's loops are sure to reach the end of.
const MOST_ON_SOFTWARE: usize = 400_000;

/// Measured times in nanoseconds.
struct Costs {
    /// A triangle tested by brute force.
    test: f64,
    /// A ray in the hierarchy, by [`RayQuery`].
    ray: [f64; 4],
    /// Passes over the triangles, by [`RayQuery`].
    passes: [f64; 4],
    /// A triangle built into the hierarchy, beyond its preparation.
    build: f64,
    /// A triangle in a refit, beyond its preparation.
    refit: f64,
}

/// A build or a refit, whatever the mesh.
const START: f64 = 10_000.0;

/// How much slower llvmpipe casts rays than the CPU by itself, by brute force and in the hierarchy alike.
const SOFTWARE: f64 = 9.0;

impl Costs {
    /// By one thread: 562,500 rays against 953,856 triangles took 16 of a Xeon 567 s; bounces, shadow rays and all hits in
    /// the hierarchy one of an EPYC 204, 200 and 145 ns. A build over 953,856 triangles took both two and sixteen 0.6 s,
    /// so a build is not taken to gain by threads.
    fn cpu(threads: usize) -> Self {
        let threads = threads.max(1) as f64;
        Self {
            test: 17.0 / threads,
            ray: [204.0, 200.0, 145.0, 145.0].map(|ray| ray / threads),
            passes: [1.0; 4],
            build: 600.0,
            refit: 60.0,
        }
    }

    /// An H200: the same rays in 1.947 s, 1,705 and 2,299 Mrays/s, 310 for all hits, which are counted first.
    const H200: Self =
        Self { test: 0.0036, ray: [0.59, 0.43, 1.6, 3.2], passes: [1.0, 1.0, 1.0, 2.0], build: 620.0, refit: 60.0 };

    fn of(device: Option<AdapterKind>) -> Self {
        // Other cards were not measured: every card is taken to be a quarter as fast as an H200, and graphics of a
        // processor a sixteenth of that. Only what runs on the device is slower.
        let slower =
            |by: f64| Self { test: by * Self::H200.test, ray: Self::H200.ray.map(|ray| by * ray), ..Self::H200 };
        let cpu = || Self::cpu(rayon::current_num_threads());
        match device {
            None => cpu(),
            Some(AdapterKind::Software) => {
                let Self { test, ray, .. } = cpu();
                let (test, ray) = (SOFTWARE * test, ray.map(|ray| SOFTWARE * ray));
                Self { test, ray, ..Self::H200 }
            }
            Some(AdapterKind::Discrete) => slower(4.0),
            Some(AdapterKind::Integrated | AdapterKind::Virtual | AdapterKind::Other) => slower(64.0),
        }
    }

    fn brute_force(&self, task: &RayTask, triangles: usize) -> f64 {
        let rounds = task.moves as f64 + 1.0;
        rounds * task.rays as f64 * triangles as f64 * self.test * self.passes[task.query as usize]
    }

    fn hierarchy(&self, task: &RayTask, triangles: usize) -> f64 {
        let (n, moves) = (triangles as f64, task.moves as f64);
        let cast = (moves + 1.0) * task.rays as f64 * self.ray[task.query as usize];
        START + n * self.build + moves * (START + n * self.refit) + cast
    }
}

/// Nanoseconds in a unit that reads well, two digits.
fn duration(nanoseconds: f64) -> String {
    let (value, unit) = match nanoseconds {
        ..1e6 => (nanoseconds * 1e-3, "µs"),
        ..1e9 => (nanoseconds * 1e-6, "ms"),
        _ => (nanoseconds * 1e-9, "s"),
    };
    let digits = if value < 10.0 { 1 } else { 0 };
    format!("{value:.digits$} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use RayStructureChoice::{BruteForce, KdTree, TriangleBvh};

    const CARD: Option<AdapterKind> = Some(AdapterKind::Discrete);

    #[track_caller]
    fn assert_chosen(task: RayTask, triangles: usize, device: Option<AdapterKind>, expected: RayStructureChoice) {
        let costs = if device.is_none() { Costs::cpu(2) } else { Costs::of(device) };
        let (structure, why) = task.choose_by(&costs, triangles, device == Some(AdapterKind::Software));
        assert_eq!(structure, expected, "{why}");
    }

    #[test]
    fn names_are_read_back() {
        for choice in std::iter::once(RayStructureChoice::Auto).chain(RayStructureChoice::ALL) {
            assert_eq!(choice.name().parse::<RayStructureChoice>().unwrap(), choice);
        }
        assert!("uniform-grid".parse::<RayStructureChoice>().is_err());
    }

    #[test]
    fn few_rays_or_few_triangles_need_no_tree() {
        for device in [None, CARD, Some(AdapterKind::Integrated), Some(AdapterKind::Software)] {
            assert_chosen(RayTask::new(0), 100_000, device, BruteForce);
            assert_chosen(RayTask::new(3), 100_000, device, BruteForce);
            assert_chosen(RayTask::new(1000), 12, device, BruteForce);
            assert_chosen(RayTask::new(10_000_000), 70_000, device, TriangleBvh);
        }
    }

    #[test]
    fn the_border_lies_where_the_measured_times_meet() {
        // On two threads 600 ns a triangle are 70.6 tests of 8.5 ns; rays in the hierarchy and its start move that little.
        assert_chosen(RayTask::new(70), 1_000_000, None, BruteForce);
        assert_chosen(RayTask::new(72), 1_000_000, None, TriangleBvh);
        // A ray takes as long as twelve tests, so fewer triangles are never worth a tree.
        assert_chosen(RayTask::new(1_000_000_000), 12, None, BruteForce);
        assert_chosen(RayTask::new(1_000_000_000), 13, None, TriangleBvh);
        // On a card tests are hundreds of times cheaper and the build is not.
        assert_chosen(RayTask::new(42_000), 1_000_000, CARD, BruteForce);
        assert_chosen(RayTask::new(44_000), 1_000_000, CARD, TriangleBvh);
    }

    #[test]
    fn a_mesh_that_moves_pays_the_build_once() {
        // A refit takes 60 ns a triangle, brute force 8.5 a ray: ten rays are cast without a tree however often it moves, and
        // of forty the tree wins once its build is paid.
        let task = RayTask::new(40);
        assert_chosen(task, 100_000, None, BruteForce);
        assert_chosen(task.moving(1), 100_000, None, TriangleBvh);
        assert_chosen(RayTask::new(5), 100_000, None, BruteForce);
        assert_chosen(RayTask::new(5).moving(1_000_000), 100_000, None, BruteForce);
        assert_chosen(RayTask::new(20_000), 1_000_000, CARD, BruteForce);
        assert_chosen(RayTask::new(20_000).moving(10), 1_000_000, CARD, TriangleBvh);
    }

    #[test]
    fn lists_of_hits_take_a_card_two_passes() {
        let task = RayTask::new(30_000);
        assert_chosen(task, 1_000_000, CARD, BruteForce);
        assert_chosen(task.asking(RayQuery::Any), 1_000_000, CARD, BruteForce);
        assert_chosen(task.asking(RayQuery::All), 1_000_000, CARD, TriangleBvh);
    }

    #[test]
    fn ropes_are_had_from_the_kd_tree_alone() {
        for (rays, triangles) in [(1, 1), (1_000_000, 1_000_000)] {
            assert_chosen(RayTask::new(rays).with_ropes(), triangles, None, KdTree);
            assert_chosen(RayTask::new(rays).with_ropes().moving(5), triangles, CARD, KdTree);
        }
    }

    #[test]
    fn no_number_is_too_large() {
        let most = RayTask::new(u64::MAX).moving(u64::MAX).asking(RayQuery::All);
        assert_chosen(most, usize::MAX, None, TriangleBvh);
        assert_chosen(most, 0, None, BruteForce);
        assert_chosen(RayTask::new(1), 500_000, Some(AdapterKind::Software), TriangleBvh);
    }

    #[test]
    fn the_reason_has_the_figures() {
        let (structure, reason) = RayTask::new(1_000_000).moving(3).choose(70_000, CARD);
        assert_eq!(structure, TriangleBvh);
        let expected = "auto chose triangle-bvh: 1000000 rays into 70000 triangles after each of 3 moves";
        assert!(reason.starts_with(expected) && reason.contains("by brute force and"), "{reason}");
    }
}
