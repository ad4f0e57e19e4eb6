//! The open loop: each call starts when it is due, whatever the state of earlier calls.

use super::calls;
use super::plan::{Plan, Planned};
use super::target::Target;
use crate::cli::exit::Failure;
use anyhow::Context;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tokio_util::task::TaskTracker;

/// Maximum sleep between two checks for the end of the run.
const LOOK: Duration = Duration::from_millis(100);

/// Makes the calls of a plan, at most `most` at a time, and waits for the calls in flight.
///
/// # Errors
/// If the thread that starts calls panics.
pub(super) async fn run(target: &Arc<Target>, plan: Plan, most: u32) -> Result<(), Failure> {
    let calls = TaskTracker::new();
    let pacer = Pacer { target: Arc::clone(target), calls: calls.clone(), runtime: Handle::current() };
    // A separate thread, because timers of the runtime have a resolution of a millisecond.
    let paced = tokio::task::spawn_blocking(move || pacer.start(plan, most as usize)).await;
    paced.context("the thread that starts calls panicked")?;
    calls.close();
    tokio::select! {
        () = calls.wait() => {}
        () = target.stop.cancelled() => {}
    }
    Ok(())
}

struct Pacer {
    target: Arc<Target>,
    calls: TaskTracker,
    runtime: Handle,
}

impl Pacer {
    /// Starts each call when it is due.
    fn start(&self, plan: Plan, most: usize) {
        let places = Arc::new(Semaphore::new(most));
        for planned in plan.calls() {
            if !self.wait_until(planned.at) {
                return;
            }
            let Planned { call, at, .. } = planned;
            self.target.record.due(call, at);
            let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
                self.target.record.dropped(call, at);
                continue;
            };
            let target = Arc::clone(&self.target);
            let made = async move {
                calls::make(&target, planned).await;
                drop(place);
            };
            self.calls.spawn_on(made, &self.runtime);
        }
    }

    /// Waits until this time of the run. Returns false if the run was stopped.
    fn wait_until(&self, due: Duration) -> bool {
        while !self.target.stop.is_cancelled() {
            let left = due.saturating_sub(self.target.watch.elapsed());
            if left.is_zero() {
                return true;
            }
            std::thread::sleep(left.min(LOOK));
        }
        false
    }
}
