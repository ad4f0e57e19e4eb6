-- Priorities; see sql/order.rs. The rank is the priority, negated, so that one direction of an index is the order.
ALTER TABLE jobs ADD COLUMN rank INTEGER NOT NULL DEFAULT 0;
ALTER TABLE batches ADD COLUMN priority INTEGER NOT NULL DEFAULT 0;

DROP INDEX jobs_queue;
DROP INDEX jobs_queue_by_submitter;
DROP INDEX jobs_running;
CREATE INDEX jobs_queue ON jobs (backend_requested, rank, turn, id, available_at) WHERE status = 'queued';
CREATE INDEX jobs_queue_by_submitter ON jobs (backend_requested, rank, submitter, turn) WHERE status = 'queued';
CREATE INDEX jobs_running ON jobs (backend_requested, rank, turn) WHERE status = 'running';

-- How many jobs have ended in which way, without counting them.
CREATE TABLE ended_jobs (status TEXT NOT NULL PRIMARY KEY, jobs INTEGER NOT NULL) STRICT, WITHOUT ROWID;
INSERT INTO ended_jobs (status, jobs) VALUES ('succeeded', 0), ('failed', 0), ('cancelled', 0);
UPDATE ended_jobs SET jobs = (SELECT COUNT(*) FROM jobs WHERE jobs.status = ended_jobs.status);

-- What a job is inserted as, or becomes; one that has ended never changes again.
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
