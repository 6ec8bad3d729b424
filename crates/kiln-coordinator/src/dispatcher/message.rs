//! What the dispatcher is told and asked.

use super::{Respond, registry::Hello};
use crate::{events::EventLog, keeper::Stored};
use kiln_core::Digest;
use kiln_proto::{Submission, status, v1};
use kiln_schedule::WorkerId;
use std::{sync::Arc, time::Duration};
use tokio::sync::{mpsc, oneshot, watch};
use tonic::{Code, Status};

/// Where a worker's messages go.
pub(crate) type Outbox = mpsc::Sender<Result<v1::SessionResponse, Status>>;

/// A message to the dispatcher.
#[derive(Debug)]
pub(crate) enum Message {
    /// A client asks.
    Ask(Ask),
    /// A worker says hello; it is answered with its number and that of its session.
    Join { hello: Box<Hello>, outbox: Outbox, respond: Respond<(WorkerId, u64)> },
    /// A worker says something.
    Said { worker: WorkerId, session: u64, request: v1::SessionRequest },
    /// A worker's stream ended.
    Left { worker: WorkerId, session: u64 },
    /// The store answers.
    Stored(Stored),
    /// The coordinator is to stop.
    Stop,
}

/// A call of a client.
#[derive(Debug)]
pub(crate) enum Ask {
    Submit { submission: Box<Submission>, payload: Digest, source: Digest, respond: Respond<(v1::Bake, bool)> },
    Get { bake: String, respond: Respond<v1::Bake> },
    List { page_size: u32, page_token: String, active_only: bool, respond: Respond<v1::ListBakesResponse> },
    Watch { bake: String, respond: Respond<Watching> },
    Cancel { bake: String, respond: Respond<v1::Bake> },
    Pause { bake: String, paused: bool, respond: Respond<v1::Bake> },
    Explain { bake: String, respond: Respond<v1::ExplainBakeResponse> },
    Workers { page_size: u32, page_token: String, respond: Respond<v1::ListWorkersResponse> },
    Stats { respond: Respond<v1::FarmStats> },
}

/// What a watcher of a bake needs.
#[derive(Debug)]
pub(crate) struct Watching {
    pub(crate) events: Arc<EventLog>,
    /// Nothing more will happen.
    pub(crate) ended: bool,
}

/// The way to the dispatcher.
#[derive(Clone, Debug)]
pub(crate) struct Handle {
    inbox: mpsc::Sender<Message>,
    farm: watch::Receiver<Arc<v1::WatchFarmResponse>>,
}

impl Handle {
    pub(crate) fn new(inbox: mpsc::Sender<Message>, farm: watch::Receiver<Arc<v1::WatchFarmResponse>>) -> Self {
        Self { inbox, farm }
    }

    /// Sends a message; an error means that the coordinator has stopped.
    pub(crate) async fn send(&self, message: Message) -> Result<(), Status> {
        self.inbox.send(message).await.map_err(|_| stopped())
    }

    /// Asks and waits for the answer.
    pub(crate) async fn ask<T>(&self, ask: impl FnOnce(Respond<T>) -> Ask) -> Result<T, Status> {
        let (respond, answer) = oneshot::channel();
        self.send(Message::Ask(ask(respond))).await?;
        answer.await.map_err(|_| stopped())?
    }

    /// Announces a worker.
    pub(crate) async fn join(&self, hello: Hello, outbox: Outbox) -> Result<(WorkerId, u64), Status> {
        let (respond, answer) = oneshot::channel();
        self.send(Message::Join { hello: Box::new(hello), outbox, respond }).await?;
        answer.await.map_err(|_| stopped())?
    }

    /// Ends when the coordinator has stopped.
    pub(crate) async fn closed(&self) {
        self.inbox.closed().await;
    }

    /// The farm's state as it changes.
    pub(crate) fn farm(&self) -> watch::Receiver<Arc<v1::WatchFarmResponse>> {
        self.farm.clone()
    }
}

/// The error of a coordinator that has stopped or is about to.
pub(crate) fn stopped() -> Status {
    let message = "the coordinator is stopping; try again when it is back";
    status::retry_later(Code::Unavailable, status::STOPPING, message, Duration::from_secs(1))
}
