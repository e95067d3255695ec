//! Memory of the host for what is read back.

use bytemuck::Zeroable;

use crate::{Error, Result};

/// Bytes from which on memory comes from the system by itself, and large pages are worth asking for.
const MANY_BYTES: usize = 4 << 20;

/// So many elements, all zero.
///
/// # Errors
/// `OutOfMemory`.
pub(crate) fn zeroed<T: Zeroable>(what: &'static str, len: usize) -> Result<Vec<T>> {
    let needed = (len as u64).saturating_mul(size_of::<T>() as u64);
    let mut values =
        bytemuck::allocation::try_zeroed_vec(len).map_err(|()| Error::OutOfMemory { what, needed, available: 0 })?;
    advise_large_pages(&mut values);
    Ok(values)
}

/// Asks for large pages where memory is not touched yet: with pages of 4 KiB, 200 MB are touched for the first time in 50,000 page faults, which take
/// longer than the copy into them.
#[cfg(target_os = "linux")]
fn advise_large_pages<T>(values: &mut [T]) {
    /// Page sizes divide it on every Linux.
    const PAGE: usize = 64 << 10;
    if size_of_val(values) < MANY_BYTES {
        return;
    }
    let begin = values.as_mut_ptr() as usize;
    let (first, end) = (begin.next_multiple_of(PAGE), (begin + size_of_val(values)) / PAGE * PAGE);
    // SAFETY: the range lies within memory of this process that `values` borrows alone, and the advice changes nothing of its contents. That it is refused
    // does no harm.
    unsafe {
        libc::madvise(first as *mut libc::c_void, end.saturating_sub(first), libc::MADV_HUGEPAGE);
    }
}

#[cfg(not(target_os = "linux"))]
fn advise_large_pages<T>(_: &mut [T]) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_zero_whatever_its_size() {
        for len in [0, 1, 1000, MANY_BYTES / 8, MANY_BYTES + 12_345] {
            let mut values = zeroed::<u64>("test", len).unwrap();
            assert_eq!(values.len(), len);
            assert!(values.iter().all(|&v| v == 0));
            values.fill(7);
            assert!(values.iter().all(|&v| v == 7));
        }
        let too_many = zeroed::<u64>("test", usize::MAX / 16);
        assert!(matches!(too_many, Err(Error::OutOfMemory { what: "test", .. })));
    }
}
