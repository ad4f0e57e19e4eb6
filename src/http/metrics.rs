//! `GET /metrics`: what this process counts, and gauges read from the stores, as OpenMetrics text for Prometheus.

use super::AppState;
use crate::clock::Stopwatch;
use crate::jobs::Counts;
use crate::metrics::{MEDIA_TYPE, Metrics};
use axum::extract::{MatchedPath, Request, State};
use axum::http::header;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

/// Read the metrics of this process, and the depth of the queue.
#[utoipa::path(
    get, path = "/metrics", operation_id = "get_metrics", tag = "service",
    responses((status = 200, description = "OpenMetrics text. While the job store is unavailable, gauges of the queue keep their last values",
        content_type = "application/openmetrics-text", body = String))
)]
pub(super) async fn read(State(state): State<AppState>) -> Response {
    read_gauges(&state).await;
    ([(header::CONTENT_TYPE, MEDIA_TYPE)], state.metrics.text()).into_response()
}

/// Sets the gauges that are read when they are asked for. Metrics stay readable while a store is unavailable.
async fn read_gauges(state: &AppState) {
    state.metrics.set_streams(state.open_streams());
    match state.store.counts().await {
        Ok(counts) => state.metrics.set_jobs(by_status(&counts)),
        Err(error) => tracing::warn!(%error, "jobs could not be counted"),
    }
    match state.store.queued_by_backend().await {
        Ok(queued) => state.metrics.set_queued(queued.map(|(backend, count)| (backend.name(), count))),
        Err(error) => tracing::warn!(%error, "queued jobs could not be counted"),
    }
    state.metrics.set_artifact_store_up(state.artifacts.outage().is_none());
}

fn by_status(counts: &Counts) -> [(&'static str, u64); 5] {
    [
        ("queued", counts.queued),
        ("running", counts.running),
        ("succeeded", counts.succeeded),
        ("failed", counts.failed),
        ("cancelled", counts.cancelled),
    ]
}

/// Counts each response by the pattern of its path.
pub(super) async fn count(State(metrics): State<Metrics>, request: Request, next: Next) -> Response {
    let method = match request.method().as_str() {
        known @ ("GET" | "HEAD" | "POST" | "PUT" | "PATCH" | "DELETE" | "OPTIONS") => known.to_owned(),
        _ => "other".to_owned(),
    };
    let route = request.extensions().get::<MatchedPath>().map_or("none", MatchedPath::as_str).to_owned();
    let watch = Stopwatch::start();
    let response = next.run(request).await;
    metrics.request(&method, &route, response.status().as_u16(), watch.elapsed());
    response
}
