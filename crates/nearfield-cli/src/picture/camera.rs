//! Where the eye stands and how points land on the picture: a tilted parallel view for flat scans, a three-quarter
//! perspective for the rest.

use glam::{DVec3, Vec3};

use super::Frame;

/// The direction that is up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Up {
    X,
    Y,
    Z,
}

/// A cloud thinner than this part of its width counts as flat.
const FLAT: f64 = 0.3;
/// Points that decide on the view; more would not change it.
const SAMPLE: usize = 100_000;
/// Part of the sample on each side that the view reaches for only so far: stray returns must not shrink the rest.
const STRAY: f64 = 0.01;
/// How far that is, as a part of the range of the others.
const REACH: f64 = 0.2;

/// Projects points onto the picture.
#[derive(Debug, Clone)]
pub(crate) struct Camera {
    center: DVec3,
    right: DVec3,
    up: DVec3,
    toward_eye: DVec3,
    /// Distance of the eye from the center, infinite for a parallel view.
    distance: f64,
    scale: f64,
    shift: [f64; 2],
    /// Far enough in front of the center for rays of a parallel view to start before everything.
    reach: f64,
}

/// A point on the picture.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Projected {
    /// Pixels from the left.
    pub(crate) x: f32,
    /// Pixels from the top.
    pub(crate) y: f32,
    /// Pixels away from the eye, 0 at the center.
    pub(crate) depth: f32,
    /// How much larger than at the center things look.
    pub(crate) zoom: f32,
}

impl Camera {
    /// The view of `points` that fills `frame`.
    pub(super) fn fitted(points: &[Vec3], up: Up, frame: Frame) -> Self {
        let step = points.len().div_ceil(SAMPLE).max(1);
        let sample: Vec<DVec3> = points.iter().step_by(step).map(|p| p.as_dvec3()).collect();
        let axis = |a: usize| inner_range(sample.iter().map(|p| p[a]).collect());
        let ranges = [axis(0), axis(1), axis(2)];
        let extent = DVec3::from_array(ranges.map(|[low, high]| high - low));
        let center = DVec3::from_array(ranges.map(|[low, high]| 0.5 * low + 0.5 * high));

        // Axes of the floor: what is seen from the front runs along `side`.
        let (up_axis, side, front) = match up {
            Up::X => (DVec3::X, DVec3::Y, DVec3::Z),
            Up::Y => (DVec3::Y, DVec3::X, DVec3::Z),
            Up::Z => (DVec3::Z, DVec3::X, DVec3::NEG_Y),
        };
        let (height, width, depth) = (extent.dot(up_axis).abs(), extent.dot(side).abs(), extent.dot(front).abs());
        let flat = height < FLAT * width.max(depth);
        let (side, front) = if flat && depth > 1.2 * width { (front, -side) } else { (side, front) };
        let (turn, tilt) = if flat { (24f64, 38f64) } else { (32.0, 22.0) };
        let (turn, tilt) = (turn.to_radians(), tilt.to_radians());
        let level = front * turn.cos() + side * turn.sin();
        let toward_eye = level * tilt.cos() + up_axis * tilt.sin();
        let right = up_axis.cross(toward_eye).normalize();
        let distance = if flat { f64::INFINITY } else { 1.7 * extent.length().max(f64::MIN_POSITIVE) };

        let farthest = sample.iter().map(|p| p.distance_squared(center)).fold(0.0, f64::max).sqrt();
        let mut camera = Self {
            center,
            right,
            up: toward_eye.cross(right),
            toward_eye,
            distance,
            scale: 1.0,
            shift: [0.0, 0.0],
            reach: 2.0 * farthest.max(extent.length()),
        };
        camera.fit(&sample, frame);
        camera
    }

    /// The view of the plane z = 0 from its front, y up, filled by `points`.
    pub(super) fn front(points: &[Vec3], frame: Frame) -> Self {
        let mut camera = Self::fitted(points, Up::Y, frame);
        (camera.right, camera.up, camera.toward_eye) = (DVec3::X, DVec3::Y, DVec3::Z);
        camera.distance = f64::INFINITY;
        let sample: Vec<DVec3> = points.iter().map(|p| p.as_dvec3()).collect();
        camera.fit(&sample, frame);
        camera
    }

    /// A length in pixels, at the center.
    pub(super) fn pixels(&self, length: f64) -> f32 {
        (self.scale * length) as f32
    }

    /// The view of a picture of so many pixels that nothing else is drawn on, filled by `points` with all strays.
    pub(crate) fn filled(points: &[Vec3], up: Up, width: u32, height: u32) -> Self {
        let frame = Frame { left: 0.0, top: 0.0, width: width as f32, height: height as f32 };
        let mut camera = Self::fitted(points, up, frame);
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for &point in points {
            if let Some((x, y, ..)) = camera.on_plane(point.as_dvec3()) {
                (low, high) = ([low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)]);
            }
            camera.reach = camera.reach.max(2.0 * point.as_dvec3().distance(camera.center));
        }
        if low[0] <= high[0] {
            camera.fill([low[0], high[0]], [low[1], high[1]], frame);
        }
        camera
    }

    /// Where a ray through a place of the picture starts, and its unit direction.
    pub(crate) fn ray(&self, x: f64, y: f64) -> (DVec3, DVec3) {
        let [across, above] = [(x - self.shift[0]) / self.scale, (self.shift[1] - y) / self.scale];
        let on_plane = self.center + self.right * across + self.up * above;
        if self.distance.is_finite() {
            let eye = self.center + self.toward_eye * self.distance;
            return (eye, (on_plane - eye).normalize());
        }
        (on_plane + self.toward_eye * self.reach, -self.toward_eye)
    }

    fn fit(&mut self, sample: &[DVec3], frame: Frame) {
        let seen: Vec<[f64; 3]> =
            sample.iter().filter_map(|&p| self.on_plane(p)).map(|(x, y, _, z)| [x, y, z]).collect();
        let range = |a: usize| inner_range(seen.iter().map(|s| s[a]).collect());
        self.fill(range(0), range(1), frame);
    }

    /// Makes a rectangle of the plane fill the frame.
    fn fill(&mut self, [left, right]: [f64; 2], [bottom, top]: [f64; 2], frame: Frame) {
        let per_unit = |pixels: f32, units: f64| if units > 0.0 { f64::from(pixels) / units } else { f64::INFINITY };
        let scale = per_unit(frame.width, right - left).min(per_unit(frame.height, top - bottom));
        self.scale = if scale.is_finite() { 0.96 * scale } else { 1.0 };
        self.shift = [
            f64::from(frame.left + 0.5 * frame.width) - self.scale * (0.5 * left + 0.5 * right),
            f64::from(frame.top + 0.5 * frame.height) + self.scale * (0.5 * bottom + 0.5 * top),
        ];
    }

    /// Right, up, distance behind the center and magnification, in the unit of the points.
    fn on_plane(&self, point: DVec3) -> Option<(f64, f64, f64, f64)> {
        let p = point - self.center;
        let near = p.dot(self.toward_eye);
        let zoom = if self.distance.is_finite() { self.distance / (self.distance - near) } else { 1.0 };
        // Behind the eye, or so near that it would fill the picture.
        (zoom > 0.0 && zoom < 20.0).then(|| (p.dot(self.right) * zoom, p.dot(self.up) * zoom, -near, zoom))
    }

    /// Where a point lands; `None` behind the eye.
    pub(crate) fn project(&self, point: Vec3) -> Option<Projected> {
        let (x, y, depth, zoom) = self.on_plane(point.as_dvec3())?;
        Some(Projected {
            x: (self.shift[0] + self.scale * x) as f32,
            y: (self.shift[1] - self.scale * y) as f32,
            depth: (self.scale * depth) as f32,
            zoom: zoom as f32,
        })
    }

    /// Unit vectors to the right and up on the picture, and from the center to the eye.
    pub(crate) fn axes(&self) -> [Vec3; 3] {
        [self.right, self.up, self.toward_eye].map(|axis| axis.as_vec3())
    }

    /// Unit vector from the center to the eye.
    #[cfg(test)]
    pub(crate) fn toward_eye(&self) -> Vec3 {
        self.toward_eye.as_vec3()
    }
}

/// The range of the values, strays at both ends only as far as [`REACH`] allows; 0 for none.
fn inner_range(mut values: Vec<f64>) -> [f64; 2] {
    if values.is_empty() {
        return [0.0, 0.0];
    }
    values.sort_unstable_by(f64::total_cmp);
    let (stray, last) = ((values.len() as f64 * STRAY) as usize, values.len() - 1);
    let (low, high) = (values[stray], values[last - stray]);
    let reach = REACH * (high - low);
    [values[0].max(low - reach), values[last].min(high + reach)]
}

/// The direction that is most likely up: z for clouds that lie flat, y for formats of modelling programs, else z.
pub(crate) fn likely_up(extent: Vec3, modelling: bool) -> Up {
    let lies_flat = f64::from(extent.z) < FLAT * f64::from(extent.x.max(extent.y));
    if modelling && !lies_flat { Up::Y } else { Up::Z }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Frame = Frame { left: 10.0, top: 20.0, width: 400.0, height: 300.0 };

    fn corners(size: Vec3) -> Vec<Vec3> {
        (0..8).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) * size).collect()
    }

    #[test]
    fn every_corner_of_a_box_lands_in_the_frame() {
        for (size, up) in [(Vec3::ONE, Up::Z), (Vec3::new(9.0, 5.0, 0.5), Up::Z), (Vec3::new(1.0, 3.0, 1.0), Up::Y)] {
            let points = corners(size);
            let camera = Camera::fitted(&points, up, FRAME);
            for &p in &points {
                let seen = camera.project(p).unwrap();
                assert!(seen.x >= 10.0 && seen.x <= 410.0 && seen.y >= 20.0 && seen.y <= 320.0, "{size}: {seen:?}");
            }
        }
    }

    #[test]
    fn up_is_up_and_a_nearer_point_has_less_depth() {
        let camera = Camera::fitted(&corners(Vec3::ONE), Up::Y, FRAME);
        let (low, high) = (camera.project(Vec3::ZERO).unwrap(), camera.project(Vec3::Y).unwrap());
        assert!(high.y < low.y);
        let nearer = camera.project(Vec3::splat(0.5) + camera.toward_eye()).unwrap();
        assert!(nearer.depth < camera.project(Vec3::splat(0.5)).unwrap().depth);
    }

    #[test]
    fn a_ray_through_where_a_point_lands_passes_the_point() {
        // A tilted parallel view, and a perspective one.
        for size in [Vec3::new(9.0, 5.0, 0.5), Vec3::new(1.0, 3.0, 1.0)] {
            let points = corners(size);
            let camera = Camera::filled(&points, Up::Z, 640, 480);
            for &p in &points {
                let seen = camera.project(p).unwrap();
                assert!(seen.x >= 0.0 && seen.x <= 640.0 && seen.y >= 0.0 && seen.y <= 480.0, "{seen:?}");
                let (origin, direction) = camera.ray(f64::from(seen.x), f64::from(seen.y));
                let to = p.as_dvec3() - origin;
                assert!(to.dot(direction) > 0.0, "{size}: the ray starts behind {p}");
                assert!((to - direction * to.dot(direction)).length() < 1e-5, "{size}: {p}");
            }
        }
    }

    #[test]
    fn scans_stand_on_z_and_models_on_y() {
        assert_eq!(likely_up(Vec3::new(9.0, 8.0, 1.0), true), Up::Z);
        assert_eq!(likely_up(Vec3::ONE, true), Up::Y);
        assert_eq!(likely_up(Vec3::ONE, false), Up::Z);
    }

    #[test]
    fn one_stray_point_does_not_shrink_the_view() {
        let mut points: Vec<Vec3> = corners(Vec3::ONE).repeat(1000);
        points.push(Vec3::splat(1e6));
        let camera = Camera::fitted(&points, Up::Z, FRAME);
        let (a, b) = (camera.project(Vec3::ZERO).unwrap(), camera.project(Vec3::Z).unwrap());
        assert!((a.y - b.y).abs() > 50.0);
    }
}
