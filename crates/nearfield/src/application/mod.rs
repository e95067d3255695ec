//! What is made of points once they can be searched. An application is one folder, written on the structures and queries
//! alone: what it needs and they lack is a missing query.

pub mod cluster;
pub mod distance_field;
pub mod domain_decomposition;
pub mod downsample;
pub mod dual_contouring;
mod finite_points;
mod length;
pub mod mls;
pub mod normals;
mod offset;
pub mod outliers;
pub mod particles;
pub mod path_trace;
mod point_flags;
mod watch;
pub mod winding_number;
pub mod wlop;

pub use cluster::{Clusters, DbscanSettings, EuclideanSettings, LeftOut, dbscan, euclidean_clusters};
#[cfg(feature = "gpu")]
pub use cluster::{GpuClusters, dbscan_on_gpu, euclidean_clusters_on_gpu};
pub use distance_field::{
    DistanceField, DistanceMode, DistanceSettings, MeshClosure, MeshDistance, OrientedSamples, SignRule, grid_around,
};
#[cfg(feature = "gpu")]
pub use distance_field::{FieldParameters, GpuDistanceField, GpuMeshDistance, GpuOrientedSamples};
pub use domain_decomposition::{Exchange, PartReport, Partition, PartitionReport, compare_curves};
pub use downsample::{
    Extent, FarthestPoints, FarthestStart, PoissonDisk, PoissonDiskSettings, VoxelOrigin, VoxelPoint, VoxelSettings,
    Voxels, farthest_points, poisson_disk, voxel_downsample,
};
#[cfg(feature = "gpu")]
pub use downsample::{farthest_points_on_gpu, voxel_downsample_on_gpu};
pub use dual_contouring::{
    Contour, ContourReport, ContourSettings, Crossing, FieldHermite, FunctionHermite, GridEdge, HermiteData,
    NodeValues, PointsHermite, VertexMode, contour, contour_with,
};
#[cfg(feature = "gpu")]
pub use dual_contouring::{ContourCell, ContourParameters, GpuContour, contour_on_gpu};
pub use length::{Length, diagonal, spacing};
#[cfg(feature = "gpu")]
pub use mls::{GpuMlsProjection, GpuMlsSmoothing, MlsPoints};
pub use mls::{MlsMethod, MlsProjection, MlsReport, MlsSettings, MlsSmoothing, PlaneSearch, Support, Weight};
#[cfg(feature = "gpu")]
pub use normals::{GpuNormals, estimate_normals_on_gpu};
pub use normals::{
    Neighborhood, NormalMethod, NormalSettings, Normals, SpanningTree, Viewpoint, WindingOrientation, estimate_normals,
    estimate_normals_at, orient_by_spanning_tree, orient_by_viewpoint, orient_by_winding_number,
};
pub use offset::{Offset, offset};
pub use outliers::{
    Duplicates, OutlierRule, RadiusOutlierSettings, RadiusOutliers, StatisticalOutlierSettings, StatisticalOutliers,
    duplicates, radius_outliers, statistical_outliers,
};
#[cfg(feature = "gpu")]
pub use outliers::{duplicates_on_gpu, radius_outliers_on_gpu, statistical_outliers_on_gpu};
pub use path_trace::{
    Camera, CameraFrame, Environment, EnvironmentImage, Film, Material, PathCounters, PathParameters, PathSettings,
    PathState, PathTracer, PointLight, Scene, Surface,
};
#[cfg(feature = "gpu")]
pub use path_trace::{GpuPathTracer, SceneLayout};
#[cfg(feature = "io")]
pub use path_trace::{SceneReader, parse_scene, read_scene};
pub use point_flags::PointFlags;
pub use watch::{Progress, Watch};
#[cfg(feature = "gpu")]
pub use winding_number::{GpuWindingNumber, WindingLayout};
pub use winding_number::{WindingNumber, disk_areas};
#[cfg(feature = "gpu")]
pub use wlop::GpuWlop;
pub use wlop::{
    NoiseCheck, Snap, Wlop, WlopReport, WlopSamples, WlopSettings, WlopStart, WlopVariant, estimate_noise, noise_check,
    random_subset,
};
