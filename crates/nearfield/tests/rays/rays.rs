//! Rays of every kind into a mesh.

use nearfield::{Ray, TriMesh, Vec3};

use crate::support::Random;

/// What rays of a set have in common.
pub(crate) const KINDS: &[&str] = &[
    "random",
    "along axes",
    "at vertices",
    "at edges",
    "from surfaces",
    "from planes",
    "from afar",
    "with limits",
    "along edges",
];

struct Source<'a> {
    mesh: &'a TriMesh,
    random: Random,
    center: Vec3,
    reach: f32,
}

impl Source<'_> {
    fn unit(&mut self) -> f32 {
        self.random.unit()
    }

    fn direction(&mut self) -> Vec3 {
        let mut component = || 2.0 * self.unit() - 1.0;
        let direction = Vec3::new(component(), component(), component());
        if direction.length() < 1e-3 { Vec3::X } else { direction }
    }

    /// In the box around the mesh, half as large again.
    fn place(&mut self) -> Vec3 {
        let (center, reach) = (self.center, self.reach);
        let mut component = || 1.5 * (self.unit() - 0.5);
        center + Vec3::new(component(), component(), component()) * reach
    }

    fn triangle(&mut self) -> [Vec3; 3] {
        let i = self.random.below(self.mesh.triangles.len() as u32) as usize;
        let t = self.mesh.triangle(i);
        [t.a, t.b, t.c]
    }

    fn axis(&mut self) -> Vec3 {
        [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z][self.random.below(6) as usize]
    }

    fn ray(&mut self, kind: &str) -> Ray {
        match kind {
            "along axes" => {
                let axis = self.axis();
                // Half of them through a vertex, where planes of boxes lie.
                let through = if self.random.below(2) == 0 { self.triangle()[0] } else { self.place() };
                Ray::new(through - axis * ((1.5 + self.unit()) * self.reach), axis)
            }
            "at vertices" => {
                let (from, at) = (self.place(), self.triangle()[1]);
                toward(from, at)
            }
            "at edges" => {
                let (from, [a, b, _], share) = (self.place(), self.triangle(), self.unit());
                toward(from, a + share * (b - a))
            }
            "from surfaces" => {
                let ([a, b, c], u, v) = (self.triangle(), self.unit(), self.unit());
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                Ray::new(a + u * (b - a) + v * (c - a), self.direction())
            }
            "from planes" => {
                // Coordinates of vertices and of the centre are where trees are cut.
                let (a, b, c) = (self.triangle()[0], self.center, self.triangle()[2]);
                let pick = |source: &mut Self, x: f32, y: f32, z: f32| [x, y, z][source.random.below(3) as usize];
                let origin = Vec3::new(pick(self, a.x, b.x, c.x), pick(self, a.y, b.y, c.y), pick(self, a.z, b.z, c.z));
                let direction = self.direction();
                let zero = self.random.below(4);
                let mut direction = direction.to_array();
                if zero < 3 {
                    direction[zero as usize] = 0.0;
                }
                Ray::new(origin, Vec3::from_array(direction) + self.axis())
            }
            "from afar" => {
                let at = self.place();
                let from = at + self.direction().normalize() * (1e3 * self.reach);
                Ray::new(from, (at - from) * 1e-3)
            }
            "with limits" => {
                let (from, at) = (self.place(), self.place());
                let (low, length) = (self.unit(), self.unit());
                Ray { t_min: low, t_max: low + length, ..toward(from, at) }
            }
            "along edges" => {
                let ([a, b, _], before) = (self.triangle(), self.unit());
                Ray::new(a - before * (b - a), b - a)
            }
            _ => Ray::new(self.place(), self.direction()),
        }
    }
}

/// A ray that reaches `at` at t = 1; another direction where it starts there.
fn toward(from: Vec3, at: Vec3) -> Ray {
    let direction = at - from;
    Ray::new(from, if direction.length() > 0.0 { direction } else { Vec3::X })
}

/// `n` rays of a kind, all of them castable.
pub(crate) fn rays(mesh: &TriMesh, kind: &str, n: usize, seed: u64) -> Vec<Ray> {
    let bounds = mesh.bounds();
    let reach = bounds.extent().max_element().max(1e-30);
    let mut source = Source { mesh, random: Random(seed), center: bounds.center(), reach };
    (0..n)
        .map(|_| source.ray(kind))
        .map(|ray| if ray.fault().is_some() { Ray::new(ray.origin, Vec3::Y) } else { ray })
        .collect()
}

/// Rays that cannot miss a closed mesh, from places inside it and at them from beyond it, through vertices, edges and faces:
/// the rays, and whether each must hit at t <= 1 already.
pub(crate) fn cannot_miss(mesh: &TriMesh, inside: &[Vec3], n: usize, seed: u64) -> Vec<(Ray, bool)> {
    let bounds = mesh.bounds();
    let reach = bounds.extent().max_element();
    let mut source = Source { mesh, random: Random(seed), center: bounds.center(), reach };
    (0..n)
        .map(|i| {
            let place = inside[source.random.below(inside.len() as u32) as usize];
            let ([a, b, c], u, v) = (source.triangle(), source.unit(), source.unit());
            let through = match i % 5 {
                0 => a,
                1 => a + u * (b - a),
                2 => a + u * (b - a) + (1.0 - u) * v * (c - a),
                3 => place + source.axis() * reach,
                _ => place + source.direction() * reach,
            };
            if i / 5 % 2 == 0 {
                return (toward(place, through), false);
            }
            // Beyond the bounds, whatever lies between.
            let away = (through - place).normalize_or(Vec3::X);
            (toward(place + away * (3.0 * reach), place), true)
        })
        .collect()
}

/// How many of the rays differ.
pub(crate) fn distinct(rays: &[Ray]) -> usize {
    let bits = |ray: &Ray| [ray.origin.to_array(), ray.direction.to_array(), [ray.t_min, ray.t_max, 0.0]];
    let mut all: Vec<[[u32; 3]; 3]> = rays.iter().map(|ray| bits(ray).map(|row| row.map(f32::to_bits))).collect();
    all.sort_unstable();
    all.dedup();
    all.len()
}
