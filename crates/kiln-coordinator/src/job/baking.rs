//! Runs a task graph: which tasks are ready, and when all outputs are there. It knows of no kinds of task.

use super::Node;
use kiln_core::{Digest, GraphError, Output, TaskGraph};

/// The tasks of the graph run, each as soon as all that it takes is there.
#[derive(Debug)]
pub(crate) struct Baking {
    pub(crate) graph: TaskGraph,
    /// Result of each task.
    results: Vec<Option<Digest>>,
    /// How many inputs of each task are not there yet; one that it takes twice counts twice.
    missing: Vec<u32>,
    /// The tasks that take each task's result: runs of `dependents`, of which each begins where that before ends.
    dependents_end: Vec<u32>,
    dependents: Vec<u32>,
    missing_outputs: usize,
}

/// What follows from a result.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Progressed {
    /// These tasks, which waited for nothing else, can run now: often none.
    Ready(Vec<Node>),
    /// It was the last output that was missing: every task has run.
    Finished,
}

impl Baking {
    /// Checks the graph, of which nothing has run.
    pub(crate) fn new(level: Digest, graph: TaskGraph) -> Result<Self, GraphError> {
        graph.check(level)?;
        Ok(Self::over(graph))
    }

    /// `graph` has runs of inputs that exist, and no cycles.
    fn over(graph: TaskGraph) -> Self {
        let count = graph.tasks.len();
        // Where each run ends, then begins, then, once every dependent has taken its place, ends again.
        let mut dependents_end = vec![0u32; count];
        graph.inputs.iter().for_each(|&input| dependents_end[input as usize] += 1);
        let mut sum = 0;
        for end in &mut dependents_end {
            (*end, sum) = (sum, sum + *end);
        }
        let mut dependents = vec![0; graph.inputs.len()];
        let mut missing = Vec::with_capacity(count);
        for task in 0..count as u32 {
            let inputs = graph.inputs_of(task);
            missing.push(inputs.len() as u32);
            for &input in inputs {
                let place = &mut dependents_end[input as usize];
                dependents[*place as usize] = task;
                *place += 1;
            }
        }
        let missing_outputs = graph.tasks.iter().filter(|task| task.output.is_some()).count();
        Self { results: vec![None; count], missing, dependents_end, dependents, missing_outputs, graph }
    }

    /// The tasks that wait for nothing, in the order of the graph.
    pub(crate) fn first(&self) -> Vec<Node> {
        let ready = self.missing.iter().zip(0..).filter(|(missing, _)| **missing == 0);
        ready.map(|(_, index)| self.node(index)).collect()
    }

    /// The result of a task is there. A second result, or that of a task that is not in the graph, changes nothing.
    pub(crate) fn done(&mut self, index: u32, result: Digest) -> Progressed {
        let mut ready = Vec::new();
        let Some(place @ None) = self.results.get_mut(index as usize) else { return Progressed::Ready(ready) };
        *place = Some(result);
        if self.graph.tasks[index as usize].output.is_some() {
            self.missing_outputs -= 1;
            if self.missing_outputs == 0 {
                return Progressed::Finished;
            }
        }
        let begin = index.checked_sub(1).map_or(0, |before| self.dependents_end[before as usize]);
        for place in begin..self.dependents_end[index as usize] {
            let dependent = self.dependents[place as usize];
            let missing = &mut self.missing[dependent as usize];
            *missing -= 1;
            if *missing == 0 {
                ready.push(self.node(dependent));
            }
        }
        Progressed::Ready(ready)
    }

    /// Whether all outputs are there.
    pub(crate) fn is_finished(&self) -> bool {
        self.missing_outputs == 0
    }

    /// What a task takes, in order, once all is there.
    pub(crate) fn inputs(&self, index: u32) -> Option<Vec<Digest>> {
        self.graph.inputs_of(index).iter().map(|&input| self.results[input as usize]).collect()
    }

    /// The outputs that are there, in the order of the graph.
    pub(crate) fn outputs(&self) -> Vec<(Output, Digest)> {
        let tasks = self.graph.tasks.iter().zip(&self.results);
        tasks.filter_map(|(task, result)| Some((task.output?, (*result)?))).collect()
    }

    fn node(&self, index: u32) -> Node {
        Node::Work { kind: self.graph.tasks[index as usize].work.kind(), index }
    }
}

#[cfg(test)]
mod tests;
