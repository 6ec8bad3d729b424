//! A coordinator as a whole: the dispatcher, and the services over whatever connections come in.

use crate::{
    access::Gate,
    config::Config,
    dispatcher::{self, Handle, Message, Running},
    error::{ServeError, StartError},
    services::{Artefacts, Bakes, Context, Farm, Workers},
};
use kiln_proto::{DESCRIPTORS, limits, v1};
use kiln_store::Store;
use std::{io, pin::pin, sync::Arc, time::Duration};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    task::JoinHandle,
};
use tokio_stream::Stream;
use tonic::{
    service::{Routes, interceptor::InterceptedService},
    transport::{Server, server::Connected},
};
use v1::{
    artefact_service_server::ArtefactServiceServer, bake_service_server::BakeServiceServer,
    farm_service_server::FarmServiceServer, worker_service_server::WorkerServiceServer,
};

/// Time that connections have to end by themselves when the coordinator stops.
const GRACE: Duration = Duration::from_secs(5);

/// Uploads that nobody has gone on with for this long are given up.
const UPLOAD_KEPT_SECS: u64 = 24 * 3600;

/// A coordinator that runs. Dropped without [`Self::serve`], it goes on in the background until the runtime ends.
#[derive(Debug)]
pub struct Coordinator {
    store: Arc<Store>,
    gate: Gate,
    handle: Handle,
    dispatcher: JoinHandle<Result<(), ServeError>>,
}

impl Coordinator {
    /// Takes the store's journal over, replays it, and takes up what was unfinished. Must be called within a tokio
    /// runtime; the store is read on a thread that may block.
    pub async fn start(store: Arc<Store>, config: Config) -> Result<Self, StartError> {
        let runtime = tokio::runtime::Handle::current();
        let gate = Gate::new(config.token.as_ref());
        let opened = Arc::clone(&store);
        let start = move || {
            opened.upload_expire(UPLOAD_KEPT_SECS)?;
            dispatcher::start(&opened, config, &runtime)
        };
        let running = tokio::task::spawn_blocking(start).await;
        let Running { handle, task } = running.map_err(|e| StartError::Thread(io::Error::other(e)))??;
        Ok(Self { store, gate, handle, dispatcher: task })
    }

    /// Serves connections until `shutdown` is there or the store cannot go on: TCP (see [`crate::listen`]) or in
    /// memory (see [`crate::in_memory`]). Then streams are ended, what was acknowledged is durable, and workers
    /// keep their work for when a coordinator is back.
    pub async fn serve<S, IO>(self, incoming: S, shutdown: impl Future<Output = ()> + Send) -> Result<(), ServeError>
    where
        S: Stream<Item = io::Result<IO>> + Send,
        IO: AsyncRead + AsyncWrite + Connected + Unpin + Send + 'static,
        IO::ConnectInfo: Clone + Send + Sync + 'static,
    {
        let routes = self.routes().await?;
        let Self { handle, mut dispatcher, .. } = self;
        let (stop_serving, stopped) = tokio::sync::oneshot::channel::<()>();
        let server = Server::builder()
            .initial_stream_window_size(4 << 20)
            .initial_connection_window_size(16 << 20)
            .http2_keepalive_interval(Some(Duration::from_secs(60)))
            .max_concurrent_streams(1024)
            .add_routes(routes)
            .serve_with_incoming_shutdown(incoming, async {
                // An error means that the sender is gone, which says the same.
                let _ = stopped.await;
            });
        let mut server = pin!(server);
        let (mut served, mut ended) = (None, None);
        tokio::select! {
            outcome = &mut server => served = Some(outcome),
            outcome = &mut dispatcher => ended = Some(outcome),
            () = shutdown => {}
        }
        // The dispatcher goes first: that ends the streams that the connections wait for.
        let _ = handle.send(Message::Stop).await;
        drop(stop_serving);
        let outcome = match ended {
            Some(outcome) => outcome,
            None => dispatcher.await,
        };
        outcome.map_err(ServeError::Dispatcher)??;
        match served {
            Some(outcome) => outcome?,
            None => match tokio::time::timeout(GRACE, server).await {
                Ok(outcome) => outcome?,
                Err(_) => tracing::warn!("some connections did not end by themselves and were cut"),
            },
        }
        Ok(())
    }

    async fn routes(&self) -> Result<Routes, ServeError> {
        let context = Context { handle: self.handle.clone(), store: Arc::clone(&self.store) };
        let bakes = BakeServiceServer::new(Bakes(context.clone()))
            .max_decoding_message_size(limits::MESSAGE_BYTES)
            .max_encoding_message_size(limits::MESSAGE_BYTES);
        let artefacts = ArtefactServiceServer::new(Artefacts(context.clone()))
            .max_decoding_message_size(limits::CHUNK_MESSAGE_BYTES)
            .max_encoding_message_size(limits::CHUNK_MESSAGE_BYTES);
        let workers = WorkerServiceServer::new(Workers(context.clone()))
            .max_decoding_message_size(limits::SESSION_MESSAGE_BYTES)
            .max_encoding_message_size(limits::SESSION_MESSAGE_BYTES);
        let farm = FarmServiceServer::new(Farm(context)).max_decoding_message_size(limits::MESSAGE_BYTES);
        let (reporter, health) = tonic_health::server::health_reporter();
        reporter.set_serving::<BakeServiceServer<Bakes>>().await;
        reporter.set_serving::<ArtefactServiceServer<Artefacts>>().await;
        reporter.set_serving::<WorkerServiceServer<Workers>>().await;
        reporter.set_serving::<FarmServiceServer<Farm>>().await;
        let reflection = tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(DESCRIPTORS)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
            .build_v1()?;
        let gate = &self.gate;
        let mut routes = Routes::default();
        routes = routes
            .add_service(InterceptedService::new(bakes, gate.clone()))
            .add_service(InterceptedService::new(artefacts, gate.clone()))
            .add_service(InterceptedService::new(workers, gate.clone()))
            .add_service(InterceptedService::new(farm, gate.clone()))
            .add_service(health)
            .add_service(reflection);
        Ok(routes)
    }
}
