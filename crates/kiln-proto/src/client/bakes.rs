//! Submitting, watching and steering bakes.

use super::{ClientError, Farm, backoff, retrying};
use crate::{FieldError, Submission, limits, required, status, v1};
use bytes::Bytes;
use kiln_core::Digest;
use prost::Message;
use std::collections::BTreeMap;
use tonic::Streaming;

impl Farm {
    /// Submits a bake whose files are on the farm. Safe to repeat: the request id names it. The flag says whether
    /// the id was known already.
    pub async fn submit(&self, submission: &Submission) -> Result<(v1::Bake, bool), ClientError> {
        let request = v1::SubmitBakeRequest::from(submission);
        let (bytes, limit) = (request.encoded_len(), limits::MESSAGE_BYTES);
        if bytes > limit {
            return Err(ClientError::TooLarge { action: "submit the bake", bytes, limit });
        }
        let call = || async { Ok(self.bakes().submit_bake(request.clone()).await?.into_inner()) };
        let response = retrying("submit the bake", call).await?;
        Ok((bake("submit the bake", response.bake)?, response.repeated))
    }

    /// Uploads those files of a submission that the farm does not have, and submits it.
    pub async fn submit_with_files(
        &self,
        submission: &Submission,
        files: &BTreeMap<Digest, Bytes>,
    ) -> Result<(v1::Bake, bool), ClientError> {
        let blobs: Vec<Bytes> = files.values().cloned().collect();
        self.upload(&blobs).await?;
        match self.submit(submission).await {
            // The farm tidied up between the upload and the submission.
            Err(error) if error.reason().as_deref() == Some(status::SOURCE_MISSING) => {
                self.upload(&blobs).await?;
                self.submit(submission).await
            }
            answer => answer,
        }
    }

    /// The present state of a bake.
    pub async fn bake(&self, bake_id: &str) -> Result<v1::Bake, ClientError> {
        let call = || async {
            let request = v1::GetBakeRequest { bake_id: bake_id.to_owned() };
            Ok(self.bakes().get_bake(request).await?.into_inner().bake)
        };
        bake("show the bake", retrying("show the bake", call).await?)
    }

    /// A page of bakes, the latest first, and the token of the next page, if there is one.
    pub async fn list(
        &self,
        page_size: u32,
        page_token: &str,
        active_only: bool,
    ) -> Result<(Vec<v1::Bake>, Option<String>), ClientError> {
        let request = v1::ListBakesRequest { page_size, page_token: page_token.to_owned(), active_only };
        let call = || async { Ok(self.bakes().list_bakes(request.clone()).await?.into_inner()) };
        let page = retrying("list the bakes", call).await?;
        let next = Some(page.next_page_token).filter(|token| !token.is_empty());
        Ok((page.bakes, next))
    }

    /// Stops a bake.
    pub async fn cancel(&self, bake_id: &str) -> Result<v1::Bake, ClientError> {
        let call = || async {
            let request = v1::CancelBakeRequest { bake_id: bake_id.to_owned() };
            Ok(self.bakes().cancel_bake(request).await?.into_inner().bake)
        };
        bake("cancel the bake", retrying("cancel the bake", call).await?)
    }

    /// Holds a bake's tasks back.
    pub async fn pause(&self, bake_id: &str) -> Result<v1::Bake, ClientError> {
        let call = || async {
            let request = v1::PauseBakeRequest { bake_id: bake_id.to_owned() };
            Ok(self.bakes().pause_bake(request).await?.into_inner().bake)
        };
        bake("pause the bake", retrying("pause the bake", call).await?)
    }

    /// Lets a paused bake go on.
    pub async fn resume(&self, bake_id: &str) -> Result<v1::Bake, ClientError> {
        let call = || async {
            let request = v1::ResumeBakeRequest { bake_id: bake_id.to_owned() };
            Ok(self.bakes().resume_bake(request).await?.into_inner().bake)
        };
        bake("resume the bake", retrying("resume the bake", call).await?)
    }

    /// Why a bake is not running, one sentence for each reason.
    pub async fn explain(&self, bake_id: &str) -> Result<Vec<String>, ClientError> {
        let call = || async {
            let request = v1::ExplainBakeRequest { bake_id: bake_id.to_owned() };
            Ok(self.bakes().explain_bake(request).await?.into_inner().reasons)
        };
        retrying("explain the bake", call).await
    }

    /// The workers of the farm.
    pub async fn list_workers(&self) -> Result<Vec<v1::Worker>, ClientError> {
        let mut workers = Vec::new();
        let mut page_token = String::new();
        loop {
            let request = v1::ListWorkersRequest { page_size: limits::PAGE, page_token };
            let call = || async { Ok(self.state().list_workers(request.clone()).await?.into_inner()) };
            let page = retrying("list the workers", call).await?;
            workers.extend(page.workers);
            if page.next_page_token.is_empty() {
                return Ok(workers);
            }
            page_token = page.next_page_token;
        }
    }

    /// Totals of the farm.
    pub async fn stats(&self) -> Result<v1::FarmStats, ClientError> {
        let call = || async { Ok(self.state().get_stats(v1::GetStatsRequest {}).await?.into_inner().stats) };
        let stats = retrying("show the farm", call).await?;
        required("stats", stats).map_err(|source| ClientError::Malformed { action: "show the farm", source })
    }

    /// Watches a bake from a snapshot on, until it has ended.
    pub fn watch(&self, bake_id: &str) -> Watch {
        Watch { farm: self.clone(), bake_id: bake_id.to_owned(), after_event: 0, stream: None, ended: false }
    }
}

/// What a watcher is told.
#[derive(Clone, Debug, PartialEq)]
pub enum BakeUpdate {
    /// The whole state, in place of what was known.
    Snapshot(Box<v1::Bake>),
    /// A stage went on.
    Progress(v1::StageProgress),
    /// Something worth saying.
    Warning(v1::Warning),
    /// An attempt at a task failed and will be made again.
    AttemptFailed(v1::AttemptFailed),
}

/// Events of a bake. A broken connection is taken up where it broke.
#[derive(Debug)]
pub struct Watch {
    farm: Farm,
    bake_id: String,
    after_event: u64,
    stream: Option<Streaming<v1::WatchBakeResponse>>,
    ended: bool,
}

impl Watch {
    /// The next update; `None` after the snapshot of the bake's end. Cancel safe: what was not returned is sent
    /// again.
    pub async fn next(&mut self) -> Result<Option<BakeUpdate>, ClientError> {
        let mut attempt = 0;
        while !self.ended {
            match self.receive().await {
                Ok(Some(update)) => return Ok(Some(update)),
                // The farm ended the stream before the bake ended: it is stopping.
                Ok(None) => {
                    self.stream = None;
                    let status = tonic::Status::unavailable("the farm ended the stream");
                    backoff("watch the bake", status, &mut attempt).await?;
                }
                Err(status) => {
                    self.stream = None;
                    backoff("watch the bake", status, &mut attempt).await?;
                }
            }
        }
        Ok(None)
    }

    /// Waits for the bake's end and returns its last state.
    pub async fn end(mut self) -> Result<v1::Bake, ClientError> {
        let mut last = None;
        while let Some(update) = self.next().await? {
            if let BakeUpdate::Snapshot(bake) = update {
                last = Some(*bake);
            }
        }
        bake("watch the bake", last)
    }

    async fn receive(&mut self) -> Result<Option<BakeUpdate>, tonic::Status> {
        let stream = match &mut self.stream {
            Some(stream) => stream,
            none => {
                let request = v1::WatchBakeRequest { bake_id: self.bake_id.clone(), after_event: self.after_event };
                none.insert(self.farm.bakes().watch_bake(request).await?.into_inner())
            }
        };
        let Some(response) = stream.message().await? else { return Ok(None) };
        use v1::watch_bake_response::Event;
        let update = match response.event {
            Some(Event::Snapshot(bake)) => {
                self.ended = bake.has_ended();
                BakeUpdate::Snapshot(Box::new(bake))
            }
            Some(Event::Progress(progress)) => BakeUpdate::Progress(progress),
            Some(Event::Warning(warning)) => BakeUpdate::Warning(warning),
            Some(Event::AttemptFailed(failed)) => BakeUpdate::AttemptFailed(failed),
            None => {
                let problem = FieldError::new("event", "is missing or unknown");
                return Err(status::invalid(&problem));
            }
        };
        self.after_event = response.number;
        Ok(Some(update))
    }
}

fn bake(action: &'static str, bake: Option<v1::Bake>) -> Result<v1::Bake, ClientError> {
    required("bake", bake).map_err(|source| ClientError::Malformed { action, source })
}
