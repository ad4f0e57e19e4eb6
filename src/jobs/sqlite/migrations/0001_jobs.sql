-- Records of jobs. Times are microseconds since 1970 UTC; ids are hyphenated UUIDv7, so they sort by age.
CREATE TABLE jobs (
    id                TEXT    NOT NULL PRIMARY KEY,
    status            TEXT    NOT NULL CHECK (status IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    version           INTEGER NOT NULL DEFAULT 1,
    preset            TEXT    NOT NULL,
    seed              INTEGER NOT NULL,
    digest            TEXT    NOT NULL,
    outputs           TEXT    NOT NULL,
    backend_requested TEXT    NOT NULL,
    backend_used      TEXT,
    device            TEXT,
    fallback          TEXT,
    -- Number of the last attempt: the fence of every write of a worker.
    attempts          INTEGER NOT NULL DEFAULT 0,
    -- Attempts that count against the limit: all but those that were given back in peace.
    spent             INTEGER NOT NULL DEFAULT 0,
    cancel_requested  INTEGER NOT NULL DEFAULT 0,
    holder            TEXT,
    lease_until       INTEGER,
    available_at      INTEGER NOT NULL,
    created_at        INTEGER NOT NULL,
    started_at        INTEGER,
    finished_at       INTEGER,
    reused_from       TEXT,
    idempotency_key   TEXT UNIQUE,
    idempotency_body  TEXT,
    summary           TEXT,
    problem           TEXT,
    progress          TEXT,
    spec              TEXT    NOT NULL,
    section           TEXT,
    CHECK ((status = 'running') = (holder IS NOT NULL)),
    CHECK ((status = 'running') = (lease_until IS NOT NULL))
) STRICT;

-- Claims read the head of the queue of each backend; their cost does not depend on its length.
CREATE INDEX jobs_queue ON jobs (backend_requested, id, available_at) WHERE status = 'queued';
CREATE INDEX jobs_position ON jobs (id) WHERE status = 'queued';
CREATE INDEX jobs_leases ON jobs (lease_until) WHERE status = 'running';
CREATE INDEX jobs_by_digest ON jobs (digest, id) WHERE status = 'succeeded';
CREATE INDEX jobs_by_status ON jobs (status, id);
CREATE INDEX jobs_by_preset ON jobs (preset, id);

-- The last line of defence of the main invariant; the state machine never gets here.
CREATE TRIGGER ended_jobs_never_change BEFORE UPDATE ON jobs
WHEN OLD.status IN ('succeeded', 'failed', 'cancelled')
BEGIN
    SELECT RAISE(ABORT, 'an ended job never changes');
END;

CREATE TABLE labels (
    name   TEXT NOT NULL,
    value  TEXT NOT NULL,
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    PRIMARY KEY (name, value, job_id)
) STRICT, WITHOUT ROWID;
CREATE INDEX labels_by_job ON labels (job_id, name, value);

-- Several jobs may name the same key (reuse by digest).
CREATE TABLE files (
    job_id     TEXT    NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    ordinal    INTEGER NOT NULL,
    name       TEXT    NOT NULL,
    media_type TEXT    NOT NULL,
    bytes      INTEGER NOT NULL,
    sha256     TEXT    NOT NULL,
    key        TEXT    NOT NULL,
    PRIMARY KEY (job_id, ordinal)
) STRICT, WITHOUT ROWID;
CREATE INDEX files_by_key ON files (key);

CREATE TABLE attempts (
    job_id     TEXT    NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    attempt    INTEGER NOT NULL,
    worker     TEXT    NOT NULL,
    started_at INTEGER NOT NULL,
    ended_at   INTEGER,
    outcome    TEXT CHECK (outcome IN ('succeeded', 'failed', 'cancelled', 'released', 'retried', 'vanished')),
    detail     TEXT,
    PRIMARY KEY (job_id, attempt)
) STRICT, WITHOUT ROWID;

CREATE TABLE workers (
    id           TEXT    NOT NULL PRIMARY KEY,
    host         TEXT    NOT NULL,
    backend      TEXT    NOT NULL,
    device       TEXT    NOT NULL,
    job          TEXT,
    jobs_done    INTEGER NOT NULL,
    heartbeat_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
