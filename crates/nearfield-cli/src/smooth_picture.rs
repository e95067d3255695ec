//! The picture of a smoothing: before and after, side by side, shaded by the normals of the points as they lie.

use nearfield::application::{PlaneSearch, Support};
use nearfield::{Aabb, AabbTreeN, AabbTreeNSettings, MlsMethod, MlsProjection, MlsSettings, Vec3};

use crate::options::PictureSize;
use crate::picture::{self, Image, Scene, Up};
use crate::report::grouped;

/// Nearest points whose plane gives the normal that a point is shaded by: few, so that noise shows.
const NEAREST: u32 = 12;
/// What stands in full light, and the share of light in the shade.
const COLOR: [f32; 3] = [226.0, 214.0, 196.0];
const SHADE: f32 = 0.12;
/// Light from the upper left, in directions of the picture: right, up, towards the eye.
const LIGHT: [f32; 3] = [-0.45, 0.5, 0.74];

/// What was smoothed.
pub(crate) struct Smoothed<'a> {
    /// Name of the file.
    pub(crate) name: String,
    pub(crate) before: &'a [Vec3],
    pub(crate) after: &'a [Vec3],
    /// How.
    pub(crate) words: String,
    pub(crate) up: Option<Up>,
}

/// Draws both clouds by one camera.
pub(crate) fn draw(smoothed: &Smoothed<'_>, size: PictureSize) -> nearfield::Result<Image> {
    let half = PictureSize { width: size.width / 2, ..size };
    let extent = Aabb::of_points(smoothed.before).extent();
    let up = smoothed.up.unwrap_or_else(|| picture::likely_up(extent, false));
    let side = |points: &[Vec3], title: String, subtitle: String| -> nearfield::Result<Image> {
        let colors = shades(points, smoothed.before, up)?;
        let scene = Scene {
            points,
            colors: &colors,
            sizes: &[],
            focus: smoothed.before,
            up,
            title,
            subtitle,
            bar: None,
            swatches: vec![],
        };
        Ok(picture::draw(&scene, half))
    };
    let n = grouped(smoothed.before.len() as u64);
    let before = side(smoothed.before, format!("{}: before", smoothed.name), format!("{n} points"))?;
    let after = side(smoothed.after, "after".to_owned(), smoothed.words.clone())?;
    Ok(Image::beside(&before, &after))
}

/// Light on the planes of the nearest, by the camera that looks at `focus`.
fn shades(points: &[Vec3], focus: &[Vec3], up: Up) -> nearfield::Result<Vec<[u8; 3]>> {
    let positions: Vec<[f32; 3]> = points.iter().map(Vec3::to_array).collect();
    let tree = AabbTreeN::build(&positions, &AabbTreeNSettings::default())?;
    let plane = MlsMethod::Pss { degree: 0, plane: PlaneSearch::Fast };
    let settings = MlsSettings {
        most_steps: 1,
        accuracy: nearfield::application::Length::Absolute(f64::from(f32::MIN_POSITIVE)),
        ..MlsSettings::new(plane)
    };
    let mut planes = MlsProjection::new(&tree, None, &positions, &Support::Nearest(NEAREST), &settings)?;
    planes.iterate()?;
    let [right, above, toward_eye] = picture::axes(focus, up);
    let light = (LIGHT[0] * right + LIGHT[1] * above + LIGHT[2] * toward_eye).normalize();
    let shade = |normal: &[f32; 3]| {
        let normal = Vec3::from_array(*normal);
        let facing = if normal.dot(toward_eye) < 0.0 { -normal } else { normal };
        let bright = SHADE + (1.0 - SHADE) * facing.dot(light).max(0.0);
        COLOR.map(|c| (c * bright).round() as u8)
    };
    Ok(planes.normals().iter().map(shade).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_halves_are_drawn() {
        let grid: Vec<Vec3> = (0..900u16).map(|i| Vec3::new(f32::from(i % 30), f32::from(i / 30), 0.0)).collect();
        let rough: Vec<Vec3> = grid.iter().enumerate().map(|(i, p)| *p + (i % 7) as f32 * 0.3 * Vec3::Z).collect();
        let shown = Smoothed {
            name: "grid".to_owned(),
            before: &rough,
            after: &grid,
            words: "flat".to_owned(),
            up: Some(Up::Z),
        };
        let size = PictureSize { width: 400, height: 220 };
        let image = draw(&shown, size).unwrap();
        let mut png = Vec::new();
        image.write_png(&mut png).unwrap();
        assert_eq!(png[16..24], [0, 0, 1, 144, 0, 0, 0, 220]);
        // A plane is shaded evenly, noise is not.
        let colors = |points: &[Vec3]| -> std::collections::BTreeSet<[u8; 3]> {
            shades(points, &rough, Up::Z).unwrap().into_iter().collect()
        };
        let (even, uneven) = (colors(&grid), colors(&rough));
        let brightest = even.iter().map(|c| c[0]).max().unwrap();
        assert!(even.iter().all(|c| brightest - c[0] <= 1), "{even:?}");
        assert!(uneven.len() > 5, "{uneven:?}");
        assert!(draw(&Smoothed { before: &[], after: &[], ..shown }, size).is_ok());
    }
}
