-- Turns between submitters, and the length of the queue without counting it; see sql/order.rs.
ALTER TABLE jobs ADD COLUMN submitter TEXT NOT NULL DEFAULT '';
ALTER TABLE jobs ADD COLUMN turn INTEGER NOT NULL DEFAULT 0;

DROP INDEX jobs_queue;
DROP INDEX jobs_position;
-- Claims read the head of the lane of each backend; their cost does not depend on its length.
CREATE INDEX jobs_queue ON jobs (backend_requested, turn, id, available_at) WHERE status = 'queued';
CREATE INDEX jobs_queue_by_submitter ON jobs (backend_requested, submitter, turn) WHERE status = 'queued';
CREATE INDEX jobs_running ON jobs (backend_requested, turn) WHERE status = 'running';

CREATE TABLE queue_length (jobs INTEGER NOT NULL) STRICT;
INSERT INTO queue_length (jobs) SELECT COUNT(*) FROM jobs WHERE status = 'queued';

CREATE TRIGGER queue_grows AFTER INSERT ON jobs WHEN NEW.status = 'queued'
BEGIN
    UPDATE queue_length SET jobs = jobs + 1;
END;
CREATE TRIGGER queue_shrinks AFTER DELETE ON jobs WHEN OLD.status = 'queued'
BEGIN
    UPDATE queue_length SET jobs = jobs - 1;
END;
CREATE TRIGGER queue_changes AFTER UPDATE OF status ON jobs WHEN (OLD.status = 'queued') <> (NEW.status = 'queued')
BEGIN
    UPDATE queue_length SET jobs = jobs + (NEW.status = 'queued') - (OLD.status = 'queued');
END;
