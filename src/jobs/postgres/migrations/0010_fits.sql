-- What a job makes: a model, or a fit of parameters.
ALTER TABLE jobs ADD COLUMN kind TEXT NOT NULL DEFAULT 'model';
CREATE INDEX jobs_fits ON jobs (id) WHERE kind = 'fit';
