//! The paper's baseline of shifted sorts: approximate, everything done anew in every query. Source: Li2012.
//!
//! As in the paper k is the mean number of neighbours of the range search; what of the k nearest lies beyond the radius is left out
//! when recall is measured. Five shifts.

use nearfield::Error;
use nearfield::gpu::{Buffer, Gpu};
use nearfield::structure::DevicePoint;

use super::{Found, Method, NearestFound, Plug, Positions, Update, nearest_within};
use crate::Result;
use crate::baselines::MOST_K;
use crate::baselines::shifted_sort::{Asks, GpuShiftedSort, ShiftedSortSettings};
use crate::paper::lab::cube;

/// Sorted and asked on the GPU.
pub const ON_GPU: Plug = Plug {
    name: "shifted sort, GPU",
    on_gpu: true,
    color: 2,
    make: |start| {
        let k = start.mean_neighbors.round().max(1.0) as usize;
        if k > MOST_K {
            let what = format!("a shifted sort for the {k} nearest");
            return Err(Error::Unsupported { what, advice: "it keeps at most 128" }.into());
        }
        let plan = GpuShiftedSort::new(start.gpu(), start.at.host.len(), ShiftedSortSettings::new(k))?;
        let (gpu, points) = (start.gpu().clone(), start.at.on_device().clone());
        Ok(Box::new(ShiftedSort { gpu, plan, k, points, n: start.at.host.len() as u64 }))
    },
};

struct ShiftedSort {
    gpu: Gpu,
    plan: GpuShiftedSort,
    k: usize,
    points: Buffer<DevicePoint>,
    n: u64,
}

impl Method for ShiftedSort {
    /// Nothing: the sorts are part of the query.
    fn update(&mut self, at: &Positions) -> Result<Update> {
        self.points = at.on_device().clone();
        Ok(Update { stages: Vec::new(), rebuilt: true })
    }

    fn list(&mut self, radius: f32) -> Result<Found> {
        let rows = self.plan.run(&self.points, &cube(), Asks::Points { without_self: false })?;
        Ok(Found::NearestRows { k: self.k, rows, radius })
    }

    fn list_around(&mut self, queries: &Positions, radius: f32) -> Result<Found> {
        let rows = self.plan.run(&self.points, &cube(), Asks::Other(queries.on_device()))?;
        Ok(Found::NearestRows { k: self.k, rows, radius })
    }

    /// By the first place of its rows; made for one neighbour it keeps no other.
    fn nearest_around(&mut self, queries: &Positions, radius: f32) -> Result<NearestFound> {
        let rows = self.plan.run(&self.points, &cube(), Asks::Other(queries.on_device()))?;
        let first = |all: usize| (0..all).step_by(self.k);
        let (ids, dist2) = (self.gpu.read(&rows.ids)?, self.gpu.read(&rows.dist2)?);
        let ids: Vec<u32> = first(ids.len()).map(|i| ids[i]).collect();
        let dist2: Vec<f32> = first(dist2.len()).map(|i| dist2[i]).collect();
        Ok(NearestFound { indices: nearest_within(&ids, &dist2, radius), stages: rows.stages, is_exact: false })
    }

    /// Points, sorted points, keys twice and their order.
    fn memory_bytes(&self) -> u64 {
        (16 + 16 + 8 + 8 + 4) * self.n
    }
}
