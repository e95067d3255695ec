//! All ray queries of the CPU, over any [`RayStructure`].

use std::time::Instant;

use rayon::prelude::*;

use super::visitors::{All, Any, Closest, Count};
use super::{HitCounts, HitLists, HitRecord, Hits, Occlusion, RayHit, RaySearch, hits};
use crate::geometry::{LocalHit, PreparedRay, Ray};
use crate::query::cpu::device_name;
use crate::query::{Report, Stage, rows};
use crate::structure::{CountRayWork, PreparedTriangles, RayStructure, RayWork};
use crate::{Error, Result};

/// Rays that a thread takes at once.
const CHUNK: usize = 1024;

fn report<S: RayStructure>(structure: &S, kernel: &str) -> Report {
    Report {
        structure: S::NAME,
        search: structure.search(),
        device: device_name(),
        kernels: vec![kernel.to_owned()],
        batches: 1,
        ..Report::default()
    }
}

/// Answers each ray with `ask`; rays that cannot be cast get `invalid`.
fn each<S: RayStructure, T: Copy + Send + Sync>(
    structure: &S,
    rays: &[Ray],
    invalid: T,
    what: &'static str,
    ask: impl Fn(&S, &PreparedRay) -> T + Sync,
) -> Result<Vec<T>> {
    let mut answers = with_room(rays.len(), what)?;
    let space = structure.triangles().space();
    let answer =
        |ray: &Ray| if ray.fault().is_some() { invalid } else { ask(structure, &PreparedRay::new(ray, space)) };
    rays.par_iter()
        .with_min_len(CHUNK.min(rays.len().div_ceil(4 * rayon::current_num_threads()).max(1)))
        .map(answer)
        .collect_into_vec(&mut answers);
    Ok(answers)
}

fn with_room<T>(n: usize, what: &'static str) -> Result<Vec<T>> {
    let mut answers = Vec::new();
    answers.try_reserve_exact(n).map_err(|_| out_of_memory::<T>(n as u64, what))?;
    Ok(answers)
}

fn out_of_memory<T>(n: u64, what: &'static str) -> Error {
    Error::OutOfMemory { what, needed: n.saturating_mul(size_of::<T>() as u64), available: rows::available_memory() }
}

fn closest<S: RayStructure, W: CountRayWork>(structure: &S, ray: &PreparedRay, work: &mut W) -> HitRecord {
    let mut visitor = Closest::new(ray);
    structure.walk(ray, &mut visitor, work);
    visitor.record(ray)
}

fn is_occluded<S: RayStructure>(structure: &S, ray: &PreparedRay) -> bool {
    let mut visitor = Any::new(ray);
    structure.walk(ray, &mut visitor, &mut ());
    visitor.found
}

fn count<S: RayStructure>(structure: &S, ray: &PreparedRay) -> u32 {
    let mut visitor = Count::new(ray);
    structure.walk(ray, &mut visitor, &mut ());
    visitor.count
}

/// Fills `found` with the hits of a ray in order.
fn all<S: RayStructure>(structure: &S, ray: &PreparedRay, found: &mut Vec<LocalHit>) {
    structure.walk(ray, &mut All::new(ray, found), &mut ());
    // By the caller's t, as rows are sorted everywhere.
    let t = |hit: &LocalHit| ray.caller_t(hit.t);
    found.sort_unstable_by(|a, b| t(a).total_cmp(&t(b)).then(a.triangle.cmp(&b.triangle)));
}

fn record_of(hit: &LocalHit, ray: &PreparedRay) -> HitRecord {
    HitRecord { triangle: hit.triangle, t: ray.caller_t(hit.t), weights: hit.weights }
}

impl<S: RayStructure> RaySearch for S {
    fn structure(&self) -> &'static str {
        S::NAME
    }

    fn device(&self) -> String {
        device_name()
    }

    fn prepared(&self) -> &PreparedTriangles {
        self.triangles()
    }

    fn memory_bytes(&self) -> u64 {
        RayStructure::memory_bytes(self)
    }

    fn build_stages(&self) -> Vec<Stage> {
        RayStructure::build_stages(self).iter().map(Stage::from).collect()
    }

    fn closest_hits(&self, rays: &[Ray]) -> Result<Hits> {
        let start = Instant::now();
        let records = each(self, rays, HitRecord::invalid(), "hits", |s, ray| closest(s, ray, &mut ()))?;
        let mut report = report(self, "closest");
        report.host_stage("cast", start);
        Ok(Hits { records, triangles: self.triangles().clone(), report })
    }

    fn closest_hits_with_work(&self, rays: &[Ray]) -> Result<(Hits, Vec<RayWork>)> {
        let start = Instant::now();
        let invalid = (HitRecord::invalid(), RayWork::default());
        let answers = each(self, rays, invalid, "hits and their work", |s, ray| {
            let mut work = RayWork::default();
            (closest(s, ray, &mut work), work)
        })?;
        let (records, work) = answers.into_iter().unzip();
        let mut report = report(self, "closest");
        report.host_stage("cast", start);
        Ok((Hits { records, triangles: self.triangles().clone(), report }, work))
    }

    fn any_hits(&self, rays: &[Ray]) -> Result<Occlusion> {
        let start = Instant::now();
        let states = each(self, rays, 2, "hit flags", |s, ray| u32::from(is_occluded(s, ray)))?;
        let mut report = report(self, "any");
        report.host_stage("cast", start);
        Ok(Occlusion { states, report })
    }

    fn all_hits(&self, rays: &[Ray]) -> Result<HitLists> {
        let start = Instant::now();
        let space = self.triangles().space();
        let row_of = |found: &mut Vec<LocalHit>, ray: &Ray, records: &mut Vec<HitRecord>| {
            if ray.fault().is_some() {
                return Ok(0);
            }
            let ray = PreparedRay::new(ray, space);
            all(self, &ray, found);
            let needed = records.len() + found.len();
            records.try_reserve(found.len()).map_err(|_| out_of_memory::<HitRecord>(needed as u64, "lists of hits"))?;
            records.extend(found.iter().map(|hit| record_of(hit, &ray)));
            Ok(found.len() as u64)
        };
        // Each chunk of rays makes its own rows; they are put together in the order of the rays.
        let chunks: Vec<(Vec<u64>, Vec<HitRecord>)> = rays
            .par_chunks(CHUNK)
            .map(|chunk| {
                let (mut found, mut records) = (Vec::new(), Vec::new());
                let lengths: Result<Vec<u64>> = chunk.iter().map(|ray| row_of(&mut found, ray, &mut records)).collect();
                Ok((lengths?, records))
            })
            .collect::<Result<_>>()?;
        let total: usize = chunks.iter().map(|(_, records)| records.len()).sum();
        let mut offsets = with_room(rays.len() + 1, "lists of hits")?;
        let mut records = with_room(total, "lists of hits")?;
        let mut end = 0;
        offsets.push(0);
        for (lengths, row) in chunks {
            for length in lengths {
                end += length;
                offsets.push(end);
            }
            records.extend(row);
        }
        let mut report = report(self, "all");
        report.host_stage("cast", start);
        Ok(HitLists { offsets, records, triangles: self.triangles().clone(), report })
    }

    fn count_hits(&self, rays: &[Ray]) -> Result<HitCounts> {
        let start = Instant::now();
        let counts = each(self, rays, 0, "hit counts", count)?;
        let mut report = report(self, "count");
        report.host_stage("cast", start);
        Ok(HitCounts { counts, report })
    }

    fn closest_hit(&self, ray: &Ray) -> Result<Option<RayHit>> {
        hits::check(ray)?;
        let record = closest(self, &PreparedRay::new(ray, self.triangles().space()), &mut ());
        let triangles = self.triangles().as_slice();
        Ok(record.is_hit().then(|| RayHit::new(&record, &triangles[record.triangle as usize])))
    }

    fn any_hit(&self, ray: &Ray) -> Result<bool> {
        hits::check(ray)?;
        Ok(is_occluded(self, &PreparedRay::new(ray, self.triangles().space())))
    }

    fn count_hits_of(&self, ray: &Ray) -> Result<u32> {
        hits::check(ray)?;
        Ok(count(self, &PreparedRay::new(ray, self.triangles().space())))
    }
}
