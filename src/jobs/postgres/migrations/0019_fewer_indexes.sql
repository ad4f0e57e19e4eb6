-- The age of the queue is read from jobs_queue_by_submitter.
DROP INDEX jobs_queue_by_age;
