//! Normals towards where the points were seen from.

use super::Normals;
use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};
use crate::{Error, Result};

/// Where points were seen from, in their unit.
#[derive(Debug, Clone, Copy)]
pub enum Viewpoint<'a, T> {
    /// All from one place.
    One(Vector<T>),
    /// Each from its own: a scanner that moved.
    Each(&'a [Vector<T>]),
}

/// Turns every normal to the side of its viewpoint; those at right angles to the line of sight stay. Returns how many were
/// turned.
///
/// - `points`: `[n]` positions
///
/// # Errors
/// `LengthMismatch`; `NonFinite` for viewpoints: the normals are then as they were.
pub fn orient_by_viewpoint<T: Scalar>(
    points: &[Vector<T>],
    normals: &mut Normals<T>,
    viewpoint: Viewpoint<'_, T>,
) -> Result<u64> {
    normals.check_length(points.len())?;
    check(&viewpoint, points.len())?;
    let mut flipped = 0;
    for (i, &point) in points.iter().enumerate() {
        let eye = match viewpoint {
            Viewpoint::One(eye) => eye,
            Viewpoint::Each(eyes) => eyes[i],
        };
        if vector::dot(normals.vectors[i], vector::subtract(eye, point)) < T::ZERO {
            normals.flip(i);
            flipped += 1;
        }
    }
    Ok(flipped)
}

fn check<T: Scalar>(viewpoint: &Viewpoint<'_, T>, points: usize) -> Result<()> {
    let eyes = match viewpoint {
        Viewpoint::One(eye) => std::slice::from_ref(eye),
        Viewpoint::Each(eyes) if eyes.len() != points => {
            let (found, expected) = (eyes.len() as u64, points as u64);
            return Err(Error::LengthMismatch { what: "viewpoints", found, expected });
        }
        Viewpoint::Each(eyes) => eyes,
    };
    let is_invalid = |eye: &&Vector<T>| eye.iter().any(|x| !x.is_finite());
    match eyes.iter().position(|eye| is_invalid(&eye)) {
        None => Ok(()),
        Some(first) => {
            let count = eyes.iter().filter(is_invalid).count() as u64;
            Err(Error::NonFinite { what: "viewpoints", count, first: first as u64 })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_face_their_viewpoint() {
        let points = [[0.0f64, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
        let up = [0.0, 0.0, 1.0];
        let down = [0.0, 0.0, -1.0];
        let mut normals = Normals::of_vectors(&[up, down, [0.0; 3]]);
        assert_eq!(orient_by_viewpoint(&points, &mut normals, Viewpoint::One([9.0, 9.0, 1.0])).unwrap(), 1);
        assert_eq!(normals.vectors, [up, up, [0.0; 3]]);
        let eyes = [[0.0, 0.0, -5.0], [0.0, 0.0, 5.0], [0.0; 3]];
        assert_eq!(orient_by_viewpoint(&points, &mut normals, Viewpoint::Each(&eyes)).unwrap(), 1);
        assert_eq!(normals.vectors, [down, up, [0.0; 3]]);
    }

    #[test]
    fn wrong_viewpoints_are_errors() {
        let points = [[0.0f32; 3]; 2];
        let mut normals = Normals::of_vectors(&[[0.0f32, 0.0, 1.0]; 2]);
        let mut orient = |viewpoint| orient_by_viewpoint(&points, &mut normals, viewpoint).unwrap_err();
        let short = orient(Viewpoint::Each(&[[0.0; 3]]));
        assert!(matches!(short, Error::LengthMismatch { found: 1, expected: 2, .. }), "{short}");
        let invalid = orient(Viewpoint::Each(&[[0.0; 3], [f32::NAN, 0.0, 0.0]]));
        assert!(matches!(invalid, Error::NonFinite { count: 1, first: 1, .. }), "{invalid}");
    }
}
