//! What is made of points once they can be searched. An application is one folder, written on the structures and queries
//! alone: what it needs and they lack is a missing query.

pub mod domain_decomposition;

pub use domain_decomposition::{Exchange, PartReport, Partition, PartitionReport, compare_curves};
