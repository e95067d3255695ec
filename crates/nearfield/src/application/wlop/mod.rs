//! Locally optimal projection: a few samples move onto the surface that many noisy points suggest, and spread evenly over it.
//!
//! Each sample is drawn to the points around it, near ones more, and pushed away by the other samples (Lipman2007). Points in
//! crowded places can draw less, and samples in crowded places push more, so that the samples spread however the points do
//! (Huang2009). With θ(r) = exp(−r² / (h / 4)²), points p and samples x an iteration moves every sample at once to
//!
//! x ← Σ p α / v ÷ Σ α / v + μ Σ (x − x′) w′ β ÷ Σ w′ β, with α = θ(r) / r, β = θ(r) / r, v = 1 + Σ θ and w = 1 + Σ θ
//!
//! over those within the radius; in the first iteration α = θ. [`WlopVariant`] has this formula and three others. No normals are
//! needed, and none are made.
//!
//! # Differs
//! Radii scale with the points ([`WlopSettings`]). Distances below a thousandth of the radius count as that where they are
//! divided by; samples at one place, which could not part, do not push each other, and random ones do not begin at one place. The
//! caller's points keep their order.
//!
//! # Cost
//! An iteration searches the points once and the samples twice for each sample; nothing is kept of neighbours. Weights v take one
//! search of the points for each point, once. The tree over the samples is refitted. On a device all stays there; the host reads some
//! sums every ten iterations.
//!
//! # Which one
//! [`WlopVariant::Best`]. The radius is to hold two or three rings of samples and five deviations of the noise in its quarter
//! ([`noise_check`]): with less, samples follow the noise.
//!
//! # What holds
//! 1. Number and order of the samples never change; [`PointFlags`](super::PointFlags) say which have no neighbours, and
//!    [`WlopSamples::keep_attracted`] drops those on outliers where a caller wants that.
//! 2. On the CPU the result is the same bytes whatever the number of threads.
//! 3. Every weight is made of squared distances in parts of the squared radius: the unit of the points does not matter, but to
//!    [`WlopVariant::Cgal`].

mod cpu;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
mod gpu_layout;
mod noise;
mod pairs;
mod report;
mod samples;
mod settings;
mod snap;
mod start;
mod variant;

pub use cpu::Wlop;
#[cfg(feature = "gpu")]
pub use gpu::GpuWlop;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use gpu_layout::{AdvanceParameters, DensityParameters, PairParameters, Pull, Record, RecordPart};
pub use noise::{NoiseCheck, estimate_noise, noise_check};
pub use report::WlopReport;
pub use samples::WlopSamples;
pub use settings::WlopSettings;
pub use snap::Snap;
pub use start::{WlopStart, random_subset};
pub use variant::WlopVariant;
