//! What comes out of a bake, and the requests that start one.

use crate::{
    field::{self, FieldError, at_most, digest, digests},
    limits, source, v1,
};
use kiln_core::{Baked, Digest, ErrorEstimate, SourceManifest, Warning};

impl From<&Warning> for v1::Warning {
    fn from(warning: &Warning) -> Self {
        Self {
            code: warning.code.clone(),
            subject: warning.subject.clone(),
            message: warning.message.clone(),
            count: warning.count,
        }
    }
}

impl From<&ErrorEstimate> for v1::ErrorEstimate {
    fn from(estimate: &ErrorEstimate) -> Self {
        Self { rmse: estimate.rmse, p99: estimate.p99, max: estimate.max }
    }
}

impl v1::BakeResult {
    /// The result as shown: `digest` is that of the encoded [`Baked`].
    pub fn new(digest: Digest, baked: &Baked, answered_from_store: bool) -> Self {
        Self {
            baked: digest.0.to_vec(),
            file: baked.file.0.to_vec(),
            file_bytes: baked.bytes,
            vertices: baked.summary.counts.vertices,
            faces: baked.summary.counts.faces,
            rays: baked.summary.trace.rays,
            error: baked.summary.error.iter().map(Into::into).collect(),
            answered_from_store,
        }
    }

    /// Digests of the encoded [`Baked`] and of the file.
    pub fn digests(&self) -> Result<(Digest, Digest), FieldError> {
        Ok((digest("result.baked", &self.baked)?, digest("result.file", &self.file)?))
    }
}

impl v1::Bake {
    /// Whether the bake has come to its end, good or bad.
    pub fn has_ended(&self) -> bool {
        matches!(self.state(), v1::BakeState::Succeeded | v1::BakeState::Failed | v1::BakeState::Cancelled)
    }
}

/// A submission, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Submission {
    /// Chosen by the caller; the same id returns the same bake.
    pub request_id: String,
    /// What is baked.
    pub source: SourceManifest,
    /// Which workers may trace it.
    pub backend: v1::Backend,
    /// Higher first; -100 to 100.
    pub priority: i32,
    /// What to call it.
    pub name: String,
    /// For whom.
    pub tenant: String,
}

impl From<&Submission> for v1::SubmitBakeRequest {
    fn from(submission: &Submission) -> Self {
        Self {
            request_id: submission.request_id.clone(),
            source: Some((&submission.source).into()),
            backend: submission.backend.into(),
            priority: submission.priority,
            name: submission.name.clone(),
            tenant: submission.tenant.clone(),
        }
    }
}

impl TryFrom<v1::SubmitBakeRequest> for Submission {
    type Error = FieldError;

    fn try_from(request: v1::SubmitBakeRequest) -> Result<Self, FieldError> {
        let backend = match request.backend() {
            v1::Backend::Unspecified => v1::Backend::Auto,
            backend => backend,
        };
        field::id("request_id", &request.request_id)?;
        field::text("name", &request.name, limits::NAME_BYTES)?;
        field::text("tenant", &request.tenant, limits::NAME_BYTES)?;
        if !(-100..=100).contains(&request.priority) {
            let problem = format!("is {}; it must be from -100 to 100", request.priority);
            return Err(FieldError::new("priority", problem));
        }
        Ok(Self {
            source: source::source(request.source)?,
            request_id: request.request_id,
            backend,
            priority: request.priority,
            name: request.name,
            tenant: request.tenant,
        })
    }
}

impl v1::UploadManifest {
    /// A manifest of these artefacts.
    pub fn new(entries: &[(Digest, u64)]) -> Self {
        let entries = entries.iter().map(|&(digest, bytes)| v1::ArtefactSize { digest: digest.0.to_vec(), bytes });
        Self { entries: entries.collect() }
    }

    /// The entries, checked: digests, counts and sizes.
    pub fn checked(&self) -> Result<Vec<(Digest, u64)>, FieldError> {
        at_most("manifest.entries", self.entries.len(), limits::ARTEFACTS)?;
        let entries = self.entries.iter().enumerate().map(|(i, entry)| {
            if entry.bytes > limits::ARTEFACT_BYTES {
                let problem = format!("is {}; an artefact has at most {} bytes", entry.bytes, limits::ARTEFACT_BYTES);
                return Err(FieldError::new(format!("manifest.entries[{i}].bytes"), problem));
            }
            Ok((digest(&format!("manifest.entries[{i}].digest"), &entry.digest)?, entry.bytes))
        });
        entries.collect()
    }
}

impl v1::FindMissingRequest {
    /// The digests, checked.
    pub fn checked(&self) -> Result<Vec<Digest>, FieldError> {
        digests("digests", &self.digests, limits::ARTEFACTS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::{BakeSettings, SourceFile};

    fn submission() -> Submission {
        let file = SourceFile { path: "a.glb".into(), digest: Digest::of(b"a") };
        Submission {
            request_id: "r-1".into(),
            source: SourceManifest { files: vec![file], sidecar: None, settings: BakeSettings::default() },
            backend: v1::Backend::Gpu,
            priority: -3,
            name: "Level é".into(),
            tenant: "night".into(),
        }
    }

    #[test]
    fn a_submission_and_back() {
        let submission = submission();
        assert_eq!(Submission::try_from(v1::SubmitBakeRequest::from(&submission)), Ok(submission));
    }

    #[test]
    fn errors_name_the_field() {
        let field = |change: fn(&mut v1::SubmitBakeRequest)| {
            let mut request = v1::SubmitBakeRequest::from(&submission());
            change(&mut request);
            Submission::try_from(request).unwrap_err().field
        };
        assert_eq!(field(|r| r.request_id.clear()), "request_id");
        assert_eq!(field(|r| r.request_id = "a b".into()), "request_id");
        assert_eq!(field(|r| r.priority = 101), "priority");
        assert_eq!(field(|r| r.name = "x".repeat(257)), "name");
        assert_eq!(field(|r| r.source = None), "source");
        assert_eq!(field(|r| r.source.as_mut().unwrap().files[0].path = "../x".into()), "source.files[0].path");
    }

    #[test]
    fn a_manifest_has_limits() {
        let entry = |bytes| v1::ArtefactSize { digest: vec![0; 32], bytes };
        let manifest = |entries| v1::UploadManifest { entries };
        assert_eq!(manifest(vec![entry(5)]).checked(), Ok(vec![(Digest::default(), 5)]));
        assert_eq!(manifest(vec![entry(u64::MAX)]).checked().unwrap_err().field, "manifest.entries[0].bytes");
        assert_eq!(manifest(vec![entry(0); limits::ARTEFACTS + 1]).checked().unwrap_err().field, "manifest.entries");
    }
}
