//! The exact kd-tree on the CPU, in the place of the paper's ANN: kiddo's, built on one thread and asked on all.

use super::{Found, Method, NearestFound, Plug, Positions, Update, nearest_within};
use crate::Result;
use crate::baselines::kd_tree_cpu::KdTree;
use crate::baselines::{Points, Queries};

/// Built anew in every step.
pub const ON_CPU: Plug = Plug {
    name: "kd-tree, CPU",
    on_gpu: false,
    color: 7,
    make: |start| Ok(Box::new(Kiddo { tree: build(start.at)?, n: start.at.host.len() as u64 })),
};

struct Kiddo {
    tree: KdTree<'static>,
    n: u64,
}

fn build(at: &Positions) -> Result<KdTree<'static>> {
    Ok(KdTree::build_owned(Points::in_space(&at.host)?)?)
}

impl Method for Kiddo {
    fn update(&mut self, at: &Positions) -> Result<Update> {
        self.tree = build(at)?;
        Ok(Update { stages: Vec::new(), rebuilt: true })
    }

    fn list(&mut self, radius: f32) -> Result<Found> {
        let rows = self.tree.list_within(Queries::Points, radius)?;
        Ok(Found::Baseline { rows, stages: Vec::new(), is_exact: true })
    }

    fn list_around(&mut self, queries: &Positions, radius: f32) -> Result<Found> {
        let rows = self.tree.list_within(Queries::Other(&Points::in_space(&queries.host)?), radius)?;
        Ok(Found::Baseline { rows, stages: Vec::new(), is_exact: true })
    }

    fn nearest_around(&mut self, queries: &Positions, radius: f32) -> Result<NearestFound> {
        let rows = self.tree.knn(Queries::Other(&Points::in_space(&queries.host)?), 1)?;
        Ok(NearestFound {
            indices: nearest_within(rows.ids(), rows.dist2(), radius),
            stages: Vec::new(),
            is_exact: true,
        })
    }

    /// The points, and kiddo's copy of them with an index each; kiddo does not tell its own.
    fn memory_bytes(&self) -> u64 {
        (12 + 16) * self.n
    }
}
