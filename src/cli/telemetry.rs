//! The log on stderr, and traces to an OpenTelemetry collector if one is configured.
//!
//! Each request and each attempt is a span; the stages of an attempt are spans within it. Spans are
//! sent in batches over OTLP (HTTP, protobuf). If the collector is unavailable, spans are lost; the
//! process continues.

use super::args::{Global, LogFormat};
use super::exit::Failure;
use opentelemetry::trace::TracerProvider;
use opentelemetry::{KeyValue, global};
use opentelemetry_otlp::{Protocol, SpanExporter, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::propagation::TraceContextPropagator;
use opentelemetry_sdk::trace::SdkTracerProvider;
use std::io::IsTerminal;
use tracing::level_filters::LevelFilter;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

/// Variables of the OpenTelemetry specification for the address of the collector.
const ENDPOINTS: [&str; 2] = ["OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "OTEL_EXPORTER_OTLP_ENDPOINT"];
const SERVICE_NAME: &str = "OTEL_SERVICE_NAME";

/// The exporter of traces, if there is one.
pub(super) struct Telemetry(Option<SdkTracerProvider>);

impl Telemetry {
    /// Starts the log and, if a collector is configured, traces. `default` is the filter of the log
    /// unless an option gives another. Only a process that `serves` reads the collector from the
    /// variables of the OpenTelemetry specification. Call it before an async runtime exists.
    ///
    /// # Errors
    /// [`Failure::Usage`] for an invalid filter or URL.
    pub(super) fn start(global: &Global, default: &str, serves: bool) -> Result<Self, Failure> {
        let filter = global.log.as_deref().unwrap_or(default);
        let filter = EnvFilter::try_new(filter).map_err(|error| Failure::usage(format!("--log {filter}: {error}")))?;
        let log =
            tracing_subscriber::fmt::layer().with_writer(std::io::stderr).with_ansi(std::io::stderr().is_terminal());
        let log = match global.log_format {
            LogFormat::Text => log.boxed(),
            LogFormat::Json => log.json().boxed(),
        };
        let provider = match &global.otlp_endpoint {
            Some(endpoint) => Some(provider(Some(endpoint))?),
            None if serves && ENDPOINTS.iter().any(|name| is_set(name)) => Some(provider(None)?),
            None => None,
        };
        let traces = provider.as_ref().map(|provider| {
            // Log events of the exporter itself must not become traces.
            let ours = Targets::new().with_target(env!("CARGO_CRATE_NAME"), LevelFilter::INFO);
            let layer = tracing_opentelemetry::layer().with_tracer(provider.tracer(env!("CARGO_PKG_NAME")));
            layer.with_location(false).with_threads(false).with_filter(ours)
        });
        let started = tracing_subscriber::registry().with(log.with_filter(filter)).with(traces).try_init();
        started.map_err(|error| Failure::Failed(anyhow::anyhow!("logging could not be started: {error}")))?;
        Ok(Self(provider))
    }

    /// Sends the remaining spans.
    pub(super) fn stop(self) {
        if let Some(Err(error)) = self.0.map(|provider| provider.shutdown()) {
            tracing::warn!(%error, "the last spans could not be sent to the collector");
        }
    }
}

fn is_set(name: &str) -> bool {
    std::env::var_os(name).is_some_and(|value| !value.is_empty())
}

fn provider(endpoint: Option<&String>) -> Result<SdkTracerProvider, Failure> {
    crate::tls::install();
    let mut exporter = SpanExporter::builder().with_http().with_protocol(Protocol::HttpBinary);
    if let Some(endpoint) = endpoint {
        let bad = |detail: String| Failure::usage(format!("--otlp-endpoint {endpoint}: {detail}"));
        let url = reqwest::Url::parse(endpoint).map_err(|error| bad(error.to_string()))?;
        if !matches!(url.scheme(), "http" | "https") {
            return Err(bad("must be an http or https URL".to_owned()));
        }
        exporter = exporter.with_endpoint(format!("{}/v1/traces", endpoint.trim_end_matches('/')));
    }
    let exporter = exporter
        .build()
        .map_err(|error| Failure::usage(format!("the trace exporter could not be started: {error}")))?;
    let mut resource = Resource::builder().with_attribute(KeyValue::new("service.version", crate::ENGINE_VERSION));
    if !is_set(SERVICE_NAME) {
        resource = resource.with_service_name(env!("CARGO_PKG_NAME"));
    }
    global::set_text_map_propagator(TraceContextPropagator::new());
    Ok(SdkTracerProvider::builder().with_resource(resource.build()).with_batch_exporter(exporter).build())
}
