//! Pauses: of all workers, and of single ones. A row of `claiming` is a pause; claims look for one as part of their own
//! statements, so that a pause costs them nothing and holds as soon as it is committed.

use super::codec::values;
use super::error::SqlError;
use super::operation::{Done, Operation};
use super::tx::Tx;
use super::workers::{ALL, is_listed, to_pause};
use crate::jobs::operators::{Instruction, Pause};
use crate::jobs::store::StoreOptions;

/// A condition of SQL: neither all workers nor the one named by this parameter are paused.
pub(super) fn unpaused(worker: &str) -> String {
    format!("(SELECT scope FROM claiming WHERE scope IN ('{ALL}', {worker}) LIMIT 1) IS NULL")
}

/// Pauses, drains or resumes; `worker` is `None` for all workers. Gives whether there is such a worker.
#[derive(Debug)]
pub(super) struct Instruct {
    pub(super) worker: Option<String>,
    pub(super) instruction: Instruction,
    pub(super) by: Option<String>,
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

/// The pause of all workers.
pub(super) async fn paused(tx: &mut Tx<'_>) -> Result<Option<Pause>, SqlError> {
    let row = tx.optional("SELECT drain, since, set_by FROM claiming WHERE scope = $1", values![ALL]).await?;
    Ok(row.as_ref().map(to_pause).transpose()?.flatten())
}
