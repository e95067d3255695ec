//! LAZ: the chunks of compressed points, found and bounded before `laz` sees them.
//!
//! Each chunk is decoded by itself from its own bytes, so a broken one cannot read into its neighbour and all can be
//! decoded in parallel.

use std::io::Cursor;

use las::PointData;
use laz::laszip::ChunkTable;
use laz::record::{LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor};
use laz::{LazItem, LazItemRecordBuilder, LazVlr};

use super::FORMAT;
use super::header::{Header, error};
use crate::Result;
use crate::error::{FileError, Place};
use crate::io::guard;

/// Most extra bytes a compressed point may have. Each takes about 10 kB of tables in `laz`; the format's own
/// description of extra bytes ends far below.
const MAX_EXTRA_BYTES: u16 = 1024;

/// How LASzip arranged the points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Arrangement {
    /// One chunk, no chunk table.
    Whole,
    /// Chunks of whole points.
    Chunks,
    /// Chunks in which each field is a layer of its own.
    Layers,
}

/// Points that are decoded together.
pub(super) struct Chunk<'a> {
    /// Byte of the file at which it starts.
    start: usize,
    bytes: &'a [u8],
    /// Number of points in it.
    pub(super) points: usize,
}

/// The compressed points of a file.
pub(super) struct Compressed<'a> {
    items: Vec<LazItem>,
    arrangement: Arrangement,
    record_size: usize,
    chunks: Vec<Chunk<'a>>,
}

impl<'a> Compressed<'a> {
    /// Finds the chunks of a compressed file and checks that they hold as many points as the header says.
    ///
    /// # Errors
    /// `File` with the byte at fault.
    pub(super) fn open(bytes: &'a [u8], header: &Header) -> Result<Self> {
        let (record, at) = laszip_record(bytes, header)?;
        let arrangement = match u16::from_le_bytes([record[0], record[1]]) {
            1 => Arrangement::Whole,
            2 => Arrangement::Chunks,
            3 => Arrangement::Layers,
            other => return Err(error(at, format!("LASzip compressor {other}"), "compressor 1, 2 or 3")),
        };
        let unreadable = |cause| error(at, format!("a LASzip record that cannot be read ({cause})"), "a whole record");
        let vlr = LazVlr::from_buffer(record).map_err(unreadable)?;
        check_items(&vlr, at, arrangement, header)?;
        let mut compressed =
            Self { items: vlr.items().clone(), arrangement, record_size: header.record_size, chunks: vec![] };
        if header.points > 0 {
            compressed.chunks = match arrangement {
                Arrangement::Whole => {
                    let points = point_count(header)?;
                    vec![Chunk { start: header.points_start, bytes: &bytes[header.points_start..], points }]
                }
                Arrangement::Chunks | Arrangement::Layers => chunks(bytes, header, &vlr)?,
            };
        }
        for chunk in &compressed.chunks {
            compressed.check_chunk(chunk)?;
        }
        Ok(compressed)
    }

    /// The chunks in file order; their points add up to those of the header.
    pub(super) fn chunks(&self) -> &[Chunk<'a>] {
        &self.chunks
    }

    /// Decodes a chunk, `block_points` points at a time into `block`, each followed by a call of `store`.
    ///
    /// # Errors
    /// `File` where the chunk ends too early or cannot be decoded.
    pub(super) fn decode(
        &self,
        chunk: &Chunk<'_>,
        block_points: usize,
        block: &mut PointData,
        mut store: impl FnMut(&PointData),
    ) -> Result<()> {
        let source = Cursor::new(chunk.bytes);
        let mut decoder: Box<dyn RecordDecompressor<_>> = match self.arrangement {
            Arrangement::Layers => Box::new(LayeredPointRecordDecompressor::new(source)),
            Arrangement::Whole | Arrangement::Chunks => Box::new(SequentialPointRecordDecompressor::new(source)),
        };
        let failed = |cause: String, done: usize| {
            let found = format!("a compressed chunk that breaks after {done} points ({cause})");
            error(chunk.start, found, format!("{} points", chunk.points))
        };
        decoder.set_fields_from(&self.items).map_err(|cause| failed(cause.to_string(), 0))?;
        let mut done = 0;
        while done < chunk.points {
            let n = block_points.min(chunk.points - done);
            let records = block.resize_for(n).chunks_exact_mut(self.record_size);
            for (i, record) in records.enumerate() {
                decoder.decompress_next(record).map_err(|cause| failed(cause.to_string(), done + i))?;
            }
            store(block);
            done += n;
        }
        Ok(())
    }

    /// Checks that a chunk has room for its first point, which is stored as it is, and for the layers it announces.
    fn check_chunk(&self, chunk: &Chunk<'_>) -> Result<()> {
        if chunk.points == 0 {
            return Ok(());
        }
        let short = |what: &str, needed: u64| {
            let found = format!("a compressed chunk of {} bytes", chunk.bytes.len());
            Err(error(chunk.start, found, format!("at least {needed} for {what}")))
        };
        let point_end = self.record_size;
        if chunk.bytes.len() < point_end {
            return short("its first point", point_end as u64);
        }
        if self.arrangement != Arrangement::Layers {
            return Ok(());
        }
        let layers: usize = self.items.iter().map(layers).sum();
        let sizes_end = point_end + 4 + 4 * layers;
        let Some(sizes) = chunk.bytes.get(point_end + 4..sizes_end) else {
            return short("its layer sizes", sizes_end as u64);
        };
        let size = |b: &[u8]| u64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let needed = sizes_end as u64 + sizes.chunks_exact(4).map(size).sum::<u64>();
        if needed > chunk.bytes.len() as u64 { short("its layers", needed) } else { Ok(()) }
    }
}

/// The number of points as a size.
fn point_count(header: &Header) -> Result<usize> {
    let too_many = |_| error(107, format!("a count of {} points", header.points), "a count that memory can hold");
    usize::try_from(header.points).map_err(too_many)
}

/// Content of the record that describes the compression, and the byte at which it starts.
fn laszip_record<'a>(bytes: &'a [u8], header: &Header) -> Result<(&'a [u8], usize)> {
    let mut rest = &bytes[header.records_start..header.points_start];
    for _ in 0..header.records {
        let at = header.points_start - rest.len();
        let record = las::raw::Vlr::read_from(&mut rest, false)
            .map_err(|cause| error(at, format!("a variable length record cut off ({cause})"), "a whole record"))?;
        let start = at + 54;
        if record.user_id == *b"laszip encoded\0\0" && record.record_id == LazVlr::RECORD_ID {
            let content = &bytes[start..start + record.data.len()];
            if content.len() < 34 {
                return Err(error(start, format!("a LASzip record of {} bytes", content.len()), "at least 34"));
            }
            return Ok((content, start));
        }
    }
    let found = format!("compressed points, and no LASzip record among {} records", header.records);
    Err(error(header.records_start, found, "a record of user \"laszip encoded\""))
}

/// Checks that the compressed fields are those of the point format, in the only sizes they can have.
fn check_items(vlr: &LazVlr, at: usize, arrangement: Arrangement, header: &Header) -> Result<()> {
    if header.format.extra_bytes > MAX_EXTRA_BYTES {
        let found = format!("{} extra bytes a point", header.format.extra_bytes);
        return Err(error(105, found, format!("at most {MAX_EXTRA_BYTES} in a compressed file")));
    }
    let expected = LazItemRecordBuilder::default_for_point_format_id(header.format_number, header.format.extra_bytes)
        .map_err(|cause| error(104, cause.to_string(), "a point format that LASzip knows"))?;
    let versions = if arrangement == Arrangement::Layers { 3..=4 } else { 1..=2 };
    let fits = |(item, expected): (&LazItem, &LazItem)| {
        item.item_type() == expected.item_type() && item.size() == expected.size() && versions.contains(&item.version())
    };
    if vlr.items().len() != expected.len() || !vlr.items().iter().zip(&expected).all(fits) {
        let describe = |items: &[LazItem]| {
            let item = |i: &LazItem| format!("{:?} of {} bytes, version {}", i.item_type(), i.size(), i.version());
            items.iter().take(8).map(item).collect::<Vec<_>>().join("; ")
        };
        let found = format!("compressed fields [{}]", describe(vlr.items()));
        let expected = format!("those of format {}: [{}]", header.format_number, describe(&expected));
        return Err(error(at + 32, found, expected));
    }
    Ok(())
}

/// Layers of a field in a layered chunk.
fn layers(item: &LazItem) -> usize {
    match item.item_type() {
        laz::LazItemType::Point14 => 9,
        laz::LazItemType::RGBNIR14 => 2,
        laz::LazItemType::Byte14(count) => usize::from(count),
        _ => 1,
    }
}

/// The chunks that the chunk table lists, checked to lie in the file and to hold the points of the header.
fn chunks<'a>(bytes: &'a [u8], header: &Header, vlr: &LazVlr) -> Result<Vec<Chunk<'a>>> {
    let (data_start, table) = chunk_table_start(bytes, header)?;
    let number = bytes.get(table + 4..table + 8).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let Some(number) = number else {
        return Err(error(table, "the end of the file in the chunk table", "a version and a number of chunks"));
    };
    // The first point of each chunk is stored whole. Some writers close a file with an empty chunk.
    let room = (table - data_start + header.record_size) as u64;
    guard::records(FORMAT, Place::Byte(table as u64 + 4), number.into(), header.record_size as u64, room)?;
    let mut source = Cursor::new(&bytes[table..]);
    let entries = ChunkTable::read(&mut source, vlr.uses_variable_size_chunks())
        .map_err(|cause| error(table, format!("a chunk table that cannot be read ({cause})"), "a whole table"))?;
    let points = point_count(header)?;
    let wrong_count = |held: String| -> crate::Error {
        FileError::new(FORMAT, Place::Byte(107), format!("a count of {points} points"), held).into()
    };
    let mut chunks = Vec::with_capacity(number as usize);
    let (mut start, mut left) = (data_start, points);
    for entry in entries.as_ref() {
        // A negative difference in the table comes out as a huge count here.
        let end = usize::try_from(entry.byte_count).ok().and_then(|n| start.checked_add(n)).filter(|&end| end <= table);
        let Some(end) = end else {
            let found = format!("a chunk of {} bytes at byte {start}", entry.byte_count);
            return Err(error(table, found, format!("chunks that end at byte {table} or before")));
        };
        let count = if vlr.uses_variable_size_chunks() { entry.point_count } else { u64::from(vlr.chunk_size()) };
        let fixed = !vlr.uses_variable_size_chunks();
        let count = match usize::try_from(count) {
            Ok(count) if count <= left => count,
            _ if fixed => left,
            _ => return Err(wrong_count(format!("the {count} and more that the chunks hold"))),
        };
        if count == 0 && end > start {
            return Err(wrong_count("as many as the chunks hold, which is more".into()));
        }
        chunks.push(Chunk { start, bytes: &bytes[start..end], points: count });
        (start, left) = (end, left - count);
    }
    if left > 0 {
        return Err(wrong_count(format!("at most the {} of {number} chunks", points - left)));
    }
    Ok(chunks)
}

/// Byte at which the chunks start, and at which the table behind them starts.
fn chunk_table_start(bytes: &[u8], header: &Header) -> Result<(usize, usize)> {
    let offset_at = |at: usize| bytes.get(at..at + 8).map(|b| i64::from_le_bytes(b.try_into().expect("8 bytes")));
    let data_start = header.points_start + 8;
    let inside = |offset: &i64| *offset >= data_start as i64 && *offset <= bytes.len() as i64;
    let Some(offset) = offset_at(header.points_start) else {
        return Err(error(bytes.len(), "the end of the file", "the offset of the chunk table"));
    };
    // A writer that could not go back leaves -1 here and puts the offset into the last 8 bytes.
    let offset = if offset == -1 { bytes.len().checked_sub(8).and_then(offset_at).unwrap_or(-1) } else { offset };
    match Some(offset).filter(inside) {
        Some(offset) => Ok((data_start, offset as usize)),
        None => {
            let expected = format!("between byte {data_start} and the file size {}", bytes.len());
            Err(error(header.points_start, format!("a chunk table at byte {offset}"), expected))
        }
    }
}
