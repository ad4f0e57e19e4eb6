//! Submission of jobs and reuse of finished models.

use super::codec::{Value, enum_to_sql, json, values};
use super::error::SqlError;
use super::operation::{Done, Grouped, Operation, Results, or_refusal};
use super::order::{self, rank};
use super::place::{FarPlace, Place};
use super::quota;
use super::read::{self, known_job};
use super::record::{outputs_to_sql, submitter};
use super::share;
use super::spent;
use super::store::Store;
use super::tx::{Row, Tx};
use crate::jobs::job::IdGenerator;
use crate::jobs::state::{self, ClaimScope, Lane};
use crate::jobs::{
    BackendReport, BatchId, Change, File, Job, JobId, NewJob, Quota, Status, StoreError, StoreOptions, Submitted,
};
use crate::lock::Mutex;
use jiff::Timestamp;
use serde_json::json as object;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Calls that create single jobs.
impl Store {
    /// Queues a job, reuses a finished model, or returns the job of an earlier request with the
    /// same idempotency key.
    pub async fn submit(&self, new: NewJob) -> Result<Submitted, StoreError> {
        Ok(self.change("submit", self.submission(new, true)).await?.expect("files may be reused"))
    }

    /// The same as [`Store::submit`] unless a finished model would be reused. Then nothing is
    /// queued and the result is `None`: the caller checks the files of that model first.
    pub async fn submit_new(&self, new: NewJob) -> Result<Option<Submitted>, StoreError> {
        self.change("submit", self.submission(new, false)).await
    }

    fn submission(&self, new: NewJob, may_reuse: bool) -> Submit {
        Submit {
            new,
            may_reuse,
            ids: self.id_generator(),
            tried: Mutex::default(),
            is_unknown: AtomicBool::new(false),
            far: self.far_place(),
        }
    }

    /// The job that its owner created with this idempotency key and body; see
    /// [`NewJob::idempotency`].
    pub async fn replayed(&self, owner: Option<&str>, key: &str, body: &str) -> Result<Option<Job>, StoreError> {
        let tx = &mut self.read("replayed").await?;
        let sql = "SELECT id FROM jobs WHERE idempotency_key = $1 AND idempotency_body = $2";
        let Some(row) = tx.optional(sql, values![scoped(owner, key), body]).await? else { return Ok(None) };
        Ok(read::job(tx, JobId(row.id("id")?)).await?)
    }

    /// The finished model of the same owner that [`Store::submit`] would reuse for `new`.
    pub async fn reusable(&self, new: &NewJob) -> Result<Option<Job>, StoreError> {
        Ok(reusable(&mut self.read("reusable").await?, new).await?)
    }
}

/// Queues a job, or finds the job of an earlier request with the same idempotency key.
struct Submit {
    new: NewJob,
    /// True if the files of finished models have been checked.
    may_reuse: bool,
    ids: Arc<IdGenerator>,
    /// Id and time of the first run, which retries use too.
    tried: Mutex<Option<(JobId, Timestamp)>>,
    /// True once the outcome of a run is unknown.
    is_unknown: AtomicBool,
    far: Arc<FarPlace>,
}

impl Operation for Submit {
    /// `None` if a finished model would be reused and may not be.
    type Output = Option<Submitted>;

    const GROUPED: Grouped = Grouped::Submissions;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Option<Submitted>>, SqlError> {
        match self.tried().filter(|_| self.is_unknown.load(Ordering::Relaxed)) {
            Some((id, created_at)) => self.queue_again(tx, options, id, created_at).await,
            None => self.queue(tx, options).await,
        }
    }

    async fn run_together(
        submissions: &[Arc<Self>],
        tx: &mut Tx<'_>,
        options: &StoreOptions,
    ) -> Result<Results<Option<Submitted>>, SqlError> {
        let mut results = Vec::with_capacity(submissions.len());
        for submission in submissions {
            let is_plain = tx.is_postgres() && submission.is_plain();
            let job = if is_plain { submission.place_plain(tx, options, submissions.len() == 1).await? } else { None };
            results.push(match job {
                Some(job) => Ok(Self::done(job)),
                None => or_refusal(submission.queue(tx, options).await)?,
            });
        }
        Ok(results)
    }

    async fn was_committed(&self, tx: &mut Tx<'_>, done: &Done<Option<Submitted>>) -> Result<bool, SqlError> {
        self.is_unknown.store(true, Ordering::Relaxed);
        let Some((id, _)) = self.tried() else { return Ok(false) };
        Ok(match &done.output {
            Some(Submitted::Replayed(_)) => spent::is_spent(tx, id.0).await?,
            Some(_) => read::job(tx, id).await?.is_some() || spent::is_spent(tx, id.0).await?,
            None => false,
        })
    }
}

impl Submit {
    fn tried(&self) -> Option<(JobId, Timestamp)> {
        *self.tried.lock()
    }

    /// Queues the job.
    async fn queue(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Option<Submitted>>, SqlError> {
        let new = &self.new;
        quota::lock_owner(tx, new.owner.as_deref(), new.quota).await?;
        share::lock_digest(tx, new).await?;
        let found = look(tx, new).await?;
        if let (Some((id, known)), Some((_, body))) = (&found.same_key, &new.idempotency) {
            if known != body {
                return Err(StoreError::IdempotencyConflict.into());
            }
            return Ok(Done::quiet(Some(Submitted::Replayed(known_job(tx, *id).await?))));
        }
        if !self.may_reuse && found.has_equal && reusable(tx, new).await?.is_some() {
            return Ok(Done::quiet(None));
        }
        let (id, created_at) = self.identity(tx.now().await?);
        tx.use_time(created_at);
        quota::check(tx, new.owner.as_deref(), new.quota, new.weight.into()).await?;
        let batch = batch_of(tx, new.retry_of).await?;
        let mut room = options.queue_limit.saturating_sub(found.queued);
        Ok(Self::done(place(tx, options, id, new, batch, &found, &mut room).await?))
    }

    /// Queues the job with the id and time of an earlier run whose outcome is unknown: it may have
    /// taken effect, or may do so at any time.
    async fn queue_again(
        &self,
        tx: &mut Tx<'_>,
        options: &StoreOptions,
        id: JobId,
        created_at: Timestamp,
    ) -> Result<Done<Option<Submitted>>, SqlError> {
        if let Some(job) = read::job(tx, id).await? {
            return Ok(Self::done(job));
        }
        if spent::is_spent(tx, id.0).await? {
            // The job was deleted.
            let job = new_job(id, &self.new, created_at, None, false, None);
            return Ok(Done::quiet(Some(Submitted::Queued(job))));
        }
        match self.queue(tx, options).await {
            Ok(done) => {
                match &done.output {
                    // The other job has the idempotency key until the id is spent.
                    Some(Submitted::Replayed(job)) if lock(tx, job.id).await? => spent::spend(tx, id.0, None).await?,
                    Some(Submitted::Queued(_) | Submitted::Reused(_)) => spent::refuse_spent(tx, id.0).await?,
                    Some(Submitted::Replayed(_)) | None => return Err(SqlError::Unknown),
                }
                Ok(done)
            }
            // The earlier run may have been accepted.
            Err(SqlError::Store(_)) => Err(SqlError::Unknown),
            Err(error) => Err(error),
        }
    }

    fn done(job: Job) -> Done<Option<Submitted>> {
        let change = Change::of(&job);
        let submitted = if job.reused_from.is_some() { Submitted::Reused(job) } else { Submitted::Queued(job) };
        Done::new(Some(submitted), vec![change])
    }

    /// Id and time of the job. Every retry uses the same ones: if an earlier run is still under way,
    /// the next one conflicts at the primary key.
    fn identity(&self, now: Timestamp) -> (JobId, Timestamp) {
        *self.tried.lock().get_or_insert_with(|| (JobId(self.ids.next(now)), now))
    }

    /// True if [`Submit::place_plain`] may queue the job.
    fn is_plain(&self) -> bool {
        self.new.quota == Quota::default() && self.new.retry_of.is_none()
    }

    /// Queues a job on PostgreSQL in one statement, the whole transaction if it is `alone`.
    /// `None` if the job needs [`Operation::run`].
    async fn place_plain(&self, tx: &mut Tx<'_>, options: &StoreOptions, alone: bool) -> Result<Option<Job>, SqlError> {
        const SUBMIT: &str = "SELECT * FROM submit_job($1::json, $2, $3::json, $4, $5, $6, $7, $8, $9)";
        let new = &self.new;
        let (id, created_at) = self.identity(tx.recently().await?);
        let job = new_job(id, new, created_at, None, false, None);
        let record = object!({
            "id": id, "preset": job.preset, "seed": seed(new)?, "digest": job.digest,
            "outputs": outputs_to_sql(&job.outputs), "backend_requested": new.backend,
            "created_at": created_at.as_microsecond(), "engine": job.engine,
            "submitter": submitter(new.owner.as_deref()), "rank": rank(new.priority), "trace": job.trace,
            "batch_key": batch_key(new), "short": short(new), "kind": new.kind, "weight": new.weight,
            "idempotency_key": new.idempotency.as_ref().map(|(key, _)| scoped(new.owner.as_deref(), key)),
            "idempotency_body": new.idempotency.as_ref().map(|(_, body)| body),
        });
        let lane = Lane::of(new.kind, new.backend);
        let (far, until) = self.far.get(lane).unzip();
        let values = values![
            record.to_string(),
            job.spec.text(),
            json(&new.labels),
            new.reuse,
            options.queue_limit,
            far.as_ref().map(|far| far.rank),
            far.as_ref().map(|far| far.turn),
            far.map(|far| far.id.to_string()),
            until,
        ];
        let rows = if alone { tx.all_alone(SUBMIT, values).await } else { tx.all(SUBMIT, values).await };
        if alone && rows.as_ref().is_err_and(|error| !error.is_refusal()) {
            self.is_unknown.store(true, Ordering::Relaxed);
        }
        let rows = rows?;
        let row = rows.first().ok_or(sqlx::Error::RowNotFound)?;
        let Some(turn) = row.get("its_turn")? else { return Ok(None) };
        tx.set_now(row.optional_time("now")?);
        let ahead: u64 = row.count("ahead")?;
        if let Some(changes) = row.get::<Option<i64>>("changes")? {
            self.far.note(Place { lane, rank: rank(new.priority), turn, id }, ahead, changes);
        }
        Ok(Some(Job { queue_position: Some(ahead.min(Job::MAX_QUEUE_POSITION)), ..job }))
    }
}

/// The batch of the job that a new one repeats, and its index there. The lock keeps the batch until
/// the transaction has added to it.
async fn batch_of(tx: &mut Tx<'_>, repeated: Option<JobId>) -> Result<Option<(BatchId, Option<u32>)>, SqlError> {
    let Some(id) = repeated else { return Ok(None) };
    let sql = format!(
        "SELECT b.id, j.batch_index FROM jobs j JOIN batches b ON b.id = j.batch WHERE j.id = $1{}",
        tx.either("", " FOR KEY SHARE OF b"),
    );
    let Some(row) = tx.optional(sql, values![id]).await? else { return Ok(None) };
    Ok(Some((BatchId(row.id("id")?), batch_index(&row)?)))
}

/// Index of a job in its batch; `None` if it has none, or if a version before studies wrote it.
pub(super) fn batch_index(row: &Row) -> Result<Option<u32>, SqlError> {
    Ok(row.get::<Option<i64>>("batch_index")?.and_then(|index| u32::try_from(index).ok()))
}

/// Stored form of an idempotency key, which contains the owner. Neither a key nor an owner contains
/// the separator.
pub(super) fn scoped(owner: Option<&str>, key: &str) -> String {
    owner.map_or_else(|| key.to_owned(), |owner| format!("{owner}\u{1f}{key}"))
}

/// State of the queue that a submission needs.
pub(super) struct Found {
    /// Number of queued jobs.
    pub(super) queued: u64,
    /// Job with the same idempotency key, and the hash of its request body.
    same_key: Option<(JobId, String)>,
    /// True if there is a job with the same digest, in flight or finished.
    has_equal: bool,
    /// Turn of the new job.
    turn: i64,
}

/// Reads all that a submission needs in one statement.
pub(super) async fn look(tx: &mut Tx<'_>, new: &NewJob) -> Result<Found, SqlError> {
    let sql = format!(
        "SELECT (SELECT CAST(COALESCE(SUM(jobs), 0) AS BIGINT) FROM queue_length) AS queued, {}, \
         (SELECT id FROM jobs WHERE idempotency_key = $4) AS same_key, \
         (SELECT idempotency_body FROM jobs WHERE idempotency_key = $4) AS same_body, \
         (SELECT id FROM jobs{} WHERE finished_at IS NULL AND NOT shares AND digest = $5 ORDER BY id LIMIT 1) \
         AS in_flight, \
         (SELECT id FROM jobs{} WHERE status = 'succeeded' AND engine_used = engine AND digest = $5 \
         ORDER BY id LIMIT 1) AS finished, {} AS now",
        order::TURN,
        tx.either(" INDEXED BY jobs_in_flight", ""),
        tx.either(" INDEXED BY jobs_by_digest", ""),
        tx.either("NULL", Tx::NOW),
    );
    let key = new.idempotency.as_ref().map(|(key, _)| scoped(new.owner.as_deref(), key));
    let lane = enum_to_sql(Lane::of(new.kind, new.backend));
    let values = values![lane, rank(new.priority), submitter(new.owner.as_deref()), key, &new.digest];
    let row = tx.one(sql, values).await?;
    tx.set_now(row.optional_time("now")?);
    let same_key = row.optional_id("same_key")?.map(JobId).zip(row.get("same_body")?);
    let is_equal = |column| Ok::<_, SqlError>(row.get::<Option<&str>>(column)?.is_some());
    Ok(Found {
        queued: row.count("queued")?,
        same_key,
        has_equal: is_equal("in_flight")? || is_equal("finished")?,
        turn: order::turn(&row)?,
    })
}

/// Queues a job if there is `room` for it, or reuses a finished model. `batch` is its batch and its
/// index there.
pub(super) async fn place(
    tx: &mut Tx<'_>,
    options: &StoreOptions,
    id: JobId,
    new: &NewJob,
    batch: Option<(BatchId, Option<u32>)>,
    found: &Found,
    room: &mut u64,
) -> Result<Job, SqlError> {
    // In this order, so that an equal job that ends between the two queries is found finished.
    let in_flight = found.has_equal && share::in_flight(tx, new).await?;
    let source = if found.has_equal { reusable(tx, new).await? } else { None };
    let shares = in_flight && source.is_none();
    if source.is_none() {
        *room = room.checked_sub(1).ok_or(StoreError::QueueFull { limit: options.queue_limit })?;
    }
    insert(tx, id, new, source.as_ref(), shares, found.turn, batch).await
}

/// The finished model of the same owner that `new` would reuse: the oldest that still exists. The
/// lock keeps its row until the transaction has named its files. Presets must be equal too: files
/// contain the name of the preset, but the digest does not.
async fn reusable(tx: &mut Tx<'_>, new: &NewJob) -> Result<Option<Job>, SqlError> {
    if !new.reuse {
        return Ok(None);
    }
    // One job of each kind is enough: thousands may share the same files.
    let sql = format!(
        "SELECT MIN(id) AS id FROM jobs{} WHERE status = 'succeeded' AND engine_used = engine AND digest = $1 \
         AND preset = $2 AND submitter = $4 AND NOT EXISTS (SELECT 1 FROM files f WHERE f.job_id = jobs.id AND f.key {}) \
         GROUP BY backend_used, outputs ORDER BY 1",
        tx.either(" INDEXED BY jobs_by_digest", ""),
        tx.either("IN (SELECT value FROM json_each($3))", "= ANY ($3)"),
    );
    let values = values![&new.digest, &new.preset, new.missing.clone(), submitter(new.owner.as_deref())];
    for row in tx.all(sql, values).await? {
        let id = JobId(row.id("id")?);
        if !lock(tx, id).await? {
            continue;
        }
        let job = known_job(tx, id).await?;
        let same = job.backend.used.is_some_and(|used| state::same_bytes(new.backend, used));
        if same && job.outputs.include(&new.outputs) {
            return Ok(Some(job));
        }
    }
    Ok(None)
}

/// Keeps a job from being deleted until the transaction ends; false if it does not exist.
async fn lock(tx: &mut Tx<'_>, id: JobId) -> Result<bool, SqlError> {
    let sql = format!("SELECT id FROM jobs WHERE id = $1{}", tx.either("", " FOR KEY SHARE"));
    Ok(tx.optional(sql, values![id]).await?.is_some())
}

/// The record of a new job. `source` is the finished model that it reuses.
fn new_job(id: JobId, new: &NewJob, now: Timestamp, source: Option<&Job>, shares: bool, batch: Option<BatchId>) -> Job {
    let backend = source.map(|job| &job.backend);
    Job {
        id,
        kind: new.kind,
        owner: new.owner.clone(),
        status: if source.is_some() { Status::Succeeded } else { Status::Queued },
        version: 1,
        preset: new.preset.clone(),
        seed: new.seed,
        spec: new.spec.clone(),
        outputs: new.outputs.clone(),
        labels: new.labels.clone(),
        priority: new.priority,
        trace: new.trace.clone(),
        backend: BackendReport {
            requested: new.backend,
            used: backend.and_then(|backend| backend.used),
            device: backend.and_then(|backend| backend.device.clone()),
            fallback: backend.and_then(|backend| backend.fallback.clone()),
        },
        queue_position: None,
        waits_for_equal: shares,
        progress: None,
        section: None,
        attempts: 0,
        worker: None,
        cancel_requested: false,
        created_at: now,
        started_at: None,
        finished_at: source.map(|_| now),
        files: source.map(|job| reused_files(job, new)).unwrap_or_default(),
        summary: source.and_then(|job| job.summary.clone()),
        problem: None,
        digest: new.digest.clone(),
        engine: new.engine.clone(),
        batch,
        checkpoint: None,
        reused_from: source.map(|job| job.id),
        retry_of: new.retry_of,
    }
}

/// Stored form of the seed.
fn seed(new: &NewJob) -> Result<i64, SqlError> {
    let error = |_| StoreError::Database(format!("seed {} is beyond the range of records", new.seed).into());
    Ok(i64::try_from(new.seed).map_err(error)?)
}

/// The batch key of a job that a GPU may simulate.
fn batch_key(new: &NewJob) -> Option<String> {
    new.batch_key.clone().filter(|_| ClaimScope::Gpu.lanes().contains(&Lane::of(new.kind, new.backend)))
}

/// True if a CPU worker may run the job beside a longer one.
fn short(new: &NewJob) -> bool {
    new.short && ClaimScope::CpuShort.lanes().contains(&Lane::of(new.kind, new.backend))
}

async fn insert(
    tx: &mut Tx<'_>,
    id: JobId,
    new: &NewJob,
    source: Option<&Job>,
    shares: bool,
    turn: i64,
    batch: Option<(BatchId, Option<u32>)>,
) -> Result<Job, SqlError> {
    let now = tx.now().await?;
    let turn = if source.is_some() { 0 } else { turn };
    let mut job = new_job(id, new, now, source, shares, batch.map(|(batch, _)| batch));
    let place = Place { lane: Lane::of(new.kind, new.backend), rank: rank(new.priority), turn, id };
    // The jobs of a batch are counted when the batch is read.
    let is_counted = batch.is_none() && source.is_none();
    let is_far = is_counted && tx.is_far(&place);
    let sql = format!(
        "INSERT INTO jobs (id, status, preset, seed, digest, outputs, backend_requested, backend_used, device, \
         fallback, available_at, created_at, finished_at, reused_from, idempotency_key, idempotency_body, summary, \
         spec, engine, engine_used, batch, submitter, turn, rank, trace, batch_key, batch_index, retry_of, shares, \
         kind, weight, short) \
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, 0, $11, $12, $13, $14, $15, $16, $17, $18, $19, $20, $21, \
         $22, $23, $24, $25, $26, $27, $28, $29, $30, $31) RETURNING ({}) AS ahead",
        if is_counted && !is_far { order::ahead(tx) } else { "CAST(0 AS BIGINT)" },
    );
    let row = tx
        .one(
            sql,
            values![
                id,
                job.status.name(),
                &job.preset,
                seed(new)?,
                &job.digest,
                outputs_to_sql(&job.outputs),
                enum_to_sql(new.backend),
                job.backend.used.map(enum_to_sql),
                job.backend.device.clone(),
                job.backend.fallback.clone(),
                now,
                job.finished_at,
                job.reused_from.map(|id| id.to_string()),
                new.idempotency.as_ref().map(|(key, _)| scoped(new.owner.as_deref(), key)),
                new.idempotency.as_ref().map(|(_, body)| body.clone()),
                job.summary.as_ref().map(json),
                tx.spec(job.spec.text()),
                &job.engine,
                source.map(|job| job.engine.clone()),
                job.batch.map(|batch| batch.to_string()),
                submitter(new.owner.as_deref()),
                turn,
                rank(new.priority),
                job.trace.clone(),
                batch_key(new),
                batch.and_then(|(_, index)| index),
                new.retry_of.map(|id| id.to_string()),
                shares,
                enum_to_sql(new.kind),
                new.weight,
                short(new),
            ],
        )
        .await?;
    if source.is_none() {
        let ahead = if is_far { Job::MAX_QUEUE_POSITION } else { row.count("ahead")? };
        job.queue_position = Some(ahead);
        // Jobs that the transaction adds behind this one need no count.
        if is_counted && ahead >= Job::MAX_QUEUE_POSITION {
            tx.note_far(place);
        }
    }
    let labels = new.labels.iter().map(|(name, value)| values![id, name, value]);
    insert_rows(tx, "INSERT INTO labels (job_id, name, value) VALUES ", labels.collect()).await?;
    insert_files(tx, id, job.files.iter()).await?;
    Ok(job)
}

/// The files of a finished model that a new one wants.
fn reused_files(source: &Job, new: &NewJob) -> Vec<File> {
    source.files.iter().filter(|file| new.outputs.want(&file.name)).cloned().collect()
}

pub(super) async fn insert_files(
    tx: &mut Tx<'_>,
    id: JobId,
    files: impl Iterator<Item = &File>,
) -> Result<(), SqlError> {
    let row = |(ordinal, file): (u64, &File)| {
        values![id, ordinal, &file.name, &file.media_type, file.bytes, &file.sha256, &file.key, file.start]
    };
    let sql = "INSERT INTO files (job_id, ordinal, name, media_type, bytes, sha256, key, start) VALUES ";
    insert_rows(tx, sql, (0..).zip(files).map(row).collect()).await
}

/// Inserts rows in one statement.
async fn insert_rows(tx: &mut Tx<'_>, sql: &'static str, rows: Vec<Vec<Value>>) -> Result<(), SqlError> {
    if rows.is_empty() {
        return Ok(());
    }
    let mut n = 0;
    let mut place = |_: &Value| {
        n += 1;
        format!("${n}")
    };
    let mut places = |row: &Vec<Value>| format!("({})", row.iter().map(&mut place).collect::<Vec<_>>().join(", "));
    let places: Vec<String> = rows.iter().map(&mut places).collect();
    tx.execute(format!("{sql}{}", places.join(", ")), rows.into_iter().flatten().collect()).await?;
    Ok(())
}
