//! Where the tests find the real files that are kept outside the repository.

use std::path::PathBuf;

/// A file of the shared test data, or `None` with a printed line where the folder is absent.
///
/// The folder stands beside the repository; `NEARFIELD_TEST_DATA` names another one.
pub(crate) fn real_file(name: &str) -> Option<Vec<u8>> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");
    let folder = std::env::var_os("NEARFIELD_TEST_DATA").map_or_else(|| PathBuf::from(beside), PathBuf::from);
    let path = folder.join(name);
    let bytes = std::fs::read(&path).ok();
    if bytes.is_none() {
        println!("skipped: {} is not there", path.display());
    }
    bytes
}
