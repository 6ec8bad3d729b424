//! The path of a job from submission to result, without store or workers.

use super::*;
use kiln_core::{BakeSummary, Baked, Kernel, LevelCounts, Sampling, SolveWork, TraceSummary, TraceWork, Work};

/// A graph without tasks.
pub(crate) fn empty() -> TaskGraph {
    TaskGraph {
        level: Digest::of(b"level"),
        surroundings: vec![Digest::of(b"surroundings")],
        tasks: Vec::new(),
        inputs: Vec::new(),
        sampling: sampling(),
        counts: LevelCounts::default(),
        warnings: Vec::new(),
    }
}

/// A piece that costs 64 rays.
pub(crate) fn piece(instance: u32, first_face: u32) -> PlannedTask {
    let family = Digest::of(format!("piece {instance} {first_face}").as_bytes());
    let work = TraceWork { instance, first_face, face_count: 1, density_per_m2: 1.0, alone: false };
    PlannedTask { surroundings: Some(0), ..PlannedTask::new(Work::Trace(work), family, 64) }
}

/// The solve of a triangle: an output.
pub(crate) fn solve(instance: u32) -> PlannedTask {
    let work = Work::Solve(SolveWork { instance, vertex_count: 3, alone: false });
    let output = Some(Output::Solution { instance });
    PlannedTask { output, ..PlannedTask::new(work, Digest::of(&instance.to_le_bytes()), 3) }
}

/// A graph with one instance for each number of pieces: its pieces, and then its solve.
pub(crate) fn graph(pieces: &[u32]) -> TaskGraph {
    let mut graph = empty();
    for (instance, &count) in (0..).zip(pieces) {
        let first = graph.tasks.len() as u32;
        for first_face in 0..count {
            graph.add(piece(instance, first_face), []);
        }
        graph.add(solve(instance), first..first + count);
    }
    graph
}

fn trace_at(index: u32) -> Node {
    Node::Work { kind: TaskKind::Trace, index }
}

fn solve_at(index: u32) -> Node {
    Node::Work { kind: TaskKind::Solve, index }
}

fn sampling() -> Sampling {
    Sampling {
        target: None,
        kernel: Kernel::Occlusion { ray_distance_m: 1.0 },
        rays_per_sample: 32,
        mean_samples_per_face: 2.0,
        density_per_m2: None,
        min_samples_per_face: 2,
        max_samples_per_face: 2,
        back_face_limit: 0.25,
        seed: 0,
        foliage: kiln_core::FoliageMode::default(),
        ground_plane_y_m: None,
        no_skip: std::collections::BTreeSet::new(),
    }
}

fn job() -> Job {
    let order = Order {
        id: JobId(1),
        request_id: "r".into(),
        payload: Digest::of(b"payload"),
        source: Digest::of(b"source"),
        backend: v1::Backend::Auto,
        priority: 0,
        name: "level".into(),
        tenant: String::new(),
        submitted_unix_ms: 5,
        skips_unchanged: true,
    };
    Job::new(order, EventLog::new(0, 16))
}

fn lane() -> Lane {
    Lane { trace: "cpu".into(), solve: "any".into() }
}

pub(crate) fn baked() -> Baked {
    let summary = BakeSummary {
        level: Digest::of(b"level"),
        counts: LevelCounts::default(),
        sampling: sampling(),
        trace: TraceSummary::default(),
        trace_lanes: Default::default(),
        beyond_reach: kiln_core::BeyondReach::default(),
        error: Vec::new(),
        meshes: Vec::new(),
        foliage: kiln_core::FoliageSummary::default(),
        lods: kiln_core::LodSummary::default(),
        regions: None,
        warnings: Vec::new(),
    };
    Baked { file: Digest::of(b"glb"), bytes: 3, pack: None, summary }
}

#[test]
fn the_whole_path() {
    let mut job = job();
    assert_eq!(job.phase.shown(), v1::BakeState::Submitted);
    assert!(job.task(Node::Import).is_none(), "no lane yet");
    let step = job.start(lane());
    assert_eq!(step, Step::LookUpAnswer(answer_key(Digest::of(b"source"), &lane())));
    assert_eq!(job.no_answer(), [Step::LookUp(vec![Node::Import])]);
    assert_eq!(job.no_answer(), [], "only once");
    assert!(job.task(Node::Plan).is_none(), "not yet");
    assert_eq!(job.task(Node::Import).unwrap().needs.lane, None);
    assert_eq!(job.done(Node::Import, Digest::of(b"level")), [Step::LookUp(vec![Node::Plan])]);
    assert_eq!(job.done(Node::Plan, Digest::of(b"graph")), [Step::ReadGraph(Digest::of(b"graph"))]);
    assert_eq!(job.phase.shown(), v1::BakeState::Planning);
    // Tasks 0 and 2 are pieces, 1 and 3 their solves.
    let steps = job.planned(graph(&[1, 1])).unwrap();
    assert_eq!(steps, [Step::LookUp(vec![trace_at(0), trace_at(2)])]);
    let stages: Vec<_> = job.progress.stages().iter().map(|s| (s.kind(), s.total, s.rays_total)).collect();
    assert_eq!(stages, [(v1::TaskKind::Trace, 2, 128), (v1::TaskKind::Solve, 2, 0)]);
    assert_eq!((job.rays(trace_at(0)), job.cost(trace_at(0))), (64, Some(64)));
    assert_eq!((job.rays(solve_at(1)), job.cost(solve_at(1))), (0, Some(3)));
    assert_eq!(job.task(trace_at(0)).unwrap().needs.lane.as_deref(), Some("cpu"));
    assert!(job.task(solve_at(1)).is_none(), "its moments are not there");
    assert_eq!(job.done(trace_at(0), Digest::of(b"m0")), [Step::LookUp(vec![solve_at(1)])]);
    let task = job.task(solve_at(1)).unwrap();
    assert_eq!(task.expect, Expect::Work { work: solve(0).work, channels: 1 });
    let inputs = vec![Digest::of(b"m0")];
    assert_eq!(task.spec, TaskSpec::Work(WorkSpec { level: Digest::of(b"level"), work: solve(0).work, inputs }));
    assert_eq!(job.done(solve_at(1), Digest::of(b"s0")), []);
    assert_eq!(job.done(trace_at(2), Digest::of(b"m1")), [Step::LookUp(vec![solve_at(3)])]);
    let output = |instance, result: &[u8]| (Output::Solution { instance }, Digest::of(result));
    let outputs = vec![output(0, b"s0"), output(1, b"s1")];
    assert_eq!(job.done(solve_at(3), Digest::of(b"s1")), [Step::StoreOutputs(outputs)]);
    assert_eq!(job.done(solve_at(3), Digest::of(b"s1")), [], "only once");
    assert_eq!(job.listed(Digest::of(b"list")), [Step::LookUp(vec![Node::Export])]);
    assert_eq!(job.done(Node::Export, Digest::of(b"baked")), [Step::ReadBaked(Digest::of(b"baked"))]);
    job.succeed(Success { digest: Digest::of(b"baked"), baked: baked(), from_store: false });
    assert!(job.is_over());
    assert_eq!(job.phase.shown(), v1::BakeState::Exporting, "shown as before until it is durable");
}

#[test]
fn pieces_of_a_mixed_job_run_anywhere_under_keys_of_their_own() {
    let mixed = Lane { trace: kiln_core::MIXED_LANE.to_owned(), ..lane() };
    assert_ne!(answer_key(Digest::of(b"source"), &mixed), answer_key(Digest::of(b"source"), &lane()));
    let mut job = job();
    job.start(mixed.clone());
    job.no_answer();
    job.done(Node::Import, Digest::of(b"level"));
    let TaskSpec::Plan(plan) = job.task(Node::Plan).unwrap().spec else { panic!("a plan task is no plan") };
    assert_eq!(plan.lane, mixed, "the plan makes the keys");
    job.done(Node::Plan, Digest::of(b"graph"));
    job.planned(graph(&[1])).unwrap();
    assert_eq!(job.task(trace_at(0)).unwrap().needs.lane, None);
    job.done(trace_at(0), Digest::of(b"m0"));
    assert_eq!(job.task(solve_at(1)).unwrap().needs.lane, Some(lane().solve));
}

#[test]
fn the_first_outcome_counts() {
    let mut job = job();
    assert!(job.end(Outcome::Cancelled));
    assert!(!job.end(Outcome::Failed(v1::BakeFailure::default())));
    assert_eq!(job.done(Node::Import, Digest::default()), []);
    assert!(matches!(&job.phase, Phase::Ending(ending) if matches!(ending.outcome, Outcome::Cancelled)));
}

#[test]
fn a_level_without_receivers_is_exported_at_once() {
    let mut job = job();
    job.start(lane());
    job.no_answer();
    job.done(Node::Import, Digest::of(b"level"));
    assert_eq!(job.planned(graph(&[])).unwrap(), [Step::StoreOutputs(vec![])]);
}

#[test]
fn a_graph_that_makes_no_sense_is_refused() {
    let mut job = job();
    job.start(lane());
    job.no_answer();
    job.done(Node::Import, Digest::of(b"level"));
    let mut wrong = graph(&[1]);
    wrong.inputs[0] = 1;
    let problem = kiln_core::GraphProblem::NotEarlier { task: 1, input: 1 };
    assert_eq!(job.planned(wrong), Err(GraphError { level: Digest::of(b"level"), problem }));
    assert!(matches!(job.phase, Phase::Planning(_)));
}

#[test]
fn a_restart_begins_the_graph_anew() {
    let mut job = job();
    let planned = |job: &mut Job| {
        job.no_answer();
        job.done(Node::Import, Digest::of(b"level"));
        job.planned(graph(&[1])).unwrap()
    };
    job.start(lane());
    let steps = planned(&mut job);
    job.done(trace_at(0), Digest::of(b"m0"));
    assert!(job.restart());
    assert_eq!(job.done(trace_at(0), Digest::of(b"m0")), [], "not while the graph is not there");
    assert_eq!(planned(&mut job), steps);
    assert!(job.task(solve_at(1)).is_none(), "what was there before is looked up again");
    assert_eq!(job.done(trace_at(0), Digest::of(b"m0")), [Step::LookUp(vec![solve_at(1)])]);
}

#[test]
fn the_lane_is_part_of_the_answer() {
    let source = Digest::of(b"source");
    let other = Lane { trace: "cpu".into(), solve: "x86_64+avx2".into() };
    assert_ne!(answer_key(source, &lane()), answer_key(source, &other));
    assert_ne!(answer_key(source, &lane()), answer_key(Digest::of(b"other"), &lane()));
}
