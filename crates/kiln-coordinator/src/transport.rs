//! The in-memory transport: connections are pairs of buffers in this process, and everything above them is the
//! same as over TCP.

use hyper_util::rt::TokioIo;
use std::io;
use tokio::{io::DuplexStream, sync::mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::{Channel, Endpoint, Uri};

/// Bytes that one direction of a connection holds before its writer waits: two chunks of an artefact.
const BUFFER_BYTES: usize = 2 << 20;

/// Connections that wait to be accepted.
const BACKLOG: usize = 16;

/// The coordinator's end: pass it to [`crate::Coordinator::serve`].
pub type InMemoryIncoming = ReceiverStream<io::Result<DuplexStream>>;

/// The client's end: makes channels to the coordinator.
#[derive(Clone, Debug)]
pub struct InMemoryConnector {
    connections: mpsc::Sender<io::Result<DuplexStream>>,
}

/// A transport within this process.
pub fn in_memory() -> (InMemoryIncoming, InMemoryConnector) {
    let (connections, accepted) = mpsc::channel(BACKLOG);
    (ReceiverStream::new(accepted), InMemoryConnector { connections })
}

impl InMemoryConnector {
    /// A connection as such.
    pub async fn connect(&self) -> io::Result<DuplexStream> {
        let (near, far) = tokio::io::duplex(BUFFER_BYTES);
        let stopped = |_| io::Error::new(io::ErrorKind::ConnectionRefused, "the coordinator has stopped");
        self.connections.send(Ok(far)).await.map_err(stopped)?;
        Ok(near)
    }

    /// A channel of its own connection, made on the first call and again after it broke.
    pub fn channel(&self) -> Channel {
        let connector = self.clone();
        let connect = tower::service_fn(move |_: Uri| {
            let connector = connector.clone();
            async move { connector.connect().await.map(TokioIo::new) }
        });
        Endpoint::from_static("http://in-memory.kiln").connect_with_connector_lazy(connect)
    }
}
