//! What moving least squares can be asked for.

use crate::application::Length;
use crate::application::mls::Weight;
use crate::geometry::Scalar;
use crate::{Error, Result};

/// How the plane of [`MlsMethod::Pss`] is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PlaneSearch {
    /// The plane that minimises the weighted squared distances with weights about the point's own foot on it (Alexa2001,
    /// Levin2003).
    Full,
    /// The plane of the weighted mean and covariance: "almost orthogonal" (Adamson2004). Projects idempotently.
    Fast,
}

/// A surface that is fitted to the samples near a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MlsMethod {
    /// A point-set surface: a plane, and a polynomial height over it. Needs no normals.
    Pss {
        /// Degree of the polynomial, 0 (the plane alone, which shrinks what it smooths) to 3.
        degree: u8,
        /// How the plane is found.
        plane: PlaneSearch,
    },
    /// An algebraic sphere (Guennebaud2007). Needs oriented normals.
    Apss {
        /// 1 for spheres as they fit, 0 for planes, others between.
        sphericity: f64,
    },
    /// Planes at the samples, blended by distance and by how far their normals differ: keeps edges (Oztireli2009). Needs oriented
    /// normals.
    Rimls {
        /// How much normals may differ: 0.5 for sharp edges, 0.75 usual, 2 for soft ones.
        normal_width: f64,
    },
    /// Along the normal by a mean of the heights over the samples' planes, with weights by distance and normal (Huang2013, §4, as
    /// in CGAL); no other weight is used. Needs oriented normals.
    Bilateral {
        /// Normals up to about so many degrees apart count as of one face: 0 to 90, larger is smoother.
        sharpness_degrees: f64,
    },
    /// The plane of the neighbours, all counting alike, and a height of degree 2 over it (Cazals2005, as in CGAL); weights are not
    /// used. Needs no normals. Meant for the k nearest.
    Jet,
}

impl MlsMethod {
    /// Point-set surfaces of degree 2, by the fast form.
    pub const PSS: Self = Self::Pss { degree: 2, plane: PlaneSearch::Fast };
    /// Algebraic spheres.
    pub const APSS: Self = Self::Apss { sphericity: 1.0 };
    /// Robust implicit surfaces with the usual width.
    pub const RIMLS: Self = Self::Rimls { normal_width: 0.75 };
    /// Bilateral with the angle that CGAL's examples use.
    pub const BILATERAL: Self = Self::Bilateral { sharpness_degrees: 30.0 };

    /// In lower case.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Pss { .. } => "pss",
            Self::Apss { .. } => "apss",
            Self::Rimls { .. } => "rimls",
            Self::Bilateral { .. } => "bilateral",
            Self::Jet => "jet",
        }
    }

    /// Whether the samples must have oriented normals.
    pub const fn needs_normals(&self) -> bool {
        matches!(self, Self::Apss { .. } | Self::Rimls { .. } | Self::Bilateral { .. })
    }

    /// Fewest neighbours, the point itself among them where it is a sample: those that determine the surface.
    pub const fn least_neighbors(&self) -> u32 {
        let degree = match self {
            Self::Pss { degree, .. } => *degree as u32,
            Self::Jet => 2,
            _ => 1,
        };
        let coefficients = (degree + 1) * (degree + 2) / 2;
        if coefficients < 3 { 3 } else { coefficients }
    }

    fn validate(&self) -> Result<()> {
        let (found, expected) = match *self {
            Self::Pss { degree, .. } if degree > 3 => {
                (format!("a polynomial of degree {degree}"), "a degree from 0 to 3")
            }
            Self::Apss { sphericity } if !(0.0..=1.0).contains(&sphericity) => {
                (format!("a sphericity of {sphericity}"), "0 (planes) to 1 (spheres)")
            }
            Self::Rimls { normal_width } if !(0.05..=100.0).contains(&normal_width) => {
                (format!("a width of normals of {normal_width}"), "0.05 to 100; 0.5 is sharp, 2 is soft")
            }
            Self::Bilateral { sharpness_degrees } if !(sharpness_degrees > 0.0 && sharpness_degrees <= 90.0) => {
                (format!("a sharpness of {sharpness_degrees} degrees"), "more than 0 and at most 90")
            }
            _ => return Ok(()),
        };
        Err(Error::InvalidSetting { setting: "method of moving least squares", found, expected })
    }
}

/// Settings of moving least squares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MlsSettings {
    /// The surface.
    pub method: MlsMethod,
    /// How samples count by distance.
    pub weight: Weight,
    /// A projected point has arrived once it moves less than this; never less than four roundings of its coordinates.
    pub accuracy: Length,
    /// Most steps of a projected point.
    pub most_steps: u32,
    /// A point is outside where it is farther than this part of the radius from the mean of its neighbours.
    pub domain: f64,
}

impl MlsSettings {
    /// A method with the quartic weight, projecting to 1e-4 of the spacing in at most 15 steps.
    pub const fn new(method: MlsMethod) -> Self {
        Self { method, weight: Weight::Quartic, accuracy: Length::Spacings(1e-4), most_steps: 15, domain: 0.5 }
    }

    /// With another weight.
    pub const fn weight(self, weight: Weight) -> Self {
        Self { weight, ..self }
    }

    /// Whether all of them can be used.
    ///
    /// # Errors
    /// `InvalidSetting`.
    pub fn validate(&self) -> Result<()> {
        self.method.validate()?;
        self.weight.validate()?;
        if self.most_steps == 0 {
            let expected = "at least 1";
            return Err(Error::InvalidSetting { setting: "most steps", found: "0".to_owned(), expected });
        }
        if !(self.domain > 0.0) {
            let (found, expected) = (self.domain.to_string(), "a number above 0, such as 0.5");
            return Err(Error::InvalidSetting { setting: "domain", found, expected });
        }
        Ok(())
    }
}

impl Default for MlsSettings {
    /// Algebraic spheres.
    fn default() -> Self {
        Self::new(MlsMethod::APSS)
    }
}

/// Which samples a point is fitted to. Samples at exactly the radius are among them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Support<'a, T> {
    /// Those within one radius.
    Radius(T),
    /// Those within a radius of each query.
    OfQueries(&'a [T]),
    /// Those whose own ball reaches the query: a radius of each sample. Searches go as far as the largest.
    OfPoints(&'a [T]),
    /// The k nearest beside the point itself: the radius is the distance of the last, found again in each iteration.
    Nearest(u32),
}

impl<T: Scalar> Support<'_, T> {
    /// Whether its lengths are of use for so many queries and samples.
    ///
    /// # Errors
    /// `InvalidSetting`, `LengthMismatch`.
    pub(super) fn validate(&self, n_queries: usize, n_points: usize) -> Result<()> {
        let refuse = |found: String| {
            let expected = "finite lengths above 0, or at least 3 nearest points";
            Err(Error::InvalidSetting { setting: "support", found, expected })
        };
        let usable = |radius: &T| *radius > T::ZERO && radius.is_finite() && *radius < T::MAX_COORDINATE;
        let each = |radii: &[T], what, n: usize| match radii.iter().position(|radius| !usable(radius)) {
            _ if radii.len() != n => Err(Error::LengthMismatch { what, found: radii.len() as u64, expected: n as u64 }),
            Some(i) => refuse(format!("a radius of {:?} at index {i}", radii[i])),
            None => Ok(()),
        };
        match self {
            Self::Radius(radius) if !usable(radius) => refuse(format!("a radius of {radius:?}")),
            Self::Nearest(k) if *k < 3 => refuse(format!("{k} nearest points")),
            Self::OfQueries(radii) => each(radii, "radii of the queries", n_queries),
            Self::OfPoints(radii) => each(radii, "radii of the points", n_points),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_say_what_they_need() {
        let least = |method: MlsMethod| (method.least_neighbors(), method.needs_normals());
        let pss = |degree| MlsMethod::Pss { degree, plane: PlaneSearch::Full };
        assert_eq!([0, 1, 2, 3].map(|degree| least(pss(degree)).0), [3, 3, 6, 10]);
        assert_eq!(least(MlsMethod::Jet), (6, false));
        assert!([MlsMethod::APSS, MlsMethod::RIMLS, MlsMethod::BILATERAL].map(least).iter().all(|m| *m == (3, true)));
    }

    #[test]
    fn settings_out_of_range_are_errors() {
        let default = MlsSettings::default();
        default.validate().unwrap();
        for settings in [
            MlsSettings::new(MlsMethod::Pss { degree: 4, plane: PlaneSearch::Fast }),
            MlsSettings::new(MlsMethod::Apss { sphericity: f64::NAN }),
            MlsSettings::new(MlsMethod::Rimls { normal_width: 0.0 }),
            MlsSettings::new(MlsMethod::Bilateral { sharpness_degrees: 91.0 }),
            MlsSettings { most_steps: 0, ..default },
            MlsSettings { domain: 0.0, ..default },
            default.weight(Weight::Gaussian { widths: -1.0 }),
        ] {
            assert!(matches!(settings.validate(), Err(Error::InvalidSetting { .. })), "{settings:?}");
        }
    }

    #[test]
    fn supports_out_of_range_are_errors() {
        for support in [
            Support::Radius(0.0),
            Support::Radius(f64::NAN),
            Support::OfQueries(&[1.0, -1.0]),
            Support::OfPoints(&[1.0, 1.0, f64::INFINITY]),
            Support::Nearest(2),
        ] {
            assert!(matches!(support.validate(2, 3), Err(Error::InvalidSetting { .. })), "{support:?}");
        }
        assert!(matches!(Support::OfQueries(&[1.0f32]).validate(2, 3), Err(Error::LengthMismatch { .. })));
        Support::OfPoints(&[1.0, 1.0, 2.0f32]).validate(2, 3).unwrap();
    }
}
