-- Ids of jobs and batches that were deleted within an hour of their submission; see sql/deleted.rs.
CREATE TABLE deleted (
    id TEXT COLLATE "C" NOT NULL PRIMARY KEY
);
