//! Tasks that wait or run, by number and by key. Equal keys run once: whoever asks for a key that is in the air
//! already follows, and gets the result when it lands.

use crate::job::Node;
use kiln_core::{JobId, TaskKey};
use kiln_schedule::TaskId;
use std::collections::BTreeMap;

/// A task that the scheduler knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Entry {
    pub(crate) job: JobId,
    pub(crate) node: Node,
    pub(crate) key: TaskKey,
}

/// A key in the air.
#[derive(Debug, Default)]
struct Flight {
    /// The tasks that run it: more than one if the first belongs to a paused job.
    tasks: Vec<TaskId>,
    followers: Vec<(JobId, Node)>,
}

/// All tasks in the air.
#[derive(Debug)]
pub(crate) struct Flights {
    next: u64,
    entries: BTreeMap<TaskId, Entry>,
    flights: BTreeMap<TaskKey, Flight>,
}

impl Flights {
    /// None; the first task gets the number `first`.
    pub(crate) fn new(first: u64) -> Self {
        Self { next: first, entries: BTreeMap::new(), flights: BTreeMap::new() }
    }

    /// Adds a task; gives its number if it is to run, and nothing if it follows another that is not held back.
    pub(crate) fn add(&mut self, entry: Entry, is_paused: impl Fn(JobId) -> bool) -> Option<TaskId> {
        let flight = self.flights.entry(entry.key).or_default();
        let runs = flight.tasks.iter().filter_map(|id| self.entries.get(id));
        if runs.clone().any(|other| !is_paused(other.job)) || (!flight.tasks.is_empty() && is_paused(entry.job)) {
            flight.followers.push((entry.job, entry.node));
            return None;
        }
        let id = TaskId(self.next);
        self.next += 1;
        flight.tasks.push(id);
        self.entries.insert(id, entry);
        Some(id)
    }

    /// A task by its number.
    pub(crate) fn get(&self, id: TaskId) -> Option<&Entry> {
        self.entries.get(&id)
    }

    /// The tasks that run a key.
    pub(crate) fn tasks_of(&self, key: TaskKey) -> &[TaskId] {
        self.flights.get(&key).map_or(&[], |flight| &flight.tasks)
    }

    /// The task that a result is of: by its number, if the key agrees, else by its key alone.
    pub(crate) fn find(&self, id: TaskId, key: TaskKey) -> Option<TaskId> {
        match self.entries.get(&id) {
            Some(entry) if entry.key == key => Some(id),
            _ => self.tasks_of(key).first().copied(),
        }
    }

    /// A result is there: the key's tasks are gone, and its followers are given out.
    pub(crate) fn land(&mut self, key: TaskKey) -> Vec<(JobId, Node)> {
        let Some(flight) = self.flights.remove(&key) else { return Vec::new() };
        for id in flight.tasks {
            self.entries.remove(&id);
        }
        flight.followers
    }

    /// A job is over; gives the followers of tasks that nobody runs any more, to be added anew.
    pub(crate) fn leave(&mut self, job: JobId) -> Vec<(JobId, Node)> {
        self.entries.retain(|_, entry| entry.job != job);
        let mut orphans = Vec::new();
        self.flights.retain(|_, flight| {
            flight.tasks.retain(|id| self.entries.contains_key(id));
            flight.followers.retain(|(follower, _)| *follower != job);
            if flight.tasks.is_empty() {
                orphans.append(&mut flight.followers);
            }
            !flight.tasks.is_empty()
        });
        orphans
    }

    /// After a job was paused: followers of other jobs whose key only paused jobs would run, to be added anew.
    pub(crate) fn held_back(&mut self, is_paused: impl Fn(JobId) -> bool) -> Vec<(JobId, Node)> {
        let mut free = Vec::new();
        for flight in self.flights.values_mut() {
            let runs = flight.tasks.iter().filter_map(|id| self.entries.get(id));
            if runs.clone().all(|entry| is_paused(entry.job)) {
                free.extend(flight.followers.extract_if(.., |(job, _)| !is_paused(*job)));
            }
        }
        free
    }

    /// Tasks in the air.
    pub(crate) fn len(&self) -> usize {
        self.entries.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::{Digest, TaskKind};

    fn work(index: u32) -> Node {
        Node::Work { kind: TaskKind::Trace, index }
    }

    fn entry(job: u64, key: &str) -> Entry {
        Entry { job: JobId(job), node: work(job as u32), key: TaskKey(Digest::of(key.as_bytes())) }
    }

    const NONE: fn(JobId) -> bool = |_| false;

    #[test]
    fn equal_keys_run_once() {
        let mut flights = Flights::new(7);
        assert_eq!(flights.add(entry(1, "a"), NONE), Some(TaskId(7)));
        assert_eq!(flights.add(entry(2, "a"), NONE), None);
        assert_eq!(flights.add(entry(2, "b"), NONE), Some(TaskId(8)));
        let a = entry(1, "a").key;
        assert_eq!(flights.find(TaskId(7), a), Some(TaskId(7)));
        assert_eq!(flights.find(TaskId(8), a), Some(TaskId(7)), "the key decides");
        assert_eq!(flights.find(TaskId(1), entry(0, "c").key), None);
        assert_eq!(flights.land(a), [(JobId(2), work(2))]);
        assert_eq!(flights.land(a), []);
        assert_eq!(flights.len(), 1);
    }

    #[test]
    fn followers_of_a_job_that_ends_go_on() {
        let mut flights = Flights::new(0);
        flights.add(entry(1, "a"), NONE);
        flights.add(entry(2, "a"), NONE);
        flights.add(entry(3, "a"), NONE);
        assert_eq!(flights.leave(JobId(3)), []);
        assert_eq!(flights.leave(JobId(1)), [(JobId(2), work(2))]);
        assert_eq!((flights.len(), flights.flights.len()), (0, 0));
    }

    #[test]
    fn a_paused_job_holds_nobody_back() {
        let mut flights = Flights::new(0);
        flights.add(entry(1, "a"), NONE);
        flights.add(entry(2, "a"), NONE);
        let paused = |job: JobId| job == JobId(1);
        assert_eq!(flights.held_back(paused), [(JobId(2), work(2))]);
        assert_eq!(flights.add(entry(2, "a"), paused), Some(TaskId(1)), "it runs beside the paused one");
        assert_eq!(flights.add(entry(3, "a"), paused), None);
        assert_eq!(flights.tasks_of(entry(1, "a").key), [TaskId(0), TaskId(1)]);
        assert_eq!(flights.land(entry(1, "a").key), [(JobId(3), work(3))]);
        assert_eq!(flights.len(), 0);
    }
}
