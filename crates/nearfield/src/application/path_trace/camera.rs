//! The pinhole camera. Its twin stands in `parameters.wesl`.

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

use crate::geometry::Aabb;
use crate::{Error, Result};

/// A pinhole camera that looks at a point. Positions are relative to the origin of the mesh, as those of rays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Where it stands.
    pub position: Vec3,
    /// The point in the middle of the picture.
    pub target: Vec3,
    /// A direction that points upwards in the picture; any but that of the view.
    pub up: Vec3,
    /// Angle between the upper and the lower edge of the picture, in degrees; 0 … 180, both excluded.
    pub vertical_fov: f32,
}

impl Camera {
    /// A camera that looks along `direction`, up along +y (or +z where the view is along y), and has all of `bounds` in
    /// a picture of `width` by `height` pixels.
    ///
    /// The ball around the box fits into the picture: some room stays around flat things.
    pub fn framing(bounds: &Aabb, direction: Vec3, vertical_fov: f32, width: u32, height: u32) -> Self {
        let view = direction.as_dvec3().normalize_or(-DVec3::Z);
        let half = 0.5 * f64::from(vertical_fov.clamp(1.0, 179.0)).to_radians();
        let aspect = f64::from(width.max(1)) / f64::from(height.max(1));
        let narrow = half.min((half.tan() * aspect).atan());
        let radius = 0.5 * f64::from(bounds.diagonal());
        let target = bounds.center();
        let position = target.as_dvec3() - view * (radius / narrow.sin());
        let up = if view.y.abs() > 0.99 { Vec3::Z } else { Vec3::Y };
        Self { position: position.as_vec3(), target, up, vertical_fov }
    }

    /// Checks that there is a view.
    ///
    /// # Errors
    /// `InvalidSetting`.
    pub fn check(&self) -> Result<()> {
        let fault = |setting: &'static str, found: String, expected: &'static str| {
            Err(Error::InvalidSetting { setting, found, expected })
        };
        const FINITE: &str = "finite coordinates within ±1e18";
        let usable = |v: Vec3| v.abs().cmple(Vec3::splat(crate::geometry::validate::MAX_COORDINATE)).all();
        if !usable(self.position) {
            return fault("camera position", self.position.to_string(), FINITE);
        }
        if !usable(self.target) {
            return fault("camera target", self.target.to_string(), FINITE);
        }
        if !usable(self.up) {
            return fault("camera up", self.up.to_string(), FINITE);
        }
        if !(self.vertical_fov > 0.0 && self.vertical_fov < 180.0) {
            let expected = "degrees between 0 and 180, both excluded";
            return fault("camera field of view", self.vertical_fov.to_string(), expected);
        }
        let view = self.target.as_dvec3() - self.position.as_dvec3();
        if view == DVec3::ZERO {
            return fault("camera target", self.target.to_string(), "a point other than the camera's position");
        }
        if view.normalize().cross(self.up.as_dvec3().normalize_or_zero()).length() < 1e-6 {
            return fault("camera up", self.up.to_string(), "a direction other than that of the view");
        }
        Ok(())
    }
}

/// The camera as the stages read it: where it stands, and the steps to the edges of the picture. 64 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct CameraFrame {
    /// Where it stands.
    pub position: Vec3,
    /// Unused.
    pub padding_0: u32,
    /// Unit direction of the view.
    pub forward: Vec3,
    /// Unused.
    pub padding_1: u32,
    /// From the middle to the right edge.
    pub right: Vec3,
    /// Unused.
    pub padding_2: u32,
    /// From the middle to the upper edge.
    pub up: Vec3,
    /// Unused.
    pub padding_3: u32,
}

impl CameraFrame {
    pub(super) fn new(camera: &Camera, width: u32, height: u32) -> Self {
        let forward = (camera.target.as_dvec3() - camera.position.as_dvec3()).normalize();
        let right = forward.cross(camera.up.as_dvec3()).normalize();
        let up = right.cross(forward);
        let reach = (0.5 * f64::from(camera.vertical_fov).to_radians()).tan();
        let aspect = f64::from(width) / f64::from(height);
        Self {
            position: camera.position,
            forward: forward.as_vec3(),
            right: (right * (reach * aspect)).as_vec3(),
            up: (up * reach).as_vec3(),
            ..Self::zeroed()
        }
    }

    /// The unit direction through a place of the picture: x to the right and y downwards, both from 0 to 1.
    pub(super) fn direction(&self, x: f32, y: f32) -> Vec3 {
        (self.forward + self.right * (2.0 * x - 1.0) + self.up * (1.0 - 2.0 * y)).normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_looks_at_the_target_and_edges_lie_at_half_the_angle() {
        let camera = Camera { position: Vec3::new(0.0, 0.0, 5.0), target: Vec3::ZERO, up: Vec3::Y, vertical_fov: 90.0 };
        let frame = CameraFrame::new(&camera, 200, 100);
        assert!((frame.direction(0.5, 0.5) - Vec3::NEG_Z).length() < 1e-6);
        let top = frame.direction(0.5, 0.0);
        assert!((top - Vec3::new(0.0, 1.0, -1.0).normalize()).length() < 1e-6, "{top}");
        let right = frame.direction(1.0, 0.5);
        assert!((right - Vec3::new(2.0, 0.0, -1.0).normalize()).length() < 1e-6, "{right}");
    }

    #[test]
    fn framing_keeps_every_corner_inside() {
        let bounds = Aabb::new(Vec3::new(-1.0, 2.0, 0.0), Vec3::new(3.0, 3.0, 7.0));
        for (width, height) in [(100, 100), (300, 100), (100, 300)] {
            for view in [Vec3::NEG_Z, Vec3::new(1.0, -1.0, -0.5), Vec3::NEG_Y] {
                let camera = Camera::framing(&bounds, view, 40.0, width, height);
                camera.check().unwrap();
                let frame = CameraFrame::new(&camera, width, height);
                for corner in 0..8 {
                    let pick = |axis: usize| if corner >> axis & 1 == 0 { bounds.min } else { bounds.max }[axis];
                    let to = Vec3::new(pick(0), pick(1), pick(2)) - frame.position;
                    let depth = to.dot(frame.forward);
                    let across = to.dot(frame.right) / frame.right.length_squared() / depth;
                    let upwards = to.dot(frame.up) / frame.up.length_squared() / depth;
                    assert!(depth > 0.0 && across.abs() <= 1.0 && upwards.abs() <= 1.0, "{view} {across} {upwards}");
                }
            }
        }
    }

    #[test]
    fn cameras_without_a_view_are_refused() {
        let good = Camera { position: Vec3::ZERO, target: Vec3::NEG_Z, up: Vec3::Y, vertical_fov: 40.0 };
        assert!(good.check().is_ok());
        for (bad, what) in [
            (Camera { target: Vec3::ZERO, ..good }, "target"),
            (Camera { up: Vec3::Z, ..good }, "up"),
            (Camera { up: Vec3::ZERO, ..good }, "up"),
            (Camera { vertical_fov: 180.0, ..good }, "field of view"),
            (Camera { vertical_fov: f32::NAN, ..good }, "field of view"),
            (Camera { position: Vec3::NAN, ..good }, "position"),
        ] {
            let message = bad.check().unwrap_err().to_string();
            assert!(message.contains(what), "{message}");
        }
    }
}
