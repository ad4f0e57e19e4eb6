//! State that the parts of a running load test share.

use super::known::Known;
use super::record::Record;
use super::seeds::Seeds;
use crate::cli::remote::client::Client;
use crate::clock::Stopwatch;
use serde_json::{Value, json};
use std::sync::OnceLock;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// Name of the label that marks the models of a run.
const LABEL: &str = "load";

/// A service under load and the state of the run.
#[derive(Debug)]
pub(super) struct Target {
    pub(super) client: Client,
    /// Request for a model without its seed.
    body: Value,
    /// Value of the label on the models of this run.
    label: String,
    /// Maximum time of one call.
    pub(super) timeout: Duration,
    /// Seeds of the models.
    pub(super) seeds: Seeds,
    pub(super) known: Known,
    pub(super) record: Record,
    /// Time since the start of the run.
    pub(super) watch: Stopwatch,
    /// Faults of the request for a model, if the service refuses the first one: it would refuse
    /// all.
    pub(super) invalid: OnceLock<Vec<String>>,
    /// Length of the run; set when the time is over.
    length: OnceLock<Duration>,
    /// Cancelled when the time is over; no further models are followed.
    pub(super) over: CancellationToken,
    /// Cancelled when the run is interrupted or the request is invalid; everything stops.
    pub(super) stop: CancellationToken,
}

impl Target {
    /// Starts a run whose first `warm_up` is not counted.
    pub(super) fn new(client: Client, mut body: Value, seeds: Seeds, warm_up: Duration, timeout: Duration) -> Self {
        let label = uuid::Uuid::now_v7().to_string();
        body["labels"] = json!({ LABEL: label });
        body["reuse"] = json!(false);
        let stop = CancellationToken::new();
        Self {
            client,
            body,
            label,
            timeout,
            seeds,
            known: Known::default(),
            record: Record::new(warm_up),
            watch: Stopwatch::start(),
            invalid: OnceLock::new(),
            length: OnceLock::new(),
            over: stop.child_token(),
            stop,
        }
    }

    /// Returns the request for the model of a seed.
    pub(super) fn body(&self, seed: u64) -> Value {
        let mut body = self.body.clone();
        body["seed"] = json!(seed);
        body
    }

    /// Returns the path of a page of the models of this run.
    pub(super) fn listing(&self, query: &str) -> String {
        format!("/models?label={LABEL}:{}&{query}", self.label)
    }

    /// Ends the time of the run after this length.
    pub(super) fn end(&self, length: Duration) {
        let _ = self.length.set(length);
        self.over.cancel();
    }

    /// Returns the length of the run with its warm-up; the elapsed time if the run is not over.
    pub(super) fn length(&self) -> Duration {
        self.length.get().copied().unwrap_or_else(|| self.watch.elapsed())
    }

    /// Ends the run because the service would refuse every model.
    pub(super) fn refuse(&self, faults: Vec<String>) {
        // Other calls may have reported the same faults.
        let _ = self.invalid.set(faults);
        self.stop.cancel();
    }
}
