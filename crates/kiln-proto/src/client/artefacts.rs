//! Moving artefacts: only what is missing goes up, in chunks; what comes down is checked against its digest.

use super::{ClientError, Farm, backoff, retrying};
use crate::{digest, limits, v1};
use bytes::{Bytes, BytesMut};
use kiln_core::Digest;
use std::collections::BTreeSet;
use tonic::{Code, Status};

impl Farm {
    /// Which of these artefacts the farm does not have, in the order given, each once.
    pub async fn find_missing(&self, digests: &[Digest]) -> Result<Vec<Digest>, ClientError> {
        const ACTION: &str = "look for artefacts";
        let mut missing = Vec::new();
        let mut seen = BTreeSet::new();
        let distinct: Vec<Digest> = digests.iter().copied().filter(|&digest| seen.insert(digest)).collect();
        for part in distinct.chunks(limits::ARTEFACTS) {
            let request = v1::FindMissingRequest { digests: part.iter().map(|digest| digest.0.to_vec()).collect() };
            let call = || async { Ok(self.artefacts().find_missing(request.clone()).await?.into_inner()) };
            for bytes in retrying(ACTION, call).await?.missing {
                let found = digest("missing", &bytes);
                missing.push(found.map_err(|source| ClientError::Malformed { action: ACTION, source })?);
            }
        }
        Ok(missing)
    }

    /// Stores artefacts on the farm, those that it has not yet; durable on return. Returns their digests in the
    /// order given.
    pub async fn upload(&self, artefacts: &[Bytes]) -> Result<Vec<Digest>, ClientError> {
        let digests: Vec<Digest> = artefacts.iter().map(|bytes| Digest::of(bytes)).collect();
        let missing: BTreeSet<Digest> = self.find_missing(&digests).await?.into_iter().collect();
        let mut sent = BTreeSet::new();
        let wanted = digests.iter().zip(artefacts);
        let wanted: Vec<(Digest, Bytes)> = wanted
            .filter(|(digest, _)| missing.contains(digest) && sent.insert(**digest))
            .map(|(digest, bytes)| (*digest, bytes.clone()))
            .collect();
        for part in wanted.chunks(limits::ARTEFACTS) {
            self.upload_all(part).await?;
        }
        Ok(digests)
    }

    async fn upload_all(&self, artefacts: &[(Digest, Bytes)]) -> Result<(), ClientError> {
        const ACTION: &str = "upload artefacts";
        let entries: Vec<(Digest, u64)> = artefacts.iter().map(|(d, bytes)| (*d, bytes.len() as u64)).collect();
        let manifest = v1::UploadManifest::new(&entries);
        let (mut attempt, mut offset) = (0, 0);
        loop {
            let parts = parts(manifest.clone(), artefacts, offset);
            let answer = self.artefacts().upload(tokio_stream::iter(parts)).await;
            let Err(status) = answer else { return Ok(()) };
            backoff(ACTION, status, &mut attempt).await?;
            let query = v1::QueryUploadRequest { manifest: Some(manifest.clone()) };
            let call = || async { Ok(self.artefacts().query_upload(query.clone()).await?.into_inner().offset) };
            offset = retrying(ACTION, call).await?;
        }
    }

    /// Reads one artefact.
    pub async fn download(&self, digest: Digest) -> Result<Bytes, ClientError> {
        let mut all = self.download_all(&[digest]).await?;
        all.pop().ok_or(ClientError::Missing { digest })
    }

    /// Reads several artefacts in one call, in the order given, each checked against its digest.
    pub async fn download_all(&self, digests: &[Digest]) -> Result<Vec<Bytes>, ClientError> {
        let mut all = Vec::with_capacity(digests.len());
        for part in digests.chunks(limits::ARTEFACTS) {
            let mut download = Download::new(part);
            let mut attempt = 0;
            while let Err(status) = download.run(self).await {
                if status.code() == Code::NotFound {
                    return Err(ClientError::Missing { digest: part[download.done.len().min(part.len() - 1)] });
                }
                backoff("download artefacts", status, &mut attempt).await?;
            }
            for (&expected, bytes) in part.iter().zip(download.done) {
                let found = Digest::of(&bytes);
                if found != expected {
                    return Err(ClientError::Damaged { expected, found });
                }
                all.push(bytes);
            }
        }
        Ok(all)
    }
}

/// The messages of an upload from an offset on, made as they are sent; chunks share the artefacts' memory.
fn parts(
    manifest: v1::UploadManifest,
    artefacts: &[(Digest, Bytes)],
    from: u64,
) -> impl Iterator<Item = v1::UploadRequest> + Send + 'static {
    use v1::upload_request::Part;
    let placed = artefacts.iter().scan(0u64, |end, (_, bytes)| {
        let start = *end;
        *end += bytes.len() as u64;
        Some((start, bytes.clone()))
    });
    let placed: Vec<(u64, Bytes)> = placed.collect();
    let chunks = placed.into_iter().flat_map(move |(start, bytes)| {
        let skip = from.saturating_sub(start).min(bytes.len() as u64) as usize;
        (skip..bytes.len()).step_by(limits::CHUNK_BYTES).map(move |at| {
            let data = bytes.slice(at..bytes.len().min(at + limits::CHUNK_BYTES));
            Part::Chunk(v1::UploadChunk { offset: start + at as u64, data })
        })
    });
    std::iter::once(Part::Manifest(manifest)).chain(chunks).map(|part| v1::UploadRequest { part: Some(part) })
}

/// A download under way: what is complete, and the beginning of the next artefact, kept over broken connections.
#[derive(Debug)]
struct Download {
    digests: Vec<Digest>,
    done: Vec<Bytes>,
    partial: BytesMut,
}

impl Download {
    fn new(digests: &[Digest]) -> Self {
        Self { digests: digests.to_vec(), done: Vec::new(), partial: BytesMut::new() }
    }

    /// Asks for all that is not there yet, and takes what comes.
    async fn run(&mut self, farm: &Farm) -> Result<(), Status> {
        let first = self.done.len();
        if first == self.digests.len() {
            return Ok(());
        }
        let range = |(i, digest): (usize, &Digest)| v1::DownloadRange {
            digest: digest.0.to_vec(),
            offset: if i == 0 { self.partial.len() as u64 } else { 0 },
            length: 0,
        };
        let ranges = self.digests[first..].iter().enumerate().map(range).collect();
        let mut stream = farm.artefacts().download(v1::DownloadRequest { ranges }).await?.into_inner();
        while let Some(chunk) = stream.message().await? {
            self.take(first, &chunk)?;
        }
        if self.done.len() < self.digests.len() {
            return Err(Status::unavailable("the download ended early"));
        }
        Ok(())
    }

    fn take(&mut self, first: usize, chunk: &v1::DownloadResponse) -> Result<(), Status> {
        let in_order = first + chunk.range as usize == self.done.len() && self.done.len() < self.digests.len();
        let size = self.partial.len() as u64 + chunk.data.len() as u64;
        if !in_order || chunk.offset != self.partial.len() as u64 || size > limits::ARTEFACT_BYTES {
            return Err(Status::data_loss("the farm sent bytes that do not follow those before"));
        }
        self.partial.extend_from_slice(&chunk.data);
        if chunk.last {
            self.done.push(self.partial.split().freeze());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use v1::upload_request::Part;

    fn chunks(artefacts: &[Bytes], from: u64) -> Vec<(u64, Bytes)> {
        let named: Vec<_> = artefacts.iter().map(|bytes| (Digest::of(bytes), bytes.clone())).collect();
        let parts = parts(v1::UploadManifest::default(), &named, from);
        let chunks = parts.filter_map(|request| match request.part {
            Some(Part::Chunk(chunk)) => Some((chunk.offset, chunk.data)),
            _ => None,
        });
        chunks.collect()
    }

    #[test]
    fn chunks_cover_the_artefacts_from_any_offset() {
        let big = Bytes::from((0..2_500_000u32).map(|i| i as u8).collect::<Vec<_>>());
        let artefacts = [Bytes::from_static(b"first"), Bytes::new(), big, Bytes::from_static(b"last")];
        let whole: Vec<u8> = artefacts.iter().flat_map(|bytes| bytes.to_vec()).collect();
        for from in [0, 3, 5, 1_000_000, 1_048_581, whole.len() - 1, whole.len()] {
            let mut at = from;
            for (offset, data) in chunks(&artefacts, from as u64) {
                assert_eq!(offset as usize, at);
                assert!(data.len() <= limits::CHUNK_BYTES && !data.is_empty());
                assert_eq!(data, whole[at..at + data.len()]);
                at += data.len();
            }
            assert_eq!(at, whole.len());
        }
    }

    #[test]
    fn a_download_takes_only_what_follows() {
        let mut download = Download::new(&[Digest::of(b"ab"), Digest::of(b"")]);
        let chunk = |range, offset, data: &'static [u8], last| v1::DownloadResponse {
            range,
            offset,
            data: Bytes::from_static(data),
            last,
        };
        assert!(download.take(0, &chunk(1, 0, b"a", false)).is_err());
        download.take(0, &chunk(0, 0, b"a", false)).unwrap();
        assert!(download.take(0, &chunk(0, 0, b"a", false)).is_err());
        download.take(0, &chunk(0, 1, b"b", true)).unwrap();
        // After a reconnect the ranges are counted from the first that is missing.
        download.take(1, &chunk(0, 0, b"", true)).unwrap();
        assert_eq!(download.done, [Bytes::from_static(b"ab"), Bytes::new()]);
        assert!(download.take(1, &chunk(1, 0, b"", true)).is_err());
    }
}
