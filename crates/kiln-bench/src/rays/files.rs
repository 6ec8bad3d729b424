//! Triangles, rays and hits as files, for programs that trace the same.
//!
//! Little-endian. `PREFIX.pos`: f32 x, y, z for each vertex. `PREFIX.idx`: u32 triples of vertices. `PREFIX.rays`: u32
//! points, u32 rays per point, f32 diagonal of the scene; then f32 x, y, z of each point, of each normal, and of each
//! direction, those of one point together. Hits: for each ray f32 t (infinite on a miss), u32 triangle, u32 flags
//! (1: the back of the triangle).

use crate::BenchError;
use kiln_core::{FaceGroup, Mesh};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Bytes of three numbers.
const TRIPLE: usize = 12;

/// Rays from points of a surface.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RaySet {
    /// Rays of each point.
    pub(super) per_point: usize,
    /// Of the scene, metres.
    pub(super) diagonal_m: f32,
    /// Points, moved off the surface.
    pub(super) origins: Vec<[f32; 3]>,
    /// Unit normals at the points.
    pub(super) normals: Vec<[f32; 3]>,
    /// Directions, those of one point together.
    pub(super) directions: Vec<[f32; 3]>,
}

impl RaySet {
    /// Origin and direction of a ray.
    pub(super) fn ray(&self, index: usize) -> ([f32; 3], [f32; 3]) {
        (self.origins[index / self.per_point], self.directions[index])
    }
}

/// The closest hit of a ray, as files have it.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub(super) struct FileHit {
    /// Distance; infinite on a miss.
    pub(super) t: f32,
    /// Triangle in the order of `PREFIX.idx`.
    pub(super) triangle: u32,
    /// Its back was hit.
    pub(super) is_back: bool,
}

impl FileHit {
    /// No hit.
    pub(super) const MISS: Self = Self { t: f32::INFINITY, triangle: u32::MAX, is_back: false };

    /// Whether anything was hit.
    pub(super) fn is_hit(&self) -> bool {
        self.t < f32::INFINITY
    }
}

/// The paths of a scene's three files.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Paths {
    /// Vertices.
    pub(super) positions: PathBuf,
    /// Triangles.
    pub(super) triangles: PathBuf,
    /// Rays.
    pub(super) rays: PathBuf,
}

impl Paths {
    /// `PREFIX.pos`, `PREFIX.idx`, `PREFIX.rays`.
    pub(super) fn of(prefix: &Path) -> Self {
        let with = |ending: &str| {
            let mut path = prefix.as_os_str().to_owned();
            path.push(ending);
            PathBuf::from(path)
        };
        Self { positions: with(".pos"), triangles: with(".idx"), rays: with(".rays") }
    }

    /// Reads the triangles, all of them single-sided and in the way of rays, and the rays.
    pub(super) fn read(&self) -> Result<(Mesh, RaySet), BenchError> {
        let positions: Vec<[f32; 3]> = triples(&self.positions, "vertices of f32 x, y, z")?;
        if let Some(at) = positions.iter().position(|position| !is_finite(position)) {
            return Err(bad(&self.positions, format!("vertex {at} is not finite; leave out its triangles")));
        }
        let faces: Vec<[u32; 3]> = triples(&self.triangles, "triangles of u32 vertices")?;
        let count = positions.len();
        if let Some(at) = faces.iter().position(|face| face.iter().any(|vertex| *vertex as usize >= count)) {
            let reason = format!("triangle {at} names a vertex beyond the {count} of {}", self.positions.display());
            return Err(bad(&self.triangles, reason + "; the two files must come from one scene"));
        }
        let mesh = Mesh {
            normals: vec![[0.0; 3]; count],
            positions,
            face_group: vec![0; faces.len()],
            faces,
            groups: vec![group(false)],
            ..Mesh::default()
        };
        Ok((mesh, read_rays(&self.rays)?))
    }

    /// Writes the triangles and the rays.
    pub(super) fn write(&self, mesh: &Mesh, rays: &RaySet) -> Result<(), BenchError> {
        write(&self.positions, bytemuck::cast_slice(&mesh.positions))?;
        write(&self.triangles, bytemuck::cast_slice(&mesh.faces))?;
        let mut bytes = Vec::new();
        bytes.extend(bytemuck::bytes_of(&[rays.origins.len() as u32, rays.per_point as u32]));
        bytes.extend(rays.diagonal_m.to_le_bytes());
        for list in [&rays.origins, &rays.normals, &rays.directions] {
            bytes.extend_from_slice(bytemuck::cast_slice(list));
        }
        write(&self.rays, &bytes)
    }
}

/// What faces without a material have in common.
pub(super) fn group(double_sided: bool) -> FaceGroup {
    FaceGroup { double_sided, ..FaceGroup::PLAIN }
}

fn read_rays(path: &Path) -> Result<RaySet, BenchError> {
    let bytes = read(path)?;
    let Some((header, body)) = bytes.split_first_chunk::<TRIPLE>() else {
        return Err(bad(path, format!("has {} bytes, less than its header's {TRIPLE}; {MAKE_RAYS}", bytes.len())));
    };
    let [points, per_point, diagonal]: [u32; 3] = bytemuck::cast(*header);
    let diagonal_m = f32::from_bits(diagonal);
    let (points, per_point) = (points as usize, per_point as usize);
    let needed = per_point.checked_add(2).and_then(|of_point| of_point.checked_mul(points)?.checked_mul(TRIPLE));
    if points == 0 || per_point == 0 || needed != Some(body.len()) {
        let said = format!("its header says {points} points of {per_point} rays");
        return Err(bad(path, format!("{said}, which is not what its {} bytes hold; {MAKE_RAYS}", bytes.len())));
    }
    if !(diagonal_m.is_finite() && diagonal_m > 0.0) {
        return Err(bad(path, format!("the scene's diagonal is {diagonal_m}, no positive length; {MAKE_RAYS}")));
    }
    let all: Vec<[f32; 3]> = bytemuck::pod_collect_to_vec(body);
    if let Some(at) = all.iter().position(|triple| !is_finite(triple)) {
        return Err(bad(path, format!("byte {}: a coordinate is not finite; {MAKE_RAYS}", TRIPLE * (at + 1))));
    }
    let (origins, rest) = all.split_at(points);
    let (normals, directions) = rest.split_at(points);
    if let Some(at) = directions.iter().position(|direction| *direction == [0.0; 3]) {
        return Err(bad(path, format!("ray {at} has no direction; {MAKE_RAYS}")));
    }
    let (origins, normals, directions) = (origins.to_vec(), normals.to_vec(), directions.to_vec());
    Ok(RaySet { per_point, diagonal_m, origins, normals, directions })
}

const MAKE_RAYS: &str = "write it again, or give the level itself, a .glb";

/// Reads the hits of `count` rays.
pub(super) fn read_hits(path: &Path, count: usize) -> Result<Vec<FileHit>, BenchError> {
    let raw: Vec<[u32; 3]> = triples(path, "hits")?;
    if raw.len() != count {
        let reason = format!("has {} hits of {count} rays; the program must write one for each ray", raw.len());
        return Err(bad(path, reason));
    }
    let hit = |[t, triangle, flags]: [u32; 3]| {
        let t = f32::from_bits(t);
        if t < f32::INFINITY { FileHit { t, triangle, is_back: flags & 1 == 1 } } else { FileHit::MISS }
    };
    Ok(raw.into_iter().map(hit).collect())
}

/// Writes hits.
pub(super) fn write_hits(path: &Path, hits: &[FileHit]) -> Result<(), BenchError> {
    let raw: Vec<[u32; 3]> = hits.iter().map(|hit| [hit.t.to_bits(), hit.triangle, u32::from(hit.is_back)]).collect();
    write(path, bytemuck::cast_slice(&raw))
}

fn triples<T: bytemuck::Pod>(path: &Path, what: &str) -> Result<Vec<[T; 3]>, BenchError>
where
    [T; 3]: bytemuck::Pod,
{
    let bytes = read(path)?;
    if bytes.is_empty() || bytes.len() % TRIPLE != 0 {
        let reason = format!("has {} bytes, which are no {what} of {TRIPLE} bytes each; write it again", bytes.len());
        return Err(bad(path, reason));
    }
    Ok(bytemuck::pod_collect_to_vec(&bytes))
}

fn is_finite(triple: &[f32; 3]) -> bool {
    triple.iter().all(|x| x.is_finite())
}

fn read(path: &Path) -> Result<Vec<u8>, BenchError> {
    let reason = |error| format!("{error}; give PREFIX for PREFIX.pos, PREFIX.idx and PREFIX.rays, or a level, a .glb");
    fs::read(path).map_err(|error| bad(path, reason(error)))
}

/// Writes a file.
pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<(), BenchError> {
    fs::write(path, bytes).map_err(|error| bad(path, format!("{error}; check the folder and its free space")))
}

fn bad(path: &Path, reason: String) -> BenchError {
    BenchError::File { path: path.to_path_buf(), reason }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scratch::Scratch;

    fn triangle() -> Mesh {
        Mesh {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            normals: vec![[0.0; 3]; 3],
            faces: vec![[0, 1, 2]],
            face_group: vec![0],
            groups: vec![group(false)],
            ..Mesh::default()
        }
    }

    fn rays() -> RaySet {
        RaySet {
            per_point: 2,
            diagonal_m: 1.5,
            origins: vec![[0.25, 0.25, 1.0]],
            normals: vec![[0.0, 0.0, 1.0]],
            directions: vec![[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]],
        }
    }

    #[test]
    fn what_is_written_is_read() -> Result<(), BenchError> {
        let scratch = Scratch::new("rays-files")?;
        let paths = Paths::of(&scratch.path().join("a.b"));
        paths.write(&triangle(), &rays())?;
        assert_eq!(paths.read()?, (triangle(), rays()));
        let hits = [FileHit { t: 1.0, triangle: 0, is_back: true }, FileHit::MISS];
        write_hits(&paths.rays, &hits)?;
        assert_eq!(read_hits(&paths.rays, 2)?, hits);
        Ok(())
    }

    /// What is said about a scene after its files were changed.
    fn said_after(name: &str, spoil: impl Fn(&Paths)) -> String {
        let scratch = Scratch::new(name).unwrap();
        let paths = Paths::of(&scratch.path().join("scene"));
        paths.write(&triangle(), &rays()).unwrap();
        spoil(&paths);
        paths.read().unwrap_err().to_string()
    }

    #[test]
    fn bad_files_are_refused_with_name_and_reason() {
        let put = |path: &Path, bytes: &[u8]| fs::write(path, bytes).unwrap();
        let cut = |path: &Path, by: usize| {
            let bytes = fs::read(path).unwrap();
            put(path, &bytes[..bytes.len() - by]);
        };
        let said = said_after("rays-cut", |paths| cut(&paths.positions, 1));
        assert!(said.contains("scene.pos") && said.contains("35 bytes"), "{said}");
        let said = said_after("rays-index", |paths| put(&paths.triangles, bytemuck::cast_slice(&[0u32, 1, 3])));
        assert!(said.contains("scene.idx") && said.contains("triangle 0 names a vertex beyond the 3"), "{said}");
        let said = said_after("rays-nan", |paths| put(&paths.positions, bytemuck::cast_slice(&[f32::NAN; 9])));
        assert!(said.contains("vertex 0 is not finite"), "{said}");
        let said = said_after("rays-short", |paths| cut(&paths.rays, 4));
        assert!(said.contains("scene.rays") && said.contains("1 points of 2 rays"), "{said}");
        let said = said_after("rays-header", |paths| put(&paths.rays, &[1; 5]));
        assert!(said.contains("less than its header"), "{said}");
        let said = said_after("rays-huge", |paths| put(&paths.rays, &[255; 24]));
        assert!(said.contains("4294967295 points"), "{said}");
        let said = said_after("rays-gone", |paths| fs::remove_file(&paths.rays).unwrap());
        assert!(said.contains("scene.rays") && said.contains("give PREFIX"), "{said}");
    }

    #[test]
    fn rays_without_length_or_direction_are_refused() {
        let with = |name: &str, spoil: fn(&mut RaySet)| {
            said_after(name, |paths| {
                let mut rays = rays();
                spoil(&mut rays);
                paths.write(&triangle(), &rays).unwrap();
            })
        };
        assert!(with("rays-diagonal", |rays| rays.diagonal_m = 0.0).contains("no positive length"));
        assert!(with("rays-zero", |rays| rays.directions[1] = [0.0; 3]).contains("ray 1 has no direction"));
        assert!(with("rays-inf", |rays| rays.origins[0][2] = f32::INFINITY).contains("byte 12: a coordinate"));
    }

    #[test]
    fn hits_must_be_those_of_all_rays() -> Result<(), BenchError> {
        let scratch = Scratch::new("rays-hits")?;
        let path = scratch.path().join("hits");
        write_hits(&path, &[FileHit::MISS])?;
        let said = read_hits(&path, 2).unwrap_err().to_string();
        assert!(said.contains("has 1 hits of 2 rays"), "{said}");
        Ok(())
    }
}
