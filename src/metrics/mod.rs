//! The metrics of this process in the OpenMetrics text format, which Prometheus reads.
//!
//! Counters and histograms cover this process only: sum them over the processes. Gauges that are
//! read from the stores (`oviduct_jobs`, `oviduct_workers`, `oviduct_stored_bytes` …) are the same
//! in every process: take their maximum, not their sum. Label values come from the code, never from
//! requests, so their number is bounded.

mod process;

use process::Process;
use prometheus_client::encoding::text::{encode_eof, encode_registry};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::Registry;
use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;

/// Media type of the text.
pub const MEDIA_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

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

/// Labels of a metric: names and values.
type Labels<const N: usize> = [(&'static str, Cow<'static, str>); N];
type Gauges = Family<Labels<1>, Gauge>;
type Counters = Family<Labels<1>, Counter>;
type Histograms<const N: usize> = Family<Labels<N>, Histogram, fn() -> Histogram>;

/// The metrics of a process. Clones share them.
#[derive(Clone, Debug)]
pub struct Metrics(Arc<Inner>);

/// Declares the metrics with the prefix `oviduct_`: field, type, initial value, name and help, in
/// the order of the text.
macro_rules! metrics {
    ($($field:ident: $kind:ty = $new:expr, $name:literal, $help:literal;)+) => {
        #[derive(Debug)]
        struct Inner {
            registry: Registry,
            /// Metrics with names that all programs share.
            common: Registry,
            process: Option<Process>,
            $($field: $kind,)+
        }

        impl Default for Inner {
            fn default() -> Self {
                let (mut registry, mut common) = (Registry::with_prefix("oviduct"), Registry::default());
                registry.register("build", "Versions of the program and of its engine", Info::new(build()));
                $(
                    let $field: $kind = $new;
                    registry.register($name, $help, $field.clone());
                )+
                let process = Process::register(&mut common);
                Self { registry, common, process, $($field,)+ }
            }
        }
    };
}

metrics! {
    jobs: Gauges = Gauges::default(),
        "jobs", "Jobs by status, from the store; queued is the depth of the queue";
    queued: Gauges = Gauges::default(),
        "queued_jobs", "Queued jobs by the backend asked for, from the store";
    oldest: Family<Labels<1>, Gauge<f64, AtomicU64>> = Family::default(), "oldest_queued_seconds",
        "Time since the oldest queued job was accepted, by the backend asked for, from the store; 0 if none is queued";
    workers: Family<Labels<2>, Gauge> = Family::default(), "workers",
        "Workers alive by backend and state (active, paused, draining, drained), from the store";
    paused: Gauge = Gauge::default(),
        "claiming_paused", "1 while all workers are paused, from the store";
    slots: Gauges = Gauges::default(),
        "worker_slots", "Workers of this process by backend";
    busy_slots: Gauges = Gauges::default(),
        "worker_slots_busy", "Workers of this process that run a job or a batch, by backend";
    job_store_up: Gauge = Gauge::default(),
        "job_store_up", "1 if the gauges from the store could be read; else they keep their last values";
    connections: Family<Labels<2>, Gauge> = Family::default(), "database_connections",
        "Connections of this process to the database, by pool and state (busy, idle)";
    most_connections: Gauges = Gauges::default(), "database_connections_max",
        "Limit of oviduct_database_connections by pool, busy and idle together";
    artifact_store_up: Gauge = Gauge::default(),
        "artifact_store_up", "1 unless this process's latest write to the artifact store failed";
    stored: Gauge = Gauge::default(),
        "stored_bytes", "Bytes of all files of models, from the store";
    streams: Gauge = Gauge::default(),
        "event_streams", "Event streams open in this process";
    most_streams: Gauge = Gauge::default(),
        "event_streams_max", "Limit of oviduct_event_streams";
    held: Gauge = Gauge::default(),
        "held_answers", "Answers held by Prefer: wait in this process";
    most_held: Gauge = Gauge::default(),
        "held_answers_max", "Limit of oviduct_held_answers";
    downloads: Gauge = Gauge::default(),
        "downloads", "Downloads through this process that run";
    most_downloads: Gauge = Gauge::default(),
        "downloads_max", "Limit of oviduct_downloads";
    wait: Histogram = long(), "queue_wait_seconds",
        "Time from a job's acceptance to its first claim, of jobs first claimed by this process";
    stages: Histograms<1> = Histograms::new_with_constructor(stage),
        "stage_seconds", "Run time of a job by stage";
    made: Family<Labels<2>, Counter> = Family::default(),
        "models_made", "Models made by this process, by backend and device";
    fallbacks: Counters = Counters::default(), "fallbacks",
        "Attempts of this process at jobs with backend auto that ran on a CPU: no-gpu (no GPU worker was alive), busy \
         (the GPU workers had too many jobs), device (the device could not compute the model)";
    attempts: Counters = Counters::default(),
        "attempts", "Attempts of this process, by end";
    leases_lost: Counter = Counter::default(),
        "leases_lost", "Attempts of this process whose lease was lost";
    bytes: Counters = Counters::default(),
        "artifact_bytes", "Bytes to (in) and from (out) the artifact store";
    checkpoints: Counter = Counter::default(),
        "checkpoints", "Checkpoints stored";
    removed: Counter = Counter::default(),
        "models_removed", "Models removed because of their age or of the limit on bytes";
    clock_jumps: Counter = Counter::default(), "clock_jumps",
        "Advances of the job store's clock that are longer than the time that passed; each skipped a round of retention";
    task_panics: Counters = Counters::default(), "task_panics",
        "Panics of tasks of this process, each of which was restarted: claims, heartbeats, events";
    damaged: Counter = Counter::default(), "damaged_files",
        "Reads of whole stored files that differ from their records; such a file is not served";
    pictures: Counters = Counters::default(), "pictures",
        "Requests for pictures of models: drawn, kept (in memory from an earlier request), refused (too many waited)";
    picture_seconds: Histogram = short(),
        "picture_seconds", "Time to draw a picture of a model";
    requests: Family<Labels<3>, Counter> = Family::default(),
        "http_requests", "Requests answered";
    request_seconds: Histogram = short(), "http_request_seconds",
        "Time to the head of the response, including long polls and streams";
    request_durations: Histograms<3> = Histograms::new_with_constructor(request), "http_request_duration_seconds",
        "Time to the head of the response by method, route and class of status, without answers held by Prefer: wait";
}

/// Versions of the program and of its engine.
fn build() -> Labels<3> {
    let arch = std::env::consts::ARCH.into();
    [("version", env!("CARGO_PKG_VERSION").into()), ("engine", crate::ENGINE_VERSION.into()), ("arch", arch)]
}

/// From a tenth of a second to about three hours.
fn long() -> Histogram {
    Histogram::new(exponential_buckets(0.1, 2.0, 17))
}

/// From a millisecond to about a minute.
fn short() -> Histogram {
    Histogram::new(exponential_buckets(0.001, 2.0, 16))
}

/// From a millisecond to a minute, at round numbers, which objectives are stated in.
fn request() -> Histogram {
    Histogram::new([0.001, 0.0025, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0])
}

/// From ten milliseconds to about twenty minutes.
fn stage() -> Histogram {
    Histogram::new(exponential_buckets(0.01, 2.0, 17))
}

impl Default for Metrics {
    fn default() -> Self {
        let inner = Inner::default();
        inner.artifact_store_up.set(1);
        Self(Arc::new(inner))
    }
}

impl Metrics {
    /// Number of jobs by status.
    pub fn set_jobs(&self, counts: impl IntoIterator<Item = (&'static str, u64)>) {
        for (status, count) in counts {
            self.0.jobs.get_or_create(&[("status", status.into())]).set(gauge(count));
        }
    }

    /// Queued jobs by the backend asked for.
    pub fn set_queued(&self, queued: impl IntoIterator<Item = (&'static str, u64)>) {
        for (backend, count) in queued {
            self.0.queued.get_or_create(&[("backend", backend.into())]).set(gauge(count));
        }
    }

    /// Time since the oldest queued job was accepted, by the backend asked for.
    pub fn set_oldest(&self, ages: impl IntoIterator<Item = (&'static str, Duration)>) {
        for (backend, age) in ages {
            self.0.oldest.get_or_create(&[("backend", backend.into())]).set(age.as_secs_f64());
        }
    }

    /// Workers alive by backend and state.
    pub fn set_workers(&self, workers: impl IntoIterator<Item = (&'static str, &'static str, u64)>) {
        for (backend, state, count) in workers {
            let label = [("backend", backend.into()), ("state", state.into())];
            self.0.workers.get_or_create(&label).set(gauge(count));
        }
    }

    /// Whether all workers are paused.
    pub fn set_paused(&self, paused: bool) {
        self.0.paused.set(i64::from(paused));
    }

    /// Counts a worker of this process.
    pub fn add_slot(&self, backend: &'static str) {
        let label = [("backend", backend.into())];
        self.0.slots.get_or_create(&label).inc();
        // So that a worker without a job is seen too.
        drop(self.0.busy_slots.get_or_create(&label));
    }

    /// A worker of this process begins to run something, or has nothing left to run.
    pub fn slot_busy(&self, backend: &'static str, busy: bool) {
        self.0.busy_slots.get_or_create(&[("backend", backend.into())]).inc_by(if busy { 1 } else { -1 });
    }

    /// Whether the job store could be read.
    pub fn set_job_store_up(&self, up: bool) {
        self.0.job_store_up.set(i64::from(up));
    }

    /// Connections to the database of a pool.
    pub fn set_connections(&self, pool: &'static str, busy: u32, idle: u32, most: u32) {
        for (state, count) in [("busy", busy), ("idle", idle)] {
            let label = [("pool", pool.into()), ("state", state.into())];
            self.0.connections.get_or_create(&label).set(count.into());
        }
        self.0.most_connections.get_or_create(&[("pool", pool.into())]).set(most.into());
    }

    /// Whether the latest write of this process to the artifact store succeeded.
    pub fn set_artifact_store_up(&self, up: bool) {
        self.0.artifact_store_up.set(i64::from(up));
    }

    /// Bytes of all files of models.
    pub fn set_stored_bytes(&self, bytes: u64) {
        self.0.stored.set(gauge(bytes));
    }

    /// Number of open event streams, and its limit.
    pub fn set_streams(&self, open: usize, most: usize) {
        self.0.streams.set(gauge(open as u64));
        self.0.most_streams.set(gauge(most as u64));
    }

    /// Number of held answers, and its limit.
    pub fn set_held(&self, open: usize, most: usize) {
        self.0.held.set(gauge(open as u64));
        self.0.most_held.set(gauge(most as u64));
    }

    /// Number of running downloads, and its limit.
    pub fn set_downloads(&self, open: usize, most: usize) {
        self.0.downloads.set(gauge(open as u64));
        self.0.most_downloads.set(gauge(most as u64));
    }

    /// Records the wait of a job until its first claim.
    pub fn waited(&self, time: Duration) {
        self.0.wait.observe(time.as_secs_f64());
    }

    /// Records the duration of a stage of a job.
    pub fn stage(&self, stage: &'static str, seconds: f64) {
        self.0.stages.get_or_create(&[("stage", stage.into())]).observe(seconds);
    }

    /// Counts a finished model: files stored, record committed.
    pub fn made(&self, backend: &'static str, device: String) {
        self.0.made.get_or_create(&[("backend", backend.into()), ("device", device.into())]).inc();
    }

    /// Counts a job with backend `auto` that runs on the CPU.
    pub fn fallback(&self, cause: Fallback) {
        self.0.fallbacks.get_or_create(&[("cause", cause.name().into())]).inc();
    }

    /// Counts the end of an attempt.
    pub fn attempt(&self, end: &'static str) {
        self.0.attempts.get_or_create(&[("end", end.into())]).inc();
        if end == "lost" {
            self.0.leases_lost.inc();
        }
    }

    /// Counts bytes written to the artifact store.
    pub fn bytes_in(&self, bytes: u64) {
        self.0.bytes.get_or_create(&[("direction", "in".into())]).inc_by(bytes);
    }

    /// Counts bytes read from the artifact store for clients.
    pub fn bytes_out(&self, bytes: u64) {
        self.0.bytes.get_or_create(&[("direction", "out".into())]).inc_by(bytes);
    }

    /// Counts a stored checkpoint.
    pub fn checkpoint(&self) {
        self.0.checkpoints.inc();
    }

    /// Counts models removed because of their age or of the limit on bytes.
    pub fn removed(&self, models: u64) {
        self.0.removed.inc_by(models);
    }

    /// Counts a jump of the clock of the job store.
    pub fn clock_jumped(&self) {
        self.0.clock_jumps.inc();
    }

    /// Counts panics of a restarted task: `claims`, `heartbeats` or `events`.
    pub fn task_panicked(&self, task: &'static str, panics: u64) {
        self.0.task_panics.get_or_create(&[("task", task.into())]).inc_by(panics);
    }

    /// Counts a read of a stored file that differs from its record.
    pub fn damaged_file(&self) {
        self.0.damaged.inc();
    }

    /// Counts a request for a picture of a model by its `result`: `drawn`, `kept` (in memory from
    /// an earlier request) or `refused`.
    pub fn picture(&self, result: &'static str) {
        self.0.pictures.get_or_create(&[("result", result.into())]).inc();
    }

    /// Counts a picture that was drawn in this time.
    pub fn picture_drawn(&self, time: Duration) {
        self.picture("drawn");
        self.0.picture_seconds.observe(time.as_secs_f64());
    }

    /// Counts a response. `route` is the pattern of the path, not the path. `held` is true if the
    /// response was delayed by `Prefer: wait`.
    pub fn request(&self, method: &str, route: &str, status: u16, time: Duration, held: bool) {
        let method = ("method", Cow::from(method.to_owned()));
        let route = ("route", Cow::from(route.to_owned()));
        if !held {
            let class = format!("{}xx", status / 100);
            let label = [method.clone(), route.clone(), ("status", class.into())];
            self.0.request_durations.get_or_create(&label).observe(time.as_secs_f64());
        }
        self.0.requests.get_or_create(&[method, route, ("status", status.to_string().into())]).inc();
        self.0.request_seconds.observe(time.as_secs_f64());
    }

    /// All metrics as text.
    #[must_use]
    pub fn text(&self) -> String {
        let Inner { registry, common, process, .. } = &*self.0;
        if let Some(process) = process {
            process.read();
        }
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = encode_registry(&mut text, registry)
            .and_then(|()| encode_registry(&mut text, common))
            .and_then(|()| encode_eof(&mut text));
        text
    }
}

fn gauge(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests;
