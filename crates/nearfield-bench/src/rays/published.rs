//! The figures that ours stand beside: those of Accel, and the targets of this library.

use super::method::Method;
use super::shots::Question;

/// Accel's number of rays in its timings, those of 750 by 750 pixels.
pub const RAYS: usize = 750 * 750;
/// Numbers of triangles of Accel's timings.
const TRIANGLES: [f64; 5] = [2465.0, 4968.0, 59_616.0, 119_232.0, 953_856.0];

/// Accel's milliseconds for 750 × 750 rays, read off its graphs: triangles and times. Its GPU times include allocation and upload.
pub fn accel(method: Method) -> Vec<(f64, f64)> {
    let all = |times: [f64; 5]| TRIANGLES.into_iter().zip(times).collect();
    match method {
        // Of the other four only the last can be read.
        Method::CpuBrute => vec![(TRIANGLES[4], 3.15e6)],
        Method::CpuStack => all([815.0, 1010.0, 1450.0, 1280.0, 1300.0]),
        Method::CpuRopes => all([275.0, 275.0, 490.0, 495.0, 780.0]),
        Method::GpuRopes => all([10.0, 12.0, 27.0, 36.0, 110.0]),
        // The last lies above the graph, at more than 10 s.
        Method::GpuBrute => TRIANGLES.into_iter().zip([140.0, 270.0, 1450.0, 2500.0]).collect(),
        Method::CpuBvh | Method::GpuBvh => vec![],
    }
}

/// Accel's time at that number of triangles.
pub fn accel_at(method: Method, triangles: usize) -> Option<f64> {
    accel(method).into_iter().find(|point| point.0 == triangles as f64).map(|point| point.1)
}

/// Accel's build of a kd-tree over 29,808 triangles: leaf limit and milliseconds.
pub const ACCEL_BUILDS: [(u32, f64); 3] = [(20, 115.0), (200, 24.0), (2000, 11.0)];

/// Largest number of triangles that a ray of Accel's heat maps tested: leaf limit and number. Brute force tests all of the
/// 29,808 that it read.
pub const ACCEL_TESTS: [(u32, u32); 3] = [(2000, 7147), (200, 1666), (20, 467)];

/// Triangles of Accel's heat maps: the first three corners of every quad of its largest bunny.
pub const ACCEL_CORNERS: usize = 29_808;

/// Accel's path tracer: iterations in two minutes by ropes and by brute force, on its GPU.
pub const ITERATIONS: [usize; 2] = [168, 13];

/// The target of a row of the speed table, in words; those of the GPU are for an H200, those of the CPU for a core.
pub fn target(method: Method, shots: &str, question: Question) -> &'static str {
    match (method, shots, question) {
        (Method::GpuRopes, "primary", Question::Closest) => "≥ 800 Mrays/s",
        (Method::GpuBvh, "primary", Question::Closest) => "≥ 1000 Mrays/s",
        (Method::GpuRopes | Method::GpuBvh, "diffuse bounces", _) => "≥ 400 Mrays/s",
        (Method::CpuRopes, "primary", Question::Closest) => "≥ 4 Mrays/s a core",
        (Method::CpuBvh, _, Question::Closest) => "half of Embree's",
        _ => "",
    }
}
