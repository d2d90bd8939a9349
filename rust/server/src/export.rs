//! Where the spans of requests go.

use std::time::Duration;

use opentelemetry::KeyValue;
use opentelemetry::trace::TracerProvider as _;
use opentelemetry_otlp::{SpanExporter, WithExportConfig as _};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::SdkTracerProvider;
use tracing::Subscriber;
use tracing_subscriber::Layer;
use tracing_subscriber::filter::filter_fn;
use tracing_subscriber::registry::LookupSpan;

use crate::traces::SPANS;

/// Longest time that a server which has stopped waits for its collector.
const LONGEST_END: Duration = Duration::from_secs(3);

/// The way of spans to a collector, by OTLP over gRPC.
#[derive(Clone, Debug)]
pub struct Traces {
    provider: SdkTracerProvider,
}

impl Traces {
    /// Will send spans to the collector at a URL; tokio's runtime must be entered, which carries
    /// them. That nobody answers there is no error.
    ///
    /// # Errors
    /// What is wrong with the URL.
    pub fn to(endpoint: &str) -> Result<Self, String> {
        let exporter = SpanExporter::builder().with_tonic().with_endpoint(endpoint).build();
        let exporter =
            exporter.map_err(|error| format!("otlp_endpoint = {endpoint:?}: {error}"))?;
        let mut resource = Resource::builder()
            .with_attribute(KeyValue::new("service.version", env!("CARGO_PKG_VERSION")));
        // Who names it otherwise has a reason.
        if std::env::var_os("OTEL_SERVICE_NAME").is_none() {
            resource = resource.with_service_name("octoarm-server");
        }
        let provider = SdkTracerProvider::builder()
            .with_resource(resource.build())
            .with_batch_exporter(exporter)
            .build();
        Ok(Self { provider })
    }

    /// What hands the requests' spans on.
    pub fn layer<S: Subscriber + for<'a> LookupSpan<'a>>(&self) -> impl Layer<S> + use<S> {
        tracing_opentelemetry::layer()
            .with_tracer(self.provider.tracer("octoarm-server"))
            .with_location(false)
            .with_threads(false)
            .with_target(false)
            .with_tracked_inactivity(false)
            .with_filter(filter_fn(|metadata| metadata.target() == SPANS))
    }

    /// Sends what has not been sent yet, for at most 3 s. Not to be called where tasks run.
    ///
    /// # Errors
    /// Why some spans may be lost.
    pub fn finish(&self) -> Result<(), String> {
        self.provider.shutdown_with_timeout(LONGEST_END).map_err(|error| error.to_string())
    }
}
