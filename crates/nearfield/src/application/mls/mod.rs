//! Moving least squares: points move onto the smooth surface that the samples around them suggest.
//!
//! Around each point a surface is fitted to the samples near it, near ones counting more ([`Weight`]), and the point moves onto
//! it. The surfaces ([`MlsMethod`]): planes with a polynomial height (`pss.rs`; Alexa2001, Adamson2004), algebraic spheres (`apss.rs`;
//! Guennebaud2007), planes blended robustly (`rimls.rs`; Oztireli2009), the bilateral step (`bilateral.rs`; Huang2013), jets (`jet.rs`;
//! Cazals2005). Two modes by name: *project* ([`MlsProjection`], [`GpuMlsProjection`]): the samples stay; and *smooth* ([`MlsSmoothing`],
//! [`GpuMlsSmoothing`]): all points move in every iteration and are the next one's samples.
//!
//! # Cost
//! A search of a point a pass, nothing kept of its neighbours: one pass for spheres, planes and the bilateral step, two for heights
//! and jets, at most three for RIMLS and some six for the full point-set surface. On a device all stays there between iterations; some sums
//! are read.
//!
//! # Which one
//! With normals: APSS, which hardly shrinks and costs one pass. Without: PSS of degree 2. For edges: RIMLS or bilateral.
//!
//! # What holds
//! 1. Number and order of the points never change; [`PointFlags`](super::PointFlags) say what went wrong with which.
//! 2. No step is longer than the radius (of samples with their own: than the mean of those met).
//! 3. A point with fewer neighbours than the surface needs, or with neighbours on a line (middle to largest eigenvalue below 1e-6),
//!    stays.
//! 4. On the CPU the result is the same bytes whatever the number of threads.

mod apss;
mod bilateral;
mod cloud;
mod cpu;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
mod gpu_project;
#[cfg(feature = "gpu")]
mod gpu_smooth;
mod height;
mod jet;
mod project;
mod pss;
mod report;
mod rimls;
mod settings;
mod smooth;
mod spread;
mod weight;

#[cfg(feature = "gpu")]
pub use gpu::MlsPoints;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use gpu::{ConcludeParameters, FitParameters, FitState, IterationSums, PointPlace};
#[cfg(feature = "gpu")]
pub use gpu_project::GpuMlsProjection;
#[cfg(feature = "gpu")]
pub use gpu_smooth::GpuMlsSmoothing;
pub use project::MlsProjection;
pub use report::MlsReport;
pub use settings::{MlsMethod, MlsSettings, PlaneSearch, Support};
pub use smooth::MlsSmoothing;
pub use weight::Weight;
