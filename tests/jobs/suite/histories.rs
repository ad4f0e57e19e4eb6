//! Random histories: after every step the store agrees with the pure state machine, and no ended job changes.

use super::*;
use oviduct::jobs::state::{Event, Fence, Next, State, retry_delay};
use oviduct::random::{Stream, below, words};

const MAX_ATTEMPTS: u32 = 3;

/// What the store should hold of a job.
struct Expected {
    state: State,
    lease_until: Timestamp,
    available_at: Timestamp,
    seen: Job,
}

/// A claim that was not consumed yet; it may be stale.
struct Held {
    id: JobId,
    fence: Fence,
    claimed: ClaimedJob,
}

struct History {
    bench: Bench,
    jobs: BTreeMap<JobId, Expected>,
    held: Vec<Held>,
}

pub async fn random_histories_agree_with_the_state_machine(factory: Factory) {
    for seed in 1..=4 {
        let bench = bench(factory, |options| options.max_attempts = MAX_ATTEMPTS).await;
        let mut history = History { bench, jobs: BTreeMap::new(), held: Vec::new() };
        for step in 0..250 {
            let [op, pick, worker, amount] = words(seed, Stream::Growth, step, 0);
            let context = format!("seed {seed}, step {step}");
            match below(op, 16) {
                0..=2 => history.submit(step).await,
                3 => history.cancel(pick).await,
                4 => history.delete(pick).await,
                5..=8 => history.claim(["a", "b", "c"][below(worker, 3) as usize], 1 + below(amount, 2)).await,
                9 => history.beat(pick).await,
                10..=13 => history.end(pick, below(amount, 5)).await,
                _ => history.bench.clock.advance(Duration::from_millis(u64::from(below(amount, 6000)))),
            }
            history.compare(&context).await;
        }
        let ended = history.jobs.values().filter(|job| job.state.status.is_ended()).count();
        assert!(ended > 10, "seed {seed} ended only {ended} jobs: it shows too little");
    }
}

impl History {
    fn pick(&self, word: u32) -> Option<JobId> {
        let n = below(word, (self.jobs.len() as u32).max(1));
        self.jobs.keys().nth(n as usize).copied()
    }

    /// Applies an event to what is expected; whether the store should have accepted it.
    fn apply(&mut self, id: JobId, event: &Event) -> bool {
        let now = self.bench.clock.now();
        let Some(job) = self.jobs.get_mut(&id) else { return false };
        let Ok(Next { state, .. }) = job.state.on(event, MAX_ATTEMPTS) else { return false };
        match event {
            Event::Claim(_) | Event::Renew(_) => job.lease_until = now + LEASE,
            Event::Retry(_) => job.available_at = now + retry_delay(state.spent),
            Event::Release(_) | Event::Expire => job.available_at = now,
            _ => {}
        }
        job.state = state;
        true
    }

    async fn submit(&mut self, step: u32) {
        let seen = self.bench.queue(&step.to_string()).await;
        let now = self.bench.clock.now();
        self.jobs.insert(seen.id, Expected { state: State::queued(), lease_until: now, available_at: now, seen });
    }

    async fn cancel(&mut self, word: u32) {
        let Some(id) = self.pick(word) else { return };
        self.apply(id, &Event::Cancel);
        self.bench.store.cancel(id).await.unwrap().unwrap();
    }

    async fn delete(&mut self, word: u32) {
        let Some(id) = self.pick(word) else { return };
        let keys = self.bench.store.delete(id).await.unwrap().unwrap();
        assert_eq!(keys.len(), self.jobs.remove(&id).unwrap().seen.files.len());
    }

    async fn claim(&mut self, worker: &str, limit: u32) {
        let now = self.bench.clock.now();
        let expired = |job: &Expected| job.state.status == Status::Running && job.lease_until <= now;
        let ids: Vec<JobId> = self.jobs.iter().filter(|(_, job)| expired(job)).map(|(id, _)| *id).collect();
        for id in ids {
            assert!(self.apply(id, &Event::Expire));
        }
        let ready = |job: &Expected| job.state.status == Status::Queued && job.available_at <= now;
        let ids: Vec<JobId> = self.jobs.iter().filter(|(_, job)| ready(job)).map(|(id, _)| *id).collect();
        let expected = &ids[..ids.len().min(limit as usize)];
        let claimed = self.bench.store.claim(worker, Backend::Cpu, LEASE, limit).await.unwrap();
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
        let (result, event) = match how {
            0 => {
                let done = finished(&claimed);
                (store.finish(claimed, done).await.map(drop), Event::Finish(fence))
            }
            1 => (store.fail(claimed, by_cpu(), problem("panic")).await.map(drop), Event::Fail(fence)),
            2 => (store.cancelled(claimed).await.map(drop), Event::Stopped(fence)),
            3 => (store.release(claimed).await, Event::Release(fence)),
            _ => (store.retry(claimed, problem("io")).await.map(drop), Event::Retry(fence)),
        };
        match (result, self.apply(id, &event)) {
            (Ok(()), true) | (Err(StoreError::Fenced), false) => {}
            other => panic!("{event:?}: {other:?}"),
        }
    }

    async fn compare(&mut self, context: &str) {
        let page = self.bench.store.list(&ListFilter { limit: 1000, ..ListFilter::default() }).await.unwrap();
        assert_eq!(page.jobs.len(), self.jobs.len(), "{context}");
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
            // The position in the queue follows from the other jobs.
            let before = Job { queue_position: None, ..expected.seen.clone() };
            let after = Job { queue_position: None, ..job.clone() };
            assert_eq!(after.version > before.version, after != before, "{context}: the version does not tell");
            expected.seen = job;
        }
    }
}
