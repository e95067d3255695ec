//! LZF, the compression of `binary_compressed`: literal runs and copies of what was just written.
//!
//! A stream is measured before anything is allocated for it, so a size that it cannot reach costs nothing.

/// What is wrong with a compressed stream.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Broken {
    /// Byte of the stream at which the faulty instruction starts.
    pub(super) at: usize,
    /// What is wrong there.
    pub(super) what: &'static str,
}

/// One instruction of the stream.
enum Step<'a> {
    Literal(&'a [u8]),
    Copy { distance: usize, len: usize },
}

/// Reads the instruction at byte `at`; returns it with the byte behind it.
fn step(input: &[u8], at: usize) -> Result<(Step<'_>, usize), Broken> {
    let cut = Broken { at, what: "an instruction cut off by the end of the data" };
    let control = usize::from(input[at]);
    if control < 32 {
        let end = at + 2 + control;
        return match input.get(at + 1..end) {
            Some(run) => Ok((Step::Literal(run), end)),
            None => Err(cut),
        };
    }
    let (extra, low_at) = if control >> 5 == 7 { (input.get(at + 1), at + 2) } else { (Some(&0), at + 1) };
    let (Some(&extra), Some(&low)) = (extra, input.get(low_at)) else { return Err(cut) };
    let len = (control >> 5) + usize::from(extra) + 2;
    let distance = ((control & 31) << 8) + usize::from(low) + 1;
    Ok((Step::Copy { distance, len }, low_at + 1))
}

/// Bytes that `input` expands to, without expanding it.
///
/// # Errors
/// [`Broken`] where an instruction is cut off or copies from before the start.
pub(super) fn expanded_len(input: &[u8]) -> Result<u64, Broken> {
    let (mut at, mut len) = (0, 0_u64);
    while at < input.len() {
        let (step, next) = step(input, at)?;
        len += match step {
            Step::Literal(run) => run.len() as u64,
            Step::Copy { distance, .. } if distance as u64 > len => {
                return Err(Broken { at, what: "a copy from before the start" });
            }
            Step::Copy { len, .. } => len as u64,
        };
        at = next;
    }
    Ok(len)
}

/// Expands `input`; `len` is its [`expanded_len`].
///
/// # Errors
/// As [`expanded_len`].
pub(super) fn expand(input: &[u8], len: usize) -> Result<Vec<u8>, Broken> {
    let mut output = Vec::with_capacity(len);
    let mut at = 0;
    while at < input.len() {
        let (step, next) = step(input, at)?;
        match step {
            Step::Literal(run) => output.extend_from_slice(run),
            Step::Copy { distance, len } => {
                let Some(start) = output.len().checked_sub(distance) else {
                    return Err(Broken { at, what: "a copy from before the start" });
                };
                if distance >= len {
                    output.extend_from_within(start..start + len);
                } else {
                    // The copy reads bytes that it writes itself: that is how LZF repeats a pattern.
                    for i in start..start + len {
                        output.push(output[i]);
                    }
                }
            }
        }
        at = next;
    }
    Ok(output)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literals_and_overlapping_copies_expand() {
        // "abc", then 5 bytes from 3 back (control 3 << 5 | 0), then 12 bytes from 1 back (long form: 7 + 3 + 2).
        let input = [2, b'a', b'b', b'c', 0x60, 2, 0xe0, 3, 0];
        assert_eq!(expanded_len(&input), Ok(20));
        assert_eq!(expand(&input, 20).unwrap(), b"abcabcabbbbbbbbbbbbb");
    }

    #[test]
    fn broken_streams_name_the_byte() {
        assert_eq!(expanded_len(&[5, 1]).unwrap_err().at, 0);
        assert_eq!(expanded_len(&[0, 7, 0xe0]).unwrap_err().at, 2);
        assert_eq!(expanded_len(&[0, 7, 0x20]).unwrap_err().at, 2);
        let before = expanded_len(&[0, 7, 0x20, 1]).unwrap_err();
        assert_eq!(before, Broken { at: 2, what: "a copy from before the start" });
        assert_eq!(expand(&[0, 7, 0x20, 1], 4).unwrap_err(), before);
    }
}
