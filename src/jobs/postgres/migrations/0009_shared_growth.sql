-- Jobs that wait for the growth of an equal job; see sql/share.rs. Claims do not see them.
ALTER TABLE jobs ADD COLUMN shares BOOLEAN NOT NULL DEFAULT FALSE;

DROP INDEX jobs_queue;
DROP INDEX jobs_queue_by_submitter;
DROP INDEX jobs_by_batch_key;
CREATE INDEX jobs_queue ON jobs (backend_requested, rank, turn, id, available_at)
WHERE status = 'queued' AND NOT shares;
CREATE INDEX jobs_queue_by_submitter ON jobs (backend_requested, rank, submitter, turn)
WHERE status = 'queued' AND NOT shares;
CREATE INDEX jobs_by_batch_key ON jobs (batch_key, rank, turn, id, available_at)
WHERE (status = 'queued') IS TRUE AND NOT shares AND batch_key IS NOT NULL;
-- The jobs that others may wait for, and those that wait.
CREATE INDEX jobs_in_flight ON jobs (digest, id) WHERE finished_at IS NULL AND NOT shares;
CREATE INDEX jobs_sharing ON jobs (digest, rank, id) WHERE finished_at IS NULL AND shares;
