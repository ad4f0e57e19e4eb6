//! Cache of the API keys. The service reads its keys again every second (`AccessOptions::refresh`),
//! so a request costs no query.

use crate::clock::Stopwatch;
use crate::jobs::keys::{Key, Secret};
use crate::jobs::{Store, StoreError};
use crate::lock::Mutex;
use jiff::{SignedDuration, Timestamp};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinError;

/// Maximum time for which a request waits for a refresh. After that, the cached keys stay in
/// effect.
const REFRESH_WAIT: Duration = Duration::from_millis(250);

/// All keys at one moment.
#[derive(Debug)]
pub(super) struct Keys {
    by_prefix: BTreeMap<String, Arc<Key>>,
    /// Time of the store when the keys were read.
    at: Timestamp,
    /// Time since then.
    age: Stopwatch,
}

impl Keys {
    /// True if no key was ever created.
    pub(super) fn is_empty(&self) -> bool {
        self.by_prefix.is_empty()
    }

    fn now(&self) -> Timestamp {
        let elapsed = SignedDuration::try_from(self.age.elapsed()).unwrap_or(SignedDuration::MAX);
        self.at.checked_add(elapsed).unwrap_or(Timestamp::MAX)
    }

    /// The key with this prefix, if it is valid.
    pub(super) fn working(&self, prefix: &str) -> Option<Arc<Key>> {
        self.by_prefix.get(prefix).filter(|key| key.works_at(self.now())).cloned()
    }

    /// The key with this secret, if it is valid. An unknown prefix takes as long as a wrong secret,
    /// so response times do not reveal prefixes.
    pub(super) fn working_with(&self, secret: &Secret) -> Option<Arc<Key>> {
        const NONE: &str = "0000000000000000000000000000000000000000000000000000000000000000";
        let hash = self.by_prefix.get(secret.prefix()).map_or(NONE, |key| &key.hash);
        if secret.matches(hash) { self.working(secret.prefix()) } else { None }
    }
}

/// The cache. Refreshes run in tasks that share its state.
pub(super) struct Keyring(Arc<KeyCache>);

struct KeyCache {
    store: Store,
    refresh_interval: Duration,
    keys: Mutex<Option<Arc<Keys>>>,
    /// Held during a refresh. Contains the time since the last failure.
    refreshing: tokio::sync::Mutex<Option<Stopwatch>>,
}

impl Keyring {
    pub(super) fn new(store: Store, refresh_interval: Duration) -> Self {
        let (keys, refreshing) = (Mutex::default(), tokio::sync::Mutex::default());
        Self(Arc::new(KeyCache { store, refresh_interval, keys, refreshing }))
    }

    /// The keys, at most as old as the refresh interval. If the store does not respond in time, the
    /// cached keys stay in effect until it does.
    pub(super) async fn current(&self) -> Result<Arc<Keys>, StoreError> {
        let cached = self.0.cached();
        if let Some(keys) = cached.clone().filter(|keys| keys.age.elapsed() < self.0.refresh_interval) {
            return Ok(keys);
        }
        // The task outlives this request, so a slow store still refreshes the cache.
        let cache = Arc::clone(&self.0);
        let refresh = tokio::spawn(async move { cache.refresh().await });
        let failed = |error: JoinError| StoreError::Database(format!("the keys could not be read: {error}").into());
        let Some(cached) = cached else { return refresh.await.map_err(failed)? };
        Ok(match tokio::time::timeout(REFRESH_WAIT, refresh).await {
            Ok(Ok(Ok(keys))) => keys,
            _ => cached,
        })
    }
}

impl KeyCache {
    fn cached(&self) -> Option<Arc<Keys>> {
        self.keys.lock().clone()
    }

    /// Reads the keys once for all requests that wait. After a failure, the store is not asked
    /// again during the refresh interval.
    async fn refresh(&self) -> Result<Arc<Keys>, StoreError> {
        let waiting = Stopwatch::start();
        let mut failed = self.refreshing.lock().await;
        let cached = self.cached();
        // Another request refreshed the cache in the meantime.
        if let Some(keys) = cached.clone().filter(|keys| keys.age.elapsed() <= waiting.elapsed()) {
            return Ok(keys);
        }
        if failed.is_some_and(|failed| failed.elapsed() < self.refresh_interval) {
            return cached.ok_or_else(|| StoreError::Database("the keys could not be read a moment ago".into()));
        }
        let (age, result) = (Stopwatch::start(), self.store.keys().await);
        *failed = result.is_err().then(Stopwatch::start);
        let (at, keys) = result.inspect_err(|error| tracing::warn!(%error, "the keys could not be read"))?;
        if age.elapsed() > REFRESH_WAIT {
            let seconds = age.seconds();
            tracing::warn!(
                seconds,
                "the job store was slow to return the API keys; the previous keys stayed in effect"
            );
        }
        let by_prefix = keys.into_iter().map(|key| (key.prefix.clone(), Arc::new(key))).collect();
        let keys = Arc::new(Keys { by_prefix, at, age });
        if let Some(cached) = cached {
            report_changes(&cached, &keys);
        }
        *self.keys.lock() = Some(Arc::clone(&keys));
        Ok(keys)
    }
}

/// Logs keys that another process created or revoked.
fn report_changes(before: &Keys, after: &Keys) {
    for (prefix, key) in &after.by_prefix {
        match before.by_prefix.get(prefix) {
            None => key.audit_added(),
            Some(known) if known.revoked_at != key.revoked_at => key.audit_revoked(),
            Some(_) => {}
        }
    }
}
