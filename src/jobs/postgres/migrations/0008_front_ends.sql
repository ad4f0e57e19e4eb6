-- The failed job that a job repeats.
ALTER TABLE jobs ADD COLUMN retry_of TEXT COLLATE "C";
-- With the status, so that the jobs of a batch are counted in the index alone.
DROP INDEX jobs_by_batch;
CREATE INDEX jobs_by_batch ON jobs (batch, id, status) WHERE batch IS NOT NULL;
