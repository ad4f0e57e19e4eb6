-- Batches, checkpoints, retention, engine versions.
CREATE TABLE batches (
    id                TEXT    NOT NULL PRIMARY KEY,
    created_at        INTEGER NOT NULL,
    idempotency_key   TEXT UNIQUE,
    idempotency_body  TEXT
) STRICT, WITHOUT ROWID;

ALTER TABLE jobs ADD COLUMN batch TEXT REFERENCES batches (id);
-- Artifact key of the newest checkpoint of a job that has not ended.
ALTER TABLE jobs ADD COLUMN checkpoint TEXT;
-- The engine version that the digest is of, and the one that made the files. Records from before this migration were
-- made by 0.1.0, the only version there was.
ALTER TABLE jobs ADD COLUMN engine TEXT NOT NULL DEFAULT '0.1.0';
ALTER TABLE jobs ADD COLUMN engine_used TEXT;

DROP TRIGGER ended_jobs_never_change;
UPDATE jobs SET engine_used = engine WHERE status = 'succeeded';
CREATE TRIGGER ended_jobs_never_change BEFORE UPDATE ON jobs
WHEN OLD.status IN ('succeeded', 'failed', 'cancelled')
BEGIN
    SELECT RAISE(ABORT, 'an ended job never changes');
END;

DROP INDEX jobs_by_digest;
CREATE INDEX jobs_by_digest ON jobs (digest, id) WHERE status = 'succeeded' AND engine_used = engine;
CREATE INDEX jobs_by_batch ON jobs (batch, id) WHERE batch IS NOT NULL;
CREATE INDEX jobs_by_checkpoint ON jobs (checkpoint) WHERE checkpoint IS NOT NULL;
CREATE INDEX jobs_by_end ON jobs (finished_at, id) WHERE finished_at IS NOT NULL;

DROP INDEX files_by_key;
CREATE INDEX files_by_key ON files (key, bytes);
