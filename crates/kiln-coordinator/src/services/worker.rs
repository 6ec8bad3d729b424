//! WorkerService.

use super::{Context, Responses};
use crate::dispatcher::{Hello, Message};
use kiln_proto::{status, v1};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Request, Response, Status, Streaming};
use v1::{session_request::Message as Said, worker_service_server::WorkerService};

/// Messages that wait for a worker's connection; one that lets more pile up is cut off.
const OUTBOX: usize = 1024;

/// Time that a worker has for its hello.
const HELLO_WITHIN: Duration = Duration::from_secs(10);

#[derive(Clone, Debug)]
pub(crate) struct Workers(pub(crate) Context);

#[tonic::async_trait]
impl WorkerService for Workers {
    type SessionStream = Responses<v1::SessionResponse>;

    async fn session(
        &self,
        request: Request<Streaming<v1::SessionRequest>>,
    ) -> Result<Response<Self::SessionStream>, Status> {
        let mut inbound = request.into_inner();
        let no_hello =
            || status::error(Code::InvalidArgument, "HELLO_MISSING", "a worker's first message is its hello");
        let first = tokio::time::timeout(HELLO_WITHIN, inbound.message()).await.map_err(|_| no_hello())??;
        let Some(Said::Hello(hello)) = first.and_then(|request| request.message) else { return Err(no_hello()) };
        let hello = Hello::new(hello)?;
        let (outbox, responses) = mpsc::channel(OUTBOX);
        let handle = self.0.handle.clone();
        let gone = outbox.clone();
        let (worker, session) = handle.join(hello, outbox).await?;
        tokio::spawn(async move {
            loop {
                let message = tokio::select! {
                    message = inbound.message() => message,
                    () = gone.closed() => break,
                    () = handle.closed() => break,
                };
                let Ok(Some(request)) = message else { break };
                if handle.send(Message::Said { worker, session, request }).await.is_err() {
                    break;
                }
            }
            // Fails only if the coordinator has stopped.
            let _ = handle.send(Message::Left { worker, session }).await;
        });
        Ok(Response::new(ReceiverStream::new(responses)))
    }
}
