//! The server as a whole: listening, serving, stopping.

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::http::{StatusCode, header};
use axum::routing::get;
use thiserror::Error;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Server as Transport;

use crate::auth::Guard;
use crate::listener::{ConnectionLimits, Listener, connections, next_connection};
use crate::metrics::Metrics;
use crate::protocol::DESCRIPTORS;
use crate::protocol::environment_server::EnvironmentServer;
use crate::service::Service;
use crate::sessions::Sessions;
use crate::settings::Settings;
use crate::tls::Tls;
use crate::tokens::{Tokens, warn_if_open};

/// Bytes of requests on their way to a connection's streams.
const CONNECTION_WINDOW: u32 = 8 << 20;
/// Connections of readers of the metrics at a time, and the time that one may be silent.
const MOST_READERS: usize = 16;
const READER_SILENCE: Duration = Duration::from_secs(10);
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
        let tokens = self.tokens.reload(next_connection()).map_err(|error| error.to_string());
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

/// Serves what Prometheus reads.
async fn serve_metrics(listener: Listener, metrics: Arc<Metrics>, stop: CancellationToken) {
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
    let router = Router::new().route("/metrics", get(answer));
    let serving =
        axum::serve(listener, router).with_graceful_shutdown(async move { stop.cancelled().await });
    if let Err(error) = serving.await {
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
    pub async fn bind(settings: Settings) -> Result<Self, ServeError> {
        let limits = &settings.limits;
        let transport = Transport::builder()
            .max_concurrent_streams(limits.max_streams_per_connection)
            // What may be on its way in, many small requests of many streams.
            .initial_connection_window_size(CONNECTION_WINDOW)
            .http2_keepalive_interval(Some(limits.keepalive_interval))
            .http2_keepalive_timeout(Some(limits.keepalive_timeout));
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
        let Self { settings, mut transport, tls, tokens, listener, metrics: metrics_listener } =
            self;
        let limits = settings.limits.clone();
        let metrics = Metrics::new();
        let stop = CancellationToken::new();
        let threads = settings.server_threads;
        let sessions = Sessions::new(limits.clone(), Arc::clone(&metrics), stop.clone(), threads);

        let (health, health_service) = tonic_health::server::health_reporter();
        health.set_serving::<EnvironmentServer<Service>>().await;
        let guard = Guard { tokens, metrics: Arc::clone(&metrics) };
        let environment = EnvironmentServer::new(Service { sessions: Arc::clone(&sessions) })
            .max_decoding_message_size(limits.max_message_size);
        let reflection = |error: tonic_reflection::server::Error| transport_error(&error);
        let files = || {
            tonic_reflection::server::Builder::configure()
                .register_encoded_file_descriptor_set(DESCRIPTORS)
                .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        };

        let router = transport
            .add_service(health_service)
            .add_service(InterceptedService::new(environment, guard.clone()))
            .add_service(InterceptedService::new(
                files().build_v1().map_err(reflection)?,
                guard.clone(),
            ))
            .add_service(InterceptedService::new(
                files().build_v1alpha().map_err(reflection)?,
                guard,
            ));
        let life = limits.keepalive_interval + limits.keepalive_timeout;
        let connection_limits = ConnectionLimits {
            most: limits.max_connections,
            // Twice, so that a connection is first given up by the transport, which says goodbye.
            silence: 2 * life,
            probation: life,
        };
        let incoming = connections(listener, connection_limits, Arc::clone(&metrics));

        let watch = tokio::spawn(sessions.keep_watch());
        let scraped = metrics_listener
            .map(|listener| Listener::new(listener, MOST_READERS, READER_SILENCE))
            .map(|listener| {
                tokio::spawn(serve_metrics(listener, Arc::clone(&metrics), stop.clone()))
            });
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
                tracing::info!("shutting down: running requests are answered, streams ended");
                health.set_not_serving::<EnvironmentServer<Service>>().await;
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
