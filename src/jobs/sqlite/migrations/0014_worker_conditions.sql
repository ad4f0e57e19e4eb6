-- Condition that keeps a live worker from claiming jobs; null if there is none.
ALTER TABLE workers ADD COLUMN condition TEXT;
-- True after the process of the worker has stopped it, so that it leaves the list of workers.
ALTER TABLE workers ADD COLUMN stopped INTEGER NOT NULL DEFAULT 0;
