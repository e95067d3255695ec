//! What stands in front of every third-party reader: no count is believed beyond the bytes that are there, and no
//! panic of a decoder reaches the caller.

use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::error::{FileError, Place, Result};

/// Checks that `declared` records of at least `smallest` bytes each fit into `remaining` bytes.
///
/// # Errors
/// `File`, with the count found and the largest count that the bytes can hold.
pub(crate) fn records(format: &'static str, place: Place, declared: u64, smallest: u64, remaining: u64) -> Result<()> {
    let possible = remaining / smallest.max(1);
    if declared > possible {
        let found = format!("a count of {declared} records of at least {smallest} bytes");
        let expected = format!("at most {possible}, which is what the remaining {remaining} bytes can hold");
        return Err(FileError::new(format, place, found, expected).into());
    }
    Ok(())
}

/// Runs a third-party decoder; a panic in it becomes an error.
///
/// # Errors
/// What `decode` returns, or `File` where it panicked.
pub(crate) fn caught<T>(format: &'static str, decode: impl FnOnce() -> Result<T>) -> Result<T> {
    match catch_unwind(AssertUnwindSafe(decode)) {
        Ok(result) => result,
        Err(panic) => {
            let message = panic
                .downcast_ref::<String>()
                .map(String::as_str)
                .or_else(|| panic.downcast_ref::<&str>().copied())
                .unwrap_or("no message");
            let found = format!("content the decoder cannot handle ({message})");
            Err(FileError::new(format, Place::Whole, found, "a well-formed file").into())
        }
    }
}
