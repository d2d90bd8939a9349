//! What Prometheus can ask the server.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64};

use octoarm_protocol::environment_request::Payload;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric, text};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::{ConstGauge, Gauge};
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Registry, Unit};

/// Kinds of requests; the last are those that hold none that is known.
const KINDS: [&str; 9] = [
    "create_world",
    "join_world",
    "step",
    "reset",
    "reset_world",
    "leave_world",
    "destroy_world",
    "extension",
    "unknown",
];

/// The codes that a refusal has.
const CODES: [(tonic::Code, &str); 10] = [
    (tonic::Code::InvalidArgument, "INVALID_ARGUMENT"),
    (tonic::Code::DeadlineExceeded, "DEADLINE_EXCEEDED"),
    (tonic::Code::NotFound, "NOT_FOUND"),
    (tonic::Code::PermissionDenied, "PERMISSION_DENIED"),
    (tonic::Code::ResourceExhausted, "RESOURCE_EXHAUSTED"),
    (tonic::Code::FailedPrecondition, "FAILED_PRECONDITION"),
    (tonic::Code::Aborted, "ABORTED"),
    (tonic::Code::Unimplemented, "UNIMPLEMENTED"),
    (tonic::Code::Internal, "INTERNAL"),
    (tonic::Code::Unavailable, "UNAVAILABLE"),
];

type Labels = Vec<(&'static str, &'static str)>;
type Count = Counter<u64, AtomicU64>;
pub(crate) type Level = Gauge<i64, AtomicI64>;

/// What is counted of one kind of request.
#[derive(Clone, Debug)]
pub(crate) struct Requests {
    /// Its name.
    pub(crate) kind: &'static str,
    answered: Count,
    refused: Count,
    seconds: Histogram,
}

impl Requests {
    /// Counts a request that took so long.
    pub(crate) fn count(&self, refused: bool, seconds: f64) {
        if refused {
            self.refused.inc()
        } else {
            self.answered.inc()
        };
        self.seconds.observe(seconds);
    }
}

/// The server's counters and levels.
#[derive(Debug)]
pub(crate) struct Metrics {
    registry: Registry,
    requests: [Requests; KINDS.len()],
    /// Control periods of all arms.
    pub(crate) steps: Count,
    /// Streams that were refused for a wrong or missing token.
    pub(crate) unauthenticated: Count,
    /// Streams that were ended for want of requests.
    pub(crate) idle: Count,
    /// Open connections.
    pub(crate) connections: Level,
    /// Open streams.
    pub(crate) streams: Level,
    /// Worlds, those in the making included.
    pub(crate) worlds: Level,
    /// Memory that was set aside for them \[bytes\].
    pub(crate) world_bytes: Level,
    /// Requests that are not answered, and large answers that are not sent \[bytes\].
    pub(crate) bytes_in_flight: Level,
    errors: Family<Labels, Count>,
    turned_away: Family<Labels, Count>,
    waiting: Family<Labels, Level>,
    clients: Family<Vec<(&'static str, String)>, Level>,
}

/// A stream of a client whose token has a name, as long as there is this.
#[derive(Debug)]
pub(crate) struct Present(Level);

impl Drop for Present {
    fn drop(&mut self) {
        self.0.dec();
    }
}

/// Memory of the process, read when it is asked for.
#[derive(Debug)]
struct Process;

impl Collector for Process {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> Result<(), std::fmt::Error> {
        // Linux alone tells; elsewhere there is no such line.
        let Ok(text) = std::fs::read_to_string("/proc/self/status") else { return Ok(()) };
        for (key, name, help, scale) in [
            ("VmRSS:", "process_resident_memory", "Resident memory of the process", 1024),
            ("Threads:", "process_threads", "Threads of the process", 1),
        ] {
            let line = text.lines().find_map(|line| line.strip_prefix(key));
            let number = line.and_then(|line| line.split_whitespace().next()?.parse::<i64>().ok());
            let Some(number) = number else { continue };
            let gauge = ConstGauge::new(number * scale);
            let unit = (scale != 1).then_some(&Unit::Bytes);
            let encoder = encoder.encode_descriptor(name, help, unit, gauge.metric_type())?;
            gauge.encode(encoder)?;
        }
        Ok(())
    }
}

impl Metrics {
    /// Metrics that are all at zero.
    pub(crate) fn new() -> Arc<Self> {
        let mut registry = Registry::default();
        registry.register_collector(Box::new(Process));
        let registry_ref = registry.sub_registry_with_prefix("octoarm");
        let version = Info::new(vec![("version", env!("CARGO_PKG_VERSION"))]);
        registry_ref.register("build", "The server's version", version);
        let counts: Family<Labels, Count> = Family::default();
        // From 10 µs to 2.6 s.
        let times: Family<Labels, Histogram> =
            Family::new_with_constructor(|| Histogram::new(exponential_buckets(1e-5, 2.0, 19)));
        registry_ref.register("requests", "Requests answered or refused", counts.clone());
        registry_ref.register_with_unit(
            "request_duration",
            "Time from a request's arrival to its answer",
            Unit::Seconds,
            times.clone(),
        );
        let requests = KINDS.map(|kind| {
            let count =
                |result| counts.get_or_create_owned(&vec![("request", kind), ("result", result)]);
            Requests {
                kind,
                answered: count("answered"),
                refused: count("refused"),
                seconds: times.get_or_create_owned(&vec![("request", kind)]),
            }
        });
        let mut counter = |name: &str, help: &str| {
            let counter = Count::default();
            registry_ref.register(name, help, counter.clone());
            counter
        };
        let steps = counter("environment_steps", "Control periods of all arms");
        let unauthenticated = counter("unauthenticated", "Calls with a wrong token or none");
        let idle = counter("idle_streams", "Streams ended for want of requests");
        let mut gauge = |name: &str, help: &str| {
            let gauge = Level::default();
            registry_ref.register(name, help, gauge.clone());
            gauge
        };
        let connections = gauge("connections", "Open connections");
        let streams = gauge("streams", "Open streams");
        let worlds = gauge("worlds", "Worlds");
        let mut gauge_bytes = |name: &str, help: &str| {
            let gauge = Level::default();
            registry_ref.register_with_unit(name, help, Unit::Bytes, gauge.clone());
            gauge
        };
        let world_bytes = gauge_bytes("worlds_memory", "Memory set aside for worlds");
        let bytes_in_flight =
            gauge_bytes("in_flight", "Requests not answered, and large answers not sent");
        let errors: Family<Labels, Count> = Family::default();
        registry_ref.register("errors", "Requests refused, by gRPC's code", errors.clone());
        let turned_away: Family<Labels, Count> = Family::default();
        registry_ref.register(
            "connections_turned_away",
            "Connections closed for want of places",
            turned_away.clone(),
        );
        let waiting: Family<Labels, Level> = Family::default();
        registry_ref.register("jobs_waiting", "Long work that waits for its turn", waiting.clone());
        let clients: Family<Vec<(&'static str, String)>, Level> = Family::default();
        registry_ref.register(
            "client_streams",
            "Open streams of the clients with a token, by its name",
            clients.clone(),
        );
        Arc::new(Self {
            requests,
            steps,
            unauthenticated,
            idle,
            connections,
            streams,
            worlds,
            world_bytes,
            bytes_in_flight,
            errors,
            turned_away,
            waiting,
            clients,
            registry,
        })
    }

    /// Counts a request that was refused; gives the code's name.
    pub(crate) fn refused(&self, code: tonic::Code) -> &'static str {
        // As gRPC writes it.
        let name = CODES.iter().find(|(known, _)| *known == code).map_or("OTHER", |(_, name)| name);
        self.errors.get_or_create_owned(&vec![("code", name)]).inc();
        name
    }

    /// Counts a connection that was closed because there are too many.
    pub(crate) fn turned_away(&self, reason: &'static str) {
        self.turned_away.get_or_create_owned(&vec![("reason", reason)]).inc();
    }

    /// The number of jobs that wait for a pool.
    pub(crate) fn waiting(&self, pool: &'static str) -> Level {
        self.waiting.get_or_create_owned(&vec![("pool", pool)])
    }

    /// Counts a stream that the token of this name has opened.
    pub(crate) fn present(&self, token: &str) -> Present {
        let level = self.clients.get_or_create_owned(&vec![("token", token.to_owned())]);
        level.inc();
        Present(level)
    }

    /// The counters of requests that make worlds.
    pub(crate) fn of_creation(&self) -> &Requests {
        &self.requests[0]
    }

    /// The counters of a request's kind.
    pub(crate) fn of(&self, payload: Option<&Payload>) -> &Requests {
        let kind = match payload {
            Some(Payload::CreateWorld(_)) => 0,
            Some(Payload::JoinWorld(_)) => 1,
            Some(Payload::Step(_)) => 2,
            Some(Payload::Reset(_)) => 3,
            Some(Payload::ResetWorld(_)) => 4,
            Some(Payload::LeaveWorld(_)) => 5,
            Some(Payload::DestroyWorld(_)) => 6,
            Some(Payload::Extension(_)) => 7,
            None => 8,
        };
        &self.requests[kind]
    }

    /// All of them in the format that Prometheus reads.
    pub(crate) fn text(&self) -> Result<String, std::fmt::Error> {
        let mut out = String::new();
        text::encode(&mut out, &self.registry)?;
        Ok(out)
    }
}
