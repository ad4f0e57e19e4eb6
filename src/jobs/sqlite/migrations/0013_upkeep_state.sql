-- State of upkeep that outlives processes, as JSON: one row.
CREATE TABLE upkeep_state (
    id    INTEGER NOT NULL PRIMARY KEY CHECK (id = 1),
    state TEXT    NOT NULL
) STRICT;
