//! Task graphs run by hand, and at random.

use super::*;
use crate::{
    flights::{Entry, Flights},
    job::tests::{empty, graph, piece, solve},
};
use kiln_core::{JobId, PlannedTask, TaskKey, TaskKind};
use proptest::prelude::*;
use std::collections::BTreeMap;

fn digest(name: &str) -> Digest {
    Digest::of(name.as_bytes())
}

fn trace_at(index: u32) -> Node {
    Node::Work { kind: TaskKind::Trace, index }
}

fn solve_at(index: u32) -> Node {
    Node::Work { kind: TaskKind::Solve, index }
}

fn ready(nodes: &[Node]) -> Progressed {
    Progressed::Ready(nodes.to_vec())
}

/// A graph of solves that take solves: no plan makes one, but to the executor all kinds are alike. Task i takes
/// `inputs[i]`, and is an output if nothing takes it, or `is_output` says so.
fn any_graph(inputs: &[Vec<u32>], is_output: impl Fn(u32) -> bool) -> TaskGraph {
    let mut graph = empty();
    for (index, inputs_of) in (0..).zip(inputs) {
        let is_taken = inputs.iter().flatten().any(|&input| input == index);
        let task = solve(index);
        let output = task.output.filter(|_| !is_taken || is_output(index));
        graph.add(PlannedTask { output, ..task }, inputs_of.iter().copied());
    }
    graph
}

#[test]
fn an_instance_is_ready_when_its_last_piece_is_traced() {
    // Pieces 0 and 1 and their solve; a solve without pieces; piece 4 and its solve.
    let mut baking = Baking::new(digest("level"), graph(&[2, 0, 1])).unwrap();
    assert_eq!(baking.first(), [trace_at(0), trace_at(1), solve_at(3), trace_at(4)]);
    assert_eq!(baking.done(1, digest("1")), ready(&[]));
    assert_eq!(baking.done(1, digest("again")), ready(&[]), "a second result changes nothing");
    assert_eq!(baking.inputs(2), None);
    assert_eq!(baking.done(0, digest("0")), ready(&[solve_at(2)]));
    assert_eq!(baking.inputs(2), Some(vec![digest("0"), digest("1")]));
    assert_eq!(baking.done(3, digest("b")), ready(&[]));
    assert_eq!(baking.done(4, digest("4")), ready(&[solve_at(5)]));
    assert_eq!(baking.done(5, digest("c")), ready(&[]));
    assert_eq!(baking.done(2, digest("a")), Progressed::Finished);
    assert_eq!(baking.done(2, digest("a")), ready(&[]), "it ends once");
    let output = |instance, name| (Output::Solution { instance }, digest(name));
    assert_eq!(baking.outputs(), [output(0, "a"), output(1, "b"), output(2, "c")]);
}

#[test]
fn a_chain_is_run_link_by_link() {
    let mut baking = Baking::over(any_graph(&[vec![], vec![0], vec![1], vec![2]], |_| false));
    assert_eq!(baking.first(), [solve_at(0)]);
    for link in 0..3 {
        assert_eq!(baking.done(link, digest("link")), ready(&[solve_at(link + 1)]));
    }
    assert!(!baking.is_finished());
    assert_eq!(baking.done(3, digest("end")), Progressed::Finished);
    assert_eq!(baking.outputs(), [(Output::Solution { instance: 3 }, digest("end"))]);
}

#[test]
fn a_diamond_waits_for_both_of_its_sides() {
    // The top is an output as well as an input.
    let mut baking = Baking::over(any_graph(&[vec![], vec![0], vec![0], vec![2, 1]], |index| index == 0));
    assert_eq!(baking.first(), [solve_at(0)]);
    assert_eq!(baking.done(0, digest("top")), ready(&[solve_at(1), solve_at(2)]));
    assert_eq!(baking.done(2, digest("right")), ready(&[]));
    assert_eq!(baking.done(1, digest("left")), ready(&[solve_at(3)]));
    assert_eq!(baking.inputs(3), Some(vec![digest("right"), digest("left")]), "in the order of the graph");
    assert_eq!(baking.done(3, digest("end")), Progressed::Finished);
}

#[test]
fn what_is_taken_twice_is_waited_for_once() {
    let mut baking = Baking::over(any_graph(&[vec![], vec![0, 0]], |_| false));
    assert_eq!(baking.done(0, digest("0")), ready(&[solve_at(1)]));
    assert_eq!(baking.inputs(1), Some(vec![digest("0"); 2]));
}

#[test]
fn results_of_no_task_change_nothing() {
    let mut baking = Baking::over(graph(&[1]));
    assert_eq!(baking.done(2, digest("stray")), ready(&[]));
    assert_eq!(baking.done(u32::MAX, digest("stray")), ready(&[]));
    assert!(Baking::over(graph(&[])).is_finished());
}

/// Inputs of up to 40 tasks, each of earlier ones, some twice.
fn any_inputs() -> impl Strategy<Value = Vec<Vec<u32>>> {
    let raw = prop::collection::vec(prop::collection::vec(any::<prop::sample::Index>(), 0..4), 1..40);
    raw.prop_map(|tasks| {
        let earlier = |task: usize, picks: &[prop::sample::Index]| {
            if task == 0 { Vec::new() } else { picks.iter().map(|pick| pick.index(task) as u32).collect() }
        };
        tasks.iter().enumerate().map(|(task, picks)| earlier(task, picks)).collect()
    })
}

proptest! {
    #[test]
    fn every_task_runs_once_and_after_its_inputs(
        inputs in any_inputs(),
        outputs in prop::collection::vec(any::<bool>(), 40),
        order in prop::collection::vec(any::<prop::sample::Index>(), 80),
    ) {
        let graph = any_graph(&inputs, |index| outputs[index as usize]);
        let mut baking = Baking::over(graph.clone());
        let result = |index: u32| Digest::of(&index.to_le_bytes());
        let mut handed_out = vec![false; inputs.len()];
        let mut done = handed_out.clone();
        let mut waiting = baking.first();
        let mut is_finished = false;
        for pick in order {
            for node in &waiting {
                let Node::Work { index, .. } = *node else { panic!("a graph has no {node:?}") };
                let known: Vec<Digest> = inputs[index as usize].iter().map(|&input| result(input)).collect();
                prop_assert!(inputs[index as usize].iter().all(|&input| done[input as usize]));
                prop_assert_eq!(baking.inputs(index), Some(known));
                handed_out[index as usize] = true;
            }
            if waiting.is_empty() {
                break;
            }
            let Node::Work { index, .. } = waiting.swap_remove(pick.index(waiting.len())) else { unreachable!() };
            prop_assert!(!std::mem::replace(&mut done[index as usize], true), "handed out twice");
            let all = |done: &[bool]| graph.tasks.iter().zip(done).all(|(task, done)| task.output.is_none() || *done);
            match baking.done(index, result(index)) {
                Progressed::Ready(nodes) => {
                    prop_assert!(!all(&done));
                    waiting.extend(nodes);
                }
                Progressed::Finished => {
                    prop_assert!(all(&done) && waiting.is_empty() && !is_finished);
                    is_finished = true;
                }
            }
            prop_assert_eq!(baking.done(index, digest("late")), Progressed::Ready(Vec::new()));
            prop_assert_eq!(baking.is_finished(), is_finished);
        }
        prop_assert!(is_finished && handed_out == done && !done.contains(&false));
    }

    /// As the dispatcher does it: a key is looked up first, and runs once. Instances here share pieces in some of their
    /// faces, so that keys repeat: within an instance, between instances, and of whole solves.
    #[test]
    fn equal_keys_run_once(
        faces in prop::collection::vec(prop::collection::vec(0u32..3, 0..4), 1..8),
        order in prop::collection::vec(any::<prop::sample::Index>(), 64),
    ) {
        let mut graph = empty();
        for (instance, faces) in (0..).zip(&faces) {
            let first = graph.tasks.len() as u32;
            faces.iter().for_each(|&face| {
                graph.add(PlannedTask { family: piece(0, face).family, ..piece(instance, face) }, []);
            });
            let family = digest("of one mesh in one place");
            graph.add(PlannedTask { family, ..solve(instance) }, first..first + faces.len() as u32);
        }
        let mut baking = Baking::new(digest("level"), graph).unwrap();
        let (mut store, mut flights) = (BTreeMap::<TaskKey, Digest>::new(), Flights::new(0));
        let (mut to_look_up, mut flying) = (baking.first(), Vec::new());
        let (mut order, mut ends) = (order.into_iter().cycle(), 0);
        loop {
            let mut landed = Vec::new();
            if let Some(node) = to_look_up.pop() {
                let Node::Work { index, .. } = node else { unreachable!() };
                let inputs = baking.inputs(index).unwrap();
                let key = baking.graph.key(&baking.graph.tasks[index as usize], &inputs);
                match store.get(&key) {
                    Some(&result) => landed.push((node, result)),
                    None => flying.extend(flights.add(Entry { job: JobId(1), node, key }, |_| false)),
                }
            } else if flying.is_empty() {
                break;
            } else {
                let Entry { node, key, .. } = *flights.get(flying.swap_remove(order.next().unwrap().index(flying.len()))).unwrap();
                prop_assert_eq!(store.insert(key, key.0), None, "run twice");
                landed.push((node, key.0));
                landed.extend(flights.land(key).into_iter().map(|(_, follower)| (follower, key.0)));
            }
            for (node, result) in landed {
                let Node::Work { index, .. } = node else { unreachable!() };
                match baking.done(index, result) {
                    Progressed::Ready(nodes) => to_look_up.extend(nodes),
                    Progressed::Finished => ends += 1,
                }
            }
        }
        prop_assert_eq!((ends, flights.len()), (1, 0));
        // Solutions are equal where, and only where, all pieces are.
        let outputs = baking.outputs();
        prop_assert_eq!(outputs.len(), faces.len());
        for (i, j) in (0..faces.len()).flat_map(|i| (0..i).map(move |j| (i, j))) {
            prop_assert_eq!(outputs[i].1 == outputs[j].1, faces[i] == faces[j]);
        }
    }
}
