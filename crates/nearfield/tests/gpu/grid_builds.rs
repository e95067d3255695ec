//! Grids that are built again as points move: the same cells whatever the order of the points in them.

use libtest_mimic::Trial;
use nearfield::gpu::Gpu;
use nearfield::structure::{DevicePoint, EntryOrder, GpuStructure, GridBuilder};
use nearfield::{Aabb, FixedRadius, GridSettings, NeighborSearch, Vec3};

use crate::support::gpu_trial;
use crate::{RADIUS, lattice_points, rows_by_loop, wrong_row};

pub(crate) fn trials() -> Vec<Trial> {
    vec![gpu_trial("grids_are_rebuilt_in_either_order", either_order)]
}

fn packed(points: &[Vec3]) -> Vec<DevicePoint> {
    points.iter().enumerate().map(|(i, p)| [p.x, p.y, p.z, f32::from_bits(i as u32)]).collect()
}

fn either_order(gpu: &Gpu) {
    let bounds = Aabb::new(Vec3::ZERO, Vec3::ONE);
    // Cells of one entry each, and hashed ones that several cells share.
    for cell in [RADIUS, 1.0 / 512.0] {
        let settings = GridSettings { cell_size: cell, ..GridSettings::for_radius(RADIUS) };
        for order in [EntryOrder::AsGiven, EntryOrder::Any] {
            for n in [0, 1, 700] {
                let first = lattice_points(n);
                let moved: Vec<Vec3> = first.iter().map(|p| Vec3::ONE - *p).collect();
                let heap = vec![Vec3::splat(0.5); n];
                let mut builder = GridBuilder::with_order(gpu, n, &bounds, &settings, order).unwrap();
                let on_device = gpu.upload("points", &packed(&first)).unwrap();
                let mut grid = builder.build(&on_device).unwrap();
                for points in [&first, &moved, &heap] {
                    gpu.write(&on_device, 0, &packed(points)).unwrap();
                    let mut commands = gpu.commands("rebuild");
                    builder.record_rebuild(&mut commands, &on_device, &mut grid).unwrap();
                    commands.submit().unwrap();
                    let mut ids: Vec<u32> = gpu.read(grid.points()).unwrap().iter().map(|p| p[3].to_bits()).collect();
                    assert_eq!(gpu.read(grid.ids().unwrap()).unwrap(), ids, "{order:?}, {n} points");
                    ids.sort_unstable();
                    assert!(ids.into_iter().eq(0..n as u32), "{order:?}, {n} points: each is there once");
                    let found = grid.list(&FixedRadius::new(RADIUS)).unwrap();
                    let expected = rows_by_loop(points, points, RADIUS);
                    assert_eq!(wrong_row(&found, &expected), None, "{order:?}, {n} points, cells of {cell}");
                }
            }
        }
    }
}
