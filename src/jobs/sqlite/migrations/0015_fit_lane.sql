-- The lane in which a job waits: fits have one of their own, because workers run them beside
-- models.
ALTER TABLE jobs ADD COLUMN lane TEXT NOT NULL
    GENERATED ALWAYS AS (CASE WHEN kind = 'fit' THEN 'fit' ELSE backend_requested END) VIRTUAL;
-- Number of jobs as which a job counts against the quota of its owner.
ALTER TABLE jobs ADD COLUMN weight INTEGER NOT NULL DEFAULT 1;

DROP INDEX jobs_claimable;
DROP INDEX jobs_queue_by_submitter;
DROP INDEX jobs_running;
CREATE INDEX jobs_lanes ON jobs (lane, rank, turn, id, available_at) WHERE status = 'queued' AND NOT shares;
CREATE INDEX jobs_queue_by_submitter ON jobs (lane, rank, submitter, turn) WHERE status = 'queued' AND NOT shares;
CREATE INDEX jobs_running ON jobs (lane, rank, turn) WHERE status = 'running';
CREATE INDEX jobs_unfinished_fits ON jobs (submitter, weight) WHERE kind = 'fit' AND finished_at IS NULL;
