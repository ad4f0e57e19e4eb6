//! Upkeep: which process may sweep, and which keys of the artifact store are in use.

use super::codec::{until, values};
use super::error::SqlError;
use super::operation::{Done, Operation};
use super::tx::Tx;
use crate::jobs::store::{StoreOptions, UpkeepTask};
use std::collections::BTreeSet;
use std::time::Duration;

/// Takes or renews the lock of an upkeep task. Gives whether `owner` has it.
#[derive(Debug)]
pub(super) struct AcquireUpkeep {
    pub(super) task: UpkeepTask,
    pub(super) owner: String,
    pub(super) lease: Duration,
}

impl Operation for AcquireUpkeep {
    type Output = bool;

    async fn run(&self, tx: &mut Tx<'_>, _: &StoreOptions) -> Result<Done<bool>, SqlError> {
        let now = tx.steady().await?;
        let taken = tx
            .execute(
                "INSERT INTO upkeep (task, owner, held_until) VALUES ($1, $2, $3) \
                 ON CONFLICT (task) DO UPDATE SET owner = $2, held_until = $3 \
                 WHERE upkeep.owner = $2 OR upkeep.held_until <= $4",
                values![self.task.name(), &self.owner, until(now, self.lease), now],
            )
            .await?;
        Ok(Done::quiet(taken > 0))
    }
}

/// Frees the locks of all upkeep tasks: no other process has the store open.
#[derive(Debug)]
pub(in crate::jobs) struct FreeUpkeep;

impl Operation for FreeUpkeep {
    type Output = ();

    async fn run(&self, tx: &mut Tx<'_>, _: &StoreOptions) -> Result<Done<()>, SqlError> {
        tx.execute("DELETE FROM upkeep", values![]).await?;
        Ok(Done::quiet(()))
    }
}

/// Those of `keys` that a record names or that belong to a running attempt, of one moment.
pub(super) async fn keys_in_use(tx: &mut Tx<'_>, keys: &[String]) -> Result<BTreeSet<String>, SqlError> {
    let any = tx.either("IN (SELECT value FROM json_each($1))", "= ANY ($1)");
    // A running attempt gives the prefix of its keys, which no key is equal to.
    let sql = format!(
        "SELECT key FROM files WHERE key {any} UNION SELECT checkpoint FROM jobs WHERE checkpoint {any} \
         UNION SELECT 'models/' || id || '/' || attempts || '/' FROM jobs WHERE status = 'running'"
    );
    let rows = tx.all(sql, values![keys.to_vec()]).await?;
    let used = rows.iter().map(|row| row.text("key")).collect::<Result<BTreeSet<_>, _>>()?;
    let prefix = |key: &str| key.match_indices('/').nth(2).map(|(at, slash)| key[..at + slash.len()].to_owned());
    let is_used = |key: &&String| used.contains(key.as_str()) || prefix(key).is_some_and(|p| used.contains(p.as_str()));
    Ok(keys.iter().filter(is_used).cloned().collect())
}
