//! From the root of each point's cluster to numbers of clusters, and clusters of unwanted size left out.

use super::{Clusters, EuclideanSettings, LeftOut};
use crate::{Error, Result};

/// What has no root.
pub(super) const NONE: u32 = u32::MAX;

/// Numbers roots in ascending order; the labels, and how many clusters there are.
///
/// - `roots`: `[n]` the smallest core index of each point's cluster, or [`NONE`]
///
/// # Errors
/// `TooMany`.
pub(super) fn number(roots: &[u32], is_core: &[bool]) -> Result<(Vec<i32>, u32)> {
    let mut numbers = vec![Clusters::NONE; roots.len()];
    let mut next = 0u32;
    for (i, (&root, _)) in roots.iter().zip(is_core).enumerate().filter(|(_, (_, core))| **core) {
        if root as usize == i {
            numbers[i] = check_count(next)?;
            next += 1;
        }
    }
    let label = |&root: &u32| if root == NONE { Clusters::NONE } else { numbers[root as usize] };
    Ok((roots.iter().map(label).collect(), next))
}

/// The number of a cluster as a label.
///
/// # Errors
/// `TooMany`.
pub(super) fn check_count(number: u32) -> Result<i32> {
    let (found, limit) = (u64::from(number) + 1, i32::MAX as u64);
    let advice = "labels are 31 bits wide; use a larger radius";
    i32::try_from(number).map_err(|_| Error::TooMany { what: "clusters", found, limit, advice })
}

/// Leaves out the clusters that are too small or too large; the others keep their order.
pub(super) fn keep_sizes(clusters: &mut Clusters, settings: &EuclideanSettings) {
    let sizes = clusters.sizes();
    let mut next = 0;
    let mut renamed = vec![Clusters::NONE; sizes.len()];
    for (new, &size) in renamed.iter_mut().zip(&sizes) {
        let left_out = |left: &mut LeftOut| {
            left.clusters += 1;
            left.points += size;
        };
        if size < settings.min_size {
            left_out(&mut clusters.too_small);
        } else if size > settings.max_size {
            left_out(&mut clusters.too_large);
        } else {
            *new = next;
            next += 1;
        }
    }
    if next as usize == sizes.len() {
        return;
    }
    clusters.labels.iter_mut().filter(|label| **label >= 0).for_each(|label| *label = renamed[*label as usize]);
    clusters.n_clusters = next as u32;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clusters_are_numbered_by_their_smallest_core() {
        // Point 0 is at the border of the cluster of 3, point 1 is noise.
        let roots = [3, NONE, 2, 3, 2, 3];
        let is_core = [false, false, true, true, false, true];
        assert_eq!(number(&roots, &is_core).unwrap(), (vec![1, -1, 0, 1, 0, 1], 2));
        assert!(check_count(i32::MAX as u32).is_ok());
        assert!(matches!(check_count(1 << 31), Err(Error::TooMany { what: "clusters", .. })));
    }

    #[test]
    fn sizes_decide_who_stays() {
        let labels = vec![0, 1, 1, 2, 2, 2, 3, 3, -1];
        let mut clusters = Clusters { labels, n_clusters: 4, ..Clusters::default() };
        keep_sizes(&mut clusters, &EuclideanSettings { radius: 1.0, min_size: 2, max_size: 2 });
        assert_eq!(clusters.labels, [-1, 0, 0, -1, -1, -1, 1, 1, -1]);
        assert_eq!(clusters.n_clusters, 2);
        assert_eq!(clusters.too_small, LeftOut { clusters: 1, points: 1 });
        assert_eq!(clusters.too_large, LeftOut { clusters: 1, points: 3 });
    }
}
