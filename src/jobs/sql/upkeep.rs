//! Upkeep: the process that may sweep, the keys of the artifact store that are in use, and the
//! state that outlives processes.

use super::codec::{json, parse, until, values};
use super::error::{SqlError, broken};
use super::operation::{Done, Run, Uncertain};
use super::spent;
use super::store::Store;
use super::tx::{Row, Tx};
use crate::clock::Stopwatch;
use crate::jobs::jumps::{Jump, Jumps};
use crate::jobs::{File, JobId, StoreError, StoreOptions};
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
    /// Jumps of the clock of the store.
    #[serde(default)]
    pub jumps: Jumps,
}

/// Findings of a process for [`Store::record_round`].
#[derive(Clone, Debug)]
pub struct Observation {
    /// Mismatch that the process found in this round.
    pub mismatch: Option<Mismatch>,
    /// Runs since the process began its rounds.
    pub watch: Stopwatch,
    /// Reading of `watch` in the last round of this process.
    pub read_at: Option<Duration>,
    /// Maximum difference between clock and `watch` that is no jump.
    pub tolerance: Duration,
    /// Whether to accept both stores and the clock as they are.
    pub trust: bool,
}

/// A recorded round.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UpkeepRound {
    /// State after the round.
    pub state: UpkeepState,
    /// Jump of the clock since the last round.
    pub jump: Option<Jump>,
    /// Reading of the stopwatch at [`UpkeepState::seen_at`].
    pub read_at: Duration,
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
        let run: Run<(UpkeepTask, String, Duration), _> =
            |(task, owner, lease), tx, _| Box::pin(acquire(*task, owner, *lease, tx));
        self.apply("acquire_upkeep", input, run, Uncertain::RunsAgain).await
    }

    /// Reads when upkeep last saw the records.
    pub async fn last_round(&self) -> Result<LastRound, StoreError> {
        let tx = &mut self.read("last_round").await?;
        let state = state(tx).await?;
        Ok(LastRound { now: tx.now().await?, seen_at: last_seen(state.as_ref(), tx).await? })
    }

    /// The state of upkeep; `None` before the first round.
    pub async fn upkeep_state(&self) -> Result<Option<UpkeepState>, StoreError> {
        Ok(state(&mut self.read("upkeep_state").await?).await?)
    }

    /// Records a round of upkeep. An earlier mismatch and earlier jumps stay unless
    /// [`Observation::trust`] is true.
    pub async fn record_round(&self, seen: Observation) -> Result<UpkeepRound, StoreError> {
        const RECORDS: Uncertain<Observation, UpkeepRound> =
            Uncertain::Recognised(|_, done, tx| Box::pin(is_recorded(done, tx)));
        self.apply("record_round", seen, |seen, tx, options| Box::pin(record(seen, options, tx)), RECORDS).await
    }

    /// Files that records name, by key and position: the `limit` ones after the file `after`. A
    /// file of several jobs comes once.
    pub async fn files_after(&self, after: Option<&File>, limit: u32) -> Result<Vec<File>, StoreError> {
        let tx = &mut self.read("files_after").await?;
        let sql = format!(
            "SELECT key, start, MIN(name) AS name, MIN(media_type) AS media_type, MIN(bytes) AS bytes, \
             MIN(sha256) AS sha256 FROM files{} WHERE key >= $1 AND (key > $1 OR start > $2) \
             GROUP BY key, start ORDER BY key, start LIMIT {limit}",
            tx.either(" INDEXED BY files_by_key", ""),
        );
        let file = |row: &Row| {
            Ok(File {
                name: row.get("name")?,
                media_type: row.get("media_type")?,
                bytes: row.count("bytes")?,
                sha256: row.get("sha256")?,
                key: row.get("key")?,
                start: row.get::<Option<i64>>("start")?.map(u64::try_from).transpose().map_err(broken)?,
            })
        };
        let (key, start) = after.map_or(("", None), |file| (&*file.key, file.start));
        tx.all(sql, values![key, start]).await?.iter().map(file).collect()
    }

    /// Jobs whose records name this file.
    pub async fn jobs_with_file(&self, file: &File) -> Result<Vec<JobId>, StoreError> {
        let tx = &mut self.read("jobs_with_file").await?;
        let sql = "SELECT DISTINCT job_id FROM files WHERE key = $1 AND COALESCE(start, 0) = $2 ORDER BY job_id";
        let rows = tx.all(sql, values![&file.key, file.start.unwrap_or_default()]).await?;
        rows.iter().map(|row| Ok(JobId(row.id("job_id")?))).collect()
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
    // `null` while the first round is recorded.
    Ok(row.map(|row| parse::<Option<UpkeepState>>(row.get("state")?)).transpose()?.flatten())
}

/// True if the round was recorded. A second run would not report its jump.
async fn is_recorded(done: &Done<UpkeepRound>, tx: &mut Tx<'_>) -> Result<bool, SqlError> {
    lock_state(tx).await?;
    Ok(state(tx).await?.as_ref() == Some(&done.output.state))
}

/// Locks the state of upkeep, so that of several processes one records a jump.
async fn lock_state(tx: &mut Tx<'_>) -> Result<(), SqlError> {
    let lock = "INSERT INTO upkeep_state (id, state) VALUES (1, 'null') ON CONFLICT (id) DO UPDATE SET id = 1";
    tx.execute(lock, values![]).await?;
    Ok(())
}

/// Time of the last round. Before the first one, the records themselves are the trace of time.
async fn last_seen(state: Option<&UpkeepState>, tx: &mut Tx<'_>) -> Result<Option<Timestamp>, SqlError> {
    if let Some(state) = state {
        return Ok(Some(state.seen_at));
    }
    let job = tx.optional("SELECT created_at AS at FROM jobs ORDER BY id DESC LIMIT 1", values![]).await?;
    let Some(job) = job else { return Ok(None) };
    let beat = tx.one("SELECT MAX(heartbeat_at) AS at FROM workers", values![]).await?;
    Ok(beat.optional_time("at")?.max(Some(job.time("at")?)))
}

async fn record(seen: &Observation, options: &StoreOptions, tx: &mut Tx<'_>) -> Result<Done<UpkeepRound>, SqlError> {
    lock_state(tx).await?;
    let before = state(tx).await?;
    let (now, read_at) = (tx.now().await?, options.clock.elapsed(&seen.watch));
    let mut state = UpkeepState { seen_at: now, mismatch: seen.mismatch.clone(), jumps: Jumps::default() };
    let mut jump = None;
    if !seen.trust
        && let Some(last) = last_seen(before.as_ref(), tx).await?
    {
        let before = before.unwrap_or(UpkeepState { seen_at: last, mismatch: None, jumps: Jumps::default() });
        state.jumps = before.jumps;
        state.mismatch = state.mismatch.or(before.mismatch);
        let elapsed = seen.read_at.map_or(Duration::ZERO, |last| read_at.saturating_sub(last));
        jump = state.jumps.note(last, now, elapsed, seen.tolerance);
    }
    tx.execute("UPDATE upkeep_state SET state = $1 WHERE id = 1", values![json(&state)]).await?;
    spent::forget_old(tx).await?;
    Ok(Done::quiet(UpkeepRound { state, jump, read_at }))
}

/// Frees the locks of all upkeep tasks, for a store that no other process has open.
pub(super) async fn free_all(tx: &mut Tx<'_>) -> Result<Done<()>, SqlError> {
    tx.execute("DELETE FROM upkeep", values![]).await?;
    Ok(Done::quiet(()))
}
