//! How many steps a chunk of work has: as many as take about 50 ms on the device at hand, so that no watchdog bites, and
//! progress and cancellation keep within a second.

/// What a chunk is to take, seconds.
const CHUNK_SECONDS: f64 = 0.05;
/// Most steps of a chunk.
const MOST_STEPS: i64 = 512;
/// Steps of the first chunks, of which nothing is known yet.
const FIRST_STEPS: i64 = 2;

/// Sets the length of the next chunks by how long the last one took.
#[derive(Debug)]
pub(super) struct Pace {
    steps: i64,
    /// When the last chunk was seen to end.
    ended: f64,
    /// Seconds that the host was busy with other things since.
    busy: f64,
}

impl Pace {
    pub(super) fn new() -> Self {
        Self { steps: FIRST_STEPS, ended: 0.0, busy: 0.0 }
    }

    /// Steps of the next chunk, at least 1.
    pub(super) fn steps(&self) -> i64 {
        self.steps
    }

    /// The host was busy for so many seconds.
    pub(super) fn busy(&mut self, seconds: f64) {
        self.busy = seconds;
    }

    /// A chunk of `steps` that was submitted at `submitted` was seen to end `now`; chunks run one after another.
    pub(super) fn chunk(&mut self, steps: i64, submitted: f64, now: f64) {
        let seconds = (now - submitted.max(self.ended)).max(1e-6);
        self.ended = now;
        // Where the host was busy most of the time, nothing is known of the device.
        if steps > 0 && self.busy < 0.5 * seconds.max(CHUNK_SECONDS) {
            let wanted = steps as f64 * CHUNK_SECONDS / seconds;
            // Grows gently: the next steps may be dearer.
            self.steps = (wanted as i64).clamp(1, (2 * self.steps).min(MOST_STEPS));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    /// Seconds of each chunk of a run on a device of which step `i` takes `cost(i)`, with two chunks on their way.
    fn chunks(steps: i64, cost: impl Fn(i64) -> f64) -> Vec<(i64, f64)> {
        let (mut pace, mut now, mut next) = (Pace::new(), 0.0, 0);
        let mut on_their_way: VecDeque<(i64, i64, f64)> = VecDeque::new();
        let mut taken = Vec::new();
        loop {
            while on_their_way.len() < 2 && next < steps {
                let end = (next + pace.steps()).min(steps);
                on_their_way.push_back((next, end, now));
                next = end;
            }
            let Some((begin, end, submitted)) = on_their_way.pop_front() else { return taken };
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
            // Nor are they so short that submitting them would count.
            let most = found.iter().map(|&(steps, _)| steps).max().unwrap();
            assert!(most >= (0.4 * CHUNK_SECONDS / cost).min(MOST_STEPS as f64) as i64, "{most} steps of {cost} s");
        }
    }

    #[test]
    fn chunks_stay_short_while_steps_become_dearer() {
        // A hundred times as dear at the end as at the start, and every tenth one five times as dear as the others.
        for cheapest in [1e-5, 1e-3] {
            let cost = |i: i64| cheapest * 100f64.powf(i as f64 / 2300.0) * if i % 10 == 0 { 5.0 } else { 1.0 };
            for (steps, seconds) in chunks(2300, cost) {
                assert!(seconds < 0.5, "{steps} steps took {seconds} s");
            }
        }
    }

    #[test]
    fn a_busy_host_says_nothing_of_the_device() {
        let mut pace = Pace::new();
        pace.busy(2.0);
        pace.chunk(2, 0.0, 2.1);
        assert_eq!(pace.steps(), FIRST_STEPS);
        pace.busy(0.0);
        pace.chunk(2, 2.1, 2.2);
        assert_eq!(pace.steps(), 1);
    }
}
