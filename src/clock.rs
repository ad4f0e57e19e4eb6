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
    Manual(Arc<Mutex<Timestamp>>),
}

impl Clock {
    /// A manual clock at `start`; [`Clock::advance`] moves it.
    #[must_use]
    pub fn manual(start: Timestamp) -> Self {
        Self::Manual(Arc::new(Mutex::new(start)))
    }

    /// The current time.
    #[must_use]
    pub fn now(&self) -> Timestamp {
        match self {
            #[expect(clippy::disallowed_methods, reason = "the one place that reads the wall clock")]
            Self::System => Timestamp::now(),
            Self::Manual(at) => *at.lock(),
        }
    }

    /// Advances a manual clock; has no effect on the system clock.
    pub fn advance(&self, by: Duration) {
        if let Self::Manual(at) = self {
            let mut at = at.lock();
            *at = at.saturating_add(by).unwrap_or(Timestamp::MAX);
        }
    }
}
