//! A bake in this process: all tasks by the executor that workers have, over artefacts in memory.

use crate::{geometry::HALF_DISTANCES_M, level::Level};
use bytes::Bytes;
use kiln_core::{
    BakeSettings, BakeSummary, Baked, Digest, ExportSpec, Lane, PlanSpec, Quality, SourceFile, SourceManifest,
    TaskGraph, TaskSpec, codec,
};
use kiln_scene::{BakedScene, read_baked};
use kiln_worker::{
    ArtefactError, Artefacts, CancelFlag, Executor, TaskError,
    tasks::{Backend, BakeExecutor},
};
use std::{
    collections::BTreeMap,
    sync::{Mutex, PoisonError},
};

/// A baked level, as the file says and as the report says.
pub(crate) struct Outcome {
    pub(crate) scene: BakedScene,
    pub(crate) summary: BakeSummary,
}

impl Outcome {
    /// How often import or export warned of something.
    pub(crate) fn warned(&self, code: &str) -> u64 {
        self.summary.warnings.iter().filter(|warning| warning.code == code).map(|warning| warning.count).sum()
    }
}

/// As `kiln bake` samples by default, at the half-distances of the room times `scale`.
pub(crate) fn adaptive(quality: Quality, scale: f64) -> BakeSettings {
    let half_distances_m = Some(HALF_DISTANCES_M.map(|d| d * scale).to_vec());
    BakeSettings { quality, half_distances_m, ..BakeSettings::default() }
}

/// The same number of samples on every face, so that no face's depends on any other.
pub(crate) fn fixed(samples: u32) -> BakeSettings {
    let settings = adaptive(Quality::Medium, 1.0);
    BakeSettings { density_per_m2: Some(1e30), max_samples_per_face: Some(samples), ..settings }
}

/// Bakes a level that must bake.
pub(crate) fn bake(level: &Level, settings: &BakeSettings) -> Outcome {
    try_bake(level, settings).unwrap_or_else(|error| panic!("the level does not bake: {error}"))
}

/// Bakes a level.
pub(crate) fn try_bake(level: &Level, settings: &BakeSettings) -> Result<Outcome, TaskError> {
    let memory = Memory::default();
    let manifest = SourceManifest {
        files: vec![SourceFile { path: "level.glb".to_owned(), digest: memory.add(level.glb()) }],
        sidecar: None,
        settings: settings.clone(),
    };
    let source = memory.add(codec::encode(&manifest));
    let run = Run { memory, executor: BakeExecutor::new(Backend::Cpu.into()) };
    let (level, _) = run.task(&TaskSpec::Import { source })?;
    let solutions = run.solutions(level)?;
    let solutions = run.memory.add(codec::encode(&solutions));
    let (_, baked) = run.task(&TaskSpec::Export(ExportSpec { source, level, solutions }))?;
    let baked: Baked = codec::decode("a baked level", &baked)?;
    let files = BTreeMap::from([("baked.glb".to_owned(), run.memory.get(baked.file)?.to_vec())]);
    let refused = |error: kiln_scene::SceneError| TaskError::Refused { reason: error.to_string() };
    Ok(Outcome { scene: read_baked("baked.glb", &files).map_err(refused)?, summary: baked.summary })
}

struct Run {
    memory: Memory,
    executor: BakeExecutor,
}

impl Run {
    /// Runs a task and keeps what it gives.
    fn task(&self, spec: &TaskSpec) -> Result<(Digest, Vec<u8>), TaskError> {
        let output = self.executor.run(spec, "cpu", &self.memory, &CancelFlag::default(), &|_| {})?;
        output.attachments.into_iter().for_each(|bytes| {
            self.memory.add(bytes);
        });
        Ok((self.memory.add(output.result.clone()), output.result))
    }

    /// Plans, traces and solves: each receiving instance and its solution.
    fn solutions(&self, level: Digest) -> Result<Vec<(u32, Digest)>, TaskError> {
        let lanes = self.executor.lanes();
        let lane = Lane { trace: lanes.trace.concat(), solve: lanes.solve };
        let (_, graph) = self.task(&TaskSpec::Plan(PlanSpec { level, lane }))?;
        let graph: TaskGraph = codec::decode("a plan", &graph)?;
        let mut solutions = Vec::new();
        for solve in &graph.solve {
            let pieces = &graph.trace[solve.first_trace as usize..][..solve.trace_count as usize];
            let trace = |task: &kiln_core::TraceTask| self.task(&TaskSpec::Trace { level, task: task.clone() });
            let moments = pieces.iter().map(|task| Ok(trace(task)?.0)).collect::<Result<_, TaskError>>()?;
            let spec = TaskSpec::Solve { level, instance: solve.instance, moments };
            solutions.push((solve.instance, self.task(&spec)?.0));
        }
        Ok(solutions)
    }
}

#[derive(Default)]
struct Memory(Mutex<BTreeMap<Digest, Bytes>>);

impl Memory {
    fn add(&self, bytes: Vec<u8>) -> Digest {
        let digest = Digest::of(&bytes);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(digest, bytes.into());
        digest
    }
}

impl Artefacts for Memory {
    fn get_many(&self, digests: &[Digest]) -> Result<Vec<Bytes>, ArtefactError> {
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let one = |digest: &Digest| known.get(digest).cloned().ok_or(ArtefactError::Missing { digest: *digest });
        digests.iter().map(one).collect()
    }

    fn store(&self, artefacts: Vec<Bytes>) -> Result<Vec<Digest>, ArtefactError> {
        Ok(artefacts.into_iter().map(|bytes| self.add(bytes.to_vec())).collect())
    }
}
