-- Batch keys, queue length by backend, locks of upkeep tasks.

-- Which jobs a GPU may run together: those of the same key. NULL: alone. Jobs queued before this migration, and by
-- processes of an older version, have none.
ALTER TABLE jobs ADD COLUMN batch_key TEXT COLLATE "C";
-- Claims of GPU workers read the jobs of one key in the order of claims. No other index has this order; and with IS TRUE,
-- here and in the query, the planner cannot choose the index by status, which would read all queued jobs.
CREATE INDEX jobs_by_batch_key ON jobs (batch_key, rank, turn, id, available_at)
WHERE (status = 'queued') IS TRUE AND batch_key IS NOT NULL;

-- The ALTER TABLE above keeps others from changing jobs until this transaction ends.
ALTER TABLE queue_length ADD COLUMN backend TEXT COLLATE "C";
DELETE FROM queue_length;
INSERT INTO queue_length (backend, jobs)
SELECT backend_requested, COUNT(*) FROM jobs WHERE status = 'queued' GROUP BY backend_requested;
ALTER TABLE queue_length ALTER COLUMN backend SET NOT NULL;

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
END $$;

CREATE OR REPLACE FUNCTION count_queue() RETURNS trigger LANGUAGE plpgsql AS $$
DECLARE
    was TEXT := CASE WHEN TG_OP <> 'INSERT' THEN OLD.status END;
    becomes TEXT := CASE WHEN TG_OP <> 'DELETE' THEN NEW.status END;
BEGIN
    IF was IS NOT DISTINCT FROM becomes THEN RETURN NULL; END IF;
    IF becomes = 'queued' THEN INSERT INTO queue_length (backend, jobs) VALUES (NEW.backend_requested, 1); END IF;
    IF was = 'queued' THEN INSERT INTO queue_length (backend, jobs) VALUES (OLD.backend_requested, -1); END IF;
    IF becomes IN ('succeeded', 'failed', 'cancelled') THEN
        INSERT INTO ended_jobs (status, jobs) VALUES (becomes, 1);
    END IF;
    IF was IN ('succeeded', 'failed', 'cancelled') THEN
        INSERT INTO ended_jobs (status, jobs) VALUES (was, -1);
    END IF;
    PERFORM put_counts_together();
    RETURN NULL;
END $$;

CREATE TABLE upkeep (
    task       TEXT   COLLATE "C" NOT NULL PRIMARY KEY,
    owner      TEXT   NOT NULL,
    held_until BIGINT NOT NULL
);
