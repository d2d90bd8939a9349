//! What the server is told: on the command line, in the environment, in a file.

use std::fmt::Display;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Parser;
use serde::Deserialize;

use crate::settings::{Limits, LogFormat, Settings, SettingsError, cores};
use crate::tls::CertificateFiles;
use crate::tokens::{self, Token};

/// What can be set, on the command line and under the same names (with `_` for `-`) in a TOML file;
/// the command line goes before the file.
#[derive(Clone, Debug, Default, Parser, Deserialize)]
#[command(
    name = "octoarm-server",
    version,
    about = "The octopus arm as a service: its environments over gRPC, in the protocol dm_env_rpc.",
    after_help = "Every option but --config may stand in the file, as a TOML key of its name with \
                  '_' for '-'.\nThe token is read from the file of --token-file, or from the \
                  environment variable OCTOARM_TOKEN."
)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Address to listen on; one that is not of this machine alone needs TLS and a token.
    #[arg(long, value_name = "ADDRESS")]
    host: Option<IpAddr>,
    /// Port to listen on; 0 takes a free one.
    #[arg(long)]
    port: Option<u16>,
    /// TOML file with settings.
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    config: Option<PathBuf>,
    /// Certificate chain (PEM) that the server shows.
    #[arg(long, value_name = "FILE")]
    tls_certificate: Option<PathBuf>,
    /// Private key (PEM) of the certificate.
    #[arg(long, value_name = "FILE")]
    tls_key: Option<PathBuf>,
    /// File with the tokens of which clients must present one as `authorization: Bearer <token>`: one a
    /// line, with its name and a space before it if it has one.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Worlds at a time [default: 1024].
    #[arg(long, value_name = "NUMBER")]
    max_worlds: Option<usize>,
    /// Worlds at a time that were made through one connection [default: 256].
    #[arg(long, value_name = "NUMBER")]
    max_worlds_per_connection: Option<usize>,
    /// Arms of a world [default: 1024].
    #[arg(long, value_name = "NUMBER")]
    max_num_envs: Option<usize>,
    /// Arms of all worlds together, those of more than 20 compartments by their size [default: 16384].
    #[arg(long, value_name = "NUMBER")]
    max_arms: Option<usize>,
    /// Compartments of an arm [default: 60].
    #[arg(long, value_name = "NUMBER")]
    max_compartments: Option<usize>,
    /// Physics steps of one request, those of all arms together, for arms of 20 compartments; others
    /// count by their size [default: 1000000].
    #[arg(long, value_name = "NUMBER")]
    max_physics_steps: Option<u64>,
    /// Threads that a world may share a step among [default: as many as the processor runs at once].
    #[arg(long, value_name = "NUMBER")]
    max_threads: Option<usize>,
    /// Bytes of a request [default: 4194304].
    #[arg(long, value_name = "BYTES")]
    max_message_size: Option<usize>,
    /// Memory of all worlds together, as the server reckons it, in bytes; one that does not fit in is
    /// refused [default: 1073741824].
    #[arg(long, value_name = "BYTES")]
    max_world_bytes: Option<usize>,
    /// Bytes of requests that are not answered yet, and of large answers that are not sent yet, of all
    /// streams together; what does not fit in is refused [default: 268435456].
    #[arg(long, value_name = "BYTES")]
    max_bytes_in_flight: Option<usize>,
    /// Connections at a time; one more takes the place of the oldest over which no call was let in, or
    /// waits if there is none; there are fewer where the system allows fewer open files [default: 1024].
    #[arg(long, value_name = "NUMBER")]
    max_connections: Option<usize>,
    /// Connections at a time from one address (of IPv6, from one network of 64 bits); what is more is
    /// closed [default: 512].
    #[arg(long, value_name = "NUMBER")]
    max_connections_per_address: Option<usize>,
    /// Streams of a connection at a time; more wait [default: 256].
    #[arg(long, value_name = "NUMBER")]
    max_streams_per_connection: Option<u32>,
    /// Seconds in which a call must be let in over a new connection, or one must watch the health
    /// [default: 10].
    #[arg(long, value_name = "SECONDS")]
    probation_timeout: Option<f64>,
    /// Seconds that a request may take from its first byte to its last [default: 60].
    #[arg(long, value_name = "SECONDS")]
    message_timeout: Option<f64>,
    /// Seconds after which a connection takes no new streams, so that clients connect anew; its streams go
    /// on. Without it connections have no age.
    #[arg(long, value_name = "SECONDS")]
    max_connection_age: Option<f64>,
    /// Seconds without a request after which a stream is ended and its worlds are freed
    /// [default: 3600].
    #[arg(long, value_name = "SECONDS")]
    idle_timeout: Option<f64>,
    /// Seconds between signs of life that are asked of a connection [default: 30].
    #[arg(long, value_name = "SECONDS")]
    keepalive_interval: Option<f64>,
    /// Seconds after which a connection without an answer is given up [default: 20].
    #[arg(long, value_name = "SECONDS")]
    keepalive_timeout: Option<f64>,
    /// Seconds for which a stream's next request is looked for before the server sleeps, while at most
    /// one stream for two cores is open, and makes no steps of a batch: a lone client is answered
    /// sooner; 0 switches it off [default: 0.0002].
    #[arg(long, value_name = "SECONDS")]
    busy_poll: Option<f64>,
    /// Seconds that running requests may take when the server is told to stop [default: 10].
    #[arg(long, value_name = "SECONDS")]
    shutdown_timeout: Option<f64>,
    /// Seconds that running episodes may go on after SIGTERM, while nothing new may begin, before the
    /// server stops; 0: none [default: 0].
    #[arg(long, value_name = "SECONDS")]
    drain_timeout: Option<f64>,
    /// Threads that serve [default: as many as the processor runs at once].
    #[arg(long, value_name = "NUMBER")]
    server_threads: Option<usize>,
    /// Port for Prometheus, at the path /metrics; 0 takes a free one. Without it there are no metrics.
    #[arg(long, value_name = "PORT")]
    metrics_port: Option<u16>,
    /// Address for Prometheus; whoever reaches it can read the metrics [default: 127.0.0.1].
    #[arg(long, value_name = "ADDRESS")]
    metrics_host: Option<IpAddr>,
    /// URL of an OpenTelemetry collector, such as http://127.0.0.1:4317, that gets a span for each
    /// request by OTLP over gRPC; else the environment variable OTEL_EXPORTER_OTLP_ENDPOINT says so. It
    /// needs a server that was built with the feature `otel`.
    #[arg(long, value_name = "URL")]
    otlp_endpoint: Option<String>,
    /// Log lines for eyes (text) or programs (json) [default: text].
    #[arg(long, value_name = "FORMAT")]
    log_format: Option<LogFormat>,
    /// What is logged: error, warn, info, debug, trace, or a filter of tracing [default: info].
    #[arg(long, value_name = "LEVEL")]
    log_level: Option<String>,
    /// Lines that the log takes in a second; how many more there were is a line of its own
    /// [default: 1000].
    #[arg(long, value_name = "NUMBER")]
    log_rate: Option<u64>,
}

/// Environment variable that holds the token.
const TOKEN_VARIABLE: &str = "OCTOARM_TOKEN";
/// Environment variable that names the collector of traces.
const OTLP_VARIABLE: &str = "OTEL_EXPORTER_OTLP_ENDPOINT";
/// The port that gRPC's examples use.
const PORT: u16 = 50_051;
/// Shortest time that may be set \[s\].
const SHORTEST: f64 = 0.001;
/// Longest time that may be set \[s\].
const LONGEST: f64 = 1e9;
/// Longest time for which a request is looked for without sleeping \[s\].
const LONGEST_BUSY: f64 = 0.01;

fn read_file(option: &str, path: &Path) -> Result<String, SettingsError> {
    std::fs::read_to_string(path)
        .map_err(|error| SettingsError::Value(format!("{option} {}: {error}", path.display())))
}

fn outside(name: &str, value: impl Display, range: &str) -> SettingsError {
    SettingsError::Value(format!("{name} = {value} is outside the allowed range {range}"))
}

fn positive<T: PartialOrd + Default + Display>(
    name: &str,
    value: Option<T>,
    default: T,
) -> Result<T, SettingsError> {
    match value.unwrap_or(default) {
        value if value > T::default() => Ok(value),
        value => Err(SettingsError::Value(format!("{name} = {value}: expected a positive number"))),
    }
}

/// A time in seconds from `low` to `high`.
fn within(
    name: &str,
    value: Option<f64>,
    default: Duration,
    (low, high): (f64, f64),
) -> Result<Duration, SettingsError> {
    match value {
        None => Ok(default),
        Some(value) if (low..=high).contains(&value) => Ok(Duration::from_secs_f64(value)),
        Some(value) => Err(outside(name, value, &format!("[{low}, {high}] s"))),
    }
}

fn seconds(name: &str, value: Option<f64>, default: Duration) -> Result<Duration, SettingsError> {
    within(name, value, default, (SHORTEST, LONGEST))
}

fn moment(name: &str, value: Option<f64>, default: Duration) -> Result<Duration, SettingsError> {
    within(name, value, default, (0.0, LONGEST_BUSY))
}

/// Most threads of any kind.
const MOST_THREADS: usize = 1024;

fn threads(name: &str, value: Option<usize>, default: usize) -> Result<usize, SettingsError> {
    match value {
        None => Ok(default.min(MOST_THREADS)),
        Some(value) if (1..=MOST_THREADS).contains(&value) => Ok(value),
        Some(value) => Err(outside(name, value, &format!("[1, {MOST_THREADS}]"))),
    }
}

/// Where spans go, if anywhere.
fn collector(given: Option<String>) -> Result<Option<String>, SettingsError> {
    if !cfg!(feature = "otel") {
        // The variable is for all programs of a machine, whether they have traces or not.
        return match given {
            None => Ok(None),
            Some(_) => Err(SettingsError::Value(
                "otlp_endpoint needs a server that was built with traces: cargo build --release -p \
                 octoarm-server --features otel"
                    .to_owned(),
            )),
        };
    }
    let (name, url) = match (given, std::env::var(OTLP_VARIABLE)) {
        (Some(url), _) => ("otlp_endpoint", url),
        (None, Ok(url)) if !url.is_empty() => (OTLP_VARIABLE, url),
        _ => return Ok(None),
    };
    let parsed = url.parse::<http::Uri>().ok();
    let scheme = parsed.as_ref().and_then(http::Uri::scheme_str);
    if !matches!(scheme, Some("http" | "https")) {
        return Err(SettingsError::Value(format!(
            "{name} = {url:?}: expected a URL of http or https, such as http://127.0.0.1:4317"
        )));
    }
    Ok(Some(url))
}

macro_rules! prefer {
    ($first:ident, $second:ident; $($field:ident)*) => {
        Options { config: None, $($field: $first.$field.or($second.$field)),* }
    };
}

impl Options {
    /// What is set here, and from `file` what is not.
    fn or(self, file: Self) -> Self {
        prefer!(self, file; host port tls_certificate tls_key token_file max_worlds
            max_worlds_per_connection max_num_envs max_arms max_compartments
            max_physics_steps max_threads max_message_size max_world_bytes max_bytes_in_flight
            max_connections max_connections_per_address max_streams_per_connection
            probation_timeout message_timeout max_connection_age idle_timeout keepalive_interval
            keepalive_timeout busy_poll shutdown_timeout drain_timeout server_threads metrics_port
            metrics_host otlp_endpoint log_format log_level log_rate)
    }

    fn from_file(path: &Path) -> Result<Self, SettingsError> {
        let fail =
            |reason: String| SettingsError::File { path: path.display().to_string(), reason };
        let text = std::fs::read_to_string(path).map_err(|error| fail(error.to_string()))?;
        toml::from_str(&text).map_err(|error| fail(error.to_string().trim_end().to_owned()))
    }

    /// Reads the files that are named, and checks every setting.
    ///
    /// # Errors
    /// [`SettingsError`] that names the setting, its value and what is allowed.
    pub fn settle(mut self) -> Result<Settings, SettingsError> {
        let options = match self.config.take() {
            Some(path) => {
                let file = Self::from_file(&path)?;
                self.or(file)
            }
            None => self,
        };
        let standard = Limits::default();
        macro_rules! checked {
            ($check:ident $field:ident) => {
                $check(stringify!($field), options.$field, standard.$field)?
            };
        }
        let limits = Limits {
            max_worlds: checked!(positive max_worlds),
            max_worlds_per_connection: checked!(positive max_worlds_per_connection),
            max_num_envs: checked!(positive max_num_envs),
            max_arms: checked!(positive max_arms),
            max_compartments: checked!(positive max_compartments),
            max_physics_steps: checked!(positive max_physics_steps),
            max_threads: checked!(threads max_threads),
            max_message_size: checked!(positive max_message_size),
            max_world_bytes: checked!(positive max_world_bytes),
            max_bytes_in_flight: checked!(positive max_bytes_in_flight),
            max_connections: checked!(positive max_connections),
            max_connections_per_address: checked!(positive max_connections_per_address),
            max_streams_per_connection: checked!(positive max_streams_per_connection),
            probation_timeout: checked!(seconds probation_timeout),
            message_timeout: checked!(seconds message_timeout),
            max_connection_age: match options.max_connection_age {
                None => None,
                age => Some(seconds("max_connection_age", age, Duration::ZERO)?),
            },
            idle_timeout: checked!(seconds idle_timeout),
            keepalive_interval: checked!(seconds keepalive_interval),
            keepalive_timeout: checked!(seconds keepalive_timeout),
            busy_poll: checked!(moment busy_poll),
        };
        let tls = match (options.tls_certificate, options.tls_key) {
            (None, None) => None,
            (Some(certificate), Some(key)) => {
                read_file("tls_certificate", &certificate)?;
                read_file("tls_key", &key)?;
                Some(CertificateFiles { certificate, key })
            }
            _ => {
                return Err(SettingsError::Value(
                    "tls_certificate and tls_key go together: give both or none".to_owned(),
                ));
            }
        };
        let tokens = match &options.token_file {
            Some(path) => tokens::read_file(path).map_err(SettingsError::Value)?,
            None => match std::env::var(TOKEN_VARIABLE) {
                Ok(text) => Token::read(TOKEN_VARIABLE, &text).map_err(SettingsError::Value)?,
                Err(std::env::VarError::NotPresent) => Vec::new(),
                Err(error) => {
                    return Err(SettingsError::Value(format!("{TOKEN_VARIABLE}: {error}")));
                }
            },
        };
        let host = options.host.unwrap_or(IpAddr::V4(Ipv4Addr::LOCALHOST));
        if !host.is_loopback() && (tls.is_none() || tokens.is_empty()) {
            return Err(SettingsError::Value(format!(
                "host = {host} can be reached from other machines: that needs tls_certificate, \
                 tls_key and a token (token_file or {TOKEN_VARIABLE})"
            )));
        }
        let metrics_host = options.metrics_host.unwrap_or(IpAddr::V4(Ipv4Addr::LOCALHOST));
        Ok(Settings {
            address: SocketAddr::new(host, options.port.unwrap_or(PORT)),
            tls,
            tokens,
            token_file: options.token_file,
            limits,
            shutdown_timeout: seconds(
                "shutdown_timeout",
                options.shutdown_timeout,
                Duration::from_secs(10),
            )?,
            drain_timeout: within(
                "drain_timeout",
                options.drain_timeout,
                Duration::ZERO,
                (0.0, LONGEST),
            )?,
            log_rate: positive("log_rate", options.log_rate, 1000)?,
            server_threads: threads("server_threads", options.server_threads, cores())?,
            metrics: options.metrics_port.map(|port| SocketAddr::new(metrics_host, port)),
            otlp_endpoint: collector(options.otlp_endpoint)?,
            log_format: options.log_format.unwrap_or_default(),
            log_level: options.log_level.unwrap_or_else(|| "info".to_owned()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settle(arguments: &[&str]) -> Result<Settings, String> {
        let all = std::iter::once("octoarm-server").chain(arguments.iter().copied());
        Options::try_parse_from(all)
            .map_err(|error| error.to_string())?
            .settle()
            .map_err(|error| error.to_string())
    }

    fn written(name: &str, text: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("octoarm-settings-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("folder");
        let path = folder.join(name);
        std::fs::write(&path, text).expect("file");
        path
    }

    #[test]
    fn loopback_is_the_default_and_needs_nothing() {
        let settings = settle(&[]).expect("settings");
        assert_eq!(settings.address.to_string(), "127.0.0.1:50051");
        assert!(settings.tls.is_none() && settings.metrics.is_none());
        assert_eq!(settings.limits, Limits::default());
        assert!(settle(&["--host", "::1", "--port", "0"]).is_ok());
    }

    #[test]
    fn wider_needs_tls_and_a_token() {
        let certificate = written("certificate.pem", "certificate").display().to_string();
        let token = written("token", " 0123456789abcdef\n").display().to_string();
        let tls = ["--tls-certificate", &certificate, "--tls-key", &certificate];
        for host in ["0.0.0.0", "::", "192.168.1.2"] {
            let bare = settle(&["--host", host]).expect_err("bare");
            assert!(bare.contains("needs tls_certificate"), "{bare}");
            let with = |more: &[&str]| settle(&[&["--host", host], more].concat());
            assert!(with(&tls).is_err());
            assert!(with(&["--token-file", &token]).is_err());
            assert!(with(&[&tls[..], &["--token-file", &token]].concat()).is_ok());
        }
        let half = settle(&["--tls-key", &certificate]).expect_err("half");
        assert!(half.contains("go together"), "{half}");
    }

    #[test]
    fn the_command_line_goes_before_the_file() {
        let file = written(
            "settings.toml",
            "port = 7000\nmax_worlds = 3\nidle_timeout = 1.5\nlog_format = \"json\"\n",
        );
        let file = file.display().to_string();
        let settings = settle(&["--config", &file, "--max-worlds", "5"]).expect("settings");
        assert_eq!(settings.address.port(), 7000);
        assert_eq!(settings.limits.max_worlds, 5);
        assert_eq!(settings.limits.idle_timeout, Duration::from_millis(1500));
        assert_eq!(settings.log_format, LogFormat::Json);
    }

    #[test]
    fn bad_settings_are_named() {
        for (arguments, expected) in [
            (&["--max-worlds", "0"][..], "max_worlds = 0"),
            (&["--idle-timeout", "0"], "idle_timeout = 0"),
            (&["--busy-poll", "1"], "busy_poll = 1 is outside the allowed range [0, 0.01]"),
            (&["--max-threads", "18446744073709551615"], "max_threads = 18446744073709551615"),
            (&["--server-threads", "100000"], "server_threads = 100000"),
            (&["--idle-timeout", "nan"], "idle_timeout = NaN"),
            (&["--token-file", "/nowhere/token"], "token_file /nowhere/token"),
            (&["--config", "/nowhere/settings.toml"], "--config /nowhere/settings.toml"),
            (&["--host", "elsewhere"], "--host"),
            (&["--port", "70000"], "70000"),
        ] {
            let message = settle(arguments).expect_err("refused");
            assert!(message.contains(expected), "{arguments:?}: {message}");
        }
        // Traces are refused where there are none, and without a scheme where there are.
        let message = settle(&["--otlp-endpoint", "127.0.0.1:4317"]).expect_err("no scheme");
        let expected = if cfg!(feature = "otel") { "expected a URL" } else { "--features otel" };
        assert!(message.contains("otlp_endpoint") && message.contains(expected), "{message}");
        let url = settle(&["--otlp-endpoint", "http://127.0.0.1:4317"]);
        assert_eq!(url.is_ok(), cfg!(feature = "otel"));
        let file = written("unknown.toml", "max_wolrds = 3\n").display().to_string();
        let message = settle(&["--config", &file]).expect_err("unknown");
        assert!(message.contains("max_wolrds"), "{message}");
        let short = written("short", "abc").display().to_string();
        let message = settle(&["--token-file", &short]).expect_err("short");
        assert!(message.contains("token_file"), "{message}");
        assert!(!message.contains("abc"), "{message}");
    }
}
