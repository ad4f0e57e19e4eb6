-- The trace that the attempts of a job belong to, as W3C traceparent.
ALTER TABLE jobs ADD COLUMN trace TEXT;
