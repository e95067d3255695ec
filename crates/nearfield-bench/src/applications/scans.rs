//! Scans of meshes as experiments need them: samples with noise in the cube from -1 to 1, and a radius for a number of neighbours.

use std::path::Path;

use nearfield::geometry::generate::{MeshKind, add_noise, mesh, surface_samples};
use nearfield::{FixedRadius, GridSettings, NeighborSearch, TriMesh, UniformGrid, Vec3};

use super::Workshop;
use crate::Result;
use crate::paper::lab::Lab;
use crate::paper::rows::Row;
use crate::sets::SEED;

/// Longest side of a mesh: with its noise and a narrow band it stays in the cube.
const SIDE: f32 = 1.8;
/// Files whose z axis points up; in pictures it is y.
const Z_UP: [&str; 1] = ["nefertiti.obj"];
/// Triangles of the ball that takes the place of a mesh.
const BALL: usize = 20_480;
/// Queries that neighbours are counted at while a radius is looked for.
const COUNTED: usize = 4096;

/// A mesh in the cube, by name.
pub struct Body {
    /// File, or what was made in its place.
    pub name: String,
    /// Without an origin, its longest side 1.8.
    pub mesh: TriMesh,
    /// Diagonal of its box: the paper's L.
    pub diagonal: f64,
}

impl Body {
    /// A file's mesh; a ball where the file is not there.
    ///
    /// # Errors
    /// A file that cannot be read, or a mesh without size.
    pub fn load(folder: &Path, file: &str) -> Result<Self> {
        let path = folder.join(file);
        let (name, found) = if path.is_file() {
            let found =
                nearfield::io::read_mesh(&path, None).map_err(|error| format!("{}: {error}", path.display()))?;
            (file.split('.').next().unwrap_or(file).to_owned(), found)
        } else {
            (format!("ball for {}", file.split('.').next().unwrap_or(file)), mesh(MeshKind::Icosphere, BALL, 0))
        };
        let bounds = found.bounds();
        let longest = bounds.extent().max_element();
        if bounds.is_empty() || !(longest > 0.0 && longest.is_finite()) {
            return Err(format!("{}: a mesh without size", path.display()).into());
        }
        let turned = |v: Vec3| if Z_UP.contains(&file) { Vec3::new(v.x, v.z, -v.y) } else { v };
        let vertices = found.vertices.iter().map(|v| turned(*v - bounds.center()) * (SIDE / longest)).collect();
        let mesh = TriMesh::new(vertices, found.triangles)?;
        let diagonal = f64::from(mesh.bounds().diagonal());
        Ok(Self { name, mesh, diagonal })
    }
}

/// Samples of a body.
pub struct Scan {
    /// What was sampled.
    pub body: Body,
    /// Number of points in the paper.
    pub paper_points: usize,
    /// The samples, with their noise.
    pub points: Vec<Vec3>,
    /// Normals of the triangles that they were taken from.
    pub normals: Vec<Vec3>,
    /// Root of the area that one stands for.
    pub spacing: f64,
}

impl Scan {
    /// As many samples as the paper's times the scale, moved by noise of a deviation of so many spacings along each axis.
    ///
    /// # Errors
    /// As [`Body::load`]; a mesh without area.
    pub fn new(workshop: &Workshop, file: &str, paper_points: usize, noise: f64) -> Result<Self> {
        let body = Body::load(&workshop.data, file)?;
        let n = workshop.lab.points(paper_points);
        let mut samples = surface_samples(&body.mesh, n, SEED);
        if samples.len() < n {
            return Err(format!("{}: a mesh without area", body.name).into());
        }
        let spacing = (body.mesh.area() / n as f64).sqrt();
        if noise > 0.0 {
            add_noise(&mut samples.points, noise * spacing, SEED);
        }
        let normals = samples.normals.take().unwrap_or_default();
        Ok(Self { body, paper_points, points: samples.points, normals, spacing })
    }

    /// The radius within which a point has about so many neighbours, itself included.
    ///
    /// # Errors
    /// As the grid.
    pub fn radius_for(&self, neighbors: f64) -> Result<f32> {
        radius_for(&self.points, self.spacing, neighbors)
    }

    /// A row without a value.
    pub fn row(&self, lab: &Lab, on_gpu: bool, setting: &str, radius: f32, method: &str) -> Row {
        // Enough digits for a reader.
        let r_over_l = (f64::from(radius) / self.body.diagonal * 1e5).round() / 1e5;
        let points = [self.paper_points, self.points.len()];
        Row::new(lab.device(on_gpu), points, setting, [r_over_l, radius.into()], method)
    }
}

/// The radius within which points that are `spacing` apart on a surface have about so many neighbours, themselves included.
///
/// # Errors
/// As the grid.
pub fn radius_for(points: &[Vec3], spacing: f64, neighbors: f64) -> Result<f32> {
    let step = points.len().div_ceil(COUNTED).max(1);
    let queries: Vec<Vec3> = points.iter().copied().step_by(step).collect();
    let mut radius = spacing * (neighbors / std::f64::consts::PI).sqrt();
    let grid = UniformGrid::build(points, &GridSettings::for_radius(radius as f32))?;
    // Neighbours grow with the square of the radius, and with its cube within the noise: the steps shrink quickly.
    for _ in 0..12 {
        let counts = grid.count(&FixedRadius::new(radius as f32).queries(&queries))?;
        let total: u64 = counts.as_slice().iter().map(|&count| u64::from(count)).sum();
        let found = total as f64 / queries.len().max(1) as f64;
        if (found / neighbors - 1.0).abs() < 0.002 {
            break;
        }
        radius *= (neighbors / found.max(1.0)).powf(0.45);
    }
    Ok(radius as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_mesh_is_a_ball_and_its_radius_has_the_neighbors() {
        let body = Body::load(Path::new("no folder"), "bunny.obj").expect("a ball");
        assert_eq!(body.name, "ball for bunny");
        assert!((body.mesh.bounds().extent().max_element() - SIDE).abs() < 1e-5);
        let points = surface_samples(&body.mesh, 5000, 1).points;
        let spacing = (body.mesh.area() / 5000.0).sqrt();
        for neighbors in [25.0, 60.0] {
            let radius = radius_for(&points, spacing, neighbors).expect("a radius");
            let grid = UniformGrid::build(&points, &GridSettings::for_radius(radius)).expect("a grid");
            let counts = grid.count(&FixedRadius::new(radius)).expect("counts");
            let mean = counts.as_slice().iter().map(|&c| f64::from(c)).sum::<f64>() / 5000.0;
            assert!((mean / neighbors - 1.0).abs() < 0.02, "{mean} instead of {neighbors}");
        }
    }
}
