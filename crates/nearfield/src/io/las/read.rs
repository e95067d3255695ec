//! LAS and LAZ bytes to a cloud.

use las::{PointData, PointDataBuilder};
use rayon::prelude::*;

use super::compressed::Compressed;
use super::header::Header;
use super::{FORMAT, header};
use crate::Result;
use crate::error::Place;
use crate::geometry::{Attribute, Column, PointCloud};
use crate::io::guard;
use glam::DVec3;

/// Points decoded at a time.
const BLOCK: usize = 4096;
/// Points a task decodes of an uncompressed file.
const TASK: usize = 1 << 16;

/// The cloud in a LAS or LAZ file: positions, colours, and the attributes that the module names.
///
/// # Errors
/// `File` with the byte, what was found and what was expected.
pub(crate) fn read(bytes: &[u8]) -> Result<PointCloud> {
    guard::caught(FORMAT, || {
        let header = Header::read(bytes)?;
        let columns = if header.format.is_compressed { read_laz(bytes, &header)? } else { read_las(bytes, &header)? };
        Ok(columns.into_cloud(&header))
    })
}

fn read_las(bytes: &[u8], header: &Header) -> Result<Columns> {
    let (place, size) = (Place::Byte(107), header.record_size);
    let body = &bytes[header.points_start..];
    guard::records(FORMAT, place, header.points, size as u64, body.len() as u64)?;
    let points = header.points as usize;
    let mut columns = Columns::new(header, points);
    let tasks = columns.split((0..points.div_ceil(TASK)).map(|task| TASK.min(points - task * TASK)));
    tasks.into_par_iter().zip(body[..points * size].par_chunks(TASK * size)).for_each(|(mut part, records)| {
        let mut block = empty_block(header);
        for records in records.chunks(BLOCK * size) {
            block.resize_for(records.len() / size).copy_from_slice(records);
            part.store(&block);
        }
    });
    Ok(columns)
}

fn read_laz(bytes: &[u8], header: &Header) -> Result<Columns> {
    let compressed = Compressed::open(bytes, header)?;
    if header.points == 0 {
        return Ok(Columns::new(header, 0));
    }
    // A decompressor takes some megabytes of tables, so a small file gets few of them at a time.
    let workers = rayon::current_num_threads().min(1 + bytes.len() / (1 << 19));
    let chunks = compressed.chunks();
    let group = chunks.len().div_ceil(workers);
    // Where the points need far more memory than the file, they are first decoded into nothing: only a file that
    // really holds them may ask for it.
    let allowed = 24 * bytes.len() as u64 + (32 << 20);
    if header.points.saturating_mul(Columns::bytes_per_point(header)) > allowed {
        chunks.par_chunks(group).try_for_each(|chunks| {
            let mut block = empty_block(header);
            chunks.iter().try_for_each(|chunk| compressed.decode(chunk, BLOCK, &mut block, |_| {}))
        })?;
    }
    let mut columns = Columns::new(header, header.points as usize);
    let mut tasks: Vec<_> = chunks.iter().zip(columns.split(chunks.iter().map(|chunk| chunk.points))).collect();
    tasks.par_chunks_mut(group).try_for_each(|tasks| {
        let mut block = empty_block(header);
        tasks
            .iter_mut()
            .try_for_each(|(chunk, part)| compressed.decode(chunk, BLOCK, &mut block, |block| part.store(block)))
    })?;
    drop(tasks);
    Ok(columns)
}

fn empty_block(header: &header::Header) -> PointData {
    PointDataBuilder::new().with_format(header.format).with_transforms(header.transforms).build()
}

/// What is kept of all points; a column that the format lacks is empty.
struct Columns {
    world: Vec<DVec3>,
    intensity: Vec<u16>,
    return_number: Vec<u8>,
    number_of_returns: Vec<u8>,
    classification: Vec<u8>,
    gps_time: Vec<f64>,
    color: Vec<[u16; 3]>,
}

/// A run of points within [`Columns`].
struct Part<'a> {
    world: &'a mut [DVec3],
    intensity: &'a mut [u16],
    return_number: &'a mut [u8],
    number_of_returns: &'a mut [u8],
    classification: &'a mut [u8],
    gps_time: &'a mut [f64],
    color: &'a mut [[u16; 3]],
}

/// Splits the first `n` values off `rest`, all of them where there are fewer.
fn split_off<'a, T>(rest: &mut &'a mut [T], n: usize) -> &'a mut [T] {
    let all = std::mem::take(rest);
    let (first, others) = all.split_at_mut(n.min(all.len()));
    *rest = others;
    first
}

impl Columns {
    /// Bytes that a point takes here and in the finished cloud.
    fn bytes_per_point(header: &Header) -> u64 {
        let positions = size_of::<DVec3>() + size_of::<glam::Vec3>();
        let gps_time = if header.format.has_gps_time { 8 } else { 0 };
        let color = if header.format.has_color { 6 + 4 } else { 0 };
        (positions + 2 + 3 + gps_time + color) as u64
    }

    fn new(header: &Header, points: usize) -> Self {
        let only = |present: bool| if present { points } else { 0 };
        Self {
            world: vec![DVec3::ZERO; points],
            intensity: vec![0; points],
            return_number: vec![0; points],
            number_of_returns: vec![0; points],
            classification: vec![0; points],
            gps_time: vec![0.0; only(header.format.has_gps_time)],
            color: vec![[0; 3]; only(header.format.has_color)],
        }
    }

    /// The columns cut into runs of the given lengths.
    fn split(&mut self, lengths: impl Iterator<Item = usize>) -> Vec<Part<'_>> {
        let mut rest = Part {
            world: &mut self.world,
            intensity: &mut self.intensity,
            return_number: &mut self.return_number,
            number_of_returns: &mut self.number_of_returns,
            classification: &mut self.classification,
            gps_time: &mut self.gps_time,
            color: &mut self.color,
        };
        lengths.map(|n| rest.split_off(n)).collect()
    }

    fn into_cloud(self, header: &Header) -> PointCloud {
        let mut cloud = PointCloud::from_world(&self.world);
        drop(self.world);
        if header.format.has_color {
            let eight_bits = self.color.iter().flatten().all(|&channel| channel < 256);
            let shift = if eight_bits { 0 } else { 8 };
            let color = |c: &[u16; 3]| [(c[0] >> shift) as u8, (c[1] >> shift) as u8, (c[2] >> shift) as u8, 255];
            cloud.colors = Some(self.color.iter().map(color).collect());
        }
        let attribute = |name: &str, values| Attribute { name: name.to_owned(), values };
        cloud.attributes = vec![
            attribute("intensity", Column::U16(self.intensity)),
            attribute("return_number", Column::U8(self.return_number)),
            attribute("number_of_returns", Column::U8(self.number_of_returns)),
            attribute("classification", Column::U8(self.classification)),
        ];
        if header.format.has_gps_time {
            cloud.attributes.push(attribute("gps_time", Column::F64(self.gps_time)));
        }
        cloud
    }
}

impl<'a> Part<'a> {
    fn split_off(&mut self, n: usize) -> Part<'a> {
        Part {
            world: split_off(&mut self.world, n),
            intensity: split_off(&mut self.intensity, n),
            return_number: split_off(&mut self.return_number, n),
            number_of_returns: split_off(&mut self.number_of_returns, n),
            classification: split_off(&mut self.classification, n),
            gps_time: split_off(&mut self.gps_time, n),
            color: split_off(&mut self.color, n),
        }
    }

    /// Fills the front of this run with the points of `block` and goes on behind them.
    fn store(&mut self, block: &PointData) {
        fn fill<T>(to: &mut [T], from: impl Iterator<Item = T>) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to = from);
        }
        let to = self.split_off(block.len());
        let world = block.x().zip(block.y()).zip(block.z());
        fill(to.world, world.map(|((x, y), z)| DVec3::new(x, y, z)));
        fill(to.intensity, block.intensity());
        fill(to.return_number, block.return_number());
        fill(to.number_of_returns, block.number_of_returns());
        fill(to.classification, block.classification());
        if let Some(gps_time) = block.gps_time() {
            fill(to.gps_time, gps_time);
        }
        if let Some(color) = block.rgb() {
            fill(to.color, color.map(|(red, green, blue)| [red, green, blue]));
        }
    }
}
