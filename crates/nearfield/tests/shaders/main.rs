//! Every WESL module composed as the kernels use it and validated, and what it shares with Rust compared: needs no GPU.

mod constants;
mod layouts;
mod sources;
mod twins;
mod variants;
