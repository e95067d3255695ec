//! The named clouds that every structure on every device must search without a mistake.

use nearfield::Vec3;
use nearfield::geometry::generate::{self, CloudKind, MeshKind};

use crate::random::Random;

/// A cloud, other query points around it, and a radius that fits it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Case {
    pub(crate) points: Vec<Vec3>,
    /// Query points that are not the cloud's own.
    pub(crate) queries: Vec<Vec3>,
    pub(crate) radius: f32,
    /// Length per axis; 0 where not periodic.
    pub(crate) period: Vec3,
    /// Neighbours of all points within the radius, each its own included, where known by hand.
    pub(crate) total: Option<u64>,
    /// All differences, squares and sums are exact in f32: devices must agree in every bit.
    pub(crate) exact: bool,
}

impl Case {
    fn new(points: Vec<Vec3>, radius: f32) -> Self {
        let queries = around(&points, radius);
        Self { points, queries, radius, ..Self::default() }
    }

    fn total(mut self, total: u64) -> Self {
        self.total = Some(total);
        self
    }

    fn exact(mut self) -> Self {
        self.exact = true;
        self
    }

    fn queries(mut self, queries: Vec<Vec3>) -> Self {
        self.queries = queries;
        self
    }

    fn periodic(mut self, x: f32, y: f32, z: f32) -> Self {
        self.period = Vec3::new(x, y, z);
        self
    }
}

/// A case's name and how to make it.
pub(crate) struct Named {
    pub(crate) name: &'static str,
    /// The file of real data it needs.
    pub(crate) file: Option<&'static str>,
    pub(crate) make: fn() -> Case,
}

macro_rules! cases {
    ($($name:literal => $make:expr;)*) => {
        /// Every case.
        pub(crate) const CASES: &[Named] = &[$(Named { name: $name, file: None, make: || $make }),*];
    };
}

cases! {
    "empty" => Case::new(vec![], 0.5).queries(vec![Vec3::ZERO, Vec3::ONE]).total(0).exact();
    "one-point" => Case::new(vec![Vec3::new(1.5, -2.0, 0.25)], 0.5).total(1).exact();
    "two-equal-points" => Case::new(vec![Vec3::splat(0.25); 2], 0.5).total(4).exact();
    "all-equal" => Case::new(vec![Vec3::new(0.5, -7.0, 3.25); 1000], 0.25).total(1_000_000).exact();
    "duplicate-pairs" => duplicate_pairs();
    "line" => Case::new(line(), 0.01);
    "diagonal-line" => Case::new(line().into_iter().map(|p| Vec3::splat(p.x)).collect(), 0.02);
    "plane" => Case::new(plane(), 0.06);
    "lattice-radius-is-the-spacing" => Case::new(lattice(10, 0.25), 0.25).total(lattice_total(10, 1)).exact();
    "lattice-radius-is-twice-the-spacing" => Case::new(lattice(10, 0.25), 0.5).total(lattice_total(10, 4)).exact();
    "lattice-radius-is-thrice-the-spacing" => Case::new(lattice(9, 0.25), 0.75).total(lattice_total(9, 9)).exact();
    "boundary-one-half" => boundary(0.5);
    "boundary-one-quarter" => boundary(0.25);
    "one-ulp-beyond-the-boundary" => one_ulp_beyond();
    "one-ulp-neighbors" => one_ulp_neighbors();
    "points-on-cell-borders" => cell_borders();
    "signed-zeros" => signed_zeros();
    "denormals" => denormals();
    "scale-1e-18" => scaled(1e-18, Vec3::ZERO);
    "scale-1e17" => scaled(1e17, Vec3::ZERO);
    "offset-1e7" => scaled(100.0, Vec3::new(1e7, -1e7, 3e6));
    "offset-1e7-integers" => offset_integers();
    "edge-of-the-domain" => Case::new(vec![Vec3::splat(1e18), Vec3::splat(-1e18), Vec3::ZERO, Vec3::splat(9e17)], 2e17).total(6);
    "outlier-a-million-cells-away" => outlier();
    "two-clusters-1e12-apart" => two_clusters();
    "negative-coordinates" => scaled(1.0, Vec3::new(-20.0, -0.5, -300.0));
    "rows-longer-than-a-table" => long_rows();
    "size-2" => random_cube(2, 0.5);
    "size-31" => random_cube(31, 0.3);
    "size-32" => random_cube(32, 0.3);
    "size-33" => random_cube(33, 0.3);
    "size-1000" => random_cube(1000, 0.12);
    "size-4097" => random_cube(4097, 0.06);
    "uniform" => generated(CloudKind::Uniform, 3000, 0.15);
    "clustered" => generated(CloudKind::Clustered, 3000, 0.02);
    "shell" => generated(CloudKind::Shell, 3000, 0.2);
    "plummer" => generated(CloudKind::Plummer, 2000, 0.1);
    "lidar" => generated(CloudKind::Lidar, 4000, 0.4);
    "terrain" => generated(CloudKind::Terrain, 3000, 0.0);
    "mesh-vertices" => Case::new(generate::mesh(MeshKind::Torus, 3000, 1).vertices, 0.12);
    "coarse-and-fine" => coarse_and_fine();
    "periodic-x" => periodic(600, 0.09, [1.0, 0.0, 0.0], 0.0);
    "periodic-xyz" => periodic(600, 0.12, [1.0, 1.0, 1.0], 0.0);
    "periodic-yz-odd-lengths" => periodic(600, 0.1, [0.0, 0.7, 1.3], 0.0);
    "periodic-outside-the-domain" => periodic(500, 0.11, [1.0, 0.7, 0.9], 3.0);
    "periodic-far-outside-the-domain" => periodic(500, 0.11, [1.0, 0.7, 0.9], 1000.0);
    "periodic-radius-beyond-half-a-period" => periodic(200, 0.8, [1.0, 1.5, 1.0], 0.0);
    "periodic-lattice" => Case::new(lattice(8, 0.125), 0.125).periodic(1.0, 1.0, 1.0).total(512 * 7).exact();
    "periodic-lattice-half-a-period" => Case::new(lattice(8, 0.125), 0.5).periodic(1.0, 1.0, 1.0).exact();
    "periodic-lattice-shifted-by-whole-periods" => shifted_lattice();
    "periodic-one-cell" => periodic(40, 0.9, [1.0, 1.0, 1.0], 0.0);
    "periodic-empty" => Case::new(vec![], 0.5).periodic(1.0, 1.0, 1.0).queries(vec![Vec3::ONE]).total(0).exact();
}

/// Real scans and meshes, thinned to what a software device searches in a moment.
#[cfg(feature = "io")]
pub(crate) const SCANS: &[Named] = &[
    Named { name: "scan-terrain", file: Some("terrain-csite1.pcd"), make: || scan("terrain-csite1.pcd", 8.0) },
    Named { name: "scan-autzen", file: Some("autzen-trim.laz"), make: || scan("autzen-trim.laz", 12.0) },
    Named { name: "scan-bunny", file: Some("stanford-bunny.obj"), make: || scan("stanford-bunny.obj", 0.003) },
];
#[cfg(not(feature = "io"))]
pub(crate) const SCANS: &[Named] = &[];

/// Every case and scan by number.
pub(crate) fn all() -> impl Iterator<Item = &'static Named> {
    CASES.iter().chain(SCANS)
}

/// At most this many points of a scan.
#[cfg(feature = "io")]
const SCAN_POINTS: usize = 6000;

#[cfg(feature = "io")]
fn scan(file: &str, radius: f32) -> Case {
    let path = crate::support::data_folder().join(file);
    let cloud = nearfield::io::read_cloud(&path, None).expect("real data should be readable");
    let step = cloud.len().div_ceil(SCAN_POINTS);
    Case::new(cloud.points.into_iter().step_by(step).collect(), radius)
}

/// Queries: some of the points, points beside them, and points far from everything.
fn around(points: &[Vec3], radius: f32) -> Vec<Vec3> {
    let mut random = Random::new(0x51de);
    let mut queries = vec![Vec3::ZERO, Vec3::splat(-3.0 * radius), Vec3::new(1e9, -1e9, 1e9)];
    for _ in 0..points.len().clamp(1, 97) {
        let Some(&p) = points.get(random.below(points.len().max(1))) else { continue };
        let shift = (random.point() - Vec3::splat(0.5)) * (2.0 * radius);
        queries.extend([p, (p + shift).clamp(Vec3::splat(-1e18), Vec3::splat(1e18))]);
    }
    queries
}

fn random_points(n: usize, seed: u64) -> Vec<Vec3> {
    let mut random = Random::new(seed);
    (0..n).map(|_| random.point()).collect()
}

fn random_cube(n: usize, radius: f32) -> Case {
    Case::new(random_points(n, n as u64), radius)
}

fn generated(kind: CloudKind, n: usize, radius: f32) -> Case {
    let points = generate::cloud(kind, n, 7).points;
    let (low, high) = points.iter().fold((points[0], points[0]), |(l, h), &p| (l.min(p), h.max(p)));
    Case::new(points, if radius > 0.0 { radius } else { 0.03 * (high - low).length() })
}

fn scaled(scale: f32, offset: Vec3) -> Case {
    let points = random_points(700, 11).into_iter().map(|p| (p - Vec3::splat(0.3)) * scale + offset).collect();
    Case::new(points, 0.11 * scale)
}

fn line() -> Vec<Vec3> {
    let mut random = Random::new(3);
    (0..900).map(|_| Vec3::new(random.between(-1.0, 1.0), 0.0, 0.0)).collect()
}

fn plane() -> Vec<Vec3> {
    random_points(1200, 5).into_iter().map(|p| Vec3::new(p.x, 0.75, p.z)).collect()
}

fn lattice(edge: u32, spacing: f32) -> Vec<Vec3> {
    let at = |i: u32| i as f32 * spacing;
    (0..edge.pow(3)).map(|i| Vec3::new(at(i % edge), at(i / edge % edge), at(i / edge / edge))).collect()
}

/// Pairs of lattice points whose squared distance is at most `limit` squared spacings, in whole numbers.
fn lattice_total(edge: i64, limit: i64) -> u64 {
    let pairs = |d: i64| (edge - d.abs()).max(0);
    let steps = || -edge..=edge;
    let offsets = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| (x, y, z))));
    let near = offsets.filter(|(x, y, z)| x * x + y * y + z * z <= limit);
    near.map(|(x, y, z)| (pairs(x) * pairs(y) * pairs(z)) as u64).sum()
}

fn duplicate_pairs() -> Case {
    let points: Vec<Vec3> = random_points(300, 9).into_iter().flat_map(|p| [p, p]).collect();
    Case::new(points, 0.15)
}

/// Pairs exactly `radius` apart along each axis, both ways: all are neighbours.
fn boundary(radius: f32) -> Case {
    let mut points = vec![];
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let mut step = Vec3::ZERO;
            step[axis] = sign * radius;
            let first = Vec3::splat(8.0 * points.len() as f32);
            points.extend([first, first + step]);
        }
    }
    Case::new(points, radius).total(6 * 4).exact()
}

/// Pairs one ulp of the coordinate more than 0.5 and 0.25 apart: none are neighbours.
fn one_ulp_beyond() -> Case {
    let points = vec![
        Vec3::new(0.25, 0.0, 0.0),
        Vec3::new(0.75f32.next_up(), 0.0, 0.0),
        Vec3::new(0.0, 64.0, 0.0),
        Vec3::new(0.0, 64.5f32.next_up(), 0.0),
        Vec3::new(0.0, 0.0, -64.0),
        Vec3::new(0.0, 0.0, (-64.5f32).next_down()),
    ];
    Case::new(points, 0.5).total(6)
}

fn one_ulp_neighbors() -> Case {
    let mut points = vec![];
    let mut p = Vec3::new(1.0, -3.0, 0.1);
    for i in 0..90 {
        points.push(p);
        p[i % 3] = p[i % 3].next_up();
    }
    Case::new(points, 1e-6)
}

/// Points on, just below and just above the borders of cells as large as the radius.
fn cell_borders() -> Case {
    let border = |i: usize| i as f32 * 0.1;
    let near = |i: usize, side: usize| [border(i).next_down(), border(i), border(i).next_up()][side];
    let points = (0..729).map(|i| {
        let (cell, side) = (i % 27, i / 27);
        let axis = |k: usize| near(cell / [1, 3, 9][k] % 3 + 1, side / [1, 3, 9][k] % 3);
        Vec3::new(axis(0), axis(1), axis(2))
    });
    Case::new(points.collect(), 0.1)
}

fn signed_zeros() -> Case {
    let zero = |bit: usize| if bit & 1 == 1 { -0.0 } else { 0.0 };
    let mut points: Vec<Vec3> = (0..64).map(|i| Vec3::new(zero(i), zero(i / 2), zero(i / 4))).collect();
    points.extend([Vec3::new(0.5, -0.0, 0.0), Vec3::new(-0.0, 0.0, -0.5)]);
    Case::new(points, 0.5).total(64 * 64 + 2 * 64 * 2 + 2).exact()
}

/// Coordinates too small for normal numbers: every difference has a square of zero.
fn denormals() -> Case {
    let points = (0..120u32).map(|i| Vec3::new(f32::from_bits(i), -f32::from_bits(i * 77), f32::from_bits(i % 7)));
    Case::new(points.collect(), 1.2e-19).total(120 * 120)
}

fn offset_integers() -> Case {
    let mut random = Random::new(21);
    let mut whole = || random.below(24) as f32;
    let points = (0..800).map(|_| Vec3::new(1e7 + whole(), -1e7 + whole(), 5e6 + whole())).collect();
    Case::new(points, 3.0).exact()
}

fn outlier() -> Case {
    let mut points = random_points(900, 13);
    points.insert(400, Vec3::new(1e5, -1e5, 1e5));
    Case::new(points, 0.1)
}

fn two_clusters() -> Case {
    let mut points = random_points(300, 17);
    points
        .extend(random_points(300, 18).into_iter().map(|p| (p - Vec3::splat(0.5)) * 4e5 + Vec3::new(1e12, 0.0, -1e12)));
    points.extend([Vec3::splat(-5e11), Vec3::new(0.0, 1e12, 0.0)]);
    Case::new(points, 0.2)
}

/// A sparse line whose row has far more cells than a hashed table has entries.
fn long_rows() -> Case {
    let mut random = Random::new(19);
    let mut points: Vec<Vec3> = (0..500).map(|_| Vec3::new(random.between(0.0, 1e5), random.unit(), 0.0)).collect();
    points.push(Vec3::new(3.0, 4e4, -4e4));
    Case::new(points, 90.0)
}

/// Spacing that grows a thousandfold across the cloud.
fn coarse_and_fine() -> Case {
    let mut random = Random::new(23);
    let mut point = || {
        let scale = 10f32.powi(-(random.below(4) as i32));
        random.normal() * scale
    };
    Case::new((0..1500).map(|_| point()).collect(), 0.05)
}

/// A random cloud in a periodic box, each point moved by up to `turns` whole periods an axis.
fn periodic(n: usize, radius: f32, lengths: [f32; 3], turns: f32) -> Case {
    let mut random = Random::new(29);
    let lengths = Vec3::from_array(lengths);
    let size = Vec3::select(lengths.cmpgt(Vec3::ZERO), lengths, Vec3::ONE);
    let mut point = || random.point() * size + (random.normal() * (turns / 3.0)).round() * lengths;
    let points: Vec<Vec3> = (0..n).map(|_| point()).collect();
    let queries = (0..60).map(|_| point()).collect();
    Case::new(points, radius).periodic(lengths.x, lengths.y, lengths.z).queries(queries)
}

fn shifted_lattice() -> Case {
    let mut random = Random::new(31);
    let mut turns = || random.below(2001) as f32 - 1000.0;
    let points = lattice(8, 0.125).into_iter().map(|p| p + Vec3::new(turns(), turns(), turns())).collect();
    Case::new(points, 0.125).periodic(1.0, 1.0, 1.0).total(512 * 7).exact()
}
