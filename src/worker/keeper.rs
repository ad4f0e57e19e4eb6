//! The lease of an attempt while work goes on: heartbeat and progress up, cancel down.
//!
//! A cancel in this process arrives by the store's changes at once; from elsewhere, by the next heartbeat.

use super::attempt::Context;
use super::live::Live;
use crate::clock::Stopwatch;
use crate::jobs::{BackendReport, Change, ClaimedJob, Directive, Status};
use std::future::Future;
use std::time::Duration;
use tokio::sync::broadcast::{self, error::RecvError};
use tokio::sync::watch;
use tokio::time::{Interval, MissedTickBehavior};

/// What the pool tells its workers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// Claim and work.
    Run,
    /// Claim no more; what runs may end.
    Drain,
    /// Give back what runs.
    GiveBack,
}

/// Why work was broken off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Interrupt {
    /// A client asked for it.
    Cancelled,
    /// The lease is another's.
    Lost,
    /// The job was deleted.
    Gone,
    /// The worker shuts down.
    Shutdown,
}

/// Keeps one lease.
pub(super) struct Keeper<'a> {
    context: &'a Context,
    claimed: &'a ClaimedJob,
    backend: BackendReport,
    live: &'a Live,
    /// None once the store has closed it: then heartbeats are all there is.
    changes: Option<broadcast::Receiver<Change>>,
    phase: watch::Receiver<Phase>,
    /// Time between looks at what is to be told.
    period: Duration,
    tick: Interval,
    /// Since the last heartbeat that arrived was begun.
    renewed: Option<Stopwatch>,
}

impl<'a> Keeper<'a> {
    pub(super) fn new(context: &'a Context, claimed: &'a ClaimedJob, backend: BackendReport, live: &'a Live) -> Self {
        // The first heartbeat is not at once: a job of a few milliseconds needs none.
        let period = context.options.progress.min(context.options.heartbeat);
        let mut tick = tokio::time::interval_at(tokio::time::Instant::now() + period, period);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Self {
            context,
            claimed,
            backend,
            live,
            changes: Some(context.store.changes()),
            phase: context.phase.clone(),
            period,
            tick,
            renewed: None,
        }
    }

    /// From now on something else computes the job.
    pub(super) fn report(&mut self, backend: BackendReport) {
        self.backend = backend;
        // The next beat tells it, whether there is progress or not.
        self.renewed = None;
    }

    /// Drives `work` while keeping the lease; drops it at an interrupt.
    pub(super) async fn keep<T>(&mut self, work: impl Future<Output = T>) -> Result<T, Interrupt> {
        tokio::select! {
            output = work => Ok(output),
            why = self.interrupt() => Err(why),
        }
    }

    /// Keeps the lease until there is a reason to stop. May be dropped and called again.
    async fn interrupt(&mut self) -> Interrupt {
        loop {
            tokio::select! {
                biased;
                () = gives_back(&mut self.phase) => return Interrupt::Shutdown,
                change = next(&mut self.changes) => {
                    let why = match change {
                        Ok(change) if change.id != self.claimed.job().id => None,
                        Ok(Change { version: None, .. }) => Some(Interrupt::Gone),
                        Ok(_) | Err(RecvError::Lagged(_)) => self.look().await,
                        Err(RecvError::Closed) => { self.changes = None; None }
                    };
                    if let Some(why) = why {
                        return why;
                    }
                }
                _ = self.tick.tick() => {
                    if let Some(why) = self.beat().await {
                        return why;
                    }
                }
            }
        }
    }

    /// Reads the record: the job has changed, perhaps only by this worker's own heartbeat.
    async fn look(&self) -> Option<Interrupt> {
        match self.context.store.get(self.claimed.job().id).await {
            Ok(Some(job)) if job.status == Status::Running && job.attempts == self.claimed.attempt() => {
                job.cancel_requested.then_some(Interrupt::Cancelled)
            }
            Ok(Some(_)) => Some(Interrupt::Lost),
            Ok(None) => Some(Interrupt::Gone),
            Err(error) => {
                tracing::warn!(%error, "the job could not be read");
                None
            }
        }
    }

    /// Tells what is new, or renews the lease where it is time.
    async fn beat(&mut self) -> Option<Interrupt> {
        // Not a tick later, where the clocks differ by a little: it is due at the tick that is nearest to its time.
        let due = self.renewed.is_none_or(|since| since.elapsed() + self.period / 2 >= self.context.options.heartbeat);
        let begun = Stopwatch::start();
        let news = self.live.news();
        if news.is_empty() && !due {
            return None;
        }
        if let Err(injected) = self.context.options.faults.point("during-renewal").await {
            tracing::warn!(%injected, "the lease was not renewed");
            self.live.put_back(news);
            return None;
        }
        let told = self
            .context
            .store
            .heartbeat(
                self.claimed,
                self.context.options.lease,
                &self.backend,
                news.progress.as_ref(),
                news.section.as_ref(),
            )
            .await;
        match told {
            Ok(directive) => {
                self.renewed = Some(begun);
                match directive {
                    Directive::Continue => None,
                    Directive::Cancel => Some(Interrupt::Cancelled),
                    // The record says why, where it can be read.
                    Directive::Lost => Some(self.look().await.unwrap_or(Interrupt::Lost)),
                }
            }
            Err(error) => {
                // The work goes on: the store may be back in time, and if not, the fence holds.
                tracing::warn!(%error, "the lease was not renewed");
                self.live.put_back(news);
                None
            }
        }
    }
}

async fn next(changes: &mut Option<broadcast::Receiver<Change>>) -> Result<Change, RecvError> {
    match changes {
        Some(changes) => changes.recv().await,
        None => std::future::pending().await,
    }
}

async fn gives_back(phase: &mut watch::Receiver<Phase>) {
    // A pool that is gone without a word has no wishes any more.
    if phase.wait_for(|phase| *phase == Phase::GiveBack).await.is_err() {
        std::future::pending::<()>().await;
    }
}
