//! LAS and LAZ, the point clouds of airborne and terrestrial laser scanning, versions 1.0 to 1.4, point formats 0 to 10.
//!
//! The crates `las` (header, record layout) and `laz` (decompression) do the decoding, behind our own check of every
//! number that an allocation or a loop depends on: given a damaged chunk table or layer size, `laz` asks for gigabytes,
//! and an aborted allocation cannot be caught.
//!
//! - World coordinates are `scale × integer + offset` in f64, as the format defines them.
//! - Attributes: `intensity`, `return_number`, `number_of_returns`, `classification`, and `gps_time` where there is one.
//! - Colours have 16 bits a channel and keep the upper 8; a file whose largest channel is below 256 holds 8-bit
//!   colours, as many writers do, and keeps the lower 8.
//! - Waveforms, near infrared, extra bytes and the coordinate system are not read.

mod compressed;
mod header;
mod read;
#[cfg(test)]
mod tests;

pub(crate) use read::read;

/// Name of the format in errors.
const FORMAT: &str = "LAS";
