-- Batch keys, queue length by backend, locks of upkeep tasks.

-- Which jobs a GPU may run together: those of the same key. NULL: alone. Jobs queued before this migration have none.
ALTER TABLE jobs ADD COLUMN batch_key TEXT;
-- Claims of GPU workers read the jobs of one key in the order of claims.
CREATE INDEX jobs_by_batch_key ON jobs (batch_key, rank, turn, id, available_at)
WHERE status = 'queued' AND batch_key IS NOT NULL;

DROP TRIGGER queue_grows;
DROP TRIGGER queue_shrinks;
DROP TRIGGER queue_changes;
DROP TABLE queue_length;
-- The length of the queue is the sum of the rows.
CREATE TABLE queue_length (backend TEXT NOT NULL PRIMARY KEY, jobs INTEGER NOT NULL) STRICT, WITHOUT ROWID;
INSERT INTO queue_length (backend, jobs)
SELECT backend_requested, COUNT(*) FROM jobs WHERE status = 'queued' GROUP BY backend_requested;

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

CREATE TABLE upkeep (
    task       TEXT    NOT NULL PRIMARY KEY,
    owner      TEXT    NOT NULL,
    held_until INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
