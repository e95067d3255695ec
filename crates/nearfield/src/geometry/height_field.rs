//! A polynomial height over a plane, fitted to weighted samples by least squares.
//!
//! The normal equations are summed sample by sample, in a fixed number of words, and solved by Cholesky's factorisation
//! (GolubVanLoan2013, §4.2). They square the condition of the problem: give coordinates divided by the radius of the samples, which
//! keeps it below 10⁵ at degree 3.

use super::Scalar;

/// The highest degree.
pub const MAX_DEGREE: usize = 4;
/// Coefficients at the highest degree.
const MOST: usize = n_coefficients(MAX_DEGREE);
/// Elements of a triangle of the normal matrix at the highest degree.
const MOST_ELEMENTS: usize = MOST * (MOST + 1) / 2;

/// Coefficients of a polynomial in two variables: 1, 3, 6, 10, 15.
pub const fn n_coefficients(degree: usize) -> usize {
    (degree + 1) * (degree + 2) / 2
}

/// Sums for a fit.
#[derive(Debug, Clone)]
pub struct HeightFit<T> {
    degree: usize,
    /// Lower triangle of Σ w · m mᵀ by rows, with the monomials m.
    matrix: [T; MOST_ELEMENTS],
    /// Σ w · m · height.
    right: [T; MOST],
}

impl<T: Scalar> HeightFit<T> {
    /// No sample yet; `degree` at most [`MAX_DEGREE`].
    pub fn new(degree: usize) -> Self {
        assert!(degree <= MAX_DEGREE, "a height has a degree of at most {MAX_DEGREE}, not {degree}");
        Self { degree, matrix: [T::ZERO; MOST_ELEMENTS], right: [T::ZERO; MOST] }
    }

    /// Adds a sample.
    #[inline]
    pub fn add(&mut self, u: T, v: T, height: T, weight: T) {
        let (monomials, n) = (monomials(u, v, self.degree), n_coefficients(self.degree));
        let mut element = 0;
        for i in 0..n {
            let scaled = weight * monomials[i];
            for monomial in &monomials[..=i] {
                self.matrix[element] += scaled * *monomial;
                element += 1;
            }
            self.right[i] += scaled * height;
        }
    }

    /// Coefficients of 1, u, v, u², uv, v², u³, u²v, uv², v³ …, those beyond the degree 0. `None` where the samples do not
    /// determine them: too few, or on a curve on which a polynomial of this degree is 0.
    pub fn solve(&self) -> Option<[T; MOST]> {
        let n = n_coefficients(self.degree);
        let at = |i: usize, j: usize| i * (i + 1) / 2 + j;
        let mut l = self.matrix;
        for j in 0..n {
            let own = l[at(j, j)];
            let pivot = (0..j).fold(own, |sum, k| sum - l[at(j, k)] * l[at(j, k)]);
            // What is left after the rounding of n products is no longer known.
            if !(pivot > T::of(8.0 * n as f64) * T::EPSILON * own) {
                return None;
            }
            let root = pivot.sqrt();
            l[at(j, j)] = root;
            for i in j + 1..n {
                let sum = (0..j).fold(l[at(i, j)], |sum, k| sum - l[at(i, k)] * l[at(j, k)]);
                l[at(i, j)] = sum / root;
            }
        }
        let mut x = self.right;
        for i in 0..n {
            let sum = (0..i).fold(x[i], |sum, k| sum - l[at(i, k)] * x[k]);
            x[i] = sum / l[at(i, i)];
        }
        for i in (0..n).rev() {
            let sum = (i + 1..n).fold(x[i], |sum, k| sum - l[at(k, i)] * x[k]);
            x[i] = sum / l[at(i, i)];
        }
        x[..n].iter().all(|c| c.is_finite()).then_some(x)
    }
}

/// 1, u, v, u², uv, v² …
#[inline]
fn monomials<T: Scalar>(u: T, v: T, degree: usize) -> [T; MOST] {
    let mut made = [T::ZERO; MOST];
    made[0] = T::ONE;
    let mut first = 0;
    for d in 1..=degree {
        let next = first + d;
        for i in 0..d {
            made[next + i] = made[first + i] * u;
        }
        made[next + d] = made[next - 1] * v;
        first = next;
    }
    made
}

#[cfg(test)]
mod tests {
    use super::*;

    fn height(u: f64, v: f64, degree: usize) -> f64 {
        let all = monomials(u, v, degree);
        all.iter().zip(1..).map(|(m, i)| m * (f64::from(i) * 0.7).sin()).sum()
    }

    #[test]
    fn monomials_stand_in_order() {
        let [one, u, v, uu, uv, vv, uuu, uuv, uvv, vvv, ..] = monomials(2.0f64, 3.0, 3);
        assert_eq!([one, u, v, uu, uv, vv], [1.0, 2.0, 3.0, 4.0, 6.0, 9.0]);
        assert_eq!([uuu, uuv, uvv, vvv], [8.0, 12.0, 18.0, 27.0]);
    }

    #[test]
    fn a_polynomial_is_found_again() {
        for degree in 0..=MAX_DEGREE {
            let (mut fit, mut rough) = (HeightFit::<f64>::new(degree), HeightFit::<f32>::new(degree));
            for i in 0..49u32 {
                let (u, v) = (f64::from(i % 7) / 3.0 - 1.0, f64::from(i / 7) / 3.0 - 1.0);
                let weight = 0.1 + f64::from(i * 13 % 17);
                fit.add(u, v, height(u, v, degree), weight);
                rough.add(u as f32, v as f32, height(u, v, degree) as f32, weight as f32);
            }
            let (found, rough) = (fit.solve().unwrap(), rough.solve().unwrap());
            for i in 0..MOST {
                let expected = if i < n_coefficients(degree) { (f64::from(i as u32 + 1) * 0.7).sin() } else { 0.0 };
                assert!((found[i] - expected).abs() < 1e-10, "degree {degree}, {i}: {}", found[i]);
                assert!((f64::from(rough[i]) - expected).abs() < 1e-3, "degree {degree}, {i}: {}", rough[i]);
            }
        }
    }

    #[test]
    fn samples_that_determine_nothing_give_nothing() {
        let mut fit = HeightFit::<f32>::new(2);
        assert_eq!(fit.solve(), None);
        // On a line, and on a circle: u² + v² − 1 is 0 on all of them.
        (0..40u8).map(f32::from).for_each(|i| fit.add(i / 40.0, i / 80.0, 1.0, 1.0));
        assert_eq!(fit.solve(), None);
        let mut fit = HeightFit::<f32>::new(2);
        (0..40u8).map(|i| f32::from(i) * 0.17).for_each(|a| fit.add(a.cos(), a.sin(), a, 1.0));
        assert_eq!(fit.solve(), None);
    }
}
