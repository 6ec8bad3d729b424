//! Loaded levels: meshes, BVHs and tracers, shared by the tasks of a level. What no receiver's rays can come to is not
//! loaded.

use super::{
    Backend,
    bvhs::{BvhKeeper, NamedMesh},
    fit,
    masks::SharedMasks,
    out_of_range,
    trees::{Model, Trees},
};
use crate::{
    Artefacts, LocalCache, TaskError,
    account::{self, Part},
    threads::on_all_threads,
};
use glam::{DAffine3, DVec3};
use kiln_bake::volume::{Volume, VolumeError};
use kiln_core::{Bounds, Digest, FaceGroup, FoliageMode, Instance, Level, Mesh, REACH_EPSILON, codec};
use kiln_gpu::GpuError;
use kiln_plan::Reach;
use kiln_trace::{CrossingMesh, CutoutMesh, Foliage, FoliageObject, MeshBvh, Scene, SceneObject, Tracer};
use rayon::prelude::*;
use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
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
    /// Its meshes; empty ones in place of those that no task needs.
    pub meshes: Vec<Arc<Mesh>>,
    reach: Reach,
    /// The instances that are traced.
    is_traced: Vec<bool>,
    scene: OnceLock<Arc<Scene>>,
    /// Of the CPU and of the device.
    tracers: [OnceLock<Result<SceneTracer, GpuError>>; 2],
    trees: OnceLock<Result<Trees, VolumeError>>,
    /// Which of the instances with values each run of those with one number may read, by the run's first.
    near: OnceLock<BTreeMap<u32, Vec<u32>>>,
    /// The volume around trees, and the batches that it was made of.
    volume: Mutex<Option<(Vec<Digest>, Arc<Volume>)>>,
    /// BVHs of meshes, by index.
    bvhs: Mutex<HashMap<u32, Arc<MeshBvh>>>,
    /// Models alone, by mesh and backend.
    alone: Mutex<HashMap<(u32, bool), SceneTracer>>,
}

impl LoadedLevel {
    /// Loads a level and its meshes.
    pub fn load(digest: Digest, artefacts: &dyn Artefacts) -> Result<Self, TaskError> {
        let level: Level = codec::decode("a level", &artefacts.get(digest)?)?;
        let reach = reach(&level)?;
        let mut is_traced = reach.is_reached();
        let receivers = is_traced.iter_mut().zip(&level.instances);
        receivers.for_each(|(traced, instance)| *traced |= instance.receives);
        let traced = level.instances.iter().zip(&is_traced).filter(|(_, traced)| **traced);
        let needed: BTreeSet<Digest> = traced.map(|(i, _)| level.meshes[i.mesh as usize].digest).collect();
        let digests: Vec<Digest> = needed.into_iter().collect();
        let blobs = artefacts.get_many(&digests)?;
        let masks = SharedMasks::default();
        let decode = |(digest, bytes): (&Digest, _)| -> Result<(Digest, Arc<Mesh>), TaskError> {
            let bytes: &[u8] = AsRef::as_ref(bytes);
            let mut mesh: Mesh = codec::decode("a mesh", bytes)?;
            masks.share(&mut mesh);
            Ok((*digest, Arc::new(mesh)))
        };
        let by_digest: HashMap<Digest, Arc<Mesh>> =
            digests.par_iter().zip(&blobs).map(decode).collect::<Result<_, TaskError>>()?;
        let nothing = Arc::new(Mesh::default());
        let mesh = |digest| Arc::clone(by_digest.get(digest).unwrap_or(&nothing));
        let meshes = level.meshes.iter().map(|entry| mesh(&entry.digest)).collect();
        Ok(Self::of(digest, level, meshes, reach, is_traced))
    }

    /// A level whose meshes were loaded elsewhere. All of it is traced: rays may start anywhere.
    pub fn new(digest: Digest, mut level: Level, meshes: Vec<Arc<Mesh>>) -> Result<Self, TaskError> {
        if let Some(instance) = level.instances.iter().find(|i| i.mesh as usize >= meshes.len()) {
            return Err(out_of_range("mesh", instance.mesh));
        }
        kiln_bake::place_fog(&mut level, |index| meshes.get(index).map(|mesh| &**mesh));
        let (reach, is_traced) = (reach(&level)?, vec![true; level.instances.len()]);
        Ok(Self::of(digest, level, meshes, reach, is_traced))
    }

    fn of(digest: Digest, level: Level, meshes: Vec<Arc<Mesh>>, reach: Reach, is_traced: Vec<bool>) -> Self {
        Self {
            level,
            digest,
            meshes,
            reach,
            is_traced,
            scene: OnceLock::new(),
            tracers: Default::default(),
            trees: OnceLock::new(),
            near: OnceLock::new(),
            volume: Mutex::default(),
            bvhs: Mutex::default(),
            alone: Mutex::default(),
        }
    }

    /// A box around an instance and the origins of its rays, metres.
    pub(super) fn seen_m(&self, instance: usize) -> Bounds {
        let placed = &self.level.instances[instance];
        kiln_bake::seen_bounds(&self.level.meshes[placed.mesh as usize].bounds, &placed.world_from_object)
    }

    /// The foliage that gets something.
    pub(super) fn trees(&self) -> Result<&Trees, TaskError> {
        let trees = self.trees.get_or_init(|| Trees::new(&self.level, &self.reach, |index| self.seen_m(index)));
        trees
            .as_ref()
            .map_err(|error| TaskError::Refused { reason: format!("the volume around the level's trees: {error}") })
    }

    /// The instances with values that a run of those with one number may read.
    pub(super) fn near(&self, first: u32) -> Result<&[u32], TaskError> {
        let trees = self.trees()?;
        let near = self.near.get_or_init(|| trees.near(self));
        near.get(&first).map(Vec::as_slice).ok_or_else(|| out_of_range("run of shrubs from", first))
    }

    /// The volume around trees, from its batches; put together once.
    pub(super) fn volume(&self, batches: &[Digest], artefacts: &dyn Artefacts) -> Result<Arc<Volume>, TaskError> {
        let mut known = account::waiting(|| self.volume.lock()).unwrap_or_else(PoisonError::into_inner);
        if let Some((_, volume)) = known.as_ref().filter(|(of, _)| of == batches) {
            return Ok(Arc::clone(volume));
        }
        let volume = Arc::new(fit::assemble(self, batches, artefacts)?);
        *known = Some((batches.to_vec(), Arc::clone(&volume)));
        Ok(volume)
    }

    /// The BVH of a mesh that is loaded.
    pub(super) fn bvh(&self, mesh: u32, bvhs: &BvhKeeper, cache: Option<&LocalCache>) -> Arc<MeshBvh> {
        let mut known = account::waiting(|| self.bvhs.lock()).unwrap_or_else(PoisonError::into_inner);
        if let Some(bvh) = known.get(&mesh) {
            return Arc::clone(bvh);
        }
        let index = mesh as usize;
        let build = || bvhs.all(&[(self.level.meshes[index].digest, &*self.meshes[index])], cache);
        let found = account::part(Part::Building, build);
        let bvh = found.into_iter().next().unwrap_or_else(|| Arc::new(MeshBvh::build(&Mesh::default())));
        known.insert(mesh, Arc::clone(&bvh));
        bvh
    }

    /// A model of trees by itself, and a backend's tracer over it.
    pub(super) fn alone(&self, model: &Model, backend: &Backend) -> Result<SceneTracer, TaskError> {
        let mut known = account::waiting(|| self.alone.lock()).unwrap_or_else(PoisonError::into_inner);
        let key = (model.mesh, matches!(backend, Backend::Gpu(_)));
        if let Some((scene, tracer)) = known.get(&key) {
            return Ok((Arc::clone(scene), Arc::clone(tracer)));
        }
        let mesh = &self.meshes[model.mesh as usize];
        let world_from_object = model.place();
        let crossings = CrossingMesh::build(mesh).map(Arc::new);
        let objects: Vec<FoliageObject> =
            crossings.into_iter().map(|mesh| FoliageObject::Crossings { mesh, world_from_object }).collect();
        let placed = [SceneObject { mesh: 0, world_from_object }];
        let scene = Scene::build(vec![Arc::new(MeshBvh::build(mesh))], &placed)
            .with_cutouts(vec![CutoutMesh::build(mesh).map(Arc::new)], &placed);
        let scene = Arc::new(scene.with_foliage(Foliage::build(&objects, self.level.sampling.foliage)));
        let tracer = backend.tracer(&scene).map_err(|error| gpu_error(&error))?;
        known.insert(key, (Arc::clone(&scene), Arc::clone(&tracer)));
        Ok((scene, tracer))
    }

    /// What the rays of each instance can come to.
    pub fn reach(&self) -> &Reach {
        &self.reach
    }

    /// Whether an instance is traced: whether some receiver's rays can come to it, or it receives.
    pub fn is_traced(&self, instance: usize) -> bool {
        self.is_traced.get(instance).copied().unwrap_or(false)
    }

    /// An instance and its mesh.
    pub fn instance(&self, index: u32) -> Result<(&Instance, &Arc<Mesh>), TaskError> {
        let instance = self.level.instances.get(index as usize).ok_or_else(|| out_of_range("instance", index))?;
        Ok((instance, &self.meshes[instance.mesh as usize]))
    }

    /// The scene and a backend's tracer over it, each built once: one BVH for each distinct mesh.
    pub fn tracer(&self, backend: &Backend) -> Result<&SceneTracer, TaskError> {
        self.tracer_by(backend, &BvhKeeper::default(), None)
    }

    /// Likewise, with BVHs from a cache where it has them.
    pub(super) fn tracer_by(
        &self,
        backend: &Backend,
        bvhs: &BvhKeeper,
        cache: Option<&LocalCache>,
    ) -> Result<&SceneTracer, TaskError> {
        let scene = build_once(&self.scene, || Arc::new(self.build_scene(bvhs, cache)));
        let tracer = &self.tracers[usize::from(matches!(backend, Backend::Gpu(_)))];
        let tracer = build_once(tracer, || Ok((Arc::clone(scene), backend.tracer(scene)?)));
        tracer.as_ref().map_err(gpu_error)
    }

    fn build_scene(&self, bvhs: &BvhKeeper, cache: Option<&LocalCache>) -> Scene {
        // Entries of the same digest share one mesh, and so one BVH.
        let mut first_of: HashMap<*const Mesh, usize> = HashMap::new();
        let mut distinct: Vec<NamedMesh<'_>> = Vec::new();
        let mut index_of = Vec::with_capacity(self.meshes.len());
        for (mesh, entry) in self.meshes.iter().zip(&self.level.meshes) {
            index_of.push(*first_of.entry(Arc::as_ptr(mesh)).or_insert_with(|| {
                distinct.push((entry.digest, mesh));
                distinct.len() - 1
            }));
        }
        let mut bvhs: Vec<Arc<MeshBvh>> = bvhs.all(&distinct, cache);
        if self.level.instances.iter().any(Instance::is_lod) {
            let known = index_of.iter().enumerate().map(|(mesh, at)| (mesh as u32, Arc::clone(&bvhs[*at])));
            self.bvhs.lock().unwrap_or_else(PoisonError::into_inner).extend(known);
        }
        let cutouts = distinct.par_iter().map(|(_, mesh)| CutoutMesh::build(mesh).map(Arc::new)).collect();
        // Instances that are not traced keep their index, by which ties are decided.
        let nothing = bvhs.len();
        bvhs.push(Arc::new(MeshBvh::build(&Mesh::default())));
        let object = |(instance, traced): (&Instance, &bool)| SceneObject {
            mesh: if *traced && !instance.is_lod() { index_of[instance.mesh as usize] } else { nothing },
            world_from_object: instance.world_from_object,
        };
        let mut objects: Vec<SceneObject> = self.level.instances.iter().zip(&self.is_traced).map(object).collect();
        if let Some(plane) = ground_plane(&self.level) {
            objects.push(SceneObject { mesh: bvhs.len(), world_from_object: DAffine3::IDENTITY });
            bvhs.push(Arc::new(MeshBvh::build(&plane)));
        }
        Scene::build(bvhs, &objects).with_cutouts(cutouts, &objects).with_foliage(self.build_foliage())
    }

    fn build_foliage(&self) -> Foliage {
        let in_scene = |(instance, traced): &(&Instance, &bool)| **traced && !instance.is_lod();
        let placed = self.level.instances.iter().zip(&self.is_traced).filter(in_scene);
        foliage_of(
            placed.map(|(instance, _)| (instance, &self.meshes[instance.mesh as usize])),
            self.level.sampling.foliage,
        )
    }
}

/// What rays go through of some instances, each with its mesh: trees as their faces, shrubs as fog.
pub fn foliage_of<'a>(placed: impl Iterator<Item = (&'a Instance, &'a Arc<Mesh>)>, mode: FoliageMode) -> Foliage {
    let mut trees: HashMap<*const Mesh, Option<Arc<CrossingMesh>>> = HashMap::new();
    let mut objects = Vec::new();
    for (instance, mesh) in placed {
        let tree = trees.entry(Arc::as_ptr(mesh)).or_insert_with(|| CrossingMesh::build(mesh).map(Arc::new));
        let world_from_object = instance.world_from_object;
        objects.extend(tree.iter().cloned().map(|mesh| FoliageObject::Crossings { mesh, world_from_object }));
        objects.extend(instance.fog.map(|fog| FoliageObject::Fog { fog, world_from_object }));
    }
    Foliage::build(&objects, mode)
}

fn gpu_error(error: &GpuError) -> TaskError {
    match error {
        GpuError::Trace(error) => error.into(),
        other => TaskError::Failed { reason: other.to_string() },
    }
}

/// What the first task that asks builds; the others wait for it.
fn build_once<T: Send + Sync>(slot: &OnceLock<T>, build: impl FnOnce() -> T + Send) -> &T {
    account::waiting(|| slot.get_or_init(|| on_all_threads(|| account::part(Part::Building, build))))
}

/// What the rays of each instance can come to.
fn reach(level: &Level) -> Result<Reach, TaskError> {
    let seen = |instance: &Instance| {
        let mesh = level.meshes.get(instance.mesh as usize).ok_or_else(|| out_of_range("mesh", instance.mesh))?;
        let mut seen = kiln_bake::seen_bounds(&mesh.bounds, &instance.world_from_object);
        // Fog reaches out of a flat shrub, and is rounded.
        let fog = instance.fog.and_then(|fog| kiln_trace::fog_bounds(&fog, &instance.world_from_object));
        fog.iter().for_each(|fog| seen.merge(fog));
        Ok(seen)
    };
    let seen = level.instances.iter().map(seen).collect::<Result<Vec<Bounds>, TaskError>>()?;
    Ok(Reach::new(level, &seen))
}

/// The plane that `--ground-plane` adds: two faces under the level, out to its reach, that stop rays from both sides.
#[expect(clippy::cast_possible_truncation, reason = "meshes are f32")]
pub fn ground_plane(level: &Level) -> Option<Mesh> {
    let height = level.sampling.ground_plane_y_m?;
    let bounds = if level.bounds.is_empty() { Bounds { min: DVec3::ZERO, max: DVec3::ZERO } } else { level.bounds };
    let reach = level.sampling.kernel.reach_m(REACH_EPSILON).min(MAX_PLANE_REACH_M);
    let (low, high) = (bounds.min - reach, bounds.max + reach);
    let corner = |x: f64, z: f64| [x as f32, height as f32, z as f32];
    let group = FaceGroup { double_sided: true, receives: false, ..FaceGroup::PLAIN };
    Some(Mesh {
        positions: vec![corner(low.x, low.z), corner(low.x, high.z), corner(high.x, high.z), corner(high.x, low.z)],
        normals: vec![[0.0, 1.0, 0.0]; 4],
        faces: vec![[0, 1, 2], [0, 2, 3]],
        face_group: vec![0, 0],
        groups: vec![group],
        ..Mesh::default()
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
        if let Some(level) = slot.level.get() {
            return Ok(Arc::clone(level));
        }
        let _loading = account::waiting(|| slot.loading.lock()).unwrap_or_else(PoisonError::into_inner);
        if let Some(level) = slot.level.get() {
            return Ok(Arc::clone(level));
        }
        let load = || account::part(Part::Loading, || LoadedLevel::load(digest, artefacts));
        let level = Arc::new(on_all_threads(load)?);
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

#[cfg(test)]
mod tests {
    use super::{
        super::{Backends, trace},
        *,
    };
    use crate::{ArtefactError, TaskOutput};
    use bytes::Bytes;
    use kiln_core::{BakeSettings, FaceMoments, MIXED_LANE, TraceWork};
    use std::collections::BTreeMap;

    struct Memory(BTreeMap<Digest, Bytes>);

    impl Artefacts for Memory {
        fn get_many(&self, digests: &[Digest]) -> Result<Vec<Bytes>, ArtefactError> {
            let one = |digest: &Digest| self.0.get(digest).cloned().ok_or(ArtefactError::Missing { digest: *digest });
            digests.iter().map(one).collect()
        }

        fn store(&self, _: Vec<Bytes>) -> Result<Vec<Digest>, ArtefactError> {
            Ok(Vec::new())
        }
    }

    /// The courtyard, of which only the crates receive; as tasks load it, and whole. Rays end after 1 m.
    fn courtyard() -> [LoadedLevel; 2] {
        let file = kiln_scene::example::build("courtyard").unwrap();
        let settings = BakeSettings {
            half_distances_m: Some(vec![0.1]),
            only: Some("crate*".to_owned()),
            ..BakeSettings::default()
        };
        let files = BTreeMap::from([("level.glb".to_owned(), file)]);
        let import = kiln_scene::import("level.glb", &files, None, &settings).unwrap();
        let mut memory = BTreeMap::from([(Digest::default(), Bytes::from(codec::encode(&import.level)))]);
        memory.extend(import.meshes.into_iter().map(|mesh| (mesh.digest, Bytes::from(mesh.bytes))));
        let mesh = |entry: &kiln_core::MeshEntry| Arc::new(codec::decode("a mesh", &memory[&entry.digest]).unwrap());
        let meshes = import.level.meshes.iter().map(mesh).collect();
        let whole = LoadedLevel::new(Digest::default(), import.level, meshes).unwrap();
        [LoadedLevel::load(Digest::default(), &Memory(memory)).unwrap(), whole]
    }

    /// For each instance that receives, a task over all its faces.
    fn tasks(level: &Level) -> impl Iterator<Item = TraceWork> {
        let receivers = level.instances.iter().enumerate().filter(|(_, instance)| instance.receives);
        receivers.map(|(index, instance)| TraceWork {
            instance: index as u32,
            alone: false,
            first_face: 0,
            face_count: level.meshes[instance.mesh as usize].face_count,
            density_per_m2: 10.0,
        })
    }

    fn traced(task: &TraceWork, level: &LoadedLevel, backend: &Backend) -> Result<TaskOutput, TaskError> {
        trace::run(task, level, level.tracer(backend)?, backend.lane())
    }

    /// On a real device: before the loss on it, after it on the processor, with that one's bits.
    #[test]
    fn pieces_outlive_their_device() {
        let device = kiln_gpu::GpuDevice::open(&kiln_gpu::AdapterChoice::Software).unwrap();
        let device = device.expect("this test needs a software Vulkan driver, such as mesa-vulkan-drivers");
        let [level, fresh] = courtyard();
        let task = tasks(&level.level).next().unwrap();
        let run = |level: &LoadedLevel, backends: &Backends, lane: &str| {
            let output = backends.trace(lane, |backend| traced(&task, level, backend))?;
            Ok::<_, TaskError>(FaceMoments::from_bytes(&output.result).unwrap())
        };
        let lanes = |moments: &FaceMoments| moments.lanes.iter().cloned().collect::<Vec<_>>();
        let backends = Backends::mixed(Some(Arc::clone(&device)));
        assert_eq!(lanes(&run(&level, &backends, MIXED_LANE).unwrap()), [device.lane()]);
        device.destroy();
        let on_processor = run(&level, &Backends::from(Backend::Cpu), "cpu").unwrap();
        // Where the tracer was made before, and where it cannot be made any more.
        for level in [&level, &fresh] {
            let error = run(level, &Backends::mixed(Some(Arc::clone(&device))), &device.lane()).unwrap_err();
            assert!(matches!(error, TaskError::DeviceLost { .. }), "{error}");
            let backends = Backends::mixed(Some(Arc::clone(&device)));
            assert_eq!(run(level, &backends, MIXED_LANE).unwrap(), on_processor);
            assert_eq!(backends.lanes(), ["cpu"]);
        }
    }

    /// Fog counts as far as it is traced, which may be beyond the shrub's faces.
    #[test]
    fn rays_come_to_fog_where_it_is_traced() {
        let [part, whole] = courtyard();
        let out = (0..whole.level.instances.len()).find(|i| !part.is_traced(*i)).unwrap();
        let mut level = whole.level.clone();
        let bounds = level.meshes[level.instances[out].mesh as usize].bounds;
        let mut is_reached = |grown_m: f64| {
            let bounds = Bounds { min: bounds.min - grown_m, max: bounds.max + grown_m };
            level.instances[out].fog = Some(kiln_core::Fog { bounds, density_per_m: 0.5 });
            reach(&level).unwrap().is_reached()[out]
        };
        assert!(!is_reached(0.0) && is_reached(30.0));
    }

    #[test]
    fn what_is_not_loaded_changes_nothing() {
        let [part, whole] = courtyard();
        let left_out: Vec<usize> = (0..whole.level.instances.len()).filter(|i| !part.is_traced(*i)).collect();
        assert!(left_out.len() > 10 && left_out.iter().all(|i| !part.level.instances[*i].receives));
        assert!(part.meshes.iter().any(|mesh| mesh.faces.is_empty()));
        let size = |level: &LoadedLevel| level.tracer(&Backend::Cpu).unwrap().0.memory_bytes();
        assert!(size(&part) < size(&whole));
        let mut rays = 0;
        for task in tasks(&whole.level) {
            let [part, whole] = [&part, &whole].map(|level| traced(&task, level, &Backend::Cpu).unwrap());
            assert_eq!(part.result, whole.result);
            rays += part.rays;
        }
        assert!(rays > 0);
    }
}
