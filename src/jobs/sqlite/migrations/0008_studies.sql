-- Parameter studies: the study of a batch as JSON, and the place of each job in the request for its batch.
ALTER TABLE batches ADD COLUMN study TEXT;
ALTER TABLE jobs ADD COLUMN batch_index INTEGER;
