-- True for a model that a CPU worker may run beside a longer one. IS TRUE rules the index out for
-- claims of all models.
ALTER TABLE jobs ADD COLUMN short BOOLEAN NOT NULL DEFAULT FALSE;
CREATE INDEX jobs_short ON jobs (lane, rank, turn, id, available_at)
WHERE (status = 'queued') IS TRUE AND NOT shares AND short;
