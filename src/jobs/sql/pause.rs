//! Pauses of all workers and of single ones. A row of `claiming` is a pause. Claims look for one in
//! their own statements, so a pause costs them nothing and holds once it is committed.

use super::codec::values;
use super::error::SqlError;
use super::operation::{Done, Operation};
use super::store::Store;
use super::tx::Tx;
use super::workers::{ALL, is_listed, to_pause};
use crate::jobs::{Instruction, Pause, StoreError, StoreOptions};

/// Calls for pauses.
impl Store {
    /// Pauses all workers, including workers that start later, or ends this pause; pauses of single
    /// workers stay. A pause holds for every claim that begins after this call returns. `by` is the
    /// person who requests it. No effect if the state is already the requested one.
    pub async fn set_paused(&self, paused: bool, by: Option<&str>) -> Result<(), StoreError> {
        let instruction = if paused { Instruction::Pause } else { Instruction::Resume };
        let instruct = Instruct { worker: None, instruction, by: by.map(str::to_owned) };
        self.change("set_paused", instruct).await.map(drop)
    }

    /// The pause of all workers, if there is one.
    pub async fn paused(&self) -> Result<Option<Pause>, StoreError> {
        let tx = &mut self.read("paused").await?;
        let row = tx.optional("SELECT drain, since, set_by FROM claiming WHERE scope = $1", values![ALL]).await?;
        Ok(row.as_ref().map(to_pause).transpose()?.flatten())
    }

    /// Pauses, drains or resumes one worker, as [`Store::set_paused`] does all. A pause holds for
    /// the worker of this name until it is resumed, even after a restart under the same name.
    /// Returns false, and does nothing, if [`Store::workers`] does not list the worker.
    pub async fn instruct(&self, worker: &str, instruction: Instruction, by: Option<&str>) -> Result<bool, StoreError> {
        let instruct = Instruct { worker: Some(worker.to_owned()), instruction, by: by.map(str::to_owned) };
        self.change("instruct", instruct).await
    }
}

/// SQL condition: neither all workers nor the worker named by this parameter are paused.
pub(super) fn unpaused(worker: &str) -> String {
    format!("(SELECT scope FROM claiming WHERE scope IN ('{ALL}', {worker}) LIMIT 1) IS NULL")
}

/// Pauses, drains or resumes. Returns false if the worker is not listed.
struct Instruct {
    /// `None` for all workers.
    worker: Option<String>,
    instruction: Instruction,
    by: Option<String>,
}

impl Operation for Instruct {
    type Output = bool;

    async fn run(&self, tx: &mut Tx<'_>, _: &StoreOptions) -> Result<Done<bool>, SqlError> {
        if let Some(worker) = &self.worker
            && !is_listed(tx, worker).await?
        {
            return Ok(Done::quiet(false));
        }
        let scope = self.worker.as_deref().unwrap_or(ALL);
        if self.instruction == Instruction::Resume {
            tx.execute("DELETE FROM claiming WHERE scope = $1", values![scope]).await?;
        } else {
            let (drain, now) = (self.instruction == Instruction::Drain, tx.now().await?);
            tx.execute(
                "INSERT INTO claiming (scope, drain, since, set_by) VALUES ($1, $2, $3, $4) \
                 ON CONFLICT (scope) DO UPDATE SET drain = $2, since = $3, set_by = $4 WHERE claiming.drain <> $2",
                values![scope, drain, now, &self.by],
            )
            .await?;
        }
        Ok(Done::quiet(true))
    }
}
