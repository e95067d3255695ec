//! What `nearfield neighbors` asks of an index, and the answer as counts, distances and rows.

use nearfield::query::{Index, Purpose, Summary};
use nearfield::{
    FixedRadius, Knn, KnnSearch, NearestNeighbors, NeighborSearch, Neighbors, Queries, Radius, RowOrder, Vec3,
};

use crate::lists::Rows;

/// The question.
pub(crate) enum Question<'a> {
    /// All within a radius.
    Within(FixedRadius<'a>),
    /// The nearest, and whether each row shall be ordered by index.
    Nearest { knn: Knn<'a>, by_index: bool },
}

impl<'a> Question<'a> {
    /// What an index is built for.
    pub(crate) fn purpose(&self) -> Purpose<'a> {
        match self {
            Self::Within(question) => question.into(),
            Self::Nearest { knn, .. } => knn.into(),
        }
    }

    pub(crate) fn validate(&self, points: usize) -> nearfield::Result<()> {
        match self {
            Self::Within(question) => question.validate(points),
            Self::Nearest { knn, .. } => knn.validate(points),
        }
    }

    fn radius(&self) -> Option<Radius<'a>> {
        match self {
            Self::Within(question) => Some(question.radius),
            Self::Nearest { knn, .. } => knn.radius,
        }
    }

    /// The smallest and the largest radius; `None` without any.
    pub(crate) fn radii(&self) -> Option<[f32; 2]> {
        match self.radius()? {
            Radius::One(radius) => Some([radius; 2]),
            Radius::Each(radii) => {
                let smallest = radii.iter().copied().reduce(f32::min)?;
                Some([smallest, radii.iter().copied().fold(smallest, f32::max)])
            }
        }
    }

    /// The radius of query `i`.
    pub(crate) fn radius_of(&self, i: usize) -> Option<f32> {
        self.radius().map(|radius| match radius {
            Radius::One(radius) => radius,
            Radius::Each(radii) => radii[i],
        })
    }
}

/// Counts, and rows where they are needed.
#[derive(Default)]
pub(crate) struct Answer {
    /// `[q]` neighbours of each query as found, or as kept under a cap.
    pub(crate) counts: Vec<u32>,
    /// `[q]` distance of the k-th neighbour, infinite where there is none; where the nearest were asked for.
    pub(crate) kth: Option<Vec<f32>>,
    pub(crate) cut_rows: u64,
    pub(crate) cut_neighbors: u64,
    pub(crate) report: nearfield::Report,
    rows: Option<OwnedRows>,
}

struct OwnedRows {
    offsets: Vec<u64>,
    indices: Vec<u32>,
    distances: Vec<f32>,
}

impl Answer {
    /// Asks; `k` is what the user asked for, which may be more than there are points.
    pub(crate) fn of(index: &Index, question: &Question<'_>, k: u32, lists: bool) -> nearfield::Result<Self> {
        match question {
            Question::Within(question) if lists => Ok(Self::of_list(index.list(question)?)),
            Question::Within(question) => {
                let found = index.count(question)?;
                let report = found.report.clone();
                Ok(Self { report, ..Self::of_counts(found.into_vec(), question.max_neighbors) })
            }
            Question::Nearest { knn, by_index } => Ok(Self::of_nearest(index.knn(knn)?, k, *by_index)),
        }
    }

    fn of_list(list: Neighbors) -> Self {
        let counts = list.offsets().windows(2).map(|w| (w[1] - w[0]) as u32).collect();
        let cut_rows = list.cut().len() as u64;
        let cut_neighbors = list.cut().iter().map(|cut| u64::from(cut.missing)).sum();
        let report = list.report.clone();
        let (offsets, indices, distances) = list.into_parts();
        let rows = OwnedRows { offsets, indices, distances: distances.unwrap_or_default() };
        Self { counts, cut_rows, cut_neighbors, report, rows: Some(rows), kth: None }
    }

    fn of_counts(mut counts: Vec<u32>, cap: Option<u32>) -> Self {
        let (mut cut_rows, mut cut_neighbors) = (0, 0);
        if let Some(cap) = cap {
            for count in counts.iter_mut().filter(|count| **count > cap) {
                cut_rows += 1;
                cut_neighbors += u64::from(*count - cap);
                *count = cap;
            }
        }
        Self { counts, cut_rows, cut_neighbors, ..Self::default() }
    }

    fn of_nearest(nearest: NearestNeighbors, k: u32, by_index: bool) -> Self {
        let n_queries = nearest.len();
        let counts: Vec<u32> = (0..n_queries).map(|i| nearest.found(i) as u32).collect();
        let kth = |i: usize| match nearest.row_distances(i) {
            row if row.len() == k as usize => row.last().copied().unwrap_or(f32::INFINITY),
            _ => f32::INFINITY,
        };
        let kth = (0..n_queries).map(kth).collect();
        let report = nearest.report.clone();
        let offsets: Vec<u64> = std::iter::once(0)
            .chain(counts.iter().scan(0u64, |end, &count| {
                *end += u64::from(count);
                Some(*end)
            }))
            .collect();
        let is_full = offsets[n_queries] == nearest.indices().len() as u64;
        let (mut indices, mut distances) = match is_full {
            true => nearest.into_parts(),
            false => (
                (0..n_queries).flat_map(|i| nearest.row(i)).copied().collect(),
                (0..n_queries).flat_map(|i| nearest.row_distances(i)).copied().collect(),
            ),
        };
        if by_index {
            for ends in offsets.windows(2) {
                let range = ends[0] as usize..ends[1] as usize;
                let mut row: Vec<(u32, f32)> =
                    indices[range.clone()].iter().copied().zip(distances[range.clone()].iter().copied()).collect();
                row.sort_unstable_by_key(|entry| entry.0);
                for (place, (index, distance)) in range.zip(row) {
                    (indices[place], distances[place]) = (index, distance);
                }
            }
        }
        let rows = OwnedRows { offsets, indices, distances };
        Self { counts, kth: Some(kth), report, rows: Some(rows), ..Self::default() }
    }

    /// The rows, where they were asked for.
    pub(crate) fn rows(&self) -> Option<Rows<'_>> {
        self.rows.as_ref().map(|OwnedRows { offsets, indices, distances }| Rows { offsets, indices, distances })
    }

    pub(crate) fn summary(&self) -> Summary {
        Summary::of(self.counts.iter().copied())
    }
}

/// The neighbours of one query without itself, and the distance of the farthest of them.
pub(crate) fn row_of(
    index: &Index,
    question: &Question<'_>,
    answer: &Answer,
    points: &[Vec3],
    i: usize,
) -> nearfield::Result<(Vec<u32>, f32)> {
    let Question::Within(within) = question else {
        let Some(rows) = answer.rows() else { return Ok((vec![], 0.0)) };
        let range = rows.offsets[i] as usize..rows.offsets[i + 1] as usize;
        let is_own = |j: &u32| asks_itself(question) && *j as usize == i;
        let farthest = rows.distances[range.clone()].iter().copied().fold(0.0, f32::max);
        return Ok((rows.indices[range].iter().copied().filter(|j| !is_own(j)).collect(), farthest));
    };
    let at = [match within.queries {
        Queries::Points => points[i],
        Queries::Other(queries) => queries[i],
    }];
    let radius = question.radius_of(i).unwrap_or(0.0);
    let alone = FixedRadius {
        radius: Radius::One(radius),
        exclude_self: false,
        max_neighbors: None,
        order: RowOrder::Distance,
        ..*within
    };
    let mut row = index.list(&alone.queries(&at))?.row(0).to_vec();
    row.retain(|&j| !(asks_itself(question) && j as usize == i));
    if let Some(cap) = within.max_neighbors {
        row.truncate(cap as usize);
    }
    Ok((row, radius))
}

/// Whether the queries are the points.
fn asks_itself(question: &Question<'_>) -> bool {
    let queries = match question {
        Question::Within(question) => &question.queries,
        Question::Nearest { knn, .. } => &knn.queries,
    };
    matches!(queries, Queries::Points)
}
