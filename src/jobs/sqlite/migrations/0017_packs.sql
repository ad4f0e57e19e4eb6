-- Position of a file in an object that contains several; null if the object is the file.
ALTER TABLE files ADD COLUMN start INTEGER;
DROP INDEX files_by_key;
CREATE INDEX files_by_key ON files (key, start, bytes);
