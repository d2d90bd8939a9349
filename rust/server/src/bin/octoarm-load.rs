//! `octoarm-load`: how fast a server of the arm answers, and how evenly.
//!
//! Every connection makes a world and steps it, the next request when the answer is there, for the
//! time that is asked for. A single connection computes every step in this process too, in turn with
//! the round trips: what a round trip costs over the physics is the difference.

use std::collections::BTreeMap;
use std::error::Error;
use std::hint::black_box;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Parser;
use http::Uri;
use octoarm_client::connect;
use octoarm_env::{Episode, EpisodeConfig};
use octoarm_server::protocol::environment_client::EnvironmentClient;
use octoarm_server::protocol::environment_request::Payload as Request;
use octoarm_server::protocol::environment_response::Payload as Response;
use octoarm_server::protocol::tensor::{DoubleArray, Int64Array, Payload};
use octoarm_server::protocol::{
    CreateWorldRequest, EnvironmentRequest, EnvironmentResponse, JoinWorldRequest, StepRequest,
    Tensor,
};
use tokio::sync::{Barrier, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;
use tonic::metadata::{Ascii, MetadataValue};

type Failure = Box<dyn Error + Send + Sync>;

/// Where a server listens if it is told nothing else.
const PORT: u16 = 50051;
/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(60);
/// Steps before anything is timed.
const WARM_UP: usize = 20;
/// Round trips before the same steps are computed here.
const TURN: usize = 25;
/// What is asked for with every step: spring lengths, reward, terminated.
const OBSERVATIONS: [u64; 3] = [1, 2, 9];

/// Steps worlds of a server over many connections, and prints how long the answers took, as JSON.
#[derive(Clone, Debug, Parser)]
#[command(name = "octoarm-load", version)]
struct Options {
    /// Where the server is, such as http://127.0.0.1:50051.
    address: String,
    /// Connections, each with a world of its own.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=4096))]
    connections: u16,
    /// Seconds to measure.
    #[arg(long, default_value_t = 5.0)]
    seconds: f64,
    /// Seconds from one action to the next.
    #[arg(long, default_value_t = 0.01)]
    control_period: f64,
    /// File with the certificates (PEM) of those who may have signed the server's, for https://.
    #[arg(long, value_name = "FILE")]
    certificate: Option<PathBuf>,
    /// File with the token that opens the server; without it, what OCTOARM_TOKEN holds.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

/// Where the server is, and what opens it.
#[derive(Clone)]
struct Access {
    server: octoarm_client::Access,
    authorization: Option<MetadataValue<Ascii>>,
}

impl Access {
    fn new(options: &Options) -> Result<Self, Failure> {
        let read = |name: &str, path: &PathBuf| {
            std::fs::read_to_string(path)
                .map_err(|error| format!("{name} {}: {error}", path.display()))
        };
        let address: Uri = options.address.parse()?;
        let host = address.host().ok_or_else(|| format!("{address}: expected http://HOST:PORT"))?;
        let roots = options.certificate.as_ref().map(|path| read("--certificate", path));
        let token = match &options.token_file {
            Some(path) => Some(read("--token-file", path)?),
            None => std::env::var("OCTOARM_TOKEN").ok(),
        };
        let authorization = token.as_ref().map(|token| -> Result<_, Failure> {
            let mut value: MetadataValue<Ascii> = format!("Bearer {}", token.trim()).parse()?;
            value.set_sensitive(true);
            Ok(value)
        });
        let server = octoarm_client::Access {
            host: host.trim_matches(['[', ']']).to_owned(),
            port: address.port_u16().unwrap_or(PORT),
            encrypted: address.scheme_str() == Some("https"),
            roots: roots.transpose()?.map(String::into_bytes),
            token,
            proxy: None,
        };
        Ok(Self { server, authorization: authorization.transpose()? })
    }
}

/// A stream that has joined a world of its own.
struct Client {
    requests: mpsc::Sender<EnvironmentRequest>,
    answers: Streaming<EnvironmentResponse>,
}

fn double(value: f64) -> Tensor {
    Tensor {
        payload: Some(Payload::Doubles(DoubleArray { array: vec![value] })),
        shape: Vec::new(),
    }
}

/// A wave of the base that keeps the arm in its domain.
fn action(step: usize) -> [f64; 2] {
    let phase = step as f64 * 0.05;
    [0.5 * phase.sin(), 0.5 * phase.cos()]
}

impl Client {
    async fn send(&mut self, payload: Request) -> Result<Response, Failure> {
        self.requests.send(EnvironmentRequest { payload: Some(payload) }).await?;
        self.receive().await
    }

    async fn receive(&mut self) -> Result<Response, Failure> {
        let answer = tokio::time::timeout(PATIENCE, self.answers.message()).await;
        let answer = answer.map_err(|_| format!("no answer within {} s", PATIENCE.as_secs()))??;
        match answer.and_then(|answer| answer.payload) {
            Some(Response::Error(error)) => Err(error.message.into()),
            Some(payload) => Ok(payload),
            None => Err("the server ended the stream".into()),
        }
    }

    async fn new(options: &Options, access: &Access) -> Result<Self, Failure> {
        let channel = connect(&access.server).await.map_err(|ending| ending.details)?;
        let endless = Tensor {
            payload: Some(Payload::Int64s(Int64Array { array: vec![-1] })),
            shape: vec![],
        };
        let settings = BTreeMap::from([
            ("control_period".to_owned(), double(options.control_period)),
            ("max_episode_steps".to_owned(), endless),
        ]);
        let create = Request::CreateWorld(CreateWorldRequest { settings });
        let (requests, receiver) = mpsc::channel(1);
        // Some servers say nothing, not even that there is a stream, before they have a request.
        requests.send(EnvironmentRequest { payload: Some(create) }).await?;
        let mut call = tonic::Request::new(ReceiverStream::new(receiver));
        if let Some(value) = &access.authorization {
            call.metadata_mut().insert("authorization", value.clone());
        }
        let answers = EnvironmentClient::new(channel).process(call).await?.into_inner();
        let mut client = Self { requests, answers };
        let Response::CreateWorld(world) = client.receive().await? else {
            return Err("no world was made".into());
        };
        let join = JoinWorldRequest { world_name: world.world_name, settings: BTreeMap::new() };
        client.send(Request::JoinWorld(join)).await?;
        client.step(0).await?;
        Ok(client)
    }

    async fn step(&mut self, step: usize) -> Result<(), Failure> {
        let array = action(step).to_vec();
        let tensor =
            Tensor { payload: Some(Payload::Doubles(DoubleArray { array })), shape: vec![2] };
        let request = StepRequest {
            actions: BTreeMap::from([(1, tensor)]),
            requested_observations: OBSERVATIONS.to_vec(),
        };
        match self.send(Request::Step(request)).await? {
            Response::Step(answer) if answer.observations.len() == OBSERVATIONS.len() => Ok(()),
            other => Err(format!("a step was answered by {other:?}").into()),
        }
    }
}

/// Times of steps \[µs\].
#[derive(Default)]
struct Times {
    round_trips: Vec<f64>,
    /// Of the same steps in this process.
    physics: Vec<f64>,
}

/// The same arm in this process.
fn local(options: &Options) -> Result<Episode, Failure> {
    let config =
        EpisodeConfig { control_period: options.control_period, ..EpisodeConfig::default() };
    let mut episode = Episode::new(config)?;
    episode.reset();
    Ok(episode)
}

fn microseconds(begin: Instant) -> f64 {
    begin.elapsed().as_secs_f64() * 1e6
}

/// Steps a world until the time is over, and an arm in this process in turn with it.
async fn load(
    options: Options,
    access: Access,
    mut twin: Option<Episode>,
    ready: Arc<Barrier>,
) -> Result<Times, Failure> {
    let client = async {
        let mut client = Client::new(&options, &access).await?;
        for step in 1..=WARM_UP {
            client.step(step).await?;
        }
        Ok::<_, Failure>(client)
    }
    .await;
    // Also after a failure: the others wait here.
    ready.wait().await;
    let mut client = client?;
    let end = Instant::now() + Duration::from_secs_f64(options.seconds);
    let mut times = Times::default();
    let mut first = WARM_UP + 1;
    while Instant::now() < end {
        for step in first..first + TURN {
            let begin = Instant::now();
            client.step(step).await?;
            times.round_trips.push(microseconds(begin));
        }
        if let Some(episode) = &mut twin {
            for step in first..first + TURN {
                let begin = Instant::now();
                episode.step(action(step))?;
                black_box(episode.arm().lengths());
                times.physics.push(microseconds(begin));
            }
        }
        first += TURN;
    }
    Ok(times)
}

fn percentiles(mut times: Vec<f64>) -> serde_json::Value {
    times.sort_by(f64::total_cmp);
    let at = |share: f64| {
        let last = times.len().saturating_sub(1);
        times.get((share * last as f64).round() as usize).copied()
    };
    serde_json::json!({
        "p50": at(0.5), "p90": at(0.9), "p99": at(0.99), "p99.9": at(0.999), "max": at(1.0),
    })
}

async fn measure(options: Options) -> Result<serde_json::Value, Failure> {
    let ready = Arc::new(Barrier::new(usize::from(options.connections)));
    let twin = if options.connections == 1 { Some(local(&options)?) } else { None };
    let access = Access::new(&options)?;
    let begin = |_| load(options.clone(), access.clone(), twin.clone(), Arc::clone(&ready));
    let clients: Vec<_> =
        (0..options.connections).map(|connection| tokio::spawn(begin(connection))).collect();
    let mut all = Times::default();
    for client in clients {
        let times = client.await??;
        all.round_trips.extend(times.round_trips);
        all.physics.extend(times.physics);
    }
    let steps = all.round_trips.len();
    // Of the time that the clients waited for answers, all of them at once.
    let waited = all.round_trips.iter().sum::<f64>() * 1e-6 / f64::from(options.connections);
    let over: Vec<f64> =
        all.round_trips.iter().zip(&all.physics).map(|(trip, alone)| trip - alone).collect();
    Ok(serde_json::json!({
        "connections": options.connections,
        "control_period": options.control_period,
        "seconds": options.seconds,
        "steps": steps,
        "steps_per_second": steps as f64 / waited,
        "round_trip_us": percentiles(all.round_trips),
        "physics_us": (!over.is_empty()).then(|| percentiles(all.physics)),
        "over_physics_us": (!over.is_empty()).then(|| percentiles(over)),
    }))
}

fn run() -> Result<(), Failure> {
    let options = Options::parse();
    if !(options.seconds > 0.0 && options.seconds <= 3600.0) {
        return Err(format!("--seconds {}: allowed are (0, 3600]", options.seconds).into());
    }
    let runtime = tokio::runtime::Runtime::new()?;
    let result = runtime.block_on(measure(options))?;
    writeln!(std::io::stdout(), "{result:#}")?;
    Ok(())
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let mut text = error.to_string();
            let mut cause = error.source();
            while let Some(error) = cause {
                text = format!("{text}: {error}");
                cause = error.source();
            }
            let _ = writeln!(std::io::stderr(), "octoarm-load: {text}");
            ExitCode::FAILURE
        }
    }
}
