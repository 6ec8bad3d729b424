//! The path of a job from submission to result, without store or workers.

use super::*;
use kiln_core::{BakeSummary, Baked, Kernel, LevelCounts, Sampling, SolveTask, TraceSummary, TraceTask};

/// A graph with one instance for each number of pieces.
pub(crate) fn graph(pieces: &[u32]) -> TaskGraph {
    let mut trace = Vec::new();
    let mut solve = Vec::new();
    for (instance, &count) in pieces.iter().enumerate() {
        let instance = instance as u32;
        let first_trace = trace.len() as u32;
        for piece in 0..count {
            let name = format!("piece {instance} {piece}");
            trace.push(TraceTask {
                key: TaskKey(Digest::of(name.as_bytes())),
                family: Digest::default(),
                instance,
                first_face: piece,
                face_count: 1,
                density_per_m2: 1.0,
                ray_count: 64,
            });
        }
        let family = Digest::of(&instance.to_le_bytes());
        solve.push(SolveTask { family, instance, first_trace, trace_count: count, vertex_count: 3 });
    }
    TaskGraph {
        level: Digest::of(b"level"),
        trace,
        solve,
        sampling: sampling(),
        counts: LevelCounts::default(),
        warnings: Vec::new(),
    }
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
        warnings: Vec::new(),
    };
    Baked { file: Digest::of(b"glb"), bytes: 3, summary }
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
    let steps = job.planned(graph(&[1, 1])).unwrap();
    assert_eq!(steps, [Step::LookUp(vec![Node::Trace(0), Node::Trace(1)])]);
    assert_eq!(job.task(Node::Trace(0)).unwrap().needs.lane.as_deref(), Some("cpu"));
    assert!(job.task(Node::Solve(0)).is_none(), "its moments are not there");
    assert_eq!(job.done(Node::Trace(0), Digest::of(b"m0")), [Step::LookUp(vec![Node::Solve(0)])]);
    let solve = job.task(Node::Solve(0)).unwrap();
    assert_eq!(solve.expect, Expect::Solution { vertices: 3, channels: 1 });
    assert_eq!(job.done(Node::Solve(0), Digest::of(b"s0")), []);
    assert_eq!(job.done(Node::Trace(1), Digest::of(b"m1")), [Step::LookUp(vec![Node::Solve(1)])]);
    let solutions = vec![(0, Digest::of(b"s0")), (1, Digest::of(b"s1"))];
    assert_eq!(job.done(Node::Solve(1), Digest::of(b"s1")), [Step::StoreSolutions(solutions)]);
    assert_eq!(job.solved(Digest::of(b"list")), [Step::LookUp(vec![Node::Export])]);
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
    assert_eq!(job.task(Node::Trace(0)).unwrap().needs.lane, None);
    job.done(Node::Trace(0), Digest::of(b"m0"));
    assert_eq!(job.task(Node::Solve(0)).unwrap().needs.lane, Some(lane().solve));
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
    assert_eq!(job.planned(graph(&[])).unwrap(), [Step::StoreSolutions(vec![])]);
}

#[test]
fn the_lane_is_part_of_the_answer() {
    let source = Digest::of(b"source");
    let other = Lane { trace: "cpu".into(), solve: "x86_64+avx2".into() };
    assert_ne!(answer_key(source, &lane()), answer_key(source, &other));
    assert_ne!(answer_key(source, &lane()), answer_key(Digest::of(b"other"), &lane()));
}
