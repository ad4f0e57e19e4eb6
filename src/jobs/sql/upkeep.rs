//! Upkeep: the process that may sweep, the keys of the artifact store that are in use, and the
//! state that outlives processes.

use super::codec::{json, parse, until, values};
use super::error::SqlError;
use super::operation::Done;
use super::store::Store;
use super::tx::Tx;
use crate::jobs::StoreError;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
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

/// Sign that the job store has lost records of the artifact store, or is the wrong one for it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mismatch {
    /// True if the job store has never had a job; false if its records are older than the files.
    pub is_new: bool,
    /// Folder of a model that the job store does not know.
    pub example: String,
}

/// State of upkeep that outlives processes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UpkeepState {
    /// Time of the latest round of any process, by the clock of the store.
    pub seen_at: Timestamp,
    /// Found by the latest comparison with the artifact store. While there is one, no orphan is
    /// deleted.
    pub mismatch: Option<Mismatch>,
}

/// Result of [`Store::last_round`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LastRound {
    /// Time by the clock of the store.
    pub now: Timestamp,
    /// Time up to which the records are known to be complete; `None` if there was never a job.
    pub seen_at: Option<Timestamp>,
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

    /// Reads when upkeep last saw the records.
    pub async fn last_round(&self) -> Result<LastRound, StoreError> {
        let tx = &mut self.read("last_round").await?;
        let now = tx.now().await?;
        let mut seen_at = state(tx).await?.map(|state| state.seen_at);
        if seen_at.is_none() {
            // Before the first round of this version, the records themselves are the trace of time.
            let job = tx.optional("SELECT created_at AS at FROM jobs ORDER BY id DESC LIMIT 1", values![]).await?;
            if let Some(job) = job {
                let beat = tx.one("SELECT MAX(heartbeat_at) AS at FROM workers", values![]).await?;
                seen_at = beat.optional_time("at")?.max(Some(job.time("at")?));
            }
        }
        Ok(LastRound { now, seen_at })
    }

    /// The state of upkeep; `None` before the first round.
    pub async fn upkeep_state(&self) -> Result<Option<UpkeepState>, StoreError> {
        Ok(state(&mut self.read("upkeep_state").await?).await?)
    }

    /// Records a round of upkeep with the mismatch that it found. An earlier mismatch stays unless
    /// `trust` is true. Returns the new state.
    pub async fn record_round(&self, found: Option<Mismatch>, trust: bool) -> Result<UpkeepState, StoreError> {
        self.apply("record_round", (found, trust), |(found, trust), tx, _| Box::pin(record(found, *trust, tx))).await
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

async fn state(tx: &mut Tx<'_>) -> Result<Option<UpkeepState>, SqlError> {
    let row = tx.optional("SELECT state FROM upkeep_state", values![]).await?;
    row.map(|row| parse(row.get("state")?)).transpose()
}

async fn record(found: &Option<Mismatch>, trust: bool, tx: &mut Tx<'_>) -> Result<Done<UpkeepState>, SqlError> {
    let seen_at = tx.now().await?;
    let before = state(tx).await?.and_then(|state| state.mismatch).filter(|_| !trust);
    let state = UpkeepState { seen_at, mismatch: found.clone().or(before) };
    let sql = "INSERT INTO upkeep_state (id, state) VALUES (1, $1) ON CONFLICT (id) DO UPDATE SET state = $1";
    tx.execute(sql, values![json(&state)]).await?;
    Ok(Done::quiet(state))
}

/// Frees the locks of all upkeep tasks, for a store that no other process has open.
pub(super) async fn free_all(tx: &mut Tx<'_>) -> Result<Done<()>, SqlError> {
    tx.execute("DELETE FROM upkeep", values![]).await?;
    Ok(Done::quiet(()))
}
