//! Scenes from files: TOML scene files, and meshes with or without materials. [`read_scene`] documents the keys.

mod from_mtl;
mod layout;
#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::path::Path;

use glam::{DMat3, DVec3, Vec3};

use super::camera::Camera;
use super::light::{Environment, PointLight};
use super::material::{Material, Surface};
use super::scene::{FIELD_OF_VIEW, Scene};
use crate::error::{FileError, Place};
use crate::geometry::TriMesh;
use crate::io::{Format, mesh_from_world, read_mesh, read_obj_materials, with_path};
use crate::{Error, Result};
use layout::{Kind, MaterialEntry, MeshEntry, SceneEntries};

const NAME: &str = "scene";

/// Reads a scene from a TOML scene file, or puts a mesh file into a room.
///
/// `width` and `height` are those of the picture, for cameras that frame what there is. A mesh file of any format stands
/// on the floor of the room of [`Scene::in_room`], y up; an OBJ file keeps its materials, and where it has none or another
/// format is read the mesh is light grey. [`SceneReader`] does the same within a limit of memory, and tells what the files
/// say that is not taken.
///
/// # Keys of a scene file
///
/// Only `[[mesh]]` must be there; a key that is not in this table is an error. Lengths are in the unit of the meshes, angles in
/// degrees, colours red, green and blue in linear light. The axes are right-handed; y points up unless the camera says
/// otherwise.
///
/// | key | value | where it is missing |
/// | --- | --- | --- |
/// | `room` | `true`: the room of [`Scene::in_room`] around all meshes, with its lamp and its camera | `false` |
/// | **`[camera]`** | at most one; with `position` and `target`, with `direction`, or with none of them | the room's; without a room one that frames everything along −z |
/// | `position`, `target` | three numbers each: where it stands and what is in the middle of the picture; both or none | |
/// | `direction` | three numbers, of any length: frames everything, seen along them | `[0.0, 0.0, -1.0]`; in a room the room's camera |
/// | `up` | three numbers: what is up in the picture | `[0.0, 1.0, 0.0]`; +z for a `direction` along y |
/// | `fov` | angle between the upper and the lower edge of the picture, above 0 and below 180 degrees | 39.30765 |
/// | **`[[mesh]]`** | one or more | an error |
/// | `file` | a mesh file of any format, relative to the scene file; OBJ with its MTL | an error |
/// | `material` | the `name` of a `[[material]]`, for every triangle | the materials of the file, else light grey |
/// | `scale` | a number, or three for x, y and z; a negative product mirrors and keeps the outside out | `1.0` |
/// | `rotate` | three angles, after scaling: about x, then y, then z | `[0.0, 0.0, 0.0]` |
/// | `translate` | three lengths, after turning | `[0.0, 0.0, 0.0]` |
/// | **`[[material]]`** | any number | |
/// | `name` | a name of its own | an error |
/// | `kind` | `"lambert"` (matte), `"mirror"`, `"dielectric"` (clear glass) or `"ggx"` (a coat over a base, or a metal) | an error |
/// | `color` | albedo, reflectance or tint, each channel 0 … 1 | 0.7 for lambert and ggx, 0.95 for mirror, 1 for dielectric |
/// | `metallic` | ggx: 0 for a coat, 1 for a metal of that colour | `0.0` |
/// | `roughness` | ggx: 0 for polished … 1 | `0.5` |
/// | `ior` | dielectric: index of refraction, of the inside over the outside, 0.1 … 10 | `1.5` |
/// | `emission` | light that its triangles give, in radiance, 0 … 1e9 | `[0.0, 0.0, 0.0]` |
/// | `two_sided` | `true`: it gives light from both sides, not only the one from which corners run counter-clockwise | `false` |
/// | **`[[light]]`** | point lights, any number; `position` and `intensity` both | none |
/// | `position` | three lengths | an error |
/// | `intensity` | radiant intensity, 0 … 1e9: what arrives at distance d is `intensity` / d² | an error |
/// | **`[environment]`** | light from everywhere, at most one | black; white where a scene has no other light |
/// | `radiance` | 0 … 1e9 | an error |
///
/// ```
/// # let folder = std::env::temp_dir().join(format!("nearfield-doc-scene-{}", std::process::id()));
/// # std::fs::create_dir_all(&folder)?;
/// # std::fs::write(folder.join("bunny.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")?;
/// let text = r#"
/// [camera]
/// position = [0.0, 1.0, 4.0]
/// target = [0.0, 0.5, 0.0]
/// fov = 40.0
///
/// [[mesh]]
/// file = "bunny.obj"
/// material = "gold"
/// scale = 2.0
/// rotate = [0.0, 90.0, 0.0]
///
/// [[material]]
/// name = "gold"
/// kind = "ggx"
/// color = [1.0, 0.8, 0.3]
/// metallic = 1.0
/// roughness = 0.3
///
/// [[light]]
/// position = [0.0, 3.0, 2.0]
/// intensity = [10.0, 10.0, 10.0]
///
/// [environment]
/// radiance = [0.2, 0.2, 0.3]
/// "#;
/// std::fs::write(folder.join("scene.toml"), text)?;
/// let scene = nearfield::application::read_scene(&folder.join("scene.toml"), 640, 480)?;
/// assert_eq!((scene.materials.len(), scene.lights.len(), scene.camera.vertical_fov), (1, 1, 40.0));
/// # std::fs::remove_dir_all(&folder)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// `Io` that names the file; `File` with the line of a scene, OBJ or MTL file; `InvalidSetting` for a material, light or
/// camera out of range, or an unknown extension; as [`Scene::check`].
pub fn read_scene(path: &Path, width: u32, height: u32) -> Result<Scene> {
    SceneReader::default().scene(path, width, height)
}

/// As [`read_scene`] from the text of a scene file whose other files lie in `folder`.
///
/// # Errors
/// As [`read_scene`].
pub fn parse_scene(text: &str, folder: &Path, width: u32, height: u32) -> Result<Scene> {
    SceneReader::default().parse(text, folder, width, height)
}

/// Reads scenes and meshes with their materials: within a limit of memory, and with notes on what is not taken.
#[derive(Debug, Clone, Default)]
pub struct SceneReader {
    max_bytes: Option<u64>,
    /// What the files say that is understood and not taken, in words.
    pub notes: Vec<String>,
    /// Bytes of the files so far.
    bytes: u64,
}

impl SceneReader {
    /// A reader of scene and mesh files that have at most so many bytes together; material files do not count. The
    /// default has no limit.
    pub fn within(max_bytes: u64) -> Self {
        Self { max_bytes: Some(max_bytes), ..Self::default() }
    }

    /// As [`read_scene`].
    ///
    /// # Errors
    /// As [`read_scene`]; `OutOfMemory` where files have more bytes than they may.
    pub fn scene(&mut self, path: &Path, width: u32, height: u32) -> Result<Scene> {
        if !path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml")) {
            let scene = self.mesh(path)?.in_room()?;
            scene.check()?;
            return Ok(scene);
        }
        self.allow(path)?;
        let text = std::fs::read_to_string(path).map_err(|source| Error::Io { path: path.to_owned(), source })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        self.parse(&text, folder, width, height).map_err(|error| with_path(error, path))
    }

    /// A mesh file with its materials, in darkness and without the room: for [`Scene::in_room`] after changes of one's own.
    ///
    /// # Errors
    /// As [`SceneReader::scene`].
    pub fn mesh(&mut self, path: &Path) -> Result<Scene> {
        let Part { mesh, materials, material_of } = self.part(path)?;
        let scene = Scene::of_mesh(mesh, Material::default());
        Ok(Scene { environment: Environment::NONE, materials, material_of, ..scene })
    }

    /// As [`parse_scene`].
    ///
    /// # Errors
    /// As [`SceneReader::scene`].
    pub fn parse(&mut self, text: &str, folder: &Path, width: u32, height: u32) -> Result<Scene> {
        let entries: SceneEntries = toml::from_str(text).map_err(|error| malformed(text, &error))?;
        let mut materials = vec![];
        let mut known = HashMap::new();
        for entry in &entries.material {
            let number = materials.len() as u32;
            if known.insert(entry.name.clone(), number).is_some() {
                return Err(fault(
                    format!("two materials named {:?}", entry.name),
                    "a name of its own for each material",
                ));
            }
            materials.push(material_of(entry)?);
        }
        if entries.mesh.is_empty() {
            return Err(fault("no mesh".to_owned(), "one [[mesh]] or more"));
        }
        let (mut vertices, mut triangles, mut material_of): (Vec<DVec3>, Vec<[u32; 3]>, Vec<u32>) = Default::default();
        for entry in &entries.mesh {
            let part = self.part(&folder.join(&entry.file))?;
            let first = vertices.len() as u32;
            if vertices.len() + part.mesh.vertices.len() > u32::MAX as usize {
                return Err(fault("more than 2^32 - 1 vertices".to_owned(), "fewer or smaller meshes"));
            }
            vertices.extend(placed(&part.mesh, entry));
            // A mirror image keeps its outside where corners are counted the other way round.
            let is_mirrored = entry.scale.factors().to_array().iter().product::<f64>() < 0.0;
            let turned = |[a, b, c]: [u32; 3]| if is_mirrored { [a, c, b] } else { [a, b, c] };
            triangles.extend(part.mesh.triangles.iter().map(|&corners| turned(corners).map(|v| v + first)));
            match &entry.material {
                Some(name) => {
                    let Some(&number) = known.get(name) else {
                        return Err(fault(
                            format!("material = {name:?} of {}", entry.file),
                            "the name of a [[material]] of the scene",
                        ));
                    };
                    material_of.extend(std::iter::repeat_n(number, part.mesh.triangles.len()));
                }
                None => {
                    let first = materials.len() as u32;
                    materials.extend(part.materials);
                    material_of.extend(part.material_of.iter().map(|i| i + first));
                }
            }
        }
        let mesh = mesh_from_world(&vertices, triangles);
        let origin = mesh.origin;
        let lights: Vec<PointLight> = entries
            .light
            .iter()
            .map(|light| PointLight {
                position: (DVec3::from_array(light.position) - origin).as_vec3(),
                intensity: Vec3::from_array(light.intensity),
            })
            .collect();
        let is_lit = entries.room
            || !lights.is_empty()
            || material_of.iter().any(|&i| materials[i as usize].emission != Vec3::ZERO);
        let environment = match &entries.environment {
            Some(environment) => Environment::Constant(Vec3::from_array(environment.radiance)),
            None if is_lit => Environment::NONE,
            None => Environment::Constant(Vec3::ONE),
        };
        let mut scene =
            Scene { material_of, materials, lights, environment, ..Scene::of_mesh(mesh, Material::default()) };
        if entries.room {
            scene = scene.in_room()?;
        }
        scene.camera = camera(&entries, &scene, origin, width, height)?;
        scene.check()?;
        Ok(scene)
    }

    fn part(&mut self, path: &Path) -> Result<Part> {
        self.allow(path)?;
        if Format::from_path(path)? != Format::Obj {
            let mesh = read_mesh(path, None)?;
            let material_of = vec![0; mesh.triangles.len()];
            return Ok(Part { mesh, materials: vec![Material::default()], material_of });
        }
        let (mesh, named) = read_obj_materials(path)?;
        self.notes.extend(named.notes().map(str::to_owned));
        let mut materials: Vec<Material> = named.materials.iter().map(from_mtl::material).collect();
        let without = materials.len() as u32;
        if named.material_of.iter().any(Option::is_none) {
            materials.push(Material::default());
        }
        let material_of = named.material_of.iter().map(|i| i.unwrap_or(without)).collect();
        Ok(Part { mesh, materials, material_of })
    }

    /// Holds a file that is about to be read against the limit.
    fn allow(&mut self, path: &Path) -> Result<()> {
        let size = std::fs::metadata(path).map_err(|source| Error::Io { path: path.to_owned(), source })?.len();
        self.bytes = self.bytes.saturating_add(size);
        match self.max_bytes {
            Some(available) if self.bytes > available => {
                Err(Error::OutOfMemory { what: "the input", needed: self.bytes, available })
            }
            _ => Ok(()),
        }
    }
}

/// The camera of the file; where it says nothing, that of the room, or one that frames everything along −z.
fn camera(entries: &SceneEntries, scene: &Scene, origin: DVec3, width: u32, height: u32) -> Result<Camera> {
    let Some(entry) = &entries.camera else {
        if entries.room {
            return Ok(scene.camera);
        }
        return Ok(Camera::framing(&scene.bounds(), Vec3::NEG_Z, FIELD_OF_VIEW, width, height));
    };
    let fov = entry.fov.unwrap_or(FIELD_OF_VIEW);
    let relative = |place: [f64; 3]| (DVec3::from_array(place) - origin).as_vec3();
    let mut camera = match (entry.position, entry.target, entry.direction) {
        (Some(position), Some(target), None) => {
            Camera { position: relative(position), target: relative(target), up: Vec3::Y, vertical_fov: fov }
        }
        (None, None, Some(direction)) => {
            let direction = DVec3::from_array(direction).as_vec3();
            Camera::framing(&scene.bounds(), direction, fov, width, height)
        }
        (None, None, None) if entries.room => Camera { vertical_fov: fov, ..scene.camera },
        (None, None, None) => Camera::framing(&scene.bounds(), Vec3::NEG_Z, fov, width, height),
        _ => {
            let found = "a camera with only one of position and target, or with a direction beside them";
            return Err(fault(found.to_owned(), "position and target, or direction alone, or none of them"));
        }
    };
    if let Some(up) = entry.up {
        camera.up = DVec3::from_array(up).as_vec3();
    }
    Ok(camera)
}

/// A mesh with a material for every triangle.
struct Part {
    mesh: TriMesh,
    materials: Vec<Material>,
    material_of: Vec<u32>,
}

/// World coordinates of the vertices after scaling, turning and moving.
fn placed<'a>(mesh: &'a TriMesh, entry: &MeshEntry) -> impl Iterator<Item = DVec3> + 'a {
    let [x, y, z] = entry.rotate.map(f64::to_radians);
    let turned = DMat3::from_rotation_z(z) * DMat3::from_rotation_y(y) * DMat3::from_rotation_x(x);
    // Nothing asked for, nothing rounded.
    let turned = if entry.rotate == [0.0; 3] { DMat3::IDENTITY } else { turned };
    let (scale, moved) = (entry.scale.factors(), DVec3::from_array(entry.translate));
    mesh.vertices.iter().map(move |v| turned * ((mesh.origin + v.as_dvec3()) * scale) + moved)
}

fn material_of(entry: &MaterialEntry) -> Result<Material> {
    let color = Vec3::from_array(entry.color.unwrap_or([0.7; 3]));
    let only = |given: bool, key: &str, kind: &str| {
        let found = format!("{key} of material {:?}, which is no {kind}", entry.name);
        if given { Err(fault(found, "keys of the material's kind")) } else { Ok(()) }
    };
    if entry.kind != Kind::Ggx {
        only(entry.metallic.is_some(), "metallic", "ggx")?;
        only(entry.roughness.is_some(), "roughness", "ggx")?;
    }
    if entry.kind != Kind::Dielectric {
        only(entry.ior.is_some(), "ior", "dielectric")?;
    }
    let surface = match entry.kind {
        Kind::Lambert => Surface::Lambert { albedo: color },
        Kind::Mirror => Surface::Mirror { reflectance: entry.color.map_or(Vec3::splat(0.95), Vec3::from_array) },
        Kind::Dielectric => {
            Surface::Dielectric { ior: entry.ior.unwrap_or(1.5), tint: entry.color.map_or(Vec3::ONE, Vec3::from_array) }
        }
        Kind::Ggx => {
            Surface::Ggx { color, metallic: entry.metallic.unwrap_or(0.0), roughness: entry.roughness.unwrap_or(0.5) }
        }
    };
    Ok(Material { surface, emission: Vec3::from_array(entry.emission), two_sided: entry.two_sided })
}

fn fault(found: String, expected: &str) -> Error {
    FileError::new(NAME, Place::Whole, found, expected).into()
}

/// What the TOML reader says, with the line.
fn malformed(text: &str, error: &toml::de::Error) -> Error {
    let place = match error.span() {
        Some(span) => {
            let before = text.as_bytes().get(..span.start).unwrap_or_default();
            Place::Line(1 + before.iter().filter(|&&b| b == b'\n').count() as u64)
        }
        None => Place::Whole,
    };
    FileError::new(NAME, place, error.message().replace('\n', " "), "a scene file in TOML").into()
}
