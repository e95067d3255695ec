//! What a structure answers once it is built, on the CPU and on the device.

use std::ops::ControlFlow;

use nearfield::{
    AabbTree, BoxSearch, Boxes, BruteForce, Counts, FixedRadius, ForEachNeighbor, Knn, KnnSearch, LinearOctree,
    NearestNeighbors, Neighbor, NeighborSearch, Neighbors, Result, UniformGrid, Vec3,
};
#[cfg(feature = "gpu")]
use nearfield::{
    Report,
    query::{ForEachOnDevice, Visitor as DeviceVisitor},
    structure::{GpuAabbTree, GpuBruteForce, GpuLinearOctree, GpuUniformGrid},
};

/// A function called with a query and its neighbour.
pub(crate) type Visitor<'a> = dyn Fn(u32, Neighbor) -> ControlFlow<()> + Sync + 'a;

/// A structure, ready for questions.
pub(crate) trait Built: NeighborSearch {
    /// Visits every neighbour; `None` where the structure has no such query.
    fn visit(&self, question: &FixedRadius<'_>, visitor: &Visitor<'_>) -> Option<Result<()>>;
    /// Visits the neighbours of one place; `None` where the structure has no such query.
    fn visit_at(&self, center: Vec3, radius: f32, visitor: &Visitor<'_>) -> Option<Result<()>>;
    /// The first broken invariant in words.
    fn broken_invariant(&self) -> Option<String>;
    /// The k nearest points; `None` where the structure has no such query.
    fn knn(&self, _: &Knn<'_>) -> Option<Result<NearestNeighbors>> {
        None
    }
    /// Count and list of the points in boxes; `None` where the structure has no such query.
    fn in_boxes(&self, _: &Boxes<'_>) -> Option<Result<(Counts, Neighbors)>> {
        None
    }
    /// Runs a caller's kernel on every neighbour; `None` where the structure has no such query.
    #[cfg(feature = "gpu")]
    fn run_visitor(&self, _: &FixedRadius<'_>, _: &DeviceVisitor<'_>) -> Option<Result<Report>> {
        None
    }
}

/// The k nearest points, for a structure that finds them.
macro_rules! knn {
    () => {
        fn knn(&self, question: &Knn<'_>) -> Option<Result<NearestNeighbors>> {
            Some(KnnSearch::knn(self, question))
        }
    };
}

/// The points in boxes, for a structure that finds them.
macro_rules! boxes {
    () => {
        fn in_boxes(&self, question: &Boxes<'_>) -> Option<Result<(Counts, Neighbors)>> {
            let counts = self.count_in_boxes(question);
            Some(counts.and_then(|counts| Ok((counts, self.list_in_boxes(question)?))))
        }
    };
}

macro_rules! on_cpu {
    ($structure:ty, $invariant:expr $(, $more:ident)*) => {
        impl Built for $structure {
            fn visit(&self, question: &FixedRadius<'_>, visitor: &Visitor<'_>) -> Option<Result<()>> {
                Some(self.for_each(question, visitor))
            }

            fn visit_at(&self, center: Vec3, radius: f32, visitor: &Visitor<'_>) -> Option<Result<()>> {
                Some(self.for_each_at(center, radius, |neighbor| visitor(0, neighbor)))
            }

            fn broken_invariant(&self) -> Option<String> {
                $invariant(self)
            }

            $($more!();)*
        }
    };
}

on_cpu!(BruteForce, |_| None, knn, boxes);
on_cpu!(UniformGrid, UniformGrid::broken_invariant);
on_cpu!(LinearOctree, LinearOctree::broken_invariant, knn, boxes);
on_cpu!(AabbTree, AabbTree::broken_invariant, knn);

#[cfg(feature = "gpu")]
macro_rules! on_gpu {
    ($structure:ty, $invariant:expr $(, $more:ident)*) => {
        impl Built for $structure {
            fn visit(&self, _: &FixedRadius<'_>, _: &Visitor<'_>) -> Option<Result<()>> {
                None
            }

            fn visit_at(&self, _: Vec3, _: f32, _: &Visitor<'_>) -> Option<Result<()>> {
                None
            }

            fn broken_invariant(&self) -> Option<String> {
                $invariant(self)
            }

            fn run_visitor(&self, question: &FixedRadius<'_>, visitor: &DeviceVisitor<'_>) -> Option<Result<Report>> {
                Some(self.for_each_on_device(question, visitor))
            }

            $($more!();)*
        }
    };
}

#[cfg(feature = "gpu")]
on_gpu!(GpuBruteForce, |_| None, knn);
#[cfg(feature = "gpu")]
on_gpu!(GpuUniformGrid, |_| None, knn);
#[cfg(feature = "gpu")]
on_gpu!(
    GpuAabbTree,
    |tree: &GpuAabbTree| match tree.read() {
        Ok(tree) => tree.broken_invariant(),
        Err(error) => Some(error.to_string()),
    },
    knn
);
#[cfg(feature = "gpu")]
on_gpu!(
    GpuLinearOctree,
    |tree: &GpuLinearOctree| match tree.read() {
        Ok(tree) => tree.broken_invariant(),
        Err(error) => Some(error.to_string()),
    },
    knn,
    boxes
);
