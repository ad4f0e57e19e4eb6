-- Priorities; see sql/order.rs. The rank is the priority, negated, so that one direction of an index is the order.
-- Versions from before go on beside it: their jobs have rank 0, and what they claim is still there to be claimed.
ALTER TABLE jobs ADD COLUMN rank BIGINT NOT NULL DEFAULT 0;
ALTER TABLE batches ADD COLUMN priority BIGINT NOT NULL DEFAULT 0;

DROP INDEX jobs_queue;
DROP INDEX jobs_queue_by_submitter;
DROP INDEX jobs_running;
CREATE INDEX jobs_queue ON jobs (backend_requested, rank, turn, id, available_at) WHERE status = 'queued';
CREATE INDEX jobs_queue_by_submitter ON jobs (backend_requested, rank, submitter, turn) WHERE status = 'queued';
CREATE INDEX jobs_running ON jobs (backend_requested, rank, turn) WHERE status = 'running';

-- How many jobs have ended in which way, without counting them: the sum of these rows, as with queue_length. Each
-- transaction adds rows of its own, so that none waits for another.
CREATE TABLE ended_jobs (status TEXT COLLATE "C" NOT NULL, jobs BIGINT NOT NULL)
WITH (autovacuum_vacuum_scale_factor = 0, autovacuum_vacuum_threshold = 2000);
INSERT INTO ended_jobs (status, jobs)
SELECT status, COUNT(*) FROM jobs WHERE status IN ('succeeded', 'failed', 'cancelled') GROUP BY status;

-- Every 256th change puts together the rows that nobody else is just putting together, whoever makes it, so that
-- there are never many.
CREATE SEQUENCE count_changes;
CREATE FUNCTION put_counts_together() RETURNS void LANGUAGE plpgsql AS $$
BEGIN
    IF nextval('count_changes') % 256 <> 0 THEN RETURN; END IF;
    WITH parts AS (
        DELETE FROM queue_length
        WHERE ctid = ANY (ARRAY(SELECT ctid FROM queue_length FOR UPDATE SKIP LOCKED)) RETURNING jobs
    )
    INSERT INTO queue_length (jobs) SELECT COALESCE(SUM(jobs), 0) FROM parts;
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
    IF becomes = 'queued' THEN INSERT INTO queue_length (jobs) VALUES (1); END IF;
    IF was = 'queued' THEN INSERT INTO queue_length (jobs) VALUES (-1); END IF;
    IF becomes IN ('succeeded', 'failed', 'cancelled') THEN
        INSERT INTO ended_jobs (status, jobs) VALUES (becomes, 1);
    END IF;
    IF was IN ('succeeded', 'failed', 'cancelled') THEN
        INSERT INTO ended_jobs (status, jobs) VALUES (was, -1);
    END IF;
    PERFORM put_counts_together();
    RETURN NULL;
END $$;
