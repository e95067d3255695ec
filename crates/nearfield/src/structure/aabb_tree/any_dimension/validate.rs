//! The invariants of the tree as code; the numbers are those of the module's page.

use super::AabbTreeN;
use crate::geometry::Scalar;
use crate::structure::aabb_tree::{BoxN, TreeShape};

impl<T: Scalar, const D: usize> AabbTreeN<T, D> {
    /// The first broken invariant, in words; `None` for a sound tree. For tests and for debugging.
    pub fn broken_invariant(&self) -> Option<String> {
        self.broken_order().or_else(|| self.broken_shape()).or_else(|| self.broken_boxes())
    }

    fn broken_order(&self) -> Option<String> {
        let n = self.points.len();
        let mut seen = vec![false; n];
        let twice = |&id: &u32| id as usize >= n || std::mem::replace(&mut seen[id as usize], true);
        let broken = self.points.ids().iter().copied().find(twice);
        broken.map(|id| format!("1: index {id} is out of range or stands twice"))
    }

    fn broken_shape(&self) -> Option<String> {
        let expected = TreeShape::new(self.points.len() as u32, self.settings.bucket_size);
        let sound = self.shape == expected && self.boxes.len() == expected.n_nodes();
        (!sound).then(|| format!("2: {:?} with {} boxes, expected {expected:?}", self.shape, self.boxes.len()))
    }

    fn broken_boxes(&self) -> Option<String> {
        for (node, found) in self.boxes.iter().enumerate() {
            let places = self.shape.points(node);
            let outside = |&place: &usize| !found.contains(&self.points.position(place));
            if let Some(place) = places.clone().find(outside) {
                return Some(format!("3: the point at place {place} is outside the box of node {node}"));
            }
            let tight = places.fold(BoxN::EMPTY, |bounds, place| bounds.grown_to(&self.points.position(place)));
            if *found != tight {
                return Some(format!("4: the box {found:?} of node {node} is not the smallest one, {tight:?}"));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::aabb_tree::any_dimension::AabbTreeNSettings;

    #[test]
    fn planted_faults_are_found() {
        let points: Vec<[f32; 4]> = (0..100u8).map(|i| [f32::from(i % 7), f32::from(i), 0.0, 1.0]).collect();
        let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default().bucket_size(4)).unwrap();
        assert_eq!(tree.broken_invariant(), None);
        let mut loose = tree.clone();
        loose.boxes[3].max[1] += 1.0;
        assert!(loose.broken_invariant().is_some_and(|fault| fault.starts_with('4')));
        let mut narrow = tree.clone();
        narrow.boxes[0].min[0] = 1.0;
        assert!(narrow.broken_invariant().is_some_and(|fault| fault.starts_with('3')));
        let mut short = tree.clone();
        short.boxes.pop();
        assert!(short.broken_invariant().is_some_and(|fault| fault.starts_with('2')));
        let mut doubled = tree;
        doubled.points = super::super::PointsN::gather(&points, vec![0; 100]);
        assert!(doubled.broken_invariant().is_some_and(|fault| fault.starts_with('1')));
    }
}
