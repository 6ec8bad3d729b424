//! The gRPC services: they check what comes in, ask the dispatcher or the store, and send back what they say.

mod artefact;
mod bake;
mod farm;
mod worker;

pub(crate) use artefact::Artefacts;
pub(crate) use bake::Bakes;
pub(crate) use farm::Farm;
pub(crate) use worker::Workers;

use crate::{dispatcher::Handle, error::store_status};
use kiln_store::{Store, StoreError};
use std::sync::Arc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

/// A stream of responses that a task feeds.
pub(crate) type Responses<T> = ReceiverStream<Result<T, Status>>;

/// What every service has.
#[derive(Clone, Debug)]
pub(crate) struct Context {
    pub(crate) handle: Handle,
    pub(crate) store: Arc<Store>,
}

impl Context {
    /// Asks the store on a thread that may block.
    pub(crate) async fn store<T: Send + 'static>(
        &self,
        question: impl FnOnce(&Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, Status> {
        let store = Arc::clone(&self.store);
        let answer = tokio::task::spawn_blocking(move || question(&store)).await;
        let answer = answer.map_err(|error| Status::internal(format!("the store's thread failed: {error}")))?;
        answer.map_err(|error| store_status(&error))
    }
}
