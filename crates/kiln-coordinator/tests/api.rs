//! The API as a client meets it, without workers: artefacts, limits, tokens, health, reflection, over memory and TCP.

#![expect(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use bytes::Bytes;
use kiln_coordinator::{Config, Coordinator, InMemoryConnector, Token, in_memory, listen};
use kiln_core::{BakeSettings, Digest, SourceFile, SourceManifest};
use kiln_proto::{
    Submission,
    client::{Bearer, ClientError, Farm},
    limits, status, v1,
};
use kiln_store::{OpenOptions, Store};
use std::{sync::Arc, time::Duration};
use tempfile::TempDir;
use tonic::{Code, transport::Channel};
use v1::{
    artefact_service_client::ArtefactServiceClient, upload_request::Part, worker_service_client::WorkerServiceClient,
};

/// A coordinator over memory.
async fn farm() -> (Farm, InMemoryConnector, Arc<Store>, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let store = Arc::new(Store::open(folder.path(), OpenOptions::default()).unwrap());
    let coordinator = Coordinator::start(Arc::clone(&store), Config::default()).await.unwrap();
    let (incoming, connector) = in_memory();
    tokio::spawn(coordinator.serve(incoming, std::future::pending()));
    (Farm::over(connector.channel(), Bearer::default()), connector, store, folder)
}

fn blob(bytes: usize, seed: u8) -> Bytes {
    (0..bytes).map(|i| (i as u8).wrapping_mul(31).wrapping_add(seed)).collect()
}

fn manifest(blobs: &[&Bytes]) -> v1::UploadManifest {
    let entries: Vec<(Digest, u64)> = blobs.iter().map(|bytes| (Digest::of(bytes), bytes.len() as u64)).collect();
    v1::UploadManifest::new(&entries)
}

fn part(part: Part) -> v1::UploadRequest {
    v1::UploadRequest { part: Some(part) }
}

fn chunk(offset: u64, data: Bytes) -> v1::UploadRequest {
    part(Part::Chunk(v1::UploadChunk { offset, data }))
}

#[tokio::test(flavor = "multi_thread")]
async fn artefacts_go_up_and_come_down() {
    let (farm, _, store, _folder) = farm().await;
    let blobs = [blob(0, 0), blob(10, 1), blob(2_500_000, 2), blob(limits::CHUNK_BYTES, 3), blob(10, 1)];
    let digests = farm.upload(&blobs).await.unwrap();
    assert_eq!(digests, blobs.each_ref().map(|bytes| Digest::of(bytes)));
    assert_eq!(store.missing(&digests).unwrap(), []);
    assert_eq!(farm.find_missing(&[digests[2], Digest::of(b"no")]).await.unwrap(), [Digest::of(b"no")]);
    assert_eq!(farm.download_all(&digests).await.unwrap(), blobs);
    let missing = farm.download(Digest::of(b"no")).await.unwrap_err();
    assert!(matches!(missing, ClientError::Missing { digest } if digest == Digest::of(b"no")), "{missing}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_broken_upload_goes_on_where_it_broke() {
    let (farm, _, store, _folder) = farm().await;
    let bytes = blob(3_000_000, 5);
    let manifest = manifest(&[&bytes]);
    let first = bytes.slice(..limits::CHUNK_BYTES);
    let begun = vec![part(Part::Manifest(manifest.clone())), chunk(0, first)];
    let error = farm.artefacts().upload(tokio_stream::iter(begun)).await.unwrap_err();
    assert_eq!(status::reason(&error).as_deref(), Some("UPLOAD_INCOMPLETE"));
    let query = v1::QueryUploadRequest { manifest: Some(manifest.clone()) };
    let offset = farm.artefacts().query_upload(query).await.unwrap().into_inner().offset;
    assert_eq!(offset, limits::CHUNK_BYTES as u64);
    // From the beginning again would be wrong, and is said to be; the client goes on by itself.
    let again = vec![part(Part::Manifest(manifest)), chunk(0, bytes.slice(..10))];
    let error = farm.artefacts().upload(tokio_stream::iter(again)).await.unwrap_err();
    assert_eq!((error.code(), status::is_transient(&error)), (Code::Aborted, true));
    farm.upload(std::slice::from_ref(&bytes)).await.unwrap();
    assert_eq!(store.get(&Digest::of(&bytes)).unwrap().unwrap(), bytes);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_not_what_its_digest_says_is_refused() {
    let (farm, _, store, _folder) = farm().await;
    let (said, sent) = (blob(100, 1), blob(100, 2));
    let parts = vec![part(Part::Manifest(manifest(&[&said]))), chunk(0, sent)];
    let error = farm.artefacts().upload(tokio_stream::iter(parts)).await.unwrap_err();
    assert_eq!(status::reason(&error).as_deref(), Some("UPLOAD_BROKEN"));
    assert_eq!(store.missing(&[Digest::of(&said)]).unwrap().len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn chunks_and_messages_have_limits() {
    let (farm, connector, _, _folder) = farm().await;
    let bytes = blob(limits::CHUNK_BYTES + 1, 0);
    let parts = || tokio_stream::iter(vec![part(Part::Manifest(manifest(&[&bytes]))), chunk(0, bytes.clone())]);
    let error = farm.artefacts().upload(parts()).await.unwrap_err();
    assert_eq!(error.code(), Code::InvalidArgument);
    assert!(error.message().starts_with("chunk.data: has 1048577 bytes"), "{error}");
    // A client without scruples is refused before its message is read.
    let bytes = blob(3 << 20, 0);
    let parts = || tokio_stream::iter(vec![part(Part::Manifest(manifest(&[&bytes]))), chunk(0, bytes.clone())]);
    let mut rude: ArtefactServiceClient<Channel> = ArtefactServiceClient::new(connector.channel());
    assert_eq!(rude.upload(parts()).await.unwrap_err().code(), Code::OutOfRange);
    let digests = vec![vec![0; 32]; limits::ARTEFACTS + 1];
    let error = rude.find_missing(v1::FindMissingRequest { digests }).await.unwrap_err();
    assert_eq!(error.code(), Code::InvalidArgument);
    let ranges = vec![v1::DownloadRange { digest: vec![1; 31], offset: 0, length: 0 }];
    let error = rude.download(v1::DownloadRequest { ranges }).await.unwrap_err();
    assert!(error.message().starts_with("ranges[0].digest"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_is_too_large_is_not_sent() {
    let (farm, _, _, _folder) = farm().await;
    let file = |i: usize| SourceFile { path: format!("{i:0400}"), digest: Digest::default() };
    let files = (0..limits::SOURCE_FILES).map(file).collect();
    let submission = Submission {
        request_id: "r".into(),
        source: SourceManifest { files, sidecar: None, settings: BakeSettings::default() },
        backend: v1::Backend::Auto,
        priority: 0,
        name: String::new(),
        tenant: String::new(),
    };
    let error = farm.submit(&submission).await.unwrap_err();
    assert!(matches!(error, ClientError::TooLarge { limit: limits::MESSAGE_BYTES, .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn ranges_are_read_exactly() {
    let (farm, _, _, _folder) = farm().await;
    let bytes = blob(1_500_000, 9);
    let digest = farm.upload(std::slice::from_ref(&bytes)).await.unwrap()[0];
    let range = |offset, length| v1::DownloadRange { digest: digest.0.to_vec(), offset, length };
    let ranges = vec![range(10, 1_200_000), range(1_499_999, 0), range(1_500_000, 0)];
    let mut stream = farm.artefacts().download(v1::DownloadRequest { ranges }).await.unwrap().into_inner();
    let mut read = [Vec::new(), Vec::new(), Vec::new()];
    while let Some(chunk) = stream.message().await.unwrap() {
        read[chunk.range as usize].extend_from_slice(&chunk.data);
    }
    assert_eq!(read, [bytes[10..1_200_010].to_vec(), bytes[1_499_999..].to_vec(), Vec::new()]);
    for (offset, length) in [(1_500_001, 0), (0, 1_500_001), (u64::MAX, 2)] {
        let ranges = vec![range(offset, length)];
        let mut stream = farm.artefacts().download(v1::DownloadRequest { ranges }).await.unwrap().into_inner();
        assert_eq!(stream.message().await.unwrap_err().code(), Code::OutOfRange);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn over_tcp_with_a_token() {
    let folder = tempfile::tempdir().unwrap();
    let store = Arc::new(Store::open(folder.path(), OpenOptions::default()).unwrap());
    let token = Token::new("0123456789abcdef0123").unwrap();
    let config = Config { token: Some(token.clone()), ..Config::default() };
    let coordinator = Coordinator::start(store, config).await.unwrap();
    let incoming = listen("127.0.0.1:0".parse().unwrap(), Some(&token)).unwrap();
    let address = incoming.local_addr().unwrap().to_string();
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let served = tokio::spawn(coordinator.serve(incoming, async {
        let _ = stopped.await;
    }));
    let with = |token: Option<&str>| Farm::at(&address, Bearer::new(token).unwrap()).unwrap();
    let known = with(Some(token.secret()));
    assert_eq!(known.list(0, "", false).await.unwrap().0, []);
    for stranger in [with(None), with(Some("0123456789abcdef0124"))] {
        let error = stranger.list(0, "", false).await.unwrap_err();
        assert_eq!(error.reason().as_deref(), Some("TOKEN_REQUIRED"));
        assert!(stranger.upload(&[blob(1, 1)]).await.is_err());
    }
    // Health is for everyone.
    let channel = Channel::from_shared(format!("http://{address}")).unwrap().connect().await.unwrap();
    let mut health = tonic_health::pb::health_client::HealthClient::new(channel);
    let request = tonic_health::pb::HealthCheckRequest { service: "kiln.v1.BakeService".into() };
    assert_eq!(health.check(request).await.unwrap().into_inner().status, 1);
    // A watcher does not keep the coordinator from stopping.
    let mut watch = known.state().watch_farm(v1::WatchFarmRequest {}).await.unwrap().into_inner();
    drop(stop);
    tokio::time::timeout(Duration::from_secs(3), served).await.expect("it does not stop").unwrap().unwrap();
    while let Ok(Some(_)) = watch.message().await {}
    let error = with(None).list(0, "", false).await.unwrap_err();
    assert!(error.is_unreachable(), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_api_describes_itself() {
    use tonic_reflection::pb::v1::{
        ServerReflectionRequest, server_reflection_client::ServerReflectionClient,
        server_reflection_request::MessageRequest, server_reflection_response::MessageResponse,
    };
    let (_, connector, _, _folder) = farm().await;
    let request = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::ListServices(String::new())),
    };
    let mut client = ServerReflectionClient::new(connector.channel());
    let mut stream = client.server_reflection_info(tokio_stream::iter([request])).await.unwrap().into_inner();
    let answer = stream.message().await.unwrap().unwrap().message_response;
    let Some(MessageResponse::ListServicesResponse(list)) = answer else { panic!("{answer:?}") };
    let names: Vec<String> = list.service.into_iter().map(|service| service.name).collect();
    for name in ["BakeService", "ArtefactService", "WorkerService", "FarmService"] {
        assert!(names.contains(&format!("kiln.v1.{name}")), "{names:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_must_say_hello_and_be_of_this_version() {
    let (_, connector, _, _folder) = farm().await;
    let mut workers: WorkerServiceClient<Channel> = WorkerServiceClient::new(connector.channel());
    let say = |message| tokio_stream::iter([v1::SessionRequest { message: Some(message) }]);
    use v1::session_request::Message;
    let error = workers.session(say(Message::Heartbeat(v1::Heartbeat::default()))).await.unwrap_err();
    assert_eq!(status::reason(&error).as_deref(), Some("HELLO_MISSING"));
    let hello = v1::Hello { worker_id: "w".into(), protocol_min: 99, protocol_max: 99, ..Default::default() };
    let error = workers.session(say(Message::Hello(hello))).await.unwrap_err();
    assert_eq!(status::reason(&error).as_deref(), Some("PROTOCOL"));
    let hello = v1::Hello {
        worker_id: "w".into(),
        protocol_min: kiln_proto::PROTOCOL_MIN,
        protocol_max: kiln_proto::PROTOCOL,
        ..Default::default()
    };
    let error = workers.session(say(Message::Hello(hello))).await.unwrap_err();
    assert_eq!(status::reason(&error).as_deref(), Some("KERNEL_REVISION"));
}
