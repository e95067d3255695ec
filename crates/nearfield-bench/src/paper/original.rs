//! The figures of Xing2017 that its text and tables give. Its plots carry no numbers; those are shown without crosses.
//!
//! Measured there on a GeForce GTX 660 Ti (3 GB) and a CPU of 3.4 GHz, of which one core.

/// Numbers of points in its tests of the query time.
pub const POINTS: [usize; 5] = [100_000, 250_000, 500_000, 750_000, 1_000_000];

/// A row of its table 1: 300 k points and queries.
pub struct ByRadius {
    /// Radius in diagonals of the bounding box.
    pub r_over_l: f64,
    /// Seconds of all points within the radius, and of the nearest only.
    pub seconds: [f64; 2],
    /// Megabytes for all points within the radius, and for the nearest only.
    pub megabytes: [f64; 2],
}

const fn by_radius(r_over_l: f64, all: f64, nearest: f64, all_mb: f64, nearest_mb: f64) -> ByRadius {
    ByRadius { r_over_l, seconds: [all, nearest], megabytes: [all_mb, nearest_mb] }
}

/// Table 1.
pub const TABLE_1: [ByRadius; 10] = [
    by_radius(0.005, 0.101, 0.091, 18.33, 17.13),
    by_radius(0.010, 0.155, 0.144, 31.34, 21.78),
    by_radius(0.015, 0.233, 0.206, 60.47, 28.50),
    by_radius(0.020, 0.335, 0.279, 112.7, 37.62),
    by_radius(0.025, 0.475, 0.396, 194.7, 49.41),
    by_radius(0.030, 0.660, 0.531, 312.9, 64.18),
    by_radius(0.035, 0.871, 0.683, 473.9, 82.27),
    by_radius(0.040, 1.133, 0.872, 683.5, 103.9),
    by_radius(0.045, 1.449, 1.128, 947.5, 129.5),
    by_radius(0.050, 1.848, 1.397, 1271.0, 158.9),
];
/// Points of table 1.
pub const TABLE_1_POINTS: usize = 300_000;

/// A row of its table 2, in seconds.
pub struct ByPoints {
    /// Number of points.
    pub points: usize,
    /// Refit of the tree on the GPU.
    pub refit: f64,
    /// Build of a kd-tree on the GPU, where it fits.
    pub kd_tree_gpu: Option<f64>,
    /// Build of a kd-tree on one core by the library ANN.
    pub kd_tree_cpu: f64,
    /// Build of voxels on the GPU.
    pub voxels: f64,
}

const fn by_points(points: usize, refit: f64, kd_tree_gpu: Option<f64>, kd_tree_cpu: f64, voxels: f64) -> ByPoints {
    ByPoints { points, refit, kd_tree_gpu, kd_tree_cpu, voxels }
}

/// Table 2.
pub const TABLE_2: [ByPoints; 11] = [
    by_points(100_000, 0.000624, Some(0.0320), 0.0406, 0.0185),
    by_points(200_000, 0.00116, Some(0.0470), 0.106, 0.0206),
    by_points(300_000, 0.00178, Some(0.0630), 0.184, 0.0243),
    by_points(400_000, 0.00234, Some(0.0780), 0.298, 0.0267),
    by_points(500_000, 0.00292, None, 0.413, 0.0319),
    by_points(600_000, 0.00356, None, 0.530, 0.0358),
    by_points(700_000, 0.00418, None, 0.687, 0.0396),
    by_points(800_000, 0.00471, None, 0.827, 0.0414),
    by_points(900_000, 0.00530, None, 0.967, 0.0453),
    by_points(1_000_000, 0.00589, None, 1.17, 0.0488),
    by_points(2_000_000, 0.0132, None, 2.93, 0.0804),
];

/// Radius of most of its tests, and the one that has the 49 neighbours it gives for it, in diagonals.
pub const R_OVER_L: f64 = 0.01;
/// See [`R_OVER_L`].
pub const R_OVER_L_OF_49: f64 = 0.0131;
/// Queries a millisecond among a million points.
pub const QUERIES_A_MILLISECOND: f64 = 1600.0;
/// Build and transfer of the tree by the time of the query.
pub const BUILD_BY_QUERY: [f64; 2] = [1.6, 2.8];
/// Most traversals that packing saves, in percent.
pub const MERGED_TRAVERSALS: f64 = 99.0;
/// What balancing the load gains its first search, in percent.
pub const LOAD_BALANCING: f64 = 20.0;
/// Growth of a box at which its tree is built anew.
pub const MU: f64 = 10.0;
/// Steps of its random movements.
pub const STEPS: usize = 50;

/// What a reader of the rows must know.
pub const NOTES: [&str; 4] = [
    "The paper gives 49 neighbours on average for 1 M points and r = L/100. By its own set-up, points uniform in [-1, 1]³ and L the diagonal, \
     a ball of that radius away from the faces holds 21.8; 49 need r = 0.0131 L. Both radii are run; mean neighbours are measured.",
    "At a scale below 1 lengths grow by the cube root of what points are fewer, so that a ball holds as many of them; r/L names the \
     paper's radius.",
    "Queries are the points themselves, which saves every tree the first step of its search; lists hold the query itself.",
    "Figures 7 and 9 to 13 of the paper are plots without numbers: crosses stand only where its text or tables give one.",
];
