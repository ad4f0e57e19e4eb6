//! Faults of this machine (a scratch folder that is full, read-only or gone): after one, all workers of the process rest, the
//! longer the more follow on each other, so that a machine that is not well does not outrun those that are.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

/// The first rest, doubled after each further fault.
const FIRST: Duration = Duration::from_secs(1);
/// The longest.
const LONGEST: Duration = Duration::from_secs(60);

/// How well this machine is.
#[derive(Debug, Default)]
pub(super) struct Health(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    /// Faults since the last model was made.
    faults: u32,
    rests_until: Option<Instant>,
}

impl Health {
    /// A fault of the machine. Those that came at the same time are one.
    pub(super) fn fault(&self) {
        let now = Instant::now();
        let mut state = self.state();
        if state.rests_until.is_none_or(|until| until <= now) {
            let rest = rest_after(state.faults);
            state.faults += 1;
            state.rests_until = Some(now + rest);
            tracing::warn!(?rest, "this machine is at fault; its workers rest");
        }
    }

    /// A model was made.
    pub(super) fn well(&self) {
        *self.state() = State::default();
    }

    /// Until the rest is over, where there is one.
    pub(super) async fn rest(&self) {
        let until = self.state().rests_until;
        if let Some(until) = until {
            sleep_until(until).await;
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// How long to rest after a fault, by those before it.
fn rest_after(faults: u32) -> Duration {
    (FIRST * (1 << faults.min(6))).min(LONGEST)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rests_grow() {
        let rests: Vec<u64> = (0..8).map(|faults| rest_after(faults).as_secs()).collect();
        assert_eq!(rests, [1, 2, 4, 8, 16, 32, 60, 60]);
        assert_eq!(rest_after(u32::MAX), LONGEST);
    }

    #[tokio::test]
    async fn faults_at_one_time_are_one_and_a_model_ends_the_row() {
        let health = Health::default();
        health.rest().await;
        health.fault();
        health.fault();
        assert_eq!(health.state().faults, 1);
        let until = health.state().rests_until.unwrap();
        health.rest().await;
        assert!(Instant::now() >= until);
        health.fault();
        assert_eq!(health.state().faults, 2);
        health.well();
        health.fault();
        assert_eq!(health.state().faults, 1);
    }
}
