//! Who may call: everyone on loopback, else those who know the token.
//!
//! Roles (submit, work, watch, admin) and TLS are not there yet: on a network that is not trusted, put a proxy
//! with TLS in front of the coordinator, or a tunnel between the machines.

use crate::config::Token;
use kiln_core::Digest;
use kiln_proto::status;
use std::{io, net::SocketAddr};
use tonic::{Code, Request, Status, service::Interceptor, transport::server::TcpIncoming};

/// An address on which the coordinator will not or cannot listen.
#[derive(Debug, thiserror::Error)]
pub enum ListenError {
    /// Anyone who can reach the machine could use the farm.
    #[error(
        "{address} can be reached from other machines and no token is set: anyone could use the farm; \
         give --token-file or KILN_TOKEN, or listen on 127.0.0.1"
    )]
    Open {
        /// The address.
        address: SocketAddr,
    },
    /// The system refused.
    #[error("cannot listen on {address}: {source}; is another coordinator running?")]
    Bind {
        /// The address.
        address: SocketAddr,
        /// The system's error.
        source: io::Error,
    },
}

/// Listens on an address; without a token on loopback only. Port 0 takes any free port: see
/// [`TcpIncoming::local_addr`].
pub fn listen(address: SocketAddr, token: Option<&Token>) -> Result<TcpIncoming, ListenError> {
    if token.is_none() && !address.ip().is_loopback() {
        return Err(ListenError::Open { address });
    }
    let incoming = TcpIncoming::bind(address).map_err(|source| ListenError::Bind { address, source })?;
    Ok(incoming.with_nodelay(Some(true)))
}

/// Checks the bearer token of each call.
#[derive(Clone, Debug)]
pub(crate) struct Gate(Option<Digest>);

impl Gate {
    pub(crate) fn new(token: Option<&Token>) -> Self {
        Self(token.map(|token| Digest::of(token.secret().as_bytes())))
    }
}

impl Interceptor for Gate {
    fn call(&mut self, request: Request<()>) -> Result<Request<()>, Status> {
        let Some(expected) = self.0 else { return Ok(request) };
        let given = request.metadata().get("authorization").and_then(|value| value.to_str().ok());
        let given = given.and_then(|value| value.strip_prefix("Bearer "));
        // Digests are compared, so that the time tells nothing about how much of a guess was right.
        if given.is_some_and(|token| Digest::of(token.as_bytes()) == expected) {
            return Ok(request);
        }
        let message =
            "the farm asks for a token, and this call has none or a wrong one; give --token-file or KILN_TOKEN";
        Err(status::error(Code::Unauthenticated, "TOKEN_REQUIRED", message))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_token_opens_the_gate() {
        let token = Token::new("0123456789abcdef").unwrap();
        let with = |value: &str| {
            let mut request = Request::new(());
            request.metadata_mut().insert("authorization", value.parse().unwrap());
            request
        };
        let mut gate = Gate::new(Some(&token));
        assert!(gate.call(with("Bearer 0123456789abcdef")).is_ok());
        for bad in ["Bearer 0123456789abcdeF", "0123456789abcdef", "Bearer "] {
            assert_eq!(gate.call(with(bad)).unwrap_err().code(), Code::Unauthenticated);
        }
        assert!(gate.call(Request::new(())).is_err());
        assert!(Gate::new(None).call(Request::new(())).is_ok());
    }

    #[tokio::test]
    async fn an_open_address_needs_a_token() {
        let open = "0.0.0.0:0".parse().unwrap();
        assert!(matches!(listen(open, None), Err(ListenError::Open { .. })));
        assert!(listen("127.0.0.1:0".parse().unwrap(), None).is_ok());
        assert!(listen(open, Some(&Token::new("0123456789abcdef").unwrap())).is_ok());
    }
}
