//! The invariants of the tree as code; the numbers are those of the module's page.

use super::AabbTree;
use super::region::NodeBox;
use super::shape::TreeShape;
use crate::structure::CpuStructure;

impl AabbTree {
    /// The first broken invariant, in words; `None` for a sound tree. For tests and for debugging.
    pub fn broken_invariant(&self) -> Option<String> {
        self.broken_order()
            .or_else(|| self.broken_shape())
            .or_else(|| self.broken_boxes())
            .or_else(|| self.broken_packs())
    }

    fn broken_order(&self) -> Option<String> {
        let n = self.points.len();
        let mut seen = vec![false; n];
        let twice = |&id: &u32| id as usize >= n || std::mem::replace(&mut seen[id as usize], true);
        let broken = self.points.ids().iter().copied().find(twice);
        broken.map(|id| format!("1: index {id} is out of range or stands twice"))
    }

    fn broken_shape(&self) -> Option<String> {
        let (shape, bucket) = (self.shape, self.settings.bucket_size);
        if shape != TreeShape::new(self.points.len() as u32, bucket) || self.boxes.len() != shape.n_nodes() {
            return Some(format!("2: {shape:?} with {} boxes over {} points", self.boxes.len(), self.points.len()));
        }
        let large = shape.leaves().find(|&leaf| shape.points(leaf).len() > bucket as usize);
        large.map(|leaf| format!("2: leaf {leaf} holds {} points, the bucket {bucket}", shape.points(leaf).len()))
    }

    fn broken_boxes(&self) -> Option<String> {
        for (node, aabb) in self.boxes.iter().enumerate() {
            let places = self.shape.points(node);
            // Devices may take numbers this small for zero; searches allow for far more.
            let reach = aabb.to_aabb().swept(f32::MIN_POSITIVE);
            let outside = |&place: &usize| !reach.contains(self.points.position(place));
            if let Some(place) = places.clone().find(outside) {
                return Some(format!("3: the point at place {place} is outside the box of node {node}"));
            }
            let tight =
                places.fold(NodeBox::EMPTY, |aabb, place| aabb.grown_to(&self.points.position(place).to_array()));
            let near =
                |a: [f32; 3], b: [f32; 3]| a == b || a.iter().zip(b).all(|(a, b)| (a - b).abs() <= f32::MIN_POSITIVE);
            if !(near(aabb.min, tight.min) && near(aabb.max, tight.max)) {
                return Some(format!("4: the box {aabb:?} of node {node} is not the smallest one, {tight:?}"));
            }
        }
        None
    }

    fn broken_packs(&self) -> Option<String> {
        let (packs, n) = (self.packs(), self.points.len() as u32);
        let tiles = if n == 0 { packs == [0] } else { packs.first() == Some(&0) && packs.last() == Some(&n) };
        (!tiles || !packs.is_sorted()).then(|| "5: packs do not tile the order".to_owned())
    }
}
