//! The octopus arm as a service: the environments of `octoarm-env` over gRPC, in the protocol
//! [dm_env_rpc](https://github.com/google-deepmind/dm_env_rpc), version 1. No Python in the process.
//!
//! ```
//! use clap::Parser as _;
//! use octoarm_server::protocol::environment_client::EnvironmentClient;
//! use octoarm_server::protocol::environment_request::Payload as Request;
//! use octoarm_server::protocol::environment_response::Payload as Response;
//! use octoarm_server::protocol::{CreateWorldRequest, EnvironmentRequest};
//! use octoarm_server::{Options, Server};
//!
//! # #[tokio::main]
//! # async fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // A server on a free port of this machine, until it is told to stop.
//! let settings = Options::try_parse_from(["octoarm-server", "--port", "0"])?.settle()?;
//! let server = Server::bind(settings).await?;
//! let address = format!("http://{}", server.address()?);
//! let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
//! let serving = tokio::spawn(server.serve(async { stopped.await.unwrap_or_default() }));
//!
//! // A client makes a world; it would join it then, and send actions.
//! let create = Request::CreateWorld(CreateWorldRequest::default());
//! let requests = tokio_stream::once(EnvironmentRequest { payload: Some(create) });
//! let mut client = EnvironmentClient::connect(address).await?;
//! let mut answers = client.process(requests).await?.into_inner();
//! let answer = answers.message().await?.and_then(|answer| answer.payload);
//! assert!(matches!(answer, Some(Response::CreateWorld(world)) if world.world_name.len() == 32));
//!
//! let _ = stop.send(());
//! serving.await??;
//! # Ok(())
//! # }
//! ```
//!
//! [`Options`] and [`Settings`] say where and for whom, [`Server`] serves. A *world* is an arm with
//! its episodes, or a batch of them; a client makes worlds, joins one a stream as its *agent*, and
//! steps it. What an episode is, is not decided here.

mod auth;
mod codec;
mod environment;
mod episodes;
#[cfg(feature = "otel")]
mod export;
mod intake;
mod limits;
mod listener;
mod log;
mod metrics;
mod next_reset;
mod options;
mod pool;
mod properties;
mod reply;
mod server;
mod service;
mod session;
mod sessions;
mod settings;
mod specs;
mod state;
mod task_settings;
mod tensor;
mod tls;
mod tokens;
mod traces;
mod world;
mod world_settings;
mod worlds;

#[cfg(feature = "otel")]
pub use export::Traces;
pub use log::LogRate;
pub use octoarm_protocol as protocol;
pub use options::Options;
pub use server::{Reloader, ServeError, Server};
pub use settings::{LogFormat, Settings, SettingsError};
pub use traces::SPANS;
