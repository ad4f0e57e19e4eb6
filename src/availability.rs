//! Availability of a store, as this process knows it: by its latest use, or by a check that probes
//! may request often.

use crate::clock::Stopwatch;
use crate::lock::Mutex;
use std::future::Future;
use std::time::Duration;
use tokio::time::timeout;

/// Time for which the result of a check is reused.
const FRESH: Duration = Duration::from_secs(1);
/// Maximum time of a check by default.
const LIMIT: Duration = Duration::from_secs(5);

/// The latest use and the latest check of a store.
#[derive(Debug)]
pub struct Availability {
    /// Error of the latest use, if it failed.
    outage: Mutex<Option<String>>,
    /// The latest check. Locked while a check runs, so that concurrent callers share it.
    checked: tokio::sync::Mutex<Option<(Stopwatch, Result<(), String>)>>,
    /// Maximum time of a check.
    limit: Duration,
}

impl Default for Availability {
    /// The availability of a store that works.
    fn default() -> Self {
        Self::new(LIMIT)
    }
}

impl Availability {
    /// The availability of a store that works. A check fails after the time `limit`.
    #[must_use]
    pub fn new(limit: Duration) -> Self {
        Self { outage: Mutex::default(), checked: tokio::sync::Mutex::default(), limit }
    }

    /// Remembers whether a use of the store succeeded.
    pub fn note(&self, result: Result<(), String>) {
        *self.outage.lock() = result.err();
    }

    /// Error of the latest use or check; `None` if it succeeded, or if there was none yet.
    #[must_use]
    pub fn outage(&self) -> Option<String> {
        self.outage.lock().clone()
    }

    /// The result of `probe`, a small use of the store, or of a probe less than a second ago.
    /// Concurrent calls share one probe.
    ///
    /// # Errors
    /// The error of the probe, or a message that it did not complete in time.
    pub async fn check(&self, probe: impl Future<Output = Result<(), String>>) -> Result<(), String> {
        let mut checked = self.checked.lock().await;
        if let Some((since, result)) = &*checked
            && since.elapsed() < FRESH
        {
            return result.clone();
        }
        let late = || Err(format!("a check did not complete within {:?}", self.limit));
        let result = timeout(self.limit, probe).await.unwrap_or_else(|_| late());
        self.note(result.clone());
        *checked = Some((Stopwatch::start(), result.clone()));
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};

    #[tokio::test]
    async fn concurrent_checks_share_one_probe_and_a_later_success_ends_the_outage() {
        let (store, probes) = (Availability::default(), AtomicU32::new(0));
        let probe = async || {
            probes.fetch_add(1, Ordering::Relaxed);
            tokio::task::yield_now().await;
            Err("connection refused".to_owned())
        };
        let (one, other) = tokio::join!(store.check(probe()), store.check(probe()));
        assert!(one.is_err() && other.is_err());
        assert_eq!((probes.load(Ordering::Relaxed), store.outage()), (1, Some("connection refused".to_owned())));
        store.note(Ok(()));
        assert_eq!(store.outage(), None);
    }

    #[tokio::test]
    async fn a_check_that_hangs_fails_after_its_time_limit() {
        let store = Availability::new(Duration::from_millis(10));
        let error = store.check(std::future::pending()).await.unwrap_err();
        assert!(error.contains("within 10ms") && store.outage().is_some(), "{error}");
    }
}
