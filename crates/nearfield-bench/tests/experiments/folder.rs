//! What the experiments share: a folder to write to, the device by its name, and plain loops.

use std::fs;
use std::path::PathBuf;

use nearfield::Vec3;
use nearfield::gpu::{DeviceChoice, Gpu};

/// A folder of this process that is removed in the end.
pub(crate) struct Folder(pub(crate) PathBuf);

impl Folder {
    pub(crate) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("nearfield-bench-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).expect("a temporary folder");
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

pub(crate) fn choice(gpu: &Gpu) -> DeviceChoice {
    DeviceChoice::Name(gpu.name().to_owned())
}

pub(crate) fn number(text: &str) -> f64 {
    text.parse().expect("a number")
}

/// Mean neighbours by a plain loop.
pub(crate) fn mean_neighbors(points: &[Vec3], radius: f64) -> f64 {
    let inside = |p: &Vec3, q: &Vec3| p.as_dvec3().distance_squared(q.as_dvec3()) <= radius * radius;
    let total: usize = points.iter().map(|p| points.iter().filter(|q| inside(p, q)).count()).sum();
    total as f64 / points.len() as f64
}
