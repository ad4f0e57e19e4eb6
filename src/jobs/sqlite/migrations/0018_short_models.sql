-- True for a model that a CPU worker may run beside a longer one.
ALTER TABLE jobs ADD COLUMN short INTEGER NOT NULL DEFAULT 0;
CREATE INDEX jobs_short ON jobs (lane, rank, turn, id, available_at) WHERE status = 'queued' AND NOT shares AND short;
