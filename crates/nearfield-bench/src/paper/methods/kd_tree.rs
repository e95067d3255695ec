//! The exact kd-tree on the CPU, in the place of the paper's ANN: kiddo's, built on one thread and asked on all.

use super::{Found, Method, Plug, Positions, Update};
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

    /// The points, and kiddo's copy of them with an index each; kiddo does not tell its own.
    fn memory_bytes(&self) -> u64 {
        (12 + 16) * self.n
    }
}
