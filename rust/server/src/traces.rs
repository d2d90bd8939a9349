//! A span for each request.

use tracing::Span;

/// The target of the spans of requests, at `info`, by which a log leaves them out.
pub const SPANS: &str = "octoarm_traces";

/// The span of a request that begins; without anybody who listens it is none, and costs nothing.
pub(crate) fn request(connection: u64, stream: u64, token: Option<&str>) -> Span {
    use tracing::field::Empty;
    tracing::info_span!(
        target: SPANS,
        parent: None,
        "request",
        otel.name = Empty,
        otel.kind = "server",
        otel.status_code = Empty,
        error.type = Empty,
        connection,
        stream,
        token,
        world = Empty,
    )
}

/// The part of a world's name that traces show: the whole name is a key.
pub(crate) fn shown(world_name: &str) -> &str {
    world_name.get(..8).unwrap_or_default()
}
