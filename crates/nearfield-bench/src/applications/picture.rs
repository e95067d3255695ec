//! Pictures of scans and surfaces as PNG: shaded by one light, side by side at one scale, seen from the same side.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use nearfield::application::{Length, PlaneSearch, Support};
use nearfield::{
    Aabb, AabbTreeN, AabbTreeNSettings, BvhSettings, MlsMethod, MlsProjection, MlsSettings, Ray, RaySearch, TriMesh,
    TriangleBvh, Vec3,
};

use crate::{Error, Result};

/// Pixels of a panel along each side.
const PANEL: usize = 560;
/// Part of a panel that the largest of the shown fills.
const FILLED: f32 = 0.92;
/// Nearest points whose plane gives the normal that a point is shaded by: few, so that noise shows.
const NEAREST: u32 = 12;
const COLOR: Vec3 = Vec3::new(226.0, 214.0, 196.0);
/// The colour of the other side of a surface.
const BACK: Vec3 = Vec3::new(150.0, 170.0, 214.0);
const SHADE: f32 = 0.14;

/// Where the eye is, and what is in the picture.
struct Eye {
    right: Vec3,
    up: Vec3,
    forward: Vec3,
    center: Vec3,
    /// Pixels of a length.
    scale: f32,
}

impl Eye {
    /// From the front, a little from the right and above, at what is in the box.
    fn at(bounds: &Aabb) -> Self {
        let forward = Vec3::new(-0.45, -0.3, -1.0).normalize();
        let right = forward.cross(Vec3::Y).normalize();
        let up = right.cross(forward);
        let half = 0.5 * bounds.extent();
        let reach = |axis: Vec3| half.dot(axis.abs());
        let scale = 0.5 * FILLED * PANEL as f32 / reach(right).max(reach(up)).max(f32::MIN_POSITIVE);
        Self { right, up, forward, center: bounds.center(), scale }
    }

    /// The brightness of a surface by the part of its normal that faces the eye, and whether it is its back.
    fn shade(&self, normal: Vec3) -> (f32, bool) {
        let is_back = normal.dot(self.forward) > 0.0;
        let facing = if is_back { -normal } else { normal };
        let light = (-0.45 * self.right + 0.5 * self.up - 0.74 * self.forward).normalize();
        (SHADE + (1.0 - SHADE) * facing.dot(light).max(0.0), is_back)
    }
}

/// A panel of pixels, white at first.
struct Panel(Vec<[u8; 3]>);

impl Panel {
    fn new() -> Self {
        Self(vec![[255; 3]; PANEL * PANEL])
    }

    fn put(&mut self, place: usize, color: Vec3) {
        self.0[place] = color.to_array().map(|c| c.round().clamp(0.0, 255.0) as u8);
    }
}

/// Draws points before and after, seen alike.
///
/// # Errors
/// As the tree; a file that cannot be written.
pub fn before_and_after(path: &Path, before: &[Vec3], after: &[Vec3]) -> Result<()> {
    let eye = Eye::at(&Aabb::of_points(before));
    write(path, &[points(&eye, before)?, points(&eye, after)?])
}

/// Draws meshes beside each other at one scale.
///
/// # Errors
/// As the hierarchy of triangles; a file that cannot be written.
pub fn meshes(path: &Path, shown: &[&TriMesh]) -> Result<()> {
    let bounds = shown.iter().fold(Aabb::EMPTY, |bounds, mesh| bounds.union(mesh.bounds()));
    if shown.is_empty() || bounds.is_empty() {
        return Ok(());
    }
    let eye = Eye::at(&bounds);
    let panels = shown.iter().map(|mesh| surface(&eye, mesh)).collect::<Result<Vec<Panel>>>()?;
    write(path, &panels)
}

fn surface(eye: &Eye, mesh: &TriMesh) -> Result<Panel> {
    let bvh = TriangleBvh::build(mesh, &BvhSettings::default())?;
    let far = mesh.bounds().diagonal() + mesh.bounds().center().distance(eye.center);
    let ray = |place: usize| {
        let [x, y] = [place % PANEL, place / PANEL].map(|i| (i as f32 + 0.5 - 0.5 * PANEL as f32) / eye.scale);
        Ray::new(eye.center + x * eye.right - y * eye.up - far * eye.forward, eye.forward)
    };
    let rays: Vec<Ray> = (0..PANEL * PANEL).map(ray).collect();
    let hits = bvh.closest_hits(&rays)?;
    let mut panel = Panel::new();
    for place in 0..rays.len() {
        if let Some(hit) = hits.hit(place) {
            let (bright, is_back) = eye.shade(hit.normal);
            panel.put(place, bright * if is_back { BACK } else { COLOR });
        }
    }
    Ok(panel)
}

fn points(eye: &Eye, points: &[Vec3]) -> Result<Panel> {
    let arrays: Vec<[f32; 3]> = points.iter().map(Vec3::to_array).collect();
    let tree = AabbTreeN::build(&arrays, &AabbTreeNSettings::default())?;
    let plane = MlsMethod::Pss { degree: 0, plane: PlaneSearch::Fast };
    let accuracy = Length::Absolute(f64::from(f32::MIN_POSITIVE));
    let settings = MlsSettings { most_steps: 1, accuracy, ..MlsSettings::new(plane) };
    let mut planes = MlsProjection::new(&tree, None, &arrays, &Support::Nearest(NEAREST), &settings)?;
    planes.iterate()?;
    // A point covers what one stands for, if the points were spread over the front of a ball.
    let covered = (0.5 * (PANEL * PANEL) as f32 / points.len().max(1) as f32).sqrt();
    let half = (0.75 * covered).round().clamp(1.0, 12.0) as isize;
    let (mut panel, mut depths) = (Panel::new(), vec![f32::INFINITY; PANEL * PANEL]);
    for (point, normal) in points.iter().zip(planes.normals()) {
        let offset = *point - eye.center;
        let depth = offset.dot(eye.forward);
        let middle = 0.5 * PANEL as f32;
        let x = (middle + eye.scale * offset.dot(eye.right)).floor() as isize;
        let y = (middle - eye.scale * offset.dot(eye.up)).floor() as isize;
        // The sign of the normal means nothing here.
        let (bright, _) = eye.shade(Vec3::from_array(*normal));
        for (i, j) in (-half..=half).flat_map(|j| (-half..=half).map(move |i| (i, j))) {
            let (x, y) = (x + i, y + j);
            if i * i + j * j > half * half || x < 0 || y < 0 || x >= PANEL as isize || y >= PANEL as isize {
                continue;
            }
            let place = y as usize * PANEL + x as usize;
            if depth < depths[place] {
                depths[place] = depth;
                panel.put(place, bright * COLOR);
            }
        }
    }
    Ok(panel)
}

fn write(path: &Path, panels: &[Panel]) -> Result<()> {
    let failed = |error: &dyn std::fmt::Display| Error::from(format!("{}: {error}", path.display()));
    let file = BufWriter::new(File::create(path).map_err(|error| failed(&error))?);
    let mut encoder = png::Encoder::new(file, (PANEL * panels.len()) as u32, PANEL as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(|error| failed(&error))?;
    let rows = (0..PANEL).flat_map(|y| panels.iter().flat_map(move |panel| &panel.0[y * PANEL..(y + 1) * PANEL]));
    let pixels: Vec<u8> = rows.flatten().copied().collect();
    writer.write_image_data(&pixels).map_err(|error| failed(&error))?;
    writer.finish().map_err(|error| failed(&error))
}

#[cfg(test)]
mod tests {
    use nearfield::geometry::generate::{CloudKind, MeshKind, cloud, mesh};

    use super::*;

    #[test]
    fn bodies_stand_in_the_middle_of_their_panels() {
        let ball = mesh(MeshKind::Icosphere, 1280, 0);
        let eye = Eye::at(&ball.bounds());
        let shell = cloud(CloudKind::Shell, 4000, 1).points;
        for panel in
            [surface(&eye, &ball).expect("a mesh"), points(&Eye::at(&Aabb::of_points(&shell)), &shell).expect("points")]
        {
            let at = |x: usize, y: usize| panel.0[y * PANEL + x];
            assert_ne!(at(PANEL / 2, PANEL / 2), [255; 3]);
            assert_eq!(at(2, 2), [255; 3]);
            // Light comes from the upper left.
            let bright = |x: usize, y: usize| at(x, y).iter().map(|&c| u32::from(c)).sum::<u32>();
            assert!(bright(PANEL / 3, PANEL / 3) > bright(2 * PANEL / 3, 2 * PANEL / 3));
        }
    }
}
