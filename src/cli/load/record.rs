//! Measurements of a load test: latencies and errors by kind of call.
//!
//! A latency counts from the planned start of its call. Calls that were due during the warm-up are
//! not recorded. Latencies include calls with a valid response and calls that timed out. Without
//! the latter, the slowest calls would be missing.

use super::errors::{Errors, Lost};
use super::mix::Call;
use super::times::{Times, add, histogram};
use crate::cli::remote::client::ErrorKind;
use crate::lock::Mutex;
use hdrhistogram::Histogram;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;
use std::time::Duration;

/// Result of a call.
#[derive(Debug)]
pub(super) enum Outcome {
    /// Valid response; bytes of the body.
    Answered(u64),
    /// Not sent: the call needed a model or a file that the run did not have.
    Skipped,
    /// Anything else; responses 429 are counted separately.
    Lost(Lost),
}

/// A call that ended. Times are from the start of the run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Timed {
    pub(super) call: Call,
    /// Planned start.
    pub(super) planned: Duration,
    /// Time of sending.
    pub(super) sent: Duration,
    pub(super) ended: Duration,
}

/// Numbers and latencies of one kind of call.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Tally {
    /// Calls that were due.
    pub(super) due: u64,
    pub(super) answered: u64,
    /// Calls answered per second of the run.
    pub(super) per_second: f64,
    /// Responses 429. A closed loop retries the request.
    pub(super) refused: u64,
    /// Responses 429 after which the request was retried.
    #[serde(skip)]
    pub(super) repeated: u64,
    /// Not sent: the maximum number of calls was in flight.
    pub(super) dropped: u64,
    /// Not sent: the call needed a model or a file that the run did not have.
    pub(super) skipped: u64,
    /// In flight when the run was interrupted.
    pub(super) unfinished: u64,
    pub(super) errors: Errors,
    pub(super) bytes: u64,
    /// From the planned start, in microseconds, of calls with a valid response and calls that timed
    /// out.
    #[serde(serialize_with = "times")]
    pub(super) latency: Histogram<u64>,
}

fn times<S: Serializer>(latency: &Histogram<u64>, to: S) -> Result<S::Ok, S::Error> {
    Times::of(latency).serialize(to)
}

/// Event streams that were held open.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Streams {
    /// Number of streams at a time.
    pub(super) held: u32,
    /// Models that were followed.
    pub(super) followed: u64,
    /// Models whose end was received.
    pub(super) told: u64,
    /// Connections that were lost or refused before the end was received, and reopened.
    pub(super) cut: u64,
    /// Models whose end no stream received before the run was over.
    pub(super) untold: u64,
    /// Streams that gave up.
    pub(super) errors: Errors,
}

/// All measurements.
#[derive(Clone, Debug)]
pub(super) struct Numbers {
    pub(super) calls: BTreeMap<Call, Tally>,
    /// Delay of the load generator itself: time from planned to sent, in microseconds.
    pub(super) lag: Histogram<u64>,
    /// Latencies of all calls in microseconds, by the second after the warm-up in which they were
    /// due.
    pub(super) seconds: Vec<Histogram<u64>>,
    pub(super) streams: Streams,
}

/// Collects the measurements.
#[derive(Debug)]
pub(super) struct Record {
    warm_up: Duration,
    numbers: Mutex<Numbers>,
}

impl Default for Tally {
    fn default() -> Self {
        Self {
            due: 0,
            answered: 0,
            per_second: 0.0,
            refused: 0,
            repeated: 0,
            dropped: 0,
            skipped: 0,
            unfinished: 0,
            errors: Errors::default(),
            bytes: 0,
            latency: histogram(3),
        }
    }
}

impl Record {
    /// Creates an empty record that does not count the first `warm_up` of the run.
    pub(super) fn new(warm_up: Duration) -> Self {
        let streams = Streams::default();
        let numbers = Numbers { calls: BTreeMap::new(), lag: histogram(3), seconds: Vec::new(), streams };
        Self { warm_up, numbers: Mutex::new(numbers) }
    }

    /// Returns true if a call that was due at this time counts.
    pub(super) fn counts(&self, planned: Duration) -> bool {
        planned >= self.warm_up
    }

    /// Changes the numbers of a call if calls that were due at this time count.
    fn tally(&self, call: Call, planned: Duration, change: impl FnOnce(&mut Tally)) {
        if self.counts(planned) {
            change(self.numbers.lock().calls.entry(call).or_default());
        }
    }

    /// Counts a call that is due.
    pub(super) fn due(&self, call: Call, planned: Duration) {
        self.tally(call, planned, |tally| tally.due += 1);
    }

    /// Counts a call that is not sent, because too many calls are in flight.
    pub(super) fn dropped(&self, call: Call, planned: Duration) {
        self.tally(call, planned, |tally| tally.dropped += 1);
    }

    /// Counts responses 429 after which the request was retried.
    pub(super) fn repeated(&self, call: Call, planned: Duration, times: u64) {
        self.tally(call, planned, |tally| {
            tally.refused += times;
            tally.repeated += times;
        });
    }

    /// Records the result of a call.
    pub(super) fn ended(&self, timed: Timed, outcome: Outcome) {
        if !self.counts(timed.planned) {
            return;
        }
        let mut numbers = self.numbers.lock();
        let Numbers { calls, lag, seconds, .. } = &mut *numbers;
        let tally = calls.entry(timed.call).or_default();
        match outcome {
            Outcome::Skipped => {
                tally.skipped += 1;
                return;
            }
            Outcome::Answered(bytes) => {
                tally.answered += 1;
                tally.bytes += bytes;
            }
            Outcome::Lost(lost) if lost.kind == ErrorKind::Status(429) => {
                tally.refused += 1;
                return;
            }
            Outcome::Lost(lost) => {
                let timeout = lost.kind == ErrorKind::Timeout;
                tally.errors.add(lost);
                if !timeout {
                    return;
                }
            }
        }
        let latency = timed.ended.saturating_sub(timed.planned);
        add(&mut tally.latency, latency);
        add(lag, timed.sent.saturating_sub(timed.planned));
        let second = (timed.planned - self.warm_up).as_secs() as usize;
        if seconds.len() <= second {
            seconds.resize_with(second + 1, || histogram(2));
        }
        add(&mut seconds[second], latency);
    }

    /// Changes the numbers of the streams.
    pub(super) fn streams(&self, change: impl FnOnce(&mut Streams)) {
        change(&mut self.numbers.lock().streams);
    }

    /// Returns a copy of the measurements.
    pub(super) fn numbers(&self) -> Numbers {
        self.numbers.lock().clone()
    }
}

impl Numbers {
    /// Computes the numbers that depend on the length of the run.
    pub(super) fn complete(&mut self, seconds: f64) {
        for tally in self.calls.values_mut() {
            tally.per_second = if seconds > 0.0 { tally.answered as f64 / seconds } else { 0.0 };
            let refused = tally.refused - tally.repeated;
            let ended = tally.answered + refused + tally.dropped + tally.skipped + tally.errors.total;
            tally.unfinished = tally.due.saturating_sub(ended);
        }
        let streams = &mut self.streams;
        streams.untold = streams.followed - streams.told - streams.errors.total;
    }

    /// Returns the errors of all calls and streams.
    pub(super) fn errors(&self) -> Errors {
        let mut all = Errors::default();
        for errors in self.calls.values().map(|tally| &tally.errors).chain([&self.streams.errors]) {
            all.merge(errors);
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn get(planned: u64, sent: u64, ended: u64) -> Timed {
        Timed { call: Call::Get, planned: ms(planned), sent: ms(sent), ended: ms(ended) }
    }

    fn lost(kind: ErrorKind) -> Outcome {
        Outcome::Lost(Lost { kind, message: "m".to_owned() })
    }

    #[test]
    fn latencies_count_from_the_planned_start() {
        let record = Record::new(ms(1000));
        record.due(Call::Get, ms(1000));
        record.ended(get(1000, 1400, 1500), Outcome::Answered(7));
        let numbers = record.numbers();
        let tally = &numbers.calls[&Call::Get];
        assert_eq!((tally.due, tally.answered, tally.bytes), (1, 1, 7));
        assert!(tally.latency.max().abs_diff(500_000) < 1000, "{}", tally.latency.max());
        assert!(numbers.lag.max().abs_diff(400_000) < 1000, "{}", numbers.lag.max());
    }

    #[test]
    fn the_warm_up_is_not_counted() {
        let record = Record::new(ms(1000));
        record.due(Call::Get, ms(999));
        record.dropped(Call::Get, ms(5));
        record.ended(get(999, 999, 60_000), Outcome::Answered(7));
        assert!(record.numbers().calls.is_empty() && record.numbers().seconds.is_empty());
    }

    #[test]
    fn every_end_is_counted_once() {
        let record = Record::new(Duration::ZERO);
        let outcomes = [
            Outcome::Answered(1),
            Outcome::Skipped,
            lost(ErrorKind::Status(429)),
            lost(ErrorKind::Status(500)),
            lost(ErrorKind::Timeout),
            lost(ErrorKind::Connection),
        ];
        for outcome in outcomes {
            record.due(Call::Get, ms(0));
            record.ended(get(0, 0, 10), outcome);
        }
        record.due(Call::Get, ms(1));
        record.dropped(Call::Get, ms(1));
        let numbers = record.numbers();
        let tally = &numbers.calls[&Call::Get];
        assert_eq!((tally.due, tally.answered, tally.skipped, tally.refused, tally.dropped), (7, 1, 1, 1, 1));
        assert_eq!((tally.errors.total, numbers.errors().total), (3, 3));
        // The response and the timeout.
        assert_eq!(tally.latency.len(), 2);
    }

    #[test]
    fn latencies_are_kept_by_the_second_in_which_calls_were_due() {
        let record = Record::new(ms(1000));
        record.ended(get(3500, 3500, 3600), Outcome::Answered(0));
        record.ended(get(1000, 1000, 5000), Outcome::Answered(0));
        let counts: Vec<u64> = record.numbers().seconds.iter().map(Histogram::len).collect();
        assert_eq!(counts, [1, 0, 1]);
    }
}
