//! A collector gets the spans of requests.

use std::io::{BufRead as _, BufReader};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};

use octoarm_server::protocol::environment_client::EnvironmentClient;
use octoarm_server::protocol::environment_request::Payload as Request;
use octoarm_server::protocol::environment_response::Payload as Response;
use octoarm_server::protocol::{
    CreateWorldRequest, EnvironmentRequest, JoinWorldRequest, StepRequest,
};
use opentelemetry_proto::tonic::collector::trace::v1::trace_service_server::{
    TraceService, TraceServiceServer,
};
use opentelemetry_proto::tonic::collector::trace::v1::{
    ExportTraceServiceRequest, ExportTraceServiceResponse,
};
use opentelemetry_proto::tonic::common::v1::any_value::Value;
use opentelemetry_proto::tonic::trace::v1::Span;
use opentelemetry_proto::tonic::trace::v1::status::StatusCode;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio_stream::wrappers::{TcpListenerStream, UnboundedReceiverStream};

const TOKEN: &str = "0123456789abcdef";

/// Keeps what it gets.
#[derive(Clone, Debug, Default)]
struct Collector(Arc<Mutex<Vec<ExportTraceServiceRequest>>>);

#[tonic::async_trait]
impl TraceService for Collector {
    async fn export(
        &self,
        request: tonic::Request<ExportTraceServiceRequest>,
    ) -> Result<tonic::Response<ExportTraceServiceResponse>, tonic::Status> {
        self.0.lock().expect("what was collected").push(request.into_inner());
        Ok(tonic::Response::new(ExportTraceServiceResponse::default()))
    }
}

/// An attribute, as text.
fn attribute(span: &Span, key: &str) -> Option<String> {
    let found = span.attributes.iter().find(|attribute| attribute.key == key)?;
    match found.value.as_ref()?.value.as_ref()? {
        Value::StringValue(text) => Some(text.clone()),
        Value::IntValue(number) => Some(number.to_string()),
        _ => None,
    }
}

/// Has a server with this collector make a world, step it, and refuse a step; then stops it.
async fn use_a_server(collector: &str) -> String {
    let mut server = Command::new(env!("CARGO_BIN_EXE_octoarm-server"))
        .args(["--port", "0", "--otlp-endpoint", collector])
        .env("OCTOARM_TOKEN", format!("lab {TOKEN}"))
        .stdout(Stdio::piped())
        .spawn()
        .expect("server");
    let mut line = String::new();
    let out = server.stdout.take().expect("output");
    BufReader::new(out).read_line(&mut line).expect("address");
    let address = line.split_whitespace().last().expect("address").to_owned();

    let (ask, requests) = mpsc::unbounded_channel();
    let mut request = tonic::Request::new(UnboundedReceiverStream::new(requests));
    let token = format!("Bearer {TOKEN}").parse().expect("token");
    request.metadata_mut().insert("authorization", token);
    let mut client = EnvironmentClient::connect(address).await.expect("connection");
    let mut answers = client.process(request).await.expect("stream").into_inner();
    let mut answer = async |payload| {
        ask.send(EnvironmentRequest { payload: Some(payload) }).expect("request");
        answers.message().await.expect("answer").and_then(|answer| answer.payload)
    };
    let made = answer(Request::CreateWorld(CreateWorldRequest::default())).await;
    let Some(Response::CreateWorld(world)) = made else { unreachable!("{made:?}") };
    let world_name = world.world_name;
    let join = JoinWorldRequest { world_name: world_name.clone(), ..Default::default() };
    assert!(matches!(answer(Request::JoinWorld(join)).await, Some(Response::JoinWorld(_))));
    let step = answer(Request::Step(StepRequest::default())).await;
    assert!(matches!(step, Some(Response::Step(_))));
    let wrong = StepRequest { requested_observations: vec![99], ..Default::default() };
    assert!(matches!(answer(Request::Step(wrong)).await, Some(Response::Error(_))));

    let process = i32::try_from(server.id()).ok().and_then(rustix::process::Pid::from_raw);
    rustix::process::kill_process(process.expect("process"), rustix::process::Signal::TERM)
        .expect("signal");
    let end = tokio::task::spawn_blocking(move || server.wait()).await.expect("wait");
    assert!(end.expect("exit code").success());
    world_name
}

#[tokio::test]
async fn a_collector_gets_a_span_for_each_request() {
    let collector = Collector::default();
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("port");
    let url = format!("http://{}", listener.local_addr().expect("address"));
    let service = TraceServiceServer::new(collector.clone());
    let router = tonic::transport::Server::builder().add_service(service);
    tokio::spawn(router.serve_with_incoming(TcpListenerStream::new(listener)));

    let world_name = use_a_server(&url).await;
    let collected = collector.0.lock().expect("what was collected");
    let resources = collected.iter().flat_map(|request| &request.resource_spans);
    let scopes = resources.flat_map(|resource| &resource.scope_spans);
    let mut spans: Vec<&Span> = scopes.flat_map(|scope| &scope.spans).collect();
    spans.sort_by_key(|span| span.start_time_unix_nano);
    let names: Vec<&str> = spans.iter().map(|span| span.name.as_str()).collect();
    assert_eq!(names, ["create_world", "join_world", "step", "step"]);
    for span in &spans {
        assert!(span.end_time_unix_nano > span.start_time_unix_nano, "{span:?}");
        assert!(span.parent_span_id.is_empty(), "{span:?}");
        assert_eq!(attribute(span, "token").as_deref(), Some("lab"));
        assert!(attribute(span, "connection").is_some(), "{span:?}");
        // Not the whole name, which is a key.
        assert_eq!(attribute(span, "world").as_deref(), world_name.get(..8));
    }
    let errors: Vec<Option<String>> =
        spans.iter().map(|span| attribute(span, "error.type")).collect();
    assert_eq!(errors, [None, None, None, Some("INVALID_ARGUMENT".to_owned())]);
    let status =
        |span: &Span| span.status.as_ref().is_some_and(|status| status.code() == StatusCode::Error);
    assert!(!status(spans[2]) && status(spans[3]));
}

#[tokio::test]
async fn without_a_collector_the_server_serves() {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("port");
    let url = format!("http://{}", listener.local_addr().expect("address"));
    drop(listener);
    assert_eq!(use_a_server(&url).await.len(), 32);
}
