//! `GET /metrics`: counters of this process and gauges of the stores, as OpenMetrics text for
//! Prometheus.

use super::AppState;
use super::wire::headers::PREFERENCE_APPLIED;
use crate::clock::Stopwatch;
use crate::jobs::{Counts, PoolUse, StoreError, WorkerKind, WorkerState};
use crate::metrics::{MEDIA_TYPE, Metrics};
use axum::extract::{MatchedPath, Request, State};
use axum::http::header;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::time::Duration;

/// Read the metrics of this process, and the depth of the queue.
///
/// The same metrics are served at `--metrics-addr`, without a key.
#[utoipa::path(
    get, path = "/metrics", operation_id = "get_metrics", tag = "service",
    responses((status = 200, description = "OpenMetrics text. While the job store is unavailable, the gauges read from it keep their last values and `oviduct_job_store_up` is 0",
        content_type = "application/openmetrics-text", body = String))
)]
pub(super) async fn read(State(state): State<AppState>) -> Response {
    read_gauges(&state).await;
    ([(header::CONTENT_TYPE, MEDIA_TYPE)], state.metrics.text()).into_response()
}

/// Maximum wait for the job store. A scrape by Prometheus times out after 10 s by default.
const STORE_TIME: Duration = Duration::from_secs(3);

/// Sets the gauges that are read on request. Metrics stay readable while a store is unavailable.
async fn read_gauges(state: &AppState) {
    let AppState { metrics, limits, .. } = state;
    metrics.set_streams(state.open_streams(), limits.streams);
    metrics.set_held(state.held.used(), limits.held);
    metrics.set_downloads(state.downloads.used(), limits.downloads);
    metrics.task_panicked("events", state.feed.take_panics());
    metrics.set_artifact_store_up(state.artifacts.outage().is_none());
    for PoolUse { name, open, idle, most } in state.store.pools() {
        metrics.set_connections(name, open.saturating_sub(idle), idle, most);
    }
    let read = tokio::time::timeout(STORE_TIME, read_store(state)).await;
    let fault = match read {
        Ok(Ok(())) => None,
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => Some(format!("no answer within {} s", STORE_TIME.as_secs())),
    };
    if let Some(fault) = &fault {
        tracing::warn!(fault, "the gauges of the job store could not be read");
    }
    metrics.set_job_store_up(fault.is_none());
}

async fn read_store(state: &AppState) -> Result<(), StoreError> {
    let AppState { metrics, store, limits, .. } = state;
    metrics.set_jobs(by_status(&store.counts().await?));
    metrics.set_queued(store.queued_by_backend().await?.map(|(backend, count)| (backend.name(), count)));
    metrics.set_oldest(store.queue_ages().await?.map(|(backend, age)| (backend.name(), age)));
    metrics.set_paused(store.paused().await?.is_some());
    let workers = store.workers_within(limits.worker_memory).await?;
    metrics.set_workers([WorkerKind::Cpu, WorkerKind::Gpu].into_iter().flat_map(|kind| {
        WorkerState::ALL.map(|state| {
            let count = workers.iter().filter(|worker| worker.kind == kind && worker.state() == state).count();
            (kind.name(), state.name(), count as u64)
        })
    }));
    Ok(())
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

/// Counts each response and measures its time, by method and route.
pub(super) async fn count(State(metrics): State<Metrics>, request: Request, next: Next) -> Response {
    let method = match request.method().as_str() {
        known @ ("GET" | "HEAD" | "POST" | "PUT" | "PATCH" | "DELETE" | "OPTIONS") => known.to_owned(),
        _ => "other".to_owned(),
    };
    let route = request.extensions().get::<MatchedPath>().map_or("none", MatchedPath::as_str).to_owned();
    let watch = Stopwatch::start();
    let response = next.run(request).await;
    let held = response.headers().contains_key(PREFERENCE_APPLIED);
    metrics.request(&method, &route, response.status().as_u16(), watch.elapsed(), held);
    response
}
