//! Random histories: after every step the store agrees with the pure state machine, and no ended
//! job changes.

use super::*;
use futures_util::{StreamExt, stream};
use jiff::SignedDuration;
use oviduct::jobs::Hook;
use oviduct::jobs::state::{Event, Fence, JobState, Next, retry_delay};
use oviduct::random::{Stream, below, words};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

const MAX_ATTEMPTS: u32 = 3;

/// Time after a claim in which another one may leave expired leases.
const LOOKS_EVERY: SignedDuration = SignedDuration::from_millis(500);

/// The backends from which a CPU worker claims, each with its own lane.
const LANES: [Backend; 3] = [Backend::Auto, Backend::Cpu, Backend::CpuSingle];

/// The expected record of a job.
struct Expected {
    state: JobState,
    owner: Option<String>,
    turn: i64,
    lease_until: Timestamp,
    available_at: Timestamp,
    seen: Job,
}

impl Expected {
    /// True if the job has the lane and the priority of `new`.
    fn is_peer_of(&self, new: &NewJob) -> bool {
        (self.seen.backend.requested, self.seen.priority) == (new.backend, new.priority)
    }
}

/// A claimed job that has not been released; its lease may be lost.
struct Held {
    id: JobId,
    fence: Fence,
    claimed: ClaimedJob,
}

struct History {
    bench: Bench,
    hook: Arc<LosesSome>,
    /// Time of the last claim.
    claimed_at: Timestamp,
    /// Time from which claims end expired leases again after a response was lost.
    expires_from: Timestamp,
    jobs: BTreeMap<JobId, Expected>,
    held: Vec<Held>,
    reused: usize,
}

/// Loses the responses to one commit in eight, chosen by a seed.
struct LosesSome {
    seed: u64,
    commits: AtomicU32,
    /// True if a response was lost since the history last asked.
    has_lost: AtomicBool,
}

impl Hook for LosesSome {
    fn loses_commit(&self, _call: &'static str) -> bool {
        let commit = self.commits.fetch_add(1, Ordering::Relaxed);
        let is_lost = below(words(self.seed, Stream::Growth, commit, 1)[0], 8) == 0;
        self.has_lost.fetch_or(is_lost, Ordering::Relaxed);
        is_lost
    }
}

pub async fn random_histories_agree_with_the_state_machine(factory: Factory) {
    let seeds = if std::env::var_os("OVIDUCT_TEST_NIGHT").is_some() { 1000 } else { 4 };
    let histories = stream::iter(1..=seeds).map(|seed| tokio::spawn(agrees(factory, seed))).buffer_unordered(4);
    let sum = async |(reused, ended), history: Result<(usize, usize), _>| {
        let history = history.unwrap();
        (reused + history.0, ended + history.1)
    };
    let (reused, ended) = histories.fold((0, 0), sum).await;
    assert!(reused > 2 * seeds as usize, "{reused} models were reused: the test is too weak");
    assert!(ended > 15 * seeds as usize, "{ended} jobs ended: the test is too weak");
}

/// Compares one history. Those with even seeds lose responses to commits. Returns the numbers of
/// models that were reused and of jobs that ended.
async fn agrees(factory: Factory, seed: u64) -> (usize, usize) {
    let mut bench = bench(factory, |options| options.max_attempts = MAX_ATTEMPTS).await;
    let hook = Arc::new(LosesSome { seed, commits: AtomicU32::new(0), has_lost: AtomicBool::new(false) });
    if seed.is_multiple_of(2) {
        bench.store = bench.store.with_hook(Arc::<LosesSome>::clone(&hook));
    }
    let (jobs, held, reused, claimed_at) = (BTreeMap::new(), Vec::new(), 0, Timestamp::MIN);
    let mut history = History { expires_from: claimed_at, claimed_at, bench, hook, jobs, held, reused };
    for step in 0..250 {
        let [op, pick, worker, amount] = words(seed, Stream::Growth, step, 0);
        let context = format!("seed {seed}, step {step}");
        match below(op, 16) {
            0..=2 => history.submit(step, [pick, worker, amount]).await,
            3 => history.cancel(pick).await,
            4 => history.delete(pick).await,
            5..=8 => history.claim(["a", "b", "c"][below(worker, 3) as usize], 1 + below(amount, 2)).await,
            9 => history.beat(pick).await,
            10..=13 => history.end(pick, below(amount, 5)).await,
            _ => history.bench.clock.advance(Duration::from_millis(u64::from(below(amount, 6000)))),
        }
        history.compare(&context).await;
    }
    (history.reused, history.jobs.values().filter(|job| job.state.status.is_ended()).count())
}

impl History {
    fn pick(&self, word: u32) -> Option<JobId> {
        let n = below(word, (self.jobs.len() as u32).max(1));
        self.jobs.keys().nth(n as usize).copied()
    }

    /// Applies an event to the expected record; returns true if the store should accept it.
    fn apply(&mut self, id: JobId, event: &Event) -> bool {
        let now = self.bench.clock.now();
        let Some(job) = self.jobs.get_mut(&id) else { return false };
        let Ok(Next { state, .. }) = job.state.on(event, MAX_ATTEMPTS) else { return false };
        match event {
            Event::Claim(_) | Event::Renew(_) => job.lease_until = now + LEASE,
            Event::End(_, AttemptEnd::Retried) => job.available_at = now + retry_delay(state.spent),
            Event::End(_, AttemptEnd::Released) | Event::Expire => job.available_at = now,
            _ => {}
        }
        job.state = state;
        true
    }

    /// The jobs of the same lane and priority that have this status.
    fn peers<'a>(&'a self, new: &'a NewJob, status: Status) -> impl Iterator<Item = &'a Expected> {
        self.jobs.values().filter(move |job| job.is_peer_of(new) && job.state.status == status)
    }

    /// The turn of a new job: one after the owner's last queued job, but not before the current
    /// turn. An owner may join the turn that is running unless its newest job had that turn.
    fn turn(&self, new: &NewJob) -> i64 {
        let running = self.peers(new, Status::Running).map(|job| job.turn).max();
        let first = self.peers(new, Status::Queued).map(|job| job.turn).min();
        let own = self.peers(new, Status::Queued).filter(|job| job.owner == new.owner);
        let next = own.map(|job| job.turn + 1).max();
        let newest = self.jobs.values().rfind(|job| new.owner.is_some() && job.owner == new.owner);
        let is_peer = |job: &&Expected| job.is_peer_of(new);
        let current = match (running, first, newest.filter(is_peer)) {
            (Some(running), Some(first), Some(newest)) => running.max(first - 1).max(newest.turn + 1),
            (running, first, _) => running.max(first).unwrap_or(0),
        };
        next.map_or(current, |next| current.max(next))
    }

    async fn submit(&mut self, step: u32, [how, who, again]: [u32; 3]) {
        let owner = [None, Some("x".to_owned()), Some("y".to_owned())][below(who, 3) as usize].clone();
        // Some submissions repeat a finished model of the same owner; a few repeat one of another
        // owner.
        let foreign = again % 64 == 0;
        let made: Vec<&Job> =
            self.jobs.values().filter(|job| foreign || job.owner == owner).map(|job| &job.seen).collect();
        let made: Vec<&Job> = made.into_iter().filter(|job| job.status == Status::Succeeded).collect();
        let digest = match made.get(below(again, 8) as usize) {
            Some(job) => job.digest.clone(),
            None => step.to_string(),
        };
        let new = NewJob {
            backend: LANES[below(how, 3) as usize],
            priority: [-7, 0, 0, 100][(how % 4) as usize].try_into().unwrap(),
            owner: owner.clone(),
            ..new_job(&digest)
        };
        let turn = self.turn(&new);
        let reusable = |job: &Expected| {
            (job.owner == owner, job.state.status) == (true, Status::Succeeded) && job.seen.digest == digest
        };
        let made = self.jobs.values().any(reusable);
        let submitted = self.bench.store.submit(new).await.unwrap();
        assert_eq!(matches!(submitted, Submitted::Reused(_)), made, "{submitted:?}");
        self.reused += usize::from(made);
        let seen = submitted.job().clone();
        let state = JobState { status: if made { Status::Succeeded } else { Status::Queued }, ..JobState::queued() };
        let now = self.bench.clock.now();
        // A reused model is not queued.
        let turn = if made { 0 } else { turn };
        let expected = Expected { state, owner, turn, lease_until: now, available_at: now, seen };
        self.jobs.insert(expected.seen.id, expected);
    }

    /// Sort key of a job in its lane; the smallest key is claimed first.
    fn place(&self, id: JobId) -> (std::cmp::Reverse<Priority>, i64, JobId) {
        let job = &self.jobs[&id];
        (std::cmp::Reverse(job.seen.priority), job.turn, id)
    }

    /// The jobs that a claim should return: repeatedly the best of the heads of all lanes.
    fn due(&self, now: Timestamp, limit: u32) -> Vec<JobId> {
        let ready = |job: &Expected| job.state.status == Status::Queued && job.available_at <= now;
        let mut left: Vec<JobId> = self.jobs.iter().filter(|(_, job)| ready(job)).map(|(id, _)| *id).collect();
        let mut due = Vec::new();
        while due.len() < limit as usize && !left.is_empty() {
            let of = |lane| left.iter().filter(move |id| self.jobs[id].seen.backend.requested == lane);
            let heads = LANES.iter().filter_map(|lane| of(*lane).min_by_key(|id| self.place(**id)));
            let first = *heads.min_by_key(|id| (self.place(**id).0, **id)).unwrap();
            left.retain(|id| *id != first);
            due.push(first);
        }
        due
    }

    async fn cancel(&mut self, word: u32) {
        let Some(id) = self.pick(word) else { return };
        self.apply(id, &Event::Cancel);
        self.bench.store.cancel(id).await.unwrap().unwrap();
    }

    async fn delete(&mut self, word: u32) {
        let Some(id) = self.pick(word) else { return };
        let mut keys = self.bench.store.delete(id).await.unwrap().unwrap();
        let gone = self.jobs.remove(&id).unwrap().seen.files;
        let kept: Vec<&File> = self.jobs.values().flat_map(|job| &job.seen.files).collect();
        let mut alone: Vec<String> =
            gone.into_iter().map(|file| file.key).filter(|key| !kept.iter().any(|file| file.key == *key)).collect();
        keys.sort();
        alone.sort();
        alone.dedup();
        assert_eq!(keys, alone);
    }

    async fn claim(&mut self, worker: &str, limit: u32) {
        let now = self.bench.clock.now();
        let expired = |job: &Expected| job.state.status == Status::Running && job.lease_until <= now;
        let ids: Vec<JobId> = self.jobs.iter().filter(|(_, job)| expired(job)).map(|(id, _)| *id).collect();
        // A claim shortly after another may not look for expired leases.
        let looks = now.duration_since(self.claimed_at) >= LOOKS_EVERY;
        if looks && self.hook.has_lost.swap(false, Ordering::Relaxed) {
            self.expires_from = now + LEASE;
        }
        let may_leave = !looks || now < self.expires_from;
        self.claimed_at = now;
        let claimed = self.bench.store.claim(worker, ClaimScope::Cpu, LEASE, limit).await.unwrap();
        let is_left = match ids.first() {
            Some(id) if may_leave => {
                let job = self.bench.get(*id).await;
                (job.status, job.attempts) == (Status::Running, self.jobs[id].state.attempts)
            }
            _ => false,
        };
        if !is_left {
            for id in ids {
                assert!(self.apply(id, &Event::Expire));
            }
        }
        let expected = self.due(now, limit);
        assert_eq!(claimed.iter().map(|claimed| claimed.job().id).collect::<Vec<_>>(), expected);
        for claimed in claimed {
            let id = claimed.job().id;
            assert!(self.apply(id, &Event::Claim(worker.to_owned())));
            let fence = Fence { attempt: claimed.attempt(), worker: worker.to_owned() };
            self.held.push(Held { id, fence, claimed });
        }
    }

    async fn beat(&mut self, word: u32) {
        if self.held.is_empty() {
            return;
        }
        let n = below(word, self.held.len() as u32) as usize;
        let (id, fence) = (self.held[n].id, self.held[n].fence.clone());
        let told = self.bench.beat(&self.held[n].claimed).await;
        let expected = match (self.apply(id, &Event::Renew(fence)), self.jobs.get(&id)) {
            (true, Some(job)) if job.state.cancel_requested => Directive::Cancel,
            (true, _) => Directive::Continue,
            (false, _) => Directive::Lost,
        };
        assert_eq!(told, expected);
    }

    async fn end(&mut self, word: u32, how: u32) {
        if self.held.is_empty() {
            return;
        }
        let Held { id, fence, claimed } = self.held.swap_remove(below(word, self.held.len() as u32) as usize);
        let store = &self.bench.store;
        let (result, how) = match how {
            0 => {
                let done = finished(&claimed);
                (store.finish(claimed, done).await.map(drop), AttemptEnd::Succeeded)
            }
            1 => (store.fail(claimed, by_cpu(), problem("panic")).await.map(drop), AttemptEnd::Failed),
            2 => (store.cancelled(claimed).await.map(drop), AttemptEnd::Cancelled),
            3 => (store.release(claimed, None).await, AttemptEnd::Released),
            _ => (store.retry(claimed, problem("io")).await.map(drop), AttemptEnd::Retried),
        };
        match (result, self.apply(id, &Event::End(fence, how))) {
            (Ok(()), true) | (Err(StoreError::Fenced), false) => {}
            other => panic!("{how:?}: {other:?}"),
        }
    }

    async fn compare(&mut self, context: &str) {
        let page = self.bench.store.list(&ListFilter { limit: 1000, ..ListFilter::default() }).await.unwrap();
        assert_eq!(page.jobs.len(), self.jobs.len(), "{context}");
        let mut counts = Counts::default();
        for job in self.jobs.values() {
            *counts.of_mut(job.state.status) += 1;
        }
        assert_eq!(self.bench.store.counts().await.unwrap(), counts, "{context}");
        for (id, job) in self.jobs.iter().filter(|(_, job)| job.state.status == Status::Queued) {
            let lane = self.jobs.iter().filter(|(_, other)| {
                other.state.status == Status::Queued && other.seen.backend.requested == job.seen.backend.requested
            });
            let ahead = lane.filter(|(other, _)| self.place(**other) < self.place(*id)).count() as u64;
            let told = page.jobs.iter().find(|told| told.id == *id).unwrap().queue_position;
            assert_eq!(told, Some(ahead), "{context}");
        }
        for job in page.jobs {
            let expected = self.jobs.get_mut(&job.id).unwrap();
            let state = &expected.state;
            assert_eq!(
                (job.status, job.attempts, job.cancel_requested),
                (state.status, state.attempts, state.cancel_requested),
                "{context}"
            );
            assert_eq!(job.finished_at.is_some(), job.status.is_ended(), "{context}");
            assert_eq!(job.files.is_empty(), job.status != Status::Succeeded, "{context}");
            assert_eq!(job.problem.is_some(), job.status == Status::Failed, "{context}");
            if expected.seen.status.is_ended() {
                assert_eq!(job, expected.seen, "{context}: an ended job changed");
            }
            // The queue position depends on the other jobs.
            let before = Job { queue_position: None, ..expected.seen.clone() };
            let after = Job { queue_position: None, ..job.clone() };
            assert_eq!(
                after.version > before.version,
                after != before,
                "{context}: the version does not follow the changes"
            );
            expected.seen = job;
        }
    }
}
