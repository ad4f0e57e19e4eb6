-- Ids of jobs and batches that no submission may use any more; see sql/spent.rs.
CREATE TABLE spent_ids (
    id       TEXT NOT NULL PRIMARY KEY,
    -- Random identity of the deletion; null if there was no job.
    deletion TEXT,
    spent_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
