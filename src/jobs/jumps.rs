//! Time that the clock of the store shows although it did not pass while upkeep watched: the clock
//! was set, the machine was suspended, or no service ran.
//!
//! Retention does not count this time. A wrong clock therefore makes no model older than it is, and
//! each model is kept for its whole time after a backup was restored.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Maximum number of remembered jumps. Models that are older than all of them age by the clock.
const REMEMBERED: usize = 100;

/// A jump of the clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Jump {
    /// Time by the clock after the jump.
    pub at: Timestamp,
    /// Time that did not pass.
    pub by: Duration,
}

/// The jumps of a clock, oldest first.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Jumps(Vec<Jump>);

impl Jumps {
    /// Notes that the clock went from `before` to `now` while `elapsed` passed. A difference of at
    /// most `tolerance` is no jump. A clock that is set back undoes the jumps after `now`. Returns
    /// the new jump.
    pub fn note(&mut self, before: Timestamp, now: Timestamp, elapsed: Duration, tolerance: Duration) -> Option<Jump> {
        let undone: Duration = self.0.extract_if(.., |jump| jump.at > now).map(|jump| jump.by).sum();
        let signed = |time| SignedDuration::try_from(time).unwrap_or(SignedDuration::MAX);
        let advance = now.duration_since(before).saturating_add(signed(undone)).saturating_sub(signed(elapsed));
        let by = Duration::try_from(advance).ok().filter(|by| *by > tolerance)?;
        let jump = Jump { at: now, by };
        self.0.push(jump);
        self.0.drain(..self.0.len().saturating_sub(REMEMBERED));
        Some(jump)
    }

    /// Latest time from which more than `age` has passed until `now`, without the jumps.
    #[must_use]
    pub fn before(&self, now: Timestamp, age: Duration) -> Timestamp {
        let earlier = |time: Timestamp, by| time.saturating_sub(by).unwrap_or(Timestamp::MIN);
        let later = |cutoff: &Timestamp, jump: &&Jump| jump.at > *cutoff;
        self.0.iter().rev().fold(earlier(now, age), |cutoff, jump| {
            if later(&cutoff, &jump) { earlier(cutoff, jump.by) } else { cutoff }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MINUTE: Duration = Duration::from_secs(60);
    const DAY: Duration = Duration::from_secs(86_400);
    const YEAR: Duration = Duration::from_secs(365 * 86_400);

    fn start() -> Timestamp {
        "2026-01-02T03:04:05Z".parse().unwrap()
    }

    #[test]
    fn time_that_did_not_pass_makes_nothing_older() {
        let mut jumps = Jumps::default();
        let mut now = start();
        assert_eq!(jumps.note(now, now + MINUTE, MINUTE, MINUTE), None);
        assert_eq!(jumps.note(now, now + 2 * MINUTE, MINUTE, MINUTE), None, "within the tolerance");
        assert_eq!(jumps.before(now, DAY), now - DAY);
        let jump = jumps.note(now, now + YEAR + MINUTE, MINUTE, DAY).unwrap();
        now = now + YEAR + MINUTE;
        assert_eq!(jump, Jump { at: now, by: YEAR });
        assert_eq!(jumps.before(now, 30 * DAY), start() + MINUTE - 30 * DAY);
        // What ended after the jump ages by the clock, and so does all after its whole time.
        now += 10 * DAY;
        assert_eq!(jumps.before(now, 9 * DAY), now - 9 * DAY);
        assert_eq!(jumps.before(now, 11 * DAY), now - 11 * DAY - YEAR);
        now += 20 * DAY;
        assert_eq!(jumps.before(now, 30 * DAY), now - 30 * DAY);
    }

    #[test]
    fn jumps_add_up() {
        let mut jumps = Jumps::default();
        let mut now = start();
        for _ in 0..3 {
            jumps.note(now, now + 3 * DAY, DAY, MINUTE).unwrap();
            now += 3 * DAY;
        }
        assert_eq!(jumps.before(now, 2 * DAY), start() + 3 * DAY, "after the first jump");
        assert_eq!(jumps.before(now, 3 * DAY), start(), "three days passed since");
        assert_eq!(jumps.before(now, 4 * DAY), start() - DAY);
    }

    #[test]
    fn a_clock_that_is_set_right_again_undoes_its_jump() {
        let mut jumps = Jumps::default();
        let wrong = start() + YEAR;
        jumps.note(start(), wrong, MINUTE, DAY).unwrap();
        let right = start() + 2 * MINUTE;
        assert_eq!(jumps.note(wrong, right, MINUTE, DAY), None);
        assert_eq!(jumps, Jumps::default());
        // Half of the way back.
        jumps.note(start(), wrong, Duration::ZERO, DAY).unwrap();
        let half = jumps.note(wrong, start() + YEAR / 2, Duration::ZERO, DAY).unwrap();
        assert_eq!(half, Jump { at: start() + YEAR / 2, by: YEAR / 2 });
        assert_eq!(jumps.note(half.at, Timestamp::MIN, Duration::ZERO, DAY), None);
        assert_eq!(jumps.note(Timestamp::MIN, Timestamp::MAX, Duration::MAX, DAY), None);
        assert!(jumps.note(Timestamp::MIN, Timestamp::MAX, Duration::ZERO, DAY).is_some());
        assert_eq!(jumps.before(start(), Duration::MAX), Timestamp::MIN);
    }

    #[test]
    fn old_jumps_are_forgotten() {
        let mut jumps = Jumps::default();
        let mut now = start();
        for _ in 0..3 * REMEMBERED {
            jumps.note(now, now + 2 * DAY, DAY, MINUTE).unwrap();
            now += 2 * DAY;
        }
        assert_eq!(jumps.0.len(), REMEMBERED);
    }
}
