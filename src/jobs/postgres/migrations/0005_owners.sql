-- Owners and their keys. The owner of a job or batch is its submitter; '' is nobody.
ALTER TABLE batches ADD COLUMN submitter TEXT COLLATE "C" NOT NULL DEFAULT '';
-- Partial, so that a service without keys need not maintain them.
CREATE INDEX jobs_by_submitter ON jobs (submitter, id) WHERE submitter <> '';
CREATE INDEX jobs_by_submitter_and_status ON jobs (submitter, status, id) WHERE submitter <> '';
CREATE INDEX batches_by_submitter ON batches (submitter, id);

-- Bytes of the files that the records of an owner name: the sum of these rows, as with queue_length.
CREATE TABLE kept_bytes (submitter TEXT COLLATE "C" NOT NULL, bytes BIGINT NOT NULL)
WITH (autovacuum_vacuum_scale_factor = 0, autovacuum_vacuum_threshold = 2000);
CREATE INDEX kept_bytes_by_submitter ON kept_bytes (submitter);
INSERT INTO kept_bytes (submitter, bytes)
SELECT j.submitter, SUM(f.bytes) FROM files f JOIN jobs j ON j.id = f.job_id WHERE j.submitter <> '' GROUP BY j.submitter;

CREATE OR REPLACE FUNCTION put_counts_together() RETURNS void LANGUAGE plpgsql AS $$
BEGIN
    IF nextval('count_changes') % 256 <> 0 THEN RETURN; END IF;
    WITH parts AS (
        DELETE FROM queue_length
        WHERE ctid = ANY (ARRAY(SELECT ctid FROM queue_length FOR UPDATE SKIP LOCKED)) RETURNING backend, jobs
    )
    INSERT INTO queue_length (backend, jobs) SELECT backend, SUM(jobs) FROM parts GROUP BY backend;
    WITH parts AS (
        DELETE FROM ended_jobs
        WHERE ctid = ANY (ARRAY(SELECT ctid FROM ended_jobs FOR UPDATE SKIP LOCKED)) RETURNING status, jobs
    )
    INSERT INTO ended_jobs (status, jobs) SELECT status, SUM(jobs) FROM parts GROUP BY status;
    WITH parts AS (
        DELETE FROM kept_bytes
        WHERE ctid = ANY (ARRAY(SELECT ctid FROM kept_bytes FOR UPDATE SKIP LOCKED)) RETURNING submitter, bytes
    )
    INSERT INTO kept_bytes (submitter, bytes) SELECT submitter, SUM(bytes) FROM parts GROUP BY submitter;
END $$;

CREATE FUNCTION count_kept_bytes() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    INSERT INTO kept_bytes (submitter, bytes)
    SELECT submitter, NEW.bytes FROM jobs WHERE id = NEW.job_id AND submitter <> '';
    RETURN NULL;
END $$;
CREATE TRIGGER kept_bytes_grow AFTER INSERT ON files FOR EACH ROW EXECUTE FUNCTION count_kept_bytes();

CREATE FUNCTION uncount_kept_bytes() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    INSERT INTO kept_bytes (submitter, bytes)
    SELECT OLD.submitter, -SUM(bytes) FROM files WHERE job_id = OLD.id HAVING SUM(bytes) > 0;
    RETURN OLD;
END $$;
-- Before, while its files are still there.
CREATE TRIGGER kept_bytes_shrink BEFORE DELETE ON jobs FOR EACH ROW WHEN (OLD.submitter <> '')
EXECUTE FUNCTION uncount_kept_bytes();

-- Keys of clients. A revoked key keeps its row: where a key has existed, the service is never open again.
CREATE TABLE keys (
    -- The public part of the secret.
    prefix     TEXT COLLATE "C" NOT NULL PRIMARY KEY,
    -- SHA-256 of the whole secret, which has 256 random bits.
    hash       TEXT   NOT NULL,
    owner      TEXT   NOT NULL,
    scopes     TEXT   NOT NULL,
    limits     TEXT   NOT NULL,
    created_at BIGINT NOT NULL,
    expires_at BIGINT,
    revoked_at BIGINT
);

-- Tickets: each good for one request of one path, with the rights of a key.
CREATE TABLE tickets (
    hash       TEXT COLLATE "C" NOT NULL PRIMARY KEY,
    key        TEXT   NOT NULL,
    path       TEXT   NOT NULL,
    expires_at BIGINT NOT NULL
);
CREATE INDEX tickets_by_end ON tickets (expires_at);
