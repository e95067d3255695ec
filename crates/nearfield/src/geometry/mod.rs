//! Values and formulas: boxes, balls, rays, triangles, clouds, meshes and grids of values, and the one distance formula.

mod aabb;
pub mod closest_point;
pub mod distance;
mod distance_grid;
pub mod generate;
pub mod height_field;
pub mod mesh_intersections;
pub mod mesh_topology;
mod ordered_points;
mod point_cloud;
mod prepared_ray;
mod prepared_triangle;
mod ray;
mod regular_grid;
pub(crate) mod row_simd;
mod scalar;
mod sphere;
pub mod symmetric_eigen;
mod tri_mesh;
mod triangle;
pub mod triangle_pair;
pub mod validate;
pub mod vector;

pub use aabb::Aabb;
pub use distance::Period;
pub use distance_grid::DistanceGrid;
pub use ordered_points::OrderedPoints;
pub use point_cloud::{Attribute, Column, PointCloud};
pub use prepared_ray::{PreparedRay, RayFault, RaySpace};
pub use prepared_triangle::{LocalHit, PreparedTriangle};
pub use ray::Ray;
pub use regular_grid::RegularGrid;
pub use scalar::Scalar;
pub use sphere::Sphere;
pub use tri_mesh::TriMesh;
pub use triangle::Triangle;
