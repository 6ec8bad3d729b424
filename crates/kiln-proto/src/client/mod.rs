//! A typed client of the farm: what the command line and the workers call it through.
//!
//! A [`Farm`] is a channel, a token and the message limits; cloning it is cheap. Calls that are safe to repeat are
//! repeated a few times when the connection breaks; an error that would be the same again comes back at once.

mod artefacts;
mod bakes;

pub use bakes::{BakeUpdate, Watch};

use crate::{FieldError, limits, status, v1};
use kiln_core::Digest;
use std::time::Duration;
use tonic::{
    Request, Status,
    metadata::{Ascii, MetadataValue},
    service::{Interceptor, interceptor::InterceptedService},
    transport::{Channel, Endpoint},
};
use v1::{
    artefact_service_client::ArtefactServiceClient, bake_service_client::BakeServiceClient,
    farm_service_client::FarmServiceClient, worker_service_client::WorkerServiceClient,
};

/// Times that a call is tried when the connection breaks.
const ATTEMPTS: u32 = 6;

/// A call to the farm failed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The address is no URL of a farm.
    #[error("{address:?} is no address of a farm; it looks like http://host:7480")]
    Address {
        /// The text that was given.
        address: String,
    },
    /// The token has characters that no header can carry.
    #[error("the token is not visible ASCII; give it as one line without spaces")]
    Token,
    /// Nobody answers.
    #[error("cannot reach the farm to {action}: {reason}; check the address, and that `kiln serve` runs there")]
    Unreachable {
        /// What was tried.
        action: &'static str,
        /// What the transport said.
        reason: String,
    },
    /// The farm says no.
    #[error("the farm refused to {action}: {}", .status.message())]
    Refused {
        /// What was tried.
        action: &'static str,
        /// Its words and details; see [`status`].
        status: Status,
    },
    /// A request is larger than the farm takes; it is not sent.
    #[error(
        "the request to {action} has {bytes} bytes, and the farm takes at most {limit}; give the level fewer files or shorter paths"
    )]
    TooLarge {
        /// What was tried.
        action: &'static str,
        /// Size of the request.
        bytes: usize,
        /// The most that is taken.
        limit: usize,
    },
    /// An artefact is not on the farm.
    #[error(
        "the farm does not have the artefact {digest}; the bake that made it may have been forgotten: submit it again"
    )]
    Missing {
        /// The artefact.
        digest: Digest,
    },
    /// Bytes that came are not what was asked for.
    #[error("the artefact {expected} arrived as {found}; the connection or the farm's disk is at fault: try again")]
    Damaged {
        /// What was asked for.
        expected: Digest,
        /// What came.
        found: Digest,
    },
    /// The farm's answer makes no sense.
    #[error("the farm's answer to {action} makes no sense ({source}); is it of another version of Kiln?")]
    Malformed {
        /// What was tried.
        action: &'static str,
        /// The field at fault.
        source: FieldError,
    },
}

impl ClientError {
    /// Whether the farm could not be reached, as opposed to what it said.
    pub fn is_unreachable(&self) -> bool {
        matches!(self, Self::Unreachable { .. } | Self::Address { .. })
    }

    /// The stable reason that the farm gave, such as `BAKE_NOT_FOUND`.
    pub fn reason(&self) -> Option<String> {
        match self {
            Self::Refused { status, .. } => status::reason(status),
            _ => None,
        }
    }

    fn new(action: &'static str, status: Status) -> Self {
        if status::is_transient(&status) && status::reason(&status).is_none() {
            let source = std::error::Error::source(&status).map_or(String::new(), |source| format!(" ({source})"));
            return Self::Unreachable { action, reason: format!("{}{source}", status.message()) };
        }
        Self::Refused { action, status }
    }
}

/// Adds the bearer token to each call.
#[derive(Clone, Debug, Default)]
pub struct Bearer(Option<MetadataValue<Ascii>>);

impl Bearer {
    /// A bearer of this token, or of none.
    pub fn new(token: Option<&str>) -> Result<Self, ClientError> {
        let Some(token) = token else { return Ok(Self(None)) };
        let mut value: MetadataValue<Ascii> = format!("Bearer {token}").parse().map_err(|_| ClientError::Token)?;
        value.set_sensitive(true);
        Ok(Self(Some(value)))
    }
}

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(value) = &self.0 {
            request.metadata_mut().insert("authorization", value.clone());
        }
        Ok(request)
    }
}

/// A channel that carries the token.
pub type Transport = InterceptedService<Channel, Bearer>;

/// The farm, as its clients see it.
#[derive(Clone, Debug)]
pub struct Farm {
    transport: Transport,
}

impl Farm {
    /// A farm over a channel that exists, such as one in memory.
    pub fn over(channel: Channel, bearer: Bearer) -> Self {
        Self { transport: InterceptedService::new(channel, bearer) }
    }

    /// A farm at an address such as `http://host:7480`; connects on the first call, and again when needed.
    pub fn at(address: &str, bearer: Bearer) -> Result<Self, ClientError> {
        Ok(Self::over(endpoint(address)?.connect_lazy(), bearer))
    }

    /// Like [`Self::at`], but connects now.
    pub async fn connect(address: &str, bearer: Bearer) -> Result<Self, ClientError> {
        let channel = endpoint(address)?.connect().await.map_err(|error| {
            let source = std::error::Error::source(&error).map_or_else(|| error.to_string(), ToString::to_string);
            ClientError::Unreachable { action: "connect", reason: source }
        })?;
        Ok(Self::over(channel, bearer))
    }

    /// The generated client of bakes, with the limits set.
    pub fn bakes(&self) -> BakeServiceClient<Transport> {
        BakeServiceClient::new(self.transport.clone())
            .max_decoding_message_size(limits::MESSAGE_BYTES)
            .max_encoding_message_size(limits::MESSAGE_BYTES)
    }

    /// The generated client of artefacts, with the limits set.
    pub fn artefacts(&self) -> ArtefactServiceClient<Transport> {
        ArtefactServiceClient::new(self.transport.clone())
            .max_decoding_message_size(limits::CHUNK_MESSAGE_BYTES)
            .max_encoding_message_size(limits::CHUNK_MESSAGE_BYTES)
    }

    /// The generated client of workers, with the limits set.
    pub fn workers(&self) -> WorkerServiceClient<Transport> {
        WorkerServiceClient::new(self.transport.clone())
            .max_decoding_message_size(limits::SESSION_MESSAGE_BYTES)
            .max_encoding_message_size(limits::SESSION_MESSAGE_BYTES)
    }

    /// The generated client of the farm's state, with the limits set.
    pub fn state(&self) -> FarmServiceClient<Transport> {
        FarmServiceClient::new(self.transport.clone())
            .max_decoding_message_size(limits::MESSAGE_BYTES)
            .max_encoding_message_size(limits::MESSAGE_BYTES)
    }
}

/// The endpoint of a farm: windows that fit chunks, and pings rare enough that no server minds.
pub fn endpoint(address: &str) -> Result<Endpoint, ClientError> {
    let error = || ClientError::Address { address: address.to_owned() };
    let url = if address.contains("://") { address.to_owned() } else { format!("http://{address}") };
    let endpoint = Endpoint::from_shared(url).map_err(|_| error())?;
    if endpoint.uri().host().is_none() || endpoint.uri().scheme_str() != Some("http") {
        return Err(error());
    }
    Ok(endpoint
        .connect_timeout(Duration::from_secs(10))
        .tcp_keepalive(Some(Duration::from_secs(30)))
        .http2_keep_alive_interval(Duration::from_secs(300))
        .initial_stream_window_size(4 << 20)
        .initial_connection_window_size(16 << 20))
}

/// Calls until it works, the error is not transient, or the attempts are used up.
async fn retrying<T, F>(action: &'static str, mut call: impl FnMut() -> F) -> Result<T, ClientError>
where
    F: Future<Output = Result<T, Status>>,
{
    let mut attempt = 0;
    loop {
        match call().await {
            Ok(value) => return Ok(value),
            Err(status) => backoff(action, status, &mut attempt).await?,
        }
    }
}

/// Waits before the next attempt, or gives the error back.
async fn backoff(action: &'static str, status: Status, attempt: &mut u32) -> Result<(), ClientError> {
    *attempt += 1;
    if !status::is_transient(&status) || *attempt >= ATTEMPTS {
        return Err(ClientError::new(action, status));
    }
    let delay = status::retry_delay(&status).unwrap_or(Duration::from_millis(50 << *attempt));
    tracing::debug!(action, attempt, message = status.message(), "trying again");
    tokio::time::sleep(delay.min(Duration::from_secs(5))).await;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses() {
        assert!(endpoint("http://[::1]:7480").is_ok());
        assert!(endpoint("farm:7480").is_ok());
        for bad in ["", "http://", "https://farm:7480", "ftp://farm", "a b"] {
            assert!(matches!(endpoint(bad), Err(ClientError::Address { .. })), "{bad}");
        }
    }

    #[test]
    fn tokens_are_headers_and_never_shown() {
        assert!(Bearer::new(Some("a\nb")).is_err());
        let shown = format!("{:?}", Bearer::new(Some("hunter2")).unwrap());
        assert!(!shown.contains("hunter2"), "{shown}");
    }
}
