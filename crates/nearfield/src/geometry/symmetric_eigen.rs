//! Eigenvalues and eigenvectors of symmetric 3 × 3 matrices, by Jacobi's rotations (GolubVanLoan2013, §8.5).
//! `symmetric_eigen.wesl` is the twin of this file.
//!
//! Rotations keep the relative accuracy of small eigenvalues and give orthonormal vectors also where eigenvalues are equal,
//! which closed forms by the cubic's roots do not.

use super::Scalar;
use super::vector::{self, Vector};

/// Sweeps over the three elements off the diagonal. They converge quadratically: four bring f32 to its last digits, six f64.
const SWEEPS: usize = 6;

/// A symmetric matrix by its upper triangle: xx, xy, xz, yy, yz, zz.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Symmetric<T>(pub [T; 6]);

impl<T: Scalar> Symmetric<T> {
    /// The sum with w · v vᵀ.
    #[inline(always)]
    pub fn add_outer(&mut self, v: Vector<T>, w: T) {
        let [x, y, z] = v;
        let scaled = vector::scale(v, w);
        self.0[0] += scaled[0] * x;
        self.0[1] += scaled[0] * y;
        self.0[2] += scaled[0] * z;
        self.0[3] += scaled[1] * y;
        self.0[4] += scaled[1] * z;
        self.0[5] += scaled[2] * z;
    }

    /// The product with a vector.
    #[inline(always)]
    pub fn times(&self, v: Vector<T>) -> Vector<T> {
        let [xx, xy, xz, yy, yz, zz] = self.0;
        [vector::dot([xx, xy, xz], v), vector::dot([xy, yy, yz], v), vector::dot([xz, yz, zz], v)]
    }

    /// Its eigenvalues and eigenvectors.
    pub fn eigen(&self) -> Eigen<T> {
        let [xx, xy, xz, yy, yz, zz] = self.0;
        let mut jacobi = Jacobi {
            a: [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]],
            v: [[T::ONE, T::ZERO, T::ZERO], [T::ZERO, T::ONE, T::ZERO], [T::ZERO, T::ZERO, T::ONE]],
        };
        for _ in 0..SWEEPS {
            jacobi.rotate(0, 1);
            jacobi.rotate(0, 2);
            jacobi.rotate(1, 2);
        }
        jacobi.sorted()
    }
}

/// What a symmetric matrix does along its own axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Eigen<T> {
    /// Ascending.
    pub values: [T; 3],
    /// Orthonormal, that of `values[i]` at i; each up to its sign.
    pub vectors: [Vector<T>; 3],
}

/// A matrix on its way to the diagonal, and the rotations so far: rows of `v` become the eigenvectors.
struct Jacobi<T> {
    a: [[T; 3]; 3],
    v: [Vector<T>; 3],
}

impl<T: Scalar> Jacobi<T> {
    /// Rotates the plane of axes p and q such that the element at (p, q) vanishes.
    #[inline(always)]
    fn rotate(&mut self, p: usize, q: usize) {
        let apq = self.a[p][q];
        if apq == T::ZERO {
            return;
        }
        let r = 3 - p - q;
        let theta = (self.a[q][q] - self.a[p][p]) / (apq + apq);
        let sign = if theta < T::ZERO { -T::ONE } else { T::ONE };
        // A theta whose square is infinite makes t 0, and the element is dropped as it should be.
        let t = sign / (theta.abs() + (theta * theta + T::ONE).sqrt());
        let c = T::ONE / (t * t + T::ONE).sqrt();
        let s = t * c;
        self.a[p][p] -= t * apq;
        self.a[q][q] += t * apq;
        let (arp, arq) = (self.a[r][p], self.a[r][q]);
        (self.a[r][p], self.a[r][q]) = (c * arp - s * arq, s * arp + c * arq);
        (self.a[p][r], self.a[q][r]) = (self.a[r][p], self.a[r][q]);
        (self.a[p][q], self.a[q][p]) = (T::ZERO, T::ZERO);
        for axis in 0..3 {
            let (vp, vq) = (self.v[p][axis], self.v[q][axis]);
            (self.v[p][axis], self.v[q][axis]) = (c * vp - s * vq, s * vp + c * vq);
        }
    }

    fn sorted(self) -> Eigen<T> {
        let (mut values, mut vectors) = ([self.a[0][0], self.a[1][1], self.a[2][2]], self.v);
        for (i, j) in [(0, 1), (1, 2), (0, 1)] {
            if values[j] < values[i] {
                values.swap(i, j);
                vectors.swap(i, j);
            }
        }
        Eigen { values, vectors }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A · v = λ · v, orthonormal, ascending, to `digits` of the largest eigenvalue.
    fn check<T: Scalar>(a: &Symmetric<T>, tolerance: f64) {
        let Eigen { values, vectors } = a.eigen();
        assert!(values[0] <= values[1] && values[1] <= values[2], "{a:?}: {values:?}");
        let largest = values.iter().map(|v| v.to_f64().abs()).fold(0.0, f64::max);
        for i in 0..3 {
            let off = vector::subtract(a.times(vectors[i]), vector::scale(vectors[i], values[i]));
            assert!(vector::norm(off).to_f64() <= tolerance * largest, "{a:?}: {off:?}");
            for j in 0..3 {
                let expected = f64::from(u8::from(i == j));
                let found = vector::dot(vectors[i], vectors[j]).to_f64();
                assert!((found - expected).abs() < 4.0 * tolerance, "{a:?}: {found}");
            }
        }
    }

    #[test]
    fn vectors_are_orthonormal_and_scaled_by_their_values() {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1u32 << 23) - 1.0
        };
        let fixed = [
            [0.0; 6],
            [1.0, 0.0, 0.0, 1.0, 0.0, 1.0],
            [2.0, 1.0, 1.0, 2.0, 1.0, 2.0],
            [1e-12, 0.0, 1.0, 0.0, 0.0, 0.0],
        ];
        let random = (0..2000).map(|_| std::array::from_fn(|_| next()));
        for a in fixed.into_iter().chain(random) {
            check(&Symmetric(a), 1e-14);
            check(&Symmetric(a.map(|x| x as f32)), 1e-6);
            check(&Symmetric(a.map(|x| x * 1e-15)), 1e-14);
        }
    }

    #[test]
    fn a_thin_plane_keeps_its_small_eigenvalue() {
        // Points of a plane with a thickness of 1e-6: the eigenvalue is twelve orders below the others.
        let mut a = Symmetric::<f64>::default();
        let n = [0.48, 0.6, -0.64];
        let [u, v] = vector::tangents(n);
        a.add_outer(u, 1.0);
        a.add_outer(v, 0.7);
        a.add_outer(n, 1e-12);
        let eigen = a.eigen();
        assert!((eigen.values[0] - 1e-12).abs() < 1e-15, "{eigen:?}");
        assert!(vector::dot(eigen.vectors[0], n).abs() > 1.0 - 1e-12);
    }
}
