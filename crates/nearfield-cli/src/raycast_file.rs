//! Answers to rays as the arrays of an NPZ archive.

use std::io::{self, Seek, Write};

use nearfield::io::{NpyArray, write_npz};
use nearfield::{DVec3, HitCounts, HitLists, Hits, Occlusion, RayHit, Report, Vec3};

/// What was asked and what came back.
pub(crate) enum Answer {
    Closest(Hits),
    Any(Occlusion),
    Count(HitCounts),
    All(HitLists),
}

impl Answer {
    /// What ran.
    pub(crate) fn report(&self) -> &Report {
        match self {
            Self::Closest(hits) => &hits.report,
            Self::Any(occlusion) => &occlusion.report,
            Self::Count(counts) => &counts.report,
            Self::All(lists) => &lists.report,
        }
    }

    /// Rays that hit something.
    pub(crate) fn hitting(&self) -> u64 {
        match self {
            Self::Closest(hits) => hits.n_hits() as u64,
            Self::Any(occlusion) => occlusion.as_slice().iter().filter(|&&state| state == 1).count() as u64,
            Self::Count(counts) => counts.as_slice().iter().filter(|&&count| count > 0).count() as u64,
            Self::All(lists) => lists.offsets().windows(2).filter(|ends| ends[0] < ends[1]).count() as u64,
        }
    }

    /// Hits of all rays together, where there may be several of a ray.
    pub(crate) fn hits(&self) -> Option<u64> {
        match self {
            Self::Closest(_) | Self::Any(_) => None,
            Self::Count(counts) => Some(counts.as_slice().iter().map(|&count| u64::from(count)).sum()),
            Self::All(lists) => Some(lists.records().len() as u64),
        }
    }

    /// Bytes of the arrays at most.
    pub(crate) fn bytes(&self) -> u64 {
        match self {
            Self::Closest(hits) => 56 * hits.len() as u64,
            Self::Any(occlusion) => occlusion.len() as u64,
            Self::Count(_) => 0,
            Self::All(lists) => 56 * lists.records().len() as u64,
        }
    }
}

/// The arrays of an answer.
pub(crate) enum Arrays<'a> {
    Any(Vec<u8>),
    Count(&'a [u32]),
    Closest(HitArrays),
    All(&'a [u64], HitArrays),
}

/// An element a hit.
pub(crate) struct HitArrays {
    triangle: Vec<u32>,
    t: Vec<f32>,
    barycentrics: Vec<Vec3>,
    position: Positions,
    normal: Vec<Vec3>,
}

/// In world coordinates, as exact as the mesh's are.
enum Positions {
    Small(Vec<Vec3>),
    World(Vec<DVec3>),
}

impl<'a> Arrays<'a> {
    /// The arrays of an answer over a mesh of this origin.
    pub(crate) fn of(answer: &'a Answer, origin: DVec3) -> Self {
        match answer {
            Answer::Any(occlusion) => Self::Any(occlusion.as_slice().iter().map(|&state| state as u8).collect()),
            Answer::Count(counts) => Self::Count(counts.as_slice()),
            Answer::Closest(hits) => {
                let each = hits.records().iter().enumerate().map(|(i, record)| (record.triangle, hits.hit(i)));
                Self::Closest(HitArrays::of(hits.len(), each, origin))
            }
            Answer::All(lists) => {
                let each = (0..lists.len()).flat_map(|i| lists.hits_of(i)).map(|hit| (hit.triangle, Some(hit)));
                Self::All(lists.offsets(), HitArrays::of(lists.records().len(), each, origin))
            }
        }
    }

    /// Writes the archive; `invalid` are the indices of rays that cannot be cast.
    pub(crate) fn write<W: Write + Seek>(&self, invalid: &[u64], w: W) -> io::Result<()> {
        let mut arrays = vec![];
        match self {
            Self::Any(states) => arrays.push(("hit", NpyArray::U8(states))),
            Self::Count(counts) => arrays.push(("count", NpyArray::U32(counts))),
            Self::Closest(hits) => arrays.extend(hits.named()),
            Self::All(offsets, hits) => {
                arrays.push(("offsets", NpyArray::U64(offsets)));
                arrays.extend(hits.named());
            }
        }
        arrays.push(("invalid", NpyArray::U64(invalid)));
        write_npz(&arrays, w)
    }
}

impl HitArrays {
    fn of(n: usize, each: impl Iterator<Item = (u32, Option<RayHit>)>, origin: DVec3) -> Self {
        let mut arrays = Self {
            triangle: Vec::with_capacity(n),
            t: Vec::with_capacity(n),
            barycentrics: Vec::with_capacity(n),
            position: if origin == DVec3::ZERO {
                Positions::Small(Vec::with_capacity(n))
            } else {
                Positions::World(Vec::with_capacity(n))
            },
            normal: Vec::with_capacity(n),
        };
        for (triangle, hit) in each {
            let nothing = RayHit {
                triangle,
                t: f32::INFINITY,
                barycentrics: [f32::NAN; 3],
                position: Vec3::NAN,
                normal: Vec3::NAN,
            };
            let hit = hit.unwrap_or(nothing);
            arrays.triangle.push(hit.triangle);
            arrays.t.push(hit.t);
            arrays.barycentrics.push(Vec3::from_array(hit.barycentrics));
            match &mut arrays.position {
                Positions::Small(positions) => positions.push(hit.position),
                Positions::World(positions) => positions.push(origin + hit.position.as_dvec3()),
            }
            arrays.normal.push(hit.normal);
        }
        arrays
    }

    fn named(&self) -> [(&'static str, NpyArray<'_>); 5] {
        let position = match &self.position {
            Positions::Small(positions) => NpyArray::F32x3(positions),
            Positions::World(positions) => NpyArray::F64x3(positions),
        };
        [
            ("triangle", NpyArray::U32(&self.triangle)),
            ("t", NpyArray::F32(&self.t)),
            ("barycentrics", NpyArray::F32x3(&self.barycentrics)),
            ("position", position),
            ("normal", NpyArray::F32x3(&self.normal)),
        ]
    }
}
