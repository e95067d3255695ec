//! Figures 16 and 17: the surface of a body's field, and the surfaces at a fifth of its diagonal outside and inside, by dual
//! contouring; what they consist of, and how far from the distance they are.

use std::time::Instant;

use nearfield::application::{
    Contour, ContourSettings, DistanceField, DistanceSettings, GpuContour, GpuDistanceField, GpuOrientedSamples,
    MeshDistance, NodeValues, Offset, Watch, contour, contour_on_gpu, grid_around,
};
use nearfield::geometry::mesh_topology::MeshTopology;
use nearfield::gpu::{Buffer, Gpu};
use nearfield::{Aabb, DVec3, RegularGrid, TriMesh, Vec3};
use rayon::prelude::*;

use super::field::Samples;
use super::original::{BAND, OFFSET, RESOLUTION, TABLE_3};
use super::scans::Scan;
use super::{Workshop, picture, plotting, table_3};
use crate::Result;
use crate::measure::{Effort, Measured, repeat};
use crate::paper::rows::{Row, Sheet};

const CONTOURING: &str = "dual contouring";
const FIELD: &str = "field, with build and copies";
/// Vertices whose distance is checked.
const CHECKED: usize = 5000;
/// A vertex may be so many widths off the distance, in the root mean square: offsets have creases, and samples are apart.
const MOST_OFF: f64 = 0.5;

/// Measures the three surfaces and draws them.
///
/// # Errors
/// What a method returns; a wrong answer; a file that cannot be read or written.
pub fn measure(workshop: &Workshop) -> Result<Vec<Row>> {
    let lab = &workshop.lab;
    let mut sheet = Sheet::begin(lab, "figure-17")?;
    let original = &TABLE_3[0];
    let scan = Scan::new(workshop, original.file, original.points, 0.0)?;
    let bounds = Aabb::of_points(&scan.points);
    let side = table_3::resolution(RESOLUTION, scan.points.len(), original.points);
    let narrow = Body { workshop, scan: &scan, grid: grid_around(DVec3::ZERO, &bounds, side, BAND)?, offset: None };
    let mut drawn = Vec::new();
    let inside = -(OFFSET * scan.body.diagonal);
    for distance in [inside, 0.0, -inside] {
        let made = if distance == 0.0 {
            narrow.measure(&mut sheet, "the surface")?
        } else {
            let at = |distance: f64| -> Result<Body<'_>> {
                let offset = Offset::Signed(distance);
                Ok(Body { workshop, scan: &scan, grid: offset.grid(DVec3::ZERO, &bounds, side)?, offset: Some(offset) })
            };
            let body = at(distance)?;
            let depth = if distance < 0.0 { body.depth()? } else { f64::INFINITY };
            if depth > -distance + f64::from(body.grid.spacing()) {
                body.measure(&mut sheet, &format!("{:+} L", distance / scan.body.diagonal))?
            } else {
                // Our body is thinner than the paper's.
                let name = format!("{:+.3} L, half the depth", -0.5 * depth / scan.body.diagonal);
                at(-0.5 * depth)?.measure(&mut sheet, &name)?
            }
        };
        drawn.extend(made);
    }
    let title = "Figures 16 and 17: surfaces of a distance field";
    plotting::over_points(lab, "figure-17.svg", title, "ms", sheet.rows(), &[CONTOURING, FIELD])?;
    picture::meshes(&lab.path("figure-17.png"), &drawn.iter().collect::<Vec<_>>())?;
    Ok(sheet.into_rows())
}

/// Vertices where planes meet, from values that are on the device to triangles there: their number, and the times.
///
/// # Errors
/// As the contouring; no triangle at all.
pub(crate) fn left_on_device(
    gpu: &Gpu,
    field: &GpuDistanceField,
    grid: &RegularGrid,
    level: f32,
    effort: Effort,
) -> Result<(usize, Measured)> {
    // The same bits as f32.
    let raw = field.values().raw().clone();
    let values: Buffer<f32> = Buffer::from_wgpu("values of a field", raw, grid.n_nodes())?;
    let (surface, measured) = repeat(effort, || {
        let surface = GpuContour::of(gpu, grid, &values, level, false, &ContourSettings::default())?;
        Ok((surface, Vec::new()))
    })?;
    let triangles = surface.triangles().len() / 3;
    if triangles == 0 {
        return Err("wrong answer: no triangle of a surface left on the device".into());
    }
    Ok((triangles, measured))
}

/// The topology of a contoured mesh.
///
/// # Errors
/// A mesh that is empty, no manifold, or not oriented.
pub(crate) fn checked_topology(mesh: &TriMesh) -> Result<MeshTopology> {
    let topology = MeshTopology::of(mesh);
    if topology.triangles == 0 || !topology.is_manifold() || !topology.is_oriented() {
        return Err(format!("wrong answer: {topology:?} is no manifold with one side out").into());
    }
    Ok(topology)
}

/// Samples, a grid, and the distance of the surface that is looked for.
struct Body<'a> {
    workshop: &'a Workshop,
    scan: &'a Scan,
    grid: RegularGrid,
    offset: Option<Offset>,
}

impl Body<'_> {
    fn settings(&self) -> DistanceSettings {
        let band = self.offset.map_or(BAND, |offset| offset.band(&self.grid) / f64::from(self.grid.spacing()));
        DistanceSettings::default().band(band)
    }

    fn samples(&self) -> Samples<'_> {
        Samples { points: &self.scan.points, normals: &self.scan.normals }
    }

    /// How deep the body is, as far as the band tells.
    fn depth(&self) -> Result<f64> {
        let field = match self.workshop.lab.gpu() {
            Some(gpu) => self.on_device(gpu)?.read()?,
            None => self.samples().field_on_cpu(&self.grid, &self.settings())?.field,
        };
        let values = field.distances.values();
        Ok(f64::from(-values.iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::min)))
    }

    fn on_device(&self, gpu: &Gpu) -> Result<GpuDistanceField> {
        let samples = GpuOrientedSamples::build(gpu, &self.scan.points, &self.scan.normals)?;
        Ok(samples.distance_field(&self.grid, &self.settings())?)
    }

    fn row(&self, on_gpu: bool, name: &str, method: &str) -> Row {
        let lab = &self.workshop.lab;
        let radius = self.settings().radius(&self.grid) as f32;
        let setting = format!("{}, {} nodes, {name}", self.scan.body.name, self.grid.nodes()[0]);
        self.scan.row(lab, on_gpu, &setting, radius, method)
    }

    /// Adds the rows; the surface, where it was made.
    fn measure(&self, sheet: &mut Sheet<'_>, name: &str) -> Result<Option<TriMesh>> {
        let lab = &self.workshop.lab;
        let (samples, settings) = (self.samples(), self.settings());
        let mut known: Option<(f64, DistanceField)> = None;
        let row = self.row(lab.gpu().is_some(), name, if lab.gpu().is_some() { "GPU" } else { "CPU" });
        sheet.attempt(Row { quantity: FIELD, ..row.clone() }, || {
            let timed = match lab.gpu() {
                Some(gpu) => samples.field_on_gpu(gpu, &self.grid, &settings, lab.effort())?,
                None => samples.field_on_cpu(&self.grid, &settings)?,
            };
            let note = samples.check(&timed.field, &settings)?;
            let mean = samples.mean_neighbors(&timed.field, &settings);
            known = Some((mean, timed.field));
            let row = Row { mean_neighbors: Some(mean), runs: timed.runs, ..row.of(FIELD, "ms") };
            Ok(vec![row.value(timed.total_ms).note(format!("mode plane; {note}"))])
        })?;
        let Some((mean_neighbors, field)) = known else { return Ok(None) };
        let mut surface: Option<(Contour<f32>, TriMesh)> = None;
        for method in ["GPU, left on the device", "GPU", "CPU"] {
            let on_gpu = method != "CPU";
            if on_gpu && lab.gpu().is_none() {
                continue;
            }
            let row = Row { mean_neighbors: Some(mean_neighbors), ..self.row(on_gpu, name, method) };
            sheet.attempt(Row { quantity: CONTOURING, ..row.clone() }, || match (method, lab.gpu()) {
                ("GPU, left on the device", Some(gpu)) => self.left_on_device(gpu, &row),
                ("GPU", Some(gpu)) => self.contoured(&row, &field, &mut surface, |values, settings| {
                    // Kernels are made in a run that is not timed.
                    contour_on_gpu(gpu, values, settings, &mut Watch::none())?;
                    let start = Instant::now();
                    let surface = contour_on_gpu(gpu, values, settings, &mut Watch::none())?;
                    Ok((surface, 1e3 * start.elapsed().as_secs_f64()))
                }),
                _ => self.contoured(&row, &field, &mut surface, |values, settings| {
                    let start = Instant::now();
                    let surface = contour(values, settings, &mut Watch::none())?;
                    Ok((surface, 1e3 * start.elapsed().as_secs_f64()))
                }),
            })?;
        }
        Ok(surface.map(|(_, mesh)| mesh))
    }

    fn left_on_device(&self, gpu: &Gpu, row: &Row) -> Result<Vec<Row>> {
        let level = match self.offset {
            Some(Offset::Signed(distance)) => distance as f32,
            _ => 0.0,
        };
        let (triangles, measured) =
            left_on_device(gpu, &self.on_device(gpu)?, &self.grid, level, self.workshop.lab.effort())?;
        let note =
            format!("{triangles} triangles; vertices where planes meet, before flipped triangles are looked for");
        Ok(vec![Row { runs: measured.runs, ..row.of(CONTOURING, "ms") }.value(measured.wall.median).note(note)])
    }

    fn contoured(
        &self,
        row: &Row,
        field: &DistanceField,
        known: &mut Option<(Contour<f32>, TriMesh)>,
        make: impl FnOnce(&NodeValues<'_, f32>, &ContourSettings) -> nearfield::Result<(Contour<f32>, f64)>,
    ) -> Result<Vec<Row>> {
        let values = match self.offset {
            Some(offset) => offset.values(&field.distances)?,
            None => (&field.distances).into(),
        };
        let (surface, milliseconds) = make(&values, &ContourSettings::default())?;
        let mesh = surface.mesh();
        let topology = checked_topology(&mesh)?;
        let row = Row { runs: 1, ..row.clone() };
        let border = match topology.boundary_loops {
            0 => "closed".to_owned(),
            n => format!("open: {n} border loops, {:.4} long", topology.boundary_length),
        };
        let euler = topology.euler_number();
        let note = format!(
            "{} triangles, manifold, oriented, {border}, {} components, Euler number {euler}; {} intersections left",
            topology.triangles,
            topology.components,
            surface.report().intersections
        );
        let mut rows = vec![row.of(CONTOURING, "ms").value(milliseconds).note(note)];
        if let Some((known, _)) = known {
            let (found, expected) = (&surface, &*known);
            if found.vertices().len() != expected.vertices().len() || found.n_quads() != expected.n_quads() {
                return Err("wrong answer: the devices give different surfaces".into());
            }
            return Ok(rows);
        }
        let off = self.off(&mesh)?;
        if !(off < MOST_OFF) {
            return Err(format!("wrong answer: vertices are {off} widths off their distance").into());
        }
        let note = "distance of vertices from the mesh that was sampled, less that asked for";
        rows.push(row.of("error of the surface, RMS", "widths").value(off).note(note));
        let count = |quantity, value: f64| row.of(quantity, "").value(value).note("counted on the host");
        rows.push(count("triangles", topology.triangles as f64));
        rows.push(count("Euler number", euler as f64));
        rows.push(count("components", topology.components as f64));
        rows.push(count("border loops", topology.boundary_loops as f64));
        *known = Some((surface, mesh));
        Ok(rows)
    }

    /// Root mean square of the error of the distance of some vertices, in widths.
    fn off(&self, mesh: &TriMesh) -> Result<f64> {
        let body = MeshDistance::new(&self.scan.body.mesh)?;
        let wanted = match self.offset {
            Some(Offset::Signed(distance)) => distance.abs(),
            _ => 0.0,
        };
        let step = mesh.vertices.len().div_ceil(CHECKED).max(1);
        let vertices: Vec<&Vec3> = mesh.vertices.iter().step_by(step).collect();
        let square = |v: &&Vec3| {
            let distance = body.signed_distance(v.as_dvec3(), f64::INFINITY).map_or(f64::NAN, |found| found.0.abs());
            (distance - wanted).powi(2)
        };
        let squares: f64 = vertices.par_iter().map(square).sum();
        Ok((squares / vertices.len().max(1) as f64).sqrt() / f64::from(self.grid.spacing()))
    }
}
