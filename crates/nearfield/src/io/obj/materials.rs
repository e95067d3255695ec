//! Material files (MTL) beside an OBJ file: the numbers of each material, and the material of each triangle.
//!
//! `Kd`, `Ks`, `Ke`, `Ns`, `Ni`, `d`, `Tr` and `illum` are read; maps and everything else are passed over. Keys are
//! taken in any case. Colours are red, green and blue, one number for all three, or `xyz` with CIE coordinates; a colour
//! from a `spectral` curve is not taken, and that becomes a note.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::Vec3;

use super::read::{name_after, read_named};
use crate::error::{FileError, Place};
use crate::io::text::{Lines, number, parsed, shown, words};
use crate::io::with_path;
use crate::{Error, Result, TriMesh};

const NAME: &str = "MTL";

/// A material as a file says it.
#[derive(Debug, Clone, PartialEq)]
pub struct MtlMaterial {
    /// Name behind `newmtl`.
    pub name: String,
    /// `Kd`: diffuse colour; 0.8 where it is not said.
    pub diffuse: Vec3,
    /// `Ks`: specular colour; black where it is not said.
    pub specular: Vec3,
    /// `Ke`: light given; black where it is not said.
    pub emission: Vec3,
    /// `Ns`: exponent of the highlight; `None` where it is not said.
    pub shininess: Option<f32>,
    /// `Ni`: index of refraction; `None` where it is not said.
    pub ior: Option<f32>,
    /// `d`, or 1 − `Tr`: 1 for opaque.
    pub opacity: f32,
    /// `illum`: number of the illumination model; `None` where it is not said.
    pub model: Option<u32>,
    /// Lines that are understood and not taken, in words: colours from a `spectral` curve.
    pub notes: Vec<String>,
}

impl MtlMaterial {
    fn named(name: String) -> Self {
        Self {
            name,
            diffuse: Vec3::splat(0.8),
            specular: Vec3::ZERO,
            emission: Vec3::ZERO,
            shininess: None,
            ior: None,
            opacity: 1.0,
            model: None,
            notes: vec![],
        }
    }

    /// The colour behind `kd`, `ks` or `ke`.
    fn color_mut(&mut self, key: &[u8]) -> &mut Vec3 {
        match key {
            b"kd" => &mut self.diffuse,
            b"ks" => &mut self.specular,
            _ => &mut self.emission,
        }
    }
}

/// Which triangle has which material.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MeshMaterials {
    /// The materials that triangles use, in order of first use.
    pub materials: Vec<MtlMaterial>,
    /// `[triangles]` index into `materials`; `None` for a triangle without one.
    pub material_of: Vec<Option<u32>>,
}

impl MeshMaterials {
    /// What the files say of these materials and is not taken, in words; see [`MtlMaterial::notes`].
    pub fn notes(&self) -> impl Iterator<Item = &str> {
        self.materials.iter().flat_map(|material| &material.notes).map(String::as_str)
    }
}

/// Reads an OBJ file with the materials of its triangles.
///
/// Material files lie beside it. An `mtllib` line names one file, whose name may have blanks, where a file of that name is
/// there; else, as the format says, several files with blanks between them. Of materials of one name the first counts. A
/// file without an `mtllib` line has no materials, whatever names its triangles use.
///
/// # Errors
/// As [`crate::io::read_mesh`]; `Io` that names the material file that cannot be read; `File` with the line where a
/// material file is malformed, or where a triangle uses a material that no file has.
pub fn read_obj_materials(path: &Path) -> Result<(TriMesh, MeshMaterials)> {
    let contents = |path: &Path| std::fs::read(path).map_err(|source| Error::Io { path: path.to_owned(), source });
    let (mesh, named) = read_named(&contents(path)?).map_err(|error| with_path(error, path))?;
    if named.libraries.is_empty() {
        let material_of = vec![None; mesh.triangles.len()];
        return Ok((mesh, MeshMaterials { materials: vec![], material_of }));
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut found = HashMap::new();
    for library in named.libraries.iter().flat_map(|line| library_files(folder, line)) {
        let materials = parse_mtl(&contents(&library)?).map_err(|error| with_path(error, &library))?;
        for mut material in materials {
            for note in &mut material.notes {
                *note = format!("{}{note}", library.display());
            }
            // The first definition of a name counts.
            found.entry(material.name.clone()).or_insert(material);
        }
    }
    let mut materials = vec![];
    for (name, line) in &named.names {
        let Some(material) = found.get(name) else {
            let expected = format!("a material of {}", named.libraries.join(", "));
            let error =
                FileError::new("OBJ", Place::Line(*line), format!("usemtl {}", shown(name.as_bytes())), expected);
            return Err(with_path(error.into(), path));
        };
        materials.push(material.clone());
    }
    let material_of = named.name_of.iter().map(|&i| (i != u32::MAX).then_some(i)).collect();
    Ok((mesh, MeshMaterials { materials, material_of }))
}

/// The files that an `mtllib` line names. Where none of its words is a file, the line is one name, so that the error shows
/// it whole.
fn library_files(folder: &Path, line: &str) -> Vec<PathBuf> {
    let file = |name: &str| folder.join(PathBuf::from(name.replace('\\', "/")));
    let whole = file(line);
    let words: Vec<PathBuf> = line.split_whitespace().map(file).collect();
    if whole.is_file() || !words.iter().any(|word| word.is_file()) { vec![whole] } else { words }
}

/// Reads the materials of an MTL file, in its order.
///
/// A colour as CIE coordinates (`Kd xyz 0.3 0.4 0.5`; y and z are x where they are missing) becomes linear sRGB, whose
/// channels may lie outside 0 … 1. A colour from a curve (`Kd spectral file.rfl`) is not taken: the material keeps the
/// colour it has, and a note says so.
///
/// # Errors
/// `File` with the line: a value before the first `newmtl`, a number that is none, a color without three of them.
pub fn parse_mtl(bytes: &[u8]) -> Result<Vec<MtlMaterial>> {
    let mut materials: Vec<MtlMaterial> = vec![];
    for (line, text) in Lines::new(bytes) {
        let text = text.split(|&b| b == b'#').next().unwrap_or_default();
        let mut rest = words(text);
        let Some(key) = rest.next() else { continue };
        let lower = key.to_ascii_lowercase();
        if lower == b"newmtl" {
            materials.push(MtlMaterial::named(name_after(text, key)));
            continue;
        }
        if !matches!(&lower[..], b"kd" | b"ks" | b"ke" | b"ns" | b"ni" | b"d" | b"tr" | b"illum") {
            continue;
        }
        let Some(material) = materials.last_mut() else {
            return Err(FileError::new(NAME, Place::Line(line), shown(key), "a newmtl line before it").into());
        };
        match &lower[..] {
            b"kd" | b"ks" | b"ke" => match color(line, &mut rest)? {
                Some(color) => *material.color_mut(&lower) = color,
                None => {
                    let Vec3 { x, y, z } = *material.color_mut(&lower);
                    let statement = String::from_utf8_lossy(text.trim_ascii());
                    let why = "spectral curves are not read; write red, green and blue in its place";
                    let name = &material.name;
                    let note = format!(":{line}: {statement} of material {name:?} is left at {x} {y} {z}: {why}");
                    material.notes.push(note);
                }
            },
            b"ns" => material.shininess = Some(value(line, &mut rest)?),
            b"ni" => material.ior = Some(value(line, &mut rest)?),
            b"d" => {
                // `d -halo f` makes opacity depend on the angle; the number is what counts here.
                let mut rest = rest.filter(|word| *word != b"-halo");
                material.opacity = value(line, &mut rest)?;
            }
            b"tr" => material.opacity = 1.0 - value(line, &mut rest)?,
            _ => {
                let word = rest.next().unwrap_or_default();
                let model = parsed(word).ok_or_else(|| {
                    FileError::new(NAME, Place::Line(line), shown(word), "the number of an illumination model, 0 to 10")
                })?;
                material.model = Some(model);
            }
        }
    }
    Ok(materials)
}

fn value<'a>(line: u64, rest: &mut impl Iterator<Item = &'a [u8]>) -> Result<f32> {
    let value = number(NAME, line, rest.next().unwrap_or_default(), "a value")?;
    if !value.is_finite() {
        return Err(FileError::new(NAME, Place::Line(line), value.to_string(), "a finite number").into());
    }
    Ok(value as f32)
}

/// Three numbers, or one for all three, red, green and blue or behind `xyz` CIE coordinates; `None` for a `spectral` curve.
fn color<'a>(line: u64, rest: &mut impl Iterator<Item = &'a [u8]>) -> Result<Option<Vec3>> {
    let mut rest = rest.peekable();
    let word = rest.peek().map(|word| word.to_ascii_lowercase());
    match word.as_deref() {
        Some(b"spectral") => Ok(None),
        Some(b"xyz") => {
            rest.next();
            Ok(Some(srgb_of_xyz(three_or_one(line, &mut rest)?)))
        }
        _ => three_or_one(line, &mut rest).map(Some),
    }
}

/// Linear sRGB of CIE coordinates (IEC 61966-2-1).
fn srgb_of_xyz(xyz: Vec3) -> Vec3 {
    Vec3::new(
        xyz.dot(Vec3::new(3.2406, -1.5372, -0.4986)),
        xyz.dot(Vec3::new(-0.9689, 1.8758, 0.0415)),
        xyz.dot(Vec3::new(0.0557, -0.2040, 1.0570)),
    )
}

fn three_or_one<'a>(line: u64, rest: &mut impl Iterator<Item = &'a [u8]>) -> Result<Vec3> {
    let values: Vec<&[u8]> = rest.take(3).collect();
    let channel = |i: usize| value(line, &mut std::iter::once(values[i]));
    match values.len() {
        1 => channel(0).map(Vec3::splat),
        3 => Ok(Vec3::new(channel(0)?, channel(1)?, channel(2)?)),
        n => {
            let found = format!("a color of {n} numbers");
            Err(FileError::new(NAME, Place::Line(line), found, "red, green and blue, or one number for all").into())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MTL: &str = "# lamp and glass\nnewmtl warm lamp\nKd 0.5 0.25 1\nKe 3 3 3\nillum 1\n\nnewmtl glass\nNi 1.5\nTr 0.75\nNs 250\nks 1 1 1\nmap_Kd x.png\n";

    #[test]
    fn materials_are_read_and_agree_with_another_reader() {
        let ours = parse_mtl(MTL.as_bytes()).unwrap();
        assert_eq!(ours.len(), 2);
        assert_eq!((ours[0].name.as_str(), ours[0].emission, ours[0].model), ("warm lamp", Vec3::splat(3.0), Some(1)));
        assert_eq!((ours[1].opacity, ours[1].diffuse), (0.25, Vec3::splat(0.8)));
        let (theirs, _) = tobj::load_mtl_buf(&mut MTL.as_bytes()).unwrap();
        for (our, their) in ours.iter().zip(&theirs) {
            assert_eq!(our.name, their.name);
            assert_eq!(our.shininess.map(f64::from), their.shininess);
            assert_eq!(our.ior.map(f64::from), their.optical_density);
            if let Some(diffuse) = their.diffuse {
                assert_eq!(our.diffuse.as_dvec3().to_array(), diffuse);
            }
        }
    }

    #[test]
    fn malformed_lines_are_named() {
        assert_eq!(parse_mtl(b"newmtl a\nKe 2\n").unwrap()[0].emission, Vec3::splat(2.0));
        for (text, words) in [
            ("Kd 1 1 1\n", ["MTL", ":1", "newmtl"]),
            ("newmtl a\nKd 1 1\n", ["MTL", ":2", "2 numbers"]),
            ("newmtl a\n\nNs x\n", ["MTL", ":3", "x"]),
            ("newmtl a\nKe nan 0 0\n", ["MTL", ":2", "finite"]),
            ("newmtl a\nillum -1\n", ["MTL", ":2", "-1"]),
            ("newmtl a\nKd xyz 1 1\n", ["MTL", ":2", "2 numbers"]),
            ("newmtl a\nKd xyz red\n", ["MTL", ":2", "red"]),
        ] {
            let message = parse_mtl(text.as_bytes()).unwrap_err().to_string();
            for word in words {
                assert!(message.contains(word), "{word:?} is not in {message:?}");
            }
        }
    }

    #[test]
    fn faces_take_the_material_in_force_and_missing_files_and_names_are_errors() {
        let folder = std::env::temp_dir().join(format!("nearfield-mtl-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let write = |name: &str, text: &str| {
            std::fs::write(folder.join(name), text).unwrap();
            folder.join(name)
        };
        write("two words.mtl", MTL);
        let corners = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
        let good = format!(
            "mtllib two words.mtl\n{corners}f 1 2 3\nusemtl glass\nf 1 2 3 4\nusemtl warm lamp\nf 1 2 4\nusemtl glass\nf 2 3 4\n"
        );
        let (mesh, materials) = read_obj_materials(&write("good.obj", &good)).unwrap();
        assert_eq!(mesh.triangles.len(), 5);
        assert_eq!(materials.material_of, [None, Some(0), Some(0), Some(1), Some(0)]);
        assert_eq!([0, 1].map(|i: usize| materials.materials[i].name.as_str()), ["glass", "warm lamp"]);
        let bare = format!("{corners}usemtl glass\nf 1 2 3\n");
        assert_eq!(read_obj_materials(&write("bare.obj", &bare)).unwrap().1.material_of, [None]);
        let lost = write("lost.obj", &good.replace("two words", "three words"));
        let message = read_obj_materials(&lost).unwrap_err().to_string();
        assert!(message.contains("three words.mtl"), "{message}");
        let other = write("other.obj", &good.replace("usemtl warm lamp", "usemtl cold lamp"));
        let message = read_obj_materials(&other).unwrap_err().to_string();
        assert!(message.contains("other.obj:9") && message.contains("cold lamp"), "{message}");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_library_line_is_one_name_with_blanks_or_several_names() {
        let folder = std::env::temp_dir().join(format!("nearfield-mtllib-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("sub")).unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
        let mesh = |line: &str| {
            write("mesh.obj", &format!("mtllib {line}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl b\nf 1 2 3\n"));
            read_obj_materials(&folder.join("mesh.obj"))
        };
        let red = |line: &str| mesh(line).unwrap().1.materials[0].diffuse.x;
        write("a.mtl", "newmtl a\nKd 0.1\n");
        write("sub/b.mtl", "newmtl b\nKd 0.25\n");
        write("c.mtl", "newmtl b\nKd 0.75\n");
        assert_eq!(red("a.mtl sub\\b.mtl"), 0.25);
        assert_eq!(red("a.mtl\tsub/b.mtl  c.mtl"), 0.25, "the first definition counts");
        assert_eq!(red("c.mtl sub/b.mtl"), 0.75);
        // The whole line is the name of a file.
        write("a.mtl c.mtl", "newmtl b\nKd 0.5\n");
        assert_eq!(red("a.mtl c.mtl"), 0.5);
        let lost = |line: &str| mesh(line).unwrap_err().to_string();
        assert!(lost("a.mtl lost.mtl").contains("lost.mtl") && !lost("a.mtl lost.mtl").contains("a.mtl lost.mtl"));
        assert!(lost("no such.mtl").contains("no such.mtl"));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn cie_colors_become_red_green_and_blue_and_spectral_curves_a_note() {
        let mtl = b"newmtl a\nKd xyz 0.9505 1 1.089\nKe XYZ 0.5\nKs 0.25\nks spectral gold.rfl 2 # shiny\nNs 5\nnewmtl b\nKd spectral red.rfl\n";
        let materials = parse_mtl(mtl).unwrap();
        // The white of sRGB.
        assert!((materials[0].diffuse - Vec3::ONE).abs().max_element() < 1e-3, "{}", materials[0].diffuse);
        let grey = srgb_of_xyz(Vec3::splat(0.5));
        assert_eq!((materials[0].emission, materials[0].specular), (grey, Vec3::splat(0.25)));
        assert_eq!(materials[0].shininess, Some(5.0));
        assert_eq!(materials[1].diffuse, Vec3::splat(0.8));
        let notes = [&materials[0].notes, &materials[1].notes].map(|notes| notes.join("\n"));
        for (note, words) in
            notes.iter().zip([[":5:", "gold.rfl", "\"a\"", "0.25"], [":8:", "red.rfl", "\"b\"", "0.8"]])
        {
            assert!(words.iter().all(|word| note.contains(word)), "{note}");
        }
    }
}
