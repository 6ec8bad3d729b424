//! A bake in this process: all tasks by the executor that workers have, over artefacts in memory.

use crate::{geometry::HALF_DISTANCES_M, level::Level};
use bytes::Bytes;
use kiln_core::{
    BakeSettings, BakeSummary, Baked, Digest, ExportSpec, Lane, Output, PlanSpec, Quality, SourceFile, SourceManifest,
    TaskGraph, TaskSpec, WorkSpec, codec,
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
    let outputs = run.memory.add(codec::encode(&run.outputs(level)?));
    let (_, baked) = run.task(&TaskSpec::Export(ExportSpec { source, level, outputs }))?;
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

    /// Plans and does all tasks of the graph, in its order: its outputs.
    fn outputs(&self, level: Digest) -> Result<Vec<(Output, Digest)>, TaskError> {
        let lanes = self.executor.lanes();
        let lane = Lane { trace: lanes.trace.concat(), solve: lanes.solve };
        let (_, graph) = self.task(&TaskSpec::Plan(PlanSpec { level, lane }))?;
        let graph: TaskGraph = codec::decode("a plan", &graph)?;
        let (mut results, mut outputs) = (Vec::<Digest>::new(), Vec::new());
        for (index, task) in (0..).zip(&graph.tasks) {
            let inputs = graph.inputs_of(index).iter().map(|input| results[*input as usize]).collect();
            let (result, _) = self.task(&TaskSpec::Work(WorkSpec { level, work: task.work.clone(), inputs }))?;
            outputs.extend(task.output.map(|output| (output, result)));
            results.push(result);
        }
        Ok(outputs)
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
