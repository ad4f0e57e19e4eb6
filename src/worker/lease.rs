//! The lease of a claimed job: heartbeats renew it during the work, report progress and receive
//! cancellations.
//!
//! A cancellation through this process arrives immediately, as a change of the store. A
//! cancellation through another process arrives with the next heartbeat.

use super::context::{Context, Phase};
use super::progress::LiveProgress;
use crate::clock::Stopwatch;
use crate::jobs::{BackendReport, Change, ClaimedJob, Directive, Status};
use std::future::Future;
use std::time::Duration;
use tokio::sync::broadcast::{self, error::RecvError};
use tokio::sync::watch;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval_at};

/// Reason why work was interrupted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Interrupt {
    /// A client cancelled the job.
    Cancelled,
    /// Another attempt holds the job.
    Lost,
    /// The job was deleted.
    Deleted,
    /// The pool releases its jobs.
    Shutdown,
    /// The turn of a fit is over, and the fit of another owner waits.
    TurnOver,
}

/// A claimed job, with the backend that computes it.
pub(super) struct Claim {
    pub(super) job: ClaimedJob,
    pub(super) report: BackendReport,
}

/// Renews the lease of one claim.
pub(super) struct Lease<'a> {
    context: &'a Context,
    /// `None` after the store has closed the channel; then only heartbeats receive cancellations.
    changes: Option<broadcast::Receiver<Change>>,
    phase: watch::Receiver<Phase>,
    /// Time between ticks. A tick without progress renews the lease only if the renewal is due.
    period: Duration,
    tick: Interval,
    /// Time since the start of the last heartbeat that succeeded.
    renewed: Option<Stopwatch>,
}

impl<'a> Lease<'a> {
    pub(super) fn new(context: &'a Context) -> Self {
        // The first heartbeat follows after a period, because a job of a few milliseconds needs
        // none.
        let period = context.options.progress.min(context.options.heartbeat);
        let mut tick = interval_at(Instant::now() + period, period);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let changes = Some(context.store.changes());
        Self { context, changes, phase: context.phase.clone(), period, tick, renewed: None }
    }

    /// Sends a heartbeat at the next tick even without progress, because another backend computes
    /// the job.
    pub(super) fn report_soon(&mut self) {
        self.renewed = None;
    }

    /// Drives `work` while renewing the lease of `claim`. Drops `work` if it is interrupted.
    pub(super) async fn hold<T>(
        &mut self,
        claim: &Claim,
        progress: &LiveProgress,
        work: impl Future<Output = T>,
    ) -> Result<T, Interrupt> {
        tokio::select! {
            output = work => Ok(output),
            why = self.interrupted(claim, progress) => Err(why),
        }
    }

    /// Renews the lease until there is a reason to stop. May be dropped and called again.
    async fn interrupted(&mut self, claim: &Claim, progress: &LiveProgress) -> Interrupt {
        loop {
            let why = tokio::select! {
                biased;
                () = released(&mut self.phase) => Some(Interrupt::Shutdown),
                change = next(&mut self.changes) => match change {
                    Ok(change) if change.id != claim.job.job().id => None,
                    Ok(Change { version: None, .. }) => Some(Interrupt::Deleted),
                    Ok(_) | Err(RecvError::Lagged(_)) => self.look(&claim.job).await,
                    Err(RecvError::Closed) => {
                        self.changes = None;
                        None
                    }
                },
                _ = self.tick.tick() => self.beat(claim, progress).await,
            };
            if let Some(why) = why {
                return why;
            }
        }
    }

    /// Reads the record after a change, which may be a heartbeat of this worker.
    async fn look(&self, claimed: &ClaimedJob) -> Option<Interrupt> {
        match self.context.store.get(claimed.job().id).await {
            Ok(Some(job)) if job.status == Status::Running && job.attempts == claimed.attempt() => {
                job.cancel_requested.then_some(Interrupt::Cancelled)
            }
            Ok(Some(_)) => Some(Interrupt::Lost),
            Ok(None) => Some(Interrupt::Deleted),
            Err(error) => {
                tracing::warn!(%error, "could not read the job after a change; the next heartbeat will report a cancellation");
                None
            }
        }
    }

    /// Sends a heartbeat if there is progress or the renewal is due.
    async fn beat(&mut self, claim: &Claim, progress: &LiveProgress) -> Option<Interrupt> {
        let options = &self.context.options;
        // Due at the tick nearest to its time; otherwise a small difference of clocks would delay
        // it by a tick.
        let due = self.renewed.is_none_or(|since| since.elapsed() + self.period / 2 >= options.heartbeat);
        let begun = Stopwatch::start();
        let update = progress.take();
        if update.is_empty() && !due {
            return None;
        }
        if let Err(injected) = options.faults.point("during-renewal").await {
            tracing::warn!(%injected, "could not renew the lease; the work continues");
            progress.put_back(update);
            return None;
        }
        let (changed, section) = (update.progress.as_ref(), update.section.as_ref());
        match self.context.store.heartbeat(&claim.job, options.lease, &claim.report, changed, section).await {
            Ok(directive) => {
                self.renewed = Some(begun);
                match directive {
                    Directive::Continue => None,
                    Directive::Cancel => Some(Interrupt::Cancelled),
                    // The record contains the reason.
                    Directive::Lost => Some(self.look(&claim.job).await.unwrap_or(Interrupt::Lost)),
                }
            }
            Err(error) => {
                // The work continues: the store may become available in time, and otherwise the
                // fence protects the job.
                tracing::warn!(%error, "could not renew the lease; the work continues");
                progress.put_back(update);
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

/// Waits until the pool releases its jobs.
async fn released(phase: &mut watch::Receiver<Phase>) {
    // The channel closes if the pool is dropped without a shutdown; no phase follows then.
    if phase.wait_for(|phase| *phase == Phase::Release).await.is_err() {
        std::future::pending::<()>().await;
    }
}
