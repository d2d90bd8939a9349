//! `octoarm-server`: serves the octopus arm over gRPC.

use std::error::Error;
use std::io::{self, IsTerminal as _, Write as _};
use std::process::ExitCode;

use clap::Parser as _;
#[cfg(feature = "otel")]
use octoarm_server::Traces;
use octoarm_server::{LogFormat, LogRate, Options, Reloader, SPANS, Server, Settings};
use tokio::signal::unix::{SignalKind, signal};
use tracing_appender::non_blocking::WorkerGuard;
use tracing_subscriber::filter::filter_fn;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Layer as _};

/// What is written last goes out at the end.
struct Outlets {
    _log: WorkerGuard,
    #[cfg(feature = "otel")]
    traces: Option<Traces>,
}

impl Outlets {
    /// Sends the spans that have not been sent.
    fn finish(&self) {
        #[cfg(feature = "otel")]
        if let Some(traces) = &self.traces
            && let Err(error) = traces.finish()
        {
            tracing::warn!(error, "spans may be lost");
        }
    }
}

/// Starts the log, and the export of traces.
fn start_log(settings: &Settings, rate: LogRate) -> Result<Outlets, String> {
    let level = &settings.log_level;
    // A level alone is that of the server; its libraries only warn.
    let alone = level.chars().all(char::is_alphabetic);
    // Why the transport ended a connection is of interest where connections are.
    let transport = if level == "debug" { ",tonic::transport::server=debug" } else { "" };
    let filter = if alone {
        format!("warn,rustls=error,octoarm_server={level}{transport}")
    } else {
        level.clone()
    };
    // Spans of requests are for the collector alone, whatever the log shows.
    let spans = if settings.otlp_endpoint.is_some() { "info" } else { "off" };
    let filter = EnvFilter::try_new(filter)
        .and_then(|filter| Ok(filter.add_directive(format!("{SPANS}={spans}").parse()?)))
        .map_err(|error| format!("log_level = {:?}: {error}", settings.log_level))?;
    // A reader of the log that comes to a halt must not bring the server to one: lines are dropped.
    let (writer, guard) = tracing_appender::non_blocking(io::stderr());
    let log = tracing_subscriber::fmt::layer()
        .with_ansi(io::stderr().is_terminal())
        // Nobody may be reading: that is no reason to end.
        .log_internal_errors(false)
        .with_writer(writer);
    let log = match settings.log_format {
        LogFormat::Text => log.with_target(false).boxed(),
        LogFormat::Json => log.json().flatten_event(true).boxed(),
    };
    let log = log.with_filter(filter_fn(|metadata| metadata.target() != SPANS));
    let rest = tracing_subscriber::registry();
    #[cfg(feature = "otel")]
    let traces = settings.otlp_endpoint.as_deref().map(Traces::to).transpose()?;
    #[cfg(feature = "otel")]
    let rest = rest.with(traces.as_ref().map(Traces::layer));
    rest.with(log).with(filter).with(rate).init();
    // A panic is a line of the log as everything else.
    std::panic::set_hook(Box::new(|panic| tracing::error!(%panic, "panic")));
    Ok(Outlets {
        _log: guard,
        #[cfg(feature = "otel")]
        traces,
    })
}

/// Listens to the system's signals at once; the future completes when the process is asked to end.
fn told_to_stop() -> io::Result<impl Future<Output = ()>> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    Ok(async move {
        tokio::select! {
            _ = terminate.recv() => tracing::info!(signal = "SIGTERM", "told to stop"),
            _ = interrupt.recv() => tracing::info!(signal = "SIGINT", "told to stop"),
        }
        // Who says it twice does not want to wait.
        tokio::spawn(async move {
            tokio::select! { _ = terminate.recv() => (), _ = interrupt.recv() => () }
            tracing::warn!("told to stop again: everything is broken off");
            std::process::exit(1);
        });
    })
}

/// Has the files of certificate and tokens read again whenever the process is told to.
fn reload_when_told(reloader: Reloader) -> io::Result<()> {
    let mut hangup = signal(SignalKind::hangup())?;
    tokio::spawn(async move {
        while hangup.recv().await.is_some() {
            tracing::info!(signal = "SIGHUP", "told to read certificate and tokens again");
            reloader.reload();
        }
    });
    Ok(())
}

async fn serve(settings: Settings, rate: LogRate) -> Result<(), Box<dyn Error>> {
    // Before anybody is told that there is a server to stop.
    let stop = told_to_stop()?;
    tokio::spawn(rate.keep_watch());
    let server = Server::bind(settings).await?;
    reload_when_told(server.reloader())?;
    let address = server.address()?;
    let scheme = if server.encrypted() { "https" } else { "http" };
    tracing::info!(%address, tls = server.encrypted(), version = env!("CARGO_PKG_VERSION"), "listening");
    let mut out = std::io::stdout().lock();
    // Nobody may be reading.
    let _ = writeln!(out, "octoarm-server listening on {scheme}://{address}");
    if let Some(address) = server.metrics_address()? {
        let _ = writeln!(out, "octoarm-server metrics on http://{address}/metrics");
    }
    let _ = out.flush();
    drop(out);
    server.serve(stop).await?;
    tracing::info!("stopped");
    Ok(())
}

fn run() -> Result<(), (u8, String)> {
    let settings = Options::parse().settle().map_err(|error| (2, error.to_string()))?;
    let rate = LogRate::new(settings.log_rate);
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(settings.server_threads)
        .enable_all()
        .build()
        .map_err(|error| (1, error.to_string()))?;
    // Spans are sent by its tasks.
    let inside = runtime.enter();
    let outlets = start_log(&settings, rate.clone()).map_err(|error| (2, error))?;
    drop(inside);
    let result = runtime.block_on(serve(settings, rate)).map_err(|error| (1, error.to_string()));
    outlets.finish();
    // A long step must not keep the process.
    runtime.shutdown_background();
    result
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err((code, message)) => {
            let _ = writeln!(std::io::stderr(), "octoarm-server: {message}");
            ExitCode::from(code)
        }
    }
}
