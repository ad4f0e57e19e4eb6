-- A plain submission in one statement; see sql/submit.rs, which handles all others: repeated
-- idempotency keys, models equal to existing ones, and a full queue. Then the result is null.
--
-- A function, because each of its statements sees what was committed before: with "waits", equal
-- submissions come one after the other, and the second sees the first. The rules of turns and
-- positions are those of sql/order.rs. The result includes the time of the database.
-- "changes" is the number of changes of the queue so far, unless the job comes after a place of its
-- lane with 1000 jobs ahead until there are "far_until" changes.
CREATE FUNCTION submit_job(
    new json, its_spec text, labels json, waits boolean, queue_limit bigint,
    far_rank bigint, far_turn bigint, far_id text, far_until bigint,
    OUT its_turn bigint, OUT ahead bigint, OUT changes bigint, OUT now bigint
)
LANGUAGE plpgsql AS $$
#variable_conflict use_column
DECLARE
    job jobs := json_populate_record(NULL::jobs, new);
    its_lane text COLLATE "C" := CASE WHEN job.kind = 'fit' THEN 'fit' ELSE job.backend_requested END;
    running bigint;
    head bigint;
    own bigint;
    last bigint;
BEGIN
    IF waits THEN
        PERFORM pg_advisory_xact_lock(hashtextextended(job.digest, 0));
    END IF;
    IF (SELECT COALESCE(SUM(jobs), 0) FROM queue_length) >= queue_limit
        OR (SELECT 1 FROM jobs WHERE idempotency_key = job.idempotency_key) IS NOT NULL
        OR waits AND (SELECT id FROM jobs WHERE finished_at IS NULL AND NOT shares AND digest = job.digest
            ORDER BY id LIMIT 1) IS NOT NULL
        OR waits AND (SELECT id FROM jobs WHERE status = 'succeeded' AND engine_used = engine AND digest = job.digest
            ORDER BY id LIMIT 1) IS NOT NULL
    THEN
        RETURN;
    END IF;
    SELECT
        (SELECT turn FROM jobs WHERE status = 'running' AND lane = its_lane AND rank = job.rank
            ORDER BY turn DESC LIMIT 1),
        (SELECT turn FROM jobs WHERE status = 'queued' AND NOT shares AND lane = its_lane AND rank = job.rank
            ORDER BY turn, id LIMIT 1),
        (SELECT turn FROM jobs WHERE status = 'queued' AND NOT shares AND lane = its_lane AND rank = job.rank
            AND submitter = job.submitter ORDER BY turn DESC LIMIT 1),
        (SELECT CASE WHEN lane = its_lane AND rank = job.rank THEN turn END FROM jobs
            WHERE submitter = job.submitter AND submitter <> '' ORDER BY id DESC LIMIT 1)
    INTO running, head, own, last;
    -- GREATEST ignores nulls.
    IF running IS NOT NULL AND head IS NOT NULL AND last IS NOT NULL THEN
        its_turn := GREATEST(running, head - 1, last + 1, own + 1);
    ELSE
        its_turn := GREATEST(COALESCE(running, head, 0), head, own + 1);
    END IF;
    INSERT INTO jobs (id, status, preset, seed, digest, outputs, backend_requested, available_at, created_at,
        idempotency_key, idempotency_body, spec, engine, submitter, turn, rank, trace, batch_key, retry_of, kind,
        weight, short)
    VALUES (job.id, 'queued', job.preset, job.seed, job.digest, job.outputs, job.backend_requested, 0, job.created_at,
        job.idempotency_key, job.idempotency_body, its_spec, job.engine, job.submitter, its_turn, job.rank, job.trace,
        job.batch_key, job.retry_of, job.kind, job.weight, job.short);
    -- After the insertion, which waits for other submissions with this id; see sql/spent.rs.
    IF (SELECT 1 FROM spent_ids WHERE id = job.id) IS NOT NULL THEN
        RAISE EXCEPTION 'the id of job % is spent', job.id USING ERRCODE = 'serialization_failure';
    END IF;
    INSERT INTO labels (job_id, name, value) SELECT job.id, key, value FROM json_each_text(labels);
    IF far_until > (SELECT last_value FROM count_changes)
        AND (far_rank, far_turn, far_id COLLATE "C") < (job.rank, its_turn, job.id)
    THEN
        ahead := 1000;
    ELSE
        -- Before the jobs are counted: each change from now on removes at most one of them.
        changes := (SELECT last_value FROM count_changes);
        SELECT COUNT(*) INTO ahead FROM (
            SELECT 1 FROM jobs WHERE status = 'queued' AND NOT shares AND lane = its_lane
            AND (rank, turn, id) < (job.rank, its_turn, job.id) ORDER BY rank, turn, id LIMIT 3000
        ) AS jobs_ahead;
    END IF;
    now := EXTRACT(EPOCH FROM clock_timestamp()) * 1000000;
END $$;

-- Each submission compresses its spec; lz4 takes a fraction of the time, where the server has it.
DO $$
BEGIN
    EXECUTE 'ALTER TABLE jobs ALTER COLUMN spec SET COMPRESSION lz4';
EXCEPTION
    WHEN feature_not_supported OR syntax_error THEN NULL;
END $$;

-- Ends attempts that have succeeded; see sql/end.rs, which handles those that this function leaves:
-- attempts that are no longer held, and jobs that were cancelled or that equal jobs wait for.
-- "ends" is an array of attempts, "at" their time unless it is that of the database.
CREATE FUNCTION end_jobs(ends json, at bigint) RETURNS TABLE (ended_id text, ended_version bigint)
LANGUAGE plpgsql AS $$
#variable_conflict use_column
DECLARE
    moment bigint := COALESCE(at, EXTRACT(EPOCH FROM clock_timestamp()) * 1000000);
    held text[];
BEGIN
    -- From here on, no submission begins to wait for these jobs.
    held := ARRAY(
        SELECT j.id FROM json_to_recordset(ends) AS e (id text, attempt bigint, worker text) JOIN jobs j ON j.id = e.id
        WHERE (j.status = 'running') IS TRUE AND j.attempts = e.attempt AND j.holder = e.worker
        AND NOT j.cancel_requested ORDER BY j.id FOR UPDATE OF j
    );
    RETURN QUERY
    WITH ended AS (
        UPDATE jobs j SET status = 'succeeded', holder = NULL, lease_until = NULL, finished_at = moment,
            checkpoint = NULL, section = NULL, summary = e.summary, engine_used = e.engine, backend_used = e.backend,
            device = e.device, fallback = e.fallback, version = version + 1
        FROM json_to_recordset(ends) AS e (
            id text, summary text, engine text, backend text, device text, fallback text
        )
        WHERE j.id = e.id AND e.id = ANY (held) AND (
            SELECT f.id FROM jobs f WHERE f.finished_at IS NULL AND f.shares AND f.digest = j.digest
            AND f.preset = j.preset AND f.submitter = j.submitter AND f.backend_requested = j.backend_requested
            AND f.status = 'queued' ORDER BY f.rank, f.id LIMIT 1
        ) IS NULL
        RETURNING j.id, j.attempts, j.version
    ), closed AS (
        UPDATE attempts a SET ended_at = moment, outcome = 'succeeded' FROM ended
        WHERE a.job_id = ended.id AND a.attempt = ended.attempts
    ), stored AS (
        INSERT INTO files (job_id, ordinal, name, media_type, bytes, sha256, key, start)
        SELECT ended.id, f.ordinal - 1, f.name, f.media_type, f.bytes, f.sha256, f.key, f.start
        FROM ended JOIN json_to_recordset(ends) AS e (id text, files json) ON e.id = ended.id
        CROSS JOIN LATERAL ROWS FROM (
            json_to_recordset(e.files)
            AS (name text, media_type text, bytes bigint, sha256 text, key text, start bigint)
        ) WITH ORDINALITY AS f (name, media_type, bytes, sha256, key, start, ordinal)
    )
    SELECT id, version FROM ended;
END $$;
