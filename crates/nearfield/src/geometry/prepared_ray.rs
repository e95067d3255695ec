//! Rays as the searches take them: checked, scaled, brought near the mesh, and sheared for the triangle test.
//!
//! Everything that any structure computes of a ray comes from here, so that all of them test the same numbers. Twin of
//! `prepared_ray.wesl`. Source: Woop2013.
//!
//! How the pieces fit, with R the longest side of the mesh's bounds and u = 2⁻²⁴:
//!
//! 1. The direction is scaled by a power of two until its largest component lies in [1, 2); t inside a search counts in
//!    that unit, and [`PreparedRay::caller_t`] turns it back.
//! 2. An origin farther than R from the bounds is moved along the ray to R before them, so that no corner is farther
//!    than 2R from an origin in any axis. The move rounds by u times the largest coordinate of ray and bounds.
//! 3. With that a corner in the ray's sheared frame is off by at most 12 uR (22 uR where a division is as rough as WGSL allows), and the point of a hit lies within
//!    [`RaySpace::margin`] = 2⁻¹⁷ R of the ray at its t, the error of slab tests included. A structure whose boxes are
//!    wider than the triangles by the margin on every side therefore finds every hit, and may leave out whatever
//!    begins beyond the nearest hit so far.

use glam::Vec3;

use super::{Aabb, Ray};

/// Axis directions smaller than this, in units of the largest, take this size in [`PreparedRay::inverse`].
const SMALLEST_SLOPE: f32 = 1.0 / (1u64 << 60) as f32;
/// The margin in longest sides of the bounds.
const MARGIN: f32 = 1.0 / (1u32 << 17) as f32;
/// How far off the ray the weighted corners of a hit may lie, in longest sides of the bounds.
const LATERAL: f32 = 1.0 / (1u32 << 19) as f32;

/// Where rays are cast: the bounds of a mesh and what follows from them. `RaySpace` in prepared_ray.wesl, byte for byte.
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct RaySpace {
    /// Smallest corner of all triangles.
    pub min: Vec3,
    /// Longest side of the bounds, R.
    pub reach: f32,
    /// Largest corner of all triangles.
    pub max: Vec3,
    /// By how much boxes around triangles must be wider than these on every side: 2⁻¹⁷ R.
    pub margin: f32,
}

impl RaySpace {
    /// The space of a mesh with these bounds.
    pub fn new(bounds: &Aabb) -> Self {
        let reach = bounds.extent().max_element();
        Self { min: bounds.min, reach, max: bounds.max, margin: MARGIN * reach }
    }

    /// A box grown by the margin, or to the next coordinates where the margin is finer than they are.
    #[inline]
    pub fn widened(&self, aabb: &Aabb) -> Aabb {
        let below = (aabb.min - self.margin).to_array().map(f32::next_down);
        let above = (aabb.max + self.margin).to_array().map(f32::next_up);
        Aabb::new(below.into(), above.into())
    }

    /// The widened bounds: where every hit lies.
    pub fn widened_bounds(&self) -> Aabb {
        self.widened(&Aabb::new(self.min, self.max))
    }
}

/// Why a ray cannot be cast; see [`Ray::fault`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RayFault {
    /// An origin, a direction or a limit of t that is NaN, or an infinite origin or direction.
    NonFinite,
    /// An origin beyond ±1e18.
    TooFar,
    /// A direction whose largest component is below 1.2e-38 or above 8.5e37.
    Direction,
}

impl RayFault {
    /// The fault in words.
    pub const fn reason(self) -> &'static str {
        match self {
            Self::NonFinite => "has a NaN or infinite origin or direction, or a NaN limit of t",
            Self::TooFar => "starts beyond ±1e18, the largest coordinate supported",
            Self::Direction => {
                "has no direction: its largest component must be between 1.2e-38 and 8.5e37 in size, any length but zero"
            }
        }
    }
}

impl Ray {
    /// What keeps this ray from being cast; `None` where nothing does. A range of t that is empty is no fault: such a
    /// ray hits nothing.
    pub fn fault(&self) -> Option<RayFault> {
        let finite = self.origin.is_finite() && self.direction.is_finite();
        if !finite || self.t_min.is_nan() || self.t_max.is_nan() {
            return Some(RayFault::NonFinite);
        }
        if self.origin.abs().max_element() > super::validate::MAX_COORDINATE {
            return Some(RayFault::TooFar);
        }
        let largest = self.direction.abs().max_element();
        let usable = (f32::MIN_POSITIVE..f32::MAX / 4.0).contains(&largest);
        (!usable).then_some(RayFault::Direction)
    }
}

/// A ray ready for any number of boxes and triangles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PreparedRay {
    /// Where it starts, within 2R of every corner.
    pub origin: Vec3,
    /// Direction with its largest component in [1, 2).
    pub direction: Vec3,
    /// One over the direction, always finite.
    pub inverse: Vec3,
    /// x and y of the sheared frame lose these shares of z, and z is multiplied by the third.
    pub shear: Vec3,
    /// The axis that becomes z: that of the largest component of the direction.
    pub axis: usize,
    /// Smallest t of interest, in units of `direction`, from `origin`.
    pub t_min: f32,
    /// Largest t of interest, never infinite; below `t_min` where the ray can hit nothing.
    pub t_max: f32,
    /// How far off the ray the weighted corners of a hit may lie.
    lateral: f32,
    /// t at `origin`, in units of `direction`.
    shift: f32,
    /// A unit of `direction` in the caller's.
    scale: f32,
}

impl PreparedRay {
    /// Prepares a ray without [`Ray::fault`].
    pub fn new(ray: &Ray, space: &RaySpace) -> Self {
        let size = ray.direction.abs();
        // Ties go to the axis that comes last.
        let axis = if size.z >= size.x && size.z >= size.y { 2 } else { usize::from(size.y >= size.x) };
        // The power of two below the largest component.
        let power = f32::from_bits(size[axis].to_bits() & 0x7f80_0000);
        let scale = 1.0 / power;
        let direction = ray.direction * scale;
        let inverse = Vec3::from_array(direction.to_array().map(|d| 1.0 / d.abs().max(SMALLEST_SLOPE).copysign(d)));
        let shear = {
            let [_, x, y] = [axis, (axis + 1) % 3, (axis + 2) % 3];
            let over_z = 1.0 / direction[axis];
            Vec3::new(direction[x] * over_z, direction[y] * over_z, over_z)
        };
        let mut prepared = Self {
            origin: ray.origin,
            direction,
            inverse,
            shear,
            axis,
            t_min: ray.t_min,
            t_max: ray.t_max,
            lateral: LATERAL * space.reach,
            shift: 0.0,
            scale,
        };
        let outside = (space.min - ray.origin).max(ray.origin - space.max).max_element();
        let mut misses = false;
        if outside > space.reach {
            let (near, far) = prepared.slabs(space.min - space.reach, space.max + space.reach);
            misses = near > far || far < 0.0;
            prepared.shift = near;
            let moved = ray.origin + near * direction;
            prepared.origin = moved.clamp(space.min - space.reach, space.max + space.reach);
        }
        prepared.t_min = (ray.t_min * power - prepared.shift).clamp(-f32::MAX, f32::MAX);
        prepared.t_max = (ray.t_max * power - prepared.shift).clamp(-f32::MAX, f32::MAX);
        if misses || space.reach == 0.0 {
            (prepared.t_min, prepared.t_max) = (1.0, 0.0);
        }
        prepared
    }

    /// Where the ray enters and leaves a box, as the structures store it (widened). It misses the box where the first
    /// is greater; both may be negative.
    pub fn slabs(&self, min: Vec3, max: Vec3) -> (f32, f32) {
        let to_min = (min - self.origin) * self.inverse;
        let to_max = (max - self.origin) * self.inverse;
        (to_min.min(to_max).max_element(), to_min.max(to_max).min_element())
    }

    /// A corner in the sheared frame: the ray runs along z, whose values are t.
    pub fn sheared(&self, corner: Vec3) -> Vec3 {
        let d = corner - self.origin;
        let (x, y, z) = match self.axis {
            0 => (d.y, d.z, d.x),
            1 => (d.z, d.x, d.y),
            _ => (d.x, d.y, d.z),
        };
        Vec3::new(x - self.shear.x * z, y - self.shear.y * z, self.shear.z * z)
    }

    /// How far off the ray the weighted corners of a hit may lie in the sheared frame.
    pub fn lateral(&self) -> f32 {
        self.lateral
    }

    /// A t of the search in the unit of the caller's direction, from the caller's origin; the largest number where it
    /// would pass it.
    pub fn caller_t(&self, t: f32) -> f32 {
        ((t + self.shift) * self.scale).clamp(-f32::MAX, f32::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT: Aabb = Aabb::new(Vec3::ZERO, Vec3::ONE);

    #[test]
    fn faults_are_told_apart() {
        let ray = |origin: Vec3, direction: Vec3| Ray::new(origin, direction);
        assert_eq!(ray(Vec3::ZERO, Vec3::X).fault(), None);
        assert_eq!(ray(Vec3::ZERO, Vec3::splat(-1e-37)).fault(), None);
        assert_eq!(ray(Vec3::ZERO, Vec3::ZERO).fault(), Some(RayFault::Direction));
        assert_eq!(ray(Vec3::ZERO, Vec3::splat(1e-40)).fault(), Some(RayFault::Direction));
        assert_eq!(ray(Vec3::NAN, Vec3::X).fault(), Some(RayFault::NonFinite));
        assert_eq!(ray(Vec3::ZERO, Vec3::new(f32::INFINITY, 0.0, 0.0)).fault(), Some(RayFault::NonFinite));
        assert_eq!(ray(Vec3::splat(2e18), Vec3::X).fault(), Some(RayFault::TooFar));
        assert_eq!(Ray { t_max: f32::NAN, ..ray(Vec3::ZERO, Vec3::X) }.fault(), Some(RayFault::NonFinite));
    }

    #[test]
    fn t_counts_in_the_callers_lengths_whatever_they_are() {
        for length in [1e-30, 0.3, 1.0, 7.0, 1e30] {
            let ray = Ray::new(Vec3::new(0.5, 0.5, -2.5), Vec3::new(0.0, 0.0, length));
            let prepared = PreparedRay::new(&ray, &RaySpace::new(&UNIT));
            let (near, _) = prepared.slabs(UNIT.min, UNIT.max);
            let t = prepared.caller_t(near);
            assert!((t * length - 2.5).abs() < 1e-6, "{length}: {t}");
        }
    }

    #[test]
    fn far_origins_are_brought_near_and_t_is_kept() {
        let ray = Ray::new(Vec3::new(-1000.0, 0.5, 0.25), Vec3::new(2.0, 0.0, 0.0));
        let prepared = PreparedRay::new(&ray, &RaySpace::new(&UNIT));
        assert_eq!(prepared.origin, Vec3::new(-1.0, 0.5, 0.25));
        let (near, far) = prepared.slabs(UNIT.min, UNIT.max);
        assert_eq!((prepared.caller_t(near), prepared.caller_t(far)), (500.0, 500.5));
        let away = Ray::new(Vec3::new(-1000.0, 0.5, 0.25), Vec3::new(-2.0, 0.0, 0.0));
        let prepared = PreparedRay::new(&away, &RaySpace::new(&UNIT));
        assert!(prepared.t_min > prepared.t_max);
    }

    #[test]
    fn an_axis_ray_in_the_plane_of_a_face_is_inside_the_widened_box() {
        let ray = Ray::new(Vec3::new(-0.5, 0.0, 1.0), Vec3::X);
        let space = RaySpace::new(&UNIT);
        let (prepared, aabb) = (PreparedRay::new(&ray, &space), space.widened_bounds());
        let (near, far) = prepared.slabs(aabb.min, aabb.max);
        assert!((0.4999..=0.5).contains(&near) && (1.5..=1.5001).contains(&far), "{near} to {far}");
    }
}
