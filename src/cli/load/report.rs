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

/// Numbers of one kind of call.
#[derive(Debug, Serialize)]
pub(super) struct Calls {
    pub(super) due: u64,
    pub(super) answered: u64,
    /// Calls answered per second of the run.
    pub(super) per_second: f64,
    /// Responses 429. A closed loop retries the request.
    pub(super) refused: u64,
    /// Not sent: `max_in_flight` calls were in flight.
    pub(super) dropped: u64,
    /// Not sent: the call needed a model or a file that the run did not have.
    pub(super) skipped: u64,
    /// In flight when the run was interrupted.
    pub(super) unfinished: u64,
    pub(super) errors: Errors,
    pub(super) bytes: u64,
    /// From the planned start, of calls with a valid response and calls that timed out.
    pub(super) latency: Times,
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
    pub(super) calls: BTreeMap<Call, Calls>,
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
#[derive(Clone, Debug)]
pub(super) struct Run {
    pub(super) mode: Mode,
    pub(super) seed: u64,
    pub(super) interrupted: bool,
    pub(super) warm_up: f64,
    pub(super) seconds: f64,
    /// True if the run waited for the end of all models.
    pub(super) waited: bool,
}

impl Calls {
    fn of(tally: &Tally, seconds: f64) -> Self {
        let Tally { due, answered, refused, repeated, dropped, skipped, bytes, errors, latency } = tally;
        let ended = answered + (refused - repeated) + dropped + skipped + errors.total;
        Self {
            due: *due,
            answered: *answered,
            per_second: if seconds > 0.0 { *answered as f64 / seconds } else { 0.0 },
            refused: *refused,
            dropped: *dropped,
            skipped: *skipped,
            unfinished: due.saturating_sub(ended),
            errors: errors.clone(),
            bytes: *bytes,
            latency: Times::of(latency),
        }
    }
}

impl Report {
    pub(super) fn of(
        run: &Run,
        numbers: &Numbers,
        models: Result<Models, Lost>,
        efficiency: Option<Efficiency>,
    ) -> Self {
        let mut streams = numbers.streams.clone();
        streams.untold = streams.followed - streams.told - streams.errors.total;
        let timeline = numbers.seconds.iter().enumerate().filter(|(_, latency)| !latency.is_empty());
        let (models, models_unread) = match models {
            Ok(models) => (Some(models), None),
            Err(lost) => (None, Some(lost.message)),
        };
        Self {
            mode: run.mode.clone(),
            seed: run.seed,
            interrupted: run.interrupted,
            waited: run.waited,
            warm_up: run.warm_up,
            seconds: run.seconds,
            calls: numbers.calls.iter().map(|(call, tally)| (*call, Calls::of(tally, run.seconds))).collect(),
            errors: numbers.errors(),
            lag: Times::of(&numbers.lag),
            streams,
            models,
            models_unread,
            efficiency,
            timeline: timeline
                .map(|(second, latency)| Second { second, calls: latency.len(), latency: Times::of(latency) })
                .collect(),
        }
    }

    /// Returns true if anything failed: a call had an error or was dropped, no call was answered, a
    /// stream missed an end, or a model failed, is missing or did not end in time. Responses 429
    /// are not failures.
    pub(super) fn failed(&self) -> bool {
        let models = self
            .models
            .as_ref()
            .is_none_or(|models| models.failed + models.missing > 0 || self.waited && models.unended > 0);
        let calls = self.calls.values().all(|calls| calls.answered == 0);
        let dropped = self.calls.values().any(|calls| calls.dropped > 0);
        self.errors.total > 0 || self.waited && self.streams.untold > 0 || models || calls || dropped
    }
}
