//! The report of a load test as JSON. Times are in seconds.

use super::errors::{Errors, Lost};
use super::mix::Call;
use super::models::Models;
use super::plan::Arrivals;
use super::record::{Numbers, Streams, Tally};
use super::times::Times;
use serde::Serialize;
use std::collections::BTreeMap;

/// Mode of the load test.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "mode", rename_all = "snake_case")]
pub(super) enum Mode {
    /// Open loop with a rate in calls per second.
    Open { rate: f64, arrivals: Arrivals, max_in_flight: u32 },
    /// Closed loop.
    Closed { concurrency: u32 },
    /// Without a service.
    Direct { concurrency: u32 },
}

/// Latencies of the calls that were due in one second.
#[derive(Debug, Serialize)]
pub(super) struct Second {
    second: usize,
    pub(super) calls: u64,
    latency: Times,
}

/// Models per second of the service, compared with the generator alone on all cores of this
/// machine.
#[derive(Debug, Serialize)]
pub(super) struct Efficiency {
    /// Number of models that the generator grew for the comparison.
    pub(super) sample: u64,
    pub(super) direct_per_second: f64,
    /// Models per second of the service divided by `direct_per_second`.
    pub(super) ratio: f64,
}

/// The result of a load test.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    #[serde(flatten)]
    pub(super) run: Run,
    pub(super) calls: BTreeMap<Call, Tally>,
    /// Errors of all calls and streams.
    pub(super) errors: Errors,
    /// Delay of the load generator itself: time from planned to sent.
    pub(super) lag: Times,
    pub(super) streams: Streams,
    /// `null` if the models could not be read.
    pub(super) models: Option<Models>,
    /// Reason why the models could not be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) models_unread: Option<String>,
    pub(super) efficiency: Option<Efficiency>,
    pub(super) timeline: Vec<Second>,
}

/// Circumstances of a run.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Run {
    #[serde(flatten)]
    pub(super) mode: Mode,
    /// Seed of the plan and of the first model.
    pub(super) seed: u64,
    /// True if a signal ended the run early.
    pub(super) interrupted: bool,
    /// True if the run waited for the end of all models.
    pub(super) waited: bool,
    pub(super) warm_up: f64,
    /// Length of the run without the warm-up.
    pub(super) seconds: f64,
}

impl Report {
    pub(super) fn of(
        run: Run,
        mut numbers: Numbers,
        models: Result<Models, Lost>,
        efficiency: Option<Efficiency>,
    ) -> Self {
        numbers.complete(run.seconds);
        let timeline = numbers.seconds.iter().enumerate().filter(|(_, latency)| !latency.is_empty());
        let (models, models_unread) = match models {
            Ok(models) => (Some(models), None),
            Err(lost) => (None, Some(lost.message)),
        };
        Self {
            run,
            errors: numbers.errors(),
            lag: Times::of(&numbers.lag),
            models,
            models_unread,
            efficiency,
            timeline: timeline
                .map(|(second, latency)| Second { second, calls: latency.len(), latency: Times::of(latency) })
                .collect(),
            calls: numbers.calls,
            streams: numbers.streams,
        }
    }

    /// Returns true if anything failed: a call had an error or was dropped, no call was answered, a
    /// stream missed an end, or a model failed, is missing or did not end in time. Responses 429
    /// are not failures.
    pub(super) fn failed(&self) -> bool {
        let models = self
            .models
            .as_ref()
            .is_none_or(|models| models.failed + models.missing > 0 || self.run.waited && models.unended > 0);
        let calls = self.calls.values().all(|calls| calls.answered == 0);
        let dropped = self.calls.values().any(|calls| calls.dropped > 0);
        self.errors.total > 0 || self.run.waited && self.streams.untold > 0 || models || calls || dropped
    }
}
