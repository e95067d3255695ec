//! Normals of points on a surface: estimated from their neighbours, then turned to one side.
//!
//! Estimation has two methods. [`NormalMethod::Pca`] takes the direction in which the neighbours spread least (Hoppe1992), exact
//! on planes and off by O(h²) at a radius h where neighbours lie unevenly. [`NormalMethod::Jet`] fits a height of degree 2
//! over that plane (Cazals2005) and takes its gradient at the query, which is O(h²) everywhere and does not suffer at the
//! border of a surface; principal curvatures come with it. Differs from Cazals2005: the fit is by Cholesky's factorisation, in
//! coordinates divided by the radius, not by singular values.
//!
//! An estimated normal has no side. [`orient_by_viewpoint`] turns it to where the points were seen from,
//! [`orient_by_spanning_tree`] to that of its neighbours, along the safest way (Hoppe1992), [`orient_by_winding_number`] to
//! the outside of the surface that all of them bound (Xu2023).
//!
//! Cost: on the CPU 40 bytes a point beside the answer, none for neighbours; the k nearest on the GPU take 8 bytes a neighbour,
//! in batches where memory is short; the spanning tree takes 12 bytes an edge. When to use: PCA for scans that are denser than
//! the details that matter, the jet where curvature matters, or noise makes large neighbourhoods necessary.
//!
//! Invariants:
//! 1. there is one normal a query, in the caller's order, whatever happens;
//! 2. a normal has length 1, or is 0 0 0 where there is none; one without a flag has length 1;
//! 3. the answer has the same bytes whatever the number of threads.

mod estimate;
#[cfg(feature = "gpu")]
mod gpu;
mod jet;
mod neighbor_graph;
mod patches;
mod plane;
mod sample;
mod spanning_tree;
mod viewpoint;
mod winding_number;

use super::{Length, PointFlags};
use crate::geometry::Scalar;
use crate::geometry::vector::Vector;
use crate::{Error, Result};

pub use estimate::{estimate_normals, estimate_normals_at};
#[cfg(feature = "gpu")]
pub use gpu::{GpuNormals, estimate_normals_on_gpu};
pub use spanning_tree::{SpanningTree, orient_by_spanning_tree};
pub use viewpoint::{Viewpoint, orient_by_viewpoint};
pub use winding_number::{WindingOrientation, orient_by_winding_number};

/// Which points an estimate is made from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Neighborhood {
    /// So many nearest points, the point itself among them; all where there are fewer.
    Nearest(u32),
    /// All points within this distance, the sphere included.
    Within(Length),
}

/// How a normal is made from neighbours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum NormalMethod {
    /// The direction in which they spread least.
    #[default]
    Pca,
    /// The gradient of a height of degree 2 over their plane, with principal curvatures.
    Jet,
}

impl NormalMethod {
    /// Fewest neighbours that determine the answer.
    pub fn fewest_neighbors(self) -> u32 {
        match self {
            Self::Pca => 3,
            Self::Jet => 6,
        }
    }
}

/// How normals are estimated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalSettings {
    /// From which points.
    pub neighborhood: Neighborhood,
    /// By which method.
    pub method: NormalMethod,
    /// Count near neighbours more: by (1 − d²/h²)⁴, with h the radius, or 1.25 times the distance of the k-th nearest. Else all
    /// count alike.
    pub weighted: bool,
}

impl NormalSettings {
    /// From the 24 nearest points by PCA, all alike.
    pub const DEFAULT: Self =
        Self { neighborhood: Neighborhood::Nearest(24), method: NormalMethod::Pca, weighted: false };

    /// From so many nearest points.
    pub fn nearest(mut self, k: u32) -> Self {
        self.neighborhood = Neighborhood::Nearest(k);
        self
    }

    /// From the points within this distance.
    pub fn within(mut self, radius: Length) -> Self {
        self.neighborhood = Neighborhood::Within(radius);
        self
    }

    /// By this method.
    pub fn method(mut self, method: NormalMethod) -> Self {
        self.method = method;
        self
    }

    /// With weights that fall with the distance.
    pub fn weighted(mut self) -> Self {
        self.weighted = true;
        self
    }

    /// Checks what needs no points.
    ///
    /// # Errors
    /// `InvalidSetting` with fewer nearest points than the method needs.
    pub fn validate(&self) -> Result<()> {
        match self.neighborhood {
            Neighborhood::Nearest(k) if k < self.method.fewest_neighbors() => Err(Error::InvalidSetting {
                setting: "nearest points",
                found: k.to_string(),
                expected: "at least 3 by PCA and 6 by the jet",
            }),
            _ => Ok(()),
        }
    }

    /// Squared support of the weight in squared radii of the neighbourhood.
    fn support2(&self) -> f64 {
        match self.neighborhood {
            // The k-th itself should count.
            Neighborhood::Nearest(_) => 1.25 * 1.25,
            Neighborhood::Within(_) => 1.0,
        }
    }
}

impl Default for NormalSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Normals and what else neighbours tell, in query order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Normals<T> {
    /// `[q]` normals of length 1; 0 0 0 where there is none.
    pub vectors: Vec<Vector<T>>,
    /// `[q]` surface variation, the part of the variance of the neighbours that is along the normal (Pauly2002): 0 on a
    /// plane, 1/3 where they spread alike in all directions. Empty for normals that were not estimated here.
    pub variation: Vec<T>,
    /// `[q]` the larger and the smaller principal curvature, one over lengths; positive where the surface bends towards
    /// the normal. Empty without [`NormalMethod::Jet`].
    pub curvatures: Vec<[T; 2]>,
    /// `[q]` what is wrong with a point:
    /// - `FEW_NEIGHBORS`: fewer than three, and there is no normal; or fewer than six for the jet, and the normal is that of
    ///   PCA, without curvatures (0 0);
    /// - `DEGENERATE`: neighbours on a line or at one place (λ₁ < 1e-6 λ₂), and there is no normal; or on a curve of degree 2,
    ///   and the normal is that of PCA, without curvatures;
    /// - `INVALID`: the query is not finite, and there is no normal.
    pub flags: Vec<PointFlags>,
}

impl<T: Scalar> Normals<T> {
    /// Normals from elsewhere, to be oriented. Each is brought to length 1; those that are 0 or not finite become 0 0 0 and
    /// are flagged `INVALID`.
    pub fn of_vectors(vectors: &[Vector<T>]) -> Self {
        let unit: Vec<_> = vectors.iter().map(|&v| crate::geometry::vector::normalized(v)).collect();
        let flag = |made: &Option<Vector<T>>| if made.is_some() { PointFlags::default() } else { PointFlags::INVALID };
        let flags = unit.iter().map(flag).collect();
        let vectors = unit.into_iter().map(|made| made.unwrap_or([T::ZERO; 3])).collect();
        Self { vectors, variation: Vec::new(), curvatures: Vec::new(), flags }
    }

    /// Number of normals.
    pub fn len(&self) -> usize {
        self.vectors.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.vectors.is_empty()
    }

    /// Whether point `i` has a normal.
    pub fn has(&self, i: usize) -> bool {
        self.vectors[i] != [T::ZERO; 3]
    }

    /// Turns normal `i` to the other side; curvatures change sign with it.
    pub fn flip(&mut self, i: usize) {
        // Not by negation, which would make −0 of 0.
        self.vectors[i] = self.vectors[i].map(|x| T::ZERO - x);
        if let Some(curvatures) = self.curvatures.get_mut(i) {
            *curvatures = [T::ZERO - curvatures[1], T::ZERO - curvatures[0]];
        }
    }

    /// Checks that there is a normal for each of `points` points.
    fn check_length(&self, points: usize) -> Result<()> {
        if self.len() == points {
            return Ok(());
        }
        let (found, expected) = (self.len() as u64, points as u64);
        Err(Error::LengthMismatch { what: "normals of points", found, expected })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_few_nearest_points_are_an_error() {
        let settings = NormalSettings::default();
        assert!(settings.nearest(3).validate().is_ok() && settings.nearest(2).validate().is_err());
        let jet = settings.method(NormalMethod::Jet);
        assert!(jet.nearest(6).validate().is_ok() && jet.nearest(5).validate().is_err());
    }

    #[test]
    fn flipped_normals_bend_the_other_way() {
        let mut normals = Normals::of_vectors(&[[0.0f32, 3.0, 4.0], [0.0; 3], [f32::NAN, 0.0, 0.0]]);
        assert_eq!(normals.vectors, [[0.0, 0.6, 0.8], [0.0; 3], [0.0; 3]]);
        assert_eq!(normals.flags, [PointFlags::default(), PointFlags::INVALID, PointFlags::INVALID]);
        normals.curvatures = vec![[3.0, -1.0]; 3];
        normals.flip(0);
        normals.flip(1);
        assert_eq!((normals.vectors[0], normals.curvatures[0]), ([0.0, -0.6, -0.8], [1.0, -3.0]));
        assert!(normals.vectors[1].iter().all(|x| x.is_sign_positive()) && !normals.has(1));
    }
}
