//! What there is to say about a structure over triangles: a line for people, and an object for programs.

use serde_json::{Value, json};

use crate::ray_structure::Built;
use crate::report::{grouped, size, stage_json};

impl Built {
    /// Figures of the structure as JSON.
    pub(crate) fn json(&self) -> Value {
        json!({
            "name": self.rays.search().structure(),
            "description": self.plan.describe(),
            "reason": self.reason,
            "walk": self.walk,
            "memory_bytes": self.memory_bytes,
            "nodes": self.kd.map(|kd| kd.nodes).or(self.bvh.map(|[nodes, _]| nodes)),
            "leaves": self.kd.map(|kd| kd.leaves).or(self.bvh.map(|[_, leaves]| leaves)),
            "references": self.kd.map(|kd| kd.references),
            "depth": self.kd.map(|kd| kd.depth),
            "sah_cost": self.kd.map(|kd| kd.sah_cost),
            "build_stages": self.stages.iter().map(stage_json).collect::<Vec<_>>(),
        })
    }

    /// The structure in a line.
    pub(crate) fn line(&self) -> String {
        let mut line = format!("{} ({}), {}", self.plan.describe(), self.walk, size(self.memory_bytes));
        if let Some(kd) = &self.kd {
            line += &format!(
                "; {} nodes, {} leaves ({} empty), {} references, depth {}",
                grouped(kd.nodes),
                grouped(kd.leaves),
                grouped(kd.empty_leaves),
                grouped(kd.references),
                kd.depth
            );
        }
        if let Some([nodes, leaves]) = self.bvh {
            line += &format!("; {} nodes, {} leaves", grouped(nodes), grouped(leaves));
        }
        if let Some(reason) = &self.reason {
            line += &format!("; {reason}");
        }
        line
    }
}
