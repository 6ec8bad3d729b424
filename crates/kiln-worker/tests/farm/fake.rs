//! An executor that bakes nothing, but obeys every rule: pure, deterministic, with results of the right size. The
//! "level" is a line of text: `instances pieces salt`, with ` twins` if all instances are the same, or `refuse WHY`.

use kiln_core::{
    BakeSummary, Baked, Bounds, Digest, DigestBuilder, ExportSpec, FaceMoments, HalfMoments, Kernel, Lane, Level,
    LevelCounts, MIXED_LANE, Mesh, MeshEntry, Output, PlanSpec, PlannedTask, Sampling, Solution, SolveSettings,
    SolveSummary, SolveWork, SourceManifest, TaskGraph, TaskKind, TaskSpec, TraceSummary, TraceWork, Warning, Work,
    codec,
};
use kiln_worker::{Artefacts, CancelFlag, Executor, Lanes, TaskError, TaskOutput};
use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

/// Vertices of the one mesh.
const VERTICES: u32 = 3;

/// What a test sees of the executors, and does to them.
#[derive(Default)]
pub(crate) struct Control {
    ran: Mutex<BTreeMap<TaskKind, Vec<TaskSpec>>>,
    /// Trace tasks that may still run; the others wait.
    allowed: AtomicUsize,
    gated: AtomicBool,
    /// Trace tasks that wait.
    pub(crate) waiting: AtomicUsize,
    /// Tasks that were told to stop while they waited.
    pub(crate) cancelled: AtomicUsize,
    /// The kind that fails, and how.
    pub(crate) fault: Mutex<Option<(TaskKind, Fault)>>,
}

/// How a task fails.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Fault {
    Fails,
    Panics,
    /// Gives a result that makes no sense.
    Lies,
    LosesDevice,
}

impl Control {
    /// Lets only so many trace tasks run, until [`Self::open`].
    pub(crate) fn gate(&self, allowed: usize) {
        self.allowed.store(allowed, Ordering::SeqCst);
        self.gated.store(true, Ordering::SeqCst);
    }

    pub(crate) fn open(&self) {
        self.gated.store(false, Ordering::SeqCst);
    }

    /// How often a kind was run to a result.
    pub(crate) fn runs(&self, kind: TaskKind) -> usize {
        self.ran.lock().unwrap().get(&kind).map_or(0, Vec::len)
    }

    /// Waits until something holds.
    pub(crate) async fn until(&self, what: &str, holds: impl Fn(&Self) -> bool) {
        let start = Instant::now();
        while !holds(self) {
            assert!(start.elapsed() < Duration::from_secs(10), "{what} does not come");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    fn pass(&self, cancel: &CancelFlag) -> Result<(), TaskError> {
        let take = |allowed: usize| allowed.checked_sub(1);
        let is_in = || self.allowed.fetch_update(Ordering::SeqCst, Ordering::SeqCst, take).is_ok();
        if !self.gated.load(Ordering::SeqCst) || is_in() {
            return Ok(());
        }
        self.waiting.fetch_add(1, Ordering::SeqCst);
        let start = Instant::now();
        while self.gated.load(Ordering::SeqCst) && start.elapsed() < Duration::from_secs(10) {
            if cancel.is_cancelled() {
                self.cancelled.fetch_add(1, Ordering::SeqCst);
                return Err(TaskError::Cancelled);
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        Ok(())
    }
}

/// Executes tasks under a test's control.
pub(crate) struct Fake {
    pub(crate) control: Arc<Control>,
    pub(crate) trace_lanes: Vec<String>,
}

impl Executor for Fake {
    fn lanes(&self) -> Lanes {
        Lanes { trace: self.trace_lanes.clone(), solve: "any".into() }
    }

    fn run(
        &self,
        spec: &TaskSpec,
        lane: &str,
        artefacts: &dyn Artefacts,
        cancel: &CancelFlag,
        progress: &dyn Fn(u64),
    ) -> Result<TaskOutput, TaskError> {
        if spec.kind() == TaskKind::Trace {
            assert!(lane == MIXED_LANE || self.trace_lanes.iter().any(|own| own == lane), "{lane}");
            self.control.pass(cancel)?;
        }
        let fault = self.control.fault.lock().unwrap().filter(|(kind, _)| *kind == spec.kind()).map(|(_, how)| how);
        match fault {
            Some(Fault::Fails) => return Err(TaskError::Failed { reason: "the moon is full".into() }),
            Some(Fault::Panics) => panic!("the moon is full"),
            Some(Fault::LosesDevice) => return Err(TaskError::DeviceLost { reason: "the card fell out".into() }),
            Some(Fault::Lies) | None => {}
        }
        let mut output = match spec {
            TaskSpec::Import { source } => import(*source, artefacts)?,
            TaskSpec::Plan(spec) => plan(spec, artefacts)?,
            TaskSpec::Work(task) => match &task.work {
                Work::Trace(piece) => trace(task.level, piece, artefacts)?,
                Work::Solve(_) => solve(&task.inputs, artefacts)?,
                other => panic!("the plan has no {other:?}"),
            },
            TaskSpec::Export(spec) => export(spec, artefacts)?,
        };
        progress(output.rays);
        if fault == Some(Fault::Lies) {
            output.result.pop();
        }
        self.control.ran.lock().unwrap().entry(spec.kind()).or_default().push(spec.clone());
        Ok(output)
    }
}

fn import(source: Digest, artefacts: &dyn Artefacts) -> Result<TaskOutput, TaskError> {
    let source: SourceManifest = codec::decode("a source", &artefacts.get(source)?).unwrap();
    let text = artefacts.get(source.files[0].digest)?;
    let text = std::str::from_utf8(&text).unwrap();
    if let Some(why) = text.strip_prefix("refuse ") {
        return Err(TaskError::Refused { reason: format!("{}: {why}; mend the file", source.files[0].path) });
    }
    let mesh = codec::encode(&Mesh { positions: vec![[0.0; 3]; VERTICES as usize], ..Mesh::default() });
    let entry = MeshEntry {
        digest: Digest::of(&mesh),
        // The plan reads the level's text from here.
        name: text.to_owned(),
        vertex_count: VERTICES,
        face_count: 1,
        duplicate_faces: 0,
        bounds: Bounds::EMPTY,
        center: glam::DVec3::ZERO,
        source_mesh: 0,
        blocks: Vec::new(),
    };
    let level = Level {
        origin_m: Default::default(),
        bounds: Bounds::EMPTY,
        meshes: vec![entry],
        instances: Vec::new(),
        regions: kiln_core::Regions::default(),
        sampling: sampling(source.settings.seed),
        solve: SolveSettings::default(),
        output: source.settings.output,
        warnings: vec![warning()],
        counts: LevelCounts::default(),
    };
    Ok(TaskOutput { result: codec::encode(&level), attachments: vec![mesh], rays: 0 })
}

fn warning() -> Warning {
    Warning { code: "fake".into(), subject: "level".into(), message: "this is no bake".into(), count: 1 }
}

fn sampling(seed: u64) -> Sampling {
    Sampling {
        target: None,
        kernel: Kernel::Obscurance { half_distances_m: vec![1.0, 2.0] },
        rays_per_sample: 32,
        mean_samples_per_face: 2.0,
        density_per_m2: None,
        min_samples_per_face: 2,
        max_samples_per_face: 2,
        back_face_limit: 0.25,
        seed,
        foliage: kiln_core::FoliageMode::default(),
        ground_plane_y_m: None,
        no_skip: std::collections::BTreeSet::new(),
    }
}

fn level(digest: Digest, artefacts: &dyn Artefacts) -> Result<Level, TaskError> {
    Ok(codec::decode("a level", &artefacts.get(digest)?)?)
}

fn family(kind: &str, salt: &str, lane: &Lane, index: usize) -> Digest {
    let index = index as u64;
    DigestBuilder::new(kind).text(salt).text(&lane.trace).text(&lane.solve).integer(index).finish()
}

fn plan(spec: &PlanSpec, artefacts: &dyn Artefacts) -> Result<TaskOutput, TaskError> {
    let level = level(spec.level, artefacts)?;
    let words: Vec<&str> = level.meshes[0].name.split(' ').collect();
    let (instances, pieces): (u32, u32) = (words[0].parse().unwrap(), words[1].parse().unwrap());
    let are_twins = words.get(3) == Some(&"twins");
    let mut graph = TaskGraph::new(spec.level, &level);
    graph.surroundings.push(Digest::of(words[2].as_bytes()));
    for instance in 0..instances {
        let first = graph.tasks.len() as u32;
        for first_face in 0..pieces {
            let index = if are_twins { first_face as usize } else { graph.tasks.len() };
            let family = family("trace", words[2], &spec.lane, index);
            // Results follow from the bake's lane, as those of a real tracer do.
            let density_per_m2 = f64::from(u32::from_le_bytes([family.0[0], family.0[1], family.0[2], family.0[3]]));
            let piece = TraceWork { instance, first_face, face_count: 1, density_per_m2, alone: false };
            let task = PlannedTask::new(Work::Trace(piece), family, 100);
            graph.add(PlannedTask { surroundings: Some(0), ..task }, []);
        }
        let family = family("solve", words[2], &spec.lane, if are_twins { 0 } else { instance as usize });
        let solve = Work::Solve(SolveWork { instance, vertex_count: VERTICES, alone: false });
        let output = Some(Output::Solution { instance });
        graph
            .add(PlannedTask { output, ..PlannedTask::new(solve, family, u64::from(VERTICES)) }, first..first + pieces);
    }
    Ok(TaskOutput { result: codec::encode(&graph), ..TaskOutput::default() })
}

fn trace(digest: Digest, piece: &TraceWork, artefacts: &dyn Artefacts) -> Result<TaskOutput, TaskError> {
    let level = level(digest, artefacts)?;
    artefacts.get(level.meshes[0].digest)?;
    let mut key = DigestBuilder::new("piece");
    key.float(piece.density_per_m2);
    let value = f64::from(key.finish().0[0]) / 255.0;
    let mut half = HalfMoments::default();
    half.add([0.25, 0.25, 0.5], &[value, value]);
    let mut moments = FaceMoments::new(2);
    moments.push(&[half, half]);
    moments.summary = TraceSummary { rays: 64, ..TraceSummary::default() };
    Ok(TaskOutput { result: moments.to_bytes(), attachments: Vec::new(), rays: 64 })
}

fn solve(moments: &[Digest], artefacts: &dyn Artefacts) -> Result<TaskOutput, TaskError> {
    let mut sum = 0.0;
    for bytes in artefacts.get_many(moments)? {
        sum += FaceMoments::from_bytes(&bytes).unwrap().face(0)[0].f_squared[0] as f32;
    }
    let value = sum / moments.len().max(1) as f32;
    let values = vec![value; 2 * VERTICES as usize];
    let residuals = vec![0.0; values.len()];
    let solution = Solution { channels: 2, values, residuals, unsampled: false, summary: SolveSummary::default() };
    Ok(TaskOutput { result: codec::encode(&solution), ..TaskOutput::default() })
}

fn export(spec: &ExportSpec, artefacts: &dyn Artefacts) -> Result<TaskOutput, TaskError> {
    let level = level(spec.level, artefacts)?;
    let list: Vec<(Output, Digest)> = codec::decode("a list of outputs", &artefacts.get(spec.outputs)?)?;
    let mut file = b"baked:".to_vec();
    for (output, solution) in list {
        let Output::Solution { instance } = output else { panic!("the plan has no {output:?}") };
        let solution: Solution = codec::decode("a solution", &artefacts.get(solution)?)?;
        file.extend(instance.to_le_bytes());
        solution.values.iter().for_each(|value| file.extend(value.to_le_bytes()));
    }
    let summary = BakeSummary {
        level: spec.level,
        counts: level.counts,
        sampling: level.sampling,
        trace: TraceSummary::default(),
        trace_lanes: Default::default(),
        beyond_reach: kiln_core::BeyondReach::default(),
        error: Vec::new(),
        meshes: Vec::new(),
        foliage: kiln_core::FoliageSummary::default(),
        lods: kiln_core::LodSummary::default(),
        regions: None,
        warnings: level.warnings,
    };
    let baked = Baked { file: Digest::of(&file), bytes: file.len() as u64, pack: None, summary };
    Ok(TaskOutput { result: codec::encode(&baked), attachments: vec![file], rays: 0 })
}
