//! Wall-clock time as a parameter: the only module that reads it.
//!
//! Code that needs the time takes a [`Clock`], so that tests can advance it.

pub use oviduct_engine::clock::Stopwatch;

use crate::lock::Mutex;
use jiff::Timestamp;
use std::sync::Arc;
use std::time::Duration;

/// A source of wall-clock time.
#[derive(Clone, Debug, Default)]
pub enum Clock {
    /// The operating system's clock.
    #[default]
    System,
    /// A clock that a test advances.
    Manual(Arc<Mutex<ManualTime>>),
}

/// Time of a manual clock.
#[derive(Debug)]
pub struct ManualTime {
    now: Timestamp,
    /// Time that has passed since the clock was made.
    elapsed: Duration,
}

impl Clock {
    /// A manual clock at `start`; [`Clock::advance`] and [`Clock::set`] move it.
    #[must_use]
    pub fn manual(start: Timestamp) -> Self {
        Self::Manual(Arc::new(Mutex::new(ManualTime { now: start, elapsed: Duration::ZERO })))
    }

    /// The current time.
    #[must_use]
    pub fn now(&self) -> Timestamp {
        match self {
            #[expect(clippy::disallowed_methods, reason = "the one place that reads the wall clock")]
            Self::System => Timestamp::now(),
            Self::Manual(time) => time.lock().now,
        }
    }

    /// Lets time pass on a manual clock; has no effect on the system clock.
    pub fn advance(&self, by: Duration) {
        if let Self::Manual(time) = self {
            let mut time = time.lock();
            time.now = time.now.saturating_add(by).unwrap_or(Timestamp::MAX);
            time.elapsed += by;
        }
    }

    /// Sets a manual clock without letting time pass; has no effect on the system clock.
    pub fn set(&self, now: Timestamp) {
        if let Self::Manual(time) = self {
            time.lock().now = now;
        }
    }

    /// Time that has passed while `watch` ran, whatever the clock was set to. On a manual clock,
    /// time since the clock was made.
    #[must_use]
    pub fn elapsed(&self, watch: &Stopwatch) -> Duration {
        match self {
            Self::System => watch.elapsed(),
            Self::Manual(time) => time.lock().elapsed,
        }
    }
}
