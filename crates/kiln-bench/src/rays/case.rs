//! A scene and the rays that are traced in it.

use super::{
    files::{FileHit, Paths, RaySet, group},
    surface::Surfaces,
};
use crate::{BenchError, imported};
use glam::{DAffine3, DVec3};
use kiln_core::{Cutouts, FaceGroup, Kernel, Mesh};
use kiln_trace::{Hit, MeshBvh, Scene, SceneObject};
use rayon::prelude::*;
use std::{
    path::{Path, PathBuf},
    str::FromStr,
    sync::Arc,
};

/// Where a scene comes from.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Input {
    /// `PREFIX.pos`, `PREFIX.idx`, `PREFIX.rays`.
    Files(PathBuf),
    /// A level, whose rays are made here.
    Level(PathBuf),
}

impl FromStr for Input {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let path = PathBuf::from(text);
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        Ok(match ending.as_deref() {
            Some("glb" | "gltf") => Self::Level(path),
            Some("pos" | "idx" | "rays") => Self::Files(path.with_extension("")),
            _ => Self::Files(path),
        })
    }
}

impl Input {
    /// What the command line calls it.
    pub(super) fn path(&self) -> &Path {
        let (Self::Files(path) | Self::Level(path)) = self;
        path
    }
}

/// How rays are made for a level.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RayCounts {
    pub(crate) points: usize,
    pub(crate) per_point: usize,
}

/// A scene and its rays. Every face stops rays.
pub(crate) struct Case {
    pub(super) name: String,
    pub(crate) meshes: Vec<Arc<Mesh>>,
    pub(crate) objects: Vec<SceneObject>,
    pub(super) rays: RaySet,
    /// What gathering makes of distances.
    pub(super) kernel: Kernel,
}

impl Case {
    /// Reads a scene; a level keeps its instances.
    pub(super) fn read(input: &Input, counts: RayCounts) -> Result<Self, BenchError> {
        let name = |path: &Path| path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        match input {
            Input::Files(prefix) => {
                let (mesh, rays) = Paths::of(prefix).read()?;
                let object = SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY };
                let name = prefix.file_name().unwrap_or(prefix.as_os_str()).to_string_lossy().into_owned();
                let kernel = kernel_for(rays.diagonal_m);
                Ok(Self { name, meshes: vec![Arc::new(mesh)], objects: vec![object], rays, kernel })
            }
            Input::Level(path) => {
                let imported = imported::import(path)?;
                let meshes: Vec<Arc<Mesh>> = imported.meshes.par_iter().map(occluding).collect();
                let placed = imported.level.instances.iter();
                let object = |instance: &kiln_core::Instance| SceneObject {
                    mesh: instance.mesh as usize,
                    world_from_object: instance.world_from_object,
                };
                let case = Self::new(name(path), meshes, placed.map(object).collect(), counts);
                if case.rays.origins.is_empty() {
                    let reason = "no face both stops rays and receives; choose another level".to_owned();
                    return Err(BenchError::File { path: path.clone(), reason });
                }
                Ok(Self { kernel: imported.level.sampling.kernel, ..case })
            }
        }
    }

    /// Places meshes and makes rays.
    pub(super) fn new(name: String, meshes: Vec<Arc<Mesh>>, objects: Vec<SceneObject>, counts: RayCounts) -> Self {
        let rays = Surfaces { meshes: &meshes, objects: &objects }.rays(counts.points, counts.per_point);
        let kernel = kernel_for(rays.diagonal_m);
        Self { name, meshes, objects, rays, kernel }
    }

    /// Triangles that rays can hit, those of each instance counted.
    pub(super) fn triangles(&self) -> u64 {
        self.objects.iter().map(|object| self.meshes[object.mesh].faces.len() as u64).sum()
    }

    /// All instances as one mesh.
    pub(super) fn flatten(self) -> Self {
        let mesh = Arc::new(self.flat_mesh());
        let object = SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY };
        Self { meshes: vec![mesh], objects: vec![object], ..self }
    }

    /// The faces of all objects in order, in world space; those of mirrored objects turned, so that fronts stay fronts.
    pub(super) fn flat_mesh(&self) -> Mesh {
        let mut flat = Mesh { groups: vec![group(false), group(true)], ..Mesh::default() };
        for object in &self.objects {
            let (mesh, world) = (&self.meshes[object.mesh], &object.world_from_object);
            let (first, is_mirrored) = (flat.positions.len() as u32, world.matrix3.determinant() < 0.0);
            let place = |p: &[f32; 3]| world.transform_point3(DVec3::from(p.map(f64::from))).as_vec3().to_array();
            flat.positions.extend(mesh.positions.iter().map(place));
            let turned = |[a, b, c]: [u32; 3]| if is_mirrored { [a, c, b] } else { [a, b, c] };
            flat.faces.extend(mesh.faces.iter().map(|face| turned(face.map(|vertex| vertex + first))));
            let group_of = |face| u16::from(mesh.group(face).double_sided);
            flat.face_group.extend((0..mesh.faces.len()).map(group_of));
        }
        flat.normals = vec![[0.0; 3]; flat.positions.len()];
        flat
    }

    /// Builds the BVHs with the threads of the current pool: one for each mesh, one over the instances.
    pub(super) fn build(&self) -> Scene {
        let meshes = self.meshes.par_iter().map(|mesh| Arc::new(MeshBvh::build(mesh))).collect();
        Scene::build(meshes, &self.objects)
    }

    /// Hits by the triangles of [`Case::flat_mesh`].
    pub(super) fn flat_hits(&self, hits: &[Hit]) -> Vec<FileHit> {
        let counts = self.objects.iter().map(|object| self.meshes[object.mesh].faces.len() as u32);
        let first: Vec<u32> = counts.scan(0, |next, count| Some(std::mem::replace(next, *next + count))).collect();
        let flat = |hit: &Hit| match first.get(hit.instance as usize) {
            Some(first) if hit.is_hit() => {
                FileHit { t: hit.t, triangle: first + hit.primitive, is_back: hit.back_face }
            }
            _ => FileHit::MISS,
        };
        hits.iter().map(flat).collect()
    }
}

/// The half-distances that import chooses for a level of a diagonal of 1 km, in proportion.
fn kernel_for(diagonal_m: f32) -> Kernel {
    Kernel::Obscurance { half_distances_m: [0.002, 0.3].map(|share| share * f64::from(diagonal_m)).to_vec() }
}

/// A mesh without the faces that stop no ray. Faces with holes are whole: peers know of none.
fn occluding(mesh: &Arc<Mesh>) -> Arc<Mesh> {
    let keep: Vec<usize> = (0..mesh.faces.len()).filter(|face| mesh.group(*face).occludes).collect();
    let has_holes = mesh.groups.iter().any(|group| group.cutout.is_some());
    if keep.len() == mesh.faces.len() && !has_holes {
        return Arc::clone(mesh);
    }
    Arc::new(Mesh {
        faces: keep.iter().map(|face| mesh.faces[*face]).collect(),
        face_group: keep.iter().map(|face| mesh.face_group[*face]).collect(),
        groups: mesh.groups.iter().map(|group| FaceGroup { cutout: None, ..group.clone() }).collect(),
        cutouts: Cutouts::default(),
        ..Mesh::clone(mesh)
    })
}
