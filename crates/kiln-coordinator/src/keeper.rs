//! The thread that talks to the store. The dispatcher never waits for a disk: it sends an operation here and goes
//! on when the answer comes back as a message.
//!
//! All operations that have queued up are taken at once. Their results become one file and one fsync, and then
//! their journal events one append and one fsync; only after that are they answered.

use crate::{
    check::{CheckError, Expect, check},
    job::{Answer, Effort, Node},
};
use kiln_core::{Baked, Digest, JobId, TaskGraph, TaskKey, codec};
use kiln_schedule::{LeaseId, TaskId, WorkerId};
use kiln_store::{Fence, JournalEvent, ResultConflict, Store, StoreError};
use std::{
    collections::BTreeSet,
    sync::{Arc, mpsc},
    thread,
};

/// A result that a worker brought.
#[derive(Debug)]
pub(crate) struct Arrival {
    pub(crate) key: TaskKey,
    pub(crate) artefact: Digest,
    pub(crate) effort: Effort,
    pub(crate) expect: Expect,
    /// The task that the worker ran.
    pub(crate) task: TaskId,
}

/// Results that a worker brought in one message.
#[derive(Debug)]
pub(crate) struct Delivery {
    pub(crate) worker: WorkerId,
    pub(crate) lease: LeaseId,
    pub(crate) epoch: u32,
    pub(crate) sequence: u64,
    pub(crate) lease_seconds: f64,
    pub(crate) arrivals: Vec<Arrival>,
}

/// An operation.
#[derive(Debug)]
pub(crate) enum Op {
    /// Append to the journal.
    Journal { events: Vec<JournalEvent>, ack: u64 },
    /// Keep an artefact under a key, then append to the journal that the job is over.
    End { job: JobId, record: Option<(TaskKey, Vec<u8>)>, event: Box<JournalEvent> },
    /// Find the whole answer of a job.
    LookUpAnswer { job: JobId, key: TaskKey },
    /// Find results of tasks.
    LookUp { job: JobId, nodes: Vec<(Node, TaskKey)> },
    /// Look whether an artefact that a worker could not get is really gone.
    Recheck { job: JobId, digest: Digest },
    /// Read a task graph.
    ReadGraph { job: JobId, digest: Digest },
    /// Read what an export gave.
    ReadBaked { job: JobId, digest: Digest },
    /// Store the list of outputs.
    StoreOutputs { job: JobId, bytes: Vec<u8> },
    /// Check and keep results.
    Deliver(Delivery),
    /// Bring the store down to a size.
    Collect { live: BTreeSet<Digest>, max_bytes: u64 },
}

/// What came of a result: the artefact that counts, or why it was not accepted.
pub(crate) type Verdict = Result<Digest, String>;

/// An answer.
#[derive(Debug)]
pub(crate) enum Stored {
    Journaled {
        ack: u64,
        outcome: Result<(), Arc<StoreError>>,
    },
    Ended {
        job: JobId,
        outcome: Result<(), Arc<StoreError>>,
    },
    Answer {
        job: JobId,
        found: Option<Box<(Answer, Baked)>>,
    },
    LookedUp {
        job: JobId,
        found: Vec<(Node, Option<Digest>)>,
    },
    /// An artefact that a task needs is gone.
    Lost {
        job: JobId,
        digest: Digest,
    },
    /// `None`: it is gone or damaged.
    Graph {
        job: JobId,
        graph: Option<Box<TaskGraph>>,
    },
    Baked {
        job: JobId,
        digest: Digest,
        baked: Option<Box<Baked>>,
    },
    Outputs {
        job: JobId,
        outcome: Result<Digest, Arc<StoreError>>,
    },
    Delivered {
        delivery: Delivery,
        outcome: Result<Vec<Verdict>, Arc<StoreError>>,
    },
    /// A job's question failed: the store is broken.
    Broken {
        job: JobId,
        error: StoreError,
    },
}

/// The way to the thread. It ends when this is dropped and its queue is empty.
#[derive(Debug)]
pub(crate) struct Keeper {
    ops: mpsc::Sender<Op>,
    thread: thread::JoinHandle<()>,
}

impl Keeper {
    /// Starts the thread; `answer` is called on it.
    pub(crate) fn start(
        store: Arc<Store>,
        fence: Fence,
        answer: impl Fn(Stored) + Send + 'static,
    ) -> std::io::Result<Self> {
        let (ops, queue) = mpsc::channel();
        let run = move || {
            while let Ok(first) = queue.recv() {
                let batch = std::iter::once(first).chain(queue.try_iter()).collect();
                Batch::default().run(&store, fence, batch).into_iter().for_each(&answer);
            }
        };
        let thread = thread::Builder::new().name("kiln-keeper".into()).spawn(run)?;
        Ok(Self { ops, thread })
    }

    /// Whether the thread has died: a bug in the store.
    pub(crate) fn is_dead(&self) -> bool {
        self.thread.is_finished()
    }

    /// Sends an operation. Nothing comes back if the thread has died: see [`Self::is_dead`].
    pub(crate) fn send(&self, op: Op) {
        let _ = self.ops.send(op);
    }

    /// Lets the thread finish what is queued, and waits for it. Blocks.
    pub(crate) fn finish(self) {
        drop(self.ops);
        if self.thread.join().is_err() {
            tracing::error!("the thread that keeps the store has died");
        }
    }
}

/// What a batch has gathered to write at once.
#[derive(Default)]
struct Batch {
    answers: Vec<Stored>,
    deliveries: Vec<(Delivery, Vec<Verdict>)>,
    records: Vec<(TaskKey, Vec<u8>)>,
    ends: Vec<JobId>,
    journal: Vec<JournalEvent>,
    acks: Vec<u64>,
}

impl Batch {
    fn run(mut self, store: &Store, fence: Fence, ops: Vec<Op>) -> Vec<Stored> {
        for op in ops {
            self.take(store, op);
        }
        self.write_results(store);
        self.write_journal(store, fence);
        self.answers
    }

    fn take(&mut self, store: &Store, op: Op) {
        match op {
            Op::Journal { events, ack } => {
                self.journal.extend(events);
                self.acks.push(ack);
            }
            Op::End { job, record, event } => {
                self.records.extend(record);
                self.journal.push(*event);
                self.ends.push(job);
            }
            Op::Deliver(delivery) => {
                let verdicts = delivery.arrivals.iter().map(|arrival| examine(store, arrival)).collect();
                match verdicts {
                    Ok(verdicts) => self.deliveries.push((delivery, verdicts)),
                    Err(error) => self.answers.push(Stored::Delivered { delivery, outcome: Err(Arc::new(error)) }),
                }
            }
            Op::StoreOutputs { job, bytes } => {
                let outcome = store.put_one(&bytes).map_err(Arc::new);
                self.answers.push(Stored::Outputs { job, outcome });
            }
            Op::LookUpAnswer { job, key } => {
                self.ask(job, |job| Ok(Stored::Answer { job, found: find_answer(store, key)?.map(Box::new) }));
            }
            Op::LookUp { job, nodes } => {
                self.ask(job, |job| Ok(Stored::LookedUp { job, found: find_results(store, &nodes)? }));
            }
            Op::Recheck { job, digest } => match store.get(&digest) {
                // Reading it whole finds damage, which the store then forgets.
                Ok(Some(_)) => {}
                Ok(None) => self.answers.push(Stored::Lost { job, digest }),
                Err(error) => self.answers.push(Stored::Broken { job, error }),
            },
            Op::ReadGraph { job, digest } => self
                .ask(job, |job| Ok(Stored::Graph { job, graph: read(store, "a task graph", &digest)?.map(Box::new) })),
            Op::ReadBaked { job, digest } => self.ask(job, |job| {
                let baked = read(store, "a bake's summary", &digest)?.map(Box::new);
                Ok(Stored::Baked { job, digest, baked })
            }),
            Op::Collect { live, max_bytes } => match store.collect_garbage(&live, max_bytes) {
                Ok(collected) => tracing::debug!(?collected, "collected garbage"),
                Err(error) => tracing::warn!(%error, "could not collect garbage"),
            },
        }
    }

    fn ask(&mut self, job: JobId, question: impl FnOnce(JobId) -> Result<Stored, StoreError>) {
        self.answers.push(question(job).unwrap_or_else(|error| Stored::Broken { job, error }));
    }

    /// One file for everything that was accepted and recorded.
    fn write_results(&mut self, store: &Store) {
        let mut results = Vec::new();
        for (delivery, verdicts) in &self.deliveries {
            let arrived = delivery.arrivals.iter().zip(verdicts);
            results.extend(arrived.filter_map(|(arrival, verdict)| Some((arrival.key, *verdict.as_ref().ok()?))));
        }
        let records = self.records.iter().map(|(key, bytes)| (*key, Digest::of(bytes)));
        results.extend(records);
        if results.is_empty() {
            return;
        }
        let bytes: Vec<&[u8]> = self.records.iter().map(|(_, bytes)| bytes.as_slice()).collect();
        match store.put_results(&bytes, &results) {
            Ok(conflicts) => {
                for conflict in &conflicts {
                    tracing::warn!(?conflict, "two results of one task differ; the first is kept");
                    self.prefer_kept(conflict);
                }
                let done = self.deliveries.drain(..);
                let done = done.map(|(delivery, verdicts)| Stored::Delivered { delivery, outcome: Ok(verdicts) });
                self.answers.extend(done);
            }
            Err(error) => self.results_failed(&Arc::new(error)),
        }
    }

    /// A result differs from the one that is kept: the job goes on with that one.
    fn prefer_kept(&mut self, conflict: &ResultConflict) {
        let judged = self.deliveries.iter_mut().flat_map(|(delivery, verdicts)| delivery.arrivals.iter().zip(verdicts));
        for (_, verdict) in judged.filter(|(arrival, _)| arrival.key == conflict.key) {
            if let Ok(digest) = verdict {
                *digest = conflict.kept;
            }
        }
    }

    fn results_failed(&mut self, error: &Arc<StoreError>) {
        let failed = self.deliveries.drain(..);
        let failed = failed.map(|(delivery, _)| Stored::Delivered { delivery, outcome: Err(Arc::clone(error)) });
        self.answers.extend(failed);
        if !self.records.is_empty() {
            // A record is an aid: the job may end without it, if the journal can still be written.
            tracing::warn!(%error, "could not keep the records of bakes that ended");
        }
    }

    fn write_journal(&mut self, store: &Store, fence: Fence) {
        // Deliveries without a single good result were not written.
        let rest = self.deliveries.drain(..);
        self.answers.extend(rest.map(|(delivery, verdicts)| Stored::Delivered { delivery, outcome: Ok(verdicts) }));
        if self.journal.is_empty() {
            return;
        }
        let outcome = store.journal_append(fence, &self.journal).map_err(Arc::new);
        for ack in self.acks.drain(..) {
            self.answers.push(Stored::Journaled { ack, outcome: outcome.clone() });
        }
        for job in self.ends.drain(..) {
            self.answers.push(Stored::Ended { job, outcome: outcome.clone() });
        }
    }
}

fn examine(store: &Store, arrival: &Arrival) -> Result<Verdict, StoreError> {
    match check(store, &arrival.expect, arrival.artefact) {
        Ok(()) => Ok(Ok(arrival.artefact)),
        Err(CheckError::Store(error)) => Err(error),
        Err(error) => Ok(Err(error.to_string())),
    }
}

/// A structured artefact; `None` if it is gone or cannot be read.
pub(crate) fn read<T: serde::de::DeserializeOwned>(
    store: &Store,
    what: &'static str,
    digest: &Digest,
) -> Result<Option<T>, StoreError> {
    let Some(bytes) = store.get(digest)? else { return Ok(None) };
    let value = codec::decode(what, &bytes);
    Ok(value.inspect_err(|error| tracing::warn!(%digest, %error, "an artefact cannot be read")).ok())
}

fn find_answer(store: &Store, key: TaskKey) -> Result<Option<(Answer, Baked)>, StoreError> {
    let Some(digest) = store.result(key)? else { return Ok(None) };
    let Some(answer) = read::<Answer>(store, "an answer", &digest)? else { return Ok(None) };
    let Some(baked) = read::<Baked>(store, "a bake's summary", &answer.baked)? else { return Ok(None) };
    Ok(are_there(store, &baked)?.then_some((answer, baked)))
}

/// Results of tasks; import and export count only if what they stored besides is there too.
fn find_results(store: &Store, nodes: &[(Node, TaskKey)]) -> Result<Vec<(Node, Option<Digest>)>, StoreError> {
    let keys: Vec<TaskKey> = nodes.iter().map(|&(_, key)| key).collect();
    let mut found = Vec::with_capacity(nodes.len());
    for (&(node, _), result) in nodes.iter().zip(store.results(&keys)?) {
        let whole = match (node, result) {
            (Node::Import, Some(digest)) => whole(store, &Expect::Level, digest)?,
            (Node::Export, Some(digest)) => match read::<Baked>(store, "a bake's summary", &digest)? {
                Some(baked) => are_there(store, &baked)?,
                None => false,
            },
            _ => true,
        };
        found.push((node, result.filter(|_| whole)));
    }
    Ok(found)
}

/// Whether the files that a bake made are there.
fn are_there(store: &Store, baked: &Baked) -> Result<bool, StoreError> {
    Ok(store.missing(&baked.files().collect::<Vec<_>>())?.is_empty())
}

fn whole(store: &Store, expect: &Expect, digest: Digest) -> Result<bool, StoreError> {
    match check(store, expect, digest) {
        Ok(()) => Ok(true),
        Err(CheckError::Store(error)) => Err(error),
        Err(_) => Ok(false),
    }
}
