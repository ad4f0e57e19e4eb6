-- Pauses of claims: of all workers (scope '*'), or of the worker of that name. No row: they claim.
CREATE TABLE claiming (
    scope  TEXT    NOT NULL PRIMARY KEY,
    -- Whether the worker is to be removed once it holds no job.
    drain  INTEGER NOT NULL,
    since  INTEGER NOT NULL,
    set_by TEXT
) STRICT, WITHOUT ROWID;

-- The oldest queued job of each backend.
CREATE INDEX jobs_queue_by_age ON jobs (backend_requested, id) WHERE status = 'queued';
