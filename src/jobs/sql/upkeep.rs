//! Upkeep: the process that may sweep, and the keys of the artifact store that are in use.

use super::codec::{until, values};
use super::error::SqlError;
use super::operation::Done;
use super::store::Store;
use super::tx::Tx;
use crate::jobs::StoreError;
use std::collections::BTreeSet;
use std::time::Duration;

/// A periodic task that one process at a time does for all processes that share the stores.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpkeepTask {
    /// Deletion of models by age and size.
    Retention,
    /// Removal of orphans.
    Orphans,
}

impl UpkeepTask {
    /// Name of its lock.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Retention => "retention",
            Self::Orphans => "orphans",
        }
    }
}

/// Calls for upkeep.
impl Store {
    /// Takes the lock of an upkeep task for `lease`, or renews it. Returns true if `owner` holds
    /// the lock.
    pub async fn acquire_upkeep(&self, task: UpkeepTask, owner: &str, lease: Duration) -> Result<bool, StoreError> {
        let input = (task, owner.to_owned(), lease);
        self.apply("acquire_upkeep", input, |(task, owner, lease), tx, _| Box::pin(acquire(*task, owner, *lease, tx)))
            .await
    }

    /// Returns the subset of `keys` in use: named by a record as a file or a checkpoint, or under
    /// the prefix of a running attempt. One query, so the result is consistent.
    pub async fn keys_in_use(&self, keys: &[String]) -> Result<BTreeSet<String>, StoreError> {
        let tx = &mut self.read("keys_in_use").await?;
        let any = tx.either("IN (SELECT value FROM json_each($1))", "= ANY ($1)");
        // A running attempt contributes the prefix of its keys, which equals no key.
        let sql = format!(
            "SELECT key FROM files WHERE key {any} UNION SELECT checkpoint FROM jobs WHERE checkpoint {any} \
             UNION SELECT 'models/' || id || '/' || attempts || '/' FROM jobs WHERE status = 'running'"
        );
        let rows = tx.all(sql, values![keys.to_vec()]).await?;
        let used: BTreeSet<&str> = rows.iter().map(|row| row.get("key")).collect::<Result<_, _>>()?;
        let is_used = |key: &str| {
            let prefix = key.match_indices('/').nth(2).map(|(at, slash)| &key[..at + slash.len()]);
            used.contains(key) || prefix.is_some_and(|prefix| used.contains(prefix))
        };
        Ok(keys.iter().filter(|key| is_used(key)).cloned().collect())
    }
}

async fn acquire(task: UpkeepTask, owner: &str, lease: Duration, tx: &mut Tx<'_>) -> Result<Done<bool>, SqlError> {
    let now = tx.steady().await?;
    let sql = "INSERT INTO upkeep (task, owner, held_until) VALUES ($1, $2, $3) \
               ON CONFLICT (task) DO UPDATE SET owner = $2, held_until = $3 \
               WHERE upkeep.owner = $2 OR upkeep.held_until <= $4";
    let taken = tx.execute(sql, values![task.name(), owner, until(now, lease), now]).await?;
    Ok(Done::quiet(taken > 0))
}

/// Frees the locks of all upkeep tasks, for a store that no other process has open.
pub(super) async fn free_all(tx: &mut Tx<'_>) -> Result<Done<()>, SqlError> {
    tx.execute("DELETE FROM upkeep", values![]).await?;
    Ok(Done::quiet(()))
}
