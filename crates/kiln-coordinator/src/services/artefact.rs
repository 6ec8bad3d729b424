//! ArtefactService.

use super::{Context, Responses};
use crate::error::store_status;
use bytes::Bytes;
use kiln_core::Digest;
use kiln_proto::{FieldError, digest, limits, required, status, v1};
use kiln_store::{Store, StoreError};
use std::{sync::Arc, time::Duration};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Request, Response, Status, Streaming};
use v1::{artefact_service_server::ArtefactService, upload_request::Part};

/// Chunks that wait for a client's connection.
const CHUNKS: usize = 4;

/// A client that sends nothing for this long has gone.
const UPLOAD_SILENCE: Duration = Duration::from_secs(60);

/// Artefacts up to this size are read whole and checked before a byte is sent; of larger ones ranges are read, and
/// the client's check counts.
const WHOLE_BYTES: u64 = 64 << 20;

#[derive(Clone, Debug)]
pub(crate) struct Artefacts(pub(crate) Context);

#[tonic::async_trait]
impl ArtefactService for Artefacts {
    async fn find_missing(
        &self,
        request: Request<v1::FindMissingRequest>,
    ) -> Result<Response<v1::FindMissingResponse>, Status> {
        let digests = request.into_inner().checked()?;
        let missing = self.0.store(move |store| store.missing(&digests)).await?;
        let missing = missing.iter().map(|digest| digest.0.to_vec()).collect();
        Ok(Response::new(v1::FindMissingResponse { missing }))
    }

    async fn upload(
        &self,
        request: Request<Streaming<v1::UploadRequest>>,
    ) -> Result<Response<v1::UploadResponse>, Status> {
        let mut parts = request.into_inner();
        let Some(Part::Manifest(manifest)) = next(&mut parts).await? else {
            return Err(FieldError::new("part", "is not the manifest, which comes first").into());
        };
        let entries = manifest.checked()?;
        let state = self.0.store(move |store| store.upload_begin(&entries)).await?;
        let id = state.id;
        while let Some(part) = next(&mut parts).await? {
            let Part::Chunk(chunk) = part else {
                return Err(FieldError::new("part", "is a second manifest").into());
            };
            if chunk.data.len() > limits::CHUNK_BYTES {
                let problem = format!("has {} bytes; a chunk has at most {}", chunk.data.len(), limits::CHUNK_BYTES);
                return Err(FieldError::new("chunk.data", problem).into());
            }
            self.0.store(move |store| store.upload_append(&id, chunk.offset, &chunk.data)).await?;
        }
        self.0.store(move |store| store.upload_finish(&id)).await?;
        Ok(Response::new(v1::UploadResponse { bytes: state.total_bytes }))
    }

    async fn query_upload(
        &self,
        request: Request<v1::QueryUploadRequest>,
    ) -> Result<Response<v1::QueryUploadResponse>, Status> {
        let entries = required("manifest", request.into_inner().manifest)?.checked()?;
        let state = self.0.store(move |store| store.upload_begin(&entries)).await?;
        Ok(Response::new(v1::QueryUploadResponse { offset: state.committed_bytes }))
    }

    type DownloadStream = Responses<v1::DownloadResponse>;

    async fn download(&self, request: Request<v1::DownloadRequest>) -> Result<Response<Self::DownloadStream>, Status> {
        let ranges = ranges(&request.into_inner())?;
        let (responses, stream) = mpsc::channel(CHUNKS);
        let store = Arc::clone(&self.0.store);
        tokio::task::spawn_blocking(move || {
            for (i, range) in ranges.iter().enumerate() {
                if let Err(end) = send_range(&store, i as u32, range, &responses) {
                    if let End::Failed(status) = end {
                        // A client that has gone away does not want the error.
                        let _ = responses.blocking_send(Err(status));
                    }
                    return;
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(stream)))
    }
}

/// The next part of an upload; `None` at its end.
async fn next(parts: &mut Streaming<v1::UploadRequest>) -> Result<Option<Part>, Status> {
    let silent = |_| status::error(Code::DeadlineExceeded, "UPLOAD_SILENT", "nothing came for a minute; upload again");
    match tokio::time::timeout(UPLOAD_SILENCE, parts.message()).await.map_err(silent)?? {
        None => Ok(None),
        Some(request) => Ok(Some(required("part", request.part)?)),
    }
}

/// Bytes of an artefact.
#[derive(Clone, Copy, Debug)]
struct Range {
    digest: Digest,
    offset: u64,
    /// 0 for all that follow.
    length: u64,
}

fn ranges(request: &v1::DownloadRequest) -> Result<Vec<Range>, FieldError> {
    if request.ranges.len() > limits::ARTEFACTS {
        let problem = format!("has {} entries; at most {} are taken", request.ranges.len(), limits::ARTEFACTS);
        return Err(FieldError::new("ranges", problem));
    }
    let range = |(i, range): (usize, &v1::DownloadRange)| {
        let digest = digest(&format!("ranges[{i}].digest"), &range.digest)?;
        Ok(Range { digest, offset: range.offset, length: range.length })
    };
    request.ranges.iter().enumerate().map(range).collect()
}

/// Why no more is sent.
enum End {
    /// The client has gone.
    Gone,
    Failed(Status),
}

impl From<StoreError> for End {
    fn from(error: StoreError) -> Self {
        Self::Failed(store_status(&error))
    }
}

fn send_range(
    store: &Store,
    index: u32,
    range: &Range,
    responses: &mpsc::Sender<Result<v1::DownloadResponse, Status>>,
) -> Result<(), End> {
    let missing = || {
        let message = format!("the store does not have the artefact {}", range.digest);
        End::Failed(status::error(Code::NotFound, "ARTEFACT_MISSING", message))
    };
    let size = store.size(&range.digest)?.ok_or_else(missing)?;
    let end = if range.length == 0 { size } else { range.offset.saturating_add(range.length) };
    if range.offset > size || end > size {
        return Err(End::from(StoreError::OutOfRange {
            digest: range.digest,
            offset: range.offset,
            len: end.saturating_sub(range.offset),
            bytes: size,
        }));
    }
    let whole = match size <= WHOLE_BYTES {
        true => Some(Bytes::from(store.get(&range.digest)?.ok_or_else(missing)?)),
        false => None,
    };
    let mut offset = range.offset;
    loop {
        let length = (end - offset).min(limits::CHUNK_BYTES as u64);
        let data = match &whole {
            Some(bytes) => bytes.slice(offset as usize..(offset + length) as usize),
            None => Bytes::from(store.read_range(&range.digest, offset, length)?.ok_or_else(missing)?),
        };
        let last = offset + length == end;
        let response = v1::DownloadResponse { range: index, offset, data, last };
        responses.blocking_send(Ok(response)).map_err(|_| End::Gone)?;
        offset += length;
        if last {
            return Ok(());
        }
    }
}
