-- Fewer pages for each submission: specs may be compressed, the index of idempotency keys has no
-- entries of jobs without a key, and indexes that no query reads are gone. Only a new table can
-- have other types and constraints.
-- The migration runs without foreign keys, so DROP TABLE deletes no rows that refer to jobs.

-- It names the table of jobs, which does not exist for a moment.
DROP TRIGGER kept_bytes_grow;

CREATE TABLE rebuilt (
    id                TEXT    NOT NULL PRIMARY KEY,
    kind              TEXT    NOT NULL DEFAULT 'model',
    status            TEXT    NOT NULL CHECK (status IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    version           INTEGER NOT NULL DEFAULT 1,
    preset            TEXT    NOT NULL,
    seed              INTEGER NOT NULL,
    digest            TEXT    NOT NULL,
    -- The engine version that the digest is of, and the one that made the files.
    engine            TEXT    NOT NULL DEFAULT '0.1.0',
    engine_used       TEXT,
    outputs           TEXT    NOT NULL,
    backend_requested TEXT    NOT NULL,
    backend_used      TEXT,
    device            TEXT,
    fallback          TEXT,
    -- The owner; empty if there is none.
    submitter         TEXT    NOT NULL DEFAULT '',
    -- Place in the queue; see sql/order.rs.
    lane              TEXT    NOT NULL
        GENERATED ALWAYS AS (CASE WHEN kind = 'fit' THEN 'fit' ELSE backend_requested END) VIRTUAL,
    rank              INTEGER NOT NULL DEFAULT 0,
    turn              INTEGER NOT NULL DEFAULT 0,
    available_at      INTEGER NOT NULL,
    -- Number of jobs as which a job counts against the quota of its owner.
    weight            INTEGER NOT NULL DEFAULT 1,
    -- True for a model that a CPU worker may run beside a longer one.
    short             INTEGER NOT NULL DEFAULT 0,
    -- True for a job that waits for the growth of an equal job; see sql/share.rs.
    shares            INTEGER NOT NULL DEFAULT 0,
    -- Which jobs a GPU may run together: those of the same key. Null: alone.
    batch_key         TEXT,
    batch             TEXT    REFERENCES batches (id),
    -- Position of the job in the request for its batch.
    batch_index       INTEGER,
    -- The failed job that a job repeats.
    retry_of          TEXT,
    reused_from       TEXT,
    -- Number of the last attempt: the fence of every write of a worker.
    attempts          INTEGER NOT NULL DEFAULT 0,
    -- Attempts that count against the limit: all but those that were given back in peace.
    spent             INTEGER NOT NULL DEFAULT 0,
    cancel_requested  INTEGER NOT NULL DEFAULT 0,
    holder            TEXT,
    lease_until       INTEGER,
    created_at        INTEGER NOT NULL,
    started_at        INTEGER,
    finished_at       INTEGER,
    idempotency_key   TEXT,
    idempotency_body  TEXT,
    -- The trace that the attempts of a job belong to, as W3C traceparent.
    trace             TEXT,
    -- Artifact key of the newest checkpoint of a job that has not ended.
    checkpoint        TEXT,
    summary           TEXT,
    problem           TEXT,
    progress          TEXT,
    section           TEXT,
    -- JSON, or its compressed form; see sqlite/packed.rs.
    spec              BLOB    NOT NULL,
    CHECK ((status = 'running') = (holder IS NOT NULL)),
    CHECK ((status = 'running') = (lease_until IS NOT NULL))
) STRICT;
INSERT INTO rebuilt (id, kind, status, version, preset, seed, digest, engine, engine_used, outputs, backend_requested,
    backend_used, device, fallback, submitter, rank, turn, available_at, weight, short, shares, batch_key, batch,
    batch_index, retry_of, reused_from, attempts, spent, cancel_requested, holder, lease_until, created_at, started_at,
    finished_at, idempotency_key, idempotency_body, trace, checkpoint, summary, problem, progress, section, spec)
SELECT id, kind, status, version, preset, seed, digest, engine, engine_used, outputs, backend_requested,
    backend_used, device, fallback, submitter, rank, turn, available_at, weight, short, shares, batch_key, batch,
    batch_index, retry_of, reused_from, attempts, spent, cancel_requested, holder, lease_until, created_at, started_at,
    finished_at, idempotency_key, idempotency_body, trace, checkpoint, summary, problem, progress, section,
    CAST(spec AS BLOB)
FROM jobs ORDER BY id;
DROP TABLE jobs;
ALTER TABLE rebuilt RENAME TO jobs;

CREATE UNIQUE INDEX jobs_by_idempotency_key ON jobs (idempotency_key) WHERE idempotency_key IS NOT NULL;
CREATE INDEX jobs_by_status ON jobs (status, id);
CREATE INDEX jobs_by_preset ON jobs (preset, id);
CREATE INDEX jobs_by_batch ON jobs (batch, id, status) WHERE batch IS NOT NULL;
CREATE INDEX jobs_by_checkpoint ON jobs (checkpoint) WHERE checkpoint IS NOT NULL;
CREATE INDEX jobs_by_digest ON jobs (digest, id) WHERE status = 'succeeded' AND engine_used = engine;
CREATE INDEX jobs_by_end ON jobs (finished_at, id) WHERE finished_at IS NOT NULL;
CREATE INDEX jobs_by_submitter ON jobs (submitter, id) WHERE submitter <> '';
CREATE INDEX jobs_by_submitter_and_status ON jobs (submitter, status, id) WHERE submitter <> '';
-- The queue: by lane, by submitter in a lane, by batch key, and models that are short.
CREATE INDEX jobs_lanes ON jobs (lane, rank, turn, id, available_at) WHERE status = 'queued' AND NOT shares;
CREATE INDEX jobs_queue_by_submitter ON jobs (lane, rank, submitter, turn) WHERE status = 'queued' AND NOT shares;
CREATE INDEX jobs_claimable_by_batch_key ON jobs (batch_key, rank, turn, id, available_at)
WHERE status = 'queued' AND NOT shares AND batch_key IS NOT NULL;
CREATE INDEX jobs_short ON jobs (lane, rank, turn, id, available_at) WHERE status = 'queued' AND NOT shares AND short;
CREATE INDEX jobs_running ON jobs (lane, rank, turn) WHERE status = 'running';
CREATE INDEX jobs_leases ON jobs (lease_until) WHERE status = 'running';
-- The jobs that others may wait for, and those that wait.
CREATE INDEX jobs_in_flight ON jobs (digest, id) WHERE finished_at IS NULL AND NOT shares;
CREATE INDEX jobs_sharing ON jobs (digest, rank, id) WHERE finished_at IS NULL AND shares;
CREATE INDEX jobs_fits ON jobs (id) WHERE kind = 'fit';
CREATE INDEX jobs_unfinished_fits ON jobs (submitter, weight) WHERE kind = 'fit' AND finished_at IS NULL;

-- The last line of defence of the main invariant; the state machine never gets here.
CREATE TRIGGER ended_jobs_never_change BEFORE UPDATE ON jobs
WHEN OLD.status IN ('succeeded', 'failed', 'cancelled')
BEGIN
    SELECT RAISE(ABORT, 'an ended job never changes');
END;

CREATE TRIGGER jobs_come_ended AFTER INSERT ON jobs WHEN NEW.status IN ('succeeded', 'failed', 'cancelled')
BEGIN
    UPDATE ended_jobs SET jobs = jobs + 1 WHERE status = NEW.status;
END;
CREATE TRIGGER jobs_end AFTER UPDATE OF status ON jobs WHEN NEW.status IN ('succeeded', 'failed', 'cancelled')
BEGIN
    UPDATE ended_jobs SET jobs = jobs + 1 WHERE status = NEW.status;
END;
CREATE TRIGGER ended_jobs_go AFTER DELETE ON jobs WHEN OLD.status IN ('succeeded', 'failed', 'cancelled')
BEGIN
    UPDATE ended_jobs SET jobs = jobs - 1 WHERE status = OLD.status;
END;

CREATE TRIGGER queue_grows AFTER INSERT ON jobs WHEN NEW.status = 'queued'
BEGIN
    INSERT INTO queue_length (backend, jobs) VALUES (NEW.backend_requested, 1)
    ON CONFLICT (backend) DO UPDATE SET jobs = jobs + 1;
END;
CREATE TRIGGER queue_shrinks AFTER DELETE ON jobs WHEN OLD.status = 'queued'
BEGIN
    UPDATE queue_length SET jobs = jobs - 1 WHERE backend = OLD.backend_requested;
END;
CREATE TRIGGER queue_changes AFTER UPDATE OF status ON jobs WHEN (OLD.status = 'queued') <> (NEW.status = 'queued')
BEGIN
    INSERT INTO queue_length (backend, jobs)
    VALUES (NEW.backend_requested, (NEW.status = 'queued') - (OLD.status = 'queued'))
    ON CONFLICT (backend) DO UPDATE SET jobs = jobs + excluded.jobs;
END;

CREATE TRIGGER kept_bytes_grow AFTER INSERT ON files
BEGIN
    INSERT INTO kept_bytes (submitter, bytes)
    SELECT submitter, NEW.bytes FROM jobs WHERE id = NEW.job_id AND submitter <> ''
    ON CONFLICT (submitter) DO UPDATE SET bytes = bytes + excluded.bytes;
END;
-- Before, while its files are still there.
CREATE TRIGGER kept_bytes_shrink BEFORE DELETE ON jobs WHEN OLD.submitter <> ''
BEGIN
    UPDATE kept_bytes SET bytes = bytes - (SELECT COALESCE(SUM(bytes), 0) FROM files WHERE job_id = OLD.id)
    WHERE submitter = OLD.submitter;
END;
