//! Applications on the CPU against closed forms, loops and published figures: one program for all of them, since each would link the
//! whole library.

mod distance_field;
mod dual_contouring;
mod mls;
mod path_trace;
#[path = "../support/scenes.rs"]
mod scenes;
#[path = "../support/solids.rs"]
mod solids;
#[path = "../support/mod.rs"]
mod support;
#[path = "../support/surfaces.rs"]
mod surfaces;
