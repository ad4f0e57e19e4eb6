//! The keys, kept in memory and read again from time to time, so that a request costs no query.

use crate::clock::Stopwatch;
use crate::jobs::keys::{Key, Secret};
use crate::jobs::{Store, StoreError};
use crate::lock::Mutex;
use jiff::{SignedDuration, Timestamp};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinError;

/// Longest time that a request waits for keys that are read again; then those read last count.
const PATIENCE: Duration = Duration::from_millis(250);

/// The keys as they were read.
#[derive(Debug)]
pub(super) struct Keys {
    by_prefix: BTreeMap<String, Arc<Key>>,
    /// Time of the store when they were read.
    at: Timestamp,
    age: Stopwatch,
}

impl Keys {
    /// Whether none has ever been made.
    pub(super) fn is_empty(&self) -> bool {
        self.by_prefix.is_empty()
    }

    fn now(&self) -> Timestamp {
        let elapsed = SignedDuration::try_from(self.age.elapsed()).unwrap_or(SignedDuration::MAX);
        self.at.checked_add(elapsed).unwrap_or(Timestamp::MAX)
    }

    /// The key of this prefix, if it works.
    pub(super) fn working(&self, prefix: &str) -> Option<Arc<Key>> {
        self.by_prefix.get(prefix).filter(|key| key.works_at(self.now())).cloned()
    }

    /// The key with this secret, if it works. An unknown prefix takes as long as a wrong secret.
    pub(super) fn working_with(&self, secret: &Secret) -> Option<Arc<Key>> {
        const NONE: &str = "0000000000000000000000000000000000000000000000000000000000000000";
        let hash = self.by_prefix.get(secret.prefix()).map_or(NONE, |key| &key.hash);
        if secret.matches(hash) { self.working(secret.prefix()) } else { None }
    }
}

/// Keeps the keys.
pub(super) struct Keyring(Arc<Shared>);

struct Shared {
    store: Store,
    refresh: Duration,
    read: Mutex<Option<Arc<Keys>>>,
    /// Held while they are read, with the time since the last failure.
    reading: tokio::sync::Mutex<Option<Stopwatch>>,
}

impl Keyring {
    pub(super) fn new(store: Store, refresh: Duration) -> Self {
        Self(Arc::new(Shared { store, refresh, read: Mutex::default(), reading: tokio::sync::Mutex::default() }))
    }

    /// The keys. They are read again if that was done longer ago than the time of refresh; if the store does not answer in
    /// time, those read last go on to count until it does.
    pub(super) async fn current(&self) -> Result<Arc<Keys>, StoreError> {
        let last = self.0.last();
        if let Some(keys) = last.clone().filter(|keys| keys.age.elapsed() < self.0.refresh) {
            return Ok(keys);
        }
        // A slow store answers some time, although nobody waits for it any more.
        let shared = Arc::clone(&self.0);
        let reading = tokio::spawn(async move { shared.read_again().await });
        let failed = |error: JoinError| StoreError::Database(format!("the keys could not be read: {error}").into());
        let Some(last) = last else { return reading.await.map_err(failed)? };
        match tokio::time::timeout(PATIENCE, reading).await {
            Ok(Ok(Ok(keys))) => Ok(keys),
            Ok(Ok(Err(_)) | Err(_)) | Err(_) => Ok(last),
        }
    }
}

impl Shared {
    fn last(&self) -> Option<Arc<Keys>> {
        self.read.lock().clone()
    }

    /// Reads the keys, one caller for all that wait. After a failure there is no other try for the time of refresh.
    async fn read_again(&self) -> Result<Arc<Keys>, StoreError> {
        let waiting = Stopwatch::start();
        let mut failed = self.reading.lock().await;
        let last = self.last();
        // Another caller has read them meanwhile.
        if let Some(keys) = last.clone().filter(|keys| keys.age.elapsed() <= waiting.elapsed()) {
            return Ok(keys);
        }
        if failed.is_some_and(|failed| failed.elapsed() < self.refresh) {
            return last.ok_or_else(|| StoreError::Database("the keys could not be read a moment ago".into()));
        }
        let (age, result) = (Stopwatch::start(), self.store.keys().await);
        *failed = result.is_err().then(Stopwatch::start);
        let (at, keys) = result.inspect_err(|error| tracing::warn!(%error, "the keys could not be read"))?;
        if age.elapsed() > PATIENCE {
            tracing::warn!(seconds = age.seconds(), "reading the keys was slow; those read before counted meanwhile");
        }
        let by_prefix = keys.into_iter().map(|key| (key.prefix.clone(), Arc::new(key))).collect();
        let keys = Arc::new(Keys { by_prefix, at, age });
        if let Some(last) = last {
            report_changes(&last, &keys);
        }
        *self.read.lock() = Some(Arc::clone(&keys));
        Ok(keys)
    }
}

/// Logs keys that were made or revoked elsewhere.
fn report_changes(before: &Keys, after: &Keys) {
    for (prefix, key) in &after.by_prefix {
        match before.by_prefix.get(prefix) {
            None => key.audit_added(),
            Some(known) if known.revoked_at != key.revoked_at => key.audit_revoked(),
            Some(_) => {}
        }
    }
}
