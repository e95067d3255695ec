//! Whether neighbour lists are equal, except where a distance is within a few ulp of the radius.

use nearfield::Neighbors;

/// Distances this many units in the last place from the radius may fall on either side.
const BOUNDARY_ULP: f32 = 4.0;

/// What was compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Compared {
    /// Neighbours that two lists have in common, summed over all comparisons.
    pub(crate) neighbors: u64,
    /// Neighbours at the boundary that only one of two lists has.
    pub(crate) at_boundary: u64,
}

/// Compares lists sorted by index, with distances, with a reference over all points. A list with fewer rows was asked
/// around every `step`-th point.
///
/// Says of the first difference where it is.
pub(crate) fn all<'a>(
    lists: impl Iterator<Item = (String, &'a Neighbors)>,
    reference: &Neighbors,
    step: usize,
    radius: f32,
) -> Result<Compared, String> {
    let mut compared = Compared::default();
    for (name, list) in lists {
        let step = if list.len() == reference.len() { 1 } else { step };
        if list.len() != reference.len().div_ceil(step) {
            return Err(format!("{name} gave {} rows, expected {}", list.len(), reference.len().div_ceil(step)));
        }
        for row in 0..list.len() {
            let query = row * step;
            let (found, expected) = (Row::of(list, row), Row::of(reference, query));
            let pair = compare(found, expected, radius).map_err(|index| {
                format!("{name} and the reference disagree: query {query}, point {index}, not at the boundary")
            })?;
            compared.neighbors += pair.neighbors;
            compared.at_boundary += pair.at_boundary;
        }
    }
    Ok(compared)
}

#[derive(Debug, Clone, Copy)]
struct Row<'a> {
    indices: &'a [u32],
    distances: &'a [f32],
}

impl<'a> Row<'a> {
    fn of(list: &'a Neighbors, row: usize) -> Self {
        Self { indices: list.row(row), distances: list.row_distances(row).unwrap_or_default() }
    }

    fn get(&self, i: usize) -> Option<(u32, f32)> {
        // A missing distance is no distance that could be at the boundary.
        self.indices.get(i).map(|&index| (index, self.distances.get(i).copied().unwrap_or(f32::NAN)))
    }
}

/// Walks two ascending rows side by side; the error is the first index that only one has and that is not at the
/// boundary, or whose distances differ by more than the boundary's width.
fn compare(a: Row<'_>, b: Row<'_>, radius: f32) -> Result<Compared, u32> {
    let ulp = radius.next_up() - radius;
    let near = |x: f32, y: f32| (x - y).abs() <= BOUNDARY_ULP * ulp;
    let (mut i, mut j, mut compared) = (0, 0, Compared::default());
    loop {
        let (index, distance) = match (a.get(i), b.get(j)) {
            (None, None) => return Ok(compared),
            (Some((index, d)), Some((other, e))) if index == other => {
                if !near(d, e) {
                    return Err(index);
                }
                compared.neighbors += 1;
                (i, j) = (i + 1, j + 1);
                continue;
            }
            (Some(own), Some(other)) if own.0 > other.0 => {
                j += 1;
                other
            }
            (Some(own), _) => {
                i += 1;
                own
            }
            (None, Some(other)) => {
                j += 1;
                other
            }
        };
        if !near(distance, radius) {
            return Err(index);
        }
        compared.at_boundary += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row<'a>(indices: &'a [u32], distances: &'a [f32]) -> Row<'a> {
        Row { indices, distances }
    }

    #[test]
    fn planted_differences_are_found() {
        let expected = row(&[1, 4, 9], &[0.1, 0.2, 0.3]);
        let planted = [
            row(&[1, 9], &[0.1, 0.3]),
            row(&[1, 4], &[0.1, 0.2]),
            row(&[1, 4, 9, 12], &[0.1, 0.2, 0.3, 0.4]),
            row(&[1, 5, 9], &[0.1, 0.2, 0.3]),
            row(&[1, 4, 9], &[0.1, 0.21, 0.3]),
            row(&[], &[]),
            row(&[1, 4, 9], &[]),
        ];
        for (case, wrong) in planted.into_iter().enumerate() {
            assert!(compare(wrong, expected, 0.5).is_err(), "{case}");
            assert!(compare(expected, wrong, 0.5).is_err(), "{case}");
        }
        assert_eq!(compare(expected, expected, 0.5), Ok(Compared { neighbors: 3, at_boundary: 0 }));
    }

    #[test]
    fn only_the_boundary_may_differ() {
        let short = row(&[1], &[0.1]);
        let compare_with = |distance| compare(row(&[1, 7], &[0.1, distance]), short, 0.5);
        assert_eq!(compare_with(0.5f32.next_down()), Ok(Compared { neighbors: 1, at_boundary: 1 }));
        assert_eq!(compare_with(0.499), Err(7));
    }
}
