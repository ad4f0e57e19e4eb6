//! The metrics of this process in the OpenMetrics text format, which Prometheus reads.
//!
//! Counters and histograms cover this process only: sum them over the processes. Gauges that are read from the stores
//! (`oviduct_jobs`, `oviduct_stored_bytes`) are the same from every process: take their maximum, not their sum. Label
//! values come from the code, never from requests, so that their number is bounded.

use prometheus_client::encoding::text::encode;
use prometheus_client::encoding::{EncodeLabelSet, EncodeLabelValue, LabelValueEncoder};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::Registry;
use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Duration;

/// Media type of the text.
pub const MEDIA_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// A label value known at compile time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Word(&'static str);

impl EncodeLabelValue for Word {
    fn encode(&self, encoder: &mut LabelValueEncoder<'_>) -> Result<(), std::fmt::Error> {
        encoder.write_str(self.0)
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct StatusLabel {
    status: Word,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct BackendLabel {
    backend: Word,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct StageLabel {
    stage: Word,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct EndLabel {
    end: Word,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct MadeLabel {
    backend: Word,
    device: String,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct CauseLabel {
    cause: Word,
}

/// Why a job with backend `auto` runs on the CPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fallback {
    /// No GPU worker was alive.
    NoGpu,
    /// The GPU workers had so many queued jobs that a CPU worker took this one.
    Busy,
    /// A GPU worker claimed it, but its device could not compute it: limits, lost, out of memory.
    Device,
}

impl Fallback {
    /// Value of the label.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NoGpu => "no-gpu",
            Self::Busy => "busy",
            Self::Device => "device",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct DirectionLabel {
    direction: Word,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct RequestLabel {
    method: String,
    route: String,
    status: u16,
}

type Durations<L> = Family<L, Histogram, fn() -> Histogram>;

/// The metrics of a process. Clones share them.
#[derive(Clone, Debug)]
pub struct Metrics(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    registry: Registry,
    jobs: Family<StatusLabel, Gauge>,
    queued: Family<BackendLabel, Gauge>,
    artifact_store_up: Gauge,
    stored: Gauge,
    streams: Gauge,
    wait: Histogram,
    stages: Durations<StageLabel>,
    made: Family<MadeLabel, Counter>,
    fallbacks: Family<CauseLabel, Counter>,
    attempts: Family<EndLabel, Counter>,
    leases_lost: Counter,
    bytes: Family<DirectionLabel, Counter>,
    checkpoints: Counter,
    removed: Counter,
    requests: Family<RequestLabel, Counter>,
    request_seconds: Histogram,
}

/// From a tenth of a second to about three hours.
fn long() -> Histogram {
    Histogram::new(exponential_buckets(0.1, 2.0, 17))
}

/// From a millisecond to about a minute.
fn short() -> Histogram {
    Histogram::new(exponential_buckets(0.001, 2.0, 16))
}

/// From ten milliseconds to about twenty minutes.
fn stage() -> Histogram {
    Histogram::new(exponential_buckets(0.01, 2.0, 17))
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix("oviduct");
        let inner = Inner {
            jobs: Family::default(),
            queued: Family::default(),
            artifact_store_up: Gauge::default(),
            stored: Gauge::default(),
            streams: Gauge::default(),
            wait: long(),
            stages: Durations::new_with_constructor(stage as fn() -> Histogram),
            made: Family::default(),
            fallbacks: Family::default(),
            attempts: Family::default(),
            leases_lost: Counter::default(),
            bytes: Family::default(),
            checkpoints: Counter::default(),
            removed: Counter::default(),
            requests: Family::default(),
            request_seconds: short(),
            registry: Registry::default(),
        };
        registry.register(
            "jobs",
            "Jobs by status, from the store; queued is the depth of the queue",
            inner.jobs.clone(),
        );
        registry.register("queued_jobs", "Queued jobs by the backend asked for, from the store", inner.queued.clone());
        registry.register(
            "artifact_store_up",
            "1 unless this process's latest write to the artifact store failed",
            inner.artifact_store_up.clone(),
        );
        inner.artifact_store_up.set(1);
        registry.register("stored_bytes", "Bytes of all files of models, from the store", inner.stored.clone());
        registry.register("event_streams", "Event streams open in this process", inner.streams.clone());
        registry.register(
            "queue_wait_seconds",
            "Time from a job's acceptance to its first claim, of jobs first claimed by this process",
            inner.wait.clone(),
        );
        registry.register("stage_seconds", "Run time of a job by stage", inner.stages.clone());
        registry.register("models_made", "Models made by this process, by backend and device", inner.made.clone());
        registry.register(
            "fallbacks",
            "Attempts of this process at jobs with backend auto that ran on a CPU: no-gpu (no GPU worker was alive), busy \
             (the GPU workers had too many jobs), device (the device could not compute the model)",
            inner.fallbacks.clone(),
        );
        registry.register("attempts", "Attempts of this process, by end", inner.attempts.clone());
        registry.register("leases_lost", "Attempts of this process whose lease was lost", inner.leases_lost.clone());
        registry.register("artifact_bytes", "Bytes to (in) and from (out) the artifact store", inner.bytes.clone());
        registry.register("checkpoints", "Checkpoints stored", inner.checkpoints.clone());
        registry.register(
            "models_removed",
            "Models removed because of their age or of the limit on bytes",
            inner.removed.clone(),
        );
        registry.register("http_requests", "Requests answered", inner.requests.clone());
        registry.register(
            "http_request_seconds",
            "Time to the head of the response, including long polls and streams",
            inner.request_seconds.clone(),
        );
        Self(Arc::new(Inner { registry, ..inner }))
    }
}

impl Metrics {
    /// Number of jobs by status.
    pub fn set_jobs(&self, counts: impl IntoIterator<Item = (&'static str, u64)>) {
        for (status, count) in counts {
            self.0.jobs.get_or_create(&StatusLabel { status: Word(status) }).set(gauge(count));
        }
    }

    /// Queued jobs by the backend asked for.
    pub fn set_queued(&self, queued: impl IntoIterator<Item = (&'static str, u64)>) {
        for (backend, count) in queued {
            self.0.queued.get_or_create(&BackendLabel { backend: Word(backend) }).set(gauge(count));
        }
    }

    /// Whether the latest write of this process to the artifact store succeeded.
    pub fn set_artifact_store_up(&self, up: bool) {
        self.0.artifact_store_up.set(i64::from(up));
    }

    /// Bytes of all files of models.
    pub fn set_stored_bytes(&self, bytes: u64) {
        self.0.stored.set(gauge(bytes));
    }

    /// Number of open event streams.
    pub fn set_streams(&self, open: usize) {
        self.0.streams.set(gauge(open as u64));
    }

    /// Records the wait of a job until its first claim.
    pub fn waited(&self, time: Duration) {
        self.0.wait.observe(time.as_secs_f64());
    }

    /// Records the duration of a stage of a job.
    pub fn stage(&self, stage: &'static str, seconds: f64) {
        self.0.stages.get_or_create(&StageLabel { stage: Word(stage) }).observe(seconds);
    }

    /// Counts a finished model: files stored, record committed.
    pub fn made(&self, backend: &'static str, device: String) {
        self.0.made.get_or_create(&MadeLabel { backend: Word(backend), device }).inc();
    }

    /// Counts a job with backend `auto` that runs on the CPU.
    pub fn fallback(&self, cause: Fallback) {
        self.0.fallbacks.get_or_create(&CauseLabel { cause: Word(cause.name()) }).inc();
    }

    /// Counts the end of an attempt.
    pub fn attempt(&self, end: &'static str) {
        self.0.attempts.get_or_create(&EndLabel { end: Word(end) }).inc();
        if end == "lost" {
            self.0.leases_lost.inc();
        }
    }

    /// Counts bytes written to the artifact store.
    pub fn bytes_in(&self, bytes: u64) {
        self.0.bytes.get_or_create(&DirectionLabel { direction: Word("in") }).inc_by(bytes);
    }

    /// Counts bytes read from the artifact store for clients.
    pub fn bytes_out(&self, bytes: u64) {
        self.0.bytes.get_or_create(&DirectionLabel { direction: Word("out") }).inc_by(bytes);
    }

    /// Counts a stored checkpoint.
    pub fn checkpoint(&self) {
        self.0.checkpoints.inc();
    }

    /// Counts models removed because of their age or of the limit on bytes.
    pub fn removed(&self, models: u64) {
        self.0.removed.inc_by(models);
    }

    /// Counts an answered request. `route` is the pattern of the path, not the path.
    pub fn request(&self, method: &str, route: &str, status: u16, time: Duration) {
        let label = RequestLabel { method: method.to_owned(), route: route.to_owned(), status };
        self.0.requests.get_or_create(&label).inc();
        self.0.request_seconds.observe(time.as_secs_f64());
    }

    /// All metrics as text.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = String::new();
        if encode(&mut text, &self.0.registry).is_err() {
            // Writing to a String cannot fail.
            let _ = write!(text, "# EOF");
        }
        text
    }
}

fn gauge(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_contains_the_counts() {
        let metrics = Metrics::default();
        metrics.set_jobs([("queued", 7), ("running", 2)]);
        metrics.set_queued([("auto", 4), ("gpu", 3)]);
        assert!(metrics.text().contains("oviduct_artifact_store_up 1\n"), "before the first write");
        metrics.set_artifact_store_up(false);
        metrics.waited(Duration::from_millis(300));
        metrics.stage("simulate", 1.5);
        metrics.attempt("succeeded");
        metrics.attempt("lost");
        metrics.made("gpu", "NVIDIA H200".to_owned());
        metrics.fallback(Fallback::Busy);
        metrics.bytes_in(10);
        metrics.bytes_out(5);
        metrics.request("GET", "/models/{id}", 200, Duration::from_millis(2));
        let text = metrics.text();
        for line in [
            "oviduct_jobs{status=\"queued\"} 7",
            "oviduct_queued_jobs{backend=\"gpu\"} 3",
            "oviduct_artifact_store_up 0",
            "oviduct_queue_wait_seconds_count 1",
            "oviduct_stage_seconds_sum{stage=\"simulate\"} 1.5",
            "oviduct_attempts_total{end=\"lost\"} 1",
            "oviduct_leases_lost_total 1",
            "oviduct_models_made_total{backend=\"gpu\",device=\"NVIDIA H200\"} 1",
            "oviduct_fallbacks_total{cause=\"busy\"} 1",
            "oviduct_artifact_bytes_total{direction=\"out\"} 5",
            "oviduct_http_requests_total{method=\"GET\",route=\"/models/{id}\",status=\"200\"} 1",
        ] {
            assert!(text.lines().any(|l| l == line), "{line} in\n{text}");
        }
        assert!(text.ends_with("# EOF\n"));
    }
}
