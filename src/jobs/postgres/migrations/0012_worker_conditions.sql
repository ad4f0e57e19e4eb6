-- Condition that keeps a live worker from claiming jobs; null if there is none.
ALTER TABLE workers ADD COLUMN condition TEXT;
