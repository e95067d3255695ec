//! Queries that are on the device already, and visitors recorded into a caller's commands: a step of a computation that
//! never leaves the device.

use glam::Vec3;

use super::loops::VisitorRounds;
use super::visit::{self, QueryBuffers, VisitorCode};
use super::visitor::Visitor;
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, Commands};
use crate::query::{FixedRadius, Queries, Radius};
use crate::structure::{DevicePoint, GpuStructure};
use crate::{Error, Result};

/// Queries in device memory.
///
/// A query has its slot as the bits of its fourth value: `Query::slot` in a visitor, the place of its radius and, with
/// `exclude_self`, the index of the point that it is. Slots are 0 to n − 1 in any order; queries with others are skipped.
/// Neighbouring queries should lie near each other, as those of [`GpuStructure::points`] do.
#[derive(Debug, Clone, Copy)]
pub struct DeviceQueries<'a> {
    /// `[n]` xyz and slot.
    pub points: &'a Buffer<DevicePoint>,
    /// The radius of all; where each has its own, the largest.
    pub radius: f32,
    /// `[n]` radii by slot, none above `radius`.
    pub radii: Option<&'a Buffer<f32>>,
    /// Leave out the point whose index is the query's slot.
    pub exclude_self: bool,
}

impl<'a> DeviceQueries<'a> {
    /// Queries with one radius.
    pub fn new(points: &'a Buffer<DevicePoint>, radius: f32) -> Self {
        Self { points, radius, radii: None, exclude_self: false }
    }

    /// With a radius for each, by slot, none above the one given before.
    pub fn radii(mut self, radii: &'a Buffer<f32>) -> Self {
        self.radii = Some(radii);
        self
    }

    /// Leaves out the point that a query is.
    pub fn exclude_self(mut self) -> Self {
        self.exclude_self = true;
        self
    }

    fn validate(&self) -> Result<()> {
        crate::geometry::validate::radius(self.radius, None)?;
        match self.radii {
            Some(radii) if radii.len() < self.points.len() => Err(Error::LengthMismatch {
                what: "the buffer of radii",
                found: radii.len() as u64,
                expected: self.points.len() as u64,
            }),
            _ => Ok(()),
        }
    }

    /// Two corners of a box around the queries. Only devices that end long loops need them, for which the queries are read.
    fn corners<S: GpuStructure>(&self, structure: &S) -> Result<[Vec3; 2]> {
        let gpu = structure.gpu();
        if gpu.limits().loop_rounds.is_none() || self.points.is_empty() {
            return Ok([Vec3::ZERO; 2]);
        }
        let at = |p: &DevicePoint| Vec3::new(p[0], p[1], p[2]);
        let points: Vec<Vec3> = gpu.read(self.points)?.iter().map(at).filter(|p| p.is_finite()).collect();
        let bounds = crate::parallel::reduce::bounds(&points);
        Ok(if bounds.is_empty() { [Vec3::ZERO; 2] } else { [bounds.min, bounds.max] })
    }
}

/// A visitor that is a module of the library.
#[derive(Debug, Clone, Copy)]
pub(crate) struct VisitorModule<'a> {
    /// Its path.
    pub(crate) module: &'static str,
    /// Conditions that it is compiled with.
    pub(crate) features: &'a [(&'a str, bool)],
    /// Its bindings in `@group(1)`, in order.
    pub(crate) bindings: &'a [(Access, Bind)],
    /// Most rounds of loops in a call of `visit`, and in `finish`.
    pub(crate) rounds: [u64; 2],
    /// Whether it can combine states: `VisitorCode::combines`.
    pub(crate) combines: bool,
}

/// Records `visitor` over the queries; nothing runs before the commands are submitted.
///
/// # Errors
/// As [`super::ForEachOnDevice::record_for_each`].
pub(crate) fn record_module<S: GpuStructure>(
    commands: &mut Commands,
    structure: &S,
    queries: &DeviceQueries<'_>,
    visitor: &VisitorModule<'_>,
) -> Result<()> {
    let [each, finish] = visitor.rounds;
    let accesses: Vec<Access> = visitor.bindings.iter().map(|(access, _)| *access).collect();
    let code = VisitorCode {
        source: Fill::Module(visitor.module),
        features: visitor.features,
        accesses: &accesses,
        rounds: VisitorRounds { each, finish },
        combines: visitor.combines,
    };
    record(commands, structure, queries, &code, visitor.bindings)
}

/// The same with a caller's code.
pub(super) fn record_caller<S: GpuStructure>(
    commands: &mut Commands,
    structure: &S,
    queries: &DeviceQueries<'_>,
    visitor: &Visitor<'_>,
) -> Result<()> {
    let accesses: Vec<Access> = visitor.bindings.iter().map(|(access, _)| *access).collect();
    record(commands, structure, queries, &visitor.code(&accesses), visitor.bindings)
}

fn record<S: GpuStructure>(
    commands: &mut Commands,
    structure: &S,
    queries: &DeviceQueries<'_>,
    code: &VisitorCode<'_>,
    bindings: &[(Access, Bind)],
) -> Result<()> {
    queries.validate()?;
    let corners = queries.corners(structure)?;
    let largest = [queries.radius];
    // What the kernels are told of the question; the queries themselves and their radii are buffers.
    let question = FixedRadius {
        queries: Queries::Other(&corners),
        radius: if queries.radii.is_some() { Radius::Each(&largest) } else { Radius::One(queries.radius) },
        exclude_self: queries.exclude_self,
        ..FixedRadius::new(queries.radius)
    };
    let radii = match queries.radii {
        Some(radii) => radii.clone(),
        None => structure.gpu().upload("radius", &largest)?,
    };
    let buffers = QueryBuffers::on_device(structure, &question, queries.points.clone(), radii)?;
    let binds: Vec<Bind> = bindings.iter().map(|(_, bind)| bind.clone()).collect();
    visit::record(commands, structure, &question, &buffers, code, &binds)
}
