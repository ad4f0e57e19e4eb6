//! Attempts at jobs: the claim that a worker holds, what its writes return, and the history.

use super::job::{BackendReport, File, Job, Problem};
use super::state::{AttemptEnd, Fence};
use jiff::Timestamp;
use std::fmt::Write as _;

/// A job whose lease a worker holds.
///
/// Only [`Store::claim`](super::Store::claim) creates this value. The calls that end an attempt
/// (`finish`, `fail`, `cancelled`, `release` and `retry`) consume it.
#[derive(Debug)]
pub struct ClaimedJob {
    pub(super) job: Job,
    pub(super) worker: String,
    pub(super) attempt: u32,
}

impl ClaimedJob {
    /// The record at the time of the claim.
    #[must_use]
    pub fn job(&self) -> &Job {
        &self.job
    }

    /// Number of this attempt, from 1.
    #[must_use]
    pub fn attempt(&self) -> u32 {
        self.attempt
    }

    /// The fence that every write of this attempt carries.
    pub(super) fn fence(&self) -> Fence {
        Fence { attempt: self.attempt, worker: self.worker.clone() }
    }
}

/// Response to a heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Directive {
    /// Continue; the lease was renewed.
    Continue,
    /// Stop: a client cancelled the job.
    Cancel,
    /// Stop and write nothing: another worker holds the lease, or the job has ended or was deleted.
    Lost,
}

/// Result of a job that succeeded.
#[derive(Clone, Debug)]
pub struct Finished {
    /// Backend and device that computed it.
    pub backend: BackendReport,
    /// Its files, which are in the artifact store already.
    pub files: Vec<File>,
    /// Counts and the main measures.
    pub summary: serde_json::Value,
    /// Engine version of the worker. If it differs from the version in the job's digest, the model
    /// is never reused.
    pub engine: String,
}

/// One attempt in the history of a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attempt {
    /// Number, from 1.
    pub attempt: u32,
    /// Worker that claimed the job.
    pub worker: String,
    /// Time of the claim.
    pub started_at: Timestamp,
    /// End of the attempt; `None` while it runs.
    pub ended_at: Option<Timestamp>,
    /// How the attempt ended; `None` while it runs.
    pub outcome: Option<AttemptEnd>,
    /// The error in one line, if there was one.
    pub detail: Option<String>,
}

impl Attempt {
    /// The problem of a job that used up its attempts, with their history.
    #[must_use]
    pub fn exhausted(history: &[Self]) -> Problem {
        let mut detail = String::new();
        for attempt in history {
            let how = match attempt.outcome {
                Some(AttemptEnd::Vanished) => "the worker vanished",
                Some(AttemptEnd::Retried) => "failed",
                Some(AttemptEnd::Released) => "released",
                Some(AttemptEnd::Succeeded | AttemptEnd::Failed | AttemptEnd::Cancelled) | None => "ended",
            };
            let gap = if detail.is_empty() { "" } else { "; " };
            // Writing to a String cannot fail.
            let _ = write!(detail, "{gap}attempt {} by {}: {how}", attempt.attempt, attempt.worker);
            if let Some(at) = attempt.ended_at {
                let _ = write!(detail, " at {at}");
            }
            if let Some(fault) = &attempt.detail {
                let _ = write!(detail, " ({fault})");
            }
        }
        Problem { kind: "attempts-exhausted".into(), title: "No attempt came to an end".into(), detail }
    }
}
