//! What a load has measured so far: latencies and errors by call.
//!
//! A latency is counted from the planned start of its call. Calls that were due during the warm-up are not recorded.
//! Latencies are those of calls that were answered as they should be, and of those that timed out: without these, the
//! slowest would be missing.

use super::errors::{Errors, Lost};
use super::mix::Call;
use super::times::{add, histogram};
use crate::cli::remote::client::ErrorKind;
use hdrhistogram::Histogram;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How a call ended.
#[derive(Debug)]
pub(super) enum Outcome {
    /// It was answered; bytes of the body.
    Answered(u64),
    /// It needed a model, or a file, that the run did not have yet.
    Skipped,
    /// Anything else; answers 429 are counted apart.
    Lost(Lost),
}

/// A call that ended. Times are from the start of the run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Timed {
    pub(super) call: Call,
    /// When it was due.
    pub(super) planned: Duration,
    /// When it was sent.
    pub(super) sent: Duration,
    pub(super) ended: Duration,
}

/// Numbers and latencies of one kind of call.
#[derive(Clone, Debug)]
pub(super) struct Tally {
    /// Calls that were due; those without any end were in flight when the run was interrupted.
    pub(super) due: u64,
    pub(super) answered: u64,
    /// Answers 429.
    pub(super) refused: u64,
    /// Answers 429 after which the request was sent again.
    pub(super) repeated: u64,
    /// Not sent, because as many calls as allowed were in flight.
    pub(super) dropped: u64,
    /// Not sent, because they needed a model that the run did not have yet.
    pub(super) skipped: u64,
    pub(super) bytes: u64,
    pub(super) errors: Errors,
    /// In microseconds.
    pub(super) latency: Histogram<u64>,
}

/// Event streams that were held open.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub(super) struct Streams {
    /// As many were asked for at a time.
    pub(super) held: u32,
    /// Models that were followed.
    pub(super) followed: u64,
    /// Models whose end was told.
    pub(super) told: u64,
    /// Connections that were lost or refused before the end was told, and opened again.
    pub(super) cut: u64,
    /// Models of which no end was told before the run was over.
    pub(super) untold: u64,
    /// Streams that were given up.
    pub(super) errors: Errors,
}

/// All numbers so far.
#[derive(Clone, Debug)]
pub(super) struct Numbers {
    pub(super) calls: BTreeMap<Call, Tally>,
    /// Time from planned to sent, in microseconds: how late the load generator itself was.
    pub(super) lag: Histogram<u64>,
    /// Latencies of all calls by the second in which they were due, after the warm-up; in microseconds.
    pub(super) seconds: Vec<Histogram<u64>>,
    pub(super) streams: Streams,
}

/// Collects what is measured.
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
            refused: 0,
            repeated: 0,
            dropped: 0,
            skipped: 0,
            bytes: 0,
            errors: Errors::default(),
            latency: histogram(3),
        }
    }
}

impl Record {
    /// An empty record of a run whose first `warm_up` is not counted.
    pub(super) fn new(warm_up: Duration) -> Self {
        let streams = Streams::default();
        let numbers = Numbers { calls: BTreeMap::new(), lag: histogram(3), seconds: Vec::new(), streams };
        Self { warm_up, numbers: Mutex::new(numbers) }
    }

    fn lock(&self) -> MutexGuard<'_, Numbers> {
        self.numbers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a call that was due at this time counts.
    pub(super) fn counts(&self, planned: Duration) -> bool {
        planned >= self.warm_up
    }

    /// Changes the numbers of a call, if one that was due at this time counts.
    fn tally(&self, call: Call, planned: Duration, change: impl FnOnce(&mut Tally)) {
        if self.counts(planned) {
            change(self.lock().calls.entry(call).or_default());
        }
    }

    /// A call is due.
    pub(super) fn due(&self, call: Call, planned: Duration) {
        self.tally(call, planned, |tally| tally.due += 1);
    }

    /// It is not sent, because too many are in flight.
    pub(super) fn dropped(&self, call: Call, planned: Duration) {
        self.tally(call, planned, |tally| tally.dropped += 1);
    }

    /// It was answered 429 so many times and sent again.
    pub(super) fn repeated(&self, call: Call, planned: Duration, times: u64) {
        self.tally(call, planned, |tally| {
            tally.refused += times;
            tally.repeated += times;
        });
    }

    /// It ended.
    pub(super) fn ended(&self, timed: Timed, outcome: Outcome) {
        if !self.counts(timed.planned) {
            return;
        }
        let mut numbers = self.lock();
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

    /// Changes what is known of the streams.
    pub(super) fn streams(&self, change: impl FnOnce(&mut Streams)) {
        change(&mut self.lock().streams);
    }

    /// A copy of the numbers so far.
    pub(super) fn numbers(&self) -> Numbers {
        self.lock().clone()
    }
}

impl Numbers {
    /// Errors of all calls and streams.
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
        // The answer and the timeout.
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
