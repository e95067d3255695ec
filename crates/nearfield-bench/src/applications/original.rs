//! The figures of section 5.2 of Xing2017: seconds on a GeForce GTX 660 Ti (3 GB) and, for ANN, one core of a CPU of 3.4 GHz.

use crate::paper::methods::{self, Plug};

/// Seconds of the paper's four searches.
pub struct BySearch {
    /// Its own, coherent.
    pub coherent: f64,
    /// Shifted sort.
    pub shifted_sort: f64,
    /// Voxels.
    pub voxels: f64,
    /// ANN on one core.
    pub ann: f64,
}

impl BySearch {
    /// Milliseconds of the search in whose place ours stands. The voxels are those of the grid with as many cells.
    pub fn milliseconds(&self, plug: &str, voxels: &Plug) -> Option<f64> {
        let seconds = match plug {
            name if name == methods::aabb_tree::COHERENT.name => self.coherent,
            name if name == methods::shifted_sort::ON_GPU.name => self.shifted_sort,
            name if name == methods::kd_tree::ON_CPU.name => self.ann,
            name if name == voxels.name => self.voxels,
            _ => return None,
        };
        seconds.is_finite().then_some(1e3 * seconds)
    }
}

/// A model of its figure 14.
pub struct Smoothed {
    /// Its name there.
    pub name: &'static str,
    /// Number of points.
    pub points: usize,
    /// Mean neighbours: its radii depend on the unit of length, so these follow from its rates of queries in table 1.
    pub neighbors: f64,
    /// Our mesh in its place.
    pub file: &'static str,
    /// A search of one iteration.
    pub search: BySearch,
    /// Thirty iterations.
    pub total: BySearch,
}

/// Iterations of figure 14.
pub const SMOOTHING_ITERATIONS: usize = 30;

const fn by_search(coherent: f64, shifted_sort: f64, voxels: f64, ann: f64) -> BySearch {
    BySearch { coherent, shifted_sort, voxels, ann }
}

/// Figure 14.
pub const FIGURE_14: [Smoothed; 3] = [
    Smoothed {
        name: "Inukshuk",
        points: 206_000,
        neighbors: 65.0,
        file: "stanford-bunny.obj",
        search: by_search(0.162, 0.292, 0.663, 5.36),
        total: by_search(6.33, 10.4, 22.3, 208.0),
    },
    Smoothed {
        name: "Japanese-Lady",
        points: 176_000,
        neighbors: 35.0,
        file: "nefertiti.obj",
        search: by_search(0.0794, 0.129, 0.245, 4.49),
        total: by_search(3.67, 6.22, 12.1, 166.0),
    },
    Smoothed {
        name: "Nasa",
        points: 889_000,
        neighbors: 25.0,
        file: "igea.ply",
        search: by_search(0.281, 0.557, 0.636, 14.9),
        total: by_search(9.98, 20.0, 22.1, 689.0),
    },
];

/// Points and samples of figure 15, its iterations, mean neighbours among the points, and our mesh in the place of its Kitten.
pub const FIGURE_15_POINTS: usize = 137_000;
/// See [`FIGURE_15_POINTS`].
pub const FIGURE_15_SAMPLES: usize = 20_000;
/// See [`FIGURE_15_POINTS`].
pub const FIGURE_15_ITERATIONS: usize = 100;
/// See [`FIGURE_15_POINTS`].
pub const FIGURE_15_NEIGHBORS: f64 = 460.0;
/// See [`FIGURE_15_POINTS`].
pub const FIGURE_15_FILE: &str = "igea.ply";
/// A search from the samples to the points.
pub const FIGURE_15_TO_POINTS: BySearch = by_search(0.0840, 0.133, 0.183, 2.30);
/// A search among the samples.
pub const FIGURE_15_AMONG_SAMPLES: BySearch = by_search(0.0268, 0.0432, 0.0820, 0.645);

/// A body of its table 3.
pub struct Body {
    /// Its name there.
    pub name: &'static str,
    /// Number of samples.
    pub points: usize,
    /// Our mesh in its place.
    pub file: &'static str,
    /// A field within four widths.
    pub field: BySearch,
}

/// Table 3.
pub const TABLE_3: [Body; 2] = [
    Body { name: "Vase-Lion", points: 731_000, file: "igea.ply", field: by_search(0.880, f64::NAN, 1.84, 210.0) },
    Body { name: "Buddha", points: 678_000, file: "nefertiti.obj", field: by_search(1.05, f64::NAN, 1.64, 231.0) },
];
/// The field of the first body within 0.2 L and two widths; its voxels failed.
pub const OFFSET_FIELD: BySearch = by_search(1.99, f64::NAN, f64::NAN, 236.0);
/// Nodes along a side of its grids.
pub const RESOLUTION: usize = 257;
/// Widths of its narrow band.
pub const BAND: f64 = 4.0;
/// Its offsets in diagonals.
pub const OFFSET: f64 = 0.2;

/// What a reader of the rows must know.
pub const NOTES: [&str; 6] = [
    "The paper's models are not public: points are samples of other meshes with as many of them, and noise of half their spacing along each \
     axis in figures 14 and 15. Its radii depend on the unit of length, so ours are chosen for as many neighbours as follow from its rates \
     of queries; measured ones stand beside every time.",
    "At a scale below 1 there are fewer points, as many neighbours, and coarser grids.",
    "The paper's totals hold what it computed from the neighbours. Ours with lists fit a plane by a kernel over the lists (on the CPU by a \
     loop); \"fused\" is the same fit without lists. Both stand in the figures.",
    "Its voxels are grids of 256³ (figures 14, 16 and 17) and 128³ cells (figure 15). Ours of that name have cells of that size; beyond eight \
     a point they stand in a hash table.",
    "A shifted sort keeps at most 128 neighbours, and k is the mean number of them: the rows of crowded places are cut, which recall shows.",
    "Its radius in figure 15, 40 (L/m)^½, means some 460 points and 70 samples in a ball.",
];
