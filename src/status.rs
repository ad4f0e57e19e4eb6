//! The status of this process, which `/healthz` and `/readyz` report. Workers and the command line
//! set it.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::timeout;

/// A reason why a process cannot take work now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Condition {
    /// GPU workers are opening their devices for the first time.
    OpeningDevices,
    /// The artifact store or the scratch directory refuses files: the workers claim no jobs, and
    /// the service refuses submissions.
    Storage,
    /// The process is shutting down.
    Draining,
}

impl Condition {
    /// The name in problems and logs.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::OpeningDevices => "opening-devices",
            Self::Storage => "storage",
            Self::Draining => "draining",
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct State {
    conditions: BTreeMap<Condition, String>,
    /// Workers whose generation was told to stop long ago and still runs, with a sentence on each.
    stuck: BTreeMap<String, String>,
}

/// The state of this process. Clones share it.
#[derive(Clone, Debug, Default)]
pub struct Status(Arc<watch::Sender<State>>);

impl Status {
    /// The process is not ready for the reason given in `detail`, in whole sentences, until
    /// [`Status::clear`].
    pub fn set(&self, condition: Condition, detail: impl Into<String>) {
        self.0.send_modify(|state| {
            state.conditions.insert(condition, detail.into());
        });
    }

    /// The condition no longer holds.
    pub fn clear(&self, condition: Condition) {
        self.0.send_if_modified(|state| state.conditions.remove(&condition).is_some());
    }

    /// Waits until the condition does not hold, at most for `longest`. Returns whether it does not.
    pub async fn cleared(&self, condition: Condition, longest: Duration) -> bool {
        let mut state = self.0.subscribe();
        let clear = state.wait_for(|state| !state.conditions.contains_key(&condition));
        matches!(timeout(longest, clear).await, Ok(Ok(_)))
    }

    /// The detail of a condition; `None` if it does not hold.
    #[must_use]
    pub fn detail(&self, condition: Condition) -> Option<String> {
        self.0.borrow().conditions.get(&condition).cloned()
    }

    /// The first reason why the process is not ready, with sentences for operators; `None` if the
    /// process is ready.
    #[must_use]
    pub fn not_ready(&self) -> Option<(Condition, String)> {
        self.0.borrow().conditions.first_key_value().map(|(condition, detail)| (*condition, detail.clone()))
    }

    /// Reports a worker whose generation was told to stop long ago and still runs.
    pub fn stuck(&self, worker: &str, detail: impl Into<String>) {
        self.0.send_modify(|state| {
            state.stuck.insert(worker.to_owned(), detail.into());
        });
    }

    /// Reports that a stuck worker is free again.
    pub fn unstuck(&self, worker: &str) {
        self.0.send_if_modified(|state| state.stuck.remove(worker).is_some());
    }

    /// A sentence on each stuck worker; empty if the process is healthy.
    #[must_use]
    pub fn stuck_workers(&self) -> Vec<String> {
        self.0.borrow().stuck.values().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn conditions_and_stuck_workers_come_and_go() {
        let status = Status::default();
        assert!(status.not_ready().is_none() && status.stuck_workers().is_empty());
        status.set(Condition::Draining, "The process is shutting down.");
        status.set(Condition::OpeningDevices, "The process is opening 1 GPU.");
        assert_eq!(status.not_ready(), Some((Condition::OpeningDevices, "The process is opening 1 GPU.".to_owned())));
        assert!(!status.cleared(Condition::OpeningDevices, Duration::from_millis(5)).await);
        assert_eq!(status.detail(Condition::Draining).as_deref(), Some("The process is shutting down."));
        assert_eq!(status.detail(Condition::Storage), None);
        let other = status.clone();
        let (cleared, ()) =
            tokio::join!(status.cleared(Condition::OpeningDevices, Duration::from_secs(60)), async move {
                other.clear(Condition::OpeningDevices);
            });
        assert!(cleared);
        assert_eq!(status.not_ready().map(|(condition, _)| condition), Some(Condition::Draining));
        status.stuck("host-1-0", "worker host-1-0 has not stopped for 300 s");
        assert_eq!(status.stuck_workers().len(), 1);
        status.unstuck("host-1-0");
        assert!(status.stuck_workers().is_empty());
    }
}
