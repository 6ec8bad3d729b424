//! BakeService.

use super::{Context, Responses};
use crate::{
    dispatcher::{Ask, Handle, Watching},
    events::Found,
};
use kiln_core::{Digest, codec};
use kiln_proto::{Submission, status, v1};
use prost::Message;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Request, Response, Status};
use v1::bake_service_server::BakeService;

/// Events that wait for a watcher's connection.
const WATCH_BUFFER: usize = 64;

/// Missing files that an error names.
const NAMED: usize = 5;

#[derive(Clone, Debug)]
pub(crate) struct Bakes(pub(crate) Context);

impl Bakes {
    /// Stores what was submitted, and gives the digests of the request and of the source.
    async fn keep(&self, submission: &Submission) -> Result<(Digest, Digest), Status> {
        let files = submission.source.files.iter().chain(&submission.source.sidecar);
        let files: Vec<(String, Digest)> = files.map(|file| (file.path.clone(), file.digest)).collect();
        let source = codec::encode(&submission.source);
        let payload = v1::SubmitBakeRequest::from(submission).encode_to_vec();
        let stored = self.0.store(move |store| {
            let digests: Vec<Digest> = files.iter().map(|&(_, digest)| digest).collect();
            let missing = store.missing(&digests)?;
            if !missing.is_empty() {
                let paths = files.into_iter().filter(|(_, digest)| missing.contains(digest)).map(|(path, _)| path);
                return Ok(Err(paths.collect::<Vec<_>>()));
            }
            let digests = store.put(&[&payload, &source])?;
            Ok(Ok((digests[0], digests[1])))
        });
        stored.await?.map_err(|paths| {
            let named = paths.iter().take(NAMED).map(|path| format!("{path:?}")).collect::<Vec<_>>().join(", ");
            let more = if paths.len() > NAMED { format!(" and {} more", paths.len() - NAMED) } else { String::new() };
            let message = format!("files of the source have not been uploaded: {named}{more}");
            status::error(Code::FailedPrecondition, status::SOURCE_MISSING, message)
        })
    }
}

#[tonic::async_trait]
impl BakeService for Bakes {
    async fn submit_bake(
        &self,
        request: Request<v1::SubmitBakeRequest>,
    ) -> Result<Response<v1::SubmitBakeResponse>, Status> {
        let submission = Submission::try_from(request.into_inner())?;
        let (payload, source) = self.keep(&submission).await?;
        let submission = Box::new(submission);
        let ask = |respond| Ask::Submit { submission, payload, source, respond };
        let (bake, repeated) = self.0.handle.ask(ask).await?;
        Ok(Response::new(v1::SubmitBakeResponse { bake: Some(bake), repeated }))
    }

    async fn get_bake(&self, request: Request<v1::GetBakeRequest>) -> Result<Response<v1::GetBakeResponse>, Status> {
        let bake = snapshot(&self.0.handle, &request.into_inner().bake_id).await?;
        Ok(Response::new(v1::GetBakeResponse { bake: Some(bake) }))
    }

    async fn list_bakes(
        &self,
        request: Request<v1::ListBakesRequest>,
    ) -> Result<Response<v1::ListBakesResponse>, Status> {
        let v1::ListBakesRequest { page_size, page_token, active_only } = request.into_inner();
        let ask = |respond| Ask::List { page_size, page_token, active_only, respond };
        Ok(Response::new(self.0.handle.ask(ask).await?))
    }

    type WatchBakeStream = Responses<v1::WatchBakeResponse>;

    async fn watch_bake(
        &self,
        request: Request<v1::WatchBakeRequest>,
    ) -> Result<Response<Self::WatchBakeStream>, Status> {
        let v1::WatchBakeRequest { bake_id, after_event } = request.into_inner();
        let handle = self.0.handle.clone();
        let bake = bake_id.clone();
        let watching = handle.ask(|respond| Ask::Watch { bake, respond }).await?;
        let (responses, stream) = mpsc::channel(WATCH_BUFFER);
        tokio::spawn(async move {
            if let Err(error) = watch(&handle, &bake_id, after_event, watching, &responses).await {
                // A watcher that has gone away does not want the error.
                let _ = responses.send(Err(error)).await;
            }
        });
        Ok(Response::new(ReceiverStream::new(stream)))
    }

    async fn cancel_bake(
        &self,
        request: Request<v1::CancelBakeRequest>,
    ) -> Result<Response<v1::CancelBakeResponse>, Status> {
        let bake = request.into_inner().bake_id;
        let bake = self.0.handle.ask(|respond| Ask::Cancel { bake, respond }).await?;
        Ok(Response::new(v1::CancelBakeResponse { bake: Some(bake) }))
    }

    async fn pause_bake(
        &self,
        request: Request<v1::PauseBakeRequest>,
    ) -> Result<Response<v1::PauseBakeResponse>, Status> {
        let bake = request.into_inner().bake_id;
        let bake = self.0.handle.ask(|respond| Ask::Pause { bake, paused: true, respond }).await?;
        Ok(Response::new(v1::PauseBakeResponse { bake: Some(bake) }))
    }

    async fn resume_bake(
        &self,
        request: Request<v1::ResumeBakeRequest>,
    ) -> Result<Response<v1::ResumeBakeResponse>, Status> {
        let bake = request.into_inner().bake_id;
        let bake = self.0.handle.ask(|respond| Ask::Pause { bake, paused: false, respond }).await?;
        Ok(Response::new(v1::ResumeBakeResponse { bake: Some(bake) }))
    }

    async fn explain_bake(
        &self,
        request: Request<v1::ExplainBakeRequest>,
    ) -> Result<Response<v1::ExplainBakeResponse>, Status> {
        let bake = request.into_inner().bake_id;
        Ok(Response::new(self.0.handle.ask(|respond| Ask::Explain { bake, respond }).await?))
    }
}

async fn snapshot(handle: &Handle, bake: &str) -> Result<v1::Bake, Status> {
    let bake = bake.to_owned();
    handle.ask(|respond| Ask::Get { bake, respond }).await
}

/// Sends what happens to a bake until it has ended, the watcher has gone, or the coordinator stops.
async fn watch(
    handle: &Handle,
    bake: &str,
    mut after: u64,
    watching: Watching,
    responses: &mpsc::Sender<Result<v1::WatchBakeResponse, Status>>,
) -> Result<(), Status> {
    use v1::watch_bake_response::Event;
    let Watching { events, ended } = watching;
    let mut last = events.subscribe();
    // Of a bake that has ended nothing more comes: a watcher that knows its last event is told the end again.
    let mut found = if ended { Found::Gap } else { events.after(after) };
    loop {
        let send = match found {
            Found::Events(list) => list,
            Found::Gap => {
                let bake = snapshot(handle, bake).await?;
                vec![v1::WatchBakeResponse { number: bake.last_event, event: Some(Event::Snapshot(bake)) }]
            }
        };
        for response in send {
            after = response.number;
            let is_end = matches!(&response.event, Some(Event::Snapshot(bake)) if bake.has_ended());
            if responses.send(Ok(response)).await.is_err() || is_end {
                return Ok(());
            }
        }
        tokio::select! {
            _ = last.changed() => {}
            () = responses.closed() => return Ok(()),
            () = handle.closed() => return Ok(()),
        }
        found = events.after(after);
    }
}
