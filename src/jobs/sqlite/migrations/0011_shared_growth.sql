-- Jobs that wait for the growth of an equal job; see sql/share.rs. Claims do not see them.
ALTER TABLE jobs ADD COLUMN shares INTEGER NOT NULL DEFAULT 0;

-- The version before names the indexes jobs_queue and jobs_by_batch_key in its claims: they stay for it.
DROP INDEX jobs_queue_by_submitter;
CREATE INDEX jobs_claimable ON jobs (backend_requested, rank, turn, id, available_at)
WHERE status = 'queued' AND NOT shares;
CREATE INDEX jobs_queue_by_submitter ON jobs (backend_requested, rank, submitter, turn)
WHERE status = 'queued' AND NOT shares;
CREATE INDEX jobs_claimable_by_batch_key ON jobs (batch_key, rank, turn, id, available_at)
WHERE status = 'queued' AND NOT shares AND batch_key IS NOT NULL;
-- The jobs that others may wait for, and those that wait.
CREATE INDEX jobs_in_flight ON jobs (digest, id) WHERE finished_at IS NULL AND NOT shares;
CREATE INDEX jobs_sharing ON jobs (digest, rank, id) WHERE finished_at IS NULL AND shares;
