//! A scene to measure on: the level as import makes it, its tracer, and the part of it that receives.

use super::settings::{GOALS, Goal};
use crate::BenchError;
use glam::DAffine3;
use kiln_core::{BakeSettings, Digest, Kernel, Mesh, Quality, Sampling, SolveSettings, codec};
use kiln_scene::{LevelFiles, ReadError};
use kiln_trace::{Scene, Tracer};
use kiln_worker::tasks::{Backend, LoadedLevel};
use std::{collections::BTreeMap, path::Path, sync::Arc};

/// A part of an instance that is baked: all of its faces, or some whole pieces of them.
pub(super) struct Receiver {
    /// Index of the instance in the level.
    pub(super) instance: u32,
    /// The faces that are baked, and their vertices.
    pub(super) mesh: Arc<Mesh>,
    /// The instance's face that each face of the mesh is.
    pub(super) faces: Vec<u32>,
    /// The instance's transform, relative to the level's origin.
    pub(super) world_from_object: DAffine3,
}

impl Receiver {
    /// The same faces, without the caps that classes set on the samples of a face.
    pub(super) fn without_caps(&self) -> Self {
        let mut mesh = Mesh::clone(&self.mesh);
        mesh.groups.iter_mut().for_each(|group| group.max_samples_per_face = None);
        Self { mesh: Arc::new(mesh), faces: self.faces.clone(), ..*self }
    }
}

/// A level ready to be baked again and again. All of it occludes.
pub(super) struct BenchScene {
    pub(super) name: String,
    pub(super) level: LoadedLevel,
    pub(super) receivers: Vec<Receiver>,
    /// Faces that receive in the whole level.
    pub(super) face_count: u64,
    /// What each of [`GOALS`] comes to in this level.
    samplings: Vec<Sampling>,
    scene: Arc<Scene>,
    tracer: Arc<dyn Tracer>,
}

impl BenchScene {
    /// Reads and imports a level, and picks pieces with about `most_faces` faces to be baked.
    pub(super) fn load(
        path: &Path,
        half_distances_m: Option<&[f64]>,
        most_faces: Option<u64>,
    ) -> Result<Self, BenchError> {
        let files = LevelFiles::read(path, None).map_err(|error| match error {
            ReadError::Level(source) => BenchError::Import { path: path.to_path_buf(), source },
            other => BenchError::File { path: path.to_path_buf(), reason: other.to_string() },
        })?;
        let name = path.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        Self::import(&name, &files, half_distances_m, most_faces)
            .map_err(|source| BenchError::Import { path: path.to_path_buf(), source })?
    }

    /// Imports a level whose files are in memory. The outer error is the import's.
    pub(super) fn import(
        name: &str,
        files: &LevelFiles,
        half_distances_m: Option<&[f64]>,
        most_faces: Option<u64>,
    ) -> Result<Result<Self, BenchError>, kiln_scene::SceneError> {
        let import = |goal: &Goal| {
            let (quality, target_rmse) = match goal {
                Goal::Quality(quality) => (*quality, None),
                Goal::Target(rmse) => (Quality::Medium, Some(*rmse)),
            };
            let half_distances_m = half_distances_m.map(<[f64]>::to_vec);
            let settings = BakeSettings { quality, target_rmse, half_distances_m, ..Default::default() };
            kiln_scene::import(&files.name, files, files.sidecar(), &settings)
        };
        let imported = import(&Goal::Quality(Quality::Medium))?;
        let sampling = |goal: &Goal| import(goal).map(|import| import.level.sampling);
        let samplings = GOALS.iter().map(sampling).collect::<Result<_, _>>()?;
        Ok(Self::assemble(name, imported, samplings, most_faces))
    }

    fn assemble(
        name: &str,
        import: kiln_scene::Import,
        samplings: Vec<Sampling>,
        most_faces: Option<u64>,
    ) -> Result<Self, BenchError> {
        let failed = |step: &'static str| move |reason: String| BenchError::Failed { step, reason };
        let decode = |blob: &kiln_scene::MeshBlob| -> Result<(Digest, Arc<Mesh>), codec::DecodeError> {
            Ok((blob.digest, Arc::new(codec::decode("a mesh", &blob.bytes)?)))
        };
        let meshes: BTreeMap<Digest, Arc<Mesh>> =
            import.meshes.iter().map(decode).collect::<Result<_, _>>().map_err(|e| failed("import")(e.to_string()))?;
        let meshes = import.level.meshes.iter().filter_map(|mesh| meshes.get(&mesh.digest).cloned()).collect();
        let level = LoadedLevel::new(Digest::default(), import.level, meshes)
            .map_err(|error| failed("import")(error.to_string()))?;
        let (scene, tracer) =
            level.tracer(&Backend::Cpu).map_err(|error| failed("building BVHs")(error.to_string()))?;
        let (scene, tracer) = (Arc::clone(scene), Arc::clone(tracer));
        let (receivers, face_count) = receivers(&level, most_faces);
        if receivers.is_empty() {
            return Err(BenchError::Usage(format!("{name} has no face that receives; choose another scene")));
        }
        Ok(Self { name: name.to_owned(), level, receivers, face_count, samplings, scene, tracer })
    }

    /// What traces.
    pub(super) fn tracer(&self) -> &dyn Tracer {
        &*self.tracer
    }

    /// What is traced.
    pub(super) fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The value of a ray.
    pub(super) fn kernel(&self) -> &Kernel {
        &self.level.level.sampling.kernel
    }

    /// The half-distances, metres.
    pub(super) fn half_distances_m(&self) -> &[f64] {
        match self.kernel() {
            Kernel::Obscurance { half_distances_m } => half_distances_m,
            Kernel::Occlusion { .. } => &[],
        }
    }

    /// Number of channels.
    pub(super) fn channels(&self) -> usize {
        self.kernel().channel_count()
    }

    /// How `kiln bake` samples this level to reach a goal of [`GOALS`]; by default for any other.
    pub(super) fn sampling(&self, goal: &Goal) -> &Sampling {
        let at = GOALS.iter().position(|known| known == goal);
        at.and_then(|at| self.samplings.get(at)).unwrap_or(&self.level.level.sampling)
    }

    /// How `kiln bake` solves.
    pub(super) fn solve_settings(&self) -> &SolveSettings {
        &self.level.level.solve
    }

    /// Faces that are baked.
    pub(super) fn baked_faces(&self) -> u64 {
        self.receivers.iter().map(|receiver| receiver.faces.len() as u64).sum()
    }
}

/// The receiving instances, cut down to whole pieces that together have about `most_faces` faces, evenly spread over
/// the level; and how many faces there are in all.
fn receivers(level: &LoadedLevel, most_faces: Option<u64>) -> (Vec<Receiver>, u64) {
    let mut chosen = Vec::new();
    let instances = || level.level.instances.iter().zip(0u32..).filter(|(instance, _)| instance.receives);
    let faces = |instance: &kiln_core::Instance| level.meshes[instance.mesh as usize].faces.len() as u64;
    let total: u64 = instances().map(|(instance, _)| faces(instance)).sum();
    let fraction = most_faces.map_or(1.0, |most| most as f64 / total as f64);
    let mut piece_count = 0u64;
    for (instance, index) in instances() {
        let mesh = &level.meshes[instance.mesh as usize];
        let mut keep = Vec::new();
        for piece in kiln_plan::pieces(mesh.faces.len() as u32) {
            if is_kept(piece_count, fraction) {
                keep.extend(piece);
            }
            piece_count += 1;
        }
        if !keep.is_empty() {
            let mesh = if keep.len() == mesh.faces.len() { Arc::clone(mesh) } else { Arc::new(cut(mesh, &keep)) };
            let world_from_object = instance.world_from_object;
            chosen.push(Receiver { instance: index, mesh, faces: keep, world_from_object });
        }
    }
    (chosen, total)
}

/// Whether a piece is among a fraction of all: multiples of the golden ratio are spread evenly and follow no period
/// that a level's instances might have. The first piece always is.
fn is_kept(piece: u64, fraction: f64) -> bool {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    (piece as f64 * GOLDEN).fract() < fraction
}

/// Some faces of a mesh, in order, with the vertices they use.
fn cut(mesh: &Mesh, faces: &[u32]) -> Mesh {
    let mut index = BTreeMap::new();
    faces.iter().flat_map(|face| mesh.faces[*face as usize]).for_each(|v| {
        index.insert(v, 0u32);
    });
    index.values_mut().zip(0..).for_each(|(slot, i)| *slot = i);
    let of = |v: u32| index.get(&v).copied().unwrap_or_default();
    Mesh {
        positions: index.keys().map(|v| mesh.positions[*v as usize]).collect(),
        normals: index.keys().map(|v| mesh.normals[*v as usize]).collect(),
        faces: faces.iter().map(|face| mesh.faces[*face as usize].map(of)).collect(),
        face_group: faces.iter().map(|face| mesh.face_group[*face as usize]).collect(),
        groups: mesh.groups.clone(),
        ..Mesh::default()
    }
}
