//! The server as a whole: listening, serving, stopping.

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::http::{StatusCode, header};
use axum::routing::get;
use octoarm_protocol::DESCRIPTORS;
use thiserror::Error;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Server as Transport;
use tonic_health::ServingStatus;

use crate::auth::Guard;
use crate::codec::EnvironmentServer;
use crate::intake::{Intake, Room};
use crate::limits::fit_open_files;
use crate::listener::{ConnectionLimits, Listener, connections, next_connection};
use crate::metrics::Metrics;
use crate::service::Service;
use crate::sessions::Sessions;
use crate::settings::Settings;
use crate::tls::Tls;
use crate::tokens::{Tokens, warn_if_open};

/// Bytes of requests on their way to a connection's streams.
const CONNECTION_WINDOW: u32 = 2 << 20;
/// Largest request of those who ask for the health, and for the protocol's files.
const HEALTH_REQUEST: usize = 1 << 10;
const REFLECTION_REQUEST: usize = 1 << 12;
/// Readers of the metrics: connections at a time (the oldest makes room for one more), the time that one
/// may be silent, and its whole life.
const READERS: ConnectionLimits = ConnectionLimits {
    most: 16,
    most_of_address: 16,
    silence: Duration::from_secs(10),
    probation: Duration::from_secs(60),
};
/// Time after the last stream's end in which answers go out when the server stops.
const DRAINED: Duration = Duration::from_millis(300);

/// Why the server cannot serve.
#[derive(Debug, Error)]
pub enum ServeError {
    /// An address cannot be listened on.
    #[error("cannot listen on {address}: {error}")]
    Listen {
        /// Address that was asked for.
        address: SocketAddr,
        /// Error of the system.
        error: io::Error,
    },
    /// The certificate, its key, or the transport.
    #[error("{0}")]
    Transport(String),
}

/// A server that listens.
#[derive(Debug)]
pub struct Server {
    settings: Settings,
    transport: Transport,
    tls: Option<Arc<Tls>>,
    tokens: Arc<Tokens>,
    listener: TcpListener,
    metrics: Option<TcpListener>,
}

/// What a server that serves can still be told.
#[derive(Clone, Debug)]
pub struct Reloader {
    tls: Option<Arc<Tls>>,
    tokens: Arc<Tokens>,
}

impl Reloader {
    /// Reads the files of certificate, key and tokens again, for the connections from now on; those
    /// that there are go on with what they began with. What cannot be used changes nothing, which the
    /// log tells.
    pub fn reload(&self) {
        let certificate = self.tls.as_ref().map_or(Ok(()), |tls| tls.reload());
        let tokens = self.tokens.reload(next_connection());
        for error in [certificate, tokens].into_iter().filter_map(Result::err) {
            tracing::error!("not reloaded: {error}");
        }
        tracing::info!("certificate and tokens read again");
    }
}

async fn listen(address: SocketAddr) -> Result<TcpListener, ServeError> {
    TcpListener::bind(address).await.map_err(|error| ServeError::Listen { address, error })
}

fn address_of(listener: &TcpListener) -> Result<SocketAddr, ServeError> {
    listener.local_addr().map_err(|error| ServeError::Transport(error.to_string()))
}

/// What an error says, and what is behind it.
fn with_causes(error: &(dyn std::error::Error + 'static)) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

fn transport_error(error: &(dyn std::error::Error + 'static)) -> ServeError {
    ServeError::Transport(with_causes(error))
}

/// Serves what Prometheus reads, and whether the server takes new clients.
async fn serve_metrics(listener: Listener, metrics: Arc<Metrics>, sessions: Arc<Sessions>) {
    const TEXT: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    let answer = move || async move {
        match metrics.text() {
            Ok(text) => (StatusCode::OK, [(header::CONTENT_TYPE, TEXT)], text),
            Err(error) => (
                StatusCode::INTERNAL_SERVER_ERROR,
                [(header::CONTENT_TYPE, "text/plain")],
                error.to_string(),
            ),
        }
    };
    let health = move || async move {
        if sessions.stop.is_cancelled() || sessions.draining.is_cancelled() {
            (StatusCode::SERVICE_UNAVAILABLE, "stopping\n")
        } else {
            (StatusCode::OK, "serving\n")
        }
    };
    let router = Router::new().route("/metrics", get(answer)).route("/healthz", get(health));
    if let Err(error) = axum::serve(listener, router).await {
        tracing::error!(%error, "metrics are no longer served");
    }
}

/// Completes when there has been no stream for a while: what is open then are connections without
/// one, or those that only watch.
async fn drained(metrics: &Metrics) {
    let mut since = Instant::now();
    while since.elapsed() < DRAINED {
        tokio::time::sleep(DRAINED / 10).await;
        if metrics.streams.get() > 0 {
            since = Instant::now();
        }
    }
}

impl Server {
    /// Listens, but serves nobody yet.
    ///
    /// # Errors
    /// [`ServeError::Listen`] for an address that is taken or not this machine's,
    /// [`ServeError::Transport`] for a certificate or key that cannot be used.
    pub async fn bind(mut settings: Settings) -> Result<Self, ServeError> {
        fit_open_files(&mut settings.limits);
        let limits = &settings.limits;
        let mut transport = Transport::builder()
            .max_concurrent_streams(limits.max_streams_per_connection)
            // What may be on its way in, many small requests of many streams.
            .initial_connection_window_size(CONNECTION_WINDOW)
            .http2_keepalive_interval(Some(limits.keepalive_interval))
            .http2_keepalive_timeout(Some(limits.keepalive_timeout));
        if let Some(age) = limits.max_connection_age {
            transport = transport.max_connection_age(age);
        }
        let tls = settings.tls.clone().map(|files| Tls::new(files, limits.keepalive_timeout));
        let tls = tls.transpose().map_err(ServeError::Transport)?.map(Arc::new);
        if let Some(files) = &settings.tls {
            warn_if_open("tls_key", &files.key);
        }
        let tokens = Tokens::new(settings.tokens.clone(), settings.token_file.clone());
        let listener = listen(settings.address).await?;
        let metrics = match settings.metrics {
            None => None,
            Some(address) => Some(listen(address).await?),
        };
        Ok(Self { settings, transport, tls, tokens: Arc::new(tokens), listener, metrics })
    }

    /// Where clients connect.
    ///
    /// # Errors
    /// [`ServeError::Transport`] if the system does not tell.
    pub fn address(&self) -> Result<SocketAddr, ServeError> {
        address_of(&self.listener)
    }

    /// Where Prometheus connects.
    ///
    /// # Errors
    /// [`ServeError::Transport`] if the system does not tell.
    pub fn metrics_address(&self) -> Result<Option<SocketAddr>, ServeError> {
        self.metrics.as_ref().map(address_of).transpose()
    }

    /// What tells the server, while it serves, that its files have changed.
    #[must_use]
    pub fn reloader(&self) -> Reloader {
        Reloader { tls: self.tls.clone(), tokens: Arc::clone(&self.tokens) }
    }

    /// Whether clients must speak TLS.
    #[must_use]
    pub fn encrypted(&self) -> bool {
        self.settings.tls.is_some()
    }

    /// Serves until `shutdown` completes; running requests are then answered, streams ended, and what
    /// is left after the time allowed is broken off.
    ///
    /// # Errors
    /// [`ServeError::Transport`] for a certificate or key that cannot be used.
    pub async fn serve(self, shutdown: impl Future<Output = ()>) -> Result<(), ServeError> {
        let Self { settings, transport, tls, tokens, listener, metrics: metrics_listener } = self;
        let limits = settings.limits.clone();
        let metrics = Metrics::new();
        let stop = CancellationToken::new();
        let threads = settings.server_threads;
        let sessions = Sessions::new(limits.clone(), Arc::clone(&metrics), stop.clone(), threads)
            .map_err(|error| ServeError::Transport(format!("no threads: {error}")))?;
        let room = Room::new(limits.max_bytes_in_flight, metrics.bytes_in_flight.clone());
        let intake = Intake { room: Arc::clone(&room), message_timeout: limits.message_timeout };

        let (health, health_service) = tonic_health::server::health_reporter();
        health.set_serving::<EnvironmentServer<Service>>().await;
        let guard = Guard { tokens, metrics: Arc::clone(&metrics) };
        let environment = EnvironmentServer::new(Service { sessions: Arc::clone(&sessions), room })
            .max_decoding_message_size(limits.max_message_size);
        let reflection = |error: tonic_reflection::server::Error| transport_error(&error);
        let files = || {
            tonic_reflection::server::Builder::configure()
                .register_encoded_file_descriptor_set(DESCRIPTORS)
                .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        };

        let router = transport
            .layer(intake)
            .add_service(health_service.max_decoding_message_size(HEALTH_REQUEST))
            .add_service(InterceptedService::new(environment, guard.clone()))
            .add_service(InterceptedService::new(
                files()
                    .build_v1()
                    .map_err(reflection)?
                    .max_decoding_message_size(REFLECTION_REQUEST),
                guard.clone(),
            ))
            .add_service(InterceptedService::new(
                files()
                    .build_v1alpha()
                    .map_err(reflection)?
                    .max_decoding_message_size(REFLECTION_REQUEST),
                guard,
            ));
        let life = limits.keepalive_interval + limits.keepalive_timeout;
        let connection_limits = ConnectionLimits {
            most: limits.max_connections,
            most_of_address: limits.max_connections_per_address,
            // Twice, so that a connection is first given up by the transport, which says goodbye.
            silence: 2 * life,
            probation: limits.probation_timeout,
        };
        let incoming = connections(listener, connection_limits, Arc::clone(&metrics));

        let watch = tokio::spawn(Arc::clone(&sessions).keep_watch());
        let scraped = metrics_listener.map(|listener| Listener::new(listener, READERS, None)).map(
            |listener| {
                tokio::spawn(serve_metrics(listener, Arc::clone(&metrics), Arc::clone(&sessions)))
            },
        );
        let serving = {
            let stop = stop.clone();
            async move {
                let stopped = async move { stop.cancelled().await };
                match tls {
                    None => router.serve_with_incoming_shutdown(incoming, stopped).await,
                    Some(tls) => {
                        router.serve_with_incoming_shutdown(tls.secured(incoming), stopped).await
                    }
                }
            }
        };
        let mut serving = std::pin::pin!(serving);
        let result = tokio::select! {
            result = &mut serving => Some(result),
            () = shutdown => None,
        };
        let result = match result {
            Some(result) => result,
            None => {
                health.set_not_serving::<EnvironmentServer<Service>>().await;
                health.set_service_status("", ServingStatus::NotServing).await;
                if !settings.drain_timeout.is_zero() {
                    let seconds = settings.drain_timeout.as_secs_f64();
                    tracing::info!(seconds, "running episodes may come to their end");
                    sessions.draining.cancel();
                    let over = sessions.episodes_over();
                    // The transport does not end before it is told to.
                    tokio::select! {
                        _ = tokio::time::timeout(settings.drain_timeout, over) => (),
                        _ = &mut serving => return Ok(()),
                    }
                }
                tracing::info!("shutting down: running requests are answered, streams ended");
                stop.cancel();
                tokio::select! {
                    result = serving => result,
                    () = drained(&metrics) => {
                        tracing::debug!("no stream is left; open connections are broken off");
                        Ok(())
                    }
                    () = tokio::time::sleep(settings.shutdown_timeout) => {
                        tracing::warn!(
                            seconds = settings.shutdown_timeout.as_secs_f64(),
                            streams = metrics.streams.get(),
                            "not all streams came to their end in time: they are broken off"
                        );
                        Ok(())
                    }
                }
            }
        };
        stop.cancel();
        for task in [Some(watch), scraped].into_iter().flatten() {
            task.abort();
        }
        result.map_err(|error| transport_error(&error))
    }
}
