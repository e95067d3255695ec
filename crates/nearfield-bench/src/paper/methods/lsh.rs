//! The paper's baseline of locality-sensitive hashing: approximate, tables built anew in every step. Sources: Datar2004, Pan2011.
//!
//! Its points come from the host and its lists go back there, which the device's clock does not see.

use nearfield::Gpu;

use super::{Found, Method, Plug, Positions, Update};
use crate::Result;
use crate::baselines::lsh::{GpuLsh, HashFamily, LshSettings};
use crate::baselines::{MOST_K, Points, Queries};

/// Built and asked on the GPU: eight tables of eight projections.
pub const ON_GPU: Plug = Plug {
    name: "LSH, GPU",
    on_gpu: true,
    color: 6,
    make: |start| {
        let points = Points::in_space(&start.at.host)?;
        let k = (start.mean_neighbors.round() as usize).clamp(1, MOST_K);
        let family = HashFamily::draw(&points, &LshSettings::for_k(k))?;
        let tables = Some(GpuLsh::build(start.gpu(), &points, &family)?);
        Ok(Box::new(Lsh { gpu: start.gpu().clone(), family, tables }))
    },
};

struct Lsh {
    gpu: Gpu,
    family: HashFamily,
    tables: Option<GpuLsh>,
}

impl Lsh {
    fn tables(&self) -> &GpuLsh {
        self.tables.as_ref().expect("tables should stand between updates")
    }
}

impl Method for Lsh {
    fn update(&mut self, at: &Positions) -> Result<Update> {
        // Their memory serves the next.
        self.tables = None;
        self.tables = Some(GpuLsh::build(&self.gpu, &Points::in_space(&at.host)?, &self.family)?);
        Ok(Update { stages: self.tables().build_stages().to_vec(), rebuilt: true })
    }

    fn list(&mut self, radius: f32) -> Result<Found> {
        let timed = self.tables().list_within(Queries::Points, radius)?;
        Ok(Found::Baseline { rows: timed.answer, stages: timed.stages, is_exact: false })
    }

    fn memory_bytes(&self) -> u64 {
        self.tables().memory_bytes()
    }
}
