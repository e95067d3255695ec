//! Neighbour lists as files: arrays in an NPZ archive, or CSV with one neighbour a line.

use std::io::{self, Write};
use std::path::Path;

use nearfield::io::{NpyArray, write_atomically, write_npz};

use crate::exit::Failure;

/// Format of a list file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ListFormat {
    Npz,
    Csv,
}

impl ListFormat {
    /// The format by extension; CSV for standard output.
    pub(crate) fn of(path: &Path) -> Result<Self, Failure> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("npz") => Ok(Self::Npz),
            Some("csv") => Ok(Self::Csv),
            _ if path == Path::new("-") => Ok(Self::Csv),
            _ => Err(Failure::Usage(format!("--output {}: lists are written as .npz or .csv", path.display()))),
        }
    }
}

/// Neighbours of each query as compressed rows.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rows<'a> {
    /// `[q + 1]`
    pub(crate) offsets: &'a [u64],
    /// `[nnz]`
    pub(crate) indices: &'a [u32],
    /// `[nnz]`
    pub(crate) distances: &'a [f32],
}

/// Writes a list, whole or not at all.
pub(crate) fn write(path: &Path, format: ListFormat, rows: &Rows<'_>, force: bool) -> nearfield::Result<()> {
    write_atomically(path, force, |w| match format {
        ListFormat::Npz => {
            let arrays = [
                ("offsets", NpyArray::U64(rows.offsets)),
                ("indices", NpyArray::U32(rows.indices)),
                ("distances", NpyArray::F32(rows.distances)),
            ];
            write_npz(&arrays, w)
        }
        ListFormat::Csv => write_csv(rows, w),
    })
}

fn write_csv(rows: &Rows<'_>, w: &mut dyn Write) -> io::Result<()> {
    writeln!(w, "query,neighbor,distance")?;
    let mut places = rows.indices.iter().zip(rows.distances);
    for (query, ends) in rows.offsets.windows(2).enumerate() {
        for (index, distance) in places.by_ref().take((ends[1] - ends[0]) as usize) {
            writeln!(w, "{query},{index},{distance}")?;
        }
    }
    Ok(())
}
