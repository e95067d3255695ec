//! Methods of the GPU over the library's structures: built anew in every step.

use nearfield::gpu::Buffer;
use nearfield::structure::DevicePoint;
use nearfield::{FixedRadius, Nearest, NeighborSearch, SearchOnDevice};

use super::{Found, Method, NearestFound, Positions, Update};
use crate::Result;

/// What builds a structure of points on the device.
pub(super) trait Builds {
    type Structure: SearchOnDevice + NeighborSearch;

    fn build(&mut self, points: &Buffer<DevicePoint>) -> nearfield::Result<Self::Structure>;
}

/// A structure that is built anew whenever points move.
pub(super) struct Rebuilt<B: Builds> {
    builder: B,
    structure: Option<B::Structure>,
}

impl<B: Builds> Rebuilt<B> {
    pub(super) fn new(mut builder: B, at: &Positions) -> Result<Self> {
        let structure = Some(builder.build(at.on_device())?);
        Ok(Self { builder, structure })
    }

    fn structure(&self) -> &B::Structure {
        self.structure.as_ref().expect("a structure should stand between updates")
    }
}

impl<B: Builds> Method for Rebuilt<B> {
    fn update(&mut self, at: &Positions) -> Result<Update> {
        // Its memory serves the next.
        self.structure = None;
        self.structure = Some(self.builder.build(at.on_device())?);
        Ok(Update { stages: NeighborSearch::build_stages(self.structure()), rebuilt: true })
    }

    fn list(&mut self, radius: f32) -> Result<Found> {
        Ok(Found::OnDevice(self.structure().list_on_device(&FixedRadius::new(radius))?))
    }

    fn nearest(&mut self, radius: f32) -> Result<Nearest> {
        Ok(self.structure().nearest(&FixedRadius::new(radius).exclude_self())?)
    }

    fn list_around(&mut self, queries: &Positions, radius: f32) -> Result<Found> {
        Ok(Found::OnDevice(self.structure().list_on_device(&FixedRadius::new(radius).queries(&queries.host))?))
    }

    fn nearest_around(&mut self, queries: &Positions, radius: f32) -> Result<NearestFound> {
        Ok(self.structure().nearest(&FixedRadius::new(radius).queries(&queries.host))?.into())
    }

    fn memory_bytes(&self) -> u64 {
        NeighborSearch::memory_bytes(self.structure())
    }
}
