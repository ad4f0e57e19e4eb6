-- Position of a file in an object that contains several; null if the object is the file.
ALTER TABLE files ADD COLUMN start BIGINT;
DROP INDEX files_by_key;
CREATE INDEX files_by_key ON files (key, start, bytes);
