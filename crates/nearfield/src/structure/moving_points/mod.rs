//! Points that move, and a tree of boxes that follows them: fitted anew in every step, built anew when a rule says so.
//!
//! A fit costs a few passes over the points and keeps the tree; but the more the points have moved since they were put in
//! order, the more its boxes overlap, and the more of them a query looks at. [`RebuildPolicy`] says when a new order is
//! worth its build. The answers are exact at any time, whatever the rule.
//!
//! Source: Xing2017 §4.4 for the rule of the largest volume ratio. Differs: boxes are grown by the radius before volumes
//! are compared, so that flat ones and single points have a volume; the ratio is reduced on the device. The rule by cost
//! is that of renting skis until the rent would have bought them (Karlin1988): with it, extra query time and builds
//! together take at most about twice what the best choice in hindsight takes.
//! Cost: the tree's, and under the rule of volumes 12 bytes a node on the CPU, 20 on a device. When to use: points that
//! move and are asked in every step; a set that stands still needs the tree alone.
//!
//! Invariants:
//! 1. the tree is a sound one over the positions given last, in the caller's order;
//! 2. positions that are refused (not finite, too large, another number) leave points and tree as they were.

mod cost;
mod cpu;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
mod gpu_volume_ratio;
mod policy;
mod report;
mod volume_ratio;

pub use cpu::MovingPoints;
#[cfg(feature = "gpu")]
pub use gpu::GpuMovingPoints;
pub use policy::RebuildPolicy;
pub use report::{UpdateAction, UpdateReason, UpdateReport};
