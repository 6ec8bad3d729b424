//! FarmService.

use super::{Context, Responses};
use crate::dispatcher::Ask;
use kiln_proto::v1;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};
use v1::farm_service_server::FarmService;

#[derive(Clone, Debug)]
pub(crate) struct Farm(pub(crate) Context);

#[tonic::async_trait]
impl FarmService for Farm {
    type WatchFarmStream = Responses<v1::WatchFarmResponse>;

    async fn watch_farm(
        &self,
        _request: Request<v1::WatchFarmRequest>,
    ) -> Result<Response<Self::WatchFarmStream>, Status> {
        let mut farm = self.0.handle.farm();
        let (responses, stream) = mpsc::channel(1);
        tokio::spawn(async move {
            loop {
                let changed = tokio::select! {
                    changed = farm.changed() => changed,
                    () = responses.closed() => return,
                };
                let response = v1::WatchFarmResponse::clone(&farm.borrow_and_update());
                if changed.is_err() || responses.send(Ok(response)).await.is_err() {
                    return;
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(stream)))
    }

    async fn list_workers(
        &self,
        request: Request<v1::ListWorkersRequest>,
    ) -> Result<Response<v1::ListWorkersResponse>, Status> {
        let v1::ListWorkersRequest { page_size, page_token } = request.into_inner();
        Ok(Response::new(self.0.handle.ask(|respond| Ask::Workers { page_size, page_token, respond }).await?))
    }

    async fn get_stats(
        &self,
        _request: Request<v1::GetStatsRequest>,
    ) -> Result<Response<v1::GetStatsResponse>, Status> {
        let stats = self.0.handle.ask(|respond| Ask::Stats { respond }).await?;
        Ok(Response::new(v1::GetStatsResponse { stats: Some(stats) }))
    }
}
