-- Owners and their keys. The owner of a job or batch is its submitter; '' is nobody.
ALTER TABLE batches ADD COLUMN submitter TEXT NOT NULL DEFAULT '';
-- Partial, so that a service without keys need not maintain them.
CREATE INDEX jobs_by_submitter ON jobs (submitter, id) WHERE submitter <> '';
CREATE INDEX jobs_by_submitter_and_status ON jobs (submitter, status, id) WHERE submitter <> '';
CREATE INDEX batches_by_submitter ON batches (submitter, id);

-- Bytes of the files that the records of an owner name.
CREATE TABLE kept_bytes (submitter TEXT NOT NULL PRIMARY KEY, bytes INTEGER NOT NULL) STRICT, WITHOUT ROWID;
INSERT INTO kept_bytes (submitter, bytes)
SELECT j.submitter, SUM(f.bytes) FROM files f JOIN jobs j ON j.id = f.job_id WHERE j.submitter <> '' GROUP BY j.submitter;
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

-- Keys of clients. A revoked key keeps its row: where a key has existed, the service is never open again.
CREATE TABLE keys (
    -- The public part of the secret.
    prefix     TEXT    NOT NULL PRIMARY KEY,
    -- SHA-256 of the whole secret, which has 256 random bits.
    hash       TEXT    NOT NULL,
    owner      TEXT    NOT NULL,
    scopes     TEXT    NOT NULL,
    limits     TEXT    NOT NULL,
    created_at INTEGER NOT NULL,
    expires_at INTEGER,
    revoked_at INTEGER
) STRICT, WITHOUT ROWID;

-- Tickets: each good for one request of one path, with the rights of a key.
CREATE TABLE tickets (
    hash       TEXT    NOT NULL PRIMARY KEY,
    key        TEXT    NOT NULL,
    path       TEXT    NOT NULL,
    expires_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE INDEX tickets_by_end ON tickets (expires_at);
