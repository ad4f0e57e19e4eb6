//! The state machine of a job, as a pure function of state and event.
//!
//! Both databases apply [`JobState::on`] inside the transaction and write the result, so they
//! agree. Invariants, tested as properties below:
//!
//! - A job that has ended never changes.
//! - An event of a worker is refused unless it carries the number and the holder of the current
//!   attempt.
//! - Attempt numbers only grow.
//! - A job that was cancelled while it was running ends as cancelled, by whichever event ends it.
//! - A job that is not cancelled ends after at most `max_attempts` counted attempts.

use super::job::{JobKind, Status};
use crate::generate::{Backend, UsedBackend};
use jiff::Timestamp;
use std::time::Duration;

/// The part of a job's record that decides which events are allowed.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct JobState {
    /// Status.
    pub status: Status,
    /// Number of the last attempt, from 1; 0 before the first.
    pub attempts: u32,
    /// Number of counted attempts: attempts whose worker vanished, or that ended with a transient
    /// error. Released attempts do not count.
    pub spent: u32,
    /// True if a client cancelled the job while it was running.
    pub cancel_requested: bool,
    /// Worker that holds the lease; `None` unless running.
    pub holder: Option<String>,
}

/// Worker name and attempt number that every write of a worker carries; outdated writes are
/// refused.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Fence {
    /// Number of the attempt.
    pub attempt: u32,
    /// Name of the worker.
    pub worker: String,
}

/// An event in the life of a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// A client cancels the job.
    Cancel,
    /// This worker claims the job.
    Claim(String),
    /// The lease has expired.
    Expire,
    /// The holder renews its lease.
    Renew(Fence),
    /// The holder ends its attempt.
    End(Fence, AttemptEnd),
}

/// How an attempt ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AttemptEnd {
    /// The attempt finished the model.
    Succeeded,
    /// The attempt met an error that would occur in every attempt.
    Failed,
    /// A client cancelled the job.
    Cancelled,
    /// The worker released the job; not counted.
    Released,
    /// The attempt met a transient error; counted.
    Retried,
    /// The lease expired; counted.
    Vanished,
}

/// Result of an event.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Next {
    /// State of the job after the event.
    pub state: JobState,
    /// How the attempt ended, if the event ended one.
    pub ended: Option<AttemptEnd>,
    /// True if the job failed because no attempts are left.
    pub exhausted: bool,
}

/// Reason why an event changes nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// The job has ended.
    Ended,
    /// The state does not allow the event: a claim of a running job, an expiry of a queued job.
    NotNow,
    /// The writer does not hold the current attempt.
    Fenced,
}

impl Next {
    /// The result of an event that ends no attempt.
    fn without_end(state: JobState) -> Self {
        Self { state, ended: None, exhausted: false }
    }
}

impl JobState {
    /// The state of a new job.
    #[must_use]
    pub fn queued() -> Self {
        Self { status: Status::Queued, attempts: 0, spent: 0, cancel_requested: false, holder: None }
    }

    /// The result of `event`.
    ///
    /// # Errors
    /// [`Refused`] with the reason; the state stays unchanged.
    pub fn on(&self, event: &Event, max_attempts: u32) -> Result<Next, Refused> {
        if self.status.is_ended() {
            return Err(match event {
                Event::Cancel | Event::Claim(_) | Event::Expire => Refused::Ended,
                _ => Refused::Fenced,
            });
        }
        let running = self.status == Status::Running;
        match event {
            Event::Cancel if running => Ok(Next::without_end(Self { cancel_requested: true, ..self.clone() })),
            Event::Cancel => Ok(Next::without_end(Self { status: Status::Cancelled, ..self.clone() })),
            Event::Claim(_) | Event::Expire if running != matches!(event, Event::Expire) => Err(Refused::NotNow),
            Event::Claim(worker) => Ok(Next::without_end(Self {
                status: Status::Running,
                attempts: self.attempts + 1,
                holder: Some(worker.clone()),
                ..self.clone()
            })),
            Event::Expire => Ok(self.again(AttemptEnd::Vanished, max_attempts)),
            Event::Renew(fence) => self.held_by(fence).map(|()| Next::without_end(self.clone())),
            Event::End(fence, how) => self.held_by(fence).map(|()| match how {
                AttemptEnd::Succeeded | AttemptEnd::Failed if self.cancel_requested => {
                    self.ends(Status::Cancelled, AttemptEnd::Cancelled)
                }
                AttemptEnd::Succeeded => self.ends(Status::Succeeded, *how),
                AttemptEnd::Failed => self.ends(Status::Failed, *how),
                AttemptEnd::Cancelled => self.ends(Status::Cancelled, *how),
                AttemptEnd::Released | AttemptEnd::Retried | AttemptEnd::Vanished => self.again(*how, max_attempts),
            }),
        }
    }

    fn held_by(&self, fence: &Fence) -> Result<(), Refused> {
        let held = self.status == Status::Running
            && self.attempts == fence.attempt
            && self.holder.as_deref() == Some(fence.worker.as_str());
        if held { Ok(()) } else { Err(Refused::Fenced) }
    }

    fn ends(&self, status: Status, how: AttemptEnd) -> Next {
        Next { state: Self { status, holder: None, ..self.clone() }, ended: Some(how), exhausted: false }
    }

    /// The attempt ended without a result: the job returns to the queue, unless it was cancelled or
    /// no attempts are left.
    fn again(&self, how: AttemptEnd, max_attempts: u32) -> Next {
        let spent = self.spent + u32::from(how != AttemptEnd::Released);
        let exhausted = !self.cancel_requested && spent >= max_attempts && how != AttemptEnd::Released;
        let status = if self.cancel_requested {
            Status::Cancelled
        } else if exhausted {
            Status::Failed
        } else {
            Status::Queued
        };
        Next { state: Self { status, spent, holder: None, ..self.clone() }, ended: Some(how), exhausted }
    }
}

/// Maximum duration of a lease. A lease that ends later was given before the clock was set back.
pub const MAX_LEASE: Duration = Duration::from_secs(600);
/// Maximum difference between the clock of leases and the time that has passed, between two looks at
/// the queue, that does not count as a step of the clock.
const CLOCK_TOLERANCE: Duration = Duration::from_secs(2);

/// True if a lease is over at `now`.
#[must_use]
pub fn is_expired(lease_until: Timestamp, now: Timestamp) -> bool {
    lease_until <= now || lease_until.duration_since(now).unsigned_abs() > MAX_LEASE
}

/// Looks of a process at the queue since the last outage, by the clock of leases.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Looks {
    first: Timestamp,
    latest: Timestamp,
    /// Time since the start of the process at the latest look.
    elapsed: Duration,
}

impl Looks {
    /// Notes a look at `now`, `elapsed` after the start of the process. Returns true if leases that
    /// have expired by then may be ended: since the database became available, and since its clock
    /// was last set, their holders had a whole `lease` to renew them.
    pub fn may_expire(looks: &mut Option<Self>, now: Timestamp, elapsed: Duration, lease: Duration) -> bool {
        let first = looks.filter(|looks| looks.agree(now, elapsed)).map_or(now, |looks| looks.first);
        *looks = Some(Self { first, latest: now, elapsed });
        now.duration_since(first).unsigned_abs() >= lease
    }

    /// True if the clock was not set between the latest look and `now`.
    fn agree(&self, now: Timestamp, elapsed: Duration) -> bool {
        let passed = now.duration_since(self.latest).as_secs_f64();
        let error = passed - elapsed.saturating_sub(self.elapsed).as_secs_f64();
        error.abs() < CLOCK_TOLERANCE.as_secs_f64()
    }
}

/// Delay before a job can be claimed again after a transient error, by the number of counted
/// attempts: 1 s, doubled for each further attempt, at most 60 s.
#[must_use]
pub fn retry_delay(spent: u32) -> Duration {
    Duration::from_secs(1 << spent.saturating_sub(1).min(6)).min(Duration::from_secs(60))
}

/// Lane of the queue in which a job waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lane {
    /// Models for a GPU if one is available, otherwise for a CPU.
    Auto,
    /// Models for a GPU.
    Gpu,
    /// Models for all threads of a CPU worker.
    Cpu,
    /// Models for one thread.
    CpuSingle,
    /// Fits, which CPU workers run beside models.
    Fit,
}

impl Lane {
    /// Lane of a job of this kind and requested backend.
    #[must_use]
    pub fn of(kind: JobKind, backend: Backend) -> Self {
        match (kind, backend) {
            (JobKind::Fit, _) => Self::Fit,
            (JobKind::Model, Backend::Auto) => Self::Auto,
            (JobKind::Model, Backend::Gpu) => Self::Gpu,
            (JobKind::Model, Backend::Cpu) => Self::Cpu,
            (JobKind::Model, Backend::CpuSingle) => Self::CpuSingle,
        }
    }
}

/// Jobs that a claim may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClaimScope {
    /// The claim of a GPU worker: models that requested a GPU or any backend.
    Gpu,
    /// The claim of a CPU worker: models that requested a CPU or any backend.
    Cpu,
    /// The claim of a CPU worker that leaves models of `auto` to a GPU worker.
    CpuOnly,
    /// The claim of a CPU worker that runs a longer model: the short models of [`Self::Cpu`].
    CpuShort,
    /// The short models of [`Self::CpuOnly`].
    CpuOnlyShort,
    /// The claim of a CPU worker that takes a fit.
    Fits,
}

impl ClaimScope {
    /// Lanes of the jobs.
    #[must_use]
    pub fn lanes(self) -> &'static [Lane] {
        match self {
            Self::Gpu => &[Lane::Auto, Lane::Gpu],
            Self::Cpu | Self::CpuShort => &[Lane::Auto, Lane::Cpu, Lane::CpuSingle],
            Self::CpuOnly | Self::CpuOnlyShort => &[Lane::Cpu, Lane::CpuSingle],
            Self::Fits => &[Lane::Fit],
        }
    }

    /// True for claims of short models; see [`NewJob::short`](super::NewJob::short).
    pub(super) fn is_of_short_models(self) -> bool {
        matches!(self, Self::CpuShort | Self::CpuOnlyShort)
    }
}

/// True if a model grown on `used` may be reused for a request of `requested`. `cpu` and
/// `cpu-single` produce the same bytes.
#[must_use]
pub fn same_bytes(requested: Backend, used: UsedBackend) -> bool {
    match requested {
        Backend::Auto => true,
        Backend::Gpu => used == UsedBackend::Gpu,
        Backend::Cpu | Backend::CpuSingle => used != UsedBackend::Gpu,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn fence() -> impl Strategy<Value = Fence> {
        (0u32..6, "[ab]").prop_map(|(attempt, worker)| Fence { attempt, worker })
    }

    fn event() -> impl Strategy<Value = Event> {
        prop_oneof![
            1 => Just(Event::Cancel),
            6 => "[ab]".prop_map(Event::Claim),
            3 => Just(Event::Expire),
            2 => fence().prop_map(Event::Renew),
            1 => fence().prop_map(|fence| Event::End(fence, AttemptEnd::Succeeded)),
            1 => fence().prop_map(|fence| Event::End(fence, AttemptEnd::Failed)),
            1 => fence().prop_map(|fence| Event::End(fence, AttemptEnd::Cancelled)),
            3 => fence().prop_map(|fence| Event::End(fence, AttemptEnd::Released)),
            3 => fence().prop_map(|fence| Event::End(fence, AttemptEnd::Retried)),
        ]
    }

    proptest! {
        #[test]
        fn invariants_hold_over_any_history(events in prop::collection::vec(event(), 0..60), max in 1u32..5) {
            let mut state = JobState::queued();
            let mut ends = 0;
            for event in &events {
                let before = state.clone();
                match state.on(event, max) {
                    Ok(next) => {
                        prop_assert!(!before.status.is_ended(), "an ended job changed");
                        prop_assert!(next.state.attempts >= before.attempts);
                        prop_assert!(next.state.spent <= max);
                        prop_assert!(next.state.spent <= next.state.attempts);
                        prop_assert_eq!(next.state.holder.is_some(), next.state.status == Status::Running);
                        prop_assert_eq!(
                            next.ended.is_some(),
                            before.status == Status::Running && next.state.status != Status::Running
                        );
                        prop_assert!(!next.exhausted || next.state.status == Status::Failed);
                        if before.cancel_requested && next.ended.is_some() {
                            prop_assert_eq!(next.state.status, Status::Cancelled);
                        }
                        if let Event::End(f, _) | Event::Renew(f) = event {
                            prop_assert_eq!(f.attempt, before.attempts);
                            prop_assert_eq!(Some(&f.worker), before.holder.as_ref());
                        }
                        ends += u32::from(next.state.status.is_ended());
                        state = next.state;
                    }
                    Err(_) => prop_assert_eq!(&state, &before),
                }
            }
            prop_assert!(ends <= 1, "ended {} times", ends);
        }

        #[test]
        fn vanishing_workers_end_a_job_after_max_attempts(max in 1u32..8) {
            let mut state = JobState::queued();
            for n in 1..=max {
                state = state.on(&Event::Claim("a".into()), max).unwrap().state;
                let next = state.on(&Event::Expire, max).unwrap();
                prop_assert_eq!(next.exhausted, n == max);
                state = next.state;
            }
            prop_assert_eq!(state.status, Status::Failed);
        }
    }

    #[test]
    fn a_released_attempt_does_not_count() {
        let mut state = JobState::queued();
        for attempt in 1..=20 {
            state = state.on(&Event::Claim("a".into()), 2).unwrap().state;
            state =
                state.on(&Event::End(Fence { attempt, worker: "a".into() }, AttemptEnd::Released), 2).unwrap().state;
            assert_eq!((state.status, state.spent, state.attempts), (Status::Queued, 0, attempt));
        }
    }

    #[test]
    fn an_attempt_asked_to_stop_is_not_tried_again() {
        let running = JobState::queued().on(&Event::Claim("a".into()), 5).unwrap().state;
        let asked = running.on(&Event::Cancel, 5).unwrap().state;
        assert_eq!(asked.status, Status::Running);
        let fence = Fence { attempt: 1, worker: "a".into() };
        let ends = [AttemptEnd::Released, AttemptEnd::Retried].map(|how| Event::End(fence.clone(), how));
        for event in ends.into_iter().chain([Event::Expire]) {
            assert_eq!(asked.on(&event, 5).unwrap().state.status, Status::Cancelled);
        }
    }

    #[test]
    fn each_backend_has_a_claim_and_its_models_are_reused() {
        for scope in [ClaimScope::Gpu, ClaimScope::Cpu, ClaimScope::CpuOnly] {
            assert_eq!(scope.lanes().contains(&Lane::Auto), scope != ClaimScope::CpuOnly);
            assert!(!scope.lanes().contains(&Lane::Fit), "fits are claimed separately");
        }
        for used in [UsedBackend::Gpu, UsedBackend::Cpu, UsedBackend::CpuSingle] {
            let scope = if used == UsedBackend::Gpu { ClaimScope::Gpu } else { ClaimScope::Cpu };
            assert!(scope.lanes().contains(&Lane::of(JobKind::Model, used.into())));
            assert!(same_bytes(used.into(), used) && same_bytes(Backend::Auto, used));
        }
        assert!(!same_bytes(Backend::Cpu, UsedBackend::Gpu) && !same_bytes(Backend::Gpu, UsedBackend::Cpu));
    }
}
