-- Operations that cancel or delete many jobs; see sql/bulk.rs.
CREATE TABLE bulk_operations (
    id          TEXT COLLATE "C" NOT NULL PRIMARY KEY,
    -- Empty if the request had no key.
    submitter   TEXT COLLATE "C" NOT NULL,
    action      TEXT NOT NULL,
    conditions  TEXT NOT NULL,
    filter      TEXT NOT NULL,
    -- Which jobs come next.
    position    TEXT NOT NULL,
    status      TEXT NOT NULL,
    version     BIGINT NOT NULL DEFAULT 1,
    total       BIGINT NOT NULL,
    changed     BIGINT NOT NULL DEFAULT 0,
    created_at  BIGINT NOT NULL,
    stepped_at  BIGINT NOT NULL,
    -- Random identity of the last step.
    step        TEXT,
    finished_at BIGINT
);
CREATE INDEX bulk_operations_unfinished ON bulk_operations (submitter, stepped_at) WHERE finished_at IS NULL;
CREATE INDEX bulk_operations_by_end ON bulk_operations (finished_at) WHERE finished_at IS NOT NULL;
