-- Records of jobs, as in SQLite. Times are microseconds since 1970 UTC; ids are hyphenated UUIDv7 that sort by age,
-- in the order of bytes. JSON is kept as the text that was written.

CREATE TABLE batches (
    id                TEXT   COLLATE "C" NOT NULL PRIMARY KEY,
    created_at        BIGINT NOT NULL,
    idempotency_key   TEXT   COLLATE "C" UNIQUE,
    idempotency_body  TEXT
);

CREATE TABLE jobs (
    id                TEXT    COLLATE "C" NOT NULL PRIMARY KEY,
    status            TEXT    COLLATE "C" NOT NULL
                      CHECK (status IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    version           BIGINT  NOT NULL DEFAULT 1,
    preset            TEXT    COLLATE "C" NOT NULL,
    seed              BIGINT  NOT NULL,
    digest            TEXT    COLLATE "C" NOT NULL,
    outputs           TEXT    NOT NULL,
    backend_requested TEXT    COLLATE "C" NOT NULL,
    backend_used      TEXT,
    device            TEXT,
    fallback          TEXT,
    -- Number of the last attempt: the fence of every write of a worker.
    attempts          BIGINT  NOT NULL DEFAULT 0,
    -- Attempts that count against the limit: all but those that were given back in peace.
    spent             BIGINT  NOT NULL DEFAULT 0,
    cancel_requested  BOOLEAN NOT NULL DEFAULT FALSE,
    holder            TEXT,
    lease_until       BIGINT,
    available_at      BIGINT  NOT NULL,
    created_at        BIGINT  NOT NULL,
    started_at        BIGINT,
    finished_at       BIGINT,
    reused_from       TEXT    COLLATE "C",
    idempotency_key   TEXT    COLLATE "C" UNIQUE,
    idempotency_body  TEXT,
    summary           TEXT,
    problem           TEXT,
    progress          TEXT,
    spec              TEXT    NOT NULL,
    section           TEXT,
    submitter         TEXT    COLLATE "C" NOT NULL DEFAULT '',
    turn              BIGINT  NOT NULL DEFAULT 0,
    batch             TEXT    COLLATE "C" REFERENCES batches (id),
    -- Artifact key of the newest checkpoint of a job that has not ended.
    checkpoint        TEXT    COLLATE "C",
    -- The engine version that the digest is of, and the one that made the files.
    engine            TEXT    COLLATE "C" NOT NULL,
    engine_used       TEXT    COLLATE "C",
    CHECK ((status = 'running') = (holder IS NOT NULL)),
    CHECK ((status = 'running') = (lease_until IS NOT NULL))
) WITH (autovacuum_vacuum_scale_factor = 0.01, autovacuum_vacuum_threshold = 500);

-- Claims read the head of the lane of each backend; their cost does not depend on its length. See sql/order.rs.
CREATE INDEX jobs_queue ON jobs (backend_requested, turn, id, available_at) WHERE status = 'queued';
CREATE INDEX jobs_queue_by_submitter ON jobs (backend_requested, submitter, turn) WHERE status = 'queued';
CREATE INDEX jobs_running ON jobs (backend_requested, turn) WHERE status = 'running';
CREATE INDEX jobs_leases ON jobs (lease_until) WHERE status = 'running';
CREATE INDEX jobs_by_digest ON jobs (digest, id) WHERE status = 'succeeded' AND engine_used = engine;
CREATE INDEX jobs_by_status ON jobs (status, id);
CREATE INDEX jobs_by_preset ON jobs (preset, id);
CREATE INDEX jobs_by_end ON jobs (finished_at, id) WHERE finished_at IS NOT NULL;
CREATE INDEX jobs_by_batch ON jobs (batch, id) WHERE batch IS NOT NULL;
CREATE INDEX jobs_by_checkpoint ON jobs (checkpoint) WHERE checkpoint IS NOT NULL;

-- The last line of defence of the main invariant; the state machine never gets here.
CREATE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    RAISE EXCEPTION 'an ended job never changes';
END $$;
CREATE TRIGGER ended_jobs_never_change BEFORE UPDATE ON jobs FOR EACH ROW
WHEN (OLD.status IN ('succeeded', 'failed', 'cancelled')) EXECUTE FUNCTION refuse_change();

-- The length of the queue is the sum of these rows. Each transaction adds rows of its own, so that none waits for
-- another; submissions put them together now and then.
CREATE TABLE queue_length (jobs BIGINT NOT NULL)
WITH (autovacuum_vacuum_scale_factor = 0, autovacuum_vacuum_threshold = 2000);

CREATE FUNCTION count_queue() RETURNS trigger LANGUAGE plpgsql AS $$
DECLARE
    change BIGINT := 0;
BEGIN
    IF TG_OP <> 'DELETE' AND NEW.status = 'queued' THEN change := change + 1; END IF;
    IF TG_OP <> 'INSERT' AND OLD.status = 'queued' THEN change := change - 1; END IF;
    IF change <> 0 THEN INSERT INTO queue_length (jobs) VALUES (change); END IF;
    RETURN NULL;
END $$;
CREATE TRIGGER queue_changes AFTER INSERT OR DELETE OR UPDATE OF status ON jobs
FOR EACH ROW EXECUTE FUNCTION count_queue();

CREATE TABLE labels (
    name   TEXT COLLATE "C" NOT NULL,
    value  TEXT COLLATE "C" NOT NULL,
    job_id TEXT COLLATE "C" NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    PRIMARY KEY (name, value, job_id)
);
CREATE INDEX labels_by_job ON labels (job_id, name, value);

-- Several jobs may name the same key (reuse by digest).
CREATE TABLE files (
    job_id     TEXT   COLLATE "C" NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    ordinal    BIGINT NOT NULL,
    name       TEXT   NOT NULL,
    media_type TEXT   NOT NULL,
    bytes      BIGINT NOT NULL,
    sha256     TEXT   NOT NULL,
    key        TEXT   COLLATE "C" NOT NULL,
    PRIMARY KEY (job_id, ordinal)
);
CREATE INDEX files_by_key ON files (key, bytes);

CREATE TABLE attempts (
    job_id     TEXT   COLLATE "C" NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    attempt    BIGINT NOT NULL,
    worker     TEXT   NOT NULL,
    started_at BIGINT NOT NULL,
    ended_at   BIGINT,
    outcome    TEXT CHECK (outcome IN ('succeeded', 'failed', 'cancelled', 'released', 'retried', 'vanished')),
    detail     TEXT,
    PRIMARY KEY (job_id, attempt)
);

CREATE TABLE workers (
    id           TEXT   COLLATE "C" NOT NULL PRIMARY KEY,
    host         TEXT   NOT NULL,
    backend      TEXT   NOT NULL,
    device       TEXT   NOT NULL,
    job          TEXT   COLLATE "C",
    jobs_done    BIGINT NOT NULL,
    heartbeat_at BIGINT NOT NULL
);
