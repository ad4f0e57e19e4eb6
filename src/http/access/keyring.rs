//! The keys, kept in memory and read again from time to time, so that a request costs no query.

use crate::clock::Stopwatch;
use crate::jobs::keys::{Key, Secret};
use crate::jobs::{Store, StoreError};
use jiff::{SignedDuration, Timestamp};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

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
pub(super) struct Keyring {
    store: Arc<dyn Store>,
    refresh: Duration,
    read: Mutex<Option<Arc<Keys>>>,
    /// Held while they are read, with the time of the last try.
    reading: tokio::sync::Mutex<Option<Stopwatch>>,
}

impl Keyring {
    pub(super) fn new(store: Arc<dyn Store>, refresh: Duration) -> Self {
        Self { store, refresh, read: Mutex::default(), reading: tokio::sync::Mutex::default() }
    }

    /// The keys. They are read again if that was done longer ago than the time of refresh; if the store does not answer in
    /// time, those read last go on to count.
    pub(super) async fn current(&self) -> Result<Arc<Keys>, StoreError> {
        let last = self.last();
        if let Some(keys) = last.clone().filter(|keys| keys.age.elapsed() < self.refresh) {
            return Ok(keys);
        }
        let Some(last) = last else { return self.read_again().await };
        match tokio::time::timeout(PATIENCE, self.read_again()).await {
            Ok(Ok(keys)) => Ok(keys),
            Ok(Err(_)) | Err(_) => Ok(last),
        }
    }

    fn last(&self) -> Option<Arc<Keys>> {
        self.read.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Reads the keys, one caller for all that wait. After a failure, for the time of refresh the keys read last are
    /// returned without another try.
    async fn read_again(&self) -> Result<Arc<Keys>, StoreError> {
        let waiting = Stopwatch::start();
        let mut tried = self.reading.lock().await;
        let last = self.last();
        // Another caller has read them meanwhile.
        if let Some(keys) = last.clone().filter(|keys| keys.age.elapsed() <= waiting.elapsed()) {
            return Ok(keys);
        }
        if let Some(last) = last.clone().filter(|_| tried.is_some_and(|tried| tried.elapsed() < self.refresh)) {
            return Ok(last);
        }
        *tried = Some(Stopwatch::start());
        let (age, result) = (Stopwatch::start(), self.store.keys().await);
        let (at, keys) = result.inspect_err(|error| tracing::warn!(%error, "the keys could not be read"))?;
        let by_prefix = keys.into_iter().map(|key| (key.prefix.clone(), Arc::new(key))).collect();
        let keys = Arc::new(Keys { by_prefix, at, age });
        if let Some(last) = last {
            report_changes(&last, &keys);
        }
        *self.read.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&keys));
        *tried = None;
        Ok(keys)
    }
}

/// Logs keys that were made or revoked elsewhere.
fn report_changes(before: &Keys, after: &Keys) {
    for (prefix, key) in &after.by_prefix {
        let (owner, scopes) = (&key.owner, &key.scopes);
        match before.by_prefix.get(prefix) {
            None => tracing::info!(target: "oviduct::audit", action = "key added", key = prefix, %owner, %scopes),
            Some(known) if known.revoked_at != key.revoked_at => {
                tracing::info!(target: "oviduct::audit", action = "key revoked", key = prefix, %owner);
            }
            Some(_) => {}
        }
    }
}
