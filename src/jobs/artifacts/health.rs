//! Whether the artifact store accepts writes, as far as this process knows.

use super::error::ArtifactError;
use crate::clock::Stopwatch;
use std::future::Future;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tokio::time::timeout;

/// How long the result of a check is reused.
const FRESH: Duration = Duration::from_secs(1);
/// Longest time of a check.
const LIMIT: Duration = Duration::from_secs(5);

/// The last write and the last check.
#[derive(Debug, Default)]
pub(super) struct Health {
    /// The error of the latest write, if it failed.
    outage: Mutex<Option<String>>,
    /// The latest check. Locked while one runs, so that concurrent callers share it.
    checked: tokio::sync::Mutex<Option<(Stopwatch, Result<(), String>)>>,
}

impl Health {
    /// Remembers whether a write failed. Errors that are not the store's (an unreadable scratch file) change nothing.
    pub(super) fn note<T>(&self, result: Result<T, ArtifactError>) -> Result<T, ArtifactError> {
        let outage = match &result {
            Ok(_) => None,
            Err(ArtifactError::Store(error)) => Some(error.clone()),
            Err(_) => return result,
        };
        *self.outage.lock().unwrap_or_else(PoisonError::into_inner) = outage;
        result
    }

    pub(super) fn outage(&self) -> Option<String> {
        self.outage.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The result of `probe`, a small write, or that of one less than [`FRESH`] ago.
    pub(super) async fn check(
        &self,
        probe: impl Future<Output = Result<(), ArtifactError>>,
    ) -> Result<(), ArtifactError> {
        let mut checked = self.checked.lock().await;
        if let Some((since, result)) = &*checked
            && since.elapsed() < FRESH
        {
            return result.clone().map_err(ArtifactError::Store);
        }
        let late = || ArtifactError::Store(format!("a small write did not complete within {} s", LIMIT.as_secs()));
        let result = self.note(timeout(LIMIT, probe).await.unwrap_or_else(|_| Err(late())));
        let text = result.as_ref().copied().map_err(|error| match error {
            ArtifactError::Store(detail) => detail.clone(),
            other => other.to_string(),
        });
        *checked = Some((Stopwatch::start(), text));
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};

    #[tokio::test]
    async fn concurrent_checks_share_one_write_and_a_later_success_ends_the_outage() {
        let (health, writes) = (Health::default(), AtomicU32::new(0));
        let probe = async |result: Result<(), ArtifactError>| {
            writes.fetch_add(1, Ordering::Relaxed);
            tokio::task::yield_now().await;
            result
        };
        let down = || Err(ArtifactError::Store("connection refused".to_owned()));
        let (one, other) = tokio::join!(health.check(probe(down())), health.check(probe(down())));
        assert!(one.is_err() && other.is_err());
        assert_eq!((writes.load(Ordering::Relaxed), health.outage()), (1, Some("connection refused".to_owned())));
        assert!(health.note(Err::<(), _>(ArtifactError::NotFound { key: "k".to_owned() })).is_err());
        assert!(health.outage().is_some(), "only a write that succeeds ends it");
        health.note(Ok(())).unwrap();
        assert_eq!(health.outage(), None);
    }

    #[tokio::test]
    async fn a_check_that_hangs_fails_after_its_time_limit() {
        let health = Health::default();
        let error = health.check(std::future::pending()).await.unwrap_err();
        assert!(error.to_string().contains("within 5 s") && health.outage().is_some(), "{error}");
    }
}
