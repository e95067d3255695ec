//! What every fuzz target does: read the bytes, then hold the answer to what a reader promises.
//!
//! Run one with `RUSTC_BOOTSTRAP=1 cargo fuzz run --sanitizer address ply fuzz/corpus/ply fuzz/seeds/ply`.

use std::sync::Once;

use nearfield::io::{Format, parse_cloud, parse_mesh};
use nearfield::{Error, PointCloud, Result, TriMesh};

/// Reads `bytes` as a cloud and, where the format has meshes, as a mesh.
///
/// # Panics
/// If a reader breaks a promise: a panic that leaves it, columns of unequal length, an index out of range, or an error
/// that is none about the file.
pub fn read(bytes: &[u8], format: Format) {
    static HOOK: Once = Once::new();
    // The fuzzer's own hook aborts on a panic even where a guard turns it into an error; one that gets through still
    // ends the run, as the fuzzer aborts when it reaches its entry point.
    HOOK.call_once(|| std::panic::set_hook(Box::new(|panic| eprintln!("{panic}"))));

    if let Some(cloud) = read_or_refused(parse_cloud(bytes, format)) {
        check_cloud(&cloud);
    }
    if format.info().reads_mesh
        && let Some(mesh) = read_or_refused(parse_mesh(bytes, format))
    {
        check_mesh(&mesh);
    }
}

fn read_or_refused<T>(result: Result<T>) -> Option<T> {
    match result {
        Ok(value) => Some(value),
        Err(error @ (Error::File(_) | Error::Unsupported { .. } | Error::OutOfMemory { .. })) => {
            let length = error.to_string().len();
            assert!(length <= 600, "an error of {length} bytes is not for reading");
            None
        }
        Err(error) => panic!("the wrong kind of error: {error}"),
    }
}

fn check_cloud(cloud: &PointCloud) {
    if let Err(error @ Error::LengthMismatch { .. }) = cloud.validate() {
        panic!("{error}");
    }
}

fn check_mesh(mesh: &TriMesh) {
    let n = mesh.vertices.len();
    assert!(mesh.triangles.iter().flatten().all(|&v| (v as usize) < n), "a triangle names a vertex that is not there");
    assert!(mesh.normals.as_ref().is_none_or(|normals| normals.len() == n), "normals of unequal length");
    assert!(mesh.colors.as_ref().is_none_or(|colors| colors.len() == n), "colors of unequal length");
}
