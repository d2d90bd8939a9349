//! What a server goes by, checked.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::ValueEnum;
use serde::Deserialize;
use thiserror::Error;

use crate::tls::CertificateFiles;
use crate::tokens::Token;

/// How log lines look.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum LogFormat {
    /// One line of text for each event.
    #[default]
    Text,
    /// One JSON object for each event.
    Json,
}

/// Settings that cannot be used.
#[derive(Debug, Error)]
pub enum SettingsError {
    /// The file cannot be read.
    #[error("--config {path}: {reason}")]
    File {
        /// Path of the file.
        path: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A value outside what is allowed, or settings that do not go together.
    #[error("{0}")]
    Value(String),
}

/// What clients may ask for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Limits {
    /// Worlds of all clients.
    pub(crate) max_worlds: usize,
    /// Worlds made through one connection.
    pub(crate) max_worlds_per_connection: usize,
    /// Arms of a world.
    pub(crate) max_num_envs: usize,
    /// Arms of all worlds.
    pub(crate) max_arms: usize,
    /// Compartments of an arm.
    pub(crate) max_compartments: usize,
    /// Physics steps of an arm of 20 compartments that one request may take.
    pub(crate) max_physics_steps: u64,
    /// Threads that share a batch's step.
    pub(crate) max_threads: usize,
    /// Bytes of a request.
    pub(crate) max_message_size: usize,
    /// Memory of all worlds.
    pub(crate) max_world_bytes: usize,
    /// Bytes of requests that are not answered, and of large answers that are not sent.
    pub(crate) max_bytes_in_flight: usize,
    /// Connections at a time.
    pub(crate) max_connections: usize,
    /// Connections at a time from one address.
    pub(crate) max_connections_per_address: usize,
    /// Streams of a connection at a time.
    pub(crate) max_streams_per_connection: u32,
    /// Time in which a call must be let in over a connection.
    pub(crate) probation_timeout: Duration,
    /// Time that a request may take from its first byte to its last.
    pub(crate) message_timeout: Duration,
    /// Time after which a connection takes no new streams.
    pub(crate) max_connection_age: Option<Duration>,
    /// Time without a request after which a stream is ended.
    pub(crate) idle_timeout: Duration,
    /// Time from one sign of life that is asked for to the next.
    pub(crate) keepalive_interval: Duration,
    /// Time that an answer to it may take.
    pub(crate) keepalive_timeout: Duration,
    /// Time in which the next request of a lone stream is looked for without sleeping.
    pub(crate) busy_poll: Duration,
}

/// Checked settings of a server.
#[derive(Clone, Debug)]
pub struct Settings {
    pub(crate) address: SocketAddr,
    pub(crate) tls: Option<CertificateFiles>,
    pub(crate) tokens: Vec<Token>,
    /// Where the tokens are, if they can be exchanged.
    pub(crate) token_file: Option<PathBuf>,
    pub(crate) limits: Limits,
    pub(crate) shutdown_timeout: Duration,
    /// Time that episodes may go on when the server is asked to end.
    pub(crate) drain_timeout: Duration,
    /// Lines that the log takes in a second.
    pub log_rate: u64,
    /// Number of threads that serve.
    pub server_threads: usize,
    pub(crate) metrics: Option<SocketAddr>,
    /// URL of the collector that gets the spans.
    pub otlp_endpoint: Option<String>,
    /// Form of the log lines.
    pub log_format: LogFormat,
    /// Filter of what is logged, as `tracing` reads it.
    pub log_level: String,
}

/// What the processor runs at once.
pub(crate) fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_worlds: 1024,
            max_worlds_per_connection: 256,
            max_num_envs: 1024,
            max_arms: 16_384,
            max_compartments: 60,
            max_physics_steps: 1_000_000,
            max_threads: cores(),
            max_message_size: 4 << 20,
            max_world_bytes: 1 << 30,
            max_bytes_in_flight: 256 << 20,
            max_connections: 1024,
            max_connections_per_address: 512,
            max_streams_per_connection: 256,
            probation_timeout: Duration::from_secs(10),
            message_timeout: Duration::from_secs(60),
            max_connection_age: None,
            idle_timeout: Duration::from_secs(3600),
            keepalive_interval: Duration::from_secs(30),
            keepalive_timeout: Duration::from_secs(20),
            busy_poll: Duration::from_micros(200),
        }
    }
}
