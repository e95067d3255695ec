//! Methods of the CPU over the library's structures: built anew in every step.

use nearfield::{FixedRadius, Nearest, NeighborSearch, Vec3};

use super::{Found, Method, NearestFound, Positions, Update};
use crate::Result;

type Build<S> = Box<dyn Fn(&[Vec3]) -> nearfield::Result<S>>;

/// A structure that is built anew whenever points move.
pub(super) struct Rebuilt<S> {
    build: Build<S>,
    structure: S,
}

impl<S: NeighborSearch> Rebuilt<S> {
    pub(super) fn new(build: impl Fn(&[Vec3]) -> nearfield::Result<S> + 'static, at: &Positions) -> Result<Self> {
        let structure = build(&at.host)?;
        Ok(Self { build: Box::new(build), structure })
    }
}

impl<S: NeighborSearch> Method for Rebuilt<S> {
    fn update(&mut self, at: &Positions) -> Result<Update> {
        self.structure = (self.build)(&at.host)?;
        Ok(Update { stages: self.structure.build_stages(), rebuilt: true })
    }

    fn list(&mut self, radius: f32) -> Result<Found> {
        Ok(Found::OnHost(self.structure.list(&FixedRadius::new(radius))?))
    }

    fn nearest(&mut self, radius: f32) -> Result<Nearest> {
        Ok(self.structure.nearest(&FixedRadius::new(radius).exclude_self())?)
    }

    fn list_around(&mut self, queries: &Positions, radius: f32) -> Result<Found> {
        Ok(Found::OnHost(self.structure.list(&FixedRadius::new(radius).queries(&queries.host))?))
    }

    fn nearest_around(&mut self, queries: &Positions, radius: f32) -> Result<NearestFound> {
        Ok(self.structure.nearest(&FixedRadius::new(radius).queries(&queries.host))?.into())
    }

    fn memory_bytes(&self) -> u64 {
        self.structure.memory_bytes()
    }
}
