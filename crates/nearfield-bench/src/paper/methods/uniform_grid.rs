//! The uniform grid, the paper's voxels: built anew in every step. Source of the idea in the paper: Green2010.

use nearfield::gpu::{Buffer, Gpu};
use nearfield::structure::{DevicePoint, GridBuilder};
use nearfield::{GpuUniformGrid, GridSettings, UniformGrid};

use super::on_gpu::Builds;
use super::{Plug, on_cpu, on_gpu};
use crate::paper::lab::cube;

/// Built and asked on the GPU.
pub const ON_GPU: Plug = Plug {
    name: "grid, GPU",
    on_gpu: true,
    color: 3,
    make: |start| {
        let settings = GridSettings::for_radius(start.radius);
        let builder = GridBuilder::new(start.gpu(), start.at.host.len(), &cube(), &settings)?;
        Ok(Box::new(on_gpu::Rebuilt::new(builder, start.at)?))
    },
};

/// Cells of a fixed number that have nothing to do with the radius, as in the paper's applications; its densest.
pub const FIXED_256: Plug = Plug {
    name: "grid of 256³ cells, GPU",
    on_gpu: true,
    color: 4,
    make: |start| Ok(Box::new(on_gpu::Rebuilt::new(fixed(start.gpu(), start.at.host.len(), 256)?, start.at)?)),
};

/// The same with fewer.
pub const FIXED_128: Plug = Plug {
    name: "grid of 128³ cells, GPU",
    on_gpu: true,
    color: 6,
    make: |start| Ok(Box::new(on_gpu::Rebuilt::new(fixed(start.gpu(), start.at.host.len(), 128)?, start.at)?)),
};

/// Builds grids of so many cells along each side of the cube.
///
/// # Errors
/// As [`GridBuilder::new`].
pub fn fixed(gpu: &Gpu, n_points: usize, cells: u32) -> nearfield::Result<GridBuilder> {
    let cell_size = cube().extent().max_element() / cells as f32;
    let settings = GridSettings { refine_x: 1, ..GridSettings::for_radius(cell_size) };
    GridBuilder::new(gpu, n_points, &cube(), &settings)
}

/// Built and asked on the CPU.
pub const ON_CPU: Plug = Plug {
    name: "grid, CPU",
    on_gpu: false,
    color: 8,
    make: |start| {
        let settings = GridSettings::for_radius(start.radius);
        Ok(Box::new(on_cpu::Rebuilt::new(move |points| UniformGrid::build(points, &settings), start.at)?))
    },
};

impl Builds for GridBuilder {
    type Structure = GpuUniformGrid;

    fn build(&mut self, points: &Buffer<DevicePoint>) -> nearfield::Result<GpuUniformGrid> {
        GridBuilder::build(self, points)
    }
}
