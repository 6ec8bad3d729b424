//! Loaded levels: meshes, BVHs and tracers, shared by the tasks of a level.

use super::{Backend, out_of_range};
use crate::{Artefacts, TaskError};
use glam::{DAffine3, DVec3};
use kiln_core::{Bounds, Class, Digest, FaceGroup, Instance, Level, Mesh, codec};
use kiln_trace::{MeshBvh, REACH_EPSILON, Scene, SceneObject, Tracer};
use rayon::prelude::*;
use std::{
    collections::HashMap,
    sync::{Arc, Mutex, OnceLock, PoisonError},
};

/// Levels kept loaded. Two, so that the end of one bake and the start of the next do not evict each other.
const LEVELS_KEPT: usize = 2;

/// The ground plane reaches at most this far beyond the level, metres.
const MAX_PLANE_REACH_M: f64 = 1e6;

/// A scene and what traces it.
pub type SceneTracer = (Arc<Scene>, Arc<dyn Tracer>);

/// A level whose meshes are in memory. BVHs are built when the first trace task asks.
pub struct LoadedLevel {
    /// The manifest.
    pub level: Level,
    /// Digest of the manifest.
    pub digest: Digest,
    /// Its meshes.
    pub meshes: Vec<Arc<Mesh>>,
    tracer: OnceLock<Result<SceneTracer, String>>,
}

impl LoadedLevel {
    /// Loads a level and its meshes.
    pub fn load(digest: Digest, artefacts: &dyn Artefacts) -> Result<Self, TaskError> {
        let level: Level = codec::decode("a level", &artefacts.get(digest)?)?;
        let mut digests: Vec<Digest> = level.meshes.iter().map(|mesh| mesh.digest).collect();
        digests.sort_unstable();
        digests.dedup();
        let blobs = artefacts.get_many(&digests)?;
        let decode = |(digest, bytes): (&Digest, _)| -> Result<(Digest, Arc<Mesh>), TaskError> {
            let bytes: &[u8] = AsRef::as_ref(bytes);
            Ok((*digest, Arc::new(codec::decode("a mesh", bytes)?)))
        };
        let by_digest: HashMap<Digest, Arc<Mesh>> =
            digests.par_iter().zip(&blobs).map(decode).collect::<Result<_, TaskError>>()?;
        let meshes = level.meshes.iter().map(|mesh| Arc::clone(&by_digest[&mesh.digest])).collect();
        Self::new(digest, level, meshes)
    }

    /// A level whose meshes were loaded elsewhere.
    pub fn new(digest: Digest, level: Level, meshes: Vec<Arc<Mesh>>) -> Result<Self, TaskError> {
        if let Some(instance) = level.instances.iter().find(|i| i.mesh as usize >= meshes.len()) {
            return Err(out_of_range("mesh", instance.mesh));
        }
        Ok(Self { level, digest, meshes, tracer: OnceLock::new() })
    }

    /// An instance and its mesh.
    pub fn instance(&self, index: u32) -> Result<(&Instance, &Arc<Mesh>), TaskError> {
        let instance = self.level.instances.get(index as usize).ok_or_else(|| out_of_range("instance", index))?;
        Ok((instance, &self.meshes[instance.mesh as usize]))
    }

    /// The scene and a tracer over it, built once: one BVH for each distinct mesh.
    pub fn tracer(&self, backend: &Backend) -> Result<&SceneTracer, TaskError> {
        let build = || {
            let scene = Arc::new(self.build_scene());
            let tracer = backend.tracer(&scene).map_err(|error| error.to_string())?;
            Ok((scene, tracer))
        };
        self.tracer.get_or_init(build).as_ref().map_err(|reason| TaskError::Failed { reason: reason.clone() })
    }

    fn build_scene(&self) -> Scene {
        // Entries of the same digest share one mesh, and so one BVH.
        let mut first_of: HashMap<*const Mesh, usize> = HashMap::new();
        let mut distinct: Vec<&Arc<Mesh>> = Vec::new();
        let index_of: Vec<usize> = self
            .meshes
            .iter()
            .map(|mesh| {
                *first_of.entry(Arc::as_ptr(mesh)).or_insert_with(|| {
                    distinct.push(mesh);
                    distinct.len() - 1
                })
            })
            .collect();
        let mut bvhs: Vec<Arc<MeshBvh>> = distinct.par_iter().map(|mesh| Arc::new(MeshBvh::build(mesh))).collect();
        let mut objects: Vec<SceneObject> = self
            .level
            .instances
            .iter()
            .map(|i| SceneObject { mesh: index_of[i.mesh as usize], world_from_object: i.world_from_object })
            .collect();
        if let Some(plane) = ground_plane(&self.level) {
            objects.push(SceneObject { mesh: bvhs.len(), world_from_object: DAffine3::IDENTITY });
            bvhs.push(Arc::new(MeshBvh::build(&plane)));
        }
        Scene::build(bvhs, &objects)
    }
}

/// The plane that `--ground-plane` adds: two faces under the level, out to its reach, that stop rays from both sides.
#[expect(clippy::cast_possible_truncation, reason = "meshes are f32")]
pub fn ground_plane(level: &Level) -> Option<Mesh> {
    let height = level.sampling.ground_plane_y_m?;
    let bounds = if level.bounds.is_empty() { Bounds { min: DVec3::ZERO, max: DVec3::ZERO } } else { level.bounds };
    let reach = level.sampling.kernel.reach_m(REACH_EPSILON).min(MAX_PLANE_REACH_M);
    let (low, high) = (bounds.min - reach, bounds.max + reach);
    let corner = |x: f64, z: f64| [x as f32, height as f32, z as f32];
    let group = FaceGroup {
        class: Class::Opaque,
        double_sided: true,
        occludes: true,
        receives: false,
        max_samples_per_face: None,
    };
    Some(Mesh {
        positions: vec![corner(low.x, low.z), corner(low.x, high.z), corner(high.x, high.z), corner(high.x, low.z)],
        normals: vec![[0.0, 1.0, 0.0]; 4],
        faces: vec![[0, 1, 2], [0, 2, 3]],
        face_group: vec![0, 0],
        groups: vec![group],
    })
}

/// A level that is loaded, or is being loaded by who holds the lock.
#[derive(Clone, Default)]
struct Slot {
    level: Arc<OnceLock<Arc<LoadedLevel>>>,
    loading: Arc<Mutex<()>>,
}

/// The levels that tasks have asked for of late.
#[derive(Default)]
pub(super) struct LevelCache {
    /// Most recent last.
    slots: Mutex<Vec<(Digest, Slot)>>,
}

impl LevelCache {
    /// The level, loaded by the first task that asks; the others wait for it.
    pub(super) fn get(&self, digest: Digest, artefacts: &dyn Artefacts) -> Result<Arc<LoadedLevel>, TaskError> {
        let slot = self.slot(digest);
        let _loading = slot.loading.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(level) = slot.level.get() {
            return Ok(Arc::clone(level));
        }
        let level = Arc::new(LoadedLevel::load(digest, artefacts)?);
        Ok(Arc::clone(slot.level.get_or_init(|| level)))
    }

    fn slot(&self, digest: Digest) -> Slot {
        let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = match slots.iter().position(|(d, _)| *d == digest) {
            Some(at) => slots.remove(at),
            None => (digest, Slot::default()),
        };
        slots.push(entry.clone());
        if slots.len() > LEVELS_KEPT {
            slots.remove(0);
        }
        entry.1
    }
}
