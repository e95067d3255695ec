//! A height of degree 2 over the plane of a query's neighbours, its normal and its curvatures. `jet.wesl` is the twin of this
//! file.
//!
//! Source: Cazals2005. With the height z = f(u, v) over the query, its normal is (−f_u, −f_v, 1) at length 1, and the principal
//! curvatures are the roots of κ² − 2 H κ + K with the mean and Gaussian curvatures H and K (DoCarmo1976, §3.3).

use super::sample::Samples;
use crate::application::PointFlags;
use crate::geometry::height_field::HeightFit;
use crate::geometry::vector::{self, Vector};

/// What a height tells of the surface at the query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Jet {
    /// Of length 1, on the side of the plane's.
    pub(super) normal: Vector<f64>,
    /// The larger and the smaller principal curvature, one over the unit of the points.
    pub(super) curvatures: [f64; 2],
}

/// The height over the plane with this normal.
///
/// # Errors
/// The flag that says why there is none.
pub(super) fn fit_jet(samples: &Samples, normal: Vector<f64>) -> Result<Jet, PointFlags> {
    if samples.all.len() < 6 {
        return Err(PointFlags::FEW_NEIGHBORS);
    }
    let [tangent, bitangent] = vector::tangents(normal);
    let mut fit = HeightFit::new(2);
    for sample in &samples.all {
        let along = |axis| vector::dot(sample.offset, axis);
        fit.add(along(tangent), along(bitangent), along(normal), sample.weight);
    }
    let [_, fu, fv, uu, uv, vv, ..] = fit.solve().ok_or(PointFlags::DEGENERATE)?;
    let slope = vector::add(vector::scale(tangent, -fu), vector::scale(bitangent, -fv));
    let steep = vector::add(normal, slope);
    let normal = vector::normalized(steep).ok_or(PointFlags::DEGENERATE)?;
    let curvatures = principal_curvatures([fu, fv], [2.0 * uu, uv, 2.0 * vv]);
    Ok(Jet { normal, curvatures: curvatures.map(|curvature| curvature / samples.radius) })
}

/// The larger and the smaller curvature of a height with these first and second derivatives.
fn principal_curvatures([fu, fv]: [f64; 2], [fuu, fuv, fvv]: [f64; 3]) -> [f64; 2] {
    let w2 = 1.0 + fu * fu + fv * fv;
    let w = w2.sqrt();
    let gaussian = (fuu * fvv - fuv * fuv) / (w2 * w2);
    let mean = ((1.0 + fv * fv) * fuu - 2.0 * fu * fv * fuv + (1.0 + fu * fu) * fvv) / (2.0 * w2 * w);
    let root = (mean * mean - gaussian).max(0.0).sqrt();
    [mean + root, mean - root]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curvatures_of_a_slanted_sphere_are_those_of_its_radius() {
        // z = √(4 − u² − v²) at (0.6, −0.8): derivatives in closed form, both curvatures −1/2.
        let (u, v) = (0.6f64, -0.8f64);
        let z = (4.0 - u * u - v * v).sqrt();
        let second = |a: f64, b: f64, same: f64| -(same * z * z + a * b) / (z * z * z);
        let found = principal_curvatures([-u / z, -v / z], [second(u, u, 1.0), second(u, v, 0.0), second(v, v, 1.0)]);
        assert!(found.iter().all(|k| (k + 0.5).abs() < 1e-7), "{found:?}");
    }

    #[test]
    fn a_paraboloid_is_found_again() {
        // z = u²/2 − v² over a plane that is turned, in units of 10: curvatures 1/10 and −2/10.
        let n = [0.48, 0.6, -0.64];
        let [tangent, bitangent] = vector::tangents(n);
        let mut samples = Samples::default();
        samples.begin();
        for i in 0..30u32 {
            let (u, v) = (f64::from(i % 6) / 3.0 - 0.7, f64::from(i / 6) / 3.0 - 0.6);
            let flat = vector::add(vector::scale(tangent, u), vector::scale(bitangent, v));
            samples.add(vector::scale(vector::add_scaled(flat, n, u * u / 2.0 - v * v), 10.0));
        }
        samples.finish(10.0, None);
        let jet = fit_jet(&samples, n).unwrap();
        assert!(vector::norm(vector::subtract(jet.normal, n)) < 1e-12, "{jet:?}");
        let [larger, smaller] = jet.curvatures;
        assert!((larger - 0.1).abs() < 1e-12 && (smaller + 0.2).abs() < 1e-12, "{jet:?}");
        // Over a plane that is a little off, the same surface.
        let off = vector::normalized(vector::add_scaled(n, tangent, 0.01)).unwrap();
        let turned = fit_jet(&samples, off).unwrap();
        assert!(vector::norm(vector::subtract(turned.normal, n)) < 1e-2, "{turned:?}");
    }

    #[test]
    fn neighbors_without_a_height_have_flags() {
        let mut samples = Samples::default();
        samples.begin();
        (0..5).for_each(|i| samples.add([f64::from(i), f64::from(i * i), 0.0]));
        samples.finish(1.0, None);
        assert_eq!(fit_jet(&samples, [0.0, 0.0, 1.0]), Err(PointFlags::FEW_NEIGHBORS));
        // On two lines, which are a curve of degree 2.
        samples.begin();
        (0..20).for_each(|i| samples.add([f64::from(i / 2), f64::from(i % 2), 0.0]));
        samples.finish(10.0, None);
        assert_eq!(fit_jet(&samples, [0.0, 0.0, 1.0]), Err(PointFlags::DEGENERATE));
    }
}
