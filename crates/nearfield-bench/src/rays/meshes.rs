//! The meshes that rays are cast into: Accel's bunnies and the Stanford bunny from files, or icospheres of like sizes.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use nearfield::TriMesh;
use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::io::{Format, Polygons};

use crate::Result;

/// A mesh with the name that the rows give it.
#[derive(Debug, Clone)]
pub struct Named {
    /// File, or what was made in its place.
    pub name: String,
    /// The triangles.
    pub mesh: TriMesh,
}

impl Named {
    /// Number of triangles.
    pub fn triangles(&self) -> usize {
        self.mesh.triangles.len()
    }
}

/// Where meshes come from.
#[derive(Debug, Clone)]
pub struct Source {
    folder: PathBuf,
    scale: f64,
}

/// Accel's meshes by rising number of triangles: file and triangles.
pub const ACCEL: [(&str, usize); 3] =
    [("accel-bunny-c.obj", 2465), ("accel-bunny-a.obj", 4968), ("accel-bunny-b.obj", 59_616)];
/// How often the largest of them is bisected: once for 119,232 triangles, four times for 953,856.
pub const BISECTIONS: [u32; 2] = [1, 4];
/// The Stanford bunny's file and triangles.
pub const STANFORD: (&str, usize) = ("stanford-bunny.obj", 69_451);
/// Fewest triangles of a mesh that is made.
const FEWEST: usize = 80;

/// `folder`, by default `NEARFIELD_DATA`, else `../shared/data` beside the repository.
pub fn data_folder(folder: Option<&Path>) -> PathBuf {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let by_default = || std::env::var_os("NEARFIELD_DATA").map_or_else(beside, Into::into);
    folder.map_or_else(by_default, Path::to_path_buf)
}

impl Source {
    /// Files of `folder`, by default `NEARFIELD_DATA`, else `../shared/data` beside the repository. With a scale other than
    /// 1 no file is read: icospheres have numbers of triangles of the files times it.
    pub fn new(folder: Option<&Path>, scale: f64) -> Self {
        Self { folder: data_folder(folder), scale }
    }

    /// A file's mesh; an icosphere where the file is not there.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn mesh(&self, (file, triangles): (&str, usize)) -> Result<Named> {
        let path = self.folder.join(file);
        if self.scale == 1.0 && path.is_file() {
            let mesh = nearfield::io::read_mesh(&path, None).map_err(|error| format!("{}: {error}", path.display()))?;
            return Ok(Named { name: file.trim_end_matches(".obj").to_owned(), mesh });
        }
        let n = ((triangles as f64 * self.scale) as usize).max(FEWEST);
        let mesh = mesh(MeshKind::Icosphere, n, 0);
        Ok(Named { name: format!("icosphere for {}", file.trim_end_matches(".obj")), mesh })
    }

    /// Accel's largest mesh as it read it: the first three corners of each quad, half of the triangles. Where its file is
    /// not there, every second triangle of what takes its place.
    ///
    /// # Errors
    /// A file that cannot be read, or whose faces are not all quads.
    pub fn three_corners(&self) -> Result<Named> {
        let whole = self.mesh(ACCEL[ACCEL.len() - 1])?;
        let name = format!("{}, three corners of each quad", whole.name);
        let path = self.folder.join(ACCEL[ACCEL.len() - 1].0);
        if self.scale == 1.0 && path.is_file() {
            let bytes = std::fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?;
            let mesh = nearfield::io::parse_mesh_with(&bytes, Format::Obj, Polygons::FirstThree)?;
            if 2 * mesh.triangles.len() != whole.triangles() {
                return Err(format!("{}: not all faces are quads", path.display()).into());
            }
            return Ok(Named { name, mesh });
        }
        let triangles = whole.mesh.triangles.into_iter().step_by(2).collect();
        Ok(Named { name, mesh: TriMesh { triangles, ..whole.mesh } })
    }

    /// Accel's five meshes, by rising number of triangles.
    ///
    /// # Errors
    /// As [`Source::mesh`].
    pub fn accel(&self) -> Result<Vec<Named>> {
        let mut meshes = ACCEL.iter().map(|&which| self.mesh(which)).collect::<Result<Vec<Named>>>()?;
        let (largest, n) = ACCEL[ACCEL.len() - 1];
        let is_file = !meshes[meshes.len() - 1].name.starts_with("icosphere");
        for times in BISECTIONS {
            if is_file {
                let whole = &meshes[ACCEL.len() - 1];
                let name = format!("{}, bisected {times} times", whole.name);
                meshes.push(Named { name, mesh: bisected(&whole.mesh, times)? });
            } else {
                meshes.push(self.mesh((largest, n << times))?);
            }
        }
        Ok(meshes)
    }

    /// About a million triangles.
    ///
    /// # Errors
    /// As [`Source::mesh`].
    pub fn million(&self) -> Result<Named> {
        let whole = self.mesh(ACCEL[ACCEL.len() - 1])?;
        if whole.name.starts_with("icosphere") {
            return self.mesh(("a million triangles", 1_000_000));
        }
        Ok(Named { name: format!("{}, bisected 4 times", whole.name), mesh: bisected(&whole.mesh, 4)? })
    }
}

/// Each triangle cut into two, so many times, without a crack: the two triangles of a quad are cut at the middle of
/// their common edge, then every triangle at the edge that is opposite to its newest corner, which its neighbour
/// across that edge does too. Takes meshes whose triangles 2i and 2i + 1 are the halves of a quad.
///
/// # Errors
/// Triangles that are not halves of quads.
pub fn bisected(mesh: &TriMesh, times: u32) -> Result<TriMesh> {
    // Each triangle with its newest corner first: the edge to be cut is that of the other two.
    let mut triangles = Vec::with_capacity(mesh.triangles.len() << times);
    for (i, pair) in mesh.triangles.chunks(2).enumerate() {
        let &[first, second] = pair else {
            return Err("meshes are bisected by quads, and this one has an odd number of triangles".into());
        };
        let lone = |of: [u32; 3], other: [u32; 3]| (0..3).find(|&corner| !other.contains(&of[corner]));
        match (lone(first, second), lone(second, first)) {
            (Some(a), Some(b)) if shared(first, second) == 2 => triangles.extend([turned(first, a), turned(second, b)]),
            _ => return Err(format!("triangles {} and {} are not the halves of a quad", 2 * i, 2 * i + 1).into()),
        }
    }
    let mut vertices = mesh.vertices.clone();
    for _ in 0..times {
        let mut middles: HashMap<[u32; 2], u32> = HashMap::with_capacity(triangles.len());
        let mut halves = Vec::with_capacity(2 * triangles.len());
        for &[newest, a, b] in &triangles {
            let middle = *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                vertices.push(0.5 * (vertices[a as usize] + vertices[b as usize]));
                (vertices.len() - 1) as u32
            });
            halves.extend([[middle, newest, a], [middle, b, newest]]);
        }
        triangles = halves;
    }
    Ok(TriMesh { origin: mesh.origin, ..TriMesh::new(vertices, triangles)? })
}

fn shared(a: [u32; 3], b: [u32; 3]) -> usize {
    a.iter().filter(|corner| b.contains(corner)).count()
}

/// The same triangle, beginning at that corner.
fn turned(t: [u32; 3], first: usize) -> [u32; 3] {
    [t[first], t[(first + 1) % 3], t[(first + 2) % 3]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nearfield::Vec3;

    /// A cube of quads, each as two triangles with a common diagonal.
    fn cube() -> TriMesh {
        let vertices = (0..8u32).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32)).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        TriMesh::new(vertices, triangles).expect("a cube")
    }

    #[test]
    fn bisection_doubles_the_triangles_and_leaves_no_crack() {
        let cube = cube();
        for times in 0..5 {
            let finer = bisected(&cube, times).expect("quads");
            assert_eq!(finer.triangles.len(), 12 << times);
            assert!((finer.area() - 6.0).abs() < 1e-5, "{}", finer.area());
            // Closed and oriented: each edge once in each direction.
            let mut edges = HashMap::new();
            for t in &finer.triangles {
                for i in 0..3 {
                    *edges.entry((t[i], t[(i + 1) % 3])).or_insert(0) += 1;
                }
            }
            assert!(edges.iter().all(|(&(a, b), &n)| n == 1 && edges.get(&(b, a)) == Some(&1)), "{times} bisections");
        }
    }

    #[test]
    fn triangles_that_are_no_quads_are_refused() {
        let mut mesh = cube();
        mesh.triangles.swap(0, 2);
        assert!(bisected(&mesh, 1).unwrap_err().to_string().contains("0 and 1"));
        mesh.triangles.pop();
        assert!(bisected(&mesh, 1).is_err());
    }
}
