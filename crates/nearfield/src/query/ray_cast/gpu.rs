//! All ray queries of the GPU, over any [`GpuRayStructure`]: rays go up, answers come back, in batches of bounded work,
//! and in smaller ones where memory is short.

use std::ops::Range;
use std::time::Instant;

use bytemuck::{Pod, Zeroable};

use super::on_device::{self, ALL, ANY, CLOSEST, CLOSEST_WITH_WORK, COUNT, DeviceRays, HitCode};
use super::{HitCounts, HitLists, HitRecord, Hits, Occlusion, RaySearch};
use crate::geometry::Ray;
use crate::gpu::{Access, Bind, Buffer, Commands, DeviceElement, Gpu, Kernel, Workgroups};
use crate::query::gpu::add_stages;
use crate::query::gpu::batch::{halving_from, windows};
use crate::query::{Report, Stage};
use crate::structure::{GpuBruteForceMesh, GpuKdTree, GpuRayStructure, GpuTriangleBvh, PreparedTriangles, RayWork};
use crate::{Error, Result};

/// Fewest rays of a batch: with no memory for that, there is none for anything.
const FEW_RAYS: usize = 64;
/// Invocations of a workgroup of the sorting kernel.
const WORKGROUP: u32 = 64;

/// `SortBatch` in sort_hits.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct SortBatch {
    /// Rows of this batch.
    pub count: u32,
    /// Unused.
    pub padding: [u32; 3],
}

fn report<S: GpuRayStructure>(structure: &S, code: &HitCode) -> Report {
    Report {
        structure: S::NAME,
        search: structure.search(),
        device: structure.gpu().name().to_owned(),
        kernels: vec!["package::query::ray_cast::cast".to_owned(), code.module.to_owned()],
        ..Report::default()
    }
}

/// Runs `ask` on consecutive parts of the rays, no larger than a submission of the structure may be and than memory
/// allows. Times of parts are added up.
fn in_batches<S: GpuRayStructure>(
    structure: &S,
    rays: &[Ray],
    report: &mut Report,
    mut ask: impl FnMut(Range<usize>, &mut Report) -> Result<()>,
) -> Result<()> {
    report.batches += halving_from(rays.len(), structure.rays_a_submission(), FEW_RAYS, |range| {
        let n_stages = report.stages.len();
        let asked = ask(range, report);
        if asked.is_err() {
            // Times of a batch that is tried again would count its work twice.
            report.stages.truncate(n_stages);
        }
        report.merge_stages(n_stages);
        asked
    })?;
    Ok(())
}

/// Casts a batch whose answer is one element a ray in each buffer of `visitor`.
fn cast<S: GpuRayStructure>(
    structure: &S,
    rays: &[Ray],
    code: &HitCode,
    visitor: &[Bind],
    report: &mut Report,
) -> Result<()> {
    let gpu = structure.gpu();
    let upload = Instant::now();
    let buffer = gpu.upload("rays", rays)?;
    report.host_stage("upload", upload);
    let mut commands = gpu.commands("cast rays");
    commands.stage("cast");
    on_device::record(&mut commands, structure, &DeviceRays::first(&buffer, rays.len()), code, visitor)?;
    add_stages(report, &commands.run()?);
    Ok(())
}

/// Checks that no ray was abandoned.
///
/// # Errors
/// `Unsupported` where the device ends loops before a ray is through.
fn check_finished<S: GpuRayStructure>(structure: &S, mut words: impl Iterator<Item = u32>) -> Result<()> {
    match structure.gpu().limits().loop_rounds {
        Some(limit) if words.any(|word| word == HitRecord::ABANDONED) => {
            Err(on_device::too_many_rounds(structure, limit))
        }
        _ => Ok(()),
    }
}

/// One element a ray, read back.
fn one_each<S: GpuRayStructure, T: DeviceElement>(
    structure: &S,
    rays: &[Ray],
    code: &HitCode,
) -> Result<(Vec<T>, Report)> {
    let start = Instant::now();
    let gpu = structure.gpu();
    let mut report = report(structure, code);
    let mut answers = Vec::with_capacity(rays.len());
    in_batches(structure, rays, &mut report, |range, report| {
        let buffer: Buffer<T> = gpu.buffer("answers to rays", range.len())?;
        cast(structure, &rays[range], code, &[(&buffer).into()], report)?;
        let read = Instant::now();
        answers.extend(gpu.read(&buffer)?);
        report.host_stage("read back", read);
        Ok(())
    })?;
    report.host_stage("total", start);
    Ok((answers, report))
}

/// One word a ray.
fn words<S: GpuRayStructure>(structure: &S, rays: &[Ray], code: &HitCode) -> Result<(Vec<u32>, Report)> {
    let (words, report) = one_each(structure, rays, code)?;
    check_finished(structure, words.iter().copied())?;
    Ok((words, report))
}

/// Checks that no ray was abandoned, and gives rays without a hit an infinite t: the device marks them by the largest
/// number.
fn finish<S: GpuRayStructure>(structure: &S, records: &mut [HitRecord]) -> Result<()> {
    check_finished(structure, records.iter().map(|record| record.triangle))?;
    records.iter_mut().filter(|record| !record.is_hit()).for_each(|record| record.t = f32::INFINITY);
    Ok(())
}

fn closest<S: GpuRayStructure>(structure: &S, rays: &[Ray]) -> Result<Hits> {
    let (mut records, report) = one_each(structure, rays, &CLOSEST)?;
    finish(structure, &mut records)?;
    Ok(Hits { records, triangles: structure.triangles().clone(), report })
}

fn closest_with_work<S: GpuRayStructure>(structure: &S, rays: &[Ray]) -> Result<(Hits, Vec<RayWork>)> {
    let start = Instant::now();
    let gpu = structure.gpu();
    let mut report = report(structure, &CLOSEST_WITH_WORK);
    let (mut records, mut works) = (Vec::with_capacity(rays.len()), Vec::with_capacity(rays.len()));
    in_batches(structure, rays, &mut report, |range, report| {
        let hits: Buffer<HitRecord> = gpu.buffer("hits", range.len())?;
        let work: Buffer<RayWork> = gpu.buffer("work of rays", range.len())?;
        cast(structure, &rays[range], &CLOSEST_WITH_WORK, &[(&hits).into(), (&work).into()], report)?;
        // Both are read before either is kept, so that a batch that fails leaves nothing.
        let (read_hits, read_work) = (gpu.read(&hits)?, gpu.read(&work)?);
        records.extend(read_hits);
        works.extend(read_work);
        Ok(())
    })?;
    finish(structure, &mut records)?;
    report.host_stage("total", start);
    Ok((Hits { records, triangles: structure.triangles().clone(), report }, works))
}

/// Records and lengths of the rows of rays whose hits were counted.
fn fill_rows<S: GpuRayStructure>(
    structure: &S,
    rays: &[Ray],
    counts: &[u32],
    report: &mut Report,
) -> Result<Vec<HitRecord>> {
    let gpu = structure.gpu();
    let offsets: Vec<u32> = std::iter::once(0)
        .chain(counts.iter().scan(0, |end, &count| {
            *end += count;
            Some(*end)
        }))
        .collect();
    let offsets = gpu.upload("offsets of hits", &offsets)?;
    let total = counts.iter().map(|&count| count as usize).sum();
    let records: Buffer<HitRecord> = gpu.buffer("lists of hits", total)?;
    let lengths: Buffer<u32> = gpu.buffer("lengths of lists", rays.len())?;
    let buffer = gpu.upload("rays", rays)?;
    let mut commands = gpu.commands("list hits");
    commands.stage("fill");
    let visitor: [Bind; 3] = [(&offsets).into(), (&records).into(), (&lengths).into()];
    on_device::record(&mut commands, structure, &DeviceRays::first(&buffer, rays.len()), &ALL, &visitor)?;
    commands.stage("sort");
    record_sort(&mut commands, gpu, &offsets, &lengths, &records, counts)?;
    add_stages(report, &commands.run()?);
    if gpu.read(&lengths)? != counts {
        return Err(Error::Device {
            operation: "list hits".to_owned(),
            message: "two passes of the same rays met different numbers of hits".to_owned(),
        });
    }
    gpu.read(&records)
}

fn record_sort(
    commands: &mut Commands,
    gpu: &Gpu,
    offsets: &Buffer<u32>,
    lengths: &Buffer<u32>,
    records: &Buffer<HitRecord>,
    counts: &[u32],
) -> Result<()> {
    let longest = u64::from(counts.iter().copied().max().unwrap_or(0));
    // Every record is sifted twice at most, through all levels of the heap.
    let rounds = 2 * longest * (u64::from(longest.max(1).ilog2()) + 2);
    if let Some(limit) = gpu.limits().loop_rounds.filter(|&limit| rounds > u64::from(limit)) {
        return Err(Error::Unsupported {
            what: format!("sorting {longest} hits of a ray on {}, which ends loops after {limit} rounds,", gpu.name()),
            advice: "use the CPU, count the hits, or cut the range of t",
        });
    }
    use Access::{Read, ReadWrite, Uniform};
    let batch = gpu.uniform("sort batch", &SortBatch { count: counts.len() as u32, padding: [0; 3] })?;
    let kernel = Kernel {
        constants: &[("WORKGROUP", f64::from(WORKGROUP))],
        ..Kernel::new("package::query::ray_cast::sort_hits", "sort_hits", &[Uniform, Read, Read, ReadWrite], WORKGROUP)
    };
    let binds: [Bind; 4] = [(&batch).into(), offsets.into(), lengths.into(), records.into()];
    commands.dispatch(&gpu.prepare(&kernel)?, &binds, Workgroups::Covering(counts.len() as u64));
    Ok(())
}

fn all<S: GpuRayStructure>(structure: &S, rays: &[Ray]) -> Result<HitLists> {
    let start = Instant::now();
    let (counts, counted) = words(structure, rays, &COUNT)?;
    let mut report = report(structure, &ALL);
    report.stages.extend(counted.stages.into_iter().filter(|stage| stage.name != "total"));
    let capacity = structure.gpu().limits().binding_bytes / size_of::<HitRecord>() as u64;
    let capacity = capacity.min(u64::from(u32::MAX));
    let mut records = Vec::new();
    for window in windows(&counts, capacity) {
        let (rays, counts) = (&rays[window.clone()], &counts[window]);
        in_batches(structure, rays, &mut report, |range, report| {
            records.extend(fill_rows(structure, &rays[range.clone()], &counts[range], report)?);
            Ok(())
        })?;
    }
    let mut offsets = Vec::with_capacity(rays.len() + 1);
    offsets.push(0);
    offsets.extend(counts.iter().scan(0u64, |end, &count| {
        *end += u64::from(count);
        Some(*end)
    }));
    report.host_stage("total", start);
    Ok(HitLists { offsets, records, triangles: structure.triangles().clone(), report })
}

/// The search trait for a GPU structure. (A blanket implementation would overlap with that for CPU structures.)
macro_rules! rays_on_gpu {
    ($($structure:ty),*) => {$(
        impl RaySearch for $structure {
            fn structure(&self) -> &'static str {
                <$structure as GpuRayStructure>::NAME
            }

            fn device(&self) -> String {
                self.gpu().name().to_owned()
            }

            fn prepared(&self) -> &PreparedTriangles {
                self.triangles()
            }

            fn memory_bytes(&self) -> u64 {
                GpuRayStructure::memory_bytes(self)
            }

            fn build_stages(&self) -> Vec<Stage> {
                GpuRayStructure::build_stages(self).iter().map(Stage::from).collect()
            }

            fn closest_hits(&self, rays: &[Ray]) -> Result<Hits> {
                closest(self, rays)
            }

            fn closest_hits_with_work(&self, rays: &[Ray]) -> Result<(Hits, Vec<RayWork>)> {
                closest_with_work(self, rays)
            }

            fn any_hits(&self, rays: &[Ray]) -> Result<Occlusion> {
                words(self, rays, &ANY).map(|(states, report)| Occlusion { states, report })
            }

            fn all_hits(&self, rays: &[Ray]) -> Result<HitLists> {
                all(self, rays)
            }

            fn count_hits(&self, rays: &[Ray]) -> Result<HitCounts> {
                words(self, rays, &COUNT).map(|(counts, report)| HitCounts { counts, report })
            }
        }
    )*};
}

rays_on_gpu!(GpuBruteForceMesh, GpuKdTree, GpuTriangleBvh);
