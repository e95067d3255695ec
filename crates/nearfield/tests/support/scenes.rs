//! Scenes that several tests render.

use nearfield::application::EnvironmentImage;
use nearfield::{Environment, Material, Scene, Surface, Vec3};

/// The Cornell box with every material and a sky that is a picture.
pub(crate) fn everything() -> Scene {
    let mut scene = Scene::cornell_box();
    let first = scene.materials.len() as u32;
    scene.materials.extend([
        Material::new(Surface::Ggx { color: Vec3::new(0.9, 0.6, 0.3), metallic: 1.0, roughness: 0.4 }),
        Material::new(Surface::Dielectric { ior: 1.5, tint: Vec3::new(0.9, 1.0, 0.95) }),
        Material::new(Surface::Mirror { reflectance: Vec3::splat(0.9) }),
        Material::new(Surface::Ggx { color: Vec3::new(0.2, 0.3, 0.8), metallic: 0.0, roughness: 0.3 }),
    ]);
    let n = scene.material_of.len();
    scene.material_of[n - 20..n - 10].fill(first);
    scene.material_of[n - 10..].fill(first + 1);
    scene.material_of[6..8].fill(first + 2);
    scene.material_of[0..2].fill(first + 3);
    let texels = (0..32).map(|i| Vec3::new(0.3, 0.5, 1.0) * if i % 5 == 0 { 3.0 } else { 0.2 }).collect();
    scene.environment = Environment::Image(EnvironmentImage { width: 8, height: 4, texels });
    scene
}
