//! Number of steps per submission: as many as take about 50 ms on the device. Then no watchdog of
//! the driver resets the device, and progress and cancellation take less than a second. Also the
//! maximum wait for a device that completes nothing.

use std::time::Duration;

/// Intended duration of a chunk, seconds.
const CHUNK_SECONDS: f64 = 0.05;
/// Maximum number of steps of a chunk.
const MOST_STEPS: i64 = 512;
/// Number of steps of the first chunks, which no measurement precedes.
pub(super) const FIRST_STEPS: i64 = 2;

/// Sets the number of steps of the next chunks from the duration of the last one.
#[derive(Debug)]
pub(super) struct SubmissionSizer {
    steps: i64,
    /// Time at which the end of the last chunk was observed.
    ended: f64,
    /// Seconds for which the host has been busy since then.
    busy: f64,
}

impl SubmissionSizer {
    /// A sizer that begins with chunks of `steps`.
    pub(super) fn new(steps: i64) -> Self {
        Self { steps, ended: 0.0, busy: 0.0 }
    }

    /// Number of steps of the next chunk, at least 1.
    pub(super) fn steps(&self) -> i64 {
        self.steps
    }

    /// Records that the host was busy for `seconds`.
    pub(super) fn busy(&mut self, seconds: f64) {
        self.busy = seconds;
    }

    /// Records that a chunk of `steps`, submitted at `submitted`, was observed to end at `now`.
    /// Chunks run one after another.
    pub(super) fn chunk(&mut self, steps: i64, submitted: f64, now: f64) {
        let seconds = (now - submitted.max(self.ended)).max(1e-6);
        self.ended = now;
        // If the host was busy for most of the time, it observed the end too late to measure the
        // device.
        if steps > 0 && self.busy < 0.5 * seconds.max(CHUNK_SECONDS) {
            let wanted = steps as f64 * CHUNK_SECONDS / seconds;
            // At most doubles, because the next steps may take longer.
            self.steps = (wanted as i64).clamp(1, (2 * self.steps).min(MOST_STEPS));
        }
    }
}

/// Limit of the time without a completed submission.
#[derive(Debug)]
pub(super) struct Patience {
    stall: Duration,
    waited: Duration,
}

impl Patience {
    pub(super) fn new(stall: Duration) -> Self {
        Self { stall, waited: Duration::ZERO }
    }

    /// Duration of the next wait: at most `most`, and at most the rest of the limit.
    pub(super) fn wait(&self, most: Duration) -> Duration {
        most.min(self.stall.saturating_sub(self.waited))
    }

    /// Records that a submission was completed.
    pub(super) fn progress(&mut self) {
        self.waited = Duration::ZERO;
    }

    /// Records that a wait of `waited` ended without a completion. Returns true if the limit is
    /// reached. Only the waits are summed, not the elapsed time, because the process may have been
    /// stopped in the meantime.
    pub(super) fn exhausted_by(&mut self, waited: Duration) -> bool {
        self.waited += waited;
        self.waited >= self.stall
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    /// Steps and seconds of each chunk on a device whose step `i` takes `cost(i)` seconds, with two
    /// chunks in flight.
    fn chunks(steps: i64, cost: impl Fn(i64) -> f64) -> Vec<(i64, f64)> {
        let (mut pace, mut now, mut next) = (SubmissionSizer::new(FIRST_STEPS), 0.0, 0);
        let mut in_flight: VecDeque<(i64, i64, f64)> = VecDeque::new();
        let mut taken = Vec::new();
        loop {
            while in_flight.len() < 2 && next < steps {
                let end = (next + pace.steps()).min(steps);
                in_flight.push_back((next, end, now));
                next = end;
            }
            let Some((begin, end, submitted)) = in_flight.pop_front() else { return taken };
            let seconds: f64 = (begin..end).map(&cost).sum();
            now += seconds;
            taken.push((end - begin, seconds));
            pace.chunk(end - begin, submitted, now);
        }
    }

    #[test]
    fn chunks_are_short_on_any_device() {
        for cost in [1e-6, 1e-5, 1e-4, 1e-3, 0.01, 0.04, 0.2, 3.0] {
            let found = chunks(5000, |_| cost);
            for &(steps, seconds) in &found[2..] {
                assert!(steps == 1 || seconds <= 1.1 * CHUNK_SECONDS, "{steps} steps of {cost} s");
            }
            // They are long enough for the cost of a submission not to matter.
            let most = found.iter().map(|&(steps, _)| steps).max().unwrap();
            assert!(most >= (0.4 * CHUNK_SECONDS / cost).min(MOST_STEPS as f64) as i64, "{most} steps of {cost} s");
        }
    }

    #[test]
    fn chunks_stay_short_while_steps_take_longer() {
        // Steps take a hundred times as long at the end as at the start, and every tenth step takes
        // five times as long.
        for cheapest in [1e-5, 1e-3] {
            let cost = |i: i64| cheapest * 100f64.powf(i as f64 / 2300.0) * if i % 10 == 0 { 5.0 } else { 1.0 };
            for (steps, seconds) in chunks(2300, cost) {
                assert!(seconds < 0.5, "{steps} steps took {seconds} s");
            }
        }
    }

    #[test]
    fn a_device_is_given_up_only_after_waits_without_any_completion() {
        let [wait, stall] = [100, 250].map(Duration::from_millis);
        let mut patience = Patience::new(stall);
        assert!(!patience.exhausted_by(patience.wait(wait)) && !patience.exhausted_by(patience.wait(wait)));
        patience.progress();
        assert!(!patience.exhausted_by(patience.wait(wait)) && !patience.exhausted_by(patience.wait(wait)));
        assert_eq!(patience.wait(wait), Duration::from_millis(50));
        assert!(patience.exhausted_by(patience.wait(wait)));
    }

    #[test]
    fn a_chunk_is_not_measured_while_the_host_is_busy() {
        let mut pace = SubmissionSizer::new(FIRST_STEPS);
        pace.busy(2.0);
        pace.chunk(2, 0.0, 2.1);
        assert_eq!(pace.steps(), FIRST_STEPS);
        pace.busy(0.0);
        pace.chunk(2, 2.1, 2.2);
        assert_eq!(pace.steps(), 1);
    }
}
