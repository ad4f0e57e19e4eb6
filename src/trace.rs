//! Traces that continue across processes: the context of a span as W3C `traceparent`, from the
//! header of a request and in the record of a job. If no traces are collected, there is no context,
//! and the functions have no effect.

use opentelemetry::global;
use std::collections::HashMap;
use tracing::Span;
use tracing_opentelemetry::OpenTelemetrySpanExt;

/// Name of the header that contains a context.
pub const TRACEPARENT: &str = "traceparent";

/// The context of the current span.
#[must_use]
pub fn current() -> Option<String> {
    let mut carrier = HashMap::new();
    let context = Span::current().context();
    global::get_text_map_propagator(|propagator| propagator.inject_context(&context, &mut carrier));
    carrier.remove(TRACEPARENT)
}

/// Makes the new `span` part of the trace that `traceparent` names; an invalid value is ignored.
pub fn adopt(span: &Span, traceparent: Option<&str>) {
    let Some(traceparent) = traceparent else { return };
    let carrier = HashMap::from([(TRACEPARENT.to_owned(), traceparent.to_owned())]);
    let context = global::get_text_map_propagator(|propagator| propagator.extract(&carrier));
    // Fails if no traces are collected.
    let _ = span.set_parent(context);
}
