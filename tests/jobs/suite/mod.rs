//! Requirements that every job store must meet. Each function takes a factory of empty stores;
//! [`over`] turns all functions into tests of one kind of store.

mod batch;
mod bulk;
mod histories;
mod hook;
mod keep;
mod lease;
mod list;
mod order;
mod owners;
mod pause;
mod share;
mod submit;
mod uncertain;

pub use batch::*;
pub use bulk::*;
pub use histories::*;
pub use hook::*;
pub use keep::*;
pub use lease::*;
pub use list::*;
pub use order::*;
pub use owners::*;
pub use pause::*;
pub use share::*;
pub use submit::*;
pub use uncertain::*;

use futures_util::future::{BoxFuture, join_all};
use jiff::Timestamp;
use oviduct::clock::Clock;
use oviduct::generate::{Backend, Output, Outputs, Progress, Stage, UsedBackend};
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{
    BackendReport, BatchFilter, Change, ClaimScope, ClaimedJob, Counts, Directive, File, Finished, Instruction, Job,
    JobId, JobKind, JobProgress, ListFilter, LiveSection, NewBatch, NewJob, Pause, Priority, Problem, Status, Store,
    StoreError, StoreOptions, Submitted, SubmittedBatch, UpkeepTask, WorkerCondition, WorkerCounts, WorkerInfo,
    WorkerKind, WorkerState, Workforce,
};
use oviduct::model::{BodyKind, LengthUnit};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::time::Duration;

/// Creates an empty store. The second value owns resources that the store needs, such as its
/// directory.
pub type Factory = fn(StoreOptions) -> BoxFuture<'static, (Store, Box<dyn Send + Sync>)>;

pub const LEASE: Duration = Duration::from_secs(8);

/// Generates a test for each function of the suite, over the stores that `$factory` creates.
macro_rules! over {
    ($factory:expr; $($test:ident)*) => {
        $(
            #[tokio::test(flavor = "multi_thread", worker_threads = 4)]
            async fn $test() {
                crate::suite::$test($factory).await;
            }
        )*
    };
    ($factory:expr) => {
        crate::suite::over! { $factory;
            a_hook_fails_calls_and_loses_responses
            a_hook_sees_the_calls_of_its_view_alone
            a_job_goes_from_the_queue_to_its_end
            a_heartbeat_renews_and_notifies_only_of_progress
            a_stale_attempt_changes_nothing
            an_expired_lease_is_claimed_again_before_younger_jobs
            attempts_are_used_up_with_their_history
            retries_wait_and_count_and_releases_do_not
            cancel_is_idempotent_in_every_state
            delete_in_every_state
            an_idempotency_key_gives_one_job
            racing_idempotency_keys_give_one_job
            a_finished_digest_is_reused
            bodies_and_units_are_kept_and_decide_what_is_reused
            shared_files_go_with_the_last_job
            the_queue_has_a_limit
            lists_are_filtered_and_paged
            queue_positions_are_by_age
            submitters_take_turns
            the_higher_priority_goes_first
            submitters_take_turns_within_a_priority
            a_released_job_keeps_its_priority_and_turn
            a_claim_of_several_takes_due_jobs_of_all_lanes
            a_batch_has_one_priority
            a_submitter_of_one_job_at_a_time_alternates_with_others
            a_released_job_keeps_its_turn
            fits_and_models_are_claimed_separately
            fits_of_different_owners_take_turns
            a_fit_counts_by_its_weight
            short_models_are_claimed_alone_or_with_all_others
            claims_keep_to_their_backend
            a_gpu_claims_due_jobs_of_one_batch_key
            a_gpu_claim_passes_over_jobs_that_are_not_due
            workers_are_seen
            workers_are_counted_by_what_they_can_do
            four_claimers_end_each_job_once
            random_histories_agree_with_the_state_machine
            a_batch_counts_its_jobs
            a_batch_is_taken_whole_or_not_at_all
            a_batch_is_removed_with_all_its_jobs
            an_idempotency_key_gives_one_batch
            a_batch_keeps_its_study
            a_checkpoint_passes_to_the_next_attempt
            ended_jobs_are_listed_by_age_and_bytes
            another_engines_files_are_not_reused
            a_model_without_its_files_is_not_reused
            keys_of_records_and_of_running_attempts_are_in_use
            one_owner_at_a_time_holds_an_upkeep_task
            queued_jobs_are_counted_by_backend
            owners_share_nothing
            an_owner_has_a_quota
            keys_are_stored_revoked_and_listed
            only_one_first_key_is_made
            a_ticket_is_good_once_for_its_path_and_a_minute
            paused_workers_claim_nothing
            a_paused_gpu_worker_claims_no_batch
            a_pause_does_not_keep_expired_leases
            a_drained_worker_says_so
            the_pause_of_all_is_kept
            the_queue_has_an_age
            lists_are_narrowed_by_time_batch_and_ids
            many_jobs_are_cancelled
            many_jobs_are_removed
            an_operation_changes_all_jobs_that_matched_and_no_later_ones
            operations_of_owners_take_turns
            batches_are_listed
            a_retry_goes_into_the_batch_of_the_failed_job
            equal_jobs_share_one_growth
            jobs_that_differ_share_nothing
            the_next_equal_job_grows_if_the_first_is_cancelled_or_deleted
            equal_jobs_fail_together
            unsuitable_files_are_not_shared
            equal_points_of_batches_share_growths
            racing_equal_submissions_share_one_growth
            a_job_does_not_wait_for_one_that_is_queued_again_behind_it
            a_lost_response_to_a_commit_changes_no_result
            a_retried_submission_creates_no_deleted_model_again
            a_submission_returns_the_record
            submissions_at_once_share_transactions_and_are_refused_alone
        }
    };
}
pub(crate) use over;

pub fn new_job(digest: &str) -> NewJob {
    NewJob {
        kind: JobKind::Model,
        preset: "pig".into(),
        seed: (1 << 53) - 1,
        spec: serde_json::json!({ "length_mm": 60.0, "steps": 2000 }).into(),
        outputs: vec![Output::Glb].into(),
        backend: Backend::Auto,
        labels: BTreeMap::new(),
        priority: Priority::default(),
        digest: digest.into(),
        engine: oviduct::ENGINE_VERSION.into(),
        reuse: true,
        missing: Vec::new(),
        batch_key: Some("size".into()),
        short: false,
        idempotency: None,
        owner: None,
        quota: Default::default(),
        weight: 1,
        trace: Some("00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01".into()),
        retry_of: None,
    }
}

pub fn problem(kind: &str) -> Problem {
    Problem { kind: kind.into(), title: "A fault".into(), detail: "somewhere".into() }
}

fn by_cpu() -> BackendReport {
    BackendReport {
        requested: Backend::Auto,
        used: Some(UsedBackend::Cpu),
        device: Some("cpu, 2 threads".into()),
        fallback: None,
    }
}

fn progress(fraction: f64) -> JobProgress {
    JobProgress::Model(Progress {
        stage: Stage::Simulate,
        fraction,
        step: 10,
        steps: 2000,
        particles: 710,
        sections: 2,
        eta_seconds: Some(3.5),
    })
}

fn file(claimed: &ClaimedJob, name: &str, object: &str, start: Option<u64>) -> File {
    File {
        name: name.into(),
        media_type: "application/octet-stream".into(),
        bytes: 5,
        sha256: "00".repeat(32),
        key: oviduct::jobs::artifacts::key(claimed.job().id, claimed.attempt(), object),
        start,
    }
}

/// A result with two files in a pack and one alone.
pub fn finished(claimed: &ClaimedJob) -> Finished {
    let [packed, second] =
        [("sections.bin", 0), ("report.json", 5)].map(|(name, start)| file(claimed, name, "pack", Some(start)));
    Finished {
        backend: by_cpu(),
        files: vec![packed, second, file(claimed, "model.glb", "model.glb", None)],
        summary: serde_json::json!({ "vertices": 790_211 }),
        engine: oviduct::ENGINE_VERSION.into(),
    }
}

/// Number of objects that have these files.
pub fn objects<'a>(files: impl IntoIterator<Item = &'a File>) -> usize {
    files.into_iter().map(|file| &file.key).collect::<BTreeSet<_>>().len()
}

struct Bench {
    store: Store,
    clock: Clock,
    _kept: Box<dyn Send + Sync>,
}

async fn bench(factory: Factory, change: impl FnOnce(&mut StoreOptions)) -> Bench {
    let clock = Clock::manual("2026-01-02T03:04:05.678901Z".parse().unwrap());
    let mut options = StoreOptions { clock: clock.clone(), ..StoreOptions::default() };
    change(&mut options);
    let (store, kept) = factory(options).await;
    Bench { store, clock, _kept: kept }
}

impl Bench {
    async fn queue(&self, digest: &str) -> Job {
        let submitted = self.store.submit(new_job(digest)).await.unwrap();
        assert!(matches!(submitted, Submitted::Queued(_)), "{submitted:?}");
        submitted.job().clone()
    }

    async fn claim(&self, worker: &str) -> Option<ClaimedJob> {
        let mut claimed = self.store.claim(worker, ClaimScope::Cpu, LEASE, 1).await.unwrap();
        assert!(claimed.len() <= 1);
        claimed.pop()
    }

    async fn get(&self, id: JobId) -> Job {
        self.store.get(id).await.unwrap().unwrap()
    }

    /// True if a record names the artifact key or the key belongs to a running attempt.
    async fn uses(&self, key: &str) -> bool {
        !self.store.keys_in_use(&[key.to_owned()]).await.unwrap().is_empty()
    }

    async fn beat(&self, claimed: &ClaimedJob) -> Directive {
        self.store.heartbeat(claimed, LEASE, &by_cpu(), None, None).await.unwrap()
    }

    async fn succeed(&self, digest: &str) -> Job {
        self.queue(digest).await;
        let claimed = self.claim("maker").await.unwrap();
        self.finish(claimed).await
    }

    async fn finish(&self, claimed: ClaimedJob) -> Job {
        let done = finished(&claimed);
        self.finish_with(claimed, done).await
    }

    async fn finish_with(&self, claimed: ClaimedJob, done: Finished) -> Job {
        let id = claimed.job().id;
        self.store.finish(claimed, done).await.unwrap();
        self.get(id).await
    }

    async fn fail(&self, claimed: ClaimedJob, kind: &str) -> Job {
        let id = claimed.job().id;
        self.store.fail(claimed, by_cpu(), problem(kind)).await.unwrap();
        self.get(id).await
    }

    async fn retry(&self, claimed: ClaimedJob) -> Job {
        let id = claimed.job().id;
        self.store.retry(claimed, problem("io")).await.unwrap();
        self.get(id).await
    }
}
