-- Pauses of claims: of all workers (scope '*'), or of the worker of that name. No row: they claim. Processes of an older
-- version know no pauses and go on claiming.
CREATE TABLE claiming (
    scope  TEXT    COLLATE "C" NOT NULL PRIMARY KEY,
    -- Whether the worker is to be removed once it holds no job.
    drain  BOOLEAN NOT NULL,
    since  BIGINT  NOT NULL,
    set_by TEXT
);

-- The oldest queued job of each backend. With IS TRUE, here and in the query, the planner cannot choose the index by status,
-- which would read all queued jobs.
CREATE INDEX jobs_queue_by_age ON jobs (backend_requested, id) WHERE (status = 'queued') IS TRUE;
