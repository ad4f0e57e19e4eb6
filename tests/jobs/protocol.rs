//! A model of the protocol of jobs, whose states are all visited: claim, renewal, expiry, end and
//! sharing, with processes that are killed, a clock that steps, and commits whose response is lost.
//! The transitions are those of the program: [`JobState::on`], [`Looks::may_expire`] and
//! [`is_expired`].
//!
//! A tick is a heartbeat. Time passes only when every live holder has renewed its lease and every
//! idle worker has looked at the queue. The clock
//! of the store is the time plus an offset, which steps change. A worker belongs to a process of
//! its own; a process that is killed starts again under another name.

use jiff::Timestamp;
use oviduct::jobs::Status;
use oviduct::jobs::state::{AttemptEnd, Event, Fence, JobState, Looks, is_expired};
use stateright::{Checker, Expectation, Model, Property};
use std::time::Duration;

const HEARTBEAT: u64 = 2;
const LEASE: Duration = Duration::from_secs(2 * HEARTBEAT);
/// Steps of the clock, s: a little more than a lease, and more than any lease.
const STEPS: [i64; 3] = [-7200, -5, 7200];
const MAX_ATTEMPTS: u32 = 2;

/// Bounds of the model.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    workers: usize,
    ticks: u64,
    kills: u8,
    steps: u8,
    losses: u8,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Worker {
    /// Looks at the queue once a tick.
    Idle {
        looked: Option<u64>,
    },
    /// Runs the attempt.
    Holds {
        attempt: u32,
        renewed: u64,
    },
    /// The claim of this attempt was committed, but its response was lost.
    Claiming {
        attempt: u32,
    },
    /// The end of this attempt may have been committed.
    Ending {
        attempt: u32,
    },
    Killed,
}

/// The job that waits for the growth of an equal one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Follower {
    status: Status,
    waits: bool,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct System {
    /// Ticks since the beginning.
    time: u64,
    /// Offset of the store's clock, s.
    offset: i64,
    job: JobState,
    lease_until: Timestamp,
    /// Attempt and worker of the recorded success.
    success: Option<(u32, String)>,
    follower: Follower,
    workers: Vec<Worker>,
    /// Number of starts of each process, and its looks at the queue.
    processes: Vec<(u8, Option<Looks>)>,
    cancels: u8,
    kills: u8,
    steps: u8,
    losses: u8,
    /// A rule was broken by the last action.
    broken: Option<&'static str>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Act {
    Tick,
    Step(i64),
    Claim {
        worker: usize,
        is_lost: bool,
    },
    /// The store looks for a claim whose response was lost.
    RecoverClaim(usize),
    Renew(usize),
    End {
        worker: usize,
        how: AttemptEnd,
        is_lost: bool,
    },
    /// The store looks for an end whose response was lost.
    RecoverEnd(usize),
    Cancel,
    Kill(usize),
    Start(usize),
}

impl System {
    fn now(&self) -> Timestamp {
        let begin: Timestamp = "2026-01-02T03:04:05Z".parse().unwrap();
        begin + Duration::from_secs(100_000 + self.time * HEARTBEAT) + jiff::SignedDuration::from_secs(self.offset)
    }

    fn name(&self, worker: usize) -> String {
        format!("{worker}-{}", self.processes[worker].0)
    }

    fn fence(&self, worker: usize, attempt: u32) -> Fence {
        Fence { attempt, worker: self.name(worker) }
    }

    /// Writes the result of an event, and what follows for the job that waits.
    fn write(&mut self, event: &Event) -> bool {
        let Ok(next) = self.job.on(event, MAX_ATTEMPTS) else { return false };
        if self.job.status.is_ended() && next.state != self.job {
            self.broken = Some("an ended job changed");
        }
        if self.job.cancel_requested && matches!(next.state.status, Status::Succeeded | Status::Failed) {
            self.broken = Some("a cancelled job succeeded or failed");
        }
        let before = std::mem::replace(&mut self.job, next.state);
        if self.job.status.is_ended() && !before.status.is_ended() && self.follower.waits {
            self.follower = match self.job.status {
                Status::Cancelled => Follower { status: Status::Queued, waits: false },
                status => Follower { status, waits: false },
            };
        }
        true
    }

    /// True if a live worker runs the present attempt and renewed its lease in the last heartbeat.
    fn is_held_alive(&self) -> bool {
        self.workers.iter().enumerate().any(|(worker, state)| {
            let Worker::Holds { attempt, renewed } = state else { return false };
            let holds = self.job.holder.as_deref() == Some(self.name(worker).as_str()) && self.job.attempts == *attempt;
            holds && renewed + 1 >= self.time
        })
    }

    fn claim(&mut self, worker: usize, is_lost: bool) {
        let (now, elapsed) = (self.now(), Duration::from_secs(self.time * HEARTBEAT));
        let may_expire = Looks::may_expire(&mut self.processes[worker].1, now, elapsed, LEASE);
        if may_expire && self.job.status == Status::Running && is_expired(self.lease_until, now) {
            if self.is_held_alive() {
                self.broken = Some("the lease of a live worker expired");
            }
            self.write(&Event::Expire);
        }
        if self.write(&Event::Claim(self.name(worker))) {
            self.lease_until = now + LEASE;
            let attempt = self.job.attempts;
            self.workers[worker] =
                if is_lost { Worker::Claiming { attempt } } else { Worker::Holds { attempt, renewed: self.time } };
            self.losses += u8::from(is_lost);
        } else {
            self.workers[worker] = Worker::Idle { looked: Some(self.time) };
        }
    }

    /// The job is still claimed by this attempt; its lease begins again.
    fn renew(&mut self, worker: usize, attempt: u32) {
        let fence = self.fence(worker, attempt);
        self.workers[worker] = if self.job.on(&Event::Renew(fence), MAX_ATTEMPTS).is_ok() {
            self.lease_until = self.now() + LEASE;
            Worker::Holds { attempt, renewed: self.time }
        } else {
            Worker::Idle { looked: None }
        };
    }

    fn end(&mut self, worker: usize, attempt: u32, how: AttemptEnd, is_lost: bool) {
        let fence = self.fence(worker, attempt);
        if self.write(&Event::End(fence.clone(), how)) && self.job.status == Status::Succeeded {
            if self.success.is_some() {
                self.broken = Some("a job succeeded twice");
            }
            self.success = Some((fence.attempt, fence.worker));
        }
        self.losses += u8::from(is_lost);
        self.workers[worker] = if is_lost { Worker::Ending { attempt } } else { Worker::Idle { looked: None } };
    }
}

impl Model for Bounds {
    type State = System;
    type Action = Act;

    fn init_states(&self) -> Vec<System> {
        vec![System {
            time: 0,
            offset: 0,
            job: JobState::queued(),
            lease_until: Timestamp::MIN,
            success: None,
            follower: Follower { status: Status::Queued, waits: true },
            workers: vec![Worker::Idle { looked: None }; self.workers],
            processes: vec![(0, None); self.workers],
            cancels: 0,
            kills: 0,
            steps: 0,
            losses: 0,
            broken: None,
        }]
    }

    fn actions(&self, system: &System, actions: &mut Vec<Act>) {
        let is_fresh = |worker: &Worker| match worker {
            Worker::Holds { renewed, .. } => *renewed == system.time,
            Worker::Idle { looked } => *looked == Some(system.time),
            _ => true,
        };
        if system.time < self.ticks && system.workers.iter().all(is_fresh) {
            actions.push(Act::Tick);
        }
        if system.steps < self.steps {
            actions.extend(STEPS.map(Act::Step));
        }
        let losses = if system.losses < self.losses { &[false, true][..] } else { &[false] };
        for (worker, state) in system.workers.iter().enumerate() {
            match state {
                Worker::Idle { looked } if *looked == Some(system.time) => {}
                Worker::Idle { .. } => actions.extend(losses.iter().map(|&is_lost| Act::Claim { worker, is_lost })),
                Worker::Holds { renewed, .. } => {
                    if *renewed < system.time {
                        actions.push(Act::Renew(worker));
                    }
                    for how in [AttemptEnd::Succeeded, AttemptEnd::Released, AttemptEnd::Retried] {
                        actions.extend(losses.iter().map(|&is_lost| Act::End { worker, how, is_lost }));
                    }
                }
                Worker::Claiming { .. } => actions.push(Act::RecoverClaim(worker)),
                Worker::Ending { .. } => actions.push(Act::RecoverEnd(worker)),
                Worker::Killed => actions.push(Act::Start(worker)),
            }
            if system.kills < self.kills && *state != Worker::Killed {
                actions.push(Act::Kill(worker));
            }
        }
        if system.cancels == 0 {
            actions.push(Act::Cancel);
        }
    }

    fn next_state(&self, system: &System, action: Act) -> Option<System> {
        let mut next = System { broken: None, ..system.clone() };
        match action {
            Act::Tick => next.time += 1,
            Act::Step(by) => (next.offset, next.steps) = (next.offset + by, next.steps + 1),
            Act::Claim { worker, is_lost } => next.claim(worker, is_lost),
            Act::RecoverClaim(worker) => {
                let Worker::Claiming { attempt } = next.workers[worker] else { return None };
                next.renew(worker, attempt);
            }
            Act::Renew(worker) => {
                let Worker::Holds { attempt, .. } = next.workers[worker] else { return None };
                next.renew(worker, attempt);
            }
            Act::End { worker, how, is_lost } => {
                let Worker::Holds { attempt, .. } = next.workers[worker] else { return None };
                next.end(worker, attempt, how, is_lost);
            }
            Act::RecoverEnd(worker) => {
                let Worker::Ending { attempt } = next.workers[worker] else { return None };
                let done = Some((attempt, next.name(worker)));
                if next.success == done {
                    next.workers[worker] = Worker::Idle { looked: None };
                } else {
                    // Runs again; the fence refuses it if the attempt has ended.
                    next.end(worker, attempt, AttemptEnd::Succeeded, false);
                }
            }
            Act::Cancel => {
                next.cancels += 1;
                next.write(&Event::Cancel);
            }
            Act::Kill(worker) => {
                next.kills += 1;
                next.workers[worker] = Worker::Killed;
            }
            Act::Start(worker) => {
                next.processes[worker] = (next.processes[worker].0 + 1, None);
                next.workers[worker] = Worker::Idle { looked: None };
            }
        }
        (next != *system).then_some(next)
    }

    /// Released attempts do not count, so their number has no limit of its own.
    fn within_boundary(&self, system: &System) -> bool {
        system.job.attempts <= 3
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always("no rule is broken", |_, system: &System| system.broken.is_none()),
            Property::always("only a running job has a holder", |_, system: &System| {
                (system.job.status == Status::Running) == system.job.holder.is_some()
            }),
            Property::always("no more attempts count than are allowed", |_, system: &System| {
                system.job.spent <= MAX_ATTEMPTS
            }),
            Property::always("no job waits for one that has ended", |_, system: &System| {
                !(system.follower.waits && system.job.status.is_ended())
            }),
            Property::always("a success is recorded with the attempt that made it", |_, system: &System| {
                (system.job.status == Status::Succeeded) == system.success.is_some()
            }),
            Property::sometimes("the job of a killed worker succeeds", |_, system: &System| {
                system.kills > 0 && system.job.attempts > 1 && system.job.status == Status::Succeeded
            }),
            Property::sometimes("a lease from before a step back expires", |_, system: &System| {
                system.offset < -600 && system.job.spent > 0
            }),
        ]
    }
}

fn check(bounds: Bounds) {
    let checker = bounds.checker().threads(2).spawn_bfs().join();
    eprintln!("{bounds:?}: {} states", checker.unique_state_count());
    for property in bounds.properties() {
        match property.expectation {
            // Without a step, no clock is set back.
            Expectation::Sometimes if bounds.steps == 0 && property.name.contains("step back") => {}
            Expectation::Sometimes => drop(checker.assert_any_discovery(property.name)),
            _ => checker.assert_no_discovery(property.name),
        }
    }
}

/// `scripts/test night` sets `OVIDUCT_TEST_NIGHT`, for a larger bound.
#[test]
fn every_state_within_bounds_keeps_the_rules() {
    check(Bounds { workers: 2, ticks: 5, kills: 1, steps: 1, losses: 0 });
    check(Bounds { workers: 2, ticks: 4, kills: 1, steps: 0, losses: 1 });
    if std::env::var_os("OVIDUCT_TEST_NIGHT").is_some() {
        check(Bounds { workers: 2, ticks: 4, kills: 1, steps: 1, losses: 1 });
    }
}
