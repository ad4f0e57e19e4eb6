//! Operations on many jobs. The record of an operation has the position up to which it has changed
//! jobs. Each transaction changes some of the next ones and advances the position, so an operation
//! survives its process, and several processes may advance it.

use super::codec::{Value, enum_from_sql, enum_to_sql, json, parse, values};
use super::delete;
use super::error::SqlError;
use super::lease;
use super::operation::{Done, Run, Uncertain};
use super::read::matching;
use super::record::{owner, submitter};
use super::store::Store;
use super::tx::{Row, Tx};
use crate::jobs::job::IdGenerator;
use crate::jobs::{
    BulkAction, BulkOperation, BulkPage, BulkStep, JobId, ListFilter, NewBulk, OperationId, Quantity, Status,
    StoreError, StoreOptions,
};
use crate::lock::Mutex;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;

/// Number of jobs that a transaction changes.
const JOBS_PER_STEP: u32 = 100;
/// Number of searches for jobs to cancel in both unfinished statuses. A search misses a running job
/// that is queued again during the search.
const CANCEL_ROUNDS: u32 = 3;
/// Maximum number of unfinished operations of an owner.
const MAX_UNFINISHED: u64 = 100;
/// Time after its end at which an operation is deleted.
const KEPT_FOR: Duration = Duration::from_secs(7 * 24 * 3600);
/// Maximum number of jobs that are counted.
const MAX_COUNT: u64 = 1_000_000;

const COLUMNS: &str = "id, submitter, action, conditions, status, version, total, changed, created_at, finished_at";

/// Next jobs of an operation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Position {
    /// Number of completed searches in all statuses.
    round: u32,
    /// Index of the status in [`statuses`].
    pass: usize,
    /// Only jobs older than this one.
    before: Option<JobId>,
    /// Number of changed jobs at the start of the round.
    changed_before: u64,
}

/// Calls for operations on many jobs.
impl Store {
    /// The ids of the jobs of a page, newest first.
    pub async fn ids(&self, filter: &ListFilter) -> Result<Vec<JobId>, StoreError> {
        Ok(ids(&mut self.read("ids").await?, filter, filter.limit).await?)
    }

    /// Number of jobs that an operation would change; counts up to a million of each status.
    pub async fn count_affected(&self, action: BulkAction, filter: &ListFilter) -> Result<u64, StoreError> {
        let tx = &mut self.read("count_affected").await?;
        let mut jobs = 0;
        for status in statuses(action, filter.status) {
            jobs += count(tx, &ListFilter { status, ..filter.clone() }).await?;
        }
        Ok(jobs)
    }

    /// Accepts an operation on the jobs that match now. [`Store::step_operation`] executes it.
    pub async fn create_operation(&self, new: NewBulk) -> Result<BulkOperation, StoreError> {
        // Before the transaction, because counting may take long.
        let total = self.count_affected(new.action, &new.filter).await?;
        type Input = (NewBulk, u64, Arc<IdGenerator>, Mutex<Option<OperationId>>);
        const EXISTS: Uncertain<Input, BulkOperation> =
            Uncertain::Recognised(|_, done, tx| Box::pin(async { Ok(read(tx, done.output.id).await?.is_some()) }));
        let run: Run<Input, _> = |(new, total, ids, tried), tx, _| Box::pin(create(new, *total, ids, tried, tx));
        self.apply("create_operation", (new, total, self.id_generator(), Mutex::default()), run, EXISTS).await
    }

    /// An operation by id.
    pub async fn operation(&self, id: OperationId) -> Result<Option<BulkOperation>, StoreError> {
        Ok(read(&mut self.read("operation").await?, id).await?)
    }

    /// Operations of this owner, or of all, newest first.
    pub async fn operations(
        &self,
        owner: Option<&str>,
        before: Option<OperationId>,
        limit: u32,
    ) -> Result<BulkPage, StoreError> {
        let tx = &mut self.read("operations").await?;
        let sql = format!(
            "SELECT {COLUMNS} FROM bulk_operations WHERE ($1 OR submitter = $2) AND ($3 OR id < $4) \
             ORDER BY id DESC LIMIT {}",
            limit + 1
        );
        let before = before.map(|id| id.to_string());
        let values = values![owner.is_none(), submitter(owner), before.is_none(), before.unwrap_or_default()];
        let mut operations = tx.all(sql, values).await?.iter().map(to_operation).collect::<Result<Vec<_>, _>>()?;
        let has_more = operations.len() > limit as usize;
        operations.truncate(limit as usize);
        Ok(BulkPage { next: operations.last().filter(|_| has_more).map(|operation| operation.id), operations })
    }

    /// Changes the next jobs of an operation, or of one whose owner has waited longest. Returns
    /// `None` if there is none that has not ended.
    pub async fn step_operation(&self, id: Option<OperationId>) -> Result<Option<BulkStep>, StoreError> {
        type Input = (Option<OperationId>, String);
        // After the step of another process this one is not recognised, and the next step runs.
        // Files that it had to remove are then orphans.
        const IS_LAST: Uncertain<Input, Option<BulkStep>> = Uncertain::Recognised(|(_, token), done, tx| {
            Box::pin(async move {
                let Some(BulkStep { operation, .. }) = &done.output else { return Ok(false) };
                is_last_step(tx, operation.id, token).await
            })
        });
        let run: Run<Input, _> = |(id, token), tx, options| Box::pin(step(*id, token, tx, options));
        self.apply("step_operation", (id, uuid::Uuid::new_v4().to_string()), run, IS_LAST).await
    }

    /// Ends an operation. Jobs that it has changed stay so. `None` if it does not exist.
    pub async fn cancel_operation(&self, id: OperationId) -> Result<Option<BulkOperation>, StoreError> {
        let run: Run<_, _> = |id, tx, _| Box::pin(cancel(*id, tx));
        self.apply("cancel_operation", id, run, Uncertain::RunsAgain).await
    }
}

/// The statuses in which an operation looks for jobs, one after the other.
fn statuses(action: BulkAction, status: Option<Status>) -> Vec<Option<Status>> {
    match (action, status) {
        (BulkAction::Delete, status) => vec![status],
        (BulkAction::Cancel, None) => vec![Some(Status::Queued), Some(Status::Running)],
        (BulkAction::Cancel, Some(status)) if status.is_ended() => vec![],
        (BulkAction::Cancel, status) => vec![status],
    }
}

async fn count(tx: &mut Tx<'_>, filter: &ListFilter) -> Result<u64, SqlError> {
    let mut values: Vec<Value> = Vec::new();
    let matching = matching(tx, filter, &mut values);
    let sql = format!("SELECT COUNT(*) AS n FROM (SELECT 1 {matching} LIMIT {MAX_COUNT}) AS counted");
    tx.one(sql, values).await?.count("n")
}

async fn ids(tx: &mut Tx<'_>, filter: &ListFilter, limit: u32) -> Result<Vec<JobId>, SqlError> {
    let mut values: Vec<Value> = Vec::new();
    let matching = matching(tx, filter, &mut values);
    let rows = tx.all(format!("SELECT j.id AS id {matching} LIMIT {limit}"), values).await?;
    rows.iter().map(|row| Ok(JobId(row.id("id")?))).collect()
}

async fn create(
    new: &NewBulk,
    total: u64,
    generator: &IdGenerator,
    tried: &Mutex<Option<OperationId>>,
    tx: &mut Tx<'_>,
) -> Result<Done<BulkOperation>, SqlError> {
    let (now, owner) = (tx.now().await?, submitter(new.owner.as_deref()));
    let kept_from = now.checked_sub(KEPT_FOR).unwrap_or(now);
    tx.execute("DELETE FROM bulk_operations WHERE finished_at < $1", values![kept_from]).await?;
    let sql = "SELECT COUNT(*) AS n FROM bulk_operations WHERE finished_at IS NULL AND submitter = $1";
    let used = tx.one(sql, values![owner.clone()]).await?.count("n")?;
    if used >= MAX_UNFINISHED {
        let what = Quantity::Operations;
        return Err(StoreError::QuotaExceeded { what, used, more: 1, limit: MAX_UNFINISHED }.into());
    }
    // Jobs that are accepted later do not count.
    let newest = ids(tx, &ListFilter { before: None, ..new.filter.clone() }, 1).await?.pop();
    let before = newest.map(|JobId(id)| JobId(uuid::Uuid::from_u128(id.as_u128().saturating_add(1))));
    let filter = ListFilter { before, ..new.filter.clone() };
    // Retries use the same id.
    let id = *tried.lock().get_or_insert_with(|| OperationId(generator.next(now)));
    let sql = format!(
        "INSERT INTO bulk_operations (id, submitter, action, conditions, filter, position, status, total, created_at, \
         stepped_at) VALUES ($1, $2, $3, $4, $5, $6, 'queued', $7, $8, 0) RETURNING {COLUMNS}"
    );
    let values = values![
        id.to_string(),
        owner,
        enum_to_sql(new.action),
        json(&new.conditions),
        json(&filter),
        json(&Position::default()),
        total,
        now,
    ];
    Ok(Done::quiet(to_operation(&tx.one(sql, values).await?)?))
}

async fn read(tx: &mut Tx<'_>, id: OperationId) -> Result<Option<BulkOperation>, SqlError> {
    let sql = format!("SELECT {COLUMNS} FROM bulk_operations WHERE id = $1");
    tx.optional(sql, values![id.to_string()]).await?.as_ref().map(to_operation).transpose()
}

/// True if the last step of the operation has this token, after all transactions that have locked
/// it.
async fn is_last_step(tx: &mut Tx<'_>, id: OperationId, token: &str) -> Result<bool, SqlError> {
    let lock = tx.either("", " FOR UPDATE");
    let sql = format!("SELECT 1 AS found FROM bulk_operations WHERE id = $1 AND step = $2{lock}");
    Ok(tx.optional(sql, values![id.to_string(), token]).await?.is_some())
}

fn to_operation(row: &Row) -> Result<BulkOperation, SqlError> {
    Ok(BulkOperation {
        id: OperationId(row.id("id")?),
        owner: owner(row)?,
        action: enum_from_sql(row.get("action")?)?,
        conditions: parse(row.get("conditions")?)?,
        status: enum_from_sql(row.get("status")?)?,
        version: row.count("version")?,
        total: row.count("total")?,
        changed: row.count("changed")?,
        created_at: row.time("created_at")?,
        finished_at: row.optional_time("finished_at")?,
    })
}

/// The row of the operation to advance, locked. Without `id`, owners take turns, and so do the
/// operations of an owner; skips rows that another process advances.
async fn next(id: Option<OperationId>, tx: &mut Tx<'_>) -> Result<Option<Row>, SqlError> {
    let columns = format!("{COLUMNS}, filter, position");
    let Some(id) = id else {
        let sql = format!(
            "SELECT {columns} FROM bulk_operations AS b WHERE finished_at IS NULL ORDER BY \
             (SELECT MAX(stepped_at) FROM bulk_operations AS o \
             WHERE o.finished_at IS NULL AND o.submitter = b.submitter), stepped_at, id LIMIT 1{}",
            tx.either("", " FOR UPDATE SKIP LOCKED")
        );
        return tx.optional(sql, vec![]).await;
    };
    let lock = tx.either("", " FOR UPDATE");
    let sql = format!("SELECT {columns} FROM bulk_operations WHERE id = $1 AND finished_at IS NULL{lock}");
    tx.optional(sql, values![id.to_string()]).await
}

async fn step(
    id: Option<OperationId>,
    token: &str,
    tx: &mut Tx<'_>,
    options: &StoreOptions,
) -> Result<Done<Option<BulkStep>>, SqlError> {
    let Some(row) = next(id, tx).await? else { return Ok(Done::quiet(None)) };
    let operation = to_operation(&row)?;
    let now = tx.now().await?;
    // A later version may know conditions that this one must not ignore.
    let filter = serde_json::from_str::<ListFilter>(row.get("filter")?);
    let (Ok(filter), Ok(position)) = (filter, serde_json::from_str::<Position>(row.get("position")?)) else {
        let id = operation.id;
        tracing::error!(operation = %id, "this version cannot read the operation; a later one has to execute it");
        tx.execute("UPDATE bulk_operations SET stepped_at = $2 WHERE id = $1", values![operation.id.to_string(), now])
            .await?;
        return Ok(Done::quiet(Some(BulkStep { operation, keys: Vec::new() })));
    };
    let passes = statuses(operation.action, filter.status);
    let (mut keys, mut changes, mut changed) = (Vec::new(), Vec::new(), operation.changed);
    let mut next = Some(position.clone());
    if let (Some(status), Some(_)) = (passes.get(position.pass), filter.before) {
        let page = ListFilter { status: *status, before: position.before.or(filter.before), ..filter.clone() };
        let ids = ids(tx, &page, JOBS_PER_STEP).await?;
        // A job that has been queued again in the meantime is cancelled as well, unless the request
        // is for running jobs only.
        for done in change(operation.action, &ids, filter.status, token, tx, options).await? {
            changed += 1;
            keys.extend(done.output);
            changes.extend(done.changes);
        }
        next = match ids.last() {
            Some(&last) if ids.len() == JOBS_PER_STEP as usize => Some(Position { before: Some(last), ..position }),
            _ => following(&position, passes.len(), changed),
        };
    } else {
        next = next.filter(|_| false);
    }
    let status = if next.is_some() { Status::Running } else { Status::Succeeded };
    let sql = format!(
        "UPDATE bulk_operations SET status = $2, position = $3, changed = $4, stepped_at = $5, finished_at = $6, \
         step = $7, version = version + 1 WHERE id = $1 RETURNING {COLUMNS}"
    );
    let values = values![
        operation.id.to_string(),
        status.name(),
        json(&next.unwrap_or_default()),
        changed,
        now,
        status.is_ended().then_some(now),
        token,
    ];
    let operation = to_operation(&tx.one(sql, values).await?)?;
    Ok(Done::new(Some(BulkStep { operation, keys }), changes))
}

/// The position after the last job of a pass; `None` at the end of the operation.
fn following(position: &Position, passes: usize, changed: u64) -> Option<Position> {
    if position.pass + 1 < passes {
        return Some(Position { pass: position.pass + 1, before: None, ..*position });
    }
    let round = position.round + 1;
    let is_last = passes < 2 || round == CANCEL_ROUNDS || changed == position.changed_before;
    (!is_last).then_some(Position { round, pass: 0, before: None, changed_before: changed })
}

/// Changes those of the jobs that still have the `status`. `deletion` is the random identity of the
/// step. Returns what [`delete::job`] returns for each job that has changed.
async fn change(
    action: BulkAction,
    ids: &[JobId],
    status: Option<Status>,
    deletion: &str,
    tx: &mut Tx<'_>,
    options: &StoreOptions,
) -> Result<Vec<Done<Vec<String>>>, SqlError> {
    // In the order in which transactions lock them.
    let mut ids = ids.to_vec();
    ids.sort_unstable();
    let mut changed = Vec::new();
    for id in ids {
        let done = match action {
            BulkAction::Cancel => lease::cancel(tx, options, id, status).await?,
            BulkAction::Delete => delete::job(tx, id, status, deletion).await?,
        };
        changed.extend(done);
    }
    Ok(changed)
}

async fn cancel(id: OperationId, tx: &mut Tx<'_>) -> Result<Done<Option<BulkOperation>>, SqlError> {
    let now = tx.now().await?;
    let sql = "UPDATE bulk_operations SET status = 'cancelled', finished_at = $2, version = version + 1 \
               WHERE id = $1 AND finished_at IS NULL";
    tx.execute(sql, values![id.to_string(), now]).await?;
    Ok(Done::quiet(read(tx, id).await?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cancellation_searches_until_a_round_changes_nothing() {
        let passes = statuses(BulkAction::Cancel, None).len();
        let (mut position, mut rounds) = (Position::default(), Vec::new());
        for changed in [5, 5, 6, 6, 6, 6] {
            rounds.push((position.round, position.pass));
            match following(&position, passes, changed) {
                Some(next) => position = next,
                None => break,
            }
        }
        assert_eq!(rounds, [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)]);
        assert_eq!(following(&Position { pass: 1, changed_before: 7, ..Position::default() }, 2, 7), None);
        assert_eq!(following(&Position::default(), 1, 100), None, "a deletion searches once");
    }
}
