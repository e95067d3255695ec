//! Simulations of particles: published numbers, what is conserved, and the same trajectory by every search.

mod dem;
mod pbf;
mod pbf_reference;
