//! Clouds, and the ways in which they move from one step to the next.

use nearfield::Vec3;

use crate::support::Random;

/// The radius of most questions.
pub(crate) const RADIUS: f32 = 0.25;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Motion {
    /// Every point by up to this share of the radius along each axis.
    Drift(f32),
    /// Every point away from the first one, to ten times the distance.
    Explode,
    /// Every tenth point to another place of the box.
    Teleport,
    /// Every twentieth point out of the box, by up to a thousand of its edges.
    Leave,
    /// All points to the place of one.
    Collapse,
    /// All points back into the box.
    Return,
}

impl Motion {
    pub(crate) const ALL: [Self; 9] = [
        Self::Drift(0.001),
        Self::Drift(0.01),
        Self::Drift(0.1),
        Self::Drift(1.0),
        Self::Explode,
        Self::Teleport,
        Self::Leave,
        Self::Collapse,
        Self::Return,
    ];

    /// Moves the points.
    pub(crate) fn apply(self, points: &mut [Vec3], random: &mut Random) {
        let first = points.first().copied().unwrap_or_default();
        match self {
            Self::Drift(share) => points.iter_mut().for_each(|p| *p += share * RADIUS * in_box(random)),
            Self::Explode => points.iter_mut().for_each(|p| *p = first + 10.0 * (*p - first)),
            Self::Teleport => points.iter_mut().step_by(10).for_each(|p| *p = in_box(random)),
            Self::Leave => points.iter_mut().step_by(20).for_each(|p| *p += 2000.0 * in_box(random)),
            Self::Collapse => points.fill(first),
            Self::Return => points.iter_mut().for_each(|p| *p = in_box(random)),
        }
    }
}

/// A place from -1 to 1 on each axis.
pub(crate) fn in_box(random: &mut Random) -> Vec3 {
    let mut coordinate = || 2.0 * random.unit() - 1.0;
    Vec3::new(coordinate(), coordinate(), coordinate())
}

pub(crate) fn uniform(n: usize, random: &mut Random) -> Vec<Vec3> {
    (0..n).map(|_| in_box(random)).collect()
}

/// Clouds to begin with, by name.
pub(crate) fn clouds(n: usize, random: &mut Random) -> Vec<(&'static str, Vec<Vec3>)> {
    let mut two_densities = uniform(n, random);
    // Half of the points in a thousandth of the box.
    two_densities.iter_mut().skip(n / 2).for_each(|p| *p *= 0.1);
    // More at one place than the bucket of 20 holds.
    let places = uniform(n.div_ceil(50), random);
    let duplicates = (0..n).map(|i| places[i % places.len()]).collect();
    let flat = uniform(n, random).into_iter().map(|p| Vec3::new(p.x, 0.5, p.z)).collect();
    vec![
        ("uniform", uniform(n, random)),
        ("densities 1000 : 1", two_densities),
        ("duplicates", duplicates),
        ("flat", flat),
    ]
}
